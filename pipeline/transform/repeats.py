"""Repeats of one sweep: synchronised averages, the noise between them, and the first against the later ones."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import fdtrc, fdtri

from pipeline.transform import local_polynomial
from pipeline.transform.local_polynomial import LocalFit
from schemas.arrays import Complex, Int

CHANGED = 1e-3
"""Level of the tests between repeats."""


def synchronised(u: Complex, y: Complex, lines: Int, widths: Int) -> tuple[LocalFit, LocalFit]:
    """Local polynomials of the synchronised averages: with the whole variance, and with that of the noise alone.

    u, y : (repeats, bins) spectra brought to one instant; lines, widths : (L,) bins of the lines and half widths

    Noise of the average: scatter of Y − H U between the repeats, which is
    |H|² [σ_Y²/|Y|² + σ_U²/|U|² − 2 Re(σ_YU/(Y U*))]/P, pooled over the bins of a window. What the polynomial leaves over
    beyond it does not change from repeat to repeat (distortion, or a response that is no polynomial): it goes into the
    whole variance.
    """
    count = u.shape[0]
    fitted = local_polynomial.adaptive_fit(u.mean(axis=0), y.mean(axis=0), lines, widths)
    if count < 2:
        return fitted, fitted
    bins = np.arange(u.shape[1])
    h = np.interp(bins, lines, fitted.value.real) + 1j * np.interp(bins, lines, fitted.value.imag)
    scatter = y - h * u
    scatter = scatter - scatter.mean(axis=0)
    power = (np.abs(scatter) ** 2).sum(axis=0) / (count - 1) / count
    window = local_polynomial.windows(lines, fitted.half_width, u.shape[1])
    width = window.inside.sum(axis=1)
    noise = (power[window.index] * window.inside).sum(axis=1) / width
    freedom = width * (count - 1.0)
    limit = fdtri(2 * fitted.degrees_of_freedom, 2 * freedom, 1 - CHANGED)
    pooled = (noise * freedom + fitted.noise * fitted.degrees_of_freedom) / (freedom + fitted.degrees_of_freedom)
    whole = np.where(fitted.noise > limit * noise, fitted.noise, pooled)
    return (
        replace(fitted, noise=whole, variance=whole * fitted.gain),
        replace(fitted, noise=noise, variance=noise * fitted.gain, degrees_of_freedom=freedom),
    )


def first_against_later(fits: list[LocalFit], noise: LocalFit) -> dict[str, Any]:
    """Difference of the first repeat's response from the mean of the others, against the noise of the repeats."""
    count = len(fits)
    later = np.mean([f.value for f in fits[1:]], axis=0)
    difference = fits[0].value - later
    expected = noise.noise * count * fits[0].gain * (1 + 1 / (count - 1))
    good = (expected > 0) & (np.abs(later) > 0)
    if not good.any():
        return {"relative_difference": 0.0, "p_value": 1.0, "left_out": False}
    statistic = float(np.mean(np.abs(difference[good]) ** 2 / expected[good]))
    freedom = 2 * float(noise.degrees_of_freedom[good].sum())
    weight = np.abs(later[good]) ** 2 / expected[good]
    ratio = complex(np.sum(weight * difference[good] / later[good]) / weight.sum())
    return {
        "relative_difference": ratio.real,
        "relative_difference_imag": ratio.imag,
        "p_value": float(fdtrc(2 * int(good.sum()), freedom, statistic)),
        "left_out": False,
    }


def repeat_gains(fits: list[LocalFit], average: LocalFit) -> tuple[list[float], list[float]]:
    """Gain of each repeat's response against the average, and its standard deviation."""
    gains, errors = [], []
    for f in fits:
        good = f.variance > 0
        weight = np.where(good, 1 / np.where(good, f.variance, 1.0), 0.0)
        information = float(np.sum(weight * np.abs(average.value) ** 2))
        if information == 0:
            gains.append(1.0)
            errors.append(0.0)
            continue
        gains.append(float(np.sum(weight * (f.value * average.value.conj()).real)) / information)
        errors.append(float(np.sqrt(0.5 / information)))
    return gains, errors
