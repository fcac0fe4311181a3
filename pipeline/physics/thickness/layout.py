"""What electrodes on a rod film meet: thin film, field, and where failures are to be expected."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.physics.thickness.film import RodFilm, ThicknessMap
from schemas.arrays import Bool, Float

REGIONS = ("left", "centre", "right")


@dataclass(frozen=True)
class Rectangle:
    """An electrode on the finished film, mm, the middle of the film at (0, 0), x along the rods."""

    x_low: float
    x_high: float
    y_low: float
    y_high: float

    def __post_init__(self) -> None:
        if not (self.x_high > self.x_low and self.y_high > self.y_low):
            raise ValueError(f"{self} has no area: expected x_low < x_high and y_low < y_high")


def single_region(film: RodFilm) -> tuple[Rectangle, ...]:
    """One electrode over the whole film (thesis, fig 3-2a)."""
    return (Rectangle(-film.length_mm / 2, film.length_mm / 2, -film.width_mm / 2, film.width_mm / 2),)


def separate_regions(film: RodFilm, gap_mm: float = 1.0) -> tuple[Rectangle, ...]:
    """Electrodes between the rods, a gap away from their axes.

    Notes
    -----
    The thesis' 1 mm (fig 3-2b) takes a fifth of the electrode, as its section 3.4.1 says, only if it is counted from the axes.
    """
    away = gap_mm
    rods = film.rod_positions_mm
    return tuple(
        Rectangle(-film.length_mm / 2, film.length_mm / 2, low + away, high - away)
        for low, high in itertools.pairwise(rods)
        if high - low > 2 * away
    )


def covered(film_map: ThicknessMap, electrodes: Sequence[Rectangle]) -> Bool:
    """(n,) elements whose centre lies under an electrode."""
    x, y = film_map.centres_mm.T
    under = np.zeros(x.size, bool)
    for r in electrodes:
        under |= (x >= r.x_low) & (x <= r.x_high) & (y >= r.y_low) & (y <= r.y_high)
    return under


def covered_share(film_map: ThicknessMap, electrodes: Sequence[Rectangle]) -> Float:
    """(n,) share of each element that lies under an electrode; electrodes do not overlap.

    Notes
    -----
    An element counts as the rectangle around its corners. An element that is counted whole or not at all moves the shares of
    failures by as much as a mesh of twice the elements does.
    """
    under = np.zeros(len(film_map.thickness))
    for r in electrodes:
        under += _inside(film_map, 0, r.x_low, r.x_high) * _inside(film_map, 1, r.y_low, r.y_high)
    return np.minimum(under, 1.0)


def _inside(film_map: ThicknessMap, axis: int, low: float, high: float) -> Float:
    """(n,) share of each element's extent along an axis that lies between two places."""
    start, end = film_map.corners_mm[:, :, axis].min(axis=1), film_map.corners_mm[:, :, axis].max(axis=1)
    overlap = np.minimum(end, high) - np.maximum(start, low)
    return np.asarray(np.clip(overlap / (end - start), 0.0, 1.0))


def thin_share(film_map: ThicknessMap, electrodes: Sequence[Rectangle], limit: float) -> float:
    """Share of the active area whose film is thin.

    Parameters
    ----------
    film_map : thickness of n elements
    electrodes : on the finished film
    limit : thickness over the median of the whole film below which it counts

    Returns
    -------
    Between 0 and 1

    Raises
    ------
    ValueError
        No electrode lies on the film.
    """
    area = film_map.area_mm2 * covered_share(film_map, electrodes)
    if area.sum() == 0:
        raise ValueError("no electrode lies on the film")
    return float(area[film_map.relative_thickness < limit].sum() / area.sum())


def hazard(film_map: ThicknessMap, electrodes: Sequence[Rectangle], exponent: float) -> Float:
    """Share of the failures that is expected in each element.

    Parameters
    ----------
    film_map : thickness of n elements
    electrodes : on the finished film
    exponent : of the inverse power law of life over field

    Returns
    -------
    (n,), sum 1

    Raises
    ------
    ValueError
        No electrode lies on the film.

    Notes
    -----
    ∝ undeformed area × E^exponent, E ∝ 1/λ3, under electrodes. Flaws are bound to the material, so the undeformed area
    counts.
    """
    under = covered_share(film_map, electrodes)
    weight = under * film_map.undeformed_area_mm2 * film_map.relative_thickness**-exponent
    if weight.sum() == 0:
        raise ValueError("no electrode lies on the film")
    return np.asarray(weight / weight.sum())


def region_shares(film_map: ThicknessMap, electrodes: Sequence[Rectangle], exponent: float) -> dict[str, float]:
    """Expected share of the failures in the left, centre and right third along the rods (thesis, fig 3-13)."""
    share = hazard(film_map, electrodes, exponent)
    third = film_map.film.length_mm / 6
    limits = (-np.inf, -third, third, np.inf)
    return {
        name: float((share * _inside(film_map, 0, low, high)).sum())
        for name, (low, high) in zip(REGIONS, itertools.pairwise(limits), strict=True)
    }


def rod_share(
    film_map: ThicknessMap, electrodes: Sequence[Rectangle], exponent: float, within_mm: float = 1.0
) -> float:
    """Expected share of the failures no farther than `within_mm` from the edge of a rod."""
    share = hazard(film_map, electrodes, exponent)
    reach = film_map.film.rod_diameter_mm / 2 + within_mm
    near = sum(_inside(film_map, 1, rod - reach, rod + reach) for rod in film_map.film.rod_positions_mm)
    return float((share * np.minimum(near, 1.0)).sum())
