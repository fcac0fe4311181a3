"""What the rigs are told to do: sweeps, multisines, cycles and steps as functions of time.

Pure shapes. How an amplifier or a film answers them does not belong here.
"""

from __future__ import annotations

import numpy as np

from schemas.arrays import Float, Int


def sweep(
    time_s: Float,
    *,
    start_hz: float,
    stop_hz: float,
    duration_s: float,
    amplitude: float,
    exponent: float = 0.0,
    logarithmic: bool = True,
    taper_start_s: float = 0.0,
    taper_stop_s: float = 0.0,
) -> Float:
    """A sine sweep that begins and ends at rest.

    Parameters
    ----------
    time_s : (n,) s
    start_hz, stop_hz : Hz, frequency at 0 and at `duration_s`
    duration_s : s
    amplitude : at the start
    exponent : the amplitude follows the frequency as `amplitude` (f/start_hz)^`exponent`, which keeps the force within
        the load cell when the film stiffens with frequency
    logarithmic : equal times for equal ratios of frequency; else for equal differences
    taper_start_s, taper_stop_s : s, half-cosine tapers, which remove the jumps of the velocity

    Returns
    -------
    (n,) in the unit of `amplitude`; zero before 0 and after `duration_s`
    """
    t = np.clip(time_s, 0.0, duration_s)
    if logarithmic:
        rate = np.log(stop_hz / start_hz)
        growth = np.exp(rate * t / duration_s)
        frequency = start_hz * growth
        phase = 2 * np.pi * start_hz * duration_s / rate * (growth - 1)
    else:
        slope = (stop_hz - start_hz) / duration_s
        frequency = start_hz + slope * t
        phase = 2 * np.pi * (start_hz + slope * t / 2) * t
    envelope = amplitude * (frequency / start_hz) ** exponent if exponent else np.full_like(t, amplitude)
    if taper_start_s > 0:
        envelope = envelope * half_cosine(t / taper_start_s)
    if taper_stop_s > 0:
        envelope = envelope * half_cosine((duration_s - t) / taper_stop_s)
    inside = (time_s >= 0) & (time_s <= duration_s)
    return np.where(inside, envelope * np.sin(phase), 0.0)


def half_cosine(progress: Float) -> Float:
    """A smooth rise from 0 at progress 0 (and before) to 1 at progress 1 (and after); shape of the input."""
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.clip(progress, 0.0, 1.0)))


def excited_lines(kind: str, count: int, rng: np.random.Generator | None = None) -> Int:
    """Harmonic numbers that a multisine excites.

    Parameters
    ----------
    kind : `full`: 1, 2, 3, …; `odd`: 1, 3, 5, …; `random_odd`: the odd ones without one of each four, so that the
        response at the left-out lines shows odd nonlinearity and the one at even lines even nonlinearity
    count : largest harmonic number
    rng : draws the lines that `random_odd` leaves out

    Returns
    -------
    (lines,) ascending

    Raises
    ------
    ValueError
        Another kind, or `random_odd` without `rng`.
    """
    if kind == "full":
        return np.arange(1, count + 1)
    odd = np.arange(1, count + 1, 2)
    if kind == "odd":
        return odd
    if kind != "random_odd" or rng is None:
        raise ValueError(f"lines {kind!r}: full, odd, or random_odd with a random generator")
    keep = np.ones(odd.size, dtype=bool)
    for first in range(0, odd.size - 3, 4):
        keep[first + int(rng.integers(4))] = False
    return odd[keep]


def schroeder_multisine(samples: int, lines: Int) -> Float:
    """One period of a multisine of low crest factor.

    Parameters
    ----------
    samples : of the period
    lines : (N,) harmonic numbers, ascending

    Returns
    -------
    (samples,), largest |value| 1

    Raises
    ------
    ValueError
        A line needs more samples than the period has.

    Notes
    -----
    Σ cos(2π l t + φ_k) with φ_k = −π k(k−1)/N for the k-th line (Schroeder, 1970).
    """
    k = np.arange(1, lines.size + 1)
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    if lines[-1] >= spectrum.size:
        raise ValueError(f"line {lines[-1]} needs more than {samples} samples in a period")
    spectrum[lines] = np.exp(-1j * np.pi * k * (k - 1) / lines.size)
    period = np.fft.irfft(spectrum, n=samples)
    return np.asarray(period / np.abs(period).max())


def square_root_drive(u: Float, peak_kv: float) -> Float:
    """Voltage peak √((1 + u)/2) in kV of u within ±1: its square, which drives the film, has the lines of u and no
    others."""
    return peak_kv * np.sqrt((1 + u) / 2)


def raised_cosine(time_s: Float, *, frequency_hz: float, peak_to_peak: float, cycles: int) -> Float:
    """Cycles from 0 to `peak_to_peak` and back, without a jump of the velocity.

    Parameters
    ----------
    time_s : (n,) s
    frequency_hz : Hz
    peak_to_peak : largest value
    cycles : how many, from time 0 on

    Returns
    -------
    (n,) in the unit of `peak_to_peak`; 0 before and after
    """
    t = np.clip(time_s, 0.0, cycles / frequency_hz)
    return peak_to_peak / 2 * (1 - np.cos(2 * np.pi * frequency_hz * t))


def ramp(time_s: Float, *, start_s: float, duration_s: float, height: float) -> Float:
    """Linear rise by `height` within `duration_s` s from `start_s` s, held afterwards; (n,) for (n,) s."""
    return height * np.clip((time_s - start_s) / duration_s, 0.0, 1.0)


def triangle(time_s: Float, *, peak: float, rate: float) -> Float:
    """Rise from 0 to `peak` at `rate` (per s), fall at the same rate, then 0; (n,) for (n,) s."""
    top = peak / rate
    return np.clip(peak - rate * np.abs(time_s - top), 0.0, peak)


def pulses(time_s: Float, *, levels: tuple[float, ...], on_s: float, off_s: float, first_s: float) -> Float:
    """Rectangles that follow one another.

    Parameters
    ----------
    time_s : (n,) s
    levels : height of each
    on_s, off_s : s, how long each lasts, and the 0 after it
    first_s : s, beginning of the first

    Returns
    -------
    (n,) in the unit of the levels
    """
    since = time_s - first_s
    # An edge that falls on a sample belongs to that sample; a sum of decimal steps lands a hair before it.
    cycle = np.floor((since + 1e-9) / (on_s + off_s)).astype(np.int64)
    within = since - cycle * (on_s + off_s) < on_s - 1e-9
    known = (cycle >= 0) & (cycle < len(levels))
    return np.where(known & within, np.asarray(levels)[np.clip(cycle, 0, len(levels) - 1)], 0.0)


def staircase(time_s: Float, *, levels: tuple[float, ...], plateau_s: float, ramp_s: float) -> Float:
    """Plateaus joined by half-cosine ramps.

    Parameters
    ----------
    time_s : (n,) s
    levels : height of each plateau
    plateau_s : s, how long each lasts
    ramp_s : s, how long the ramp at its start lasts

    Returns
    -------
    (n,) in the unit of the levels
    """
    total = np.full_like(time_s, levels[0])
    for i in range(1, len(levels)):
        total = total + (levels[i] - levels[i - 1]) * half_cosine((time_s - i * plateau_s) / ramp_s)
    return total
