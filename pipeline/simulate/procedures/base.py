"""What every test has: the interface, the fine clock, and how finely it has to tick. No test of its own is here."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from pipeline.physics import excitation
from pipeline.simulate.bench import Bench, Film, Signals
from pipeline.simulate.specimen import Specimen
from pipeline.simulate.tables import choice, number, whole
from schemas.arrays import Float
from schemas.errors import UsageError

INTERVALS_PER_CYCLE = 200
"""Samples of the fine clock per cycle of the highest frequency: straight lines then lose (2π/200)²/12 = 8e-5."""
INTERVALS_PER_TIME_CONSTANT = 20


class Procedure(Protocol):
    """What every test has."""

    protocol: ClassVar[str]
    loading: ClassVar[str]
    quantities: ClassVar[tuple[str, ...]]

    @property
    def duration_s(self) -> float: ...

    def finest_interval_s(self, bench: Bench) -> float:
        """Longest interval of the fine clock that keeps the signals true."""
        ...

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        """Keys of the recording's metadata that the test fixes."""
        ...

    def check(self, specimen: Specimen | None, where: str) -> None:
        """Raises `UsageError` where the test does not suit the specimen."""
        ...

    def film(self, specimen: Specimen | None) -> Film:
        """The film that this test mounts on the rig."""
        ...

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        """The signals on the fine clock, all stages passed."""
        ...


@dataclass(frozen=True, kw_only=True)
class Sweeps:
    """Sweeps of one frequency after the other, each followed by a rest; `lead_s` is what the record holds before the first."""

    frequency_start_hz: float = number(1.0, above=0)
    frequency_stop_hz: float = number(100.0, above=0)
    sweep: str = choice("log", "linear", default="log")
    sweep_s: float = number(20.0, above=0)
    rest_s: float = number(1.0, above=0)
    repeats: int = whole(1)

    def __post_init__(self) -> None:
        if self.frequency_stop_hz <= self.frequency_start_hz:
            raise ValueError("frequency_stop_hz is not above frequency_start_hz")

    @property
    def lead_s(self) -> float:
        return self.rest_s

    @property
    def duration_s(self) -> float:
        return self.lead_s + self.repeats * (self.sweep_s + self.rest_s)

    def describe_sweeps(self) -> dict[str, Any]:
        """Keys of the metadata that say what was swept."""
        return {
            "frequency_start_hz": self.frequency_start_hz,
            "frequency_stop_hz": self.frequency_stop_hz,
            "sweep": self.sweep,
            "repeats": self.repeats,
            "period_s": self.sweep_s + self.rest_s,
        }

    def make_sweeps(
        self, time_s: Float, *, amplitude: float, exponent: float = 0.0, taper_start_s: float, taper_stop_s: float
    ) -> Float:
        """All sweeps (n,) in the unit of `amplitude`; see `excitation.sweep`."""
        since = time_s - self.lead_s
        within = np.where(since < 0, -1.0, np.mod(since, self.sweep_s + self.rest_s))
        return excitation.sweep(
            within,
            start_hz=self.frequency_start_hz,
            stop_hz=self.frequency_stop_hz,
            duration_s=self.sweep_s,
            amplitude=amplitude,
            exponent=exponent,
            logarithmic=self.sweep == "log",
            taper_start_s=taper_start_s,
            taper_stop_s=taper_stop_s,
        )


@dataclass(frozen=True)
class Clock:
    """A fine clock of `samples` intervals of `interval_s`."""

    interval_s: float
    samples: int

    @property
    def time_s(self) -> Float:
        return np.arange(self.samples, dtype=np.float64) * self.interval_s


def amplifier_interval_s(bench: Bench) -> float:
    """Interval that resolves the amplifier's own time constants; infinite for an ideal one."""
    times = [t for t in (bench.amplifier.rise_time_constant_s, bench.amplifier.fall_time_constant_s) if t > 0]
    return min(times, default=math.inf) / INTERVALS_PER_TIME_CONSTANT


def film_length_mm(specimen: Specimen | None, where: str) -> float:
    """Stretched length of the specimen that strains refer to."""
    if specimen is None:
        raise UsageError("this test needs a specimen", where=where)
    return specimen.sizes.total_length_mm
