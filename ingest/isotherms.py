"""The temperatures at which a table was measured: groups of rows that stand at one each, and rows that belong to none.

A guess for drafts alone. A chamber overshoots, a machine records while it heats, and a temperature may come back at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ingest.select import split_runs
from schemas.arrays import Bool, Float

_TOLERANCES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
_FEWEST_DEGREES = 2.0
"""Range of temperatures below which a table holds one sweep."""
_FEWEST_POINTS = 3
"""Different frequencies (or times) of an isotherm."""
_SMALL = 0.3
"""Share of the rows of the largest isotherm below which rows near each other are none."""
_MOST = 0.85
"""Share of the most points that any tolerance puts at isotherms from which a narrow one will do: a chamber that overshoots spoils the
first one or two of a decade's five."""
_NEARLY_ALL = 0.97
"""Share of the points from which of two tolerances that will do the narrower one is taken."""
_NARROW = 0.5
"""Tolerance that needs no narrower one: half a kelvin moves log10 a_T by 0.05 at most."""


@dataclass(frozen=True)
class Isotherms:
    """Temperatures with the rows within `tolerance` of each; `loose` rows are at none of them."""

    values: tuple[float, ...]
    tolerance: float
    loose: int
    loose_from: float = np.nan
    loose_to: float = np.nan


def find_isotherms(temperature: Float, points: Float) -> Isotherms | None:
    """The isotherms of (n,) temperatures in °C, each with several of the (n,) frequencies or times; None where there are not two."""
    usable = np.isfinite(temperature) & np.isfinite(points)
    warm, at = temperature[usable], points[usable]
    if warm.size < 2 or np.ptp(warm) < _FEWEST_DEGREES:
        return None
    clean = _split_at_gaps(warm, at)
    if clean is not None and clean.tolerance <= _NARROW:
        return clean
    found = [one for tolerance in _TOLERANCES if (one := _cluster(warm, at, tolerance)) is not None]
    found += [] if clean is None else [clean]
    counted = [(_count_points(warm, at, one), one) for one in found]
    most = max((count for count, _ in counted), default=0)
    narrow = [(count, one) for count, one in counted if one.tolerance <= _NARROW]
    chosen = narrow if max((count for count, _ in narrow), default=0) >= _MOST * most else counted
    enough = _NEARLY_ALL * max((count for count, _ in chosen), default=0)
    return next((one for count, one in chosen if count >= enough), None)


def _count_points(warm: Float, at: Float, isotherms: Isotherms) -> int:
    """Different frequencies (or times) of all isotherms together."""
    return sum(np.unique(at[_near(warm, value, isotherms.tolerance)]).size for value in isotherms.values)


def has_returns(temperature: Float, isotherms: Isotherms) -> bool:
    """Whether a temperature comes back after others."""
    return any(len(split_runs(_near(temperature, value, isotherms.tolerance))) > 1 for value in isotherms.values)


def has_repeats(temperature: Float | None, points: Float, isotherms: Isotherms | None) -> bool:
    """Whether a frequency (or time) stands in several rows of one run of an isotherm, of the whole table where there are none."""
    if isotherms is None or temperature is None:
        groups: Sequence[Float] = [points[np.isfinite(points)]]
    else:
        near = [_near(temperature, value, isotherms.tolerance) for value in isotherms.values]
        groups = [points[run] for here in near for run in split_runs(here)]
    return any(np.unique(group).size < group.size for group in groups)


def _near(temperature: Float, value: float, tolerance: float) -> Bool:
    return np.asarray(np.abs(temperature - value) <= tolerance * (1 + 1e-9))


def _split_at_gaps(warm: Float, at: Float) -> Isotherms | None:
    """Groups between wide gaps, where every row belongs to one."""
    values = np.sort(warm)
    gaps = np.diff(values)
    wide = gaps[gaps > max(1.0, 5 * float(np.median(gaps)))]
    if not wide.size:
        return None
    groups = np.split(values, np.flatnonzero(np.isin(gaps, wide)) + 1)
    within = max(float(np.ptp(group)) for group in groups)
    tolerance = next((t for t in _TOLERANCES if t >= within), None)
    if tolerance is None or 2 * tolerance >= float(wide.min()):
        return None
    several = [_has_several(warm, at, group[0], group[-1]) for group in groups]
    if any(several) and not all(several):
        return None  # rows between isotherms that happen to stand alone
    return Isotherms(tuple(float(np.median(group)) for group in groups), tolerance, 0)


def _has_several(warm: Float, at: Float, low: float, high: float) -> bool:
    return np.unique(at[(warm >= low) & (warm <= high)]).size >= _FEWEST_POINTS


def _cluster(warm: Float, at: Float, tolerance: float) -> Isotherms | None:
    """The most crowded windows of twice the tolerance, one after the other, each with several points."""
    left = np.sort(warm)
    centres: list[float] = []
    most = 0
    while left.size:
        count = np.searchsorted(left, left + 2 * tolerance, side="right") - np.arange(left.size)
        start = int(np.argmax(count))
        most = max(most, int(count[start]))
        if count[start] < max(_FEWEST_POINTS, _SMALL * most):
            break
        centre = float(np.median(left[start : start + count[start]]))
        left = left[np.abs(left - centre) > 2 * tolerance]
        centres.append(_round(centre, tolerance))
    centres = sorted(c for c in centres if _has_several(warm, at, c - tolerance, c + tolerance))
    if len(centres) < 2 or min(np.diff(centres)) < 4 * tolerance:
        return None
    distance = np.min(np.abs(warm[:, None] - np.array(centres)), axis=1)
    loose = warm[distance > tolerance * (1 + 1e-9)]
    if not loose.size:
        return Isotherms(tuple(centres), tolerance, 0)
    return Isotherms(tuple(centres), tolerance, int(loose.size), float(loose.min()), float(loose.max()))


def _round(value: float, tolerance: float) -> float:
    """A value as it is meant: to whole degrees where that is within a third of the tolerance, to a tenth of it else."""
    whole = round(value)
    return float(whole) if abs(value - whole) <= tolerance / 2 else float(f"{value:.4g}")
