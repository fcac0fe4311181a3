"""From what is true to what is recorded: load-cell memory, delay, gain, hum, drift, clipping, noise, converter.

Does not belong here: mechanics. Arrays are (n,) on one clock; every function leaves its input unchanged.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter
from scipy.special import roots_genlaguerre

from tests.helpers.truth_rig.jit import kernel

Float = NDArray[np.float64]

_PLAYS = np.array([0.01, 0.04, 0.12, 0.3])
CELL_MEMORY = _PLAYS.size + 1
_CONVERTER_BITS = 16
_SHIFTS = 12
"""Shifts that stand for two poles, exact for polynomials of degree 23."""


@kernel
def _remembering(force, step, peak, creep_s, plays, memory):
    """What four play operators and a creep that remembers the sign of the load add per unit share; changes `memory`."""
    out = np.empty(force.size)
    last = plays.size
    for i in range(force.size):
        total = 0.0
        for j in range(last):
            reach = plays[j] * peak
            memory[j] = max(force[i] - reach, min(force[i] + reach, memory[j]))
            total += memory[j] / last
        memory[last] += (math.tanh(3 * force[i] / peak) - memory[last]) * -math.expm1(-step / creep_s)
        out[i] = total + 0.2 * peak * memory[last]
    return out


def remembering(force: Float, step: float, share: float, peak: float, creep_s: float, memory: Float) -> Float:
    """Force reading of a load cell with hysteresis and creep. `memory` (5,) is carried over, changed in place."""
    return np.asarray(force + share * _remembering(force, step, peak, creep_s, _PLAYS, memory))


def delayed(values: Float, step: float, delay_s: float, form: str) -> Float:
    """The signal through two equal poles of total delay `delay_s`, or shifted by it. At rest before the first sample.

    Between samples it is a cubic spline: a delay much shorter than a step must not become a difference of neighbours. Two poles are
    the mean of shifts by s with the density s e^{−s/τ}/τ².
    """
    t = np.arange(values.size) * step
    signal = CubicSpline(t, values)
    if form == "shift":
        return np.asarray(signal(np.maximum(t - delay_s, 0.0)))
    shifts, shares = roots_genlaguerre(_SHIFTS, 1.0)
    out = np.zeros(values.size)
    for shift, share in zip(shifts * delay_s / 2, shares, strict=True):
        out += share * signal(np.maximum(t - shift, 0.0))
    return out


def smoothed(values: Float, step: float, delay_s: float) -> Float:
    """The signal, with jumps or without, through two equal poles of total delay `delay_s`; linear within a step. At rest before."""
    decay = math.exp(-2 * step / delay_s)
    # One pole 1/(1 + s τ), exact for a signal that is linear within a step.
    ratio = delay_s / 2 / step
    new, old = 1 - ratio * (1 - decay), ratio * (1 - decay) - decay
    out = values - values[0]
    for _ in range(2):
        out = lfilter([new, old], [1, -decay], out)
    return np.asarray(out + values[0])


def hum(time_s: Float, amplitude_n: float, second: float, mains_hz: float, rng: np.random.Generator) -> Float:
    """Mains pick-up: a frequency that wanders (sd 0.02 Hz, forgetting in 10 s), and twice that; random phases."""
    step = float(time_s[1] - time_s[0])
    decay = math.exp(-step / 10.0)
    wander = lfilter([1.0], [1.0, -decay], rng.normal(0, 0.02 * math.sqrt(1 - decay**2), time_s.size))
    phase = 2 * np.pi * np.cumsum(mains_hz + wander) * step + rng.uniform(0, 2 * np.pi)
    other = rng.uniform(0, 2 * np.pi)
    return np.asarray(amplitude_n * (np.sin(phase) + second * np.sin(2 * phase + other)))


def drift(time_s: Float, preload: float, per_decade: float, onset_s: float, true_at_s: float) -> Float:
    """Creep of the rest level: a weak power law that meets −`per_decade` × preload × log10(1 + t/t0) at `true_at_s`."""
    power = 0.08
    creep = (1 + time_s / onset_s) ** power - 1
    there = math.log10(1 + true_at_s / onset_s) / ((1 + true_at_s / onset_s) ** power - 1)
    return np.asarray(-preload * per_decade * there * creep)


def soft_clip(values: Float, limit: float, softness: float) -> Float:
    """Slope 1 up to ± `limit`, then bent towards `limit` (1 + `softness`) as x/(1 + x³)^(1/3) bends towards 1."""
    width = softness * limit
    beyond = np.maximum(np.abs(values) - limit, 0.0) / width
    return np.asarray(np.where(beyond > 0, np.sign(values) * (limit + width * beyond / np.cbrt(1 + beyond**3)), values))


def noise(samples: int, sd: float, pink_share: float, rng: np.random.Generator) -> Float:
    """White noise with a share of its variance as 1/f noise, standard deviation `sd` in all, (samples,)."""
    white = rng.normal(0.0, 1.0, samples)
    spectrum = rng.normal(size=samples // 2 + 1) + 1j * rng.normal(size=samples // 2 + 1)
    spectrum[0] = 0
    spectrum[1:] /= np.sqrt(np.arange(1, spectrum.size))
    pink = np.fft.irfft(spectrum, n=samples)
    pink /= pink.std()
    return np.asarray(sd * (math.sqrt(1 - pink_share) * white + math.sqrt(pink_share) * pink))


def resolution(span: float) -> float:
    """One step of a 16-bit converter over ± `span`."""
    return span / 2.0 ** (_CONVERTER_BITS - 1)


def quantised(values: Float, one_step: float) -> Float:
    return np.asarray(np.round(values / one_step) * one_step)
