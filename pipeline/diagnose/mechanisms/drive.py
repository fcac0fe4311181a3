"""Mechanisms of the drive: lag and slew of the amplifier, offset of the voltage, leakage through the film."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.diagnose.mechanisms.mechanism import AMPLIFIER, BENT, SHAPE, Context, Mechanism, Parameter, Values
from pipeline.diagnose.simulation.effects import Effect, View, Wave
from schemas.arrays import Complex, Float

MONITORED, _HIDDEN, FURTHER = "monitored", "hidden from the monitor", "monitored, and further behind the monitor"
"""Variants of a lag: whether the voltage that was measured lags as well, and whether the film's lags behind that in its turn."""
_ROUNDS = 4
"""Rounds in which the rate of a lagging voltage is found."""


def _lagged(wave: Float, interval_s: float, rise_s: float, fall_s: float, slew: float) -> Float:
    """One period (S, W) behind a first-order lag of different time constants for rise and fall, and a slew limit.

    The mean lag is exact in the spectrum; the difference of the two and the limit act on the rate, found in a few rounds.
    """
    mean, half = (rise_s + fall_s) / 2, (rise_s - fall_s) / 2
    spectrum = np.fft.rfft(wave, axis=1)
    s = 2j * np.pi * np.fft.rfftfreq(wave.shape[1], interval_s)
    size = np.sign(wave)
    follow = np.fft.irfft(spectrum / (1 + s * mean), wave.shape[1], axis=1)
    for _ in range(_ROUNDS):
        rate = np.fft.irfft(np.fft.rfft(follow, axis=1) * s, wave.shape[1], axis=1)
        push = half * np.abs(rate) * np.where(size >= 0, 1.0, -1.0)
        if np.isfinite(slew):
            # Beyond the limit the rate costs more voltage: a stiffer lag there.
            push = push + mean * np.sign(rate) * np.maximum(np.abs(rate) - slew, 0.0)
        new = np.fft.irfft(np.fft.rfft(wave - push, axis=1) / (1 + s * mean), wave.shape[1], axis=1)
        follow = 0.5 * (follow + new)
    return np.asarray(follow)


def _lag(values: Values, variant: str) -> Effect:
    rise = values["rise_time_constant_s"]
    if rise == 0:
        return Effect()
    fall, slew = rise * values["fall_ratio"], values["limit_kv"] / rise

    def wave(given: Wave) -> Wave:
        if given.interval_s is None:
            return given
        return replace(given, film_kv=_lagged(given.film_kv, given.interval_s, rise, fall, slew))

    def constant(view: View, side: float) -> Float:
        # A step that the slew limits takes V/S longer.
        return np.asarray((rise if side > 0 else fall) + 0.5 * view.voltage_kv / slew)

    def edge(view: View, side: float) -> Complex:
        return np.asarray(1 / (1 + 2j * np.pi * view.frequency_hz * constant(view, side)))

    def squared_edge(view: View, side: float) -> Complex:
        # (1 − e^{−t/τ})² after the rise, e^{−2t/τ} after the fall.
        s = 2j * np.pi * view.frequency_hz * constant(view, side)
        return np.asarray(2 / ((1 + s) * (2 + s)) if side > 0 else 1 / (1 + s / 2))

    if variant == _HIDDEN:
        return Effect(film_voltage=(wave,), film_edges=(squared_edge,))
    monitored = Effect(monitor_wave=(wave,), monitor_edges=(edge,))
    if variant == MONITORED:
        return monitored
    behind = {
        "rise_time_constant_s": values["further_time_constant_s"],
        "fall_ratio": 1.0,
        "limit_kv": float("inf"),
    }
    return monitored | _lag(behind, _HIDDEN)


def _lag_report(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    rise = values["rise_time_constant_s"]
    further = {"further_time_constant_s": values["further_time_constant_s"]} if variant == FURTHER else {}
    return {
        "rise_time_constant_s": rise,
        "fall_time_constant_s": rise * values["fall_ratio"],
        "slew_kv_per_s": values["limit_kv"] / rise if rise else float("inf"),
        **further,
    }


def _offset(values: Values, variant: str) -> Effect:
    kv = values["offset_kv"]

    def shift(wave: Wave) -> Wave:
        return replace(wave, film_kv=wave.film_kv + kv)

    def rectify(wave: Wave) -> Wave:
        size = np.maximum(np.abs(wave.film_kv) - kv, 0.0) if kv > 0 else np.abs(wave.film_kv) - kv * (wave.film_kv != 0)
        return replace(wave, film_kv=np.sign(wave.film_kv) * size)

    return Effect(film_voltage=(shift if variant == "offset" else rectify,))


def _leak(values: Values, variant: str) -> Effect:
    droop, build, ohmic, at_once, power = (
        values[name] for name in ("droop", "build_up_s", "ohmic", "at_once", "field_power")
    )

    def conductance(kv: Float, largest: float) -> Float:
        return np.asarray(ohmic + (1 - ohmic) * (np.abs(kv) / max(largest, 1e-9)) ** power)

    def build_up(view: View) -> Complex:
        return np.asarray(at_once + (1 - at_once) / (1 + 2j * np.pi * view.frequency_hz * build))

    def edge(view: View, side: float) -> Complex | Float:
        sag = droop * conductance(view.voltage_kv, view.scale.voltage_kv)
        if side < 0:
            # The current ends with the voltage.
            return np.asarray(1 - sag)
        return np.asarray(1 - sag * build_up(view))

    def wave(given: Wave) -> Wave:
        # What builds up follows the voltage slowly: its mean over the period, the more so the longer it takes.
        mean = np.abs(given.film_kv).mean(axis=1, keepdims=True) / max(given.scale.voltage_kv, 1e-9)
        period = (given.interval_s or 0.0) * given.film_kv.shape[1]
        late = (1 - at_once) * build / (build + period)
        built = 1 - late * (1 - np.minimum(mean, 1.0))
        sag = droop * conductance(given.film_kv, given.scale.voltage_kv) * built
        return replace(given, film_kv=given.film_kv * (1 - sag))

    def squared_edge(view: View, side: float) -> Complex | Float:
        sag = droop * conductance(view.voltage_kv, view.scale.voltage_kv)
        if side < 0:
            return np.asarray((1 - sag) ** 2)
        # (1 − sag b)² of b = 1 − (1 − a) e^{−t/τ}, whose square falls with τ and with τ/2.
        s, late = 2j * np.pi * view.frequency_hz * build, 1 - at_once
        built = 1 - 2 * late * s / (1 + s) + late**2 * s / (2 + s)
        return np.asarray(1 - 2 * sag * build_up(view) + sag**2 * built)

    if variant == MONITORED:
        return Effect(monitor_wave=(wave,), monitor_edges=(edge,))
    return Effect(
        film_voltage=(lambda given: given if given.interval_s is None else wave(given),), film_edges=(squared_edge,)
    )


DRIVE_LAG = Mechanism(
    id="drive_lag",
    stage="drive",
    depends_on=("frequency",),
    equation="τ_r V̇ = u − V while it rises, τ_d while it falls, |V̇| ≤ S",
    source="converter that charges and resistor that discharges the film (thesis, section 3.3)",
    parameters=(
        Parameter("rise_time_constant_s", "s", "time constant of the rise", 3e-4, 1e-2),
        Parameter("fall_ratio", "1", "time constant of the fall over that of the rise", 0.5, 10.0, SHAPE),
        Parameter(
            "limit_kv",
            "kV",
            "lag of the voltage at which the rate is limited: S times τ_r",
            0.2,
            50.0,
            SHAPE,
            least=0.01,
        ),
        Parameter(
            "further_time_constant_s",
            "s",
            "time constant of the film's voltage behind the measured one",
            1e-5,
            1e-2,
            SHAPE,
            only=(FURTHER,),
        ),
    ),
    shows=AMPLIFIER | BENT,
    confusable={
        "frequency_dependent_permittivity": "the measured voltage against the command",
        "sensor_delay": "a lag lowers the magnitude too",
    },
    effect=_lag,
    report=_lag_report,
    variants=(MONITORED, _HIDDEN),
)

DRIVE_OFFSET = Mechanism(
    id="drive_offset",
    stage="drive",
    depends_on=("voltage",),
    equation="(V + V0)² acts, or a rectified voltage with a dead zone V0",
    source="offset of the amplifier or charge trapped in the film; Maxwell stress ε E²",
    parameters=(Parameter("offset_kv", "kV", "V0", 0.02, 0.5, signed=True, least=-5.0),),
    shows=BENT,
    confusable={
        "field_dependent_permittivity": "the effect of an offset falls as 1/V and changes with the polarity; that one grows as V²"
    },
    effect=_offset,
    variants=("offset", "rectified"),
)

LEAKAGE = Mechanism(
    id="leakage",
    stage="drive",
    depends_on=("voltage", "record_time"),
    equation="V (1 − d (q + (1 − q) (V/V_max)^p)): current V/R + a V^(p + 1), which builds up, through a series resistance "
    "before the monitor or behind it",
    source="current of polymers at high fields",
    parameters=(
        Parameter("droop", "1", "sag at the largest voltage", 0.01, 0.2, most=0.9),
        Parameter("build_up_s", "s", "time in which the sag builds up", 1e-3, 10.0, SHAPE),
        Parameter(
            "ohmic",
            "1",
            "share of the current at the largest voltage that is ohmic",
            0.0,
            1.0,
            SHAPE,
            log=False,
            most=1.0,
        ),
        Parameter("at_once", "1", "share of the current that needs no time", 0.0, 1.0, SHAPE, log=False, most=1.0),
        Parameter("field_power", "1", "p", 0.5, 4.0, SHAPE, least=0.1, most=8.0),
    ),
    shows=AMPLIFIER | BENT,
    confusable={
        "field_dependent_permittivity": "the measured voltage tells, or that a current builds up; behind the monitor one that flows at once "
        "is told by nothing but its own measurement",
        "wrinkling": "the measured voltage tells, or that a current builds up",
    },
    effect=_leak,
    variants=(MONITORED, _HIDDEN),
)
MECHANISMS = (DRIVE_LAG, DRIVE_OFFSET, LEAKAGE)
