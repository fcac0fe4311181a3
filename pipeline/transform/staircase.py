"""Further steps of an input after its first one: ramps to levels that are held, up and down in any order.

Each is a straight line, so that the response of a film that relaxes is the sum of exact responses to ramps. Does not belong here:
the first step, which may begin with the record (`relaxation`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np

from pipeline.transform.holds import Hold, find_holds
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

_HELD = 0.2
"""Least share of a record over which a staircase is held: slow machines move for most of the time."""
_LEVEL = 0.02
"""Share of a record that each level lasts."""
_LASTS = 0.5
"""A level is held for at least so many times the duration of the ramp to it: a sinusoid stays at its turning points for 0.34."""
_STRAIGHT = 0.08
"""Share of its height by which a ramp may miss a straight line: the ends of a half cosine do by 0.05, a sinusoid that is cut off by more."""
_CLEARLY = 6.0
"""Standard deviations of its noise from which an input has clearly moved."""
_FEWEST, _UNEVEN, _EVEN = 32, 1.5, 4000
"""Samples of a staircase, largest over usual interval of an uneven clock, and instants at which such a record is looked at."""


@final
@dataclass(frozen=True)
class LaterRamp:
    """A ramp after the first one.

    Parameters
    ----------
    start_s : s since the start of the first ramp
    ramp_s : its duration; a straight line
    step : its height in the unit of the input, negative where it goes down
    """

    start_s: float
    ramp_s: float
    step: float

    @property
    def end_s(self) -> float:
        return self.start_s + self.ramp_s


def find_levels(time: Float, x: Float) -> tuple[Hold, ...]:
    """The levels at which an input is held, none where it is no staircase.

    Many machines take fewer samples while they hold: levels are found in time, not in samples.
    """
    if time.size < _FEWEST:
        return ()
    interval = np.diff(time)
    if float(interval.max()) > _UNEVEN * float(np.median(interval)):
        even = np.linspace(time[0], time[-1], int(np.clip(time.size, _EVEN, 5 * _EVEN)))
        time, x = even, np.interp(even, time, x)
    try:
        found = find_holds(time, x, least_held=_HELD)
    except NotIdentifiableError:
        return ()
    # A few samples of a ramp may look like a level by chance.
    return tuple(hold for hold in found if hold.end_s - hold.start_s > _LEVEL * (time[-1] - time[0]))


def find_later_ramps(
    time: Float, x: Float, levels: tuple[Hold, ...], first: tuple[float, float, float], noise: float
) -> tuple[LaterRamp, ...]:
    """The ramps after the first one, up to the first movement that is no straight ramp to a level that is held.

    Parameters
    ----------
    time, x : (n,) s, and the input
    levels : what `find_levels` finds
    first : start of the first ramp, its end, and the level that it leads to
    noise : standard deviation of one sample of the input
    """
    start_s, end_s, level = first
    held = [hold for hold in levels if hold.end_s > end_s]
    reach = max((abs(hold.level - level) for hold in held), default=0.0)
    if not held or abs(held[0].level - level) > max(_STRAIGHT * reach, _CLEARLY * noise):
        return ()
    found: list[LaterRamp] = []
    for before, after in pairwise(held):
        ramp = _ramp_between(time, x, before, after, noise)
        if ramp is None or after.end_s - ramp[1] < _LASTS * (ramp[1] - ramp[0]):
            break
        start, end, height = ramp
        found.append(LaterRamp(start - start_s, end - start, height))
    return tuple(found)


def _ramp_between(time: Float, x: Float, before: Hold, after: Hold, noise: float) -> tuple[float, float, float] | None:
    """Start, end and height of the line through the 10 and 90 % crossings; None where the input does something else."""
    low, high = np.searchsorted(time, [(before.start_s + before.end_s) / 2, (after.start_s + after.end_s) / 2])
    old, new = _level(time, x, before), _level(time, x, after)
    t = time[low:high]
    if old == new or t.size < 2:
        return None
    progress = (x[low:high] - old) / (new - old)
    # Ascending, as interpolation needs it.
    t10, t90 = np.interp([0.1, 0.9], np.maximum.accumulate(progress), t)
    duration = float(t90 - t10) / 0.8
    start = float(t10) - 0.1 * duration
    missed = np.abs(progress - np.clip((t - start) / max(duration, 1e-12), 0, 1))
    # A ramp faster than the clock has no samples of its own.
    inside = (t > start) & (t < start + duration)
    allowed = max(_STRAIGHT, _CLEARLY * noise / abs(new - old))
    if inside.any() and float(missed[inside].max()) > allowed:
        return None
    return start, start + duration, new - old


def _level(time: Float, x: Float, hold: Hold) -> float:
    """Median of the second half of a hold: its beginning may be the end of the ramp."""
    inside = (time >= (hold.start_s + hold.end_s) / 2) & (time <= hold.end_s)
    later = x[inside]
    return float(np.median(later)) if later.size else hold.level
