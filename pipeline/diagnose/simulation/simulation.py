"""The simulation of a session: all its features from θ and what mechanisms add, in milliseconds.

    command → drive → V → actuation → F_A → film → T → contact → rig → F, x → sensor → drift → recorded

`Simulation` sorts the blocks of a session into families once; `predict` is then a few array operations per family. The
responses of a family and what is not linear in it are in `mechanical` and `electrical`.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence

import numpy as np

from pipeline.diagnose.features.kinds import (
    CYCLE_FORCE,
    CYCLIC_CAPACITANCE,
    RELAXATION_FORCE,
    REST_HUM,
    SPHS_CAPACITANCE,
    SPHS_DETECTION,
    SPHS_RESPONSE,
    SPHS_VOLTAGE,
    STEP_CAPACITANCE,
    STEP_FORCE,
    STEP_VOLTAGE,
    TAP_RING,
    WEIGHT_GAIN,
)
from pipeline.diagnose.features.rest import hum_score
from pipeline.diagnose.simulation.capacitance import CapacitanceFamily
from pipeline.diagnose.simulation.describing import Loads
from pipeline.diagnose.simulation.effects import NONE, Effect
from pipeline.diagnose.simulation.electrical import MultisineFamily, StepFamily
from pipeline.diagnose.simulation.families import Family, channel, rig_of, state_view
from pipeline.diagnose.simulation.mechanical import CYCLIC, RAMP, CyclicFamily, MechanicalFamily, RampFamily
from pipeline.diagnose.simulation.nodes import Elsewhere, response_nodes
from pipeline.diagnose.simulation.parameters import BaseModel, Physical, Several
from pipeline.diagnose.simulation.remembered import Remembered
from pipeline.diagnose.simulation.session import Place, Session
from pipeline.diagnose.simulation.sweeps import SWEEP, SweepFamily
from pipeline.diagnose.simulation.voltage_sweeps import OUTPUTS, VoltageSweepFamily
from pipeline.diagnose.simulation.voltage_waves import CAPACITANCE, FORCE, VOLTAGE
from schemas.arrays import Float
from schemas.metadata import RigConstants

Predicting = MechanicalFamily | StepFamily | MultisineFamily | VoltageSweepFamily | CapacitanceFamily

_STEPS = {STEP_FORCE: FORCE, STEP_CAPACITANCE: CAPACITANCE, STEP_VOLTAGE: VOLTAGE}
_MULTISINES = (SPHS_RESPONSE, SPHS_DETECTION, SPHS_VOLTAGE, SPHS_CAPACITANCE)
_MECHANICAL: dict[str, Callable[[Session, Sequence[Place], Float], MechanicalFamily]] = {
    SWEEP: SweepFamily,
    CYCLIC: CyclicFamily,
    RAMP: RampFamily,
}
_DRIFT_SIGN = {STEP_FORCE: -1.0, STEP_CAPACITANCE: 0.0, STEP_VOLTAGE: 0.0}
"""How a drift of the force counts in each kind of features; 1 in all others."""


class Simulation:
    """Predicts the features of a session. Built once per session (tens of milliseconds); `predict` changes nothing of what it says."""

    def __init__(self, session: Session, whole: Simulation | None = None) -> None:
        """`whole`: the simulation of the session that this one is a part of; its loads are what onsets are measured against."""
        self.session = session
        self._whole = whole
        self._reference: Loads | None = None
        groups: dict[tuple[object, ...], list[Place]] = {}
        for p in session.places:
            groups.setdefault((int(session.rig[p.recording]), *_family_key(p)), []).append(p)
        self._families: list[Predicting] = []
        for key, places in groups.items():
            nodes = session.recordings[places[0].recording].nodes
            if key[1] in ("step", "voltage chirp") and key[2] == VOLTAGE:
                nodes = response_nodes(RigConstants())
            if key[1] in _MECHANICAL:
                self._families.append(_MECHANICAL[str(key[1])](session, places, nodes))
            elif key[1] == "step":
                self._families.append(StepFamily(session, places, nodes, str(key[2])))
            elif key[1] == "voltage chirp":
                self._families.append(VoltageSweepFamily(session, places, nodes, str(key[2])))
            elif key[1] == "multisine":
                self._families.append(MultisineFamily(session, places))
            elif key[1] == CYCLIC_CAPACITANCE:
                self._families.append(CapacitanceFamily(session, places, nodes, CYCLIC))
        self._about: Physical | None = None if whole is None else whole._about
        self._predictions = self._remembered()
        self._single = [p for p in session.places if p.block.kind in (REST_HUM, TAP_RING, WEIGHT_GAIN)]
        self._known: tuple[Physical, Loads] | None = None
        self._drifting = [(p, _drift(session, p)) for p in session.places if "drift_s" in p.block.support]

    def predict(self, model: BaseModel, theta: Float, effect: Effect = NONE) -> Float:
        """(N,) features of the session at θ with the effects of mechanisms."""
        physical = model.physical(theta)
        values = np.zeros(self.session.size)
        loads = self.loads(physical) if effect.tension or effect.reading else None
        for family, predicted in zip(self._families, self._predictions, strict=True):
            values[family.rows] = predicted(physical, effect, loads)
        for place in self._single:
            values[place.first : place.stop] = self._one(place, physical, effect)
        self._add_drift(values, effect)
        return values

    def predict_several(self, model: BaseModel, thetas: Float, effect: Effect = NONE) -> Float:
        """(B, N) features of the session at several θ (B, P) with the same effects: at once where these are of spectra alone."""
        if len(thetas) == 1 or not effect.of_spectra:
            return np.array([self.predict(model, theta, effect) for theta in thetas])
        physicals = Several.of([model.physical(theta) for theta in thetas])
        values = np.zeros((len(thetas), self.session.size))
        for family, predicted in zip(self._families, self._predictions, strict=True):
            values[:, family.rows] = predicted.several(physicals, effect)
        for place in self._single:
            values[:, place.first : place.stop] = [self._one(place, p, effect) for p in physicals.members]
        self._add_drift(values, effect)
        return values

    def _add_drift(self, values: Float, effect: Effect) -> None:
        """What drifts add to features (..., N)."""
        for drift in effect.drift:
            for place, (recording_s, session_s, weight, rest) in self._drifting:
                values[..., place.first : place.stop] += weight @ drift(recording_s, session_s, rest)

    def about(self, physical: Physical) -> Simulation:
        """The same simulation with nodes that do for films and rigs much like one, which are fewer."""
        other = copy.copy(self)
        other._about = physical
        other._predictions = other._remembered()
        return other

    def measured_against(self, physical: Physical) -> Simulation:
        """The same simulation with onsets measured against the loads of one film, whatever film is simulated."""
        other = copy.copy(self)
        other._reference = self.loads(physical)
        return other

    def _remembered(self) -> list[Remembered]:
        return [_remembered(f, self._about) for f in self._families]

    def loads(self, physical: Physical) -> Loads:
        """Largest loads of the session as the plain film has them: what onsets are measured against."""
        if self._reference is not None:
            return self._reference
        if self._whole is not None:
            return self._whole.loads(physical)
        if self._known is None or self._known[0] != physical:
            found = [f.loads(physical) for f in self._families if isinstance(f, MechanicalFamily | StepFamily)]
            total = Loads(
                max((x.tension_n for x in found), default=0.0),
                max((x.fall_n for x in found), default=0.0),
                max((x.reading_n for x in found), default=0.0),
            )
            self._known = physical, total
        return self._known[1]

    def _one(self, place: Place, physical: Physical, effect: Effect) -> Float:
        """Rest and calibrations."""
        if place.block.kind == REST_HUM:
            total = np.zeros(place.block.size)
            support = place.block.support
            for frequency, amplitude_n in effect.hum_n:
                amplitude = np.where(place.block.frequency_hz == frequency, amplitude_n, 0.0)
                total = total + hum_score(amplitude, support["variance"], support["freedom"])
            return total
        rig = rig_of(physical, int(self.session.rig[place.recording]), effect)
        if place.block.kind == WEIGHT_GAIN:
            still = state_view(self.session, np.array([place.state]), np.zeros((1, 1)), "weight")
            return np.array([rig.gain * float(np.real(np.ravel(channel(effect.force, still))[0]))])
        if not np.isfinite(rig.clamp_omega):
            return np.asarray(place.block.value)
        return np.array([np.log(rig.clamp_omega / (2 * np.pi)), rig.damping_ratio])


def _remembered(family: Predicting, about: Physical | None) -> Remembered:
    """The predictions of a family: from few nodes as long as these carry the resonance, where they are known to do so about one film."""
    own = family.with_few_nodes(about) if about is not None and isinstance(family, Family) else None
    few = family if own is None else own

    def predict(physical: Physical, effect: Effect, loads: Loads | None) -> Float:
        try:
            return few.predict(physical, effect, loads)
        except Elsewhere:
            return family.predict(physical, effect, loads)

    def several(physicals: Several, effect: Effect) -> Float:
        try:
            return few.of_spectra(physicals, effect)
        except Elsewhere:
            return family.of_spectra(physicals, effect)

    return Remembered(predict, several, family.inputs, family.rig)


def _family_key(p: Place) -> tuple[object, ...]:
    kind = p.block.kind
    if kind in _STEPS:
        return "step", _STEPS[kind]
    if kind in OUTPUTS:
        return "voltage chirp", OUTPUTS[kind]
    if kind in _MULTISINES:
        wave = p.block.support["wave"].size
        return "multisine", kind, p.block.support["lines"].tobytes(), float(p.block.support["period_s"][0]), wave
    if kind in (RELAXATION_FORCE, CYCLE_FORCE):
        return (RAMP,)
    if kind.startswith("chirp."):
        return (SWEEP,)
    if kind == CYCLIC_CAPACITANCE:
        return (kind,)
    return (CYCLIC,) if kind.startswith("cyclic.") else ("single", kind)


def _drift(session: Session, p: Place) -> tuple[Float, Float, Float, float]:
    """Times since the start of the recording and of the session, weights (n, q) with the feature's sign, rest force."""
    time = p.block.support["drift_s"]
    weight = p.block.support["drift_weight"].reshape(p.block.size, time.size) * _DRIFT_SIGN.get(p.block.kind, 1.0)
    rest = float(np.nan_to_num(session.states.rest_force_n[p.state]))
    return time, time + session.start_s[p.recording], weight, rest
