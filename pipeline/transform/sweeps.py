"""Where the sweeps of a record are: rest, first movement, repeats. Found in the driven displacement itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft

from schemas.arrays import Float
from schemas.errors import PremiseError

_MOVING = 0.02
"""Share of the amplitude that counts as movement."""
_CLEARLY, _AT_REST = 6.0, 3.0
"""Standard deviations of its noise from which a signal has clearly left its level, and within which a stretch is at rest."""
_ENDS_SOON = 0.02
"""Share of a period by which the end of a sweep may seem to lie beyond the end of the record: where it rests is found to a sample or few."""
_BEYOND, _SIZES, _FEWEST_HALVES = 0.2, 200, 6
"""Share of its size about there that a sweep has to be beyond zero to have turned; parts of a record that have one size; fewest half
turns of which frequencies are read."""
_AUTOCORRELATED = 0.9
_COARSE = 16384
"""Points in which repeats are looked for; sweeps contain low frequencies, which is enough to find their period."""


@dataclass(frozen=True)
class Motion:
    """Where a signal moves.

    Parameters
    ----------
    first, stop : int
        First sample that moves, and first sample that rests again (n when it never does).
    amplitude : float
        Half peak to peak.
    level, threshold : float
        Where it rests before, and how far from there counts as movement.
    """

    first: int
    stop: int
    amplitude: float
    level: float
    threshold: float


@dataclass(frozen=True)
class Slices:
    """Equal pieces of a record, one per repeat: they start at `first` (samples) and are `length` samples long.

    `rest_before`, `rest_after`: samples of rest at both ends of each piece; `continuous`: the repeats follow each other
    without rest, so that a piece is one period of a periodic signal. `leftover`: the last samples of the record
    that fill no whole piece hold another, incomplete sweep.
    """

    first: tuple[int, ...]
    length: int
    rest_before: int
    rest_after: int
    period: float
    leftover: bool = False
    continuous: bool = False


def motion(values: Float) -> Motion:
    """Where a finite signal moves. Raises `PremiseError` for one that never does."""
    amplitude = float(values.max() - values.min()) / 2
    if amplitude == 0:
        raise PremiseError("the input does not move at all", expected="a sweep")
    edge = int(np.clip(values.size // 200, 8, 256))
    first, level, threshold = _first_move(values, edge, amplitude)
    stop, _, _ = _first_move(values[::-1], edge, amplitude)
    return Motion(first, values.size - stop, amplitude, level, threshold)


def _first_move(values: Float, edge: int, amplitude: float) -> tuple[int, float, float]:
    """First sample that has left the level at the beginning, that level, and how far from it counts as left."""
    start = values[:edge]
    spread, level = float(start.std()), float(start.mean())
    # Second differences of a signal that moves slowly are its noise; where it spreads farther, it moves from the first sample on.
    noise = float(np.sqrt(np.mean(np.diff(start, 2) ** 2) / 6)) if edge > 2 else spread
    if spread > _AT_REST * noise and spread > _MOVING * amplitude / _CLEARLY:
        spread, level = noise, float(values[0])
    threshold = min(max(_MOVING * amplitude, _CLEARLY * spread), amplitude / 4)
    # In pieces: most records move after a small part of them.
    for first in range(0, values.size, 65536):
        moving = np.abs(values[first : first + 65536] - level) > threshold
        hit = int(moving.argmax())
        if moving[hit]:
            return first + hit, level, threshold
    return 0, level, threshold


def slices(
    values: Float, moving: Motion, *, period: float | None, repeats: int | None, least_rest: float = 8.0
) -> Slices:
    """Pieces of one sweep each.

    Parameters
    ----------
    values : (n,) finite displacement
    period : samples from the start of one repeat to the start of the next, rest included; None: looked for
    repeats : number that the metadata give, None where they do not
    least_rest : samples of rest between repeats, below which they count as continuous
    """
    n = values.size
    told = period is not None
    if period is None and repeats != 1:
        period = find_period(values)
    if period is None or period >= n - moving.first or (not told and (n - moving.first) / period < 1.5):
        return Slices((0,), n, moving.first, n - moving.stop, float(n))
    # Length of one sweep: to the last movement within the first period.
    piece = values[moving.first : moving.first + int(period)]
    active = motion(piece).stop if piece.size else 0
    least = max(0.05 * period, min(least_rest, 0.2 * period))
    if period - active < least and piece.size:
        # Movement is seen a little late: the beginning of the next repeat, seen by the same measure, is no part of this one. The
        # level itself may be off by as much.
        beyond = np.flatnonzero(np.abs(piece - moving.level) > 2 * moving.threshold)
        active = min(active, int(beyond[-1]) + 1) if beyond.size else active
    gap = period - active
    rests = gap >= least
    if not rests:
        return periods(n, moving.first, period, repeats)
    before = int(min(moving.first, gap / 2))
    count = int(np.floor((n - moving.first - active) / period + _ENDS_SOON)) + 1
    count = count if repeats is None else min(count, repeats)
    first = tuple(round(moving.first - before + p * period) for p in range(count))
    length = min(round(period), n - first[-1])
    leftover = n - (moving.first + count * period) > 0.05 * active
    return Slices(first, length, before, max(0, length - before - active), period, leftover)


def periods(samples: int, onset: int, period: float, repeats: int | None) -> Slices:
    """Pieces of a periodic signal without rest: whole periods from about `onset` on; where they begin does not matter."""
    count = max(1, int((samples - onset) / period + 0.05))
    count = count if repeats is None else min(count, repeats)
    start = max(0.0, min(float(onset), samples - count * period))
    length = round(period)
    first = tuple(int(start + p * period) for p in range(count))
    first = tuple(f for f in first if f + length <= samples)
    return Slices(first, length, 0, 0, period, samples - onset - count * period > 0.05 * period, continuous=True)


def end_frequencies(values: Float) -> tuple[float, float]:
    """Frequency of a sweep where a record begins and where it ends, in turns per sample; 0 and 0 without three turns.

    Medians of three of the times between its crossings of zero: neither noise nor a cut end counts. A crossing counts where the signal
    has gone a fifth of its size about there beyond zero since the last one.

    Parameters
    ----------
    values : (n,) finite array
        One sweep or a part of one, at rest or not at its ends.
    """
    x = values - (values.max() + values.min()) / 2
    size = np.maximum.reduceat(np.abs(x), np.arange(0, x.size, max(1, x.size // _SIZES)))
    local = np.interp(np.arange(x.size), np.linspace(0, x.size - 1, size.size), size)
    beyond = np.maximum(_BEYOND * local, _MOVING * size.max())
    state = np.where(x > beyond, 1, np.where(x < -beyond, -1, 0))
    known = np.flatnonzero(state)
    turned = known[1:][state[known[1:]] != state[known[:-1]]]
    half = np.diff(turned)
    if half.size < _FEWEST_HALVES:
        return 0.0, 0.0
    return float(0.5 / np.median(half[:3])), float(0.5 / np.median(half[-3:]))


def find_period(values: Float) -> float | None:
    """Samples after which the signal repeats, None where it does not; coarse, to about one part in 16000 of the record."""
    step = max(1, values.size // _COARSE)
    coarse = values[: values.size // step * step].reshape(-1, step).mean(axis=1)
    coarse = coarse - np.median(coarse)
    n = coarse.size
    size = scipy.fft.next_fast_len(2 * n, real=True)
    spectrum = scipy.fft.rfft(coarse, size)
    products = scipy.fft.irfft(np.abs(spectrum) ** 2, size)[:n]
    energy = np.concatenate([[0.0], np.cumsum(coarse**2)])
    lags = np.arange(n)
    # Correlation coefficient of the two overlapping parts.
    together = np.sqrt(np.maximum(energy[n - lags] * (energy[n] - energy[lags]), np.finfo(float).tiny))
    coefficient = products / together
    enough = (lags > n // 400) & (lags < 0.75 * n) & (energy[n - lags] > 0.2 * energy[n])
    # The first lag after the main peak has been left.
    left = int(np.argmax(coefficient < 0.5))
    enough &= lags > left
    if not enough.any() or coefficient[enough].max() < _AUTOCORRELATED:
        return None
    high = coefficient >= 0.95 * coefficient[enough].max()
    lag = int(np.flatnonzero(enough & high)[0])
    while lag + 1 < n and coefficient[lag + 1] > coefficient[lag]:
        lag += 1
    return float(lag * step)
