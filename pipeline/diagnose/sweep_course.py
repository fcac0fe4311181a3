"""One sweep over time: how far the film is strained as it passes, what elements add to its force, how the features read a force.

A sweep is through a resonance before that has built up, and the film still rings when the input has gone on: the amplitude at
any instant is not that of the steady wave at the input's frequency. Signals are the positive frequencies of the sweep's band as
complex samples, as many as the band has room for; their size is the amplitude at each instant.
"""

from __future__ import annotations

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from pipeline.diagnose.describing import Places, SweepTable
from pipeline.diagnose.features import FeatureBlock
from pipeline.diagnose.nodes import interpolation
from pipeline.diagnose.sweep_kernels import Piece, SweepReader

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

_BEYOND = 1.3
"""The band in which signals are made, over that of the sweep: what the input holds outside is noise."""
_ROOM = 1.25
"""Complex samples over the width of the band, so that products of signals have room."""
_ITERATIONS, _SETTLED = 20, 1e-6
_FALLING = 0.7


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
        inside = np.flatnonzero((bins >= low / _BEYOND) & (bins <= high * _BEYOND))
        self._inside, self._bins = slice(int(inside[0]), int(inside[-1]) + 1), bins.size
        self._samples = scipy.fft.next_fast_len(int(np.ceil(_ROOM * inside.size)))
        self._nodes_from = int(frequency[0] <= 0)
        self._between = interpolation(np.concatenate([[0.0], frequency[self._nodes_from :]]), bins[inside])
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

    def log_hz_of_samples(self) -> Float:
        """(n,) log frequency of the input at the samples of the piece."""
        return np.asarray(np.interp(np.arange(self.piece.input.size, dtype=float), *self._passes))

    def at_bins(self, *values: Complex) -> list[Complex]:
        """(B,) each: values in the band from those at the nodes (J,)."""
        nodes = np.array(values).T
        nodes = nodes if self._nodes_from else np.concatenate([nodes[:1], nodes])
        found = self._between @ np.ascontiguousarray(nodes).view(np.float64)
        return list(np.ascontiguousarray(found.view(np.complex128).T))

    def signal(self, spectrum: Complex) -> Complex:
        """(T,) complex samples of a spectrum (B,)."""
        scale = 2 * self._samples / self.piece.input.size
        return np.asarray(scipy.fft.ifft(spectrum, self._samples) * scale)

    def spectrum(self, signal: Complex) -> Complex:
        """(B,) spectrum of complex samples (T,)."""
        scale = self.piece.input.size / (2 * self._samples)
        return np.asarray(scipy.fft.fft(signal)[: self.input.size] * scale)

    def wave(self, spectrum: Complex) -> Float:
        """(n,) real samples of a spectrum (B,)."""
        whole = np.zeros(self._bins, dtype=complex)
        whole[self._inside] = spectrum
        return np.asarray(scipy.fft.irfft(whole, self.piece.input.size))

    def passing(self, signal: Complex, log_hz: Float) -> Complex:
        """(C,) a signal (T,) over the input's as the sweep passes log frequencies (C,): amplitude in mm or N, phase against it."""
        scale = self._samples / self.piece.input.size
        at = np.interp(log_hz, self._log_f, self._moment * scale).round().astype(np.int64).clip(0, self._samples - 1)
        return np.asarray(signal[at] * self._unturned[at])

    def elongation(self, dynamic: Complex, k: Complex, compliance: float) -> Complex:
        """(B,) spectrum of the linear film's elongation, mm: x0 D/(D + k/kL)."""
        return np.asarray(self.input * dynamic / (dynamic + k * compliance))

    def strained(
        self,
        dynamic: Complex,
        k: Complex,
        compliance: float,
        table: SweepTable,
        places: Places,
        length_mm: float,
        by_size: bool,
    ) -> tuple[Complex, Complex]:
        """(B,) spectra of the film's elongation, mm, and of what elements add to its tension, N. `places`: of `log_hz` in the table;
        `by_size`: the amplitude is that of the tension over |k|.

        T = k e + Δ, Δ = (n − 1) k e at the amplitude of every instant, e = (D x0 − Δ/kL)/(D + k/kL), found together.
        """
        closing = dynamic + k * compliance
        free = self.elongation(dynamic, k, compliance)
        e, added = free, np.zeros_like(free)
        step, before = 1.0, np.inf
        stiffness = table.stiff(places)
        for _ in range(_ITERATIONS):
            tension = self.signal(k * e)
            amplitude = (np.abs(tension) / stiffness if by_size else np.abs(self.signal(e))) / length_mm
            wanted = self.spectrum((table.factor(amplitude, places) - 1) * tension)
            added = added + step * (wanted - added)
            new = free - added * compliance / closing
            change = float(np.abs(new - e).max() / np.abs(e).max())
            e = new
            if change < _SETTLED:
                break
            # A lightly damped resonance overshoots; where steps do not shrink they are made smaller.
            step = step if change < _FALLING * before else max(step / 2, 0.1)
            before = change
        return e, added
