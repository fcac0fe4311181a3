"""Harmonics of a signal by least squares: any sampling, slow terms beside them, noise with its correlation in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.transform.noise import autoregression, density_ratio
from schemas.arrays import Complex, Float

HARMONICS = 5
_MOST_SAMPLES = 200_000
_ENOUGH_FOR_FREQUENCY = 4000
_BLOCKS_PER_CYCLE = 64
"""Blocks per cycle into which long records are averaged: five harmonics need no more."""


@dataclass(frozen=True)
class Harmonics:
    """Sinusoids of one channel, phasors e^{+jωt} at the time origin.

    amplitude : (m,) complex, harmonics 1 … m
    variance : (m,) E|Δamplitude|², noise with its correlation in time
    mean : level of the slow terms over the window
    noise_sd : standard deviation of the residual
    """

    amplitude: Complex
    variance: Float
    mean: float
    noise_sd: float


@dataclass(frozen=True)
class SlowTerms:
    """What is fitted beside the harmonics: a polynomial, and decays that begin with the window (shares of its width)."""

    degree: int = 1
    decays: tuple[float, ...] = ()


def slow_terms(cycles: float) -> tuple[SlowTerms, ...]:
    """Sets of slow terms that a window of so many cycles carries, the richest last.

    A film that was at rest before the first cycle relaxes from its start far into the test. A few decays follow any sum
    of exponentials closely; in a short window they would be mistaken for the fundamental.
    """
    plain = SlowTerms()
    if cycles < 1.5:
        return plain, SlowTerms(1, (1 / 3,))
    if cycles < 2.5:
        return plain, SlowTerms(1, (1 / 3,)), SlowTerms(1, (1 / 10, 1 / 3))
    return SlowTerms(1, (1 / 10, 1 / 3)), SlowTerms(2, (1 / 30, 1 / 10, 1 / 3))


def refined_frequency(time: Float, x: Float, frequency: float, first: float, last: float) -> float:
    """Frequency by Gauss-Newton on the fundamental's phase over the window, within 5 % of the start."""
    inside = (time >= first) & (time < last)
    t, v = time[inside], x[inside]
    step = max(1, t.size // _ENOUGH_FOR_FREQUENCY)
    t, v = t[::step], v[::step]
    middle = (first + last) / 2
    start, f = frequency, frequency
    for _ in range(20):
        s = t - middle
        columns = [np.ones_like(s), s / (last - first)]
        for m in (1, 2, 3):
            columns += [np.cos(2 * np.pi * m * f * s), np.sin(2 * np.pi * m * f * s)]
        linear, *_ = np.linalg.lstsq(np.column_stack(columns), v, rcond=None)
        a, b = linear[2], linear[3]
        slope = 2 * np.pi * s * (b * columns[2] - a * columns[3])
        solution, *_ = np.linalg.lstsq(np.column_stack([*columns, slope]), v, rcond=None)
        change = float(solution[-1])
        f = float(np.clip(f + change, 0.95 * start, 1.05 * start))
        if abs(change) < 1e-10 * start:
            break
    return f


def harmonics(
    time: Float,
    values: Float,
    frequency: float,
    first: float,
    last: float,
    *,
    slow: SlowTerms | None = None,
) -> Harmonics | None:
    """Least squares on slow terms and up to five harmonics within [first, last) s; None with too few samples.

    time, values : (n,) s and any unit; gaps and jitter do no harm
    """
    slow = slow or SlowTerms()
    inside = (time >= first) & (time < last)
    t, v = time[inside], values[inside]
    cycles = (last - first) * frequency
    count = int(min(HARMONICS, np.floor(0.4 * t.size / cycles)))
    before = slow.degree + 1 + len(slow.decays)
    if count < 1 or t.size < 2 * count + before + 2:
        return None
    middle = (first + last) / 2
    design = _design(t, frequency, count, slow, first, last)
    if t.size > _MOST_SAMPLES:
        # Means over blocks of samples and of the model alike: exact, whatever the sampling.
        block = int(max(1, t.size / (cycles * _BLOCKS_PER_CYCLE)))
        starts = np.arange(0, t.size // block * block, block)
        design = np.add.reduceat(design[: starts.size * block], starts, axis=0) / block
        v = np.add.reduceat(v[: starts.size * block], starts) / block
    scale = np.linalg.norm(design, axis=0)
    q, r = np.linalg.qr(design / scale)
    solution = np.linalg.solve(r, q.T @ v) / scale
    residual = v - design @ solution
    inverse = np.linalg.inv(r) / scale[:, None]
    covariance = inverse @ inverse.T
    turns = frequency * (last - first) / v.size
    # Slow terms take half a cycle per window and term; each harmonic takes two.
    removed = np.concatenate([np.arange(before) / (2 * v.size), np.repeat(np.arange(1, count + 1), 2) * turns])
    coefficients, innovation = autoregression(residual, removed)
    amplitude = np.empty(count, dtype=complex)
    variance = np.empty(count)
    for m in range(1, count + 1):
        i = before + 2 * (m - 1)
        amplitude[m - 1] = (solution[i] - 1j * solution[i + 1]) * np.exp(-2j * np.pi * m * frequency * middle)
        density = innovation * density_ratio(coefficients, m * turns)
        variance[m - 1] = density * (covariance[i, i] + covariance[i + 1, i + 1])
    mean = float(np.mean(design[:, :before] @ solution[:before]))
    return Harmonics(amplitude, variance, mean, float(np.sqrt(np.mean(residual**2))))


def _design(time: Float, frequency: float, count: int, slow: SlowTerms, first: float, last: float) -> Float:
    s, width = time - (first + last) / 2, last - first
    before = slow.degree + 1 + len(slow.decays)
    design = np.empty((time.size, before + 2 * count))
    for power in range(slow.degree + 1):
        design[:, power] = (s / width) ** power
    for i, share in enumerate(slow.decays, start=slow.degree + 1):
        design[:, i] = np.exp((first - time) / (share * width))
    turn = np.exp(2j * np.pi * frequency * s)
    wave = np.ones_like(turn)
    for m in range(count):
        wave = wave * turn
        design[:, before + 2 * m] = wave.real
        design[:, before + 1 + 2 * m] = wave.imag
    return design
