"""The truth rig: one recording simulated through drive, actuation, film, contact, rig, sensors and drift.

`TruthRig.run` is pure: it takes what the session remembers and returns the signals and the new memory. Does not belong
here: which recordings a session has (`session`), how its effects are scaled (`hidden`), noise (`session`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tests.helpers.truth_rig import actuation, drive, mechanics, sensors
from tests.helpers.truth_rig.design import Plan
from tests.helpers.truth_rig.hidden import EMPTY, Hidden, Loads, exposure_scale, saturation_limit, slew
from tests.helpers.truth_rig.material import NOMINAL_GAIN_KV_PER_V, Specimen

Float = NDArray[np.float64]

ROOM_C = 23.0
_TONNES_PER_KG = 1e-3
_GRAVITY_M_PER_S2 = 9.80665
_CRACKS, _OPEN_EARLY = 0.3, 0.5
"""Share of the capacitance, over that of the electrode lost, that cracks take at the largest strain; strain, as a share of that, from
which they open in proportion to it instead of with its square."""
_CROSSTALK_S = 1e-3
_DRIFT_TRUE_AT_S = 20.0
_CALIBRATIONS = ("tap", "weight")


@dataclass(frozen=True)
class Memory:
    """What a session remembers from recording to recording.

    `clock_s` since the start of the session; `film` see `mechanics`; `ladder` forces of the further arms N; `exposure_s`
    of the electrodes; `wrinkles` kV²; `cell` of the load cell.
    """

    clock_s: float = 0.0
    film: Float = field(default_factory=lambda: np.zeros(mechanics.MEMORY))
    ladder: Float = field(default_factory=lambda: EMPTY)
    exposure_s: float = 0.0
    wrinkles: float = 0.0
    cell: Float = field(default_factory=lambda: np.zeros(sensors.CELL_MEMORY))


@dataclass(frozen=True)
class Signals:
    """One recording as it truly is: (n,) per quantity at `interval_s`, the memory afterwards, and the loads it made."""

    interval_s: float
    values: Mapping[str, Float]
    memory: Memory
    loads: Loads


@dataclass(frozen=True)
class TruthRig:
    """A specimen on its rig with its effects, which are scaled to the loads of the plain session, `plain`."""

    specimen: Specimen
    hidden: Hidden
    plain: Loads

    def fresh(self) -> Memory:
        """The memory at the start of a session."""
        return Memory(ladder=np.zeros(self.hidden.ladder[0].size))

    def idle(self, memory: Memory, seconds: float) -> Memory:
        """The memory after the rig stood still."""
        film = memory.film.copy()
        film[mechanics.HEAT] *= math.exp(-seconds / self.hidden.law.heat_time)
        wrinkling = self.hidden.get("wrinkling")
        recovery_s = wrinkling.number("recovery_s") if wrinkling else 1.0
        return replace(
            memory,
            clock_s=memory.clock_s + seconds,
            film=film,
            ladder=memory.ladder * np.exp(-seconds / self.hidden.ladder[1]),
            wrinkles=memory.wrinkles * math.exp(-seconds / recovery_s),
        )

    def run(self, plan: Plan, memory: Memory, rng: np.random.Generator) -> Signals:
        """One recording. `rng` serves what is random in effects (phase and wander of the mains), not the noise."""
        command_v = plan.command / NOMINAL_GAIN_KV_PER_V
        wanted = command_v * self.specimen.rig.amplifier_gain
        seen, on_film = self._drive(plan, wanted, memory)
        squared, exposure_s, wrinkles = self._actuation(plan, on_film, memory)
        electrodes = self._electrodes(exposure_s)
        actuation_n = squared * self.specimen.force_per_voltage_squared * electrodes
        room = self._room(plan, memory)
        film, ladder, cell = memory.film.copy(), memory.ladder.copy(), memory.cell.copy()
        clamp, extension, tension = self._mechanics(plan, actuation_n, room, film, ladder)
        true_force = self.hidden.law.cell_stiffness * clamp
        fine = {
            "displacement": plan.displacement[::2],
            "force": self._load_cell(plan, true_force, on_film, cell),
            "voltage": seen[::2],
            "command": command_v[::2],
            "capacitance": self._capacitance(plan, actuation_n, room, extension, electrodes),
            "leakage_current": drive.leakage_current(wanted, seen)[::2],
        }
        delay = self.hidden.get("sensor_delay")
        if delay is not None:
            channel = delay.text("channel")
            fine[channel] = sensors.delayed(fine[channel], plan.step_s, delay.severity, delay.text("form"))
        values = {name: signal[:: plan.substeps] for name, signal in fine.items()}
        time_s: Float = np.arange(plan.samples) * plan.sample_interval_s
        values["temperature"] = (
            ROOM_C
            + self._warming(plan, memory.clock_s + time_s)
            + np.linspace(memory.film[mechanics.HEAT], film[mechanics.HEAT], plan.samples)
        )
        self._electronics(plan, values, time_s, memory.clock_s, rng)
        return Signals(
            interval_s=plan.sample_interval_s,
            values=values,
            memory=Memory(memory.clock_s + plan.duration_s, film, ladder, float(exposure_s[-1]), wrinkles, cell),
            loads=Loads(
                extension=float(np.abs(extension).max()),
                amplitude=float(np.ptp(extension)) / 2,
                tension=float(np.abs(tension).max()),
                fall=float(-tension.min()),
                reading=float(np.abs(true_force).max()),
                voltage=float(np.abs(on_film).max()),
                clamp_speed=float(np.abs(np.diff(clamp)).max() / plan.step_s),
                power=float((tension[1:] * np.diff(plan.displacement[::2])).sum() / plan.duration_s),
                path=float(np.abs(np.diff(plan.displacement)).sum()),
                duration=plan.duration_s,
            ),
        )

    def _drive(self, plan: Plan, wanted: Float, memory: Memory) -> tuple[Float, Float]:
        """Voltage of the monitor and on the film, kV at half steps."""
        half = plan.step_s / 2
        seen = wanted
        if lag := self.hidden.get("drive_lag"):
            seen = drive.lagged(seen, half, lag.severity, lag.severity * lag.number("fall_ratio"), slew(lag))
        if leakage := self.hidden.get("leakage"):
            seen = drive.drooped(seen, half, leakage.severity, self.plain.voltage, leakage.number("build_up_s"))
        on_film = seen
        if lag and lag.number("behind") > 0:
            behind = lag.severity * lag.number("behind")
            on_film = drive.lagged(seen, half, behind, behind, slew(lag))
        offset = self.hidden.get("drive_offset")
        if offset is not None and plan.loading == "electrical":
            if offset.text("form") == "rectified":
                on_film = drive.dead_zone(seen, offset.severity)
            else:
                time_s: Float = memory.clock_s + np.arange(seen.size) * half
                on_film = drive.offset(seen, offset.severity, time_s, self.plain.duration / 2)
        return seen, on_film

    def _actuation(self, plan: Plan, voltage: Float, memory: Memory) -> tuple[Float, Float, float]:
        """Squared voltage that acts kV², exposure s, both at half steps, and the wrinkling left at the end kV²."""
        half, highest = plan.step_s / 2, max(self.plain.voltage, 1e-9)
        squared = voltage * voltage
        exposure_s = actuation.exposure(squared, half, highest, memory.exposure_s)
        acting, wrinkles = squared, 0.0
        if field_effect := self.hidden.get("field_dependent_permittivity"):
            acting = acting * actuation.saturating(voltage, field_effect.severity, highest, field_effect.text("form"))
        if dispersion := self.hidden.get("frequency_dependent_permittivity"):
            acting = actuation.dispersed(acting, half, dispersion.severity)
        if wrinkling := self.hidden.get("wrinkling"):
            acting, wrinkles = actuation.wrinkled(
                acting,
                half,
                highest / (1 + wrinkling.severity),
                wrinkling.number("rise_s"),
                wrinkling.number("recovery_s"),
                wrinkling.number("hysteresis"),
                memory.wrinkles,
            )
        if frame := self.hidden.get("frame_attraction"):
            acting = acting + actuation.attracted(squared, half, frame.severity, highest, frame.number("charge_s"))
        return acting, exposure_s, wrinkles

    def _electrodes(self, exposure_s: Float) -> Float:
        """Share of the electrodes that is left, at half steps or (1,)."""
        degradation = self.hidden.get("electrode_degradation")
        if degradation is None:
            return np.ones(1)
        scale_s = exposure_scale(degradation, self.plain)
        return actuation.degraded(exposure_s, degradation.severity, scale_s, degradation.number("stretch"))

    def _warming(self, plan: Plan, time_s: Float) -> Float:
        """Warming of the room at the film since the session began, K: by itself and as the design says."""
        thermal, set_k = self.hidden.get("thermal_softening"), float(plan.design["warmer_k"] or 0.0)
        if thermal is None:
            return np.full(time_s.size, set_k)
        fast, slow = (-np.expm1(-time_s / thermal.number(name)) for name in ("fast_s", "slow_s"))
        return np.asarray(set_k + thermal.number("rise_k") * (0.5 * fast + 0.5 * slow))

    def _room(self, plan: Plan, memory: Memory) -> Float:
        """Stiffness of the film over its nominal one by what the room does, per step or (1,)."""
        thermal, humidity = self.hidden.get("thermal_softening"), self.hidden.get("humidity")
        if thermal is None and humidity is None:
            return np.ones(1)
        steps = (plan.displacement.size - 1) // 2
        time_s: Float = memory.clock_s + (np.arange(steps) + 0.5) * plan.step_s
        gain = np.ones(steps)
        if thermal is not None:
            gain *= np.exp(-thermal.severity * self._warming(plan, time_s))
        if humidity is not None:
            turns = time_s / humidity.number("period_s") + humidity.number("phase")
            gain *= 1 + humidity.severity * np.sin(2 * np.pi * turns)
        return gain

    def _mechanics(
        self, plan: Plan, actuation_n: Float, room: Float, film: Float, ladder: Float
    ) -> tuple[Float, Float, Float]:
        """Clamp position mm, film extension mm, tension over the preload N, at steps; changes `film` and `ladder`."""
        steps = (plan.displacement.size - 1) // 2
        out = np.zeros(steps + 1), np.zeros(steps + 1), np.zeros(steps + 1)
        law = self.hidden.law
        if plan.test == "weight":
            return _staircase(plan) / law.cell_stiffness, out[1], out[2]
        law = law._replace(mass=law.mass + plan.design["extra_clamp_mass_kg"] * _TONNES_PER_KG)
        model, strip, arms, kick = self.specimen.film, self.hidden.strip, self.hidden.ladder, EMPTY
        k0, k, tau = model.k0, np.array(model.k), np.array(model.tau)
        x0 = plan.displacement + float(plan.design["pre_extension_mm"])
        if plan.test == "tap":
            k0, k, tau, arms, strip = 0.0, EMPTY, EMPTY, (EMPTY, EMPTY), (0.0, EMPTY, EMPTY)
            law = mechanics.Law(*law[:4])._replace(
                **{name: getattr(law, name) for name in mechanics.OF_THE_CELL}, preload=0.0
            )
            kick, film = _taps(plan, law), np.zeros(mechanics.MEMORY)
        mechanics.integrate(
            x0, np.gradient(x0, plan.step_s / 2), actuation_n, room, plan.step_s, law.record(), k0, k, tau,
            *strip, *arms, *self.hidden.tears, film, ladder if arms[0].size else EMPTY, kick, *out,
        )  # fmt: skip
        return out

    def _load_cell(self, plan: Plan, force: Float, on_film: Float, cell: Float) -> Float:
        """Force over the preload as the load cell and its cable give it, N at steps; changes `cell`."""
        reading = force
        if hysteresis := self.hidden.get("load_cell_hysteresis"):
            reading = sensors.remembering(
                reading, plan.step_s, hysteresis.severity, self.plain.reading, hysteresis.number("creep_s"), cell
            )
        crosstalk = self.hidden.get("voltage_crosstalk")
        if crosstalk is not None:
            smooth = sensors.smoothed(on_film[::2], plan.step_s, _CROSSTALK_S)
            reading = reading + crosstalk.severity * np.gradient(smooth, plan.step_s)
        return reading

    def _capacitance(self, plan: Plan, actuation_n: Float, room: Float, extension: Float, electrodes: Float) -> Float:
        """Capacitance of the sensing region pF at steps: its length follows the tension through the film's compliance."""
        if plan.test not in ("cyclic", "step"):
            return np.zeros(extension.size)
        creep = np.zeros(extension.size)
        if plan.test == "step":
            model, arms = self.specimen.film, self.hidden.ladder
            k, tau = np.concatenate([model.k, arms[0]]), np.concatenate([model.tau, arms[1]])
            creep = mechanics.creep(actuation_n[::2], room, plan.step_s, model.k0, k, tau)
        held = float(plan.design["pre_extension_mm"])
        strain = (extension - creep) / self.specimen.length_mm
        left = electrodes if electrodes.size == 1 else electrodes[::2]
        stretched = np.abs(extension - held) / max(self.plain.extension, 1e-9)
        open_cracks = stretched**2 * (1 + _OPEN_EARLY) / (stretched + _OPEN_EARLY)
        return np.asarray(
            self.specimen.rest_capacitance_pf * (1 + strain) * left * (1 - _CRACKS * (1 - left) * open_cracks)
        )

    def _electronics(
        self, plan: Plan, values: dict[str, Float], time_s: Float, clock_s: float, rng: np.random.Generator
    ) -> None:
        """Preload, hum, drift, gain and clipping of what is recorded; changes `values`."""
        law = self.hidden.law
        rest = 0.0 if plan.test in _CALIBRATIONS else law.preload
        force = values["force"] + rest
        if hum := self.hidden.get("mains_hum"):
            force = force + sensors.hum(time_s, hum.severity, hum.number("second"), hum.number("mains_hz"), rng)
        if drift := self.hidden.get("baseline_drift"):
            over_session = drift.text("form") == "session"
            since, true_at = (clock_s, self.plain.duration / 2) if over_session else (0.0, _DRIFT_TRUE_AT_S)
            force = force + sensors.drift(since + time_s, rest, drift.severity, drift.number("onset_s"), true_at)
        values["force"] = force
        if gain := self.hidden.get("gain_error"):
            values[gain.text("channel")] = values[gain.text("channel")] * (1 + gain.severity)
        if saturation := self.hidden.get("sensor_saturation"):
            limit = saturation_limit(saturation.severity, law, self.plain)
            values["force"] = sensors.soft_clip(values["force"], limit, saturation.number("softness"))


def _staircase(plan: Plan) -> Float:
    """Pull of the weights N at steps: nothing, each mass, nothing; joined by short ramps."""
    levels = [0.0, *(mass * _GRAVITY_M_PER_S2 for mass in plan.design["masses_kg"]), 0.0]
    t = np.arange((plan.displacement.size - 1) // 2 + 1) * plan.step_s
    edges = np.repeat(np.arange(1, len(levels)) * plan.design["plateau_s"], 2) + np.tile([0.0, 0.3], len(levels) - 1)
    return np.asarray(np.interp(t, edges, np.repeat(levels, 2)[1:-1]))


def _taps(plan: Plan, law: mechanics.Law) -> Float:
    """Speed mm/s that taps give the clamp before each step."""
    kick = np.zeros((plan.displacement.size - 1) // 2)
    first = np.arange(plan.design["taps"]) * plan.design["tap_every_s"] + 0.5
    speed = plan.design["tap_n"] / math.sqrt(law.cell_stiffness * law.mass)
    kick[np.round(first / plan.step_s).astype(int)] = speed
    return kick
