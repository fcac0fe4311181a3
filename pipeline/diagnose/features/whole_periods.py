"""A multisine whose period is no whole number of the recorder's samples: which of the two clocks that is due to, and what brings it to one."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from pipeline.diagnose.features.observed import read_period
from pipeline.transform.sampling import read_at
from pipeline.transform.spectrum import delay_between
from schemas.arrays import Float
from schemas.recording import Channel

_WHOLE = 0.02
"""Samples by which a period may miss a whole number."""
_OTHER_PERIOD = 0.005
"""Share by which a period that is seen is another than that stated."""
_FEWEST = 3
"""Periods in which a signal must repeat for their length to be read to a part of a sample."""


def is_whole(samples: float) -> bool:
    """Whether a number of samples is a whole one."""
    return abs(samples - round(samples)) <= _WHOLE


def make_whole(
    channels: Mapping[str, Channel], given: str, stated_s: float | None
) -> tuple[dict[str, Channel], float | None]:
    """Channels in which a period of the input `given` has a whole number of samples, and that period, s.

    The input that repeats after a whole number of samples although the period stated has none has a clock that claims another time: its
    period is as many of its samples. Where it repeats in between, the recorder and the generator have clocks of their own: all channels are
    read at instants of which a period has a whole number. `stated_s`: None where none is stated; it is then left open.
    """
    channels = dict(channels)
    if stated_s is None:
        return channels, None
    time = channels[given].time_ns
    interval_s = float(time[-1] - time[0]) / max(time.size - 1, 1) * 1e-9
    samples = stated_s / interval_s
    if is_whole(samples):
        return channels, stated_s
    seen = read_period(channels[given].values)
    if seen is None:
        return channels, stated_s
    if abs(seen / samples - 1) >= _OTHER_PERIOD:
        return channels, seen * interval_s
    exact = _refine(channels[given].values, seen)
    whole = round(exact)
    if is_whole(exact):
        return channels, whole * interval_s
    start = max(int(c.time_ns[0]) for c in channels.values())
    stop = min(int(c.time_ns[-1]) for c in channels.values())
    step_ns = exact / whole * interval_s * 1e9
    count = int((stop - start) / step_ns) + 1
    return {q: read_at(c, start, step_ns, count) for q, c in channels.items()}, whole * step_ns * 1e-9


def _refine(values: Float, seen: int) -> float:
    """The period of a signal in samples, to a part of one: how much later than `seen` samples it repeats, on average of all its periods."""
    moving = np.flatnonzero(np.abs(values) > 0.02 * np.abs(values).max())
    first = int(moving[0]) + seen  # the first period holds the start
    count = (int(moving[-1]) + 1 - first) // seen
    if count < _FEWEST:
        return float(seen)
    spectra = np.fft.rfft(values[first : first + count * seen].reshape(count, seen))
    frequency = np.arange(spectra.shape[1]) / seen
    late = [delay_between(after, before, frequency) for before, after in pairwise(spectra)]
    return seen + float(np.mean(late))
