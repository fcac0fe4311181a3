"""Prediction of voltage steps and multisines: H = −F/V² and the capacitance, from the voltage that was measured.

The responses are those of `voltage_waves`. Effects on the voltage act on the waveform (one stored period, or the plateaus of steps)
before its square reaches the film.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pipeline.diagnose.features.kinds import SPHS_CAPACITANCE, SPHS_DETECTION, SPHS_VOLTAGE
from pipeline.diagnose.simulation.describing import Loads, along
from pipeline.diagnose.simulation.effects import NONE, Course, Edge, Effect, Wave, bent
from pipeline.diagnose.simulation.families import Family, channel, rig_of, state_view
from pipeline.diagnose.simulation.parameters import Physical, Several
from pipeline.diagnose.simulation.remembered import Inputs
from pipeline.diagnose.simulation.session import Place, Session
from pipeline.diagnose.simulation.voltage_waves import (
    CAPACITANCE,
    FORCE,
    ROUNDS,
    SETTLED,
    VOLTAGE,
    VoltageWaves,
    acts_on_voltage,
    electrical_response,
    find_lines,
    measure_slope,
    pick_up,
    squared,
)
from schemas.arrays import Complex, Float, Int

STEP, MULTISINE = "step", "multisine"
INPUTS = {
    FORCE: Inputs.named(
        "film rigs actuation",
        "film_voltage film_edges squared actuation electrode film tension rig clamp force voltage reading picked_up",
    ),
    CAPACITANCE: Inputs.named(
        "film rigs actuation pf_per_n sensing",
        "film_voltage film_edges squared actuation electrode film rig clamp voltage capacitance",
    ),
    VOLTAGE: Inputs.named("amplifier", "monitor monitor_wave monitor_edges voltage"),
}


class StepFamily(Family):
    """Blocks of voltage steps with one output: force, capacitance or voltage."""

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float, output: str) -> None:
        super().__init__(session, places, nodes, STEP)
        self.output, self.inputs = output, INPUTS[output]
        self._on = np.concatenate([p.block.support["side"] > 0 for p in self.places])
        level = np.zeros(self.states.size)
        for p in self.places:
            level[self.state_of[id(p)]] = float(p.block.support["level_kv"][0])
        self._level = level

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family."""
        values = self.of_spectra(physical, effect)
        if self.output == FORCE and loads is not None and (effect.tension or effect.reading):
            self._along(values, physical, effect, loads)
        return values

    def of_spectra(self, physical: Physical | Several, effect: Effect) -> Float:
        """Features (rows,) without elements and readings; of several at once (B, rows)."""
        response = electrical_response(physical, effect, self.rig, self.view, self.output)
        if self.output != VOLTAGE and acts_on_voltage(effect):
            response = response * self._drive_factor(effect)[:, None]
        edges = effect.monitor_edges if self.output == VOLTAGE else effect.film_edges
        if edges:
            values = np.where(self._on, self._after(response, edges, 1.0), self._after(response, edges, -1.0))
        else:
            values = self.apply(np.atleast_2d(response))
        if self.output == CAPACITANCE and effect.electrode:
            self._electrode(values, effect)
        if self.output == FORCE and effect.picked_up:
            values = values - self._on * self._pick_up(effect)
        return values

    def _pick_up(self, effect: Effect) -> Float:
        """(rows,) force that the channel picks up at the plateaus."""
        levels = np.stack([np.zeros_like(self._level), self._level], axis=1)
        picked = pick_up(effect, Wave(levels, levels**2, None, self.session.scale))
        rise = picked[:, 1] - picked[:, 0]
        return np.concatenate([np.full(p.block.size, rise[self.state_of[id(p)]]) for p in self.places])

    def _after(self, response: Complex, edges: Sequence[Edge], side: float) -> Float:
        for edge in edges:
            response = response * edge(self.view, side)
        return self.apply(np.atleast_2d(response))

    def _drive_factor(self, effect: Effect) -> Float:
        """What acts at each plateau against rest, over the square of the measured voltage, (S,)."""
        levels = np.stack([np.zeros_like(self._level), self._level], axis=1)
        acting = squared(effect, Wave(levels, levels**2, None, self.session.scale))
        return np.asarray((acting[:, 1] - acting[:, 0]) / self._level**2)

    def _along(self, values: Float, physical: Physical, effect: Effect, loads: Loads) -> None:
        rig = rig_of(physical, self.rig, effect)
        still = rig.at_rest(physical.film.k0).item()
        at = 0
        for p in self.places:
            part = values[at : at + p.block.size]
            rest = float(self.session.states.rest_force_n[p.state])
            drop = part.copy()
            if effect.tension:
                course = Course(
                    drop[None] * rig.compliance / self.session.scale.length_mm,
                    -drop[None],
                    False,
                    np.array([[rest]]),
                    loads.tension_n,
                    loads.fall_n,
                    np.array([[physical.film.k0]], dtype=complex),
                    physical.film.k0,
                    np.diff(p.block.time_s, prepend=0.0)[None],
                    self.session.scale,
                )
                drop = drop - _balance(effect.tension, course, still - 1) / still
            tension = float(np.nan_to_num(rest))
            seen = bent(tension - drop, tension, loads.reading_n, effect.reading)
            values[at : at + p.block.size] = drop - seen
            at += p.block.size

    def _electrode(self, values: Float, effect: Effect) -> None:
        """The rest capacitance falls with the electrode, against what it was when the recording began."""
        before = replace(self.view, exposure_kv2_s=self.view.exposure_start_kv2_s)
        now, start = (
            np.broadcast_to(channel(effect.electrode, v).real, (self.states.size, 1))[:, 0] for v in (self.view, before)
        )
        at = 0
        for p in self.places:
            rest = self.session.recordings[p.recording].values.get("capacitance_rest_pf", 0.0)
            state = self.state_of[id(p)]
            values[..., at : at + p.block.size] += rest * (now[state] / start[state] - 1)
            at += p.block.size

    def loads(self, physical: Physical) -> Loads:
        """Largest loads of the family as the plain film has them; only a force family has any."""
        if self.output != FORCE:
            return Loads(0.0, 0.0, 0.0)
        plain = self.predict(physical, NONE, None)
        rest = np.nan_to_num(self.view.rest_force_n)
        rise, fall = float(-plain.min(initial=0.0)), float(plain.max(initial=0.0))
        return Loads(rise, fall, float(rest.max()) + rise)


class MultisineFamily:
    """Blocks of multisines of one rig, one kind and one set of lines."""

    def __init__(self, session: Session, places: Sequence[Place]) -> None:
        self.session, self.places = session, tuple(places)
        self.kind = places[0].block.kind
        self.output = {SPHS_CAPACITANCE: CAPACITANCE, SPHS_VOLTAGE: VOLTAGE}.get(self.kind, FORCE)
        self.inputs = INPUTS[self.output]
        self.rig = int(session.rig[places[0].recording])
        self.rows = np.concatenate([np.arange(p.first, p.stop) for p in places])
        n = places[0].block.size // 2
        support = places[0].block.support
        self._lines = support["lines"].astype(np.int64)
        self._excited = support.get("excited", support["lines"]).astype(np.int64)
        self._period = float(support["period_s"][0])
        wave = np.array([p.block.support["wave"] for p in places])
        if self.output == VOLTAGE:
            self._command = np.array([p.block.support["command"] for p in places])
            self._asked = find_lines(self._command)
        number = np.array([p.state for p in places])
        frequency = places[0].block.frequency_hz[None, :n]
        self.view = state_view(session, number, frequency, MULTISINE, strain=np.zeros((number.size, 1)))
        self._waves = VoltageWaves.of_period(wave, self._period, self.rig, self.view)

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family."""
        if loads is None or not (effect.tension or effect.reading) or self.output != FORCE:
            return self.of_spectra(physical, effect)
        acting, picked = self._waves.find_acting(effect), self._waves.pick_up(effect)
        extra = self._waves.bend(physical, effect, loads, acting)
        return self._features(physical, effect, acting, extra if picked is None else extra + picked)

    def of_spectra(self, physical: Physical | Several, effect: Effect) -> Float:
        """Features (rows,) without elements and readings; of several at once (B, rows)."""
        if self.output == VOLTAGE:
            return self._amplified(physical, effect)
        return self._features(physical, effect, self._waves.find_acting(effect), self._waves.pick_up(effect))

    def _features(self, physical: Physical | Several, effect: Effect, acting: Complex, extra: Complex | None) -> Float:
        """Features (..., rows) of what acts, and of what elements, readings and the voltage itself add to it, (S, L)."""
        nonlinear = acts_on_voltage(effect)
        if self.kind == SPHS_DETECTION and not nonlinear and extra is None:
            return np.zeros((*np.shape(physical.k0)[:1], self.rows.size))
        response = electrical_response(physical, effect, self.rig, self.view, self.output)
        response = np.broadcast_to(response, (*response.shape[:-2], len(self.places), self._lines.size))
        if self.kind == SPHS_DETECTION:
            given = self._waves.measured[:, self._lines]
            value = response * (acting[:, self._lines] - self._near(acting) * given)
            if extra is not None:
                lines = self._excited
                value = value + extra[:, self._lines]
                share = extra[:, lines] / self._waves.measured[:, lines]
                value = value - _interpolated(self._lines, lines, share) * given
        else:
            value = np.array(response)
            if nonlinear:
                value = value * acting[:, self._lines] / self._waves.measured[:, self._lines]
            if extra is not None:
                value = value + extra[:, self._lines] / self._waves.measured[:, self._lines]
        return _flattened(value)

    def _amplified(self, physical: Physical | Several, effect: Effect) -> Float:
        """Voltage over command at the lines of the command, from the command's own period."""
        n = self.view.frequency_hz.shape[1]
        value: Complex = np.asarray(physical.amplifier[self.rig] * np.ones((len(self.places), n), dtype=complex))
        if effect.monitor_wave:
            asked = physical.amplifier[self.rig] * self._command
            wave = Wave(asked, asked**2, self._period / asked.shape[1], self.session.scale)
            for change in effect.monitor_wave:
                wave = change(wave)
            value = find_lines(wave.film_kv)[:, self._lines] / self._asked[:, self._lines]
        return _flattened(value * channel(effect.voltage, self.view))

    def _near(self, acting: Complex) -> Complex:
        """Ratio of what acts to what was measured at the excited lines, at the others."""
        lines = self._excited
        return _interpolated(self._lines, lines, acting[:, lines] / self._waves.measured[:, lines])


def _balance(elements: Sequence[Callable[[Course], Float]], course: Course, give: float) -> Float:
    """(P,) what elements add to the tension along a slow course (1, P), with the clamp in balance with it.

    Parameters
    ----------
    give : stiffness of the film over that of the load cell
    """
    pulled = course.tension * (1 + give)
    for _ in range(ROUNDS):
        added = along(elements, course)
        slope = measure_slope(course.tension, added)
        new = (pulled - give * (added - (slope - 1) * course.tension)) / (1 + slope * give)
        change, size = np.abs(new - course.tension).max(), np.abs(course.tension).max()
        course = replace(course, tension=new)
        if not change > SETTLED * size:
            break
    return np.asarray(added[0])


def _flattened(value: Complex) -> Float:
    """(..., 2 S n) real and imaginary parts of the values (..., S, n) of each place."""
    parts = np.concatenate([value.real, value.imag], axis=-1)
    return parts.reshape(*parts.shape[:-2], -1)


def _interpolated(at: Int, lines: Int, values: Complex) -> Complex:
    return np.array([np.interp(at, lines, v.real) + 1j * np.interp(at, lines, v.imag) for v in values])
