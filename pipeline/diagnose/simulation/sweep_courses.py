"""Sweeps of equal length and band over time, all at once: how far the film is strained as they pass, what elements add to its force.

A sweep is through a resonance before that has built up, and the film still rings when the input has gone on: the amplitude at
any instant is not that of the steady wave at the input's frequency.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.diagnose.simulation.describing import Places, SweepTable
from pipeline.diagnose.simulation.sweep_course import SweepCourse
from pipeline.physics.rig import Rig
from schemas.arrays import Complex, Float, Int

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
