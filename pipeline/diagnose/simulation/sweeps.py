"""Prediction of sweeps: linear responses through the operators; elements and readings over time, as the sweep passes.

What elements make of a wave of any amplitude is tabulated at a few frequencies; every sweep then looks its own amplitude up at
each instant (`sweep_courses`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from pipeline.diagnose.features.kinds import CHIRP_HARMONIC, CHIRP_LEVEL, CHIRP_RESPONSE
from pipeline.diagnose.simulation.describing import Loads, Places, sweep_table
from pipeline.diagnose.simulation.effects import NONE, BySize, Effect, View, bent
from pipeline.diagnose.simulation.families import rig_of
from pipeline.diagnose.simulation.mechanical import Linear, MechanicalFamily, channels
from pipeline.diagnose.simulation.nodes import POINTS
from pipeline.diagnose.simulation.parameters import Physical, Several
from pipeline.diagnose.simulation.session import Place, Session
from pipeline.diagnose.simulation.sweep_courses import SweepCourse, SweepCourses
from schemas.arrays import Complex, Float, Int

SWEEP = "sweep"
_COARSE = 24
"""Log-spaced and, beside them, evenly counted nodes at which elements are asked."""


@dataclass(frozen=True)
class _Sweep:
    """A sweep's course, its response, the other features that it makes, number of its state; places (n,) of its samples among the
    coarse frequencies."""

    course: SweepCourse
    response: Place
    others: tuple[Place, ...]
    state: int
    samples: Places


@dataclass(frozen=True)
class _Alike:
    """Sweeps that are simulated at once: their numbers and states (W,), their courses."""

    number: Int
    state: Int
    courses: SweepCourses


@dataclass(frozen=True)
class _Seen:
    """Weights of the coarse frequencies in a block (n, C): of shifts of the mean force, and of harmonics `order` (h,)."""

    mean: Float | None
    harmonic: Float
    order: Int


@dataclass(frozen=True)
class _Passed:
    """What elements add to a sweep: force spectrum (B,), N; mean (C,) and harmonics 2 and 3 (2, C) of the force at coarse frequencies."""

    force: Complex
    mean: Float
    harmonic: Complex


class SweepFamily(MechanicalFamily):
    """Blocks of sweeps."""

    _of_nodes = (*MechanicalFamily._of_nodes, "_sweeps", "_alike")

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float) -> None:
        super().__init__(session, places, nodes, SWEEP)
        self._whole: SweepFamily | None = None
        self._coarse = self._coarse_view().overtones()
        self._log_hz: Float = np.log(self._coarse[0].frequency_hz[0])
        self._at_log_hz = Places.among(self._log_hz, self._log_hz)

    def _coarse_view(self) -> View:
        bands = [p.block.frequency_hz for p in self.places if p.block.kind == CHIRP_RESPONSE]
        low, high = (min(float(b.min()) for b in bands), max(float(b.max()) for b in bands)) if bands else (0.0, np.inf)
        inside = np.flatnonzero((self.frequency >= low) & (self.frequency <= high))
        spaced = np.searchsorted(self.frequency[inside], np.geomspace(max(low, 1e-9), min(high, 1e9), _COARSE))
        counted = np.linspace(0, inside.size - 1, _COARSE).astype(int)
        return self.view.at(inside[np.unique(np.concatenate([spaced.clip(0, inside.size - 1), counted]))])

    def with_few_nodes(self, physical: Physical) -> Self | None:
        """See `Family`; elements are asked at the same coarse frequencies."""
        other = super().with_few_nodes(physical)
        if other is not None:
            other._whole = self
        return other

    @cached_property
    def _sweeps(self) -> list[_Sweep]:
        """Every sweep; made when they are first needed over time."""
        if self._whole is not None:
            return [replace(s, course=s.course.with_nodes(self.frequency, POINTS)) for s in self._whole._sweeps]
        found = []
        for own in self.places:
            if own.block.kind != CHIRP_RESPONSE:
                continue
            others = tuple(p for p in self.places if p.recording == own.recording and _of_sweep(p, own))
            course = SweepCourse(own.block, self.frequency)
            samples = Places.among(self._log_hz, course.log_hz_of_samples())
            found.append(_Sweep(course, own, others, self.state_of[id(own)], samples))
        return found

    @cached_property
    def _alike(self) -> list[_Alike]:
        """The sweeps by what they have alike."""
        groups: dict[object, list[int]] = {}
        for number, sweep in enumerate(self._sweeps):
            groups.setdefault(sweep.course.sizes, []).append(number)
        return [
            _Alike(
                np.array(numbers),
                np.array([self._sweeps[i].state for i in numbers]),
                SweepCourses([self._sweeps[i].course for i in numbers], self._log_hz),
            )
            for numbers in groups.values()
        ]

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family; `loads` where the effect has elements or readings."""
        linear = self.linear(physical, effect)
        values = self.apply(linear.response)
        if effect.clamp_third:
            self.add_third(values, physical, effect)
        # Where no response is among the features (it is left out, to be predicted), no sweep is known over time.
        if loads is None or not self._sweeps or not (effect.tension or effect.reading):
            return values
        passed = self._passed(linear, physical, effect, loads) if effect.tension else []
        for sweep, added in zip(self._sweeps, passed, strict=False):
            self._shift(values, sweep, added)
        for alike in self._alike:
            if effect.reading:
                course = alike.courses.course
                (response,) = alike.courses.at_bins(_rows(linear.response, alike.state))
                wave = course.wave(response * alike.courses.input)
                change = course.wave(np.array([passed[i].force for i in alike.number])) if passed else None
                bent_by = self._bent(alike, wave, change, passed, effect, loads.reading_n)
                seen = [self._sweeps[i].course.read(own) for i, own in zip(alike.number, bent_by, strict=True)]
            else:
                seen = [self._sweeps[i].course.read_spectrum(passed[i].force) for i in alike.number]
            for number, own in zip(alike.number, seen, strict=True):
                self._read(values, self._sweeps[number], own)
        return values

    def add_third(self, values: Float, physical: Physical | Several, effect: Effect) -> None:
        """Adds the third harmonic of forces on the clamp to features (rows,) or (B, rows)."""
        third = self.third(physical, effect, self._coarse)
        for p in self.places:
            if p.block.kind != CHIRP_HARMONIC:
                continue
            seen = self._seen[id(p)]
            own = third[..., self.state_of[id(p)], :]
            both = np.where(seen.order == 3, own @ seen.harmonic.T, 0.0)
            values[..., self.spans[id(p)]] += np.concatenate([both.real, both.imag], axis=-1)

    def _bent(
        self,
        alike: _Alike,
        wave: Float,
        change: Float | None,
        passed: Sequence[_Passed],
        effect: Effect,
        largest: float,
    ) -> Float:
        """What elements, `change`, and readings add over time to the linear force `wave`, (W, n) each, N."""
        found = []
        for row, (number, own) in enumerate(zip(alike.number, wave, strict=True)):
            sweep, rest = self._sweeps[number], self.rest_of(self._sweeps[number].response)
            added = 0.0 if change is None else change[row]
            mean = sweep.samples.interpolated(passed[number].mean) if passed else 0.0
            at_rest = bent(np.array([rest]), rest, largest, effect.reading)
            found.append(added + bent(rest + added + own + mean, rest, largest, effect.reading) - at_rest)
        return np.array(found)

    def _passed(self, linear: Linear, physical: Physical, effect: Effect, loads: Loads) -> list[_Passed]:
        """What elements add to each sweep."""
        rig, view = rig_of(physical, self.rig, effect), self._coarse[0]
        length = view.scale.length_mm
        loop, passing = self.loop(physical, effect, self._coarse)
        still = rig.at_rest(physical.film.k0).item()
        seen = channels(effect, self.view)
        outside = np.broadcast_to(seen, np.broadcast_shapes(seen.shape, linear.k.shape))
        by_size, mean = any(isinstance(element, BySize) for element in effect.tension), loop.mean()
        stiffness = mean.k[1, 0] if by_size else np.ones(self._log_hz.size, dtype=complex)

        def strain(courses: SweepCourses, k: Complex, e: Complex) -> Complex:
            """(W, C) strain amplitudes, with their phase against the input, of elongations e (W, B): those of their tension if by size."""
            signal = courses.course.signal(k * e if by_size else e)
            return np.asarray(courses.passing(signal) / stiffness / length)

        parts, tops = [], []
        for alike in self._alike:
            at = (_rows(v, alike.state) for v in (linear.dynamic, linear.k, outside))
            own, k, outer = alike.courses.at_bins(*at)
            tops.append(np.abs(strain(alike.courses, k, alike.courses.elongation(own, k, rig))))
            parts.append((own, k, outer))
        rest = float(np.mean(view.rest_force_n))
        table = sweep_table(effect.tension, mean, np.max(np.concatenate(tops), axis=0), rest, loads, view.scale)
        found: dict[int, _Passed] = {}
        for alike, (own, k, outer) in zip(self._alike, parts, strict=True):
            e, added = alike.courses.strained(own, k, rig, table, length, by_size)
            force = outer * rig.electrical(k, own) * added
            at_coarse = strain(alike.courses, k, e)
            waves = table.waves(np.abs(at_coarse), self._at_log_hz)
            unit = at_coarse / np.maximum(np.abs(at_coarse), 1e-300)
            harmonic = [waves[..., m] * unit**m * _rows(passing[m - 2], alike.state) for m in (2, 3)]
            level = waves[..., 0].real / still
            for row, number in enumerate(alike.number):
                found[int(number)] = _Passed(force[row], level[row], np.array([h[row] for h in harmonic]))
        return [found[number] for number in range(len(self._sweeps))]

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
                values[own] += _weigh_mean(p, sweep) * mean

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

    def _read(self, values: Float, sweep: _Sweep, seen: Float) -> None:
        """What is read of a change of the force, as in `SweepCourse.read`, into the features of a sweep."""
        own, of_harmonics = self.spans[id(sweep.response)], sweep.response.block.size
        values[own] += seen[:of_harmonics]
        for p in sweep.others:
            own = self.spans[id(p)]
            values[own] += seen[of_harmonics:-1] if p.block.kind == CHIRP_HARMONIC else _weigh_mean(p, sweep) * seen[-1]

    def loads(self, physical: Physical) -> Loads:
        """Largest loads of the family as the plain film has them: what onsets are measured against."""
        linear, rig = self.linear(physical, NONE), physical.rigs[self.rig]
        swing = reading = 0.0
        for alike in self._alike:
            courses, parts = alike.courses, (linear.dynamic, linear.k, linear.response)
            own, k, response = courses.at_bins(*(_rows(v, alike.state) for v in parts))
            tension = courses.course.signal(k * courses.elongation(own, k, rig))
            swing = max(swing, float(np.abs(tension).max()))
            force = np.abs(courses.course.signal(response * courses.input)).max(axis=1)
            rest = [self.rest_of(self._sweeps[number].response) for number in alike.number]
            reading = max(reading, float(np.max(rest + force)))
        return Loads(swing, swing, reading)


def _of_sweep(p: Place, own: Place) -> bool:
    """Whether a block of the same recording is made by the sweep of a response, too."""
    return p.block.kind == CHIRP_LEVEL or (p.block.kind == CHIRP_HARMONIC and p.block.label == own.block.label)


def _weigh_mean(p: Place, sweep: _Sweep) -> Float:
    """(n,) what the mean of a sweep's force counts in the mean forces of a block: 1 in its own; in a recording without rest, in which they
    are told against the last sweep, −1 of that one in all."""
    own = (p.block.amplitude > 0) & (p.block.cycle == sweep.response.block.cycle[0])
    is_reference = not own.any() and sweep.response.block.cycle[0] > p.block.cycle.max()
    return np.full(own.size, -1.0) if is_reference else own.astype(np.float64)


def _rows(values: Complex, state: Int) -> Complex:
    """(1 or W, J) of values (1 or S, J): those of all states, or of these (W,)."""
    return values if len(values) == 1 else np.asarray(values[state])


def _hann(count: int) -> Float:
    """Weights (count,) of the points within a Hann window, evenly spaced and without its ends; one point weighs all."""
    weight = np.sin(np.pi * np.arange(1, count + 1) / (count + 1)) ** 2
    return np.asarray(weight / weight.sum())
