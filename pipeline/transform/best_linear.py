"""Best linear approximation from the periods of multisines, with noise and stochastic nonlinearity told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.arrays import Complex, Float

_SMOOTHED_OVER = 5
_FEW_PERIODS = 10


@dataclass(frozen=True)
class BestLinear:
    """Best linear approximation at L lines, from M realisations of several periods each.

    value : (L,) complex
    noise_variance : (L,) of `value` by noise that changes from period to period
    variance : (L,) of `value` by everything; NaN where a single period tells nothing
    distortion_variance : (L,) level of stochastic nonlinearity of one realisation, NaN with a single one
    degrees_of_freedom : complex ones, of `noise_variance` at one line
    output_noise : (L,) variance of the averaged output by noise
    """

    value: Complex
    noise_variance: Float
    variance: Float
    distortion_variance: Float
    degrees_of_freedom: float
    output_noise: Float


def best_linear_approximation(input_: list[Complex], output: list[Complex]) -> BestLinear:
    """Best linear approximation from spectra of settled periods.

    `input_` and `output` have an array (periods, L) per realisation. G[m] = ⟨Y⟩/⟨U⟩ over the periods, with the noise
    σ_n²[m] = Σ_p |Y_p − G U_p|²/(P(P−1)|⟨U⟩|²); G is the mean over realisations, σ_G² its scatter over M(M−1), and the
    level of stochastic nonlinearity M (σ_G² − ⟨σ_n²⟩/M). With few periods the noise is smoothed over five lines.
    """
    values, noises, outputs = [], [], []
    freedom = 0.0
    for u, y in zip(input_, output, strict=True):
        periods = u.shape[0]
        mean_u, mean_y = u.mean(axis=0), y.mean(axis=0)
        g = mean_y / mean_u
        values.append(g)
        if periods < 2:
            outputs.append(np.full(g.shape, np.nan))
            noises.append(np.full(g.shape, np.nan))
            continue
        rest = y - g * u
        power = (np.abs(rest) ** 2).sum(axis=0) / (periods * (periods - 1))
        freedom += periods - 1
        if periods <= _FEW_PERIODS:
            power = smoothed(power)
        outputs.append(power)
        noises.append(power / np.abs(mean_u) ** 2)
    if 0 < freedom <= _FEW_PERIODS - 1:
        freedom *= min(_SMOOTHED_OVER, values[0].size)
    count = len(values)
    g = np.mean(values, axis=0)
    noise = np.sum(noises, axis=0) / count**2
    output_noise = np.sum(outputs, axis=0) / count**2
    if count == 1:
        return BestLinear(g, noise, noise, np.full(g.shape, np.nan), freedom, output_noise)
    total = (np.abs(np.array(values) - g) ** 2).sum(axis=0) / (count * (count - 1))
    total = smoothed(total) if count <= _FEW_PERIODS else total
    nonlinear = count * (total - np.where(np.isfinite(noise), noise, 0.0))
    return BestLinear(g, noise, np.fmax(total, noise), np.maximum(nonlinear, 0.0), freedom, output_noise)


def smoothed(values: Float) -> Float:
    """Running mean over five lines, over fewer at the ends."""
    kernel = np.ones(min(_SMOOTHED_OVER, values.size))
    return np.asarray(np.convolve(values, kernel, mode="same") / np.convolve(np.ones_like(values), kernel, mode="same"))
