"""Where a sweep excites: lines at which the input stands above its own noise and above a hundredth of what it has elsewhere.

Noise on the input draws an estimate towards zero, which no residual shows; so weak lines are no response, however small their
standard error. Does not belong here: noise on the output (`quality`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.transform import local_polynomial
from pipeline.transform.response import FrequencyResponse
from pipeline.transform.sweeps import Slices
from schemas.arrays import Complex, Float, Int

_WEAK_INPUT = 0.1
"""Input spectrum below this share (−20 dB) of its median in the band is no excitation."""
_NOISY_INPUT = 0.1
"""Share of noise in the power of the input (−10 dB) from which on it is no excitation."""
_FEWEST_AT_REST = 64
_FEWEST_BINS = 5


def window_power(spectrum: Complex, lines: Int, half_width: Int) -> Float:
    """Mean |U|² over the windows, (L,)."""
    window = local_polynomial.windows(lines, half_width, spectrum.size)
    return np.asarray((np.abs(spectrum[window.index] * window.inside) ** 2).sum(axis=1) / window.inside.sum(axis=1))


def input_noise(x: Float, pieces: Slices, band: tuple[float, float], interval_s: float, count: int) -> float:
    """E|U|² per bin of what the input shows in the band while it rests before the sweep, for a piece of `count` samples.

    0 where there is too little rest to tell.
    """
    first = pieces.first[0]
    rest = x[first : first + pieces.rest_before * 3 // 4]
    rest = rest[np.isfinite(rest)]
    if rest.size < _FEWEST_AT_REST:
        return 0.0
    power = np.abs(np.fft.rfft(rest - rest.mean())) ** 2
    frequency = np.fft.rfftfreq(rest.size, interval_s)
    inside = (frequency > 0) & (frequency >= band[0]) & (frequency <= band[1])
    chosen = inside if inside.sum() >= _FEWEST_BINS else frequency > 0
    return float(power[chosen].mean()) / rest.size * count


def mark_weak(
    response: FrequencyResponse, spectrum: Complex, lines: Int, half_width: Int, noise: float
) -> FrequencyResponse:
    """Marks lines that the input does not excite; what its noise takes from the others goes into the variance.

    Noise on the input draws the estimate towards zero by its share of the power, which no residual shows.
    """
    power = window_power(spectrum, lines, half_width)
    share = noise / np.maximum(power, np.finfo(float).tiny)
    bias = np.abs(response.value) ** 2 * np.minimum(share, 1.0) ** 2
    response = replace(response, variance=response.variance + bias)
    response = response.mark(share > _NOISY_INPUT, "no excitation: the input is not 10 dB above its own noise")
    return response.mark(
        power < _WEAK_INPUT**2 * np.median(power), "no excitation: input 20 dB below its median in the band"
    )
