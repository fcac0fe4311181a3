"""Effects scaled to a session: the constants that the stages use, and the severity in the contract's keys.

Scaling needs the largest loads of the plain session (`Loads`). Does not belong here: what the effects do.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tests.helpers.truth_rig import ladders
from tests.helpers.truth_rig.effects import Effect, Shape
from tests.helpers.truth_rig.material import Specimen
from tests.helpers.truth_rig.mechanics import Law

Float = NDArray[np.float64]

EMPTY: Float = np.zeros(0)
_REFERENCE_LAG_S = 2e-3


_LEAST = 1e-6
"""Least amplitude and extension, mm, that effects are scaled to."""


@dataclass(frozen=True)
class Loads:
    """Largest loads of the plain session: extension and its amplitude (half the swing) mm, tension over and under the preload N, force reading over the
    preload N, voltage kV, clamp speed mm/s, dissipated power N mm/s; path of the driven end mm, exposure s at the largest
    voltage, length of the session s."""

    extension: float = 0.0
    amplitude: float = 0.0
    tension: float = 0.0
    fall: float = 0.0
    reading: float = 0.0
    voltage: float = 0.0
    clamp_speed: float = 0.0
    power: float = 0.0
    path: float = 0.0
    exposure: float = 0.0
    duration: float = 0.0

    def with_loads(self, other: Loads) -> Loads:
        """Both together: the largest of the loads, the sum of path, exposure and time."""
        sums = ("path", "exposure", "duration")
        names = [f.name for f in dataclasses.fields(self)]
        pairs = {name: (getattr(self, name), getattr(other, name)) for name in names}
        return Loads(**{name: sum(pair) if name in sums else max(pair) for name, pair in pairs.items()})


@dataclass(frozen=True)
class Hidden:
    """All that the stages need. `equivalent`: per effect, what the contract's severity keys would say.

    `strip`, `ladder`: relaxed spring N/mm (0 for the ladder), arms' springs and times; `tears`: path mm and loss.
    """

    effects: Mapping[str, Effect]
    law: Law
    ladder: tuple[Float, Float]
    strip: tuple[float, Float, Float]
    tears: tuple[Float, Float]
    equivalent: Mapping[str, Mapping[str, Shape]]

    def get(self, id: str) -> Effect | None:
        return self.effects.get(id)


@dataclass
class _Draft:
    """A session's constants while its effects are being worked in."""

    specimen: Specimen
    loads: Loads
    rng: np.random.Generator
    law: Law
    ladder_k: list[Float] = field(default_factory=lambda: [EMPTY])
    ladder_tau: list[Float] = field(default_factory=lambda: [EMPTY])
    strip: tuple[float, Float, Float] = (0.0, EMPTY, EMPTY)
    tears: tuple[Float, Float] = (EMPTY, EMPTY)

    def add(self, springs: Float, times: Float) -> None:
        self.ladder_k.append(springs)
        self.ladder_tau.append(times)


def resolve(effects: tuple[Effect, ...], specimen: Specimen, loads: Loads, rng: np.random.Generator) -> Hidden:
    """Scale effects to a session; those of severity 0 leave no trace. `rng` places the tears."""
    rig = specimen.rig
    # In a session without any test of a kind what scales with its loads is there at once, and shows nothing.
    loads = replace(loads, amplitude=max(loads.amplitude, _LEAST), extension=max(loads.extension, _LEAST))
    draft = _Draft(specimen, loads, rng, Law(rig.mass, rig.stiffness, rig.damping, preload(specimen, loads)))
    present = {effect.id: effect for effect in effects if effect.severity != 0}
    said = {
        id: _SCALE.get(id, _as_it_is)(draft, effect) for id, effect in sorted(present.items(), key=_saturation_last)
    }
    arms = np.concatenate(draft.ladder_k), np.concatenate(draft.ladder_tau)
    return Hidden(present, draft.law, arms, draft.strip, draft.tears, said)


def _saturation_last(item: tuple[str, Effect]) -> bool:
    """The limit of the channel refers to the preload, which `slack` sets."""
    return item[0] == "sensor_saturation"


def _as_it_is(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    """An effect whose stage scales it; its shape is said too where it is one of the contract's keys."""
    said: dict[str, Shape] = {effect.kind.key: effect.severity}
    return said | ({"channel": effect.text("channel")} if "channel" in effect.kind.shape else {})


def _rig_constants(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    mass, stiffness = (effect.severity * effect.number(part) for part in ("mass_part", "stiffness_part"))
    law = draft.law
    draft.law = law._replace(mass=law.mass * (1 + mass), cell_stiffness=law.cell_stiffness * (1 + stiffness))
    return {"mass_error": mass, "stiffness_error": stiffness}


def _load_cell_damping(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    law, s = draft.law, effect.severity
    if effect.text("form") == "drag":
        drag, speed = 2 * s * math.sqrt(law.cell_stiffness * law.mass), max(0.15 * draft.loads.clamp_speed, 1e-9)
        draft.law = law._replace(drag=drag, drag_speed=speed)
    else:
        # A damped absorber adds μ/(4 ζ2) of damping ratio at its own frequency.
        ratio = 0.06
        mass = 4 * ratio * s * law.mass
        rate = effect.number("tuning") * math.sqrt(law.cell_stiffness / law.mass)
        draft.law = law._replace(
            second_mass=mass,
            second_stiffness=mass * rate**2,
            second_damping=2 * ratio * mass * rate,
            second_speed=max(0.5 * draft.loads.clamp_speed, 1e-9),
        )
    return {"damping_ratio": s}


def _drive_lag(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    rise = effect.severity
    return {
        "rise_time_constant_s": rise,
        "fall_time_constant_s": rise * effect.number("fall_ratio"),
        "slew_kv_per_s": slew(effect),
    }


def _amplitude_softening(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    largest, s = draft.loads.amplitude, effect.severity
    scale = effect.number("scale_share") * largest
    draft.law = draft.law._replace(payne_drop=s / -math.expm1(-((largest / scale) ** 1.2)), payne_scale=scale)
    return {"drop": s, "strain_scale": scale / draft.specimen.length_mm}


def _cyclic_softening(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    draft.law = draft.law._replace(
        damage_loss=effect.severity,
        damage_scale=draft.loads.extension,
        damage_curvature=effect.number("curvature"),
        damage_cycles=effect.number("cycles"),
    )
    return {"loss": effect.severity, "cycles": effect.number("cycles")}


def _missing_relaxation(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    weights, times = ladders.stretched_exponential(round(effect.number("beta"), 3))
    time_constant = effect.number("time_constant_s")
    draft.add(effect.severity * draft.specimen.film.k0 * weights, time_constant * times)
    return {"stiffness_ratio": effect.severity, "time_constant_s": time_constant}


def _power_law_relaxation(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    springs, times = ladders.power_law(effect.number("exponent"))
    draft.add(effect.severity * draft.specimen.film.k0 * springs, times)
    return {"stiffness_ratio": effect.severity, "exponent": effect.number("exponent")}


def _thermal_softening(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    rise, heat_s = effect.number("rise_k"), 60.0
    draft.law = draft.law._replace(
        heat_per_energy=effect.number("self_heating") * rise / max(draft.loads.power * heat_s, 1e-12),
        heat_time=heat_s,
        heat_loss=effect.severity,
    )
    return {"per_kelvin": effect.severity, "rise_k": rise}


def _electrode_degradation(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    return {"loss": effect.severity, "exposure_scale_s": exposure_scale(effect, draft.loads)}


def _slack(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    s = effect.severity
    draft.law = draft.law._replace(
        preload=max(draft.loads.fall, 1e-6) / (1 + s),
        slack_softness=effect.number("softness"),
        slack_residual=effect.number("residual"),
    )
    return {"overload": s, "onset": 1 / (1 + s), "preload_n": draft.law.preload}


def _strain_stiffening(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    s, largest = effect.severity, draft.loads.extension
    offset, limit = _gent(s, effect.number("offset_share"), largest)
    draft.law = draft.law._replace(limit_mm=limit, limit_offset=offset)
    # Grown as the square of the strain to the 50 % that the severity key speaks of.
    return {"stiffening_at_largest": s, "stiffening": s * (0.5 * draft.specimen.length_mm / largest) ** 2}


def _wrinkling(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    return {"overload": effect.severity, "onset_kv": draft.loads.voltage / (1 + effect.severity)}


def _clamp_slip(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    s, film = effect.severity, draft.specimen.film
    force = draft.loads.tension / (1 + s)
    draft.law = draft.law._replace(
        slip_force=force,
        slip_hardening=effect.number("hardening") * film.k0,
        slip_spread=effect.number("spread"),
    )
    return {"overload": s, "slip_force": 1 / (1 + s), "slip_force_n": force}


def _sensor_saturation(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    return {"overload": effect.severity, "limit_n": saturation_limit(effect.severity, draft.law, draft.loads)}


def _passive_strip(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    share, time_constant = effect.severity, effect.number("time_constant_s")
    spring = draft.specimen.film.k0 * (1 - share) / share
    arms = spring * effect.number("relaxing") * np.array([0.7, 0.3])
    draft.strip = (spring, arms, time_constant * np.array([1.0, 0.125]))
    return {"ratio": 1 - share, "time_constant_s": time_constant}


def _edge_tear(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    jumps = round(effect.number("jumps"))
    losses = draft.rng.dirichlet(np.full(jumps, 3.0)) * effect.severity
    draft.tears = (np.sort(draft.rng.uniform(0.1, 0.9, jumps)) * draft.loads.path, losses)
    return {"loss": effect.severity}


def _clamp_misalignment(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    slope = effect.severity * draft.specimen.film.k0 / max(draft.loads.extension, 1e-9)
    draft.law = draft.law._replace(misaligned=slope, misaligned_time=effect.number("rate_s"))
    return {"share": effect.severity}


def _acoustic_resonance(draft: _Draft, effect: Effect) -> dict[str, Shape]:
    f, damping = effect.number("frequency_hz"), effect.number("damping")
    at_resonance = effect.severity * abs(complex(draft.specimen.film.stiffness(np.array([f]))[0]))
    draft.law = draft.law._replace(
        wave_stiffness=2 * damping * at_resonance, wave_rate=2 * math.pi * f, wave_damping=damping
    )
    return {"stiffness_ratio": effect.severity}


_SCALE: Mapping[str, Callable[[_Draft, Effect], Mapping[str, Shape]]] = {
    "rig_constants": _rig_constants,
    "load_cell_damping": _load_cell_damping,
    "drive_lag": _drive_lag,
    "amplitude_softening": _amplitude_softening,
    "cyclic_softening": _cyclic_softening,
    "missing_relaxation": _missing_relaxation,
    "power_law_relaxation": _power_law_relaxation,
    "thermal_softening": _thermal_softening,
    "electrode_degradation": _electrode_degradation,
    "slack": _slack,
    "strain_stiffening": _strain_stiffening,
    "wrinkling": _wrinkling,
    "clamp_slip": _clamp_slip,
    "sensor_saturation": _sensor_saturation,
    "passive_strip": _passive_strip,
    "edge_tear": _edge_tear,
    "clamp_misalignment": _clamp_misalignment,
    "acoustic_resonance": _acoustic_resonance,
}


def preload(specimen: Specimen, loads: Loads) -> float:
    """Preload of the plain rig: a film that never goes slack."""
    electrical = specimen.force_per_voltage_squared * loads.voltage**2
    return max(specimen.preload_margin * loads.fall, 3 * electrical, 0.2)


def slew(effect: Effect) -> float:
    """Slew limit in kV/s of a lag: given at 2 ms, higher for a faster amplifier, so that it vanishes with the lag."""
    return effect.number("slew_kv_per_s") * _REFERENCE_LAG_S / effect.severity


def exposure_scale(effect: Effect, loads: Loads) -> float:
    return effect.number("exposure_share") * max(loads.exposure, 1.0)


def saturation_limit(severity: float, law: Law, loads: Loads) -> float:
    """Force reading at which the channel begins to clip."""
    return (law.preload + loads.reading) / (1 + severity)


def _gent(stiffening: float, offset_share: float, largest: float) -> tuple[float, float]:
    """Offset and limit mm of the strain measure whose tangent is 1 + `stiffening` at the largest extension.

    The measure is v/(1 − v²) at v = offset + e/limit, the offset standing at `offset_share` of the largest v.
    """

    def excess(top: float) -> float:
        low = offset_share * top
        slopes = [(1 + v * v) / (1 - v * v) ** 2 for v in (low, top)]
        return slopes[1] / slopes[0] - 1 - stiffening

    low, high = 0.0, 0.9
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if excess(middle) < 0 else (low, middle)
    top = 0.5 * (low + high)
    return offset_share * top, largest / (top * (1 - offset_share))
