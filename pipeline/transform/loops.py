"""Load-unload cycles of a film: where each begins and ends, and what it takes: work, loss, forces, secant stiffness.

A cycle goes from one lowest displacement over the highest to the next lowest one; the first and the last may begin and end at
rest. What does not come back to where it began is none. Does not belong here: models of a cycle (`pipeline.fit.relaxation`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import find_peaks

from schemas.arrays import Float, Int
from schemas.errors import NotIdentifiableError

TURNS = 0.1
"""Share of the whole range by which a displacement goes back at a turning point; less is noise or a pause."""
CLOSES = 0.05
"""Share of a cycle's range by which its ends may differ: turning points are reached to a few parts in a thousand."""
STILL = 0.02
"""Share of the whole range that counts as not having left the rest before the first cycle."""
FEWEST = 8
"""Samples of a cycle: of fewer the area is that of a polygon inside of the loop, more than 5 % too small."""
ELONGATIONS = 1.02, 1.1
"""Stretches between which the modulus of the start is taken: below lies what is still slack, beyond bends an elastomer."""
AROUND = 40
"""Share of a cycle's samples, one in so many, on each side of its ends over which the answer's drift is a mean: of single samples
their noise would be 2 % of the loss of an acrylic film at 1.6 mN."""


@dataclass(frozen=True)
class Loop:
    """One cycle, x the driven length and y the answer, in the units given.

    Parameters
    ----------
    first, last : numbers of its first and last sample among those given
    low, high : lowest and highest x
    least, most : lowest and highest y
    loss : ∮ y dx, closed by the straight line from end to beginning
    steady_loss : the same after y has lost its drift from beginning to end, linear in time: what a cycle takes once the film no
        longer relaxes from one to the next. None where the cycle begins or ends at rest
    unclosed : cycles before it that end elsewhere than they began, such as a first one from the unloaded film to the lower turning point
    work : ∫ y dx from the lowest to the highest x
    top : number of the sample at the highest x
    """

    first: int
    last: int
    low: float
    high: float
    least: float
    most: float
    loss: float
    steady_loss: float | None
    work: float
    top: int
    unclosed: int = 0

    @property
    def loss_share(self) -> float | None:
        """Loss over the work of loading; None where loading took none."""
        return self.loss / self.work if self.work > 0 else None

    @property
    def secant(self) -> float | None:
        """Range of y over range of x; None where x stands still."""
        return (self.most - self.least) / (self.high - self.low) if self.high > self.low else None


def find_loops(time: Float, x: Float, y: Float) -> list[Loop]:
    """The cycles of (n,) finite samples in the order of time. Raises `NotIdentifiableError` where there is none."""
    time, x, y = (np.asarray(values, dtype=float) for values in (time, x, y))
    span = float(np.ptp(x)) if x.size else 0.0
    found = [] if span <= 0 else _cycles(time, x, y, span)
    if not found:
        raise NotIdentifiableError(
            "the displacement does not go up and come back", where="cycle", expected="a load-unload cycle"
        )
    return found


def _cycles(time: Float, x: Float, y: Float, span: float) -> list[Loop]:
    highs, turns = _find_turns(x, span)
    ends = np.unique(np.concatenate([[_leaves(x, span)], turns, [x.size - 1 - _leaves(x[::-1], span)]]))
    turning = set(turns.tolist())
    found: list[Loop] = []
    unclosed = 0
    for begin, end in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        between = highs[(highs > begin) & (highs < end)]
        if between.size != 1 or end - begin < FEWEST:
            continue
        top = int(between[0])
        if abs(x[end] - x[begin]) <= CLOSES * (x[top] - min(x[begin], x[end])):
            drift = _drift(y, begin, end) if {begin, end} <= turning else None
            found.append(replace(_loop(time, x, y, (begin, top, end), drift), unclosed=unclosed))
        else:
            unclosed += 1
    return found


def _find_turns(x: Float, span: float) -> tuple[Int, Int]:
    """Samples at which x is highest and lowest, one of each turn.

    A turn that a converter reaches in several equal steps has as many peaks, each as prominent as the turn.
    """
    places = [find_peaks(sign * x, prominence=TURNS * span)[0] for sign in (1.0, -1.0)]
    at = np.concatenate(places)
    is_high = np.repeat([True, False], [p.size for p in places])
    order = np.argsort(at)
    at, is_high = at[order], is_high[order]
    runs = np.split(np.arange(at.size), np.flatnonzero(np.diff(is_high)) + 1)
    chosen = [run[np.argmax(x[at[run]] if is_high[run[0]] else -x[at[run]])] for run in runs if run.size]
    return at[[i for i in chosen if is_high[i]]], at[[i for i in chosen if not is_high[i]]]


def _leaves(x: Float, span: float) -> int:
    """The last lowest sample of the rest that a record begins with."""
    away: Int = np.flatnonzero(np.abs(x - x[0]) > STILL * span)
    rest = x[: int(away[0])] if away.size else x
    return int(np.flatnonzero(rest == rest.min())[-1])


def _drift(y: Float, begin: int, end: int) -> float:
    """How much y has changed from one end of a cycle to the other: of means over the same samples around both."""
    around = (end - begin) // AROUND
    before, behind = min(around, begin), min(around, y.size - 1 - end)
    at_begin, at_end = (y[i - before : i + behind + 1] for i in (begin, end))
    return float(at_end.mean() - at_begin.mean())


def _loop(time: Float, x: Float, y: Float, turns: tuple[int, int, int], drift: float | None) -> Loop:
    begin, top, end = turns
    own_x, own_y = x[begin : end + 1], y[begin : end + 1]
    passed = (time[begin : end + 1] - time[begin]) / (time[end] - time[begin])
    up = slice(0, top - begin + 1)
    return Loop(
        first=begin,
        last=end,
        low=float(own_x.min()),
        high=float(own_x.max()),
        least=float(own_y.min()),
        most=float(own_y.max()),
        loss=_area(own_x, own_y),
        steady_loss=None if drift is None else _area(own_x, own_y - drift * passed),
        work=float(np.trapezoid(own_y[up], own_x[up])),
        top=top,
    )


def retell(time: Float, x: Float, y: Float, loop: Loop) -> Loop:
    """A cycle that was found among (n,) samples, in other quantities of the same samples."""
    drift = None if loop.steady_loss is None else _drift(y, loop.first, loop.last)
    return replace(_loop(time, x, y, (loop.first, loop.top, loop.last), drift), unclosed=loop.unclosed)


def measure_modulus(stretch: Float, stress: Float, loop: Loop) -> float | None:
    """Slope of the straight line through the loading of a cycle from 2 to 10 % elongation, in the unit of the stress.

    Parameters
    ----------
    stretch, stress : (n,) samples among which the cycle was found

    Returns
    -------
    None where the loading has not `FEWEST` samples there, such as that of a film under pre-stretch
    """
    lam, p = (values[loop.first : loop.top + 1] for values in (stretch, stress))
    inside = (lam >= ELONGATIONS[0]) & (lam <= ELONGATIONS[1])
    if inside.sum() < FEWEST or lam[0] > ELONGATIONS[0]:
        return None
    return float(np.polyfit(lam[inside], p[inside], 1)[0])


def _area(x: Float, y: Float) -> float:
    return float(np.trapezoid(np.append(y, y[0]), np.append(x, x[0])))
