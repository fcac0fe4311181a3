"""The thesis' incremental scheme (thesis, section 3.4.3) with its errata corrected.

Eleven linear steps on moving nodes: ten of 0.2 of the undeformed length along the rods, one of 0.2 across. In each step
an element has the tangent of the Ogden law at its current deformation, pushed forward to the current shape, in place of
eq 3.16, which is not symmetric and takes the held-width tangent for Young's modulus. A rod is a band of its diameter on
the left and the right edge, not a single node: a point load would concentrate the deformation at that node and make the
level of the map depend on the mesh. The level still is a result of that boundary condition; compare
`relative_thickness`.
"""

from __future__ import annotations

import numpy as np

from pipeline.physics.hyperelastic import stress_and_tangent
from pipeline.physics.thickness.assembly import q4, solve, tie_matrix
from pipeline.physics.thickness.film import RodFilm, ThicknessMap, on_rods, undeformed_mesh
from schemas.arrays import Float


def incremental_thickness(film: RodFilm, *, elements: int = 20_000, steps_along: int = 10) -> ThicknessMap:
    """Thickness map of the incremental scheme.

    Parameters
    ----------
    film : geometry and pre-stretch
    elements : about how many
    steps_along : linear steps in which the film is stretched along the rods

    Returns
    -------
    Map of the finished film

    Notes
    -----
    λ3 from the product of the steps' strains (thesis, eq 3.17). Boundary conditions (thesis, section 3.4.3): along the
    rods the left ends of the rods are pulled, the right ends are fixed, all else is free; then the upper edge is moved,
    the lower one is fixed and the rods' ends keep their x.
    """
    mesh = undeformed_mesh(film, elements)
    undeformed = np.asarray(mesh.p.T)
    nodes = np.asarray(q4(mesh).nodes)
    area = q4(mesh).weights.sum(axis=1)
    x, y = undeformed.T
    rod = on_rods(film, y) >= 0
    left, right = np.isclose(x, x.min()) & rod, np.isclose(x, x.max()) & rod
    lower, upper = np.isclose(y, y.min()), np.isclose(y, y.max())
    length, width = np.ptp(x), np.ptp(y)

    along = [(left, (-(film.stretch_along - 1) * length / steps_along, 0.0)), (right, (0.0, 0.0))]
    across = [(lower, (0.0, 0.0)), (upper, (0.0, (film.stretch_across - 1) * width))]
    points = undeformed.copy()
    total = np.broadcast_to(np.eye(2), (len(nodes), 2, 2)).copy()
    for step in range(steps_along + 1):
        moved, ends = (along, ()) if step < steps_along else (across, (left, right))
        held, value = np.zeros((len(points), 2), bool), np.zeros((len(points), 2))
        for mask, amount in moved:
            held[mask], value[mask] = True, amount
        for mask in ends:
            held[mask, 0] = True
        mesh = type(mesh)(np.ascontiguousarray(points.T), mesh.t)
        current = q4(mesh)
        _, tangent = stress_and_tangent(total)
        quadrature = np.broadcast_to(_pushed_forward(tangent, total)[:, None], (*current.weights.shape, 2, 2, 2, 2))
        owner = np.where(held, -1, np.arange(held.size).reshape(held.shape)).ravel()
        matrix = current.matrix(quadrature)
        increment = solve(matrix, np.zeros(held.size), tie_matrix(owner), value.ravel()).reshape(-1, 2)
        total = current.deformation(increment).mean(axis=1) @ total
        points = points + increment
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    return ThicknessMap(film, (points - middle)[nodes], 1 / np.linalg.det(total), area, "incremental", steps_along + 1)


def _pushed_forward(tangent: Float, deformation: Float) -> Float:
    """(n, 2, 2, 2, 2) tangent on the current shape, a_ijkl = F_jJ F_lL A_iJkL, times the current thickness 1/det F."""
    n = len(deformation)
    turn = np.zeros((n, 2, 2, 2, 2))
    for i in range(2):
        turn[:, i, :, i, :] = deformation
    flat = turn.reshape(n, 4, 4)
    pushed = flat @ tangent.reshape(n, 4, 4) @ np.swapaxes(flat, 1, 2)
    return np.asarray((pushed / np.linalg.det(deformation)[:, None, None]).reshape(n, 2, 2, 2, 2))
