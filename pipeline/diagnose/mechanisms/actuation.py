"""Mechanisms of the actuation: permittivity that depends on field or frequency, dying electrodes, wrinkles."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from pipeline.diagnose.features import kinds
from pipeline.diagnose.mechanisms.mechanism import (
    BENT,
    ELECTRICAL,
    SHAPE,
    Context,
    Mechanism,
    Parameter,
    Values,
)
from pipeline.diagnose.simulation.effects import Cracks, Effect, View, Wave
from schemas.arrays import Complex, Float

_LOWEST_HZ = 1e-4
"""Frequency below which a power law is constant, Hz."""
_CELLS = 64
"""Cells of a period in each of which what follows the voltage is constant."""
_ROUNDS, _SETTLED = 20, 1e-9
"""Rounds at most in which the levels of a period are found, and the share of the largest by which they move no more."""


def _field(values: Values, variant: str) -> Effect:
    fraction, exponent = values["fraction"], values["exponent"]

    def falls(wave: Wave) -> Wave:
        field = np.abs(wave.film_kv) / max(wave.scale.voltage_kv, 1e-9)
        return replace(wave, squared=wave.squared * (1 - fraction * field**exponent))

    return Effect(squared=(falls,))


def _frequency(values: Values, variant: str) -> Effect:
    power = -values["per_decade"] / np.log(10)

    def slopes(view: View) -> Complex:
        # A power of jω falls with the frequency by that share per decade and has the phase that causality asks for.
        return view.power_of_jw(power, tau=0.5 / np.pi, lowest_hz=_LOWEST_HZ)

    def relaxes(view: View) -> Complex:
        # Re 1/(1 + jωτ) falls steepest at ωτ = 1: by ln 10 / 2 per decade.
        turned = 2j * np.pi * view.frequency_hz * values["time_constant_s"]
        return np.asarray(1 + 2 * values["per_decade"] / np.log(10) / (1 + turned))

    if power == 0:
        return Effect()
    return Effect(actuation=(relaxes if variant == "relaxation" else slopes,))


def _frequency_report(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    time = {"time_constant_s": values["time_constant_s"]} if variant == "relaxation" else {}
    return {"per_decade": values["per_decade"], **time}


def _degraded(values: Values, variant: str) -> Effect:
    loss, cycles, stretch = values["loss"], values["cycles"], values["stretch"]

    def left(view: View) -> Float:
        exposure = np.maximum(view.exposure_kv2_s, 0.0) / max(view.scale.voltage_kv, 1e-9) ** 2
        return np.asarray(1 - loss * -np.expm1(-((exposure / cycles) ** stretch)))

    def opened(view: View) -> Float:
        return np.asarray(values["opening"] * (1 - left(view)))

    return Effect(electrode=(left,), opening=(Cracks(opened, values["opening_power"]),))


def _wrinkled(values: Values, variant: str) -> Effect:
    overload, growth = values["overload"], values["growth"]
    rise, recovery, kept = values["rise_s"], values["recovery_s"], values["kept"]
    at_once, of_area = variant == "at_once", variant == "of_area"
    if overload <= 0:
        return Effect()

    def begin(largest: float) -> float:
        """The squared voltage from which there are wrinkles."""
        return (largest / (1 + overload)) ** 2

    def lost(squared: Float, largest: float) -> Float:
        """What wrinkles take of the squared voltage in the end."""
        return np.asarray((1 - growth) * np.maximum(squared - begin(largest), 0.0))

    def stops(wave: Wave) -> Wave:
        if wave.interval_s is None:
            return wave
        target = lost(wave.film_kv**2, wave.scale.voltage_kv)
        if not target.any():
            return wave
        if at_once:
            return replace(wave, squared=wave.squared - target)
        if of_area:
            share = follow_in_steady_state(np.where(target > 0, 1 - growth, 0.0), wave.interval_s, rise, recovery)
            above = wave.film_kv**2 - begin(wave.scale.voltage_kv)
            return replace(wave, squared=wave.squared - share * np.where(above > 0, above, kept * above))
        held = follow_in_steady_state(target, wave.interval_s, rise, recovery)
        return replace(wave, squared=np.maximum(wave.squared - held, kept * held))

    def edge(view: View, side: float) -> Complex | Float:
        squared = np.maximum(view.voltage_kv, 1e-9) ** 2
        share = lost(view.voltage_kv**2, view.scale.voltage_kv) / squared
        if at_once:
            return np.asarray(1 - share)
        s = 2j * np.pi * view.frequency_hz
        if side > 0:
            return np.asarray(1 - share / (1 + s * rise))
        # Wrinkles that are still there without voltage keep the tension down.
        left = (1 - growth) * begin(view.scale.voltage_kv) / squared * (share > 0) if of_area else share
        return np.asarray(1 - share - kept * left * s * recovery / (1 + s * recovery))

    return Effect(squared=(stops,), film_edges=(edge,))


def follow_in_steady_state(target: Float, interval_s: float, rise_s: float, fall_s: float) -> Float:
    """One period (S, W) of what follows `target` with one time constant upwards and another downwards, in steady state.

    Constant within each of some tens of cells of the period, in which the target may cross it many times. Newton's method on
    the levels of all cells at once: what a cell adds to its level is piecewise linear in it, and the period of linear maps
    closes exactly.
    """
    states, samples = target.shape
    size = max(1, samples // _CELLS)
    count = samples // size
    cells = target[:, : count * size].reshape(states, count, size)
    up, down = (-np.expm1(-size * interval_s / t) for t in (rise_s, fall_s))
    mean = cells.mean(axis=2)
    held = np.repeat(mean.mean(axis=1)[:, None], count, axis=1)
    enough = _SETTLED * float(np.abs(mean).max())
    for _ in range(_ROUNDS):
        # Upwards what lies above the level, downwards the rest.
        above = cells - held[:, :, None]
        is_above = above > 0
        share = np.count_nonzero(is_above, axis=2) / size
        excess = np.einsum("ijk,ijk->ij", above, is_above) / size
        kept = 1 - down - (up - down) * share
        added = down * (mean - held) + (up - down) * excess
        last, held = held, _close_period(kept, held + added - kept * held)
        if float(np.abs(held - last).max()) <= enough:
            break
    after = np.roll(held, -1, axis=1)
    middle = (np.arange(count) + 0.5) * size
    at = np.concatenate([[middle[-1] - samples], middle, [middle[0] + samples]])
    closed = np.concatenate([after[:, -1:], after, after[:, :1]], axis=1)
    return np.array([np.interp(np.arange(samples), at, row) for row in closed])


def _close_period(kept: Float, added: Float) -> Float:
    """(S, C) levels before each cell of a period that ends where it begins, where a cell makes `kept` level + `added` of a level.

    The maps of 1, 2, 4, … cells up to each cell, composed: no quotient of products that may vanish.
    """
    step = 1
    while step < kept.shape[1]:
        earlier, beside = np.ones_like(kept), np.zeros_like(added)
        earlier[:, step:], beside[:, step:] = kept[:, :-step], added[:, :-step]
        kept, added = kept * earlier, kept * beside + added
        step *= 2
    first = added[:, -1:] / (1 - kept[:, -1:])
    return np.concatenate([first, kept[:, :-1] * first + added[:, :-1]], axis=1)


def _onset_kv(values: Values, variant: str, context: Context) -> dict[str, float | str]:
    lasting = float(variant != "at_once")
    return {
        "onset_kv": context.scale.voltage_kv / (1 + values["overload"]),
        "growth": values["growth"],
        **{name: lasting * values[name] for name in ("rise_s", "recovery_s", "kept")},
    }


FIELD_DEPENDENT_PERMITTIVITY = Mechanism(
    id="field_dependent_permittivity",
    stage="actuation",
    depends_on=("voltage",),
    equation="ε (1 − a (E/E_max)^p), E_max the field at the session's largest voltage, p about 2",
    source="saturation of dipoles at high fields",
    parameters=(
        Parameter("fraction", "1", "loss of permittivity at the largest voltage", 0.005, 0.15, signed=True, least=-1.0, most=0.9),
        Parameter("exponent", "1", "p", 1.0, 4.0, SHAPE, least=0.3, most=8.0),
    ),
    shows=BENT,
    confusable={
        "drive_offset": "an offset falls as 1/V and depends on the polarity: four or more voltages, both polarities",
        "leakage": "the measured voltage tells",
        "wrinkling": "wrinkles begin at an onset and recover slowly",
    },
    effect=_field,
)  # fmt: skip

FREQUENCY_DEPENDENT_PERMITTIVITY = Mechanism(
    id="frequency_dependent_permittivity",
    stage="actuation",
    depends_on=("frequency",),
    equation="ε (jf/1 Hz)^{−b/ln 10}: falls by b per decade of frequency; or ε (1 + (2b/ln 10)/(1 + jωτ)): by b per decade at 1/τ",
    source="Curie-von Schweidler law of dielectrics; Debye relaxation",
    parameters=(
        # A passive dielectric only falls: its loss is not negative (Kramers-Kronig).
        Parameter("per_decade", "1", "fall per decade", 0.002, 0.06, most=0.5),
        Parameter("time_constant_s", "s", "τ of one relaxation", 3e-3, 30.0, SHAPE),
    ),
    variants=("power", "relaxation"),
    report=_frequency_report,
    shows=ELECTRICAL,
    confusable={
        "drive_lag": "the measured voltage against the command",
        "passive_strip": "the blocked force with the strip in it; the creep of the capacitance",
    },
    effect=_frequency,
)

ELECTRODE_DEGRADATION = Mechanism(
    id="electrode_degradation",
    stage="actuation",
    depends_on=("exposure",),
    equation="w (1 − d (1 − e^{−(n/n0)^β})), n = ∫V²dt over the session in seconds at the largest voltage",
    source="loss of conducting paths in compliant electrodes under voltage",
    parameters=(
        Parameter("loss", "1", "share of the electrode lost in the end", 0.02, 0.4, most=0.99),
        Parameter("cycles", "s at the largest voltage", "n0", 10.0, 1000.0, SHAPE, least=0.1),
        Parameter("stretch", "1", "β", 0.5, 1.2, SHAPE, log=False, least=0.2, most=2.0),
        Parameter(
            "opening",
            "1",
            "capacitance that cracks take at the largest strain, over the loss",
            0.0,
            3.0,
            SHAPE,
            log=False,
        ),
        Parameter(
            "opening_power",
            "1",
            "power of the strain by which cracks open",
            1.0,
            3.0,
            SHAPE,
            log=False,
            least=0.5,
            most=4.0,
        ),
    ),
    shows=ELECTRICAL | {kinds.CYCLIC_CAPACITANCE},
    faint=("cyclic",),
    confusable={
        "baseline_drift": "there the capacitance stays",
        "field_dependent_permittivity": "it does not follow the number of cycles",
    },
    effect=_degraded,
)

WRINKLING = Mechanism(
    id="wrinkling",
    stage="actuation",
    depends_on=("voltage",),
    equation="V² stops growing above V_c; what is lost comes with a time t_r and goes with a time t_w, a part of it acting on without "
    "voltage, or comes and goes at once, or in a share of the area, which comes with t_r, goes with t_w and holds V² at V_c² meanwhile",
    source="loss of tension (thesis, section 5.4.6)",
    parameters=(
        Parameter("overload", "1", "largest voltage over the onset, less 1", 0.02, 1.0),
        Parameter("growth", "1", "growth that is left above the onset", 0.0, 0.5, SHAPE, log=False, most=1.0),
        Parameter("recovery_s", "s", "t_w", 0.1, 3.0, SHAPE, least=1e-3),
        Parameter("rise_s", "s", "t_r", 0.02, 1.0, SHAPE, least=1e-3),
        Parameter(
            "kept",
            "1",
            "what wrinkles keep of the force without voltage, over what they take of it with voltage",
            0.0,
            1.0,
            SHAPE,
            log=False,
            most=10.0,
        ),
    ),
    shows=BENT,
    confusable={
        "leakage": "the measured voltage tells",
        "sensor_saturation": "slow return only with wrinkles",
        "field_dependent_permittivity": "no onset there",
    },
    effect=_wrinkled,
    variants=("lasting", "at_once", "of_area"),
    onset=True,
    report=_onset_kv,
)
MECHANISMS = (
    FIELD_DEPENDENT_PERMITTIVITY,
    FREQUENCY_DEPENDENT_PERMITTIVITY,
    ELECTRODE_DEGRADATION,
    WRINKLING,
)
