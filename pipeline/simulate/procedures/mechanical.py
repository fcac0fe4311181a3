"""Tests that move the driven end: sweeps, cycles, relaxation, one large cycle, a pull to failure, creep."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pipeline.physics import excitation
from pipeline.physics.compliance import Compliance
from pipeline.simulate.bench import Bench, Film, Signals
from pipeline.simulate.procedures.base import (
    INTERVALS_PER_CYCLE,
    INTERVALS_PER_TIME_CONSTANT,
    Clock,
    Sweeps,
    film_length_mm,
)
from pipeline.simulate.specimen import Specimen
from pipeline.simulate.tables import number, whole
from schemas.arrays import Float
from schemas.errors import UsageError


class Mechanical(ABC):
    """Shared by the tests without voltage."""

    loading: ClassVar[str] = "mechanical"
    quantities: ClassVar[tuple[str, ...]] = ("displacement", "force")

    def check(self, specimen: Specimen | None, where: str) -> None:
        film_length_mm(specimen, where)

    def film(self, specimen: Specimen | None) -> Film:
        return Film() if specimen is None else specimen.film(electrical=False)

    @abstractmethod
    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals: ...


class Driven(Mechanical):
    """Shared by the tests that move the driven end."""

    @abstractmethod
    def displacement(self, time_s: Float, specimen: Specimen | None) -> Float: ...

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        return bench.run(Signals(clock.interval_s, {"displacement": self.displacement(clock.time_s, specimen)}))


_INTERVALS_OF_A_SINE = 5000
"""Straight lines in place of a slow sine: their kinks shake the load cell at its resonance, far above the test, and the
sampled record folds that back onto the test's frequency (0.35 % with 250 lines to the cycle, 1e-5 with these)."""


@dataclass(frozen=True, kw_only=True)
class Chirp(Sweeps, Driven):
    """Sweeps of the driven end, each followed by a rest; the record begins with a rest.

    `amplitude_mm` at the start frequency, falling or rising as frequency^`amplitude_exponent`.
    """

    protocol: ClassVar[str] = "chirp"
    amplitude_mm: float = number(above=0)
    amplitude_exponent: float = number(0.0)

    def finest_interval_s(self, bench: Bench) -> float:
        return 1 / (INTERVALS_PER_CYCLE * self.frequency_stop_hz)

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {
            **self.describe_sweeps(),
            "strain_pp": 2 * self.amplitude_mm / film_length_mm(specimen, "chirp"),
            "amplitude_mm": self.amplitude_mm,
            "amplitude_exponent": self.amplitude_exponent,
        }

    def check(self, specimen: Specimen | None, where: str) -> None:
        super().check(specimen, where)
        longest = max(specimen.model.tau, default=0.0) if specimen is not None else 0.0
        if self.rest_s < 3 * longest:
            raise UsageError(
                f"rest_s is {self.rest_s:g}",
                where=where,
                expected=f"3 × the longest relaxation time, {3 * longest:g} s",
            )

    def displacement(self, time_s: Float, specimen: Specimen | None) -> Float:
        return self.make_sweeps(
            time_s,
            amplitude=self.amplitude_mm,
            exponent=self.amplitude_exponent,
            taper_start_s=min(0.5 / self.frequency_start_hz, self.sweep_s / 4),
            taper_stop_s=min(5 / self.frequency_stop_hz, self.sweep_s / 4),
        )


@dataclass(frozen=True, kw_only=True)
class Cyclic(Driven):
    """Sinusoid from 0 to `strain_pp` of the stretched length and back, after a short rest."""

    protocol: ClassVar[str] = "cyclic"
    quantities: ClassVar[tuple[str, ...]] = ("displacement", "force", "capacitance")
    frequency_hz: float = number(above=0)
    strain_pp: float = number(above=0)
    cycles: int = whole(10)
    rest_s: float = number(1.0, at_least=0)

    @property
    def duration_s(self) -> float:
        return self.rest_s + self.cycles / self.frequency_hz

    def finest_interval_s(self, bench: Bench) -> float:
        return 1 / (_INTERVALS_OF_A_SINE * self.frequency_hz)

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {"frequency_hz": self.frequency_hz, "strain_pp": self.strain_pp, "cycles": self.cycles}

    def displacement(self, time_s: Float, specimen: Specimen | None) -> Float:
        return excitation.raised_cosine(
            time_s - self.rest_s,
            frequency_hz=self.frequency_hz,
            peak_to_peak=self.strain_pp * film_length_mm(specimen, "cyclic"),
            cycles=self.cycles,
        )


@dataclass(frozen=True, kw_only=True)
class Relaxation(Driven):
    """Step of the driven end, held: stress relaxation."""

    protocol: ClassVar[str] = "step"
    step_mm: float = number(above=0)
    ramp_s: float = number(0.02, above=0)
    hold_s: float = number(above=0)
    rest_s: float = number(1.0, at_least=0)

    @property
    def duration_s(self) -> float:
        return self.rest_s + self.ramp_s + self.hold_s

    def finest_interval_s(self, bench: Bench) -> float:
        return self.ramp_s / INTERVALS_PER_TIME_CONSTANT

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {"strain_pp": self.step_mm / film_length_mm(specimen, "step"), "ramp_s": self.ramp_s}

    def displacement(self, time_s: Float, specimen: Specimen | None) -> Float:
        return excitation.ramp(time_s, start_s=self.rest_s, duration_s=self.ramp_s, height=self.step_mm)


@dataclass(frozen=True, kw_only=True)
class Triangle(Driven):
    """One load–unload cycle at constant rate."""

    protocol: ClassVar[str] = "cycle"
    peak_mm: float = number(above=0)
    rate_mm_per_s: float = number(above=0)
    rest_s: float = number(1.0, at_least=0)

    @property
    def duration_s(self) -> float:
        return 2 * self.rest_s + 2 * self.peak_mm / self.rate_mm_per_s

    def finest_interval_s(self, bench: Bench) -> float:
        return self.peak_mm / self.rate_mm_per_s / INTERVALS_PER_CYCLE

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {
            "strain_pp": self.peak_mm / film_length_mm(specimen, "cycle"),
            "rate_mm_per_s": self.rate_mm_per_s,
            "cycles": 1,
        }

    def displacement(self, time_s: Float, specimen: Specimen | None) -> Float:
        return excitation.triangle(time_s - self.rest_s, peak=self.peak_mm, rate=self.rate_mm_per_s)


@dataclass(frozen=True, kw_only=True)
class Pull(Driven):
    """A pull at constant rate until the film breaks at `break_mm`; the machine stops a little later."""

    protocol: ClassVar[str] = "pull"
    break_mm: float = number(above=0)
    rate_mm_per_s: float = number(above=0)
    rest_s: float = number(1.0, at_least=0)
    further: float = number(0.02, above=0)

    @property
    def duration_s(self) -> float:
        return self.rest_s + (1 + self.further) * self.break_mm / self.rate_mm_per_s

    def finest_interval_s(self, bench: Bench) -> float:
        return self.break_mm / self.rate_mm_per_s / INTERVALS_PER_CYCLE

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {"rate_mm_per_s": self.rate_mm_per_s}

    def displacement(self, time_s: Float, specimen: Specimen | None) -> Float:
        return np.asarray(self.rate_mm_per_s * np.maximum(time_s - self.rest_s, 0.0))

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        signals = super().run(bench, specimen, clock, rng)
        return signals.with_values(force=np.where(signals["displacement"] < self.break_mm, signals["force"], 0.0))


@dataclass(frozen=True, kw_only=True)
class Creep(Mechanical):
    """A load that is put on, held and taken off: the driven end goes where the load cell shows it; `drift_mm_per_h` of its sensor."""

    protocol: ClassVar[str] = "creep"
    load_n: float = number(above=0)
    hold_s: float = number(above=0)
    recovery_s: float = number(at_least=0)
    ramp_s: float = number(0.2, above=0)
    rest_s: float = number(5.0, at_least=0)
    drift_mm_per_h: float = number(0.0)

    @property
    def duration_s(self) -> float:
        return self.rest_s + 2 * self.ramp_s + self.hold_s + self.recovery_s

    def finest_interval_s(self, bench: Bench) -> float:
        return self.ramp_s / INTERVALS_PER_TIME_CONSTANT

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {"load_n": self.load_n}

    def check(self, specimen: Specimen | None, where: str) -> None:
        super().check(specimen, where)
        if specimen is not None and specimen.model.c_inf:
            raise UsageError("a film with a pure dashpot does not give way to a load at once", where=where)

    def load(self, time_s: Float) -> Float:
        """The load (n,) N above that of the pre-stretch."""
        on = excitation.ramp(time_s, start_s=self.rest_s, duration_s=self.ramp_s, height=self.load_n)
        off_s = self.rest_s + self.ramp_s + self.hold_s
        return np.asarray(on - excitation.ramp(time_s, start_s=off_s, duration_s=self.ramp_s, height=self.load_n))

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        load = self.load(clock.time_s)
        extension = sum((Compliance.of(part).response(clock.time_s, load) for part in bench.film.parts), 0 * load)
        driven = extension + load / bench.rig.stiffness
        signals = bench.run(Signals(clock.interval_s, {"displacement": driven}))
        drift = self.drift_mm_per_h / 3600 * clock.time_s
        return signals.with_values(displacement=signals["displacement"] + drift)
