"""Periods of a periodic signal: where they are, the spectrum of each at the exact lines of the period, and the best linear
approximation from them, with noise and stochastic nonlinearity told apart.

The period need not be a whole number of samples: lines are then solved for together instead of leaking into each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from scipy.linalg import solve_toeplitz

from schemas.arrays import Complex, Float, Int

_WHOLE = 1e-3
"""Samples by which a period may miss a whole number and be transformed as if it did not."""


def period_starts(onset: float, period: float, count: int, samples: int) -> Int:
    """First sample of each period (count,), the sample nearest to its true start; all lie within `samples`."""
    starts: Int = np.rint(onset + np.arange(count) * period).astype(np.int64)
    return starts[starts + round(period) <= samples]


def line_spectra(values: Float, starts: Int, onset: float, period: float, lines: int) -> Complex:
    """Amplitudes of the lines 0 … lines − 1 of each period, (periods, lines) complex.

    Phasors e^{+jωt} with the time counted from the exact start of each period, `onset` + p `period` samples. A line l of
    amplitude A is A cos(2π l t/period + φ) → A e^{jφ}; line 0 is the mean.
    """
    length = round(period)
    pieces = values[starts[:, None] + np.arange(length)]
    if abs(period - length) <= _WHOLE:
        spectra = scipy.fft.rfft(pieces, axis=1)[:, :lines] / length
    else:
        spectra = _exact(pieces, period, lines)
    spectra[:, 1:] *= 2
    late = starts - (onset + np.rint((starts - onset) / period) * period)
    return np.asarray(spectra * np.exp(-2j * np.pi * np.outer(late, np.arange(lines)) / period))


def _exact(pieces: Float, period: float, lines: int) -> Complex:
    """Least squares of pieces of a whole number of samples on e^{j2πln/period}, |l| < lines: a Toeplitz system."""
    from scipy.signal import czt  # half a second, which most recordings need not wait for

    length = pieces.shape[1]
    k = np.arange(2 * lines - 1)
    turn = np.exp(-2j * np.pi / period)
    right = np.array([czt(p, m=2 * lines - 1, w=turn, a=turn ** (lines - 1)) for p in pieces])
    # Sum over the samples of e^{−j2πkn/period}, a geometric series.
    step = np.expm1(-2j * np.pi * k[1:] / period)
    column = np.concatenate([[length], np.expm1(-2j * np.pi * k[1:] * length / period) / step])
    solution = solve_toeplitz((column, column.conj()), right.T)
    return np.asarray(solution[lines - 1 :].T)


def without_drift(values: Float, starts: Int, period: float) -> tuple[Float, float]:
    """The signal without the straight lines through the means of its periods, and the drift from first to last mean.

    A mean over a period holds nothing of the lines, so that only what is slower than the period is taken out.
    """
    if starts.size < 2:
        return values, 0.0
    length = round(period)
    means = values[starts[:, None] + np.arange(length)].mean(axis=1)
    centres = starts + (length - 1) / 2
    index = np.arange(values.size)
    line = np.interp(index, centres, means)
    before, after = index < centres[0], index > centres[-1]
    line[before] += (index[before] - centres[0]) * (means[1] - means[0]) / (centres[1] - centres[0])
    line[after] += (index[after] - centres[-1]) * (means[-1] - means[-2]) / (centres[-1] - centres[-2])
    return values - line, float(means[-1] - means[0])


def excited_lines(amplitude: Float, first: int, last: int, *, kind: str | None, least: float) -> Int:
    """Lines first … last that the input excites.

    A line is excited when it reaches a third of the largest within ten lines and the share `least` of the largest of all,
    among those that `kind` (`full`, `odd`, `random_odd`) allows; without `kind` even lines are left out when hardly any is
    excited.
    """
    lines: Int = np.arange(first, min(last, amplitude.size - 1) + 1)
    if kind in ("odd", "random_odd"):
        lines = lines[lines % 2 == 1]
    size = amplitude[lines]
    if size.size == 0 or size.max() == 0:
        return lines[:0]
    near = np.array([size[np.abs(lines - k) <= 10].max() for k in lines])
    found: Int = lines[(size >= near / 3) & (size >= least * size.max())]
    if kind is None and (found % 2 == 0).mean() < 0.1:
        found = found[found % 2 == 1]
    return found


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
