"""Tests that command the amplifier: multisines, voltage steps, force maps."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pipeline.physics import excitation
from pipeline.physics.compliance import Compliance
from pipeline.simulate.bench import Bench, Film, Signals
from pipeline.simulate.procedures.base import INTERVALS_PER_CYCLE, Clock, Sweeps, amplifier_interval_s
from pipeline.simulate.specimen import EPSILON_0_N_PER_KV2, Specimen
from pipeline.simulate.tables import choice, number, numbers, whole
from schemas.arrays import Float
from schemas.errors import UsageError


class Electrical(ABC):
    """Shared by the tests that command the amplifier."""

    loading: ClassVar[str] = "electrical"
    quantities: ClassVar[tuple[str, ...]] = ("command", "voltage", "force", "capacitance")

    @abstractmethod
    def voltage(self, clock: Clock, rng: np.random.Generator) -> Float: ...

    def check(self, specimen: Specimen | None, where: str) -> None:
        if specimen is None:
            raise UsageError("this test needs a specimen", where=where)
        specimen.film(electrical=True)

    def film(self, specimen: Specimen | None) -> Film:
        return Film() if specimen is None else specimen.film(electrical=True)

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        command = bench.amplifier.command_for(self.voltage(clock, rng))
        return bench.run(Signals(clock.interval_s, {"command": command}))


@dataclass(frozen=True, kw_only=True)
class Sphs(Electrical):
    """Schroeder-phased harmonic sequence with the square-root drive, so that V² has the lines and no others."""

    protocol: ClassVar[str] = "sphs"
    drive_kv: float = number(above=0)
    period_s: float = number(1.0, above=0)
    periods: int = whole(20)
    frequency_stop_hz: float = number(100.0, above=0)
    lines: str = choice("odd", "full", "random_odd", default="odd")
    rest_s: float = number(0.5, at_least=0)

    @property
    def duration_s(self) -> float:
        return self.rest_s + self.periods * self.period_s

    def finest_interval_s(self, bench: Bench) -> float:
        return min(1 / (INTERVALS_PER_CYCLE * self.frequency_stop_hz), amplifier_interval_s(bench))

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {
            "frequency_start_hz": 1 / self.period_s,
            "frequency_stop_hz": self.frequency_stop_hz,
            "period_s": self.period_s,
            "periods": self.periods,
            "lines": self.lines,
            "drive_kv": self.drive_kv,
        }

    def voltage(self, clock: Clock, rng: np.random.Generator) -> Float:
        count = math.floor(self.frequency_stop_hz * self.period_s + 1e-9)
        lines = excitation.excited_lines(self.lines, count, rng)
        rest, period = round(self.rest_s / clock.interval_s), round(self.period_s / clock.interval_s)
        u = excitation.schroeder_multisine(period, lines)
        one = excitation.square_root_drive(u, self.drive_kv)
        whole_record = np.concatenate([np.zeros(rest), np.tile(one, self.periods + 1)])
        return whole_record[: clock.samples]


@dataclass(frozen=True, kw_only=True)
class VoltageChirp(Sweeps, Electrical):
    """Sweeps of the voltage about a bias, which it is brought to at the start: V = bias_kv + swing_kv sin φ, never negative."""

    protocol: ClassVar[str] = "chirp"
    bias_kv: float = number(above=0)
    swing_kv: float = number(above=0)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.swing_kv > self.bias_kv:
            raise ValueError("swing_kv is above bias_kv: the amplifier gives no negative voltage")

    @property
    def lead_s(self) -> float:
        return 2 * self.rest_s

    def finest_interval_s(self, bench: Bench) -> float:
        return min(1 / (2 * INTERVALS_PER_CYCLE * self.frequency_stop_hz), amplifier_interval_s(bench))

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {
            **self.describe_sweeps(),
            "drive_kv": self.bias_kv + self.swing_kv,
        }

    def voltage(self, clock: Clock, rng: np.random.Generator) -> Float:
        swing = self.make_sweeps(
            clock.time_s,
            amplitude=self.swing_kv,
            taper_start_s=0.05 * self.sweep_s,
            taper_stop_s=0.02 * self.sweep_s,
        )
        brought = excitation.ramp(
            clock.time_s, start_s=0.5 * self.rest_s, duration_s=0.5 * self.rest_s, height=self.bias_kv
        )
        return brought + swing


@dataclass(frozen=True, kw_only=True)
class VoltageSteps(Electrical):
    """Voltage on and off: one level for `cycles` cycles, or one cycle for each of `levels_kv`; from `bias_kv` if given."""

    protocol: ClassVar[str] = "step"
    levels_kv: tuple[float, ...] = numbers(above=0)
    cycles: int = whole(1)
    on_s: float = number(above=0)
    off_s: float = number(at_least=0)
    bias_kv: float = number(0.0, at_least=0)
    rest_s: float = number(2.0, at_least=0)

    def __post_init__(self) -> None:
        if self.cycles > 1 and len(self.levels_kv) > 1:
            raise ValueError("either several cycles of one level or one cycle of several levels")

    @property
    def duration_s(self) -> float:
        return self.rest_s + self.cycles * len(self.levels_kv) * (self.on_s + self.off_s)

    def finest_interval_s(self, bench: Bench) -> float:
        return amplifier_interval_s(bench)

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {
            "drive_kv": max(self.levels_kv),
            "on_s": self.on_s,
            "off_s": self.off_s,
            "cycles": self.cycles * len(self.levels_kv),
            "controller": "open",
        }

    def voltage(self, clock: Clock, rng: np.random.Generator) -> Float:
        levels = self.levels_kv * self.cycles
        above = tuple(level - self.bias_kv for level in levels)
        pulses = excitation.pulses(clock.time_s, levels=above, on_s=self.on_s, off_s=self.off_s, first_s=self.rest_s)
        return self.bias_kv + pulses


@dataclass(frozen=True, kw_only=True)
class ForceMap:
    """Voltage on and off at one pair of stretches, both forces of the stretched film held at fixed length.

    Blocked on a stiff rig, so the drop of tension is the Maxwell force at once (thesis, eq 3.7); `repeat_sd` is the
    relative scatter between the cycles, whose electrodes are painted anew.
    """

    protocol: ClassVar[str] = "force_map"
    loading: ClassVar[str] = "electrical"
    quantities: ClassVar[tuple[str, ...]] = ("voltage", "force_1", "force_2")
    stretch_1: float = number(above=0)
    stretch_2: float = number(above=0)
    drive_kv: float = number(above=0)
    cycles: int = whole(5)
    on_s: float = number(above=0)
    off_s: float = number(above=0)
    rest_s: float = number(1.0, at_least=0)
    repeat_sd: float = number(0.0, at_least=0)

    @property
    def duration_s(self) -> float:
        return self.rest_s + self.cycles * (self.on_s + self.off_s)

    def finest_interval_s(self, bench: Bench) -> float:
        return amplifier_interval_s(bench)

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {
            "stretch_1": self.stretch_1,
            "stretch_2": self.stretch_2,
            "drive_kv": self.drive_kv,
            "on_s": self.on_s,
            "off_s": self.off_s,
            "cycles": self.cycles,
        }

    def check(self, specimen: Specimen | None, where: str) -> None:
        if specimen is None:
            raise UsageError("this test needs a specimen", where=where)
        self._forces_per_voltage_squared(specimen)

    def film(self, specimen: Specimen | None) -> Film:
        return Film()

    def _forces_per_voltage_squared(self, specimen: Specimen) -> tuple[float, float]:
        geometry = specimen.geometry
        keys = ("active_length_mm", "active_width_mm", "film_thickness_mm")
        for key in keys:
            if key not in geometry:
                raise UsageError(f"{key} is missing", where=f"specimens.{specimen.name}", expected="the size in mm")
        length, width, thickness = (float(geometry[key]) for key in keys)
        layers = int(geometry.get("layers", 1))
        common = EPSILON_0_N_PER_KV2 * specimen.permittivity * self.stretch_1 * self.stretch_2 * layers**2 / thickness
        across = specimen.deviations.blocked_scale * common
        if geometry.get("active_drawn", "undeformed") == "stretched":
            return across * width, common * length
        return across * width * self.stretch_2, common * length * self.stretch_1

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        if specimen is None:
            raise ValueError("a force map needs a specimen")
        levels = (self.drive_kv,) * self.cycles
        demand = excitation.pulses(clock.time_s, levels=levels, on_s=self.on_s, off_s=self.off_s, first_s=self.rest_s)
        command = bench.amplifier.command_for(demand)
        driven = bench.run_stage("drive", Signals(clock.interval_s, {"command": command}))
        since = clock.time_s - self.rest_s
        cycle = np.clip(np.floor(since / (self.on_s + self.off_s)).astype(int), 0, self.cycles - 1)
        painted = (1 + self.repeat_sd * rng.standard_normal(self.cycles))[cycle]
        drop = painted * driven["film_voltage"] ** 2
        first, second = self._forces_per_voltage_squared(specimen)
        rest = specimen.deviations.pretension_n
        forces = driven.with_values(force_1=rest - first * drop, force_2=rest - second * drop)
        return bench.run_stage("drift", bench.run_stage("sensor", forces))


@dataclass(frozen=True, kw_only=True)
class Coating:
    """Capacitance at rest after a number of coats of electrode; no voltage, no motion.

    The first coat covers `first_share` of the sensing region, each further one the share 1 − e^(−1/`coats_scale`) of what
    is still bare; `coat_sd` is the relative scatter from coat to coat.
    """

    protocol: ClassVar[str] = "coverage"
    loading: ClassVar[str] = "electrical"
    quantities: ClassVar[tuple[str, ...]] = ("capacitance",)
    coats: int = whole()
    first_share: float = number(above=0, at_most=1)
    coats_scale: float = number(above=0)
    coat_sd: float = number(0.0, at_least=0)
    duration_s: float = number(2.0, above=0)

    def finest_interval_s(self, bench: Bench) -> float:
        return math.inf

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {"coats": self.coats}

    def check(self, specimen: Specimen | None, where: str) -> None:
        if specimen is None or specimen.film(electrical=False).sensing is None:
            raise UsageError("coats need a specimen with sensing_length_mm", where=where)

    def film(self, specimen: Specimen | None) -> Film:
        return Film() if specimen is None else specimen.film(electrical=False)

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        covered = 1 - (1 - self.first_share) * math.exp(-(self.coats - 1) / self.coats_scale)
        painted = covered * (1 + self.coat_sd * rng.standard_normal())
        level = np.full(clock.samples, bench.film.rest_capacitance_pf * painted)
        return bench.run_stage("drift", bench.run_stage("sensor", Signals(clock.interval_s, {"capacitance": level})))


@dataclass(frozen=True, kw_only=True)
class Isotonic(VoltageSteps):
    """Steps of voltage on a film that moves a constant load, its pretension; `drift_mm_per_h` of the sensor of the stroke."""

    protocol: ClassVar[str] = "isotonic"
    quantities: ClassVar[tuple[str, ...]] = ("command", "voltage", "displacement", "force")
    drift_mm_per_h: float = number(0.0)

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {key: value for key, value in super().metadata(specimen).items() if key != "controller"}

    def check(self, specimen: Specimen | None, where: str) -> None:
        super().check(specimen, where)
        if specimen is not None and specimen.model.c_inf:
            raise UsageError("a film with a pure dashpot does not move a load at once", where=where)

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        command = bench.amplifier.command_for(self.voltage(clock, rng))
        signals = Signals(clock.interval_s, {"command": command})
        for stage in ("drive", "actuation"):
            signals = bench.run_stage(stage, signals)
        active = bench.film.parts[bench.film.active or 0]
        stroke = Compliance.of(active).response(clock.time_s, signals["actuation"])
        signals = signals.with_values(displacement=stroke)
        for stage in ("mechanics", "sensor", "drift"):
            signals = bench.run_stage(stage, signals)
        drift = self.drift_mm_per_h / 3600 * clock.time_s
        return signals.with_values(displacement=signals["displacement"] + drift)
