"""Electrodes for a film over rods: which of them lives longest at the same force, by the film's own law of life.

Force goes with V² Σ A/h over the film under the electrodes between the rods (what lies on a rod is held and gives
none), hazard with V^p Σ A₀ h^−p (`film_life`). At equal force the voltage is free, so that only both sums count. Among
electrodes of any shape the best covers all film thicker than a limit: hazard over force of a place falls with its
thickness. What a stencil gives of that is its outline between the rods, in slices; rectangles are tried one by one
beside it.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import LinearNDInterpolator

from pipeline.fit.survival.film_life import FilmLifeFit
from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.physics.thickness.film import RodFilm, ThicknessMap
from pipeline.physics.thickness.layout import Rectangle, covered_share
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

NEAREST_MM, STEP_MM = 0.5, 0.25
"""Least distance of an electrode from the axis of a rod, and the steps in which distances are tried."""
_LEAST_SHARE = 0.3
"""Of the film's length and of the space between rods, that an electrode keeps: smaller ones need too high a voltage."""
_BINS = 0.01
"""Relative width of the classes of thickness."""
_LEVEL = (0.05, 0.95)
RECTANGLES, SHAPED, ANY_SHAPE = "rectangles", "shaped", "any shape"
_SLICE_MM, _FINE_MM, _NARROWEST_MM = 0.5, 0.05, 1.0
"""Width of the slices of a shaped electrode, steps in which their ends are found, and the narrowest that is kept."""


@dataclass(frozen=True)
class ElectrodeDesign:
    """Electrodes against those that a film has now, at equal force.

    Parameters
    ----------
    design : rectangles; shaped: outlines made of slices; any shape: the bound that no electrodes better
    electrodes : rectangles that make them up; none for any shape
    gap_mm, inset_mm : distance from the rods' axes, and from the film's ends along the rods; None unless rectangles
    covered_share : of the film
    relative_force : at equal voltage, over that of the electrodes now
    voltage_ratio : at equal force
    life_ratio : median life at equal force over that now, with 90 % limits of the law
    thinnest : smallest thickness over the film's median, under the electrodes
    """

    design: str
    electrodes: tuple[Rectangle, ...]
    gap_mm: float | None
    inset_mm: float | None
    covered_share: float
    relative_force: float
    voltage_ratio: float
    life_ratio: Estimate
    thinnest: float


@dataclass(frozen=True)
class _Classes:
    """A film in m classes of thickness: ln of that (m,), and which class each of its n elements is in."""

    log_thickness: Float
    member: np.ndarray[tuple[int, ...], np.dtype[np.int64]]
    force: Float
    """(n,) A/h, 0 on a rod."""
    area: Float
    """(n,) undeformed."""

    @classmethod
    def of(cls, film_map: ThicknessMap) -> _Classes:
        log = np.log(film_map.thickness)
        _, member = np.unique(np.round(log / _BINS), return_inverse=True)
        total = np.bincount(member, weights=film_map.undeformed_area_mm2)
        mean = np.bincount(member, weights=film_map.undeformed_area_mm2 * log) / total
        y = film_map.centres_mm[:, 1]
        rods = film_map.film.rod_positions_mm
        held = np.min(np.abs(y[:, None] - rods), axis=1) < film_map.film.rod_diameter_mm / 2
        force = np.where(held, 0.0, film_map.area_mm2 / film_map.thickness)
        return cls(mean, np.asarray(member, dtype=np.int64), force, film_map.undeformed_area_mm2)

    def sums(self, share: Float) -> tuple[float, Float]:
        """Σ A/h, and A₀ by class, of the film under electrodes that cover shares (n,) of its elements."""
        area = np.bincount(self.member, weights=self.area * share, minlength=self.log_thickness.size)
        return float(self.force @ share), np.asarray(area, dtype=np.float64)


def place_rectangles(film: RodFilm, gap_mm: float, inset_mm: float) -> tuple[Rectangle, ...]:
    """Electrodes between the rods that keep away from the rods' axes and from the film's ends along them.

    Parameters
    ----------
    film : the film
    gap_mm, inset_mm : both distances
    """
    half = film.length_mm / 2 - inset_mm
    return tuple(
        Rectangle(-half, half, low + gap_mm, high - gap_mm)
        for low, high in itertools.pairwise(film.rod_positions_mm)
        if half > 0 and high - low > 2 * gap_mm
    )


def place_slices(film_map: ThicknessMap, least: float) -> tuple[Rectangle, ...]:
    """Slices across the rods that follow the outline of film that is thick enough, around the middle of each bay.

    Parameters
    ----------
    film_map : thickness of the film
    least : smallest thickness over undeformed thickness
    """
    film = film_map.film
    thickness = LinearNDInterpolator(film_map.centres_mm, film_map.thickness)
    places = np.arange(-film.length_mm / 2, film.length_mm / 2 - _SLICE_MM / 2, _SLICE_MM) + _SLICE_MM / 2
    found = []
    for low, high in itertools.pairwise(film.rod_positions_mm):
        y = np.arange(low, high, _FINE_MM) + _FINE_MM / 2
        for x in places.tolist():
            thick = np.nan_to_num(thickness(np.full(y.size, x), y)) >= least
            middle = int(np.argmin(np.abs(y - (low + high) / 2)))
            if not thick[middle]:
                continue
            below, above = np.flatnonzero(~thick[:middle]), np.flatnonzero(~thick[middle:])
            start = y[below[-1] + 1] if below.size else y[0]
            end = y[middle + above[0] - 1] if above.size else y[-1]
            if end - start >= _NARROWEST_MM:
                found.append(Rectangle(x - _SLICE_MM / 2, x + _SLICE_MM / 2, float(start), float(end)))
    return tuple(found)


def design_electrodes(film_map: ThicknessMap, now: Sequence[Rectangle], law: FilmLifeFit) -> list[ElectrodeDesign]:
    """The best rectangles between the rods, shaped electrodes and the bound by any shape, against those that there are.

    Parameters
    ----------
    film_map : thickness of the film
    now : its electrodes
    law : of the film's life

    Returns
    -------
    All three, in that order. Best is the largest mean of ln life over what the law leaves possible

    Raises
    ------
    NotIdentifiableError
        The film has no two rods with room for an electrode between them.
    """
    classes, drawn, film = _Classes.of(film_map), law.draw(), film_map.film
    own = classes.sums(covered_share(film_map, now))
    gaps = np.arange(NEAREST_MM, film.rod_spacing_mm / 2 * (1 - _LEAST_SHARE) + 1e-9, STEP_MM)
    insets = np.arange(0.0, film.length_mm / 2 * (1 - _LEAST_SHARE) + 1e-9, 2 * STEP_MM)
    best: tuple[float, float, float, Float] | None = None
    for gap, inset in itertools.product(gaps.tolist(), insets.tolist()):
        rectangles = place_rectangles(film, gap, inset)
        if not rectangles:
            continue
        gained = _gain(classes, classes.sums(covered_share(film_map, rectangles)), own, drawn)
        if best is None or gained.mean() > best[0]:
            best = float(gained.mean()), gap, inset, gained
    if best is None:
        raise NotIdentifiableError(
            f"{film.rods} rods leave no room for electrodes",
            expected="two rods or more, and more than 1 mm between them",
        )
    _, gap, inset, gained = best
    rectangles = place_rectangles(film, gap, inset)
    found = [_describe(film_map, classes, RECTANGLES, rectangles, gap, inset, own, gained)]
    share, limit, free = _free_shape(classes, own, drawn)
    shaped = place_slices(film_map, float(np.exp(limit)))
    if shaped:
        gained = _gain(classes, classes.sums(covered_share(film_map, shaped)), own, drawn)
        found.append(_describe(film_map, classes, SHAPED, shaped, None, None, own, gained))
    return [*found, _describe(film_map, classes, ANY_SHAPE, (), None, None, own, free, share)]


def _gain(classes: _Classes, new: tuple[float, Float], own: tuple[float, Float], drawn: Float) -> Float:
    """(draws,) ln of life over that now, at equal force."""
    p, beta = np.exp(drawn[:, 1]), np.exp(drawn[:, 2])
    exposures = []
    for _, area in (new, own):
        there = area > 0
        terms = np.log(area[there]) - p[:, None] * classes.log_thickness[there]
        largest = terms.max(axis=1, keepdims=True)
        exposures.append(np.log(np.exp(terms - largest).sum(axis=1)) + largest[:, 0])
    louder = p * np.log(own[0] / new[0]) / 2
    return np.asarray(-(louder + exposures[0] - exposures[1]) / beta)


def _free_shape(classes: _Classes, own: tuple[float, Float], drawn: Float) -> tuple[Float, float, Float]:
    """(n,) elements that the best electrodes of any shape cover, ln of the least thickness, and the gain (draws,)."""
    best: tuple[Float, float, Float] | None = None
    for limit in np.unique(classes.log_thickness):
        share = (classes.log_thickness[classes.member] >= limit).astype(float)
        new = classes.sums(share)
        if not new[0]:
            break
        gained = _gain(classes, new, own, drawn)
        if best is None or gained.mean() > best[2].mean():
            best = share, float(limit), gained
    assert best is not None
    return best


def _describe(
    film_map: ThicknessMap,
    classes: _Classes,
    design: str,
    electrodes: tuple[Rectangle, ...],
    gap_mm: float | None,
    inset_mm: float | None,
    own: tuple[float, Float],
    gained: Float,
    share: Float | None = None,
) -> ElectrodeDesign:
    share = covered_share(film_map, electrodes) if share is None else share
    force = classes.sums(share)[0] / own[0]
    low, high = (float(np.exp(q)) for q in np.quantile(gained, _LEVEL))
    return ElectrodeDesign(
        design,
        electrodes,
        gap_mm,
        inset_mm,
        float(film_map.area_mm2 @ share / film_map.area_mm2.sum()),
        force,
        force**-0.5,
        Estimate(float(np.exp(gained.mean())), low, high),
        float(film_map.relative_thickness[share > 0.5].min()),
    )
