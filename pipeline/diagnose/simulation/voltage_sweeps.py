"""Prediction of sweeps of the voltage: −F/V², C/V² and the amplifier's response, in the bands and harmonics that their features are.

What is linear in the square of the measured voltage passes through the features' operators. What acts on the voltage over time, and
what elements and readings add to the force, is made as for a period (`VoltageWaves`): the sweep with the rest about it is one, as a
film at rest has forgotten what was before. The features then read that course of the force as they read the recorded one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.fft

from pipeline.diagnose.features.kinds import (
    VOLTAGE_CHIRP_AMPLIFIER,
    VOLTAGE_CHIRP_CAPACITANCE,
    VOLTAGE_CHIRP_HARMONIC,
    VOLTAGE_CHIRP_RESPONSE,
    read_clock,
)
from pipeline.diagnose.features.sweep_kernels import SweepReader
from pipeline.diagnose.features.voltage_chirp import cut_piece
from pipeline.diagnose.simulation.describing import Loads
from pipeline.diagnose.simulation.effects import Effect, Wave
from pipeline.diagnose.simulation.electrical import INPUTS
from pipeline.diagnose.simulation.families import Family, channel, state_view
from pipeline.diagnose.simulation.parameters import Physical, Several
from pipeline.diagnose.simulation.session import Place, Session
from pipeline.diagnose.simulation.voltage_waves import (
    CAPACITANCE,
    FORCE,
    VOLTAGE,
    VoltageWaves,
    acts_on_voltage,
    electrical_response,
    find_lines,
    make_wave,
)
from schemas.arrays import Complex, Float

OUTPUTS = {
    VOLTAGE_CHIRP_RESPONSE: FORCE,
    VOLTAGE_CHIRP_HARMONIC: FORCE,
    VOLTAGE_CHIRP_CAPACITANCE: CAPACITANCE,
    VOLTAGE_CHIRP_AMPLIFIER: VOLTAGE,
}
"""What each kind of features is of."""
_SWEEP = "voltage sweep"
_SAMPLES = 8.0
"""Samples in a turn of the highest frequency of a sweep with which its course is made: its harmonics are read from that."""


@dataclass(frozen=True)
class _Sweep:
    """A sweep: its response, its harmonics (None: there are none), what reads both of a course of the output, and its voltage, or of an
    amplifier its command, V."""

    response: Place
    harmonic: Place | None
    reader: SweepReader
    waves: VoltageWaves


class VoltageSweepFamily(Family):
    """Blocks of sweeps of the voltage with one output: force, capacitance or voltage."""

    def __init__(self, session: Session, places: Sequence[Place], nodes: Float, output: str) -> None:
        super().__init__(session, places, nodes, _SWEEP)
        self.output, self.inputs = output, INPUTS[output]
        stops = np.cumsum([0, *(p.block.size for p in self.places)])
        self._spans = {id(p): slice(int(a), int(b)) for p, a, b in zip(self.places, stops[:-1], stops[1:], strict=True)}

    def predict(self, physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        """Features (rows,) of the family."""
        values = self._of_linear(physical, effect)
        if self.output == VOLTAGE:
            if effect.monitor_wave:
                self._amplify(values, physical.amplifier[self.rig], effect)
            return values
        bends = self.output == FORCE and bool(effect.tension or effect.reading)
        for sweep in self._sweeps if bends or self._acts_over_time(effect) else ():
            acting = sweep.waves.find_acting(effect)
            added = self._find_added(sweep, physical, effect, acting)
            if bends and loads is not None:
                added = added + sweep.waves.bend(physical, effect, loads, acting)
            self._read(values, sweep, added)
        return values

    def of_spectra(self, physical: Physical | Several, effect: Effect) -> Float:
        """Features (rows,) without elements, readings and what an amplifier does over time; of several at once (B, rows)."""
        values = self._of_linear(physical, effect)
        for sweep in self._sweeps if self._acts_over_time(effect) else ():
            self._read(values, sweep, self._find_added(sweep, physical, effect, sweep.waves.find_acting(effect)))
        return values

    def _of_linear(self, physical: Physical | Several, effect: Effect) -> Float:
        """Features (..., rows) of what is linear in the square of the voltage, or in the command."""
        return self.apply(np.atleast_2d(electrical_response(physical, effect, self.rig, self.view, self.output)))

    def _acts_over_time(self, effect: Effect) -> bool:
        return self.output != VOLTAGE and bool(acts_on_voltage(effect) or effect.picked_up)

    def _find_added(self, sweep: _Sweep, physical: Physical | Several, effect: Effect, acting: Complex) -> Complex:
        """Lines (..., 1, L) of what another voltage, and what is picked up from it, add to the output."""
        added: Complex = np.zeros_like(acting)
        if acts_on_voltage(effect):
            passed = electrical_response(physical, effect, self.rig, sweep.waves.view, self.output)
            added = passed * (acting - sweep.waves.measured)
        picked = sweep.waves.pick_up(effect)
        return added if picked is None else added + picked

    def _amplify(self, values: Float, amplifier: float, effect: Effect) -> None:
        """What becomes of a command over time, beside the gain, kV/V."""
        for sweep in self._sweeps:
            asked = amplifier * sweep.waves.kv
            wave = Wave(asked, asked**2, sweep.waves.interval_s, self.session.scale)
            for change in effect.monitor_wave:
                wave = change(wave)
            change_of_voltage = find_lines(wave.film_kv - asked)
            self._read(values, sweep, change_of_voltage * channel(effect.voltage, sweep.waves.view))

    def _read(self, values: Float, sweep: _Sweep, lines: Complex) -> None:
        """Adds to features (..., rows) what a sweep's show of a course of the output, given by its lines (..., 1, L)."""
        course = lines.reshape(-1, lines.shape[-1])
        for row, wave in zip(
            values.reshape(-1, values.shape[-1]), make_wave(course, sweep.waves.kv.shape[1]), strict=True
        ):
            response, harmonic = sweep.reader.read(wave)
            row[self._spans[id(sweep.response)]] += np.concatenate([response.real, response.imag])
            if sweep.harmonic is not None:
                row[self._spans[id(sweep.harmonic)]] += np.concatenate([harmonic.real, harmonic.imag])

    @cached_property
    def _sweeps(self) -> list[_Sweep]:
        """Every sweep; made when they are first needed over time."""
        return [self._make_sweep(p) for p in self.places if p.block.kind != VOLTAGE_CHIRP_HARMONIC]

    def _make_sweep(self, response: Place) -> _Sweep:
        support = response.block.support
        given, placed = support["piece_v" if self.output == VOLTAGE else "piece_kv"], support["piece"]
        duration_s, high = given.size * placed[2], placed[4]
        count = min(scipy.fft.next_fast_len(int(_SAMPLES * high * duration_s)), given.size)
        # Fewer samples than the record has: the first three numbers count them.
        rarer = count / given.size
        wave = make_wave(find_lines(given[None])[:, : count // 2], count)
        piece = cut_piece(
            wave[0],
            np.concatenate([placed[:2] * rarer, [placed[2] / rarer], placed[3:]]),
            self.output != VOLTAGE,
            read_clock(support),
        )
        moment = support["piece_s"] / piece.interval_s
        reader = SweepReader(piece, moment, response.block.frequency_hz[: response.block.size // 2])
        harmonic = next(
            (
                p
                for p in self.places
                if (p.recording, p.block.label, p.block.kind)
                == (response.recording, response.block.label, VOLTAGE_CHIRP_HARMONIC)
            ),
            None,
        )
        state = self.state_of[id(response)]
        view = state_view(self.session, self.states[[state]], self.frequency[None, :], _SWEEP)
        return _Sweep(response, harmonic, reader, VoltageWaves.of_period(wave, duration_s, self.rig, view))
