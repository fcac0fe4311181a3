"""Where a rod film is expected to fail and where it did: thickness map × power law against failure sites."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from pipeline.physics.thickness.film import RodFilm, ThicknessMap
from pipeline.physics.thickness.layout import (
    REGIONS,
    Rectangle,
    covered,
    region_shares,
    rod_share,
    separate_regions,
    single_region,
    thin_share,
)
from schemas.arrays import Bool, Float, Int

EXPONENTS = (8.0, 10.0, 15.0)
"""Least, middle and largest plausible exponent of the inverse power law of breakdown for soft films."""
THIN = 0.9
"""Film thinner than this share of the median thickness counts as thin."""


@dataclass(frozen=True)
class RegionShare:
    """One third of the film along the rods: expected share with its range over `EXPONENTS`, and what was found.

    `unknown_site` of its `failures` have a site that nobody noted.
    """

    region: str
    predicted: float
    predicted_range: tuple[float, float]
    failures: int
    observed: float | None
    observed_interval: tuple[float, float] | None
    unknown_site: int = 0


@dataclass(frozen=True)
class LayoutCheck:
    """What electrodes on a film meet. Fields in MV/m; shares of area and of failures."""

    scheme: str
    thin_share: float
    thinnest: float
    predicted_rod_share: float
    observed_rod_share: float | None
    peak_field_mv_per_m: float | None


@dataclass(frozen=True)
class FilmGrid:
    """A thickness map on a regular grid, for figures. All arrays (rows × columns,)."""

    scheme: str
    x_mm: Float
    y_mm: Float
    thickness: Float
    relative_thickness: Float
    active: Bool


def electrodes(film: RodFilm, gap_mm: float | None) -> tuple[Rectangle, ...]:
    """A single electrode over the film, or with a gap given separate ones that keep away from the rods."""
    return single_region(film) if gap_mm is None else separate_regions(film, gap_mm)


def compare_regions(
    film_map: ThicknessMap, layout: Sequence[Rectangle], failures: Iterable[tuple[str | None, str | None]]
) -> tuple[RegionShare, ...]:
    """Expected against found failures in the left, centre and right third (thesis, fig 3-13).

    Parameters
    ----------
    film_map, layout : thickness of the film, and the electrodes on it
    failures : region and site of each failure in the film, None for what was not noted

    Notes
    -----
    Intervals are exact binomial, 95 %.
    """
    low, middle, high = (region_shares(film_map, layout, exponent) for exponent in EXPONENTS)
    found = [(region, site) for region, site in failures if region in REGIONS]
    counts = Counter(region for region, _ in found)
    unknown = Counter(region for region, site in found if site in (None, "unknown"))
    total = sum(counts.values())
    shares = []
    for region in REGIONS:
        interval = None
        if total:
            from scipy.stats import binomtest  # half a second, for labs that note where films failed

            exact = binomtest(counts[region], total).proportion_ci(0.95, method="exact")
            interval = (float(exact.low), float(exact.high))
        values = (low[region], middle[region], high[region])
        shares.append(
            RegionShare(
                region,
                values[1],
                (min(values), max(values)),
                counts[region],
                counts[region] / total if total else None,
                interval,
                unknown[region],
            )
        )
    return tuple(shares)


def check_layout(
    film_map: ThicknessMap,
    layout: Sequence[Rectangle],
    failure_sites: Iterable[str | None],
    *,
    voltage_kv: float | None = None,
    thickness_mm: float | None = None,
) -> LayoutCheck:
    """Thin film under the electrodes, and failures at the rods expected and found.

    `failure_sites` has one entry per failure in the film. The field at the thinnest place needs voltage and undeformed thickness.
    """
    under = covered(film_map, layout)
    sites = [site for site in failure_sites if site not in (None, "unknown", "none")]
    field = None
    if voltage_kv is not None and thickness_mm is not None:
        field = float(voltage_kv / (thickness_mm * film_map.thickness[under].min()))
    return LayoutCheck(
        film_map.scheme,
        thin_share(film_map, layout, THIN),
        float(film_map.relative_thickness[under].min()),
        rod_share(film_map, layout, EXPONENTS[1]),
        sites.count("rod") / len(sites) if sites else None,
        field,
    )


def on_grid(film_map: ThicknessMap, layout: Sequence[Rectangle], *, points: int = 61) -> FilmGrid:
    """The map at points × points places of the finished film; NaN outside of it (the ends run back between rods)."""
    film = film_map.film
    x, y = np.meshgrid(
        np.linspace(-film.length_mm / 2, film.length_mm / 2, points),
        np.linspace(-film.width_mm / 2, film.width_mm / 2, points),
    )
    at = np.stack([x.ravel(), y.ravel()], axis=1)
    element = _element_at(film_map, at)
    values = np.stack([film_map.thickness, film_map.relative_thickness], axis=1)
    table = np.where(element[:, None] >= 0, values[element], np.nan)
    active = np.zeros(len(at), bool)
    for r in layout:
        active |= (at[:, 0] >= r.x_low) & (at[:, 0] <= r.x_high) & (at[:, 1] >= r.y_low) & (at[:, 1] <= r.y_high)
    return FilmGrid(film_map.scheme, at[:, 0], at[:, 1], table[:, 0], table[:, 1], active & np.isfinite(table[:, 0]))


def _element_at(film_map: ThicknessMap, points: Float) -> Int:
    """(m,) element that each point (m, 2) lies in, −1 outside of the film."""
    near = cKDTree(film_map.centres_mm).query(points, k=min(12, len(film_map.thickness)))[1]
    corners = film_map.corners_mm[near]  # (m, k, 4, 2)
    edge = np.roll(corners, -1, axis=2) - corners
    away = points[:, None, None, :] - corners
    side = edge[..., 0] * away[..., 1] - edge[..., 1] * away[..., 0]
    inside = (side >= -1e-12).all(axis=2) | (side <= 1e-12).all(axis=2)
    return np.where(inside.any(axis=1), near[np.arange(len(points)), inside.argmax(axis=1)], -1)
