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
    """Electrodes between the rods, a gap away from them (thesis, fig 3-2b: 1 mm)."""
    away = film.rod_diameter_mm / 2 + gap_mm
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
    under = covered(film_map, electrodes)
    area = film_map.area_mm2[under]
    if area.sum() == 0:
        raise ValueError("no electrode lies on the film")
    return float(area[film_map.relative_thickness[under] < limit].sum() / area.sum())


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
    under = covered(film_map, electrodes)
    weight = np.where(under, film_map.undeformed_area_mm2 * film_map.relative_thickness**-exponent, 0.0)
    if weight.sum() == 0:
        raise ValueError("no electrode lies on the film")
    return np.asarray(weight / weight.sum())


def region_shares(film_map: ThicknessMap, electrodes: Sequence[Rectangle], exponent: float) -> dict[str, float]:
    """Expected share of the failures in the left, centre and right third along the rods (thesis, fig 3-13)."""
    share = hazard(film_map, electrodes, exponent)
    third = film_map.film.length_mm / 6
    x = film_map.centres_mm[:, 0]
    index = (x > -third).astype(int) + (x > third)
    return {name: float(share[index == i].sum()) for i, name in enumerate(REGIONS)}


def rod_share(
    film_map: ThicknessMap, electrodes: Sequence[Rectangle], exponent: float, within_mm: float = 1.0
) -> float:
    """Expected share of the failures no farther than `within_mm` from the edge of a rod."""
    share = hazard(film_map, electrodes, exponent)
    distance = np.abs(film_map.centres_mm[:, 1, None] - film_map.film.rod_positions_mm).min(axis=1)
    return float(share[distance <= film_map.film.rod_diameter_mm / 2 + within_mm].sum())
