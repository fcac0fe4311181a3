"""One sweep over time: its input, its signals, how the features read a force. What elements add to its force: `sweep_courses`.

Signals are the positive frequencies of the sweep's band as complex samples, as many as the band has room for; their size is the
amplitude at each instant.
"""

from __future__ import annotations

import copy

import numpy as np
import scipy.fft

from pipeline.diagnose.features.kinds import FeatureBlock
from pipeline.diagnose.features.sweep_kernels import Piece, SweepReader
from pipeline.diagnose.simulation.nodes import interpolation
from schemas.arrays import Complex, Float, Int

_BELOW, _BEYOND = 8.0, 1.3
"""The band in which signals are made, below and over that of the sweep: what the input holds outside is noise. A sweep that begins
with its largest amplitude holds much below its first frequency."""
_ROOM = 1.25
"""Complex samples over the width of the band, so that products of signals have room."""


class SweepCourse:
    """The sweep of a response block. `frequency` (J,) Hz: the nodes at which responses are given."""

    def __init__(self, response: FeatureBlock, frequency: Float) -> None:
        support = response.support
        start, end, interval, low, high = support["piece"]
        self.piece = Piece(support["piece_mm"], int(start), int(end), float(interval), float(low), float(high))
        count, f = self.piece.input.size, response.frequency_hz[: response.size // 2]
        moment = support["piece_s"] / interval
        self.reader = SweepReader(self.piece, moment, f)
        bins = scipy.fft.rfftfreq(count, interval)
        inside = np.flatnonzero((bins >= low / _BELOW) & (bins <= high * _BEYOND))
        self._inside, self._bins = slice(int(inside[0]), int(inside[-1]) + 1), bins.size
        self._samples = scipy.fft.next_fast_len(int(np.ceil(_ROOM * inside.size)))
        self._inside_hz = bins[inside]
        self._from(frequency)
        rising = np.argsort(f)
        at = np.log(bins[inside])
        self._log_f, self._moment = np.log(f[rising]), moment[rising]
        turn = np.interp(at, self._log_f, support["turn_re"][rising]) + 1j * np.interp(
            at, self._log_f, support["turn_im"][rising]
        )
        self.input: Complex = turn * scipy.fft.rfft(self.piece.input)[self._inside]
        """(B,) spectrum of the input on the force's clock, mm"""
        in_time = np.argsort(moment)
        self._passes = moment[in_time], np.log(f[in_time])
        self.log_hz = np.interp(np.arange(self._samples) * (count / self._samples), *self._passes)
        """(T,) log frequency of the input at the complex samples"""
        self._unturned = np.exp(-1j * np.angle(self.signal(self.input)))

    def _from(self, frequency: Float, points: int = 4) -> None:
        self._nodes_from = int(frequency[0] <= 0)
        nodes = np.concatenate([[0.0], frequency[self._nodes_from :]])
        self._between = interpolation(nodes, self._inside_hz, points)

    def with_nodes(self, frequency: Float, points: int) -> SweepCourse:
        """The same with responses given at other nodes (J,), and polynomials through `points` of them."""
        other = copy.copy(self)
        other._from(frequency, points)
        return other

    def log_hz_of_samples(self) -> Float:
        """(n,) log frequency of the input at the samples of the piece."""
        return np.asarray(np.interp(np.arange(self.piece.input.size, dtype=float), *self._passes))

    @property
    def sizes(self) -> tuple[int, float, int, int]:
        """What sweeps have alike that are simulated at once: samples, their interval, the band."""
        return self.piece.input.size, self.piece.interval_s, self._inside.start, self._inside.stop

    def at_bins(self, values: Complex) -> Complex:
        """(n, B) values in the band from those at the nodes (n, J)."""
        nodes = values.T
        nodes = nodes if self._nodes_from else np.concatenate([nodes[:1], nodes])
        found = self._between @ np.ascontiguousarray(nodes).view(np.float64)
        return np.ascontiguousarray(found.view(np.complex128).T)

    def signal(self, spectrum: Complex) -> Complex:
        """(..., T) complex samples of a spectrum (..., B)."""
        scale = 2 * self._samples / self.piece.input.size
        return np.asarray(scipy.fft.ifft(spectrum, self._samples) * scale)

    def spectrum(self, signal: Complex) -> Complex:
        """(..., B) spectrum of complex samples (..., T)."""
        scale = self.piece.input.size / (2 * self._samples)
        return np.asarray(scipy.fft.fft(signal)[..., : self.input.size] * scale)

    def wave(self, spectrum: Complex) -> Float:
        """(..., n) real samples of a spectrum (..., B)."""
        whole = np.zeros((*spectrum.shape[:-1], self._bins), dtype=complex)
        whole[..., self._inside] = spectrum
        return np.asarray(scipy.fft.irfft(whole, self.piece.input.size))

    def instants(self, log_hz: Float) -> tuple[Int, Complex]:
        """Complex samples (C,) at which the sweep passes log frequencies (C,), and what turns a signal there to the input's phase."""
        scale = self._samples / self.piece.input.size
        at = np.interp(log_hz, self._log_f, self._moment * scale).round().astype(np.int64).clip(0, self._samples - 1)
        return at, self._unturned[at]
