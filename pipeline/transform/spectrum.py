"""Discrete Fourier transforms of long records of which only the low bins are wanted."""

from __future__ import annotations

import numpy as np
import scipy.fft

from schemas.arrays import Complex, Float

_WORTH_SPLITTING = 100_000
_BATCH = 25
"""Short transforms at a time: their work space stays in the processor's cache."""


def length_for(samples: int, bins: int) -> int:
    """How many of `samples` the transform for `bins` low bins uses: all, or a few less where that is much faster."""
    split = _split(samples, bins)
    return samples if split is None else split[0] * split[1]


def low_bins(values: Float, bins: int, *, whole: bool = False) -> Complex:
    """Bins 0 … bins − 1 of the discrete Fourier transform of `length_for(n, bins)` leading samples, (bins,) complex.

    A transform of n = P Q samples is Q transforms of length P, of which only the wanted bins are put together: exact, and
    several times faster than the whole transform of a long record. `whole` uses every sample, as a period needs it.
    """
    split = None if whole else _split(values.size, bins)
    if split is None:
        return np.asarray(scipy.fft.rfft(values)[:bins])
    length, parts = split
    table = values[: length * parts].reshape(length, parts)
    turn = np.exp(-2j * np.pi * np.arange(bins) / (length * parts))
    total = np.zeros(bins, dtype=complex)
    # Horner's scheme over the parts: one complex product per bin and part.
    for stop in range(parts, 0, -_BATCH):
        first = max(stop - _BATCH, 0)
        spectra = scipy.fft.rfft(np.ascontiguousarray(table[:, first:stop].T), axis=1)
        for row in spectra[::-1]:
            total *= turn
            total += row[:bins]
    return total


def _split(samples: int, bins: int) -> tuple[int, int] | None:
    """(P, Q) with P Q just below `samples`; None where the whole transform is as good."""
    most = samples // max(2 * bins, 1024)
    if samples < _WORTH_SPLITTING or most < 4:
        return None
    parts = range(max(4, most // 2), most + 1)
    lengths = [int(scipy.fft.prev_fast_len(samples // q, real=True)) for q in parts]
    best = max(range(len(lengths)), key=lambda i: lengths[i] * parts[i])
    return lengths[best], parts[best]


def ramp_bins(samples: int, bins: int) -> Complex:
    """Transform of 0, 1, 2, … n − 1 at the bins 0 … bins − 1."""
    k = np.arange(bins)
    result = np.empty(bins, dtype=complex)
    result[0] = samples * (samples - 1) / 2
    result[1:] = samples / np.expm1(-2j * np.pi * k[1:] / samples)
    return result


def delay_between(spectrum: Complex, reference: Complex, frequency: Float) -> float:
    """By how many seconds `spectrum` is later than `reference`, from the slope of the phase between them.

    All (n,); products of the two weigh the lines, those at frequency 0 are left out.
    """
    cross = spectrum * reference.conj()
    weight = np.abs(cross)
    weight[frequency == 0] = 0.0
    delay = 0.0
    # Low frequencies first: their phase does not wrap, and the next octave then needs a small correction only.
    order = np.flatnonzero(weight > 0)
    if order.size == 0:
        return 0.0
    stop = max(8, order.size // 16)
    while True:
        part = order[:stop]
        omega = 2 * np.pi * frequency[part]
        angle = np.angle(cross[part] * np.exp(1j * omega * delay))
        delay -= float(np.sum(weight[part] * omega * angle) / np.sum(weight[part] * omega**2))
        if stop >= order.size:
            return delay
        stop *= 2
