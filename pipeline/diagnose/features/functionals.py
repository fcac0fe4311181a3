"""Linear functionals of records: values, noise covariance, and the operator that gives the same values from a response.

A feature is Σ w[n] y[n]. For y = G∗u with u known from the measurement, it is a linear function of the response G(jω) at the
nodes: transients, ends of the record and neighbouring lines are in it, nothing is assumed stationary. Pure array work;
which functionals a protocol has does not belong here.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.fft
import scipy.sparse

from pipeline.diagnose.simulation.nodes import interpolation
from schemas.arrays import Complex, Float

if TYPE_CHECKING:
    from scipy.signal import CZT


_NEGLIGIBLE = 3e-7
"""Share of the sum of a row's weights that may be dropped at least, smallest first."""
_SPLIT = (4.0, 24.0)
"""Turns per record between which the finer integration of the low frequencies ends."""
_FINER = 32
"""Frequencies of the finer integration over those of a plain transform."""
_SLOW_BINS = 24
"""Bins of a stretch below which coloured noise is integrated over the frequencies of the whole record instead."""
_BLENDED = 0.4, 1.0
"""Shares of these bins between which both are."""
_MAINS_SPREAD_HZ = 0.03
"""How far the frequency of mains is from its nominal value, as a standard deviation over a record: grids keep it that well."""
_LINE_NODES = 5
"""Nodes of the Gauss–Hermite rule over the frequency of the mains."""
_UNSEEN = 1e-9
"""Share of the largest product of functional and input below which a bin is left out of an operator."""
_DARK = 1e-16
"""Bins where no functional reaches this share of its largest power do not count for the noise."""


@dataclass(frozen=True)
class Component:
    """A part of the noise: channel, exponent e of its density f^−e, and what of it reaches the output.

    Density per sample: 1 for e = 0, (1 Hz/f)^e/(1 s/interval) else, so that coefficients are the variance of a sample, and
    the density per Hz at 1 Hz. `gain` (f in Hz → |transfer| from the channel to the output); None: 1. With `line_hz` it is a
    sinusoid of about that frequency and of any phase, and its coefficient the square of its amplitude.
    """

    quantity: str
    exponent: int
    gain: Callable[[Float], Float] | None = None
    line_hz: float | None = None

    @property
    def name(self) -> str:
        return f"{self.quantity}/{self.exponent}"


@dataclass(frozen=True)
class Operator:
    """values = re @ Re G + im @ Im G with G (J,) at the nodes; sparse (n, J) each."""

    re: scipy.sparse.csr_array
    im: scipy.sparse.csr_array

    def apply(self, response: Complex) -> Float:
        return np.asarray(self.re @ response.real + self.im @ response.imag)


class Functionals:
    """The functionals w (n, N), which are 0 outside `kernels` (n, M) at samples first … first + M − 1 of a record of N."""

    def __init__(self, kernels: Float, first: int, count: int, interval_s: float) -> None:
        self.kernels, self.first, self.count, self.interval_s = kernels, first, count, interval_s
        self.size = scipy.fft.next_fast_len(2 * count, real=True)
        self.frequency = np.arange(self.size // 2 + 1) / (self.size * interval_s)
        padded = np.zeros((kernels.shape[0], self.size))
        padded[:, first : first + kernels.shape[1]] = kernels
        self._spectrum: Complex = scipy.fft.rfft(padded, axis=1, overwrite_x=True)
        # The sum of the functionals' spectra, each of unit length, says where any of them sees.
        flat = self._spectrum.view(np.float64)
        size = 1 / np.maximum(np.einsum("ij,ij->i", kernels, kernels), 1e-300)
        both = np.einsum("i,ij,ij->j", size, flat, flat)
        self._loudness = np.sqrt(both[::2] + both[1::2])

    def values(self, output: Float) -> Float:
        """(n,) values of the functionals on a record (N,)."""
        return np.asarray(self.kernels @ output[self.first : self.first + self.kernels.shape[1]])

    def operator(
        self,
        input_: Float,
        nodes: Float,
        *,
        factor: Callable[[Float], Complex] | None = None,
        slow: bool = False,
        spectrum: Callable[[Float], Complex] | None = None,
        tolerance: Float | None = None,
    ) -> Operator:
        """Operator on the answer to `input_` (N,), at rest before its first sample.

        `factor` is what the channels do to the spectrum of the output (f in Hz → complex), such as a known delay. After its
        end the input goes back to rest smoothly; that shows after the record only. With `slow` the lowest frequencies are
        integrated 32 times finer, so that what relaxes over many times the record's length does not wrap around; inputs
        without a mean do not need it. `tolerance` (n,) is a sum of weights that may be dropped from a row. `spectrum` (f in Hz → Σ u e^{−2πjft}) replaces that of the samples where the input is
        known as a function of time.
        """
        count, size = self.count, self.size
        extended = np.zeros(size)
        extended[:count] = input_ - input_[0]
        back = (size - count) // 2
        extended[count : count + back] = extended[count - 1] * half_cosine(back)
        given = scipy.fft.rfft(extended) if spectrum is None else spectrum(self.frequency)
        given = given * (2 / size)
        given[0] /= 2
        if size % 2 == 0:
            given[-1] = 0.0
        given = given * (1 - self._split(self.frequency)) if slow else given
        if factor is not None:
            given = given * factor(self.frequency)
        # Most functionals know a part of the spectrum only.
        size_there = np.abs(given) * self._loudness
        seen = np.flatnonzero(size_there > _UNSEEN * size_there.max())
        product = np.conj(self._spectrum[:, seen]) * given[seen]
        weights = _transposed(nodes.tobytes(), self.size, self.interval_s, seen.tobytes())
        re, im = weights @ product.real.T, weights @ product.imag.T
        if slow:
            step = 1 / (_FINER * size * self.interval_s)
            fine = np.arange(int(_SPLIT[1] / (self.count * self.interval_s) / step) + 1) * step
            turns = step * self.interval_s
            rows = _zoom(self.kernels.shape[1], fine.size, turns)(self.kernels, axis=1)
            rows *= np.exp(-2j * np.pi * fine * self.first * self.interval_s)
            one = _zoom(extended.size, fine.size, turns)(extended) if spectrum is None else spectrum(fine)
            one *= self._split(fine) * 2 / size / _FINER
            one[0] /= 2
            product = rows.conj() * (one if factor is None else one * factor(fine))
            weights = interpolation(nodes, fine).T.tocsr()
            re, im = re + weights @ product.real.T, im + weights @ product.imag.T
        return Operator(_sparse(re.T, tolerance), _sparse(-im.T, tolerance))

    def _split(self, frequency: Float) -> Float:
        """1 below the frequencies that are integrated finely, 0 above, smooth between."""
        return _smooth_fall(frequency * self.count * self.interval_s, *_SPLIT)

    def covariances(self, components: Sequence[Component]) -> Float:
        """(components, n, n) covariance of the functionals for each part of the noise with coefficient 1.

        White noise exactly; coloured noise from its density: at the lowest frequencies, where the stretch that the functionals
        cover shows few periods, at those of twice the record, above as if it were periodic in that stretch.
        """
        frequency, part = self._bright()
        result = np.empty((len(components), part.shape[0], part.shape[0]))
        for i, c in enumerate(components):
            if c.line_hz is not None:
                result[i] = self._line(c)
                continue
            if c.exponent == 0 and c.gain is None:
                result[i] = self.kernels @ self.kernels.T
                continue
            density = np.ones_like(frequency) if c.exponent == 0 else frequency**-c.exponent / self.interval_s
            if c.gain is not None:
                density = density * c.gain(frequency) ** 2
            flat = np.ascontiguousarray(part * np.sqrt(density)).view(np.float64)
            result[i] = flat @ flat.T
        return result

    def _bright(self) -> tuple[Float, Complex]:
        """Frequencies (m,) in Hz and spectra (n, m) there, whose products times a density sum to a covariance."""
        size = scipy.fft.next_fast_len(self.kernels.shape[1], real=True)
        spectrum = scipy.fft.rfft(self.kernels, size, axis=1)
        edge = max(min(_SLOW_BINS, size // 4), 1)
        end = edge / size * self.size
        slow = int(np.ceil(end))
        # The fine bins give way to the coarse ones little by little: at a seam a functional of its frequency would be counted wrongly.
        fine = _smooth_fall(np.arange(1, slow) / end, *_BLENDED)
        coarse = 1 - _smooth_fall(np.arange(spectrum.shape[1]) / edge, *_BLENDED)
        spectrum *= np.sqrt(2 / size * coarse)
        if size % 2 == 0:
            spectrum[:, -1] /= np.sqrt(2)
        power = spectrum.real**2 + spectrum.imag**2
        low = self._spectrum[:, 1:slow] * np.sqrt(2 / self.size * fine)
        largest = np.maximum(power.max(axis=1), (low.real**2 + low.imag**2).max(axis=1))
        bright = np.flatnonzero((power > _DARK * largest[:, None]).any(axis=0))
        frequency = np.concatenate([self.frequency[1:slow], bright / (size * self.interval_s)])
        return frequency, np.concatenate([low, spectrum[:, bright]], axis=1)

    def _line(self, component: Component) -> Float:
        """(n, n) covariance that a sinusoid of amplitude 1 brings, its frequency normal about the nominal one."""
        frequency, weight = line_frequencies(component)
        time = (self.first + np.arange(self.kernels.shape[1])) * self.interval_s
        size = np.sqrt(weight / 2) * (1.0 if component.gain is None else component.gain(frequency))
        turn = 2 * np.pi * np.outer(time, frequency)
        seen = self.kernels @ np.concatenate([np.cos(turn) * size, np.sin(turn) * size], axis=1)
        return np.asarray(seen @ seen.T)


def line_frequencies(component: Component) -> tuple[Float, Float]:
    """Frequencies (m,) Hz and weights (m,), of sum 1, that stand for a sinusoid whose frequency wanders between records.

    ValueError for a component that is no sinusoid.
    """
    if component.line_hz is None:
        raise ValueError(f"{component.name} is no sinusoid")
    offset, weight = np.polynomial.hermite_e.hermegauss(_LINE_NODES)
    return component.line_hz + _MAINS_SPREAD_HZ * offset, weight / weight.sum()


@functools.lru_cache(maxsize=64)
def _transposed(nodes: bytes, size: int, interval_s: float, bins: bytes) -> scipy.sparse.csr_array:
    """(J, m) weights that gather bins (int64) of a transform of `size` samples at nodes (float64, Hz)."""
    frequency = np.frombuffer(bins, dtype=np.int64) / (size * interval_s)
    return interpolation(np.frombuffer(nodes), frequency).T.tocsr()


@functools.lru_cache(maxsize=16)
def _zoom(samples: int, count: int, step: float) -> CZT:
    """Transform of `samples` at `count` frequencies that are `step` cycles per sample apart, from 0 on."""
    from scipy.signal import CZT  # half a second, which most recordings need not wait for

    return CZT(samples, count, np.exp(-2j * np.pi * step))


def _sparse(dense: Float, tolerance: Float | None) -> scipy.sparse.csr_array:
    size = np.abs(dense)
    order = np.sort(size, axis=1)
    total = np.cumsum(order, axis=1)
    allowed = _NEGLIGIBLE * total[:, -1]
    if tolerance is not None:
        allowed = np.maximum(allowed, tolerance)
    dropped = (total <= allowed[:, None]).sum(axis=1)
    limit = order[np.arange(size.shape[0]), np.minimum(dropped, size.shape[1] - 1)]
    return scipy.sparse.csr_array(np.where(size >= limit[:, None], dense, 0.0))


def _smooth_fall(at: Float, start: float, end: float) -> Float:
    """1 up to `start`, 0 from `end` on, smooth between."""
    s = np.clip((at - start) / (end - start), 0, 1)
    return np.clip(1 - s**3 * (10 - 15 * s + 6 * s**2), 0, 1)


def half_cosine(count: int) -> Float:
    """A smooth fall from 1 to 0 over `count` samples."""
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.arange(1, count + 1) / (count + 1)))


def lines_spectrum(time_s: Float, value: Float, interval_s: float) -> Callable[[Float], Complex]:
    """Spectrum Σ u e^{−2πjft} of straight lines through (time, value) that begin and end at 0 (q,), as a sum over samples."""
    slopes = np.diff(value) / np.diff(time_s)
    changes = np.diff(np.concatenate([[0.0], slopes, [0.0]]))
    area = float(np.sum((value[1:] + value[:-1]) / 2 * np.diff(time_s)))

    def spectrum(frequency: Float) -> Complex:
        omega = 2 * np.pi * np.maximum(frequency, 1e-9)
        total = np.exp(-1j * np.outer(omega, time_s)) @ changes / -(omega**2)
        return np.asarray(np.where(frequency > 0, total, area) / interval_s)

    return spectrum


def stacked(kernels: Complex) -> Float:
    """Real functionals (2n, M) of complex ones (n, M): real parts of Σ w y first, then imaginary parts."""
    return np.concatenate([kernels.real, kernels.imag])
