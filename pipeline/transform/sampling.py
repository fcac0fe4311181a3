"""From the time stamps of channels to arrays on one constant clock, without rounding a delay to a sample.

A channel may have lost samples, gaps between blocks, stamps rounded to a decimal, a rate of its own or a machine clock
that jitters. What is not measured stays NaN. What the arrays mean (sweep, period, cycle) belongs to the transforms.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from schemas.arrays import Bool, Complex, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.recording import Channel

SAMPLES_PER_CYCLE = 5.0
"""Quintic splines reproduce a sine of at least so many samples per cycle to 2e-4, (ωh)⁶/30240."""
_STAMP_TOLERANCE = 0.02
"""Share of the interval by which a stamp may miss the constant clock and still be taken for that clock's tick."""
_GAP = 2.5
"""Intervals without a sample that are a gap, not jitter."""
_FEWEST = 16


@dataclass(frozen=True)
class Sampled:
    """Channels on one clock: sample i of channel q shows the instant `start_s[q]` + i `interval_s`.

    Parameters
    ----------
    interval_s : s
    values : quantity → (n,), the same n for all; NaN where nothing was measured
    start_s : quantity → s since the origin; the known latency of the channel is taken off. Differences between channels
        are below one interval plus the latencies and must be applied as e^{−jωΔ}
    filter_hz : quantity → corner of its anti-alias filter, None where unknown
    band_hz : frequencies above it are not reliable (interpolation, jitter, Nyquist)
    notes : what the reader of a result should know about the clocks
    """

    interval_s: float
    values: Mapping[str, Float]
    start_s: Mapping[str, float]
    filter_hz: Mapping[str, float | None]
    band_hz: float
    notes: tuple[str, ...] = ()

    @property
    def count(self) -> int:
        return next(iter(self.values.values())).size

    @property
    def finite(self) -> Bool:
        """(n,) where every channel has a value."""
        first, *others = self.values.values()
        found: Bool = np.isfinite(first)
        for values in others:
            found &= np.isfinite(values)
        return found

    def part(self, first: int, stop: int) -> Sampled:
        """Samples first…stop−1 of every channel."""
        return replace(
            self,
            values={q: v[first:stop] for q, v in self.values.items()},
            start_s={q: s + first * self.interval_s for q, s in self.start_s.items()},
        )

    def alignment(self, frequency_hz: Float, quantity: str, reference: str) -> Complex:
        """Factor that brings spectra of `quantity` to the time origin of `reference`: start difference, filter poles.

        A filter is taken for the single pole of its corner; equal corners cancel and are left alone.
        """
        later = self.start_s[quantity] - self.start_s[reference]
        factor = np.exp(-2j * np.pi * frequency_hz * later)
        own, other = self.filter_hz.get(quantity), self.filter_hz.get(reference)
        if own != other:
            factor = factor * (1 + 1j * frequency_hz / own if own else 1.0)
            factor = factor / (1 + 1j * frequency_hz / other if other else 1.0)
        return np.asarray(factor)


@dataclass(frozen=True)
class _OneClock:
    """A single channel on a constant clock, seconds since the origin."""

    start_s: float
    interval_s: float
    values: Float
    band_hz: float
    notes: tuple[str, ...] = ()


def sample(channels: Mapping[str, Channel], origin_ns: int) -> Sampled:
    """Channels on one clock, cut to the time that all of them cover.

    Equal rates are never interpolated: only the start differs, and stays as a number. With several rates the slower
    channels are interpolated to the clock of the fastest. Times in s since `origin_ns`.

    Raises `NotIdentifiableError` for channels with fewer than 16 samples or without common time.
    """
    clocks = {q: _one_clock(c, origin_ns) for q, c in channels.items()}
    notes = [note for clock in clocks.values() for note in clock.notes]
    fastest = min(clocks.values(), key=lambda c: c.interval_s)
    longest = max(c.values.size for c in clocks.values())
    for q, clock in clocks.items():
        drift = abs(clock.interval_s / fastest.interval_s - 1) * longest
        if drift > _STAMP_TOLERANCE:
            clocks[q] = _resampled(clock, fastest)
            notes.append(f"{q} at {1 / clock.interval_s:.6g} Hz interpolated to {1 / fastest.interval_s:.6g} Hz")
    interval = fastest.interval_s
    first = max(c.start_s for c in clocks.values())
    skip = {q: max(0, int(np.floor((first - c.start_s) / interval + 1e-6))) for q, c in clocks.items()}
    count = min(c.values.size - skip[q] for q, c in clocks.items())
    if count < _FEWEST:
        raise NotIdentifiableError(
            f"{' and '.join(channels)} have {max(count, 0)} samples of common time", expected=f"at least {_FEWEST}"
        )
    return Sampled(
        interval_s=interval,
        values={q: c.values[skip[q] : skip[q] + count] for q, c in clocks.items()},
        start_s={q: c.start_s + skip[q] * interval - (channels[q].delay_s or 0.0) for q, c in clocks.items()},
        filter_hz={q: c.filter_hz for q, c in channels.items()},
        band_hz=min(c.band_hz for c in clocks.values()),
        notes=tuple(notes),
    )


def runs(mask: Bool) -> list[tuple[int, int]]:
    """(first, stop) of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def fill_short_gaps(values: Float, longest: int) -> tuple[Float, int]:
    """Values with inner NaN runs of at most `longest` samples filled by the polynomial through three samples on each side.

    Of a sinusoid of eight samples or more per period it misses less than 1 % of the amplitude, and that only where samples are lost.

    Returns the array (the same one where nothing was filled) and the number of samples filled.
    """
    if longest < 1 or np.isfinite(values).all():
        return values, 0
    filled, count = values.copy(), 0
    for first, stop in runs(~np.isfinite(values)):
        if stop - first > longest:
            continue
        near = np.r_[first - 3 : first, stop : stop + 3]
        if near[0] < 0 or near[-1] >= values.size or not np.isfinite(values[near]).all():
            continue
        middle = (first + stop) / 2
        filled[first:stop] = np.polyval(np.polyfit(near - middle, values[near], 5), np.arange(first, stop) - middle)
        count += stop - first
    return filled, count


def without_short_gaps(sampled: Sampled, highest_hz: float) -> tuple[Sampled, list[str]]:
    """The same channels with gaps below a quarter of the period of `highest_hz` filled, and a note per channel."""
    longest = int(1 / (4 * highest_hz * sampled.interval_s))
    values, notes = dict(sampled.values), []
    for q in values:
        values[q], count = fill_short_gaps(values[q], longest)
        if count:
            notes.append(
                f"{count} lost samples of {q} interpolated; each gap is below a quarter of the shortest period"
            )
    return replace(sampled, values=values), notes


def seconds(channel: Channel, origin_ns: int) -> tuple[Float, Float]:
    """True times in s since the origin (known latency taken off) and values of the finite samples, both (n,)."""
    good = np.isfinite(channel.values)
    time = (channel.time_ns - origin_ns).astype(float) * 1e-9 - (channel.delay_s or 0.0)
    return (time, channel.values) if good.all() else (time[good], channel.values[good])


def _one_clock(channel: Channel, origin_ns: int) -> _OneClock:
    time, values = channel.time_ns, channel.values
    n = time.size
    if n < _FEWEST:
        raise NotIdentifiableError(f"{channel.quantity} has {n} samples", expected=f"at least {_FEWEST}")
    start = (int(time[0]) - origin_ns) * 1e-9
    shortest, longest = _interval_limits(time)
    interval_ns = (int(time[-1]) - int(time[0])) / (n - 1)
    if longest - shortest <= max(2, _STAMP_TOLERANCE * interval_ns) and _on_line(time, interval_ns):
        return _OneClock(start, interval_ns * 1e-9, values, 0.5e9 / interval_ns)
    return _with_gaps(channel, start)


def _interval_limits(time: Int) -> tuple[int, int]:
    """Shortest and longest interval in ns; in pieces that stay in the processor's cache."""
    shortest, longest = np.iinfo(np.int64).max, 0
    for first in range(0, time.size - 1, 32768):
        piece = time[first : first + 32769]
        intervals = piece[1:] - piece[:-1]
        shortest, longest = min(shortest, int(intervals.min())), max(longest, int(intervals.max()))
    return shortest, longest


def _on_line(time: Int, interval_ns: float) -> bool:
    """Whether stamps with nearly equal intervals stay near a straight line; 512 of them tell."""
    index = np.linspace(0, time.size - 1, 512).astype(np.int64)
    miss = (time[index] - time[0]) - index * interval_ns
    return bool(np.abs(miss).max() <= max(2.0, _STAMP_TOLERANCE * interval_ns))


def _with_gaps(channel: Channel, start: float) -> _OneClock:
    """A channel with lost samples, gaps, rounded stamps or jitter on a constant clock."""
    time = channel.time_ns - channel.time_ns[0]
    intervals = np.diff(time)
    interval = float(np.median(intervals))
    # Refine the interval on the ticks that it implies, twice: rounding of the first guess adds up over a long record.
    for _ in range(3):
        ticks = np.cumsum(np.concatenate([[0], np.maximum(np.rint(intervals / interval), 1)]))
        interval = float(np.dot(ticks - ticks.mean(), time - time.mean()) / np.sum((ticks - ticks.mean()) ** 2))
    offset = float(np.mean(time - ticks * interval))
    miss = time - ticks * interval - offset
    tolerance = max(_STAMP_TOLERANCE * interval, 0.51 * _quantum(channel.time_ns))
    notes: tuple[str, ...] = ()
    if np.abs(miss).max() <= tolerance:
        values = np.full(int(ticks[-1]) + 1, np.nan)
        values[ticks.astype(np.int64)] = channel.values
        lost = values.size - channel.values.size
        if lost:
            notes = (f"{channel.quantity}: {lost} samples missing in {len(runs(np.isnan(values)))} gaps",)
        return _OneClock(start + offset * 1e-9, interval * 1e-9, values, 0.5e9 / interval, notes)
    good = np.isfinite(channel.values)
    return _jittered(channel.quantity, start, time[good], channel.values[good])


def _quantum(time_ns: Int) -> float:
    """The decimal step in ns to which all stamps are rounded, at most 1 ms."""
    step = 1
    while step < 1_000_000 and not (time_ns % (step * 10)).any():
        step *= 10
    return float(step)


def _jittered(quantity: str, start: float, time: Int, measured: Float) -> _OneClock:
    """Finite values at uneven times on a clock of the median interval; a wide gap stays one."""
    if time.size < _FEWEST:
        raise NotIdentifiableError(f"{quantity} has {time.size} finite samples", expected=f"at least {_FEWEST}")
    intervals = np.diff(time)
    interval = float(np.median(intervals))
    gap = intervals > _GAP * interval
    widest = float(intervals[~gap].max())
    values = np.full(int(time[-1] / interval) + 1, np.nan)
    edges = np.concatenate([[0], np.flatnonzero(gap) + 1, [time.size]])
    for first, stop in itertools.pairwise(edges):
        _interpolate(time[first:stop] / interval, measured[first:stop], values)
    notes = (
        f"{quantity}: intervals from {intervals.min() * 1e-6:.3g} to {intervals.max() * 1e-6:.3g} ms, "
        f"interpolated to {interval * 1e-6:.3g} ms; {int(gap.sum())} gaps stay",
    )
    return _OneClock(start, interval * 1e-9, values, 1e9 / (SAMPLES_PER_CYCLE * widest), notes)


def _resampled(clock: _OneClock, target: _OneClock) -> _OneClock:
    """A channel on the ticks of another clock, within its own time; NaN stays NaN."""
    first = int(np.ceil((clock.start_s - target.start_s) / target.interval_s - 1e-9))
    end = clock.start_s + (clock.values.size - 1) * clock.interval_s
    count = int(np.floor((end - target.start_s) / target.interval_s + 1e-9)) - first + 1
    if count < _FEWEST:
        raise NotIdentifiableError("channels of different rates have hardly any common time")
    start = target.start_s + first * target.interval_s
    ratio = clock.interval_s / target.interval_s
    offset = (clock.start_s - start) / target.interval_s
    values = np.full(count, np.nan)
    for a, b in runs(np.isfinite(clock.values)):
        _interpolate(offset + np.arange(a, b) * ratio, clock.values[a:b], values)
    return _OneClock(start, target.interval_s, values, 1 / (SAMPLES_PER_CYCLE * clock.interval_s), clock.notes)


def read_at(channel: Channel, start_ns: int, step_ns: float, count: int) -> Channel:
    """A channel at `count` other instants in equal steps, by quintic splines; NaN where it has no samples, and beside a gap."""
    values = np.full(count, np.nan)
    position = (channel.time_ns - start_ns) / step_ns
    for a, b in runs(np.isfinite(channel.values)):
        _interpolate(position[a:b], channel.values[a:b], values)
    time_ns = start_ns + np.rint(step_ns * np.arange(count)).astype(np.int64)
    return replace(channel, time_ns=time_ns, values=values)


def _interpolate(position: NDArray[np.floating], values: Float, into: Float) -> None:
    """Writes a quintic spline through (position, values) into the whole positions that it covers."""
    good = np.isfinite(values)
    position, values = position[good], values[good]
    if position.size < 6:
        return
    first, last = int(np.ceil(position[0] - 1e-9)), int(np.floor(position[-1] + 1e-9))
    first, last = max(first, 0), min(last, into.size - 1)
    if last >= first:
        at = np.clip(np.arange(first, last + 1), position[0], position[-1])
        into[first : last + 1] = make_interp_spline(position, values, k=5)(at)
