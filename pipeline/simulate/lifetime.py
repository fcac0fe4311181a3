"""Lifetimes under constant voltage: how long specimens live, where they fail, and what the rig records of it.

A breakdown shorts the film: the voltage collapses within milliseconds, the current rises to the limit of the supply and
the tension comes back. Drawing and recording are apart, so that a draw can be tested without a record.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from pipeline.simulate.bench import Bench, Film, Signals
from pipeline.simulate.procedures.base import Clock, amplifier_interval_s
from pipeline.simulate.specimen import Specimen
from pipeline.simulate.tables import choice, counts, number, text, whole
from schemas.arrays import Float
from schemas.errors import UsageError

COLLAPSE_S = 0.002
"""Time constant with which a shorted film loses its voltage."""
START_SHARE = 0.95
"""The life begins when the voltage first reaches this share of the set point."""


@dataclass(frozen=True, kw_only=True)
class LifetimeGroup:
    """Specimens of one configuration under one voltage.

    Weibull with location: S(t) = exp(−((t − location)/scale)^shape), cut at `maximum_s` if given. At another voltage than
    `reference_kv` the scale is multiplied by (V/V_ref)^(−exponent/shape), which is the hazard
    h = (β/t0)(t/t0)^(β−1) (V/V_ref)^exponent. `draw`: `independent`, or `stratified` (one life in each of `count` equal
    slices of probability: the sample then looks like its distribution). `sites` and `regions` count where failures sit.
    After the fixed test the voltage may be raised by `raise_step_kv` every `raise_every_s` until breakdown near
    `breakdown_kv`; such specimens count as survivors of the fixed test. In `glitches` records the voltage drops out for
    0.2 s once.
    """

    configuration: str = text()
    prefix: str = text()
    count: int = whole()
    voltage_kv: float = number(above=0)
    test_duration_s: float = number(above=0)
    shape: float = number(above=0)
    scale_s: float = number(above=0)
    location_s: float = number(0.0, at_least=0)
    maximum_s: float | None = number(None, above=0)
    reference_kv: float | None = number(None, above=0)
    voltage_exponent: float = number(0.0, at_least=0)
    draw: str = choice("independent", "stratified", default="independent")
    sites: dict[str, int] = counts("rod", "lead", "active", "edge", "unknown", default=None)
    regions: dict[str, int] = counts("left", "centre", "right", default=None)
    raise_step_kv: float = number(0.0, at_least=0)
    raise_every_s: float = number(2.0, above=0)
    breakdown_kv: float = number(9.5, above=0)
    breakdown_sd_kv: float = number(0.0, at_least=0)
    glitches: int = whole(0, at_least=0)
    ramp_s: float = number(1.5, above=0)
    rest_s: float = number(1.0, above=0)
    leakage_gohm: float = number(5.0, above=0)
    current_limit_ua: float = number(450.0, above=0)

    def lives_s(self, rng: np.random.Generator) -> Float:
        """(count,) lives in s from the start of life."""
        if self.draw == "stratified":
            u = (rng.permutation(self.count) + rng.random(self.count)) / self.count
        else:
            u = rng.random(self.count)
        scale = self.scale_s
        if self.reference_kv is not None:
            scale *= (self.voltage_kv / self.reference_kv) ** (-self.voltage_exponent / self.shape)
        if self.maximum_s is not None:
            longest = max(self.maximum_s - self.location_s, 0.0)
            u = u * -math.expm1(-((longest / scale) ** self.shape))
        return np.asarray(self.location_s + scale * (-np.log1p(-u)) ** (1 / self.shape))

    def fates(self, rng: np.random.Generator) -> tuple[Life, ...]:
        """The lives of all specimens with their failure sites, in the order of the specimens."""
        lives = self.lives_s(rng)
        failing = np.flatnonzero(lives < self.test_duration_s)
        sites = self._places(self.sites, failing.size, rng, "sites")
        regions = self._places(self.regions, failing.size, rng, "regions")
        tops = self.breakdown_kv + self.breakdown_sd_kv * rng.standard_normal(self.count)
        glitching = set(rng.permutation(self.count)[: self.glitches].tolist())
        at = rng.uniform(0.3, 0.7, self.count)
        place = {int(i): k for k, i in enumerate(failing)}
        return tuple(
            Life(
                group=self,
                life_s=float(lives[i]) if i in place else math.inf,
                site=(sites[place[i]] if sites else "unknown") if i in place else "none",
                region=regions[place[i]] if i in place and regions else None,
                breakdown_kv=float(tops[i]),
                glitch_at_s=float(at[i] * min(lives[i], self.test_duration_s)) if i in glitching else None,
            )
            for i in range(self.count)
        )

    def _places(
        self, shares: dict[str, int] | None, failures: int, rng: np.random.Generator, key: str
    ) -> list[str] | None:
        if not shares:
            return None
        places = [name for name, n in shares.items() for _ in range(n)]
        if len(places) < failures:
            raise UsageError(
                f"{key} place {len(places)} failures", where=self.configuration, expected=f"{failures} or more"
            )
        return [places[i] for i in rng.permutation(len(places))[:failures]]


@dataclass(frozen=True, kw_only=True)
class Life:
    """One specimen's test: ramp, constant voltage until breakdown or end of test. `life_s` is infinite for survivors."""

    group: LifetimeGroup
    life_s: float
    site: str
    region: str | None
    breakdown_kv: float
    glitch_at_s: float | None

    protocol: ClassVar[str] = "lifetime"
    loading: ClassVar[str] = "electrical"
    quantities: ClassVar[tuple[str, ...]] = ("voltage", "force", "leakage_current")

    @property
    def start_s(self) -> float:
        """Instant in the record at which the voltage reaches 95 % of the set point."""
        return self.group.rest_s + START_SHARE * self.group.ramp_s

    @property
    def failure_s(self) -> float | None:
        """Instant of the breakdown in the record, None without one."""
        group = self.group
        if math.isfinite(self.life_s):
            return self.start_s + self.life_s
        if not group.raise_step_kv:
            return None
        steps = math.ceil((self.breakdown_kv - group.voltage_kv) / group.raise_step_kv)
        return self.start_s + group.test_duration_s + max(steps - 0.5, 0.5) * group.raise_every_s

    @property
    def duration_s(self) -> float:
        """The operator ends the test 2 s after a breakdown, or at the end of the test."""
        failure = self.failure_s
        return (self.start_s + self.group.test_duration_s if failure is None else failure) + 2.0

    def finest_interval_s(self, bench: Bench) -> float:
        return max(amplifier_interval_s(bench), COLLAPSE_S / 2)

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        values: dict[str, Any] = {
            "configuration": self.group.configuration,
            "voltage_setpoint_kv": self.group.voltage_kv,
            "test_duration_s": self.group.test_duration_s,
            "failure_site": self.site,
        }
        return values if self.region is None else values | {"failure_region": self.region}

    def check(self, specimen: Specimen | None, where: str) -> None:
        if specimen is None:
            raise UsageError("a lifetime test needs a specimen", where=where)
        specimen.film(electrical=True)

    def demand(self, time_s: Float) -> Float:
        """Voltage in kV that the operator asks for."""
        group = self.group
        held = group.voltage_kv * np.clip((time_s - group.rest_s) / group.ramp_s, 0.0, 1.0)
        over = time_s - self.start_s - group.test_duration_s
        if group.raise_step_kv:
            return held + group.raise_step_kv * np.clip(np.ceil(over / group.raise_every_s), 0.0, None)
        return np.where(over > 0, 0.0, held)

    def film(self, specimen: Specimen | None) -> Film:
        return Film() if specimen is None else specimen.film(electrical=True)

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        time = clock.time_s
        command = bench.amplifier.command_for(self.demand(time))
        driven = bench.run_stage("drive", Signals(clock.interval_s, {"command": command}))
        voltage = driven["film_voltage"].copy()
        current = voltage / self.group.leakage_gohm
        failure = self.failure_s
        if failure is not None:
            after = time >= failure
            collapse = np.exp(-(time[after] - failure) / COLLAPSE_S)
            voltage[after] *= collapse
            current[after] = self.group.current_limit_ua * (1 - collapse)
        if self.glitch_at_s is not None:
            begin = self.start_s + self.glitch_at_s
            voltage[(time >= begin) & (time < begin + 0.2)] *= 0.3
        shorted = driven.with_values(film_voltage=voltage, voltage=voltage, leakage_current=current)
        for stage, function in bench.stages():
            if stage != "drive":
                shorted = function(shorted)
        return shorted
