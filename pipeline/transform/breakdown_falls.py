"""Falls of the monitored voltage: where one begins, how fast it is, whether and when the voltage comes back.

Belongs here: geometry of single falls on a `Trace`. What a fall means is decided in `breakdown`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.transform.breakdown_signal import FULL, HALF, Trace

FAST_S = 20e-3
LASTING_S = 0.5
SHORTEST_LASTING_S = 0.1
"""A record that ends this soon after a fall does not show whether it lasts."""
_MOSTLY = 0.8
_VISIBLE_DIP = 0.8


@dataclass(frozen=True)
class Fall:
    """A fall below half of `level` in kV.

    `last` sample above 90 %, `entry` first sample below 50 %, `back` the first of two successive samples above 90 %
    again (None when that does not happen), `fast` when it took at most 20 ms.
    """

    last: int
    entry: int
    back: int | None
    level: float
    fast: bool

    def lasts(self, trace: Trace) -> bool:
        """Not back above 90 % within 0.5 s."""
        return self.back is None or float(trace.time[self.back] - trace.time[self.last]) > LASTING_S


def fall_at(trace: Trace, entry: int, start: int) -> Fall:
    """The fall whose first sample below half is `entry`; the life began at sample `start`."""
    level = float(trace.level[entry])
    reach = 64
    while True:
        begin = max(start, entry - reach)
        above = np.flatnonzero(trace.value[begin:entry] >= FULL * level)
        if above.size or begin == start:
            last = begin + int(above[-1]) if above.size else start
            return Fall(last, entry, back_above(trace, entry, FULL * level), level, is_fast(trace, last, entry, level))
        reach *= 8


def is_fast(trace: Trace, last: int, entry: int, level: float) -> bool:
    """From 90 % to 50 % of the level within 20 ms, the crossings interpolated; always true between two samples."""
    if entry == last + 1:
        return True
    crossings = []
    for before, share in ((last, FULL), (entry - 1, HALF)):
        (high, low), (t0, t1) = trace.value[before : before + 2], trace.time[before : before + 2]
        part = float(np.clip((high - share * level) / (high - low), 0.0, 1.0)) if high > low else 1.0
        crossings.append(float(t0 + part * (t1 - t0)))
    return crossings[1] - crossings[0] <= FAST_S


def back_above(trace: Trace, entry: int, up: float) -> int | None:
    """First of two successive samples above `up` kV after `entry`; a single last sample counts. None without."""
    reach = 256
    while True:
        stop = min(entry + reach, trace.value.size)
        above = trace.value[entry:stop] >= up
        twice = np.flatnonzero(above[:-1] & above[1:])
        if twice.size:
            return entry + int(twice[0])
        if stop == trace.value.size:
            return stop - 1 if above.size and above[-1] else None
        reach *= 8


def window_end(trace: Trace, fall: Fall, seconds: float) -> int:
    """Sample after the last one within `seconds` of the fall."""
    return int(np.searchsorted(trace.time, trace.time[fall.entry] + seconds, side="right"))


def stays_down(trace: Trace, fall: Fall) -> tuple[bool, float]:
    """Whether the voltage stays below half for 0.5 s, and for how long in s (at most 0.5) it could be watched.

    A few spikes of a supply that tries again do not count as back: four fifths of the samples must be down.
    """
    below = trace.value[fall.entry : window_end(trace, fall, LASTING_S)] < HALF * fall.level
    watched = float(trace.time[-1] - trace.time[fall.entry]) + trace.interval
    return bool(below.mean() >= _MOSTLY), min(watched, LASTING_S)


def level_before(trace: Trace, last: int) -> float:
    """Voltage just before a sample, kV: median of the last tenth of a second."""
    begin = int(np.searchsorted(trace.time, trace.time[last] - SHORTEST_LASTING_S))
    return float(np.median(trace.value[min(begin, last) : last + 1]))


@dataclass(frozen=True)
class Dips:
    """Dips to between 50 and 80 % of the level: their `number`, `lowest` share of it, `seconds` spent below 90 %."""

    number: int
    lowest: float
    seconds: float


def shallow_dips(trace: Trace, start: int, last: int) -> Dips | None:
    """Dips that stay above half the level between two samples; None when there are none."""
    share = trace.value[start : last + 1] / trace.level[start : last + 1]
    shallow, up = (share < _VISIBLE_DIP) & (share >= HALF), share >= _VISIBLE_DIP
    begins = np.flatnonzero(shallow[1:] & up[:-1])
    if not begins.size:
        return None
    ends = np.searchsorted(np.flatnonzero(up), begins + 1)
    tops = np.append(np.flatnonzero(up), share.size)[ends]
    stays = [b for b, e in zip(begins.tolist(), tops.tolist(), strict=True) if share[b + 1 : e].min() >= HALF]
    if not stays:
        return None
    return Dips(
        len(set(stays)),
        float(share[shallow].min()),
        float(np.count_nonzero(share < FULL)) * trace.interval,
    )
