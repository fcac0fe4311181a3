"""The film over its rods: geometry, mesh, and the thickness map that both schemes yield."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from schemas.arrays import Float, Int

_ROUNDED = 1e-3
"""Share by which a size may be rounded: rods on the edges of a film of 19.99 mm that are said to span 20 mm fit."""

_GRADING = 0.95
"""How far elements shrink towards rods and ends: 0 not at all, below 1."""


@dataclass(frozen=True)
class RodFilm:
    """A rectangular film that is stretched over parallel rods. x runs along the rods, y across them.

    Parameters
    ----------
    length_mm, width_mm : size along and across the rods, of the film as the pre-stretch leaves it
    rods : number of rods, placed symmetrically; the outermost may lie on the film's edges
    rod_spacing_mm : distance of neighbouring rods' axes in the finished film
    rod_diameter_mm : width over which a rod holds the film
    stretch_along, stretch_across : pre-stretch in x and y
    """

    length_mm: float = 20.0
    width_mm: float = 20.0
    rods: int = 3
    rod_spacing_mm: float = 10.0
    rod_diameter_mm: float = 0.75
    stretch_along: float = 3.0
    stretch_across: float = 1.2

    def __post_init__(self) -> None:
        for name in ("length_mm", "width_mm", "rod_spacing_mm", "rod_diameter_mm"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}, expected a length above 0")
        if self.rods < 1 or self.stretch_along < 1 or self.stretch_across < 1:
            raise ValueError("expected at least one rod and stretches of at least 1")
        if self.rods * self.rod_diameter_mm >= self.width_mm:
            raise ValueError(f"{self.rods} rods {self.rod_diameter_mm} mm wide do not fit on {self.width_mm} mm")
        if (self.rods - 1) * self.rod_spacing_mm > self.width_mm * (1 + _ROUNDED):
            raise ValueError(f"{self.rods} rods {self.rod_spacing_mm} mm apart do not fit on {self.width_mm} mm")
        if self.rods > 1 and self.rod_spacing_mm <= self.rod_diameter_mm:
            raise ValueError(f"rods {self.rod_spacing_mm} mm apart and {self.rod_diameter_mm} mm wide do not fit")

    @property
    def rod_positions_mm(self) -> Float:
        """(rods,) y of the rods' axes in the finished film, the middle of the film at 0."""
        return np.asarray((np.arange(self.rods) - (self.rods - 1) / 2) * self.rod_spacing_mm, dtype=np.float64)

    @property
    def uniform_thickness(self) -> float:
        """Thickness over undeformed thickness, were the film stretched uniformly."""
        return 1 / (self.stretch_along * self.stretch_across)


@dataclass(frozen=True)
class ThicknessMap:
    """Thickness of n four-node elements.

    Parameters
    ----------
    film : the geometry
    corners_mm : (n, 4, 2) corners in the finished film, x along the rods, the middle of the film at 0
    thickness : (n,) λ3, thickness over undeformed thickness
    undeformed_area_mm2 : (n,) area of the element before stretching
    scheme : how it was computed
    iterations : linear systems that were solved
    """

    film: RodFilm
    corners_mm: Float
    thickness: Float
    undeformed_area_mm2: Float
    scheme: str
    iterations: int

    @property
    def centres_mm(self) -> Float:
        """(n, 2) centres of the elements in the finished film."""
        return np.asarray(self.corners_mm.mean(axis=1))

    @property
    def area_mm2(self) -> Float:
        """(n,) area of the elements in the finished film."""
        return polygon_area(self.corners_mm)

    @property
    def relative_thickness(self) -> Float:
        """(n,) thickness over the area-weighted median: what maps of two schemes can be compared by."""
        order = np.argsort(self.thickness)
        weight = np.cumsum(self.area_mm2[order])
        return np.asarray(self.thickness / self.thickness[order[np.searchsorted(weight, weight[-1] / 2)]])


def polygon_area(corners: Float) -> Float:
    """(n,) areas of quadrilaterals (n, 4, 2), corners in order (shoelace formula)."""
    x, y = corners[..., 0], corners[..., 1]
    return np.asarray(0.5 * np.abs(np.sum(x * np.roll(y, -1, 1) - np.roll(x, -1, 1) * y, axis=1)))


def undeformed_mesh(film: RodFilm, elements: int) -> Any:
    """Mesh (`skfem.MeshQuad`) of the undeformed film with about that many elements; rods' edges are mesh lines.

    Notes
    -----
    Elements are smaller towards the rods' edges and the film's free ends, where the thickness changes most: shares of failures
    then agree within 1 % between meshes that would differ by 4 % with elements of one size.
    """
    from skfem import MeshQuad

    lx, ly = film.length_mm / film.stretch_along, film.width_mm / film.stretch_across
    half = film.rod_diameter_mm / 2 / film.stretch_across
    centres = film.rod_positions_mm / film.stretch_across
    edges = np.clip(np.concatenate([centres - half, centres + half]), -ly / 2, ly / 2)
    breaks = np.unique(np.concatenate([[-ly / 2], edges, [ly / 2]]))
    across = round(float(np.sqrt(elements)))
    pieces = []
    for low, high in itertools.pairwise(breaks):
        steps = max(2, round(across * (high - low) / ly))
        pieces.append(_graded(low, high, steps)[:-1])
    y = np.append(np.concatenate(pieces), ly / 2)
    count = int(np.ceil(elements / (y.size - 1)))
    return MeshQuad.init_tensor(_graded(-lx / 2, lx / 2, count + count % 2), y)


def _graded(low: float, high: float, steps: int) -> Float:
    """(steps + 1,) places from low to high, closer towards both."""
    t = np.linspace(-1, 1, steps + 1)
    return np.asarray((low + high) / 2 + (high - low) / 2 * ((1 - _GRADING) * t + _GRADING * np.sin(np.pi / 2 * t)))


def on_rods(film: RodFilm, y_undeformed: Float) -> Int:
    """(m,) number of the rod that a point at that undeformed y is bonded to, −1 for none."""
    centres = film.rod_positions_mm / film.stretch_across
    half = film.rod_diameter_mm / 2 / film.stretch_across
    inside = np.abs(y_undeformed[:, None] - centres) <= half * (1 + 1e-9)
    return np.where(inside.any(axis=1), inside.argmax(axis=1), -1)
