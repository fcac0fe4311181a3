"""What a sweep is read with: kernels of its bands and of its harmonics, from the input alone.

Features are products of these with the force. A simulation that has to have the force over time, as for a reading that bends,
makes them again. Noise and operators of the features stand in `features_chirp`.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from pipeline.diagnose.features.functionals import half_cosine
from pipeline.diagnose.features.noise_density import MAINS_HZ
from pipeline.diagnose.features.records import polynomials
from schemas.arrays import Bool, Complex, Float, Int

BANDS = 40
"""Bands of frequency, evenly spaced in the logarithm, into which a sweep is cut."""
WITHIN = 9
"""Frequencies within a window at which its harmonics are predicted, odd."""
_FEWEST_BINS = 2
"""Spectral bins that a band has at least."""
_DEGREE = 3
"""Degree of the drift that the response of a band does not see."""
_HARMONIC_RATIO = 1.45
"""Ratio of frequencies at the ends of a window for harmonics."""
_HARMONIC_CYCLES = 4.0
"""Cycles in such a window at least."""
_ENVELOPE_CYCLES = 1.0
"""Cycles on either side over which the amplitude of a sweep is taken."""


@dataclass(frozen=True)
class Piece:
    """A sweep with the rest about it: input mm (n,), samples start…end−1 in which it moves, its band in Hz.

    `clock`: true frequencies over those that were claimed when the mains were left out.
    """

    input: Float
    start: int
    end: int
    interval_s: float
    low_hz: float
    high_hz: float
    clock: float = 1.0


@dataclass(frozen=True)
class Bands:
    """What a sweep has at each band (b,): kernels (b, n), frequency Hz, instant (samples of the piece), amplitude mm."""

    kernels: Complex
    frequency: Float
    moment: Float
    amplitude: Float


@dataclass(frozen=True)
class Harmonics:
    """Kernels (h, n) of harmonics `order` (h,) in windows, and the frequencies Hz within each (h, WITHIN)."""

    kernels: Complex
    order: Int
    within: Float


@dataclass(frozen=True)
class _Cut:
    """The input's spectrum (n,) without mains, bins that begin bands and the end of the last, the bands that hold anything."""

    spectrum: Complex
    edges: Int
    kept: Bool

    @property
    def parts(self) -> Complex:
        """(b, n) the spectrum of each band alone."""
        parts = np.zeros((self.edges.size - 1, self.spectrum.size), dtype=complex)
        for row, first, stop in zip(parts, self.edges[:-1], self.edges[1:], strict=True):
            row[first:stop] = self.spectrum[first:stop]
        return parts[self.kept]


@dataclass(frozen=True)
class _Windows:
    """Windows edges[i]…edges[i + 1]−1 of harmonics: phase of the input (n,), number of the window and order of each (h,)."""

    phase: Float
    edges: Int
    number: Int
    order: Int
    within: Float

    @property
    def kernels(self) -> Complex:
        """(h, n) a Hann window that turns with each harmonic."""
        kernels = np.zeros((self.number.size, self.phase.size), dtype=complex)
        for row, number, m in zip(kernels, self.number, self.order, strict=True):
            a, b = self.edges[number : number + 2]
            window = _hann(b - a)
            row[a:b] = 2 * window * np.exp(-1j * m * self.phase[a:b]) / window.sum()
        return kernels


def bands_of(piece: Piece) -> Bands:
    """Bands of equal width in log frequency, as far as the sweep is long enough for that."""
    u = piece.input
    cut = _cut(piece)
    frequency = np.arange(u.size) / (u.size * piece.interval_s)
    parts = cut.parts
    power = np.abs(parts) ** 2
    centre = power @ frequency / power.sum(axis=1)
    parts = scipy.fft.ifft(parts, axis=1, overwrite_x=True)
    energy = np.abs(parts) ** 2
    moment = energy @ np.arange(u.size) / energy.sum(axis=1)
    taper = _taper(piece)
    kernels = _without_drift(parts.conj() * taper, taper)
    kernels /= (kernels @ u)[:, None]
    return Bands(kernels, centre, moment, _amplitudes(np.abs(_analytic(u)), piece, moment, centre * piece.interval_s))


def harmonics_of(piece: Piece, bands: Bands) -> Harmonics | None:
    """Second and third harmonic in Hann windows of at least four cycles; None where the sweep is too short for them."""
    found = _windows(piece, bands.moment, bands.frequency)
    if found is None:
        return None
    return Harmonics(_without_drift(found.kernels, _taper(piece)), found.order, found.within)


class SweepReader:
    """What the kernels of a sweep make of any force over time, without the kernels: products of spectra and of windows."""

    def __init__(self, piece: Piece, moment: Float, frequency: Float) -> None:
        """`moment`, `frequency`: of the bands."""
        self._cut = _cut(piece)
        self._conjugate = self._cut.spectrum[: self._cut.edges[-1]].conj()
        self._windows = _windows(piece, moment, frequency)
        self._taper, self._moving = _taper(piece), slice(piece.start, piece.end)
        slow = polynomials(piece.input.size, _DEGREE)
        self._tapered = slow * self._taper
        if self._windows is not None:
            turns = np.exp(-1j * np.outer((2, 3), self._windows.phase))
            edges = self._windows.edges
            window = np.concatenate([_hann(b - a) * 2 / _hann(b - a).sum() for a, b in itertools.pairwise(edges)])
            self._turned = turns[:, edges[0] : edges[-1]] * window
        moments = self._tapered @ slow.T
        raw = [self._raw(row) for row in slow]
        self._slow = [np.linalg.solve(moments, np.array([r[i] for r in raw])) for i in (0, 1)]
        self._norm = np.ones(int(self._cut.kept.sum()), dtype=complex)
        self._norm = self.read(piece.input)[0]

    def read(self, force: Float) -> tuple[Complex, Complex]:
        """Responses (b,) and harmonics (h,) of a force (n,), as the kernels' products with it."""
        drift = self._tapered @ force
        response, harmonic = (r - drift @ slow for r, slow in zip(self._raw(force), self._slow, strict=True))
        return np.asarray(response / self._norm), np.asarray(harmonic)

    @property
    def kernels(self) -> Float:
        """(2 b + 2 h + 1, n) kernels of the real and imaginary parts of the responses and of the harmonics, and of the mean force while
        the sweep moves."""
        response = (
            _without_drift(scipy.fft.ifft(self._cut.parts).conj() * self._taper, self._taper) / self._norm[:, None]
        )
        windows = np.zeros((0, self._taper.size), dtype=complex) if self._windows is None else self._windows.kernels
        harmonic = _without_drift(windows, self._taper)
        mean = np.zeros((1, self._taper.size))
        mean[:, self._moving] = 1 / (self._moving.stop - self._moving.start)
        return np.concatenate([response.real, response.imag, harmonic.real, harmonic.imag, mean])

    def _raw(self, force: Float) -> tuple[Complex, Complex]:
        cut, n = self._cut, force.size
        product = self._conjugate * scipy.fft.rfft(self._taper * force)[: self._conjugate.size]
        response: Complex = np.asarray(np.add.reduceat(product, cut.edges[:-1])[cut.kept] / n, dtype=complex)
        found = self._windows
        if found is None:
            return response, np.zeros(0, dtype=complex)
        edges = found.edges
        sums: Complex = np.add.reduceat(self._turned * force[edges[0] : edges[-1]], edges[:-1] - edges[0], axis=1)
        return response, np.asarray(sums[found.order - 2, found.number])


class SpectrumReader:
    """What a reader makes of forces that are nothing but some bins of a spectrum: one product with weights, made when it is first asked."""

    def __init__(self, reader: SweepReader, inside: slice) -> None:
        """`inside`: the bins (B,)."""
        self._reader, self._inside = reader, inside

    def read(self, spectrum: Complex) -> Float:
        """(2 b + 2 h + 1,) of the bins (B,) of a force's spectrum: real and imaginary parts of the responses, of the harmonics, and the
        mean force while the sweep moves."""
        return np.asarray(self._weights @ spectrum.view(np.float64))

    @cached_property
    def _weights(self) -> Float:
        """(2 b + 2 h + 1, 2 B) of real and imaginary parts, which stand side by side."""
        kernels = self._reader.kernels
        count, seen = kernels.shape[1], scipy.fft.rfft(kernels)
        # Every bin but the first and the one at half the rate stands for its negative frequency as well.
        times = np.full(seen.shape[1], 2.0)
        times[0] = 1.0
        if count % 2 == 0:
            times[-1] = 1.0
        return np.ascontiguousarray((seen * (times / count))[:, self._inside]).view(np.float64)


def _cut(piece: Piece) -> _Cut:
    duration = piece.input.size * piece.interval_s
    spectrum = scipy.fft.fft(piece.input)
    frequency = np.arange(piece.input.size) / duration
    for mains in MAINS_HZ:
        spectrum[np.abs(frequency - mains * piece.clock) < 1.01 / duration] = 0.0
    edges = _edges(piece.low_hz, piece.high_hz, duration)
    kept = np.array([np.any(spectrum[a:b] != 0) for a, b in itertools.pairwise(edges)])
    return _Cut(spectrum, edges, kept)


def _windows(piece: Piece, moment: Float, frequency: Float) -> _Windows | None:
    """Each window a factor of frequency wide, and some cycles long."""
    order = np.argsort(moment)
    time, f = moment[order], frequency[order]
    if time.size < 4 or not (np.diff(f) > 0).mean() > 0.7:
        return None
    edges, last = [int(time[0])], int(time[-1])
    while edges[-1] < last:
        at = float(np.interp(edges[-1], time, f))
        by_ratio = float(np.interp(at * _HARMONIC_RATIO, f, time))
        by_cycles = edges[-1] + _HARMONIC_CYCLES / (at * piece.interval_s)
        step = int(max(by_ratio, by_cycles, edges[-1] + 8))
        edges.append(last if last - step < 0.5 * (step - edges[-1]) else step)
    within = np.array([np.interp(np.linspace(a, b, WITHIN + 2)[1:-1], time, f) for a, b in itertools.pairwise(edges)])
    kept = [(m, i) for m in (2, 3) for i, inside in enumerate(within) if m * inside.max() <= 0.4 / piece.interval_s]
    if not kept:
        return None
    orders, number = np.array(kept).T
    phase = np.unwrap(np.angle(_analytic(piece.input)))
    return _Windows(phase, np.array(edges), number, orders, within[number])


def _hann(count: int) -> Float:
    return np.asarray(0.5 - 0.5 * np.cos(2 * np.pi * (np.arange(count) + 0.5) / count))


def _edges(low: float, high: float, duration_s: float) -> Int:
    """Bins that begin each band, and the end of the last: log-spaced, at least two bins each."""
    first, last = max(int(np.ceil(low * duration_s)), 1), int(np.floor(high * duration_s))
    edges = [first]
    for edge in np.rint(np.geomspace(first, last + 1, BANDS + 1)[1:]).astype(int):
        if edge >= edges[-1] + _FEWEST_BINS:
            edges.append(int(edge))
    if edges[-1] < last + 1:
        edges[-1] = last + 1
    return np.array(edges, dtype=np.int64)


def _analytic(u: Float) -> Complex:
    spectrum = scipy.fft.fft(u)
    spectrum[u.size // 2 :] = 0.0
    return np.asarray(2 * scipy.fft.ifft(spectrum))


def _amplitudes(envelope: Float, piece: Piece, moment: Float, turns: Float) -> Float:
    """Amplitude of the input within a cycle before and after each moment, of `turns` per sample, while it moves."""
    total = np.concatenate([[0.0], np.cumsum(envelope)])
    a = np.clip(np.rint(moment - _ENVELOPE_CYCLES / turns), piece.start, piece.end - 2).astype(int)
    b = np.clip(np.rint(moment + _ENVELOPE_CYCLES / turns), a + 2, piece.end).astype(int)
    return np.asarray((total[b] - total[a]) / (b - a))


def _taper(piece: Piece) -> Float:
    """1 while the sweep moves, falling smoothly to 0 at the ends of the rest around it: a functional then has no far lobes."""
    taper = np.ones(piece.input.size)
    after = taper.size - piece.end
    taper[: piece.start] = half_cosine(piece.start)[::-1]
    taper[taper.size - after :] *= half_cosine(after)
    return taper


def _without_drift(kernels: Complex, taper: Float) -> Complex:
    """Kernels (n, N) that a polynomial in time does not move; what is taken off has the taper as well."""
    slow = polynomials(taper.size, _DEGREE)
    tapered = slow * taper
    return np.asarray(kernels - np.linalg.solve(tapered @ slow.T, (kernels @ slow.T).T).T @ tapered)
