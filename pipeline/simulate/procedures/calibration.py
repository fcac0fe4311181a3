"""Tests of the rig without film: a force acts on the clamp."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from pipeline.physics import excitation
from pipeline.physics.rig import TONNES_PER_KG
from pipeline.simulate.bench import Bench, Film, Signals
from pipeline.simulate.procedures.base import INTERVALS_PER_CYCLE, INTERVALS_PER_TIME_CONSTANT, Clock
from pipeline.simulate.specimen import Specimen
from pipeline.simulate.tables import number, numbers, whole
from schemas.arrays import Float
from schemas.errors import UsageError

GRAVITY_M_PER_S2 = 9.80665


class Calibration(ABC):
    """Shared by the tests of the rig without film: the force acts on the clamp."""

    loading: ClassVar[str] = "calibration"
    quantities: ClassVar[tuple[str, ...]] = ("force",)

    @abstractmethod
    def pull(self, time_s: Float) -> Float: ...

    def check(self, specimen: Specimen | None, where: str) -> None:
        if specimen is not None:
            raise UsageError("a calibration is made without specimen", where=where, expected="rigs, not specimens")

    def film(self, specimen: Specimen | None) -> Film:
        return Film()

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        return bench.run(Signals(clock.interval_s, {"actuation": -self.pull(clock.time_s)}))


@dataclass(frozen=True, kw_only=True)
class Tap(Calibration):
    """The clamp without film is tapped and rings, with a known further mass on it or without; half-sine pulses of `pulse_s`."""

    protocol: ClassVar[str] = "tap"
    taps: int = whole(3)
    pulse_s: float = number(0.004, above=0)
    peak_n: float = number(1.0, above=0)
    ring_s: float = number(4.0, above=0)
    rest_s: float = number(1.0, at_least=0)
    extra_clamp_mass_kg: float = number(0.0, at_least=0)

    @property
    def duration_s(self) -> float:
        return self.rest_s + self.taps * self.ring_s

    def finest_interval_s(self, bench: Bench) -> float:
        return self.pulse_s / INTERVALS_PER_TIME_CONSTANT

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        known = {"repeats": self.taps, "period_s": self.ring_s}
        return known | ({"extra_clamp_mass_kg": self.extra_clamp_mass_kg} if self.extra_clamp_mass_kg else {})

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        heavier = replace(bench.rig, mass=bench.rig.mass + self.extra_clamp_mass_kg * TONNES_PER_KG)
        return super().run(replace(bench, rig=heavier), specimen, clock, rng)

    def pull(self, time_s: Float) -> Float:
        since = time_s - self.rest_s
        within = np.where(since < 0, self.ring_s, np.mod(since, self.ring_s))
        return np.where(within < self.pulse_s, self.peak_n * np.sin(np.pi * within / self.pulse_s), 0.0)


@dataclass(frozen=True, kw_only=True)
class Weight(Calibration):
    """Known masses hung on the load cell one after the other, nothing on it before the first and after the last."""

    protocol: ClassVar[str] = "weight"
    masses_kg: tuple[float, ...] = numbers(above=0)
    plateau_s: float = number(5.0, above=0)
    ramp_s: float = number(0.5, above=0)

    @property
    def duration_s(self) -> float:
        return (len(self.masses_kg) + 2) * self.plateau_s

    def finest_interval_s(self, bench: Bench) -> float:
        return self.ramp_s / INTERVALS_PER_CYCLE

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {"masses_kg": self.masses_kg, "plateau_s": self.plateau_s}

    def pull(self, time_s: Float) -> Float:
        levels = (0.0, *(GRAVITY_M_PER_S2 * m for m in self.masses_kg), 0.0)
        return excitation.staircase(time_s, levels=levels, plateau_s=self.plateau_s, ramp_s=self.ramp_s)
