"""Sweeps over time: input and signals of one, how the features read a force, and of several of equal length and band at once how
far the film is strained as they pass and what elements add to its force.

Signals are the positive frequencies of the sweep's band as complex samples, as many as the band has room for; their size is the
amplitude at each instant. A sweep is through a resonance before that has built up, and the film still rings when the input has
gone on: the amplitude at any instant is not that of the steady wave at the input's frequency.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np
import scipy.fft

from pipeline.diagnose.features.kinds import FeatureBlock, read_clock
from pipeline.diagnose.features.sweep_kernels import Piece, SpectrumReader, SweepReader
from pipeline.diagnose.simulation.describing import Places, SweepTable
from pipeline.diagnose.simulation.nodes import interpolation
from pipeline.physics.rig import Rig
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
        self.piece = Piece(
            support["piece_mm"], int(start), int(end), float(interval), float(low), float(high), read_clock(support)
        )
        count, f = self.piece.input.size, response.frequency_hz[: response.size // 2]
        moment = support["piece_s"] / interval
        self._reader = SweepReader(self.piece, moment, f)
        bins = scipy.fft.rfftfreq(count, interval)
        inside = np.flatnonzero((bins >= low / _BELOW) & (bins <= high * _BEYOND))
        self._inside, self._bins = slice(int(inside[0]), int(inside[-1]) + 1), bins.size
        self._samples = scipy.fft.next_fast_len(int(np.ceil(_ROOM * inside.size)))
        self._inside_hz = bins[inside]
        self._spectrum_reader = SpectrumReader(self._reader, self._inside)
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

    def read(self, force: Float) -> Float:
        """(2 b + 2 h + 1,) real and imaginary parts of the responses and of the harmonics, and mean, of a force over time (n,), N."""
        response, harmonic = self._reader.read(force)
        mean = force[self.piece.start : self.piece.end].mean()
        return np.concatenate([response.real, response.imag, harmonic.real, harmonic.imag, [mean]])

    def read_spectrum(self, spectrum: Complex) -> Float:
        """The same of the spectrum of a force (B,), N."""
        return self._spectrum_reader.read(spectrum)

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


_ITERATIONS, _SETTLED = 20, 1e-6
"""Rounds in which the tension of a sweep is found, at most, and relative change that is none."""
_FALLING = 0.7
"""Change of a round over that of the one before above which the step is halved."""


class SweepCourses:
    """W sweeps; `log_hz` (C,): log frequencies at which elements are asked. Responses are (1 or W, B) in the band."""

    def __init__(self, courses: Sequence[SweepCourse], log_hz: Float) -> None:
        self.course = courses[0]
        """What all have alike: the bins of the band, the times of samples."""
        self.input: Complex = np.array([c.input for c in courses])
        """(W, B) spectra, mm"""
        self.places = Places.among(log_hz, np.array([c.log_hz for c in courses]))
        """(W, T) places of the complex samples among the frequencies"""
        at, unturned = zip(*(c.instants(log_hz) for c in courses), strict=True)
        self._at, self._unturned = np.array(at), np.array(unturned)

    def at_bins(self, *values: Complex) -> list[Complex]:
        """(n, B) each: values in the band from those at the nodes (n, J)."""
        edges = np.cumsum([len(v) for v in values])[:-1]
        return np.split(self.course.at_bins(np.concatenate(values)), edges)

    def passing(self, signal: Complex) -> Complex:
        """(W, C) signals (W, T) over the input's as the sweeps pass the frequencies: amplitude in mm or N, phase against it."""
        return np.asarray(np.take_along_axis(signal, self._at, axis=1) * self._unturned)

    def elongation(self, dynamic: Complex, k: Complex, rig: Rig) -> Complex:
        """(W, B) spectra of the linear film's elongation, mm: x0 D/(D + k/kL)."""
        return np.asarray(self.input * rig.extension(k, dynamic))

    def strained(
        self, dynamic: Complex, k: Complex, rig: Rig, table: SweepTable, length_mm: float, by_size: bool
    ) -> tuple[Complex, Complex]:
        """(W, B) spectra of the film's elongation, mm, and of what elements add to its tension, N. `by_size`: the amplitude is that
        of the tension over |k|.

        T = k e + Δ, Δ = (n − 1) k e at the amplitude of every instant, e = (D x0 − Δ/kL)/(D + k/kL), found together.
        """
        course, giving = self.course, rig.compliance / rig.loaded(k, dynamic)
        found: Complex = self.elongation(dynamic, k, rig)
        total = np.zeros_like(found)
        rows = np.arange(len(found))
        e, added, free = found, total, found.copy()
        step, before = np.ones(rows.size), np.full(rows.size, np.inf)
        per_strain = (
            1 / (table.stiff(self.places) * length_mm) if by_size else np.full(self.places.share.shape, 1 / length_mm)
        )
        for _ in range(_ITERATIONS):
            tension = course.signal(_of(k, rows) * e)
            amplitude = _size(tension if by_size else course.signal(e)) * per_strain[rows]
            wanted = course.spectrum((table.factor(amplitude, self.places.rows(rows)) - 1) * tension)
            added = added + step[:, None] * (wanted - added)
            new = free - added * _of(giving, rows)
            change = _size(new - e).max(axis=1) / _size(e).max(axis=1)
            found[rows], total[rows], e = new, added, new
            # A lightly damped resonance overshoots; where steps do not shrink they are made smaller.
            step = np.where(change < _FALLING * before, step, np.maximum(step / 2, 0.1))
            going = change >= _SETTLED
            if not going.any():
                break
            rows, e, added, free, step, before = (v[going] for v in (rows, e, added, free, step, change))
        return found, total


def _of(values: Complex, rows: Int) -> Complex:
    """Values (1 or W, B) of some sweeps."""
    return values if len(values) == 1 else values[rows]


def _size(values: Complex) -> Float:
    """|v|, without the care for numbers beyond all range that costs more than all else."""
    return np.asarray(np.sqrt(values.real**2 + values.imag**2))
