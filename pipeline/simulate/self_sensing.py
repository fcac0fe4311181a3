"""Self-sensing actuators under test: capacitance held at a demand by a PI controller, and what switching does to it.

The controller acts on C − C_d, because a higher voltage lowers the capacitance of a separate region (the error of thesis,
eq 5.18, has the other sign), and on C_d − C where one region actuates and senses. It decides at each sample of the capacitance channel; between the samples film and amplifier are integrated
exactly as in every other test. Open-loop steps are in `procedures`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from pipeline.physics.controllers import Controller, ProportionalIntegral
from pipeline.physics.motion import Propagator
from pipeline.simulate.bench import Bench, Film, Signals, Stage, capacitance
from pipeline.simulate.procedures.base import Clock, amplifier_interval_s
from pipeline.simulate.sensors import Sensor
from pipeline.simulate.specimen import Specimen
from pipeline.simulate.tables import flag, number
from schemas.arrays import Float
from schemas.errors import UsageError


@dataclass(frozen=True, kw_only=True)
class ClosedLoop:
    """Capacitance from its rest value to `demand_step_pf` (negative: less) and held by u = Kp e + Ki ∫e dt.

    Gains in V of command per pF and per pF s. Between `rest_s` and the end of `hold_s` the controller is on, then the
    voltage is off for `off_s`. The command stays within 0 and `largest_kv`; at the limits the integral stands still. The
    controller sees the capacitance through its own single-pole filter. With `square_root_drive` the voltage is the root of
    what u asks for, V² = u V_largest, so that the force follows u; `thesis_sign`: the error as the thesis prints it.
    """

    protocol: ClassVar[str] = "step"
    loading: ClassVar[str] = "electrical"
    quantities: ClassVar[tuple[str, ...]] = ("command", "voltage", "force", "capacitance", "demand")
    demand_step_pf: float = number()
    proportional_gain: float = number(at_least=0)
    integral_gain: float = number(at_least=0)
    rest_s: float = number(3.0, above=0)
    hold_s: float = number(above=0)
    off_s: float = number(3.0, at_least=0)
    bias_kv: float = number(0.0, at_least=0)
    largest_kv: float = number(11.0, above=0)
    controller_filter_hz: float = number(10.0, above=0)
    square_root_drive: bool = flag(False)
    thesis_sign: bool = flag(False)

    @property
    def duration_s(self) -> float:
        return self.rest_s + self.hold_s + self.off_s

    def finest_interval_s(self, bench: Bench) -> float:
        return amplifier_interval_s(bench)

    def metadata(self, specimen: Specimen | None) -> dict[str, Any]:
        return {
            "on_s": self.hold_s,
            "off_s": self.off_s,
            "cycles": 1,
            "controller": "closed",
            "proportional_gain": self.proportional_gain,
            "integral_gain": self.integral_gain,
        }

    def check(self, specimen: Specimen | None, where: str) -> None:
        if specimen is None or specimen.film(electrical=True).sensing is None:
            raise UsageError("a closed loop needs a specimen with sensing_length_mm", where=where)

    def film(self, specimen: Specimen | None) -> Film:
        return Film() if specimen is None else specimen.film(electrical=True)

    def run(self, bench: Bench, specimen: Specimen | None, clock: Clock, rng: np.random.Generator) -> Signals:
        raise TypeError("a closed loop runs with its sensor: run_with")

    def run_with(
        self,
        bench: Bench,
        clock: Clock,
        factor: int,
        sensor: Sensor,
        rng: np.random.Generator,
        controller: Controller | None = None,
    ) -> Signals:
        """All signals; `capacitance` holds the samples that the controller saw, each held for `factor` intervals.

        `clock` is the fine clock, `sensor` the capacitance channel, which is sampled every `factor` intervals. `controller`
        decides in place of the PI controller of these gains.
        """
        film, amplifier = bench.film, bench.amplifier
        ticks = clock.samples // factor
        system = bench.equations()
        block = Propagator.of(system, 1, clock.interval_s, factor)
        within = np.arange(factor + 1, dtype=np.float64) * clock.interval_s
        times = np.arange(ticks, dtype=np.float64) * factor * clock.interval_s
        on = (times >= self.rest_s - 1e-9) & (times < self.rest_s + self.hold_s - 1e-9)
        rest = self._steady(system, film.force_per_voltage_squared * self.bias_kv**2)
        start = float(capacitance(film, np.array([_extension(system, rest[0], rest[1])]))[0])
        demand = np.where(on, start + self.demand_step_pf, start)
        noise = sensor.noise_sd * rng.standard_normal(ticks)
        drift = self._drift(bench, start, times)
        keep = float(np.exp(-2 * np.pi * self.controller_filter_hz * factor * clock.interval_s))
        exact = replace(sensor, noise_sd=0.0)

        loop = (controller or self._controller(bench)).start(1, factor * clock.interval_s)
        relaxed = float(np.exp(-factor * clock.interval_s / film.permittivity_time_s))
        state, voltage, seen, permittivity = rest[0], self.bias_kv, start, 0.0
        measured, commands = np.empty(ticks), np.empty(ticks)
        for tick in range(ticks):
            maxwell = film.force_per_voltage_squared * voltage**2 * (1 + permittivity)
            true = float(capacitance(film, np.array([_extension(system, state, maxwell)]), permittivity)[0])
            measured[tick] = exact.convert(np.array([true + drift[tick] + noise[tick]]), rng)[0]
            seen += (1 - keep) * (measured[tick] - seen)
            wanted = self.bias_kv
            if on[tick]:
                decided = loop.decide(np.array([seen - start]), float(demand[tick] - start))
                wanted = min(float(decided[0]), self.largest_kv)
            elif times[tick] >= self.rest_s:
                wanted = 0.0
            commands[tick] = amplifier.command_for(np.array([wanted]))[0]
            path = amplifier.towards(voltage, wanted, within)
            force = film.force_per_voltage_squared * path**2
            permittivity = relaxed * permittivity + (1 - relaxed) * film.permittivity_per_kv2 * float(np.mean(path**2))
            state = block.advance @ state + block.gather @ (force * (1 + permittivity))
            voltage = float(path[-1])

        held = Signals(clock.interval_s, {"command": np.repeat(commands, factor)})
        signals = bench.run(held)
        return signals.with_values(capacitance=np.repeat(measured, factor), demand=np.repeat(demand, factor))

    def _controller(self, bench: Bench) -> Controller:
        return ProportionalIntegral(
            self.proportional_gain,
            self.integral_gain,
            bench.film.shared == self.thesis_sign,
            bench.amplifier.gain_kv_per_v,
            self.largest_kv,
            self.bias_kv,
            self.square_root_drive,
        )

    def _steady(self, system: Any, maxwell: float) -> tuple[Float, float]:
        return -np.linalg.solve(system.a, system.b[:, 1] * maxwell), maxwell

    def _drift(self, bench: Bench, level: float, times: Float) -> Float:
        """What the drift stage adds to a capacitance at rest, at the ticks."""
        interval = float(times[1] - times[0]) if times.size > 1 else 1.0
        flat = Signals(interval, {"capacitance": np.full(times.size, level)})
        return np.asarray(bench.run_stage("drift", flat)["capacitance"] - level)


def _extension(system: Any, state: Float, maxwell: float) -> float:
    """Extension of the sensing part in mm."""
    return float(system.c[1] @ state + system.d[1, 1] * maxwell)


@dataclass(frozen=True, kw_only=True)
class SwitchingSpikes:
    """Interference of the converter in the capacitance at each edge: height in pF, decay within `width_s`."""

    height_pf: float = number(0.0)
    width_s: float = number(0.015, above=0)

    def stage(self) -> Stage:
        """A sensor stage that adds the spikes where the voltage jumps by more than a tenth of its largest value."""

        def add(signals: Signals) -> Signals:
            if "capacitance" not in signals or "command" not in signals or not self.height_pf:
                return signals
            command = signals["command"]
            jumps = np.diff(command, prepend=command[0])
            jumps[np.abs(jumps) < 0.1 * np.max(np.abs(command), initial=1e-12)] = 0.0
            spread = np.exp(
                -np.arange(round(5 * self.width_s / signals.interval_s) + 1) * signals.interval_s / self.width_s
            )
            spikes = np.zeros(command.size)
            for index in np.flatnonzero(jumps):
                stop = min(index + spread.size, command.size)
                spikes[index:stop] += self.height_pf * np.sign(jumps[index]) * spread[: stop - index]
            return signals.with_values(capacitance=signals["capacitance"] + spikes)

        return add
