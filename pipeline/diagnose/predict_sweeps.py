"""Prediction of sweeps: linear responses through the operators; elements and readings over time, as the sweep passes.

What elements make of a wave of any amplitude is tabulated at a few frequencies; every sweep then looks its own amplitude up at
each instant (`sweep_course`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.base import Physical
from pipeline.diagnose.describing import Loads, Places, SweepTable, sweep_table
from pipeline.diagnose.effects import NONE, BySize, Effect, View, bent
from pipeline.diagnose.families import rig_of
from pipeline.diagnose.features import CHIRP_HARMONIC, CHIRP_LEVEL, CHIRP_RESPONSE
from pipeline.diagnose.predict_mechanical import Linear, MechanicalFamily, channels
from pipeline.diagnose.session import Place, Session
from pipeline.diagnose.sweep_course import SweepCourse

Float = NDArray[np.float64]
Complex = NDArray[np.complex128]

SWEEP = "sweep"
_COARSE = 24
"""Log-spaced and, beside them, evenly counted nodes at which elements are asked."""


@dataclass(frozen=True)
class _Sweep:
    """A sweep's course, where its instants lie among the coarse frequencies, its response, the other features that it makes, number of
    its state."""

    course: SweepCourse
    places: Places
    response: Place
    others: tuple[Place, ...]
    state: int


@dataclass(frozen=True)
class _Seen:
    """Weights of the coarse frequencies in a block (n, C): of shifts of the mean force, and of harmonics `order` (h,)."""

    mean: Float | None
    harmonic: Float
    order: NDArray[np.int64]


@dataclass(frozen=True)
class _Passed:
    """What elements add to a sweep: force spectrum (B,), N; mean (C,) and harmonics 2 and 3 (2, C) of the force at coarse frequencies."""

    force: Complex
    mean: Float
    harmonic: Complex


class SweepFamily(MechanicalFamily):
    """Blocks of sweeps."""

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float) -> None:
        super().__init__(session, places, nodes, SWEEP)
        self._coarse = self._coarse_view()
        self._log_hz: Float = np.log(self._coarse.frequency_hz[0])
        self._at_log_hz = Places.among(self._log_hz, self._log_hz)

    def _coarse_view(self) -> View:
        bands = [p.block.frequency_hz for p in self.places if p.block.kind == CHIRP_RESPONSE]
        low, high = (min(float(b.min()) for b in bands), max(float(b.max()) for b in bands)) if bands else (0.0, np.inf)
        inside = np.flatnonzero((self.frequency >= low) & (self.frequency <= high))
        spaced = np.searchsorted(self.frequency[inside], np.geomspace(max(low, 1e-9), min(high, 1e9), _COARSE))
        counted = np.linspace(0, inside.size - 1, _COARSE).astype(int)
        return self.view.at(inside[np.unique(np.concatenate([spaced.clip(0, inside.size - 1), counted]))])

    @cached_property
    def _sweeps(self) -> list[_Sweep]:
        """Every sweep; made when they are first needed over time."""
        found = []
        for own in self.places:
            if own.block.kind != CHIRP_RESPONSE:
                continue
            others = [p for p in self.places if p.recording == own.recording and _of_sweep(p, own)]
            course = SweepCourse(own.block, self.frequency)
            found.append(
                _Sweep(course, Places.among(self._log_hz, course.log_hz), own, tuple(others), self.state_of[id(own)])
            )
        return found

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family; `loads` where the effect has elements or readings."""
        linear = self.linear(physical, effect)
        values = self.apply(linear.response)
        if loads is None or not (effect.tension or effect.reading) or not self._sweeps:
            return values
        passed = self._passed(linear, physical, effect, loads) if effect.tension else [None] * len(self._sweeps)
        for sweep, added in zip(self._sweeps, passed, strict=True):
            course = sweep.course
            change = np.zeros(course.piece.input.size)
            if added is not None:
                change = course.wave(added.force)
                self._shift(values, sweep, added)
            if effect.reading:
                rest, largest = self.rest_of(sweep.response), loads.reading_n
                wave = change + course.wave(course.at_bins(_row(linear.response, sweep.state))[0] * course.input)
                if added is not None:
                    wave = wave + np.interp(course.log_hz_of_samples(), self._log_hz, added.mean)
                at_rest = bent(np.array([rest]), largest, effect.reading)
                change = change + bent(rest + wave, largest, effect.reading) - at_rest
            self._read(values, sweep, change)
        return values

    def _passed(self, linear: Linear, physical: Physical, effect: Effect, loads: Loads) -> list[_Passed]:
        """What elements add to each sweep."""
        rig, view = rig_of(physical, self.rig, effect), self._coarse
        compliance = float(rig.compliance[0, 0])
        length = view.scale.length_mm
        loop, passing = self.loop(physical, effect, view)
        still = 1 + physical.film.k0 * compliance
        outside = np.broadcast_to(channels(effect, self.view), linear.k.shape)
        by_size, mean = any(isinstance(element, BySize) for element in effect.tension), loop.mean()
        stiffness = mean.k[1, 0] if by_size else np.ones(self._log_hz.size, dtype=complex)

        def strain(course: SweepCourse, k: Complex, e: Complex) -> Complex:
            """(C,) strain amplitude, with its phase against the input, of an elongation e (B,): that of its tension if by size."""
            signal = course.signal(k * e if by_size else e)
            return np.asarray(course.passing(signal, self._log_hz) / stiffness / length)

        parts, tops = [], []
        for sweep in self._sweeps:
            course = sweep.course
            own, k, outer = course.at_bins(*(_row(v, sweep.state) for v in (linear.dynamic, linear.k, outside)))
            tops.append(np.abs(strain(course, k, course.elongation(own, k, compliance))))
            parts.append((own, k, outer))
        rest = float(np.mean(view.rest_force_n))
        table = sweep_table(effect.tension, mean, np.max(tops, axis=0), rest, loads, view.scale)
        found = []
        for sweep, (own, k, outer) in zip(self._sweeps, parts, strict=True):
            e, added = sweep.course.strained(own, k, compliance, table, sweep.places, length, by_size)
            force = outer * float(rig.gain[0, 0]) * added / (own + k * compliance)
            found.append(_Passed(force, *self._waves(sweep, strain(sweep.course, k, e), table, passing, still)))
        return found

    def _waves(
        self, sweep: _Sweep, at: Complex, table: SweepTable, passing: Sequence[Complex], still: float
    ) -> tuple[Float, Complex]:
        """Mean (C,) and harmonics (2, C) of the force that elements add as the sweep passes the coarse frequencies.

        `at` (C,): strain amplitude there, with its phase against the input.
        """
        waves = table.waves(np.abs(at), self._at_log_hz)
        unit = at / np.maximum(np.abs(at), 1e-300)
        return waves[:, 0].real / still, np.array(
            [waves[:, m] * unit**m * _row(passing[m - 2], sweep.state) for m in (2, 3)]
        )

    def _shift(self, values: Float, sweep: _Sweep, added: _Passed) -> None:
        """Mean and harmonics that elements add, into the features of a sweep."""
        for p in (sweep.response, *sweep.others):
            own, seen = self.spans[id(p)], self._seen[id(p)]
            if seen.mean is not None:
                values[own] += seen.mean @ added.mean
            if p.block.kind == CHIRP_HARMONIC:
                both = np.sum(seen.harmonic * added.harmonic[seen.order - 2], axis=1)
                values[own] += np.concatenate([both.real, both.imag])
            elif p.block.kind == CHIRP_LEVEL:
                # A logarithmic sweep spends equal times in equal steps of log frequency.
                x = self._log_hz
                mean = float(np.trapezoid(added.mean, x) / (x[-1] - x[0])) if x.size > 1 else 0.0
                values[own] += np.where(_moving(p, sweep), mean, 0.0)

    @cached_property
    def _seen(self) -> dict[int, _Seen]:
        """What each block sees of what is known at the coarse frequencies."""
        found, unit = {}, np.eye(self._log_hz.size)
        for p in self.places:
            mean, harmonic, order = None, np.zeros((0, self._log_hz.size)), np.zeros(0, dtype=np.int64)
            if "shift_hz" in p.block.support:
                f = np.log(p.block.support["shift_hz"])
                weight = p.block.support["shift_weight"].reshape(p.block.size, f.size)
                mean = weight @ np.array([np.interp(f, self._log_hz, row) for row in unit]).T
            if p.block.kind == CHIRP_HARMONIC:
                order = p.block.support["order"].astype(np.int64)
                within = np.log(p.block.support["within_hz"].reshape(order.size, -1))
                hann = _hann(within.shape[1])
                harmonic = np.array([np.interp(within, self._log_hz, row) @ hann for row in unit]).T
            found[id(p)] = _Seen(mean, harmonic, order)
        return found

    def _read(self, values: Float, sweep: _Sweep, change: Float) -> None:
        """A change of the force over time (n,), N, into the features of a sweep."""
        response, harmonic = sweep.course.reader.read(change)
        values[self.spans[id(sweep.response)]] += np.concatenate([response.real, response.imag])
        piece = sweep.course.piece
        for p in sweep.others:
            own = self.spans[id(p)]
            if p.block.kind == CHIRP_HARMONIC:
                values[own] += np.concatenate([harmonic.real, harmonic.imag])
            else:
                values[own] += np.where(_moving(p, sweep), change[piece.start : piece.end].mean(), 0.0)

    def loads(self, physical: Physical) -> Loads:
        """Largest loads of the family as the plain film has them: what onsets are measured against."""
        linear, compliance = self.linear(physical, NONE), float(physical.rigs[self.rig].compliance[0, 0])
        swing = reading = 0.0
        for sweep in self._sweeps:
            course = sweep.course
            parts = (linear.dynamic, linear.k, linear.response)
            own, k, response = course.at_bins(*(_row(v, sweep.state) for v in parts))
            tension = course.signal(k * course.elongation(own, k, compliance))
            swing = max(swing, float(np.abs(tension).max()))
            force = course.signal(response * course.input)
            reading = max(reading, self.rest_of(sweep.response) + float(np.abs(force).max()))
        return Loads(swing, swing, reading)


def _of_sweep(p: Place, own: Place) -> bool:
    """Whether a block of the same recording is made by the sweep of a response, too."""
    return p.block.kind == CHIRP_LEVEL or (p.block.kind == CHIRP_HARMONIC and p.block.label == own.block.label)


def _moving(p: Place, sweep: _Sweep) -> NDArray[np.bool_]:
    """Which mean forces of a block are those while a sweep moves."""
    return np.asarray((p.block.amplitude > 0) & (p.block.cycle == sweep.response.block.cycle[0]))


def _row(values: Complex, state: int) -> Complex:
    return np.asarray(values[min(state, len(values) - 1)])


def _hann(count: int) -> Float:
    """Weights (count,) of the points within a Hann window, evenly spaced and without its ends; one point weighs all."""
    weight = np.sin(np.pi * np.arange(1, count + 1) / (count + 1)) ** 2
    return np.asarray(weight / weight.sum())
