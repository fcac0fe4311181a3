"""Prediction of sinusoids, relaxation and large cycles: G = F/x0 through the operators, and what is not linear. Sweeps: `predict_sweeps`.

    G = g k/(1 + (−Mω² + jωcL)/kL + k/kL) × (force channel)/(displacement channel)

Harmonics m of the tension reach the load cell as g T_m/(1 + (−Mω² + jωcL)/kL + k/kL) at m f.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.diagnose.features.kinds import CYCLIC_HARMONIC, CYCLIC_LEVEL, CYCLIC_RESPONSE
from pipeline.diagnose.simulation.describing import Loads, Loop, along, compose_wave, describe, harmonics
from pipeline.diagnose.simulation.effects import NONE, Course, Effect, View, bent
from pipeline.diagnose.simulation.families import Family, channel, dynamic, film_at, rig_of
from pipeline.diagnose.simulation.nodes import carried
from pipeline.diagnose.simulation.parameters import Physical, Several
from pipeline.diagnose.simulation.remembered import Inputs
from pipeline.diagnose.simulation.session import Place, Session
from pipeline.physics.rig import Rig
from schemas.arrays import Bool, Complex, Float, Int

CYCLIC, RAMP = "cyclic", "ramp"


@dataclass(frozen=True)
class Linear:
    """Film k N/mm, clamp 1 + (−Mω² + jωcL)/kL and response F/x0 N/mm at a family's nodes, (1 or S, J) each, of several (B, 1 or S, J)."""

    k: Complex
    dynamic: Complex
    response: Complex


@dataclass(frozen=True)
class _Levels:
    """Rows (n,) of mean forces in a family, the states of their cycles, and of those that they are told against."""

    rows: Int
    state: Int
    reference: Int


@dataclass(frozen=True)
class _Harmonics:
    """Rows (n,) of harmonics in a family, the states of their cycles, their orders, and which are imaginary parts."""

    rows: Int
    state: Int
    order: Int
    imaginary: Bool


@dataclass(frozen=True)
class _Groups:
    """Groups of cycles (g,) whose readings are asked over a period.

    Parameters
    ----------
    state, rest_n, amplitude_mm : state, force at rest and amplitude of the driven end
    real, imaginary : rows of the response
    level : row of the mean force against a rest, -1 where there is none
    harmonic : rows of the harmonics; their `state` is the number of the group
    levels : rows of the mean forces, with numbers of groups in place of states; told against itself: against a rest
    """

    state: Int
    rest_n: Float
    amplitude_mm: Float
    real: Int
    imaginary: Int
    level: Int
    harmonic: _Harmonics
    levels: _Levels


class MechanicalFamily(Family, ABC):
    """Blocks of mechanical tests of one kind."""

    inputs = Inputs.named("film rigs", "film tension rig clamp clamp_third force displacement reading")

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float, kind: str) -> None:
        super().__init__(session, places, nodes, kind)
        starts = np.cumsum([0, *(p.block.size for p in self.places)])
        self.spans = {
            id(p): slice(int(a), int(b)) for p, a, b in zip(self.places, starts[:-1], starts[1:], strict=True)
        }

    def of_spectra(self, physical: Physical | Several, effect: Effect) -> Float:
        """Features (rows,) without elements and readings; of several at once (B, rows)."""
        values = self.apply(self.linear(physical, effect).response)
        if effect.clamp_third:
            self.add_third(values, physical, effect)
        return values

    def add_third(self, values: Float, physical: Physical | Several, effect: Effect) -> None:
        """Adds the third harmonic of forces on the clamp to features (rows,) or (B, rows), where there are harmonics."""

    def third(self, physical: Physical | Several, effect: Effect, views: tuple[View, View, View]) -> Complex:
        """Third harmonic of the load cell's force, N, that forces on the clamp make, (S, C) or (B, S, C)."""
        rig = rig_of(physical, self.rig, effect)
        view, _, at_third = views
        k, k_third = (film_at(physical, effect, v).k for v in (view, at_third))
        total = sum(made(rig, view, k, k_third) for made in effect.clamp_third)
        return np.asarray(total * channel(effect.force, at_third))

    def linear(self, physical: Physical | Several, effect: Effect, view: View | None = None) -> Linear:
        """The response without elements and readings, at the nodes or at the frequencies of another view."""
        at = self.view if view is None else view
        rig = rig_of(physical, self.rig, effect)
        k = film_at(physical, effect, at).k
        own = dynamic(rig, at, effect, k)
        response = rig.mechanical(k, own) * channels(effect, at)
        return Linear(np.atleast_2d(k), np.atleast_2d(own), np.atleast_2d(response))

    def loop(
        self,
        physical: Physical,
        effect: Effect,
        views: tuple[View, View, View],
        cycles: tuple[Float, Float] | None = None,
    ) -> tuple[Loop, list[Complex]]:
        """Film and rig about elements at the frequencies of a view and its overtones, and what of the tension's harmonics 2 and 3
        reaches the load cell, (S, C) each."""
        view = views[0]
        shape = self.states.size, view.frequency_hz.shape[1]
        rig = rig_of(physical, self.rig, effect)
        at = [self.linear(physical, effect, v) for v in views]
        k0, no_clamp = np.full(shape, physical.film.k0, dtype=complex), np.ones(shape, dtype=complex)
        found = Loop(
            np.broadcast_to(view.frequency_hz, shape),
            np.array([k0, *(np.broadcast_to(a.k, shape) for a in at)]),
            np.array([no_clamp, *(np.broadcast_to(a.dynamic, shape) for a in at)]),
            rig,
            cycles,
        )
        passing = [
            rig.electrical(found.k[order], found.dynamic[order]) * channel(effect.force, views[order - 1])
            for order in (2, 3)
        ]
        return found, passing

    def rest_of(self, p: Place) -> float:
        """Force at rest, N; 0 where it is not known."""
        return float(np.nan_to_num(self.session.states.rest_force_n[p.state]))

    @abstractmethod
    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family; `loads` where the effect has elements or readings."""

    @abstractmethod
    def loads(self, physical: Physical) -> Loads:
        """Largest loads of the family as the plain film has them: what onsets are measured against."""


def channels(effect: Effect, view: View) -> Complex:
    """What effects do to the force over what they do to the displacement."""
    return np.asarray(channel(effect.force, view) / channel(effect.displacement, view), dtype=complex)


class CyclicFamily(MechanicalFamily):
    """Groups of cycles of sinusoids: each a state with one frequency and one amplitude."""

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float) -> None:
        super().__init__(session, places, nodes, CYCLIC)
        f = np.full((self.states.size, 1), np.nan)
        strain = np.zeros((self.states.size, 1))
        self._mean_strain = np.zeros((self.states.size, 1))
        for p in self.places:
            state = self.state_of[id(p)]
            f[state, 0], strain[state, 0] = p.block.frequency_hz[0], p.block.amplitude[0]
            if "mean_strain" in p.block.support:
                self._mean_strain[state] = float(p.block.support["mean_strain"][0])
        self._own = replace(self.view, frequency_hz=f, strain=strain).overtones()
        self._cycles = self._group_cycles()
        self._against = self._find_references()
        self._added = self._find_added()
        self._read_groups = self._find_groups()
        self._last: tuple[object, tuple[Linear, Loop, list[Complex]]] | None = None

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family; `loads` where the effect has elements or readings."""
        if loads is None or not effect.tension:
            values = self.of_spectra(physical, effect)
        else:
            values = self._with_elements(physical, effect, loads)
            if effect.clamp_third:
                self.add_third(values, physical, effect)
        if loads is not None and effect.reading:
            self._read(values, physical, effect, loads)
        return values

    def add_third(self, values: Float, physical: Physical | Several, effect: Effect) -> None:
        """Adds the third harmonic of forces on the clamp to features (rows,) or (B, rows)."""
        harmonic = self._added[2]
        own = harmonic.order == 3
        seen = self.third(physical, effect, self._own)[..., harmonic.state[own], 0]
        values[..., harmonic.rows[own]] += np.where(harmonic.imaginary[own], seen.imag, seen.real)

    def _find_groups(self) -> _Groups:
        """Groups of cycles with response and harmonics; cycles that levels are told against have no level."""
        found: dict[int, dict[str, Place]] = {}
        for p in self.places:
            found.setdefault(p.state, {})[p.block.kind] = p
        groups = [g for g in found.values() if CYCLIC_RESPONSE in g and CYCLIC_HARMONIC in g]
        responses = [g[CYCLIC_RESPONSE] for g in groups]
        state = [self.state_of[id(p)] for p in responses]
        number_of = {own: number for number, own in enumerate(state)}
        level = np.full(len(groups), -1)
        rows: list[tuple[int, int, int]] = []
        for number, (group, response) in enumerate(zip(groups, responses, strict=True)):
            if CYCLIC_LEVEL not in group:
                continue
            own, against = self.spans[id(group[CYCLIC_LEVEL])], self._against.get(response.recording)
            if against is None:
                level[number] = own.start
            reference = number if against is None else number_of.get(against, number)
            rows += [(row, number, reference) for row in range(own.start, own.stop)]
        begins = np.array([self.spans[id(p)].start for p in responses], dtype=np.int64)
        harmonic = self._list_harmonics(dict(enumerate(g[CYCLIC_HARMONIC] for g in groups)))
        return _Groups(
            np.array(state, dtype=np.int64),
            np.array([self.rest_of(p) for p in responses]),
            np.array([float(p.block.amplitude[0]) * self.session.scale.length_mm for p in responses]),
            begins,
            begins + 1,
            level,
            harmonic,
            _Levels(*np.array(rows, dtype=np.int64).reshape(-1, 3).T),
        )

    def _list_harmonics(self, places: Mapping[int, Place]) -> _Harmonics:
        """Rows of the harmonics at some places, by the numbers that these have."""
        found = [
            (self.spans[id(p)].start + i, number, *part)
            for number, p in places.items()
            for i, part in enumerate(
                (int(m), imaginary) for imaginary in (False, True) for m in p.block.support["order"]
            )
        ]
        rows, number, order, imaginary = np.array(found, dtype=np.int64).reshape(-1, 4).T
        return _Harmonics(rows, number, order, imaginary.astype(bool))

    def _find_references(self) -> dict[int, int]:
        """Recording → the state of the cycles that its levels are told against, for recordings that begin with their cycles: these have
        no level of their own."""
        kinds: dict[int, set[str]] = {}
        recording: dict[int, int] = {}
        for p in self.places:
            state = self.state_of[id(p)]
            kinds.setdefault(state, set()).add(p.block.kind)
            recording[state] = p.recording
        return {recording[s]: s for s, own in kinds.items() if CYCLIC_RESPONSE in own and CYCLIC_LEVEL not in own}

    def _find_added(self) -> tuple[_Levels, _Levels, _Harmonics]:
        """Rows to which elements add: levels against a rest, levels against other cycles, harmonics."""
        at_rest: list[tuple[int, int, int]] = []
        told_against: list[tuple[int, int, int]] = []
        harmonic: dict[int, Place] = {}
        for p in self.places:
            state, own = self.state_of[id(p)], self.spans[id(p)]
            if p.block.kind == CYCLIC_LEVEL:
                against = self._against.get(p.recording)
                found = at_rest if against is None else told_against
                found += [(row, state, state if against is None else against) for row in range(own.start, own.stop)]
            elif p.block.kind == CYCLIC_HARMONIC:
                harmonic[state] = p
        levels = [np.array(rows, dtype=np.int64).reshape(-1, 3).T for rows in (at_rest, told_against)]
        return _Levels(*levels[0]), _Levels(*levels[1]), self._list_harmonics(harmonic)

    def _group_cycles(self) -> tuple[Float, Float]:
        """First and last cycle of each state, (S, 1) each: the groups of a recording follow each other from the first on."""
        middle = self.view.cycle[:, 0]
        recording = self.session.states.recording[self.states]
        last = np.zeros(middle.size)
        for r in np.unique(recording):
            end = 0.0
            for i in np.flatnonzero(recording == r)[np.argsort(middle[recording == r])]:
                end = max(2 * middle[i] - end - 1, middle[i])
                last[i] = end
        return (2 * middle - last)[:, None], last[:, None]

    def _about_elements(self, physical: Physical, effect: Effect) -> tuple[Linear, Loop, list[Complex]]:
        """What is linear about the elements: a search moves their numbers, and then film and rig stay."""
        rig = physical.rigs[self.rig]
        linear = effect.film, effect.rig, effect.clamp, effect.force, effect.displacement
        key = self.view, physical.film, rig.numbers, rig.extra, linear
        if self._last is None or self._last[0] != key:
            self._last = key, (self.linear(physical, effect), *self.loop(physical, effect, self._own, self._cycles))
        return self._last[1]

    def _with_elements(self, physical: Physical, effect: Effect, loads: Loads) -> Float:
        """Features with the describing functions of the elements: of the response, of mean and harmonics."""
        rig, view = rig_of(physical, self.rig, effect), self._own[0]
        still = rig.at_rest(physical.film.k0)
        linear, loop, passing = self._about_elements(physical, effect)
        mean_strain, rest = self._mean_strain / still, np.broadcast_to(view.rest_force_n, view.strain.shape)
        found = describe(effect.tension, loop, view.strain, mean_strain, rest, loads, view.scale)
        k = linear.k * found.factor
        if self.view.few:
            carried(rig.loaded(k, linear.dynamic))
        values = self.apply(np.atleast_2d(rig.mechanical(k, linear.dynamic) * channels(effect, self.view)))
        if self._against:
            # Against other cycles a mean is that of the linear film, which rings where it begins at once, and what the waves add to it;
            # against a rest it relaxes as the film does, with the secant of the cycles.
            plain = self.apply(linear.response)
            scaled = (found.factor.real - 1) * physical.film.k0 * view.scale.length_mm * mean_strain
            added = (found.mean + scaled) / still
        unit = found.turn / np.abs(found.turn)
        force = [h * unit**m * p for m, h, p in zip((2, 3), (found.second, found.third), passing, strict=True)]
        levels, told_against, harmonic = self._added
        values[levels.rows] += (found.mean / still)[levels.state, 0]
        if self._against:
            rows = told_against.rows
            values[rows] = plain[rows] + added[told_against.state, 0] - added[told_against.reference, 0]
        both = np.array(force)[harmonic.order - 2, harmonic.state, 0]
        values[harmonic.rows] += np.where(harmonic.imaginary, both.imag, both.real)
        return values

    def _read(self, values: Float, physical: Physical, effect: Effect, loads: Loads) -> None:
        """Readings of sinusoids: of the waves that mean, fundamental and harmonics of each group make."""
        of, harmonic = self._read_groups, self._read_groups.harmonic
        still = rig_of(physical, self.rig, effect).at_rest(physical.film.k0).item()
        level = physical.film.k0 / still * self._mean_strain[of.state, 0] * self.session.scale.length_mm
        waves = np.zeros((of.state.size, 4), dtype=complex)
        waves[:, 0] = of.rest_n + np.where(of.level >= 0, values[of.level], level)
        waves[:, 1] = (values[of.real] + 1j * values[of.imaginary]) * of.amplitude_mm
        part = np.where(harmonic.imaginary, 1j, 1.0) * values[harmonic.rows]
        np.add.at(waves, (harmonic.state, harmonic.order), part)
        rest = of.rest_n[:, None]
        change = harmonics(bent(compose_wave(waves), rest, loads.reading_n, effect.reading))
        shift = change[:, 0].real - bent(rest, rest, loads.reading_n, effect.reading)[:, 0]
        values[of.real] += change[:, 1].real / of.amplitude_mm
        values[of.imaginary] += change[:, 1].imag / of.amplitude_mm
        seen = change[harmonic.state, harmonic.order]
        values[harmonic.rows] += np.where(harmonic.imaginary, seen.imag, seen.real)
        levels = of.levels
        values[levels.rows] += shift[levels.state] - np.where(
            levels.state == levels.reference, 0.0, shift[levels.reference]
        )

    def loads(self, physical: Physical) -> Loads:
        """Largest loads of the family as the plain film has them: what onsets are measured against."""
        view = self._own[0]
        linear = self.linear(physical, NONE, view)
        rig, travel = physical.rigs[self.rig], view.strain * view.scale.length_mm
        swing = np.abs(linear.k * rig.extension(linear.k, linear.dynamic)) * travel
        level = physical.film.k0 / rig.at_rest(physical.film.k0) * self._mean_strain * view.scale.length_mm
        reading = np.nan_to_num(view.rest_force_n) + level + np.abs(linear.response) * travel
        return Loads(float((swing + level).max()), float(np.maximum(swing - level, 0).max()), float(reading.max()))


class RampFamily(MechanicalFamily):
    """Relaxation and large cycles: windows along a course from rest."""

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float) -> None:
        super().__init__(session, places, nodes, RAMP)

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family; `loads` where the effect has elements or readings."""
        values = self.of_spectra(physical, effect)
        if loads is not None and (effect.tension or effect.reading):
            self._along(values, physical, effect, rig_of(physical, self.rig, effect), loads)
        return values

    def loads(self, physical: Physical) -> Loads:
        """Largest loads of the family as the plain film has them: what onsets are measured against."""
        values = self.predict(physical, NONE, None)
        rest = np.nan_to_num(self.view.rest_force_n)
        rise, fall = float(values.max(initial=0.0)), float(-values.min(initial=0.0))
        return Loads(rise, fall, float(rest.max(initial=0.0)) + rise)

    def _along(self, values: Float, physical: Physical, effect: Effect, rig: Rig, loads: Loads) -> None:
        """Elements and readings along the windows of relaxation and cycles, in time order."""
        still = rig.at_rest(physical.film.k0).item()
        for p in self.places:
            own = self.spans[id(p)]
            order = np.argsort(p.block.time_s)
            part = values[own][order]
            rest = float(self.session.states.rest_force_n[p.state])
            if effect.tension:
                strain = p.block.support["strain"][order]
                size = np.abs(part) / np.maximum(np.abs(strain) * self.session.scale.length_mm, 1e-300)
                course = Course(
                    strain[None],
                    part[None],
                    False,
                    np.array([[rest]]),
                    loads.tension_n,
                    loads.fall_n,
                    size[None].astype(complex),
                    physical.film.k0,
                    np.diff(p.block.time_s[order], prepend=0.0)[None],
                    self.session.scale,
                )
                part = part + along(effect.tension, course)[0] / still
            tension = float(np.nan_to_num(rest))
            values[own.start + order] = part + bent(tension + part, tension, loads.reading_n, effect.reading)
