"""The rod film as one hyperelastic problem, total Lagrangian, with boundary conditions close to the fabrication.

The film is stretched uniformly along x, rods are bonded to it (they hold the film's x as it is and stay straight and
parallel), the ends beside the rods are released, and the upper and lower edge are moved apart to the stretch across.
Between the rods the released ends run back and thicken; along the rods and in the middle the film keeps its full
pre-stretch. That is why the film at the rods is the weak one.
"""

from __future__ import annotations

import numpy as np

from pipeline.physics.hyperelastic import stress_and_tangent
from pipeline.physics.thickness.assembly import Q4, q4, solve, tie_matrix
from pipeline.physics.thickness.film import RodFilm, ThicknessMap, on_rods, undeformed_mesh
from schemas.arrays import Float, Int
from schemas.errors import NotIdentifiableError

_TOLERANCE = 1e-9
"""Largest residual force that is left, relative to the forces that hold the film."""


def continuous_thickness(film: RodFilm, *, elements: int = 20_000) -> ThicknessMap:
    """Thickness map of the continuous hyperelastic problem.

    Parameters
    ----------
    film : geometry and pre-stretch
    elements : how many at least

    Returns
    -------
    Map of the finished film

    Raises
    ------
    NotIdentifiableError
        The film has no stable solution that Newton's method finds.

    Notes
    -----
    A coarse mesh takes the load in steps; its solution starts Newton's method on the fine one.
    """
    coarse = _Problem(film, min(elements, 1200))
    displacement, solved = coarse.load_in_steps()
    if elements <= 1200:
        return coarse.result(displacement, solved)
    fine = _Problem(film, elements)
    start = coarse.interpolate(displacement, fine.points)
    start[fine.held] = fine.prescribed(1.0)[fine.held]
    displacement, more = fine.newton(fine.respect_rods(start), 1.0)
    return fine.result(displacement, solved + more)


class _Problem:
    """One mesh of the film with its constraints."""

    def __init__(self, film: RodFilm, elements: int) -> None:
        self.film = film
        self.mesh = undeformed_mesh(film, elements)
        self.points: Float = np.asarray(self.mesh.p.T)
        self.q4: Q4 = q4(self.mesh)
        x, y = self.points.T
        rod = on_rods(film, y)
        edge = np.isclose(np.abs(y), np.abs(y).max())
        owner: Int = np.arange(2 * len(x), dtype=np.int64).reshape(-1, 2)
        owner[rod >= 0, 0] = -1  # the rod holds the film's x
        pulled = np.where(edge, y, 0.0)  # y of the edge that moves a node
        for number in range(film.rods):  # and stays straight: one y for all of it
            members = rod == number
            owner[members, 1] = 2 * np.flatnonzero(members)[0] + 1
            if (members & edge).any():  # a rod on the edge moves with it
                pulled[members] = y[members & edge][0]
        owner[pulled != 0] = -1
        self.rod, self.pulled = rod, pulled
        self.held = owner < 0
        self.tie = tie_matrix(owner.ravel())

    def prescribed(self, load: float) -> Float:
        """(nodes, 2) displacement of the held unknowns; at load 0 the film is stretched along x only."""
        x, y = self.points.T
        moved = np.where(self.pulled != 0, self.pulled, y)
        return np.stack([(self.film.stretch_along - 1) * x, load * (self.film.stretch_across - 1) * moved], axis=1)

    def respect_rods(self, displacement: Float) -> Float:
        for number in range(self.film.rods):
            displacement[self.rod == number, 1] = displacement[self.rod == number, 1].mean()
        return displacement

    def newton(self, start: Float, released: float, limit: int = 25) -> tuple[Float, int]:
        """Equilibrium from a start that meets the constraints. `released`: share of the end traction taken away."""
        u = start.copy()
        traction = (1 - released) * self._end_forces()
        scale = np.abs(self._end_forces()).sum()
        for iteration in range(limit):
            stress, tangent = stress_and_tangent(self.q4.deformation(u))
            residual = traction - self.q4.forces(stress)
            if np.abs(self.tie.T @ residual).sum() < _TOLERANCE * scale:
                return u, iteration
            step = solve(self.q4.matrix(tangent), residual, self.tie, np.zeros(residual.size)).reshape(-1, 2)
            share = 1.0
            while np.linalg.det(self.q4.deformation(u + share * step)).min() <= 0.02:
                share /= 2
                if share < 1e-3:
                    break
            u = u + share * step
        raise NotIdentifiableError(
            f"the film's equilibrium was not reached in {limit} Newton steps",
            where="thickness map",
            remedy="Use a smaller pre-stretch or more load steps",
        )

    def load_in_steps(self) -> tuple[Float, int]:
        """Releases the ends and stretches across together, halving the step where Newton's method fails."""
        u, load, step, solved = self.prescribed(0.0), 0.0, 0.125, 0
        while load < 1:
            target = min(1.0, load + step)
            trial = u.copy()
            held = self.pulled != 0
            trial[held] = self.prescribed(target)[held]
            trial += np.where(held, 0, 1)[:, None] * (self.prescribed(target) - self.prescribed(load)) * [0, 1]
            try:
                u, iterations = self.newton(self.respect_rods(trial), target, limit=12)
            except (NotIdentifiableError, RuntimeError, np.linalg.LinAlgError):
                step /= 2
                if step < 1e-3:
                    raise
                continue
            solved += iterations
            load, step = target, min(0.25, 1.5 * step)
        return u, solved

    def _end_forces(self) -> Float:
        """Nodal forces that hold the uniformly stretched film at its ends before they are released."""
        stress, _ = stress_and_tangent(self.q4.deformation(self.prescribed(0.0)))
        return self.q4.forces(stress)

    def interpolate(self, displacement: Float, points: Float) -> Float:
        """(m, 2) displacement of this mesh at undeformed points (m, 2); bilinear on the tensor grid."""
        from scipy.interpolate import RegularGridInterpolator

        xs, ys = (np.unique(self.points[:, i].round(9)) for i in range(2))
        order = np.lexsort((self.points[:, 1].round(9), self.points[:, 0].round(9)))
        table = displacement[order].reshape(xs.size, ys.size, 2)
        return np.asarray(RegularGridInterpolator((xs, ys), table, bounds_error=False, fill_value=None)(points))

    def result(self, displacement: Float, solved: int) -> ThicknessMap:
        gradient = self.q4.deformation(displacement).mean(axis=1)
        return ThicknessMap(
            self.film,
            (self.points + displacement)[self.q4.nodes],
            1 / np.linalg.det(gradient),
            self.q4.weights.sum(axis=1),
            "continuous",
            solved,
        )
