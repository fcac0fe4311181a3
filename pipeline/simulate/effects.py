"""Hidden effects: how a virtual specimen or rig departs from what the laboratory believes.

Each effect is one object: the mechanism's id, its parameters, and a change of the bench. They compose by applying one
after the other. A new mechanism is a new object in `EFFECTS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pipeline.simulate.bench import Bench, Signals, Slip, Softening, Stage
from pipeline.simulate.sensors import delayed, low_pass
from pipeline.simulate.tables import choice, flag, number, parse

CHANNELS = ("force", "displacement", "voltage", "capacitance")
Change = Callable[[Bench, Any, np.random.Generator], Bench]


@dataclass(frozen=True)
class Effect:
    """One mechanism: its id, the class of its parameters and the change that it makes to a bench."""

    mechanism: str
    parameters: type
    change: Change

    def apply(self, bench: Bench, values: Mapping[str, Any], where: str, rng: np.random.Generator) -> Bench:
        """The bench with the effect. `rng` draws what differs between recordings (the phase of the mains)."""
        return self.change(bench, parse(self.parameters, values, where), rng)


@dataclass(frozen=True, kw_only=True)
class RigConstants:
    """Relative errors: the true constant is that of the campaign's rig × (1 + error)."""

    mass_error: float = number(0.0, above=-1)
    stiffness_error: float = number(0.0, above=-1)


def _rig_constants(bench: Bench, values: RigConstants, rng: np.random.Generator) -> Bench:
    rig = replace(
        bench.rig,
        mass=bench.rig.mass * (1 + values.mass_error),
        stiffness=bench.rig.stiffness * (1 + values.stiffness_error),
    )
    return replace(bench, rig=rig)


@dataclass(frozen=True, kw_only=True)
class DriveLag:
    """First-order rise and fall, slew limit; `monitored` = false: the monitor leads the film."""

    rise_time_constant_s: float = number(at_least=0)
    fall_time_constant_s: float | None = number(None, at_least=0)
    slew_kv_per_s: float = number(math.inf, above=0)
    monitored: bool = flag(True)


def _drive_lag(bench: Bench, values: DriveLag, rng: np.random.Generator) -> Bench:
    fall = values.fall_time_constant_s
    amplifier = replace(
        bench.amplifier,
        rise_time_constant_s=values.rise_time_constant_s,
        fall_time_constant_s=values.rise_time_constant_s if fall is None else fall,
        slew_kv_per_s=values.slew_kv_per_s,
        monitored=values.monitored,
    )
    return replace(bench, amplifier=amplifier)


@dataclass(frozen=True, kw_only=True)
class GainError:
    """One channel shows (1 + gain) × what is there."""

    gain: float = number(above=-1)
    channel: str = choice(*CHANNELS, default="force")


def _gain_error(bench: Bench, values: GainError, rng: np.random.Generator) -> Bench:
    return bench.with_stage("sensor", _on(values.channel, lambda s, x: (1 + values.gain) * x))


@dataclass(frozen=True, kw_only=True)
class SensorDelay:
    """One channel shows what was there `delay_s` earlier."""

    delay_s: float = number(at_least=0)
    channel: str = choice(*CHANNELS, default="force")


def _sensor_delay(bench: Bench, values: SensorDelay, rng: np.random.Generator) -> Bench:
    return bench.with_stage("sensor", _on(values.channel, lambda s, x: delayed(x, values.delay_s / s.interval_s)))


@dataclass(frozen=True, kw_only=True)
class MainsHum:
    """Mains in the force channel: amplitude at the mains frequency and at twice of it, phases by chance."""

    amplitude_n: float = number(at_least=0)
    second_n: float = number(0.0, at_least=0)
    frequency_hz: float = number(50.0, above=0)


def _mains_hum(bench: Bench, values: MainsHum, rng: np.random.Generator) -> Bench:
    first, second = rng.uniform(0, 2 * np.pi, 2)
    omega = 2 * np.pi * values.frequency_hz

    def hum(signals: Signals, force: Any) -> Any:
        angle = omega * signals.time_s
        return force + values.amplitude_n * np.sin(angle + first) + values.second_n * np.sin(2 * angle + second)

    return bench.with_stage("sensor", _on("force", hum))


@dataclass(frozen=True, kw_only=True)
class BaselineDrift:
    """Tension (and capacitance) fall by a share of their mean per decade of log10(1 + t/t0)."""

    per_decade: float = number()
    capacitance_per_decade: float = number(0.0)
    t0_s: float = number(1.0, above=0)


def _baseline_drift(bench: Bench, values: BaselineDrift, rng: np.random.Generator) -> Bench:
    def fall(share: float) -> Callable[[Signals, Any], Any]:
        return lambda s, x: x - share * float(np.mean(x)) * np.log10(1 + s.time_s / values.t0_s)

    with_force = bench.with_stage("drift", _on("force", fall(values.per_decade)))
    return with_force.with_stage("drift", _on("capacitance", fall(values.capacitance_per_decade)))


@dataclass(frozen=True, kw_only=True)
class AmplitudeSoftening:
    """The film is softer the farther it swings in a test: by `drop` of its stiffness at `largest_mm` from where it began.

    `half_at`: share of `largest_mm` at which half of the softening that a far larger swing would bring is reached.
    """

    drop: float = number(above=0, at_most=1)
    largest_mm: float = number(above=0)
    half_at: float = number(0.5, above=0)


def _amplitude_softening(bench: Bench, values: AmplitudeSoftening, rng: np.random.Generator) -> Bench:
    softening = Softening(values.drop, values.largest_mm, values.half_at)
    return replace(bench, film=replace(bench.film, softening=softening))


@dataclass(frozen=True, kw_only=True)
class ClampSlip:
    """The film slides in its clamp where its tension is more than `holds_n` from that before the test.

    What slides is pulled back by `hardening` times the film's spring at rest.
    """

    holds_n: float = number(above=0)
    hardening: float = number(1.0, at_least=0)


def _clamp_slip(bench: Bench, values: ClampSlip, rng: np.random.Generator) -> Bench:
    return replace(bench, film=replace(bench.film, slip=Slip(values.holds_n, values.hardening)))


@dataclass(frozen=True, kw_only=True)
class Wrinkling:
    """Above `onset_kv` the actuation grows no more, and it lets go late: with `delay_s` for a voltage of twice the onset."""

    onset_kv: float = number(above=0)
    delay_s: float = number(2.0, above=0)


def _wrinkling(bench: Bench, values: Wrinkling, rng: np.random.Generator) -> Bench:
    largest = bench.film.force_per_voltage_squared * values.onset_kv**2

    def wrinkle(signals: Signals) -> Signals:
        if "actuation" not in signals:
            return signals
        given = signals["actuation"]
        held, late, folded = 0.0, 0.0, np.empty_like(given)
        # What has wrinkled keeps its shape for a while after the voltage has gone; plain floats are quickest here.
        for i, force in enumerate(given.tolist()):
            beyond = math.sqrt(force / largest) - 1 if force > largest else 0.0
            if beyond > 0:
                late = max(late, values.delay_s * beyond)
                held = largest
            elif held > 0:
                held *= math.exp(-signals.interval_s / late)
                if held < 1e-3 * largest:
                    held, late = 0.0, 0.0
            folded[i] = max(min(force, largest), held)
        return signals.with_values(actuation=folded)

    return bench.with_stage("actuation", wrinkle)


@dataclass(frozen=True, kw_only=True)
class Leakage:
    """The film conducts, and the voltage sags by `droop` of it at `at_kv`, by the square of the voltage elsewhere.

    The current builds up with the time constant `build_up_s`. The monitor shows the sag.
    """

    droop: float = number(above=0, at_most=1)
    at_kv: float = number(above=0)
    build_up_s: float = number(1.0, above=0)


def _leakage(bench: Bench, values: Leakage, rng: np.random.Generator) -> Bench:
    def sag(signals: Signals) -> Signals:
        if "film_voltage" not in signals:
            return signals
        corner_hz = 1 / (2 * np.pi * values.build_up_s)
        load = low_pass((signals["film_voltage"] / values.at_kv) ** 2, corner_hz, signals.interval_s)
        left = np.maximum(1 - values.droop * load, 0.0)
        return signals.with_values(film_voltage=signals["film_voltage"] * left, voltage=signals["voltage"] * left)

    return bench.with_stage("drive", sag)


@dataclass(frozen=True, kw_only=True)
class Crosstalk:
    """The force channel picks up the rate of the voltage, by `n_s_per_kv`, behind a single pole at `corner_hz`."""

    n_s_per_kv: float = number()
    corner_hz: float = number(160.0, above=0)


def _crosstalk(bench: Bench, values: Crosstalk, rng: np.random.Generator) -> Bench:
    def leak(signals: Signals) -> Signals:
        if "film_voltage" not in signals:
            return signals
        rate = np.gradient(signals["film_voltage"], signals.interval_s)
        picked_up = values.n_s_per_kv * low_pass(rate, values.corner_hz, signals.interval_s)
        return signals.with_values(force=signals["force"] + picked_up)

    return bench.with_stage("sensor", leak)


@dataclass(frozen=True, kw_only=True)
class ElectrodeDegradation:
    """A sensing electrode under cyclic strain: from `onset_cycle` on spots lose contact near two strains of each cycle.

    Up to `loss` of the capacitance is missing there, after `cycles` more cycles two thirds of it.
    """

    loss: float = number(above=0, at_most=1)
    onset_cycle: float = number(100.0, at_least=0)
    cycles: float = number(100.0, above=0)


_SPOTS = ((0.75, 1.0), (0.35, 0.6))
"""Share of the stroke at which a spot opens, and its share of the loss."""
_SPOT_WIDTH = 0.12


def _electrode_degradation(bench: Bench, values: ElectrodeDegradation, rng: np.random.Generator) -> Bench:
    def migrate(signals: Signals) -> Signals:
        if "capacitance" not in signals or "displacement" not in signals:
            return signals
        moved = signals["displacement"] - signals["displacement"][0]
        stroke = moved / max(float(np.ptp(moved)), 1e-12)
        above = stroke > 0.5
        # Cycles so far, between the rising crossings of the middle by straight lines; half a stroke is a quarter cycle.
        rising = np.flatnonzero(above[1:] & ~above[:-1])
        cycle = np.interp(np.arange(stroke.size), rising, np.arange(rising.size) + 0.25) if rising.size else 0 * stroke
        grown = values.loss * -np.expm1(-np.maximum(cycle - values.onset_cycle, 0.0) / values.cycles)
        open_ = sum(share * np.exp(-(((stroke - at) / _SPOT_WIDTH) ** 2)) for at, share in _SPOTS)
        return signals.with_values(capacitance=signals["capacitance"] * (1 - grown * open_))

    return bench.with_stage("sensor", migrate)


def _on(quantity: str, function: Callable[[Signals, Any], Any]) -> Stage:
    """A stage that changes one quantity where it is there."""

    def stage(signals: Signals) -> Signals:
        if quantity not in signals:
            return signals
        return signals.with_values(**{quantity: function(signals, signals[quantity])})

    return stage


_ALL = (
    Effect("rig_constants", RigConstants, _rig_constants),
    Effect("drive_lag", DriveLag, _drive_lag),
    Effect("gain_error", GainError, _gain_error),
    Effect("sensor_delay", SensorDelay, _sensor_delay),
    Effect("mains_hum", MainsHum, _mains_hum),
    Effect("baseline_drift", BaselineDrift, _baseline_drift),
    Effect("amplitude_softening", AmplitudeSoftening, _amplitude_softening),
    Effect("clamp_slip", ClampSlip, _clamp_slip),
    Effect("wrinkling", Wrinkling, _wrinkling),
    Effect("leakage", Leakage, _leakage),
    Effect("crosstalk", Crosstalk, _crosstalk),
    Effect("electrode_degradation", ElectrodeDegradation, _electrode_degradation),
)
EFFECTS: dict[str, Effect] = {effect.mechanism: effect for effect in _ALL}
