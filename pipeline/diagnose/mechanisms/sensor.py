"""Mechanisms of the sensors: delay, gain, mains and clipping of a channel."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pipeline.diagnose.features import kinds
from pipeline.diagnose.mechanisms.mechanism import (
    AMPLIFIER,
    ELECTRICAL,
    FORCES,
    MECHANICAL,
    SHAPE,
    SPHS_FORCE,
    Context,
    Mechanism,
    Parameter,
    Values,
)
from pipeline.diagnose.simulation.effects import Effect, Factor, Reading, View
from schemas.arrays import Complex, Float

_CHANNELS = ("force", "displacement", "voltage", "capacitance")
_BY_SIDE, _BY_LEVEL, _IN_TIME = "by side", "by level", "in time"
_UNEVEN = tuple(f"force, {form}" for form in (_BY_SIDE, _BY_LEVEL, _IN_TIME))
"""Forms of a gain that is not the same everywhere: above and below rest, at small and large forces, early and late."""


def _split_form(variant: str) -> tuple[str, str]:
    """Channel, and the form in which it is wrong; empty where a mechanism has only one."""
    channel, _, form = variant.partition(", ")
    return channel, form


def _on(channel: str, factor: Factor) -> Effect:
    if channel == "force":
        return Effect(force=(factor,))
    if channel == "displacement":
        return Effect(displacement=(factor,))
    if channel == "voltage":
        return Effect(voltage=(factor,))
    return Effect(capacitance=(factor,))


def _delay(values: Values, variant: str) -> Effect:
    channel, form = _split_form(variant)
    delay = values["delay_s"]

    def factor(view: View) -> Complex:
        s = 2j * np.pi * view.frequency_hz * delay
        return np.asarray(np.exp(-s) if form == "shift" else 1 / (1 + s / 2) ** 2)

    return _on(channel, factor)


def _channel_of(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    return {**values, "channel": _split_form(variant)[0]}


def _gain(values: Values, variant: str) -> Effect:
    channel, form = _split_form(variant)
    gain = values["gain"]
    if not form:
        return _on(channel, lambda view: 1 + gain)
    apart = gain * values["unevenness"]
    if form == _IN_TIME:
        return _on(channel, lambda view: 1 + gain + apart * (2 * view.session_s / max(view.scale.duration_s, 1e-9) - 1))

    def read(reading: Reading) -> Float:
        change = np.abs(reading.force - reading.rest_n)
        if form == _BY_LEVEL:  # about rest: how it reads the tension itself is its even part
            if reading.largest_n <= 0:  # no test says what a large force is
                return reading.force
            change = change**2 / reading.largest_n
        return np.asarray(reading.force + apart * change)

    return Effect(force=(lambda view: 1 + gain,), reading=(read,))


def _report_gain(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    form = _split_form(variant)[1]
    return {**_channel_of(values, variant, context)} | ({"form": form} if form else {})


def _hum(values: Values, variant: str) -> Effect:
    f = float(variant.removesuffix(" Hz"))
    return Effect(hum_n=((f, values["amplitude_n"]), (2 * f, values["second"] * values["amplitude_n"])))


def _hum_report(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    return {**values, "frequency_hz": float(variant.removesuffix(" Hz"))}


def _saturation(values: Values, variant: str) -> Effect:
    overload, softness = values["overload"], max(values["softness"], 1e-3)

    def clip(reading: Reading) -> Float:
        limit = reading.largest_n / (1 + overload)
        if limit <= 0:  # where nothing is read, nothing is clipped
            return reading.force
        width = softness * limit
        beyond = np.maximum(np.abs(reading.force) - limit, 0.0)
        bent = np.sign(reading.force) * (limit + width * np.tanh(beyond / width))
        return np.asarray(np.where(beyond > 0, bent, reading.force))

    return Effect(reading=(clip,)) if overload > 0 else Effect()


def _limit(values: Values, variant: str, context: Context) -> Mapping[str, float | str]:
    return {"limit_n": context.loads.reading_n / (1 + values["overload"]), "softness": values["softness"]}


SENSOR_DELAY = Mechanism(
    id="sensor_delay",
    stage="sensor",
    depends_on=("frequency",),
    equation="e^{−jωΔ} on one channel, or two equal poles of that total delay",
    source="linear phase of a delay; anti-alias filters",
    parameters=(Parameter("delay_s", "s", "how much later the channel shows what happened", 1e-5, 2e-3),),
    shows=MECHANICAL | ELECTRICAL,
    faint=("cyclic", "relaxation", "cycle"),
    confusable={
        "drive_lag": "a lag lowers the magnitude, a delay does not",
        "missing_relaxation": "a delayed force is no relaxation of any order; a delayed displacement shows in no electrical test",
    },
    effect=_delay,
    absorbed=True,
    variants=("force, two_pole", "force, shift", "displacement, two_pole", "displacement, shift"),
    report=_channel_of,
)

GAIN_ERROR = Mechanism(
    id="gain_error",
    stage="sensor",
    depends_on=(),
    equation="one channel × (1 + g); of the force g (1 ± u) above and below rest, g (1 + u ΔF/F_max) of changes ΔF since rest, or g (1 ± u) at both ends of the session",
    source="calibration; non-linearity of load cells, and drift of their span",
    parameters=(
        Parameter("gain", "1", "recorded over true, less 1", 1e-3, 0.2, signed=True, factor=True, least=-0.95),
        Parameter("unevenness", "1", "u, by which share it is larger there, and less elsewhere", 0.1, 1.0, SHAPE, most=2.0, only=_UNEVEN),
    ),
    shows=MECHANICAL | ELECTRICAL | SPHS_FORCE | AMPLIFIER | {kinds.WEIGHT_GAIN},
    confusable={
        "thermal_softening": "a gain that drifts is in the reading of weights as well",
        "rig_constants": "a gain has no resonance; force against displacement is never decided by one rig's data",
    },
    effect=_gain,
    absorbed=True,
    varies_with=("session_time", "amplitude"),
    variants=_CHANNELS + _UNEVEN,
    report=_report_gain,
)  # fmt: skip

MAINS_HUM = Mechanism(
    id="mains_hum",
    stage="sensor",
    depends_on=("frequency",),
    equation="F + a sin(2π f t + φ) + a₂ sin(4π f t + φ₂), f = 50 or 60 Hz, not locked to the drive",
    source="mains pick-up",
    parameters=(
        Parameter("amplitude_n", "N", "amplitude at f", 5e-4, 2e-2),
        Parameter("second", "1", "amplitude at 2 f over that at f", 0.05, 1.0, SHAPE),
    ),
    shows=frozenset({kinds.REST_HUM}),
    confusable={"rig_constants": "mains are there with the drive off"},
    effect=_hum,
    variants=("50 Hz", "60 Hz"),
    report=_hum_report,
)

SENSOR_SATURATION = Mechanism(
    id="sensor_saturation",
    stage="sensor",
    depends_on=("amplitude",),
    equation="|F| bends to a ceiling beyond a limit",
    source="range of the load cell and its amplifier",
    parameters=(
        Parameter("overload", "1", "largest force over the limit, less 1", 0.02, 1.0),
        Parameter("softness", "1", "ceiling over the limit, less 1", 0.003, 0.1, SHAPE),
    ),
    shows=FORCES,
    faint=("sphs", "step"),
    confusable={
        "slack": "the level of the clipping is that of the range, and both signs are cut",
        "wrinkling": "no slow return",
    },
    effect=_saturation,
    onset=True,
    report=_limit,
)
MECHANISMS = (SENSOR_DELAY, GAIN_ERROR, MAINS_HUM, SENSOR_SATURATION)
