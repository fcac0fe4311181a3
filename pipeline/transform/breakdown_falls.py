"""Falls of the monitored voltage: where one begins, whether and when the voltage comes back.

Belongs here: geometry of single falls on a `Trace`. What a fall means is decided in `breakdown_model`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pipeline.transform.breakdown_signal import FULL, HALF, Trace
from schemas.arrays import Bool

FAST_S = 20e-3
LASTING_S = 0.5
SHORTEST_LASTING_S = 0.1
"""A record that ends this soon after a fall does not show whether it lasts."""
_LOW = 0.8
"""A voltage that stays below this share of the highest level is no longer the voltage of the test."""


@dataclass(frozen=True)
class Fall:
    """A fall from `level` in kV below half of it, or below 80 % for half a second.

    `last` sample above 90 %, `entry` first sample below, `back` the first of two successive samples above 90 % again (None
    when that does not happen), `fast` when it took at most 20 ms from 90 % to the entry, as far as the samples can tell.
    """

    last: int
    entry: int
    back: int | None
    level: float
    fast: bool

    def lasts(self, trace: Trace) -> bool:
        """Surely below half of its level for half a second: one low sample of a slow clock does not show that."""
        if self.back is None:
            return True
        low = np.flatnonzero(trace.value[self.entry : self.back] < HALF * self.level)
        return low.size > 0 and float(np.ptp(trace.time[self.entry + low[[0, -1]]])) >= LASTING_S - 1e-6

    def deep(self, trace: Trace) -> bool:
        """Below half of its level at some time."""
        return bool(np.any(trace.value[self.entry : self.back] < HALF * self.level))

    def watched(self, trace: Trace) -> float:
        """For how long the record goes on after it, s."""
        return float(trace.time[-1] - trace.time[self.entry]) + trace.interval


def falls(trace: Trace, start: int) -> Iterator[Fall]:
    """Falls after sample `start`, in order; the next is looked for where the voltage was back."""
    highest = np.maximum.accumulate(trace.level)
    low = (trace.value < HALF * trace.level) | _lasting_runs(trace, trace.value < _LOW * highest)
    entries = np.flatnonzero(low[1:] & ~low[:-1]) + 1
    resume = start
    for entry in entries[entries > start].tolist():
        if entry < resume:
            continue
        deep = trace.value[entry] < HALF * trace.level[entry]
        fall = fall_from(trace, entry, start, float(trace.level[entry] if deep else highest[entry]))
        yield fall
        if fall.back is None:
            return
        resume = fall.back


def _lasting_runs(trace: Trace, low: Bool) -> Bool:
    """Where `low` holds for half a second without a break."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], low, [False])).astype(np.int8)))
    lasting = np.zeros(low.size, dtype=np.bool_)
    for begin, end in edges.reshape(-1, 2).tolist():
        lasting[begin:end] = trace.time[end - 1] - trace.time[begin] >= LASTING_S
    return lasting


def fall_from(trace: Trace, entry: int, start: int, level: float) -> Fall:
    """The fall from `level` kV whose first low sample is `entry`; the life began at sample `start`."""
    above = np.flatnonzero(trace.value[start:entry] >= FULL * level)
    last = start + int(above[-1]) if above.size else start
    again = np.flatnonzero(trace.value[entry:] >= FULL * level)
    twice = np.flatnonzero(np.diff(again) == 1)
    back = entry + int(again[twice[0]]) if twice.size else None
    if back is None and again.size and entry + int(again[-1]) == trace.value.size - 1:
        back = trace.value.size - 1
    return Fall(last, entry, back, level, _took(trace, last, entry, level) <= FAST_S)


def _took(trace: Trace, last: int, entry: int, level: float) -> float:
    """Time in s from 90 % to the entry, the crossings interpolated; 0 between two samples."""
    if entry == last + 1:
        return 0.0
    share = HALF if trace.value[entry] < HALF * level else _LOW
    crossings = []
    for before, of in ((last, FULL), (entry - 1, share)):
        (high, low), (t0, t1) = trace.value[before : before + 2], trace.time[before : before + 2]
        part = float(np.clip((high - of * level) / (high - low), 0.0, 1.0)) if high > low else 1.0
        crossings.append(float(t0 + part * (t1 - t0)))
    return crossings[1] - crossings[0]


def level_before(trace: Trace, last: int) -> float:
    """Voltage just before a sample, kV: median of the last tenth of a second."""
    begin = int(np.searchsorted(trace.time, trace.time[last] - SHORTEST_LASTING_S))
    return float(np.median(trace.value[min(begin, last) : last + 1]))


def dips_between(trace: Trace, start: int, last: int) -> tuple[int, str]:
    """Dips to between 50 and 80 % of the level between two samples: their number, and what to say of them."""
    share = trace.value[start : last + 1] / trace.level[start : last + 1]
    below = np.concatenate(([False], share < _LOW, [False]))
    edges = np.flatnonzero(np.diff(below.astype(np.int8))).reshape(-1, 2).tolist()
    lowest = [float(share[begin:end].min()) for begin, end in edges if begin > 0 and share[begin:end].min() >= HALF]
    if not lowest:
        return 0, ""
    seconds = float(np.count_nonzero(share < FULL)) * trace.interval
    plural = "s" if len(lowest) > 1 else ""
    return len(lowest), (
        f"{len(lowest)} dip{plural} of the voltage, down to {100 * min(lowest):.0f} % of its level; {seconds:.2g} s below 90 %"
    )
