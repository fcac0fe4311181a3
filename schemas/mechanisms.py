"""The causes that a diagnosis can name, in plain words: everyday name, finding, and how a severity is written.

Equations and fits of the causes are the analysis' own (`pipeline.diagnose.mechanisms`); here is only what a reader of the
terminal and of the pages sees. A cause that is not listed is shown by its id, a parameter by its key.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from schemas.numbers import ABSENT, NBSP, UNRESOLVED, is_usable, ordinal, percent, pm, significant, with_unit

RIG = "rig_constants"
"""The cause whose severity is of constants in the rig's file."""
FOREIGN = "foreign_recording"
"""The fault of a recording that is that of another specimen."""
FILM, RECORD = "film", "record"
"""The stages of what the film does, and of what is wrong with recordings and their metadata."""


@dataclass(frozen=True)
class Parameter:
    """How a parameter of a severity is shown: words, factor to the shown unit, that unit."""

    words: str
    factor: float = 1.0
    unit: str = ""


@dataclass(frozen=True)
class Mechanism:
    """A cause in words. `finding` has one `{}` for the severity of its first parameter, `reverse` says it for a negative one, and `unsigned`
    where the sign is not known."""

    name: str
    finding: str
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    reverse: str = ""
    unsigned: str = ""


ACTIONS: dict[str, str] = {
    "rig_constants": "Measure the clamp's mass and the load cell's stiffness anew (known weights; taps, and taps with a known mass more), and put them into the rig's file.",
    "load_cell_damping": "Put the damping into the rig's file. Where it differs between tests, look for a loose clamp.",
    "drive_lag": "Nothing has to be measured again: models use the measured voltage. Faster tests need a stronger amplifier.",
    "amplitude_softening": "For strokes of this size use the extended model; the plain one is a mean over the strokes that were tested.",
    "cyclic_softening": "Cycle such films until they no longer change before they are measured; for fresh ones use the extended model.",
    "missing_relaxation": "Use the extended model, and hold a step as long as the film will be used for.",
    "power_law_relaxation": "Use the extended model, and hold a step as long as the film will be used for.",
    "baseline_drift": "Let the film rest longer after it is stretched, or zero the load cell before each test.",
    "thermal_softening": "Record the temperature beside the tests, and let film and rig warm through before them.",
    "field_dependent_permittivity": "For high voltages use the extended model; forces from the square of the voltage are too large there.",
    "frequency_dependent_permittivity": "For fast actuation use the extended model; static forces promise too much there.",
    "electrode_degradation": "Renew the electrode or make it thicker; do not sense by it beyond the cycle at which it began.",
    "slack": "Stretch the film more before the test, or move it less.",
    "strain_stiffening": "For strokes of this size use the extended model; the plain one is a mean over the strokes that were tested.",
    "sensor_delay": "Put the delay of that channel into its mapping or the rig's file, and look which filter is on.",
    "gain_error": "Calibrate that channel, and put its factor into the mapping or the rig's file.",
    "drive_offset": "Zero the amplifier; until then put the offset into the mapping.",
    "leakage": "Look at electrode and leads for a conducting path, and record the leakage current.",
    "wrinkling": "Stay below that voltage, or stretch the film more; forces above it are those of a wrinkled film.",
    "clamp_slip": "Clamp anew and repeat what was pulled beyond that force; what stayed below is sound.",
    "mains_hum": "Look at shields and earth of the force channel; responses near the mains frequency are not the film's.",
    "sensor_saturation": "Repeat those tests with less amplitude or a cell of a larger range.",
    "passive_strip": "Look for film that carries no electrode beside the active part, and put its length into the metadata.",
    "channels_swapped": "Exchange the two columns in the mapping; the lines to write stand among the corrections.",
    "sign_flipped": "Turn the sign of that channel in the mapping; the line to write stands among the corrections.",
    "unit_slip": "Put the unit right in the mapping; the line to write stands among the corrections.",
    "sample_rate_wrong": "Put the rate right in the mapping; the line to write stands among the corrections.",
    "clock_drift": "Put the clock's factor into the mapping, and let one clock sample both channels.",
    "channel_skew": "Put the delay into the mapping, and look how the two channels are started.",
    "strain_wrong": "Look which strain was driven, and put it into the metadata.",
    "size_wrong": "Measure the film's sizes again, and put them into the metadata.",
    "foreign_recording": "Look whose recording it is and put its specimen_id right, or exclude it.",
    "foreign_rig": "Look on which rig it was made, and put its rig_id right.",
    "dead_channel": "Look at that channel's cable and repeat the test.",
    "specimen_changed": "Look whether the film tore or was clamped anew; give what came after another specimen_id.",
}
"""What a laboratory does where a cause is named, a sentence or two."""


def _share(words: str) -> Parameter:
    return Parameter(words, 100.0, "%")


_BEYOND = _share("largest load beyond the onset")

MECHANISMS: dict[str, Mechanism] = {
    "rig_constants": Mechanism(
        "Constants of the rig",
        "the rig differs from its file, by {}",
        {"stiffness_error": _share("load-cell stiffness"), "mass_error": _share("clamp mass")},
    ),
    "load_cell_damping": Mechanism(
        "Damping of the load cell",
        "the load cell is damped otherwise than its file says, by {} of critical",
        {"damping_ratio": _share("damping ratio")},
    ),
    "drive_lag": Mechanism(
        "Lag of the drive",
        "the voltage lags its command, by {}",
        {
            "rise_time_constant_s": Parameter("rise time constant", 1e3, "ms"),
            "fall_time_constant_s": Parameter("fall time constant", 1e3, "ms"),
            "slew_kv_per_s": Parameter("slew rate", 1.0, "kV/s"),
            "further_time_constant_s": Parameter("time constant behind the monitor", 1e3, "ms"),
        },
    ),
    "amplitude_softening": Mechanism(
        "Softening with amplitude",
        "the film softens with amplitude, by {} at the largest",
        {"drop": _share("drop at the largest strain"), "strain_scale": _share("strain of half the drop")},
    ),
    "cyclic_softening": Mechanism(
        "Softening over cycles",
        "the film softens from cycle to cycle, by {}",
        {
            "loss": _share("loss"),
            "cycles": Parameter("cycles"),
            "strain_scale": _share("strain scale"),
            "rejoining": _share("back at the largest strain"),
        },
    ),
    "missing_relaxation": Mechanism(
        "A relaxation the model lacks",
        "the model lacks a relaxation, of {} of k₀",
        {"stiffness_ratio": _share("stiffness over k₀"), "time_constant_s": Parameter("time constant", 1.0, "s")},
    ),
    "power_law_relaxation": Mechanism(
        "Power-law relaxation",
        "the film relaxes by a power law, of {} of k₀",
        {"stiffness_ratio": _share("stiffness at 1 s over k₀"), "exponent": Parameter("exponent")},
    ),
    "baseline_drift": Mechanism(
        "Drift of the baseline",
        "the force drifts down, by {} of the rest force per decade of time",
        {"per_decade": _share("of the rest force, per decade"), "onset_s": Parameter("from", 1.0, "s")},
        "the force drifts up, by {} of the rest force per decade of time",
        "the force drifts",
    ),
    "thermal_softening": Mechanism(
        "Softening with temperature",
        "the film softens as it warms, by {} per kelvin",
        {
            "per_kelvin": _share("per kelvin"),
            "rise_k": Parameter("rise", 1.0, "K"),
            "self_heating_k": Parameter("own heat in a cycle", 1e3, "mK"),
        },
        "the film stiffens as it warms, by {} per kelvin",
        "the film softens or stiffens as it warms",
    ),
    "field_dependent_permittivity": Mechanism(
        "Permittivity falls with the field",
        "the permittivity falls with the field, by {} at the largest voltage",
        {"fraction": _share("at the largest voltage")},
        "the permittivity rises with the field, by {} at the largest voltage",
        "the permittivity changes with the field",
    ),
    "frequency_dependent_permittivity": Mechanism(
        "Permittivity changes with frequency",
        "the permittivity falls with frequency, by {} per decade",
        {"per_decade": _share("per decade")},
        "the permittivity rises with frequency, by {} per decade",
        "the permittivity changes with frequency",
    ),
    "electrode_degradation": Mechanism(
        "Degrading electrode",
        "the electrode degrades, losing {}",
        {"loss": _share("loss"), "cycles": Parameter("time at the largest voltage", 1.0, "s")},
    ),
    "slack": Mechanism(
        "Slack film",
        "the film goes slack, when {} of its preload are gone",
        {
            "onset": _share("of the preload"),
            "onset_n": Parameter("fall of the tension", 1.0, "N"),
            "overload": _BEYOND,
            "residual": _share("of the stiffness left on the softer side"),
        },
    ),
    "strain_stiffening": Mechanism(
        "Stiffening with strain",
        "the film stiffens with strain, by {} at the largest",
        {"stiffening": _share("at the largest strain")},
        "the film softens with strain without a loss, by {} at the largest",
        "the film stiffens or softens with strain",
    ),
    "sensor_delay": Mechanism("Delayed sensor", "a sensor is late, by {}", {"delay_s": Parameter("delay", 1e6, "µs")}),
    "gain_error": Mechanism(
        "Wrong gain",
        "a channel reads too much, by {}",
        {"gain": _share("gain error")},
        "a channel reads too little, by {}",
        "a channel reads too much or too little",
    ),
    "drive_offset": Mechanism(
        "Offset of the drive",
        "the voltage has an offset, of {}",
        {"offset_kv": Parameter("offset", 1.0, "kV")},
        "the voltage has an offset, of minus {}",
        "the voltage has an offset",
    ),
    "leakage": Mechanism("Leakage", "the film leaks, and the voltage sags by {}", {"droop": _share("droop")}),
    "wrinkling": Mechanism(
        "Wrinkling",
        "the film wrinkles, from {} on",
        {
            "onset_kv": Parameter("onset", 1.0, "kV"),
            "recovery_s": Parameter("recovery", 1.0, "s"),
            "overload": _BEYOND,
        },
    ),
    "clamp_slip": Mechanism(
        "Slipping clamp",
        "the clamp slips, where the tension rises or falls by more than {}",
        {
            "slip_force_n": Parameter("slip force", 1.0, "N"),
            "slip_force": _share("of the peak force"),
            "overload": _BEYOND,
            "hardening": _share("of k₀ holds a part that slips"),
        },
    ),
    "mains_hum": Mechanism(
        "Mains hum", "mains hum adds {} to the force", {"amplitude_n": Parameter("amplitude", 1e3, "mN")}
    ),
    "sensor_saturation": Mechanism(
        "Saturated sensor",
        "the force sensor saturates, at {}",
        {"limit_n": Parameter("limit", 1.0, "N"), "overload": _BEYOND},
    ),
    "passive_strip": Mechanism(
        "Passive strip",
        "a passive strip with a relaxation of its own lies in series, leaving {} of the force",
        {"ratio": _share("of the force left"), "time_constant_s": Parameter("time constant", 1.0, "s")},
    ),
}

FAULTS: dict[str, Mechanism] = {
    "channels_swapped": Mechanism("Swapped channels", "a recording has two channels in each other's place"),
    "sign_flipped": Mechanism("Flipped sign", "a recording has a channel with the opposite sign"),
    "unit_slip": Mechanism("Slip of a unit", "a channel is recorded in another unit or range than its file says"),
    "sample_rate_wrong": Mechanism("Wrong sample rate", "the clock of a recording is not that of its test"),
    "clock_drift": Mechanism("Drifting clock", "the clocks of two channels run apart"),
    "channel_skew": Mechanism("Skewed channels", "a recording has one channel stamped later than the other"),
    "strain_wrong": Mechanism("Wrong strain", "the strain that the metadata state is not that driven"),
    "size_wrong": Mechanism("Wrong size", "a size in the metadata is not that of the film"),
    "foreign_recording": Mechanism("Foreign recording", "a recording is that of another specimen"),
    "foreign_rig": Mechanism("Foreign rig", "a recording names another rig than it was made on"),
    "dead_channel": Mechanism("Dead channel", "a recording has a channel that stands still"),
    "specimen_changed": Mechanism("Changed specimen", "the film was another from one recording on"),
}
"""Causes of everyday life: what is wrong with recordings and their metadata, no mechanism of film or rig."""

FINDING = "finding"
"""Key of a severity that says all of a fault in words, with its recordings."""

_WORDS = MECHANISMS | FAULTS


UNLISTED = "unlisted"
"""Stands in `also_possible` where the cause may be none of those listed."""


def plain_name(mechanism: str) -> str:
    """Everyday name of a cause; its id where it has none here."""
    if mechanism == UNLISTED:
        return "a cause in no list"
    known = _WORDS.get(mechanism)
    return known.name if known else mechanism.replace("_", " ")


def list_actions(mechanisms: Sequence[str]) -> list[str]:
    """What to do about causes, in their order, each once."""
    return list(dict.fromkeys(ACTIONS[m] for m in mechanisms if m in ACTIONS))


def quote_name(mechanism: str) -> str:
    """The everyday name of a mechanism as it stands within a sentence: “constants of the rig”."""
    name = plain_name(mechanism)
    return f"“{name[:1].lower()}{name[1:]}”"


def nested(text: str | None) -> dict[str, dict[str, Any]]:
    """JSON of the form {mechanism: {parameter: anything}}; what is not of that form is left out."""
    try:
        found = json.loads(text) if text else {}
    except ValueError:
        return {}
    if not isinstance(found, dict):
        return {}
    return {str(m): dict(p) for m, p in found.items() if isinstance(p, dict)}


def amount(mechanism: str, parameter: str, value: Any) -> str:
    """A severity as read: {value, sd} gives value ± SD in the parameter's unit, a bare number the number, text itself."""
    shown = _shown(mechanism, parameter)
    if isinstance(value, dict):
        number, sd = value.get("value"), value.get("sd")
        if not isinstance(number, int | float):
            return str(number)
        return pm(number * shown.factor, None if sd is None else sd * shown.factor, shown.unit)
    if isinstance(value, int | float) and not isinstance(value, bool):
        return _with_its_unit(value * shown.factor, shown.unit)
    return str(value)


def _with_its_unit(value: float, unit: str) -> str:
    """A number to two digits with its unit; what is not all of it is never 100 %."""
    return percent(value / 100) if unit == "%" and abs(value) < 100 else with_unit(significant(value, 2), unit)


def parameter_words(mechanism: str, parameter: str) -> str:
    """What a parameter of a severity means, in words."""
    return _shown(mechanism, parameter).words or parameter.replace("_", " ")


def severity(mechanism: str, parameters: Mapping[str, Any]) -> str:
    """All parameters of a severity in one line; those that are hardly known by their 90 % intervals."""
    parts = [(parameter_words(mechanism, key), _held(mechanism, key, value)) for key, value in parameters.items()]
    if len(parts) == 1:
        return parts[0][1]
    return ", ".join(f"{words} {text}" for words, text in parts)


_HARDLY = 10.0
"""Upper over lower end of a 90 % interval from which a value with a standard deviation would say more than is known."""


def _held(mechanism: str, parameter: str, value: Any) -> str:
    lower, upper = (value.get(end) for end in ("lower", "upper")) if isinstance(value, dict) else (None, None)
    if lower and upper and lower > 0 and upper > _HARDLY * lower:
        shown = _shown(mechanism, parameter)
        ends = (significant(end * shown.factor, 2) for end in (lower, upper))
        return f"{with_unit(' to '.join(ends), shown.unit)} (90 %)"
    return amount(mechanism, parameter, value)


def _shown(mechanism: str, parameter: str) -> Parameter:
    known = _WORDS.get(mechanism)
    return known.parameters.get(parameter, Parameter("")) if known else Parameter("")


def main(mechanism: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """The main parameter of a severity, without shapes and other ways to say it; of the rig both constants."""
    known = _WORDS.get(mechanism)
    found = [key for key in known.parameters if key in parameters] if known else list(parameters)
    return {key: parameters[key] for key in found[: 2 if mechanism == RIG else 1]}


_WHOLE = {"%": 1.0, "ms": 1.0, "µs": 1.0}
"""The largest that a severity of a unit may be, before it is scaled to that unit: a share all of it, a delay or a lag a second."""


def candidate(mechanism: str, value: float | None, sd: float | None, parameter: str | None = None) -> str:
    """The severity of a cause that was tried, as read: of that parameter, or of its first.

    What is not known to within the whole, and not even whether it is there, is unresolved.
    """
    if value is None:
        return ABSENT
    known = _WORDS.get(mechanism)
    shown = parameter or (next(iter(known.parameters), "") if known else "")
    whole = _WHOLE.get(_shown(mechanism, shown).unit)
    if sd is not None and whole is not None and sd > max(abs(value), whole):
        return UNRESOLVED
    return amount(mechanism, shown, {"value": value, "sd": sd})


def finding(mechanism: str, parameters: Mapping[str, Any], *, beside: bool = False, sized: bool = True) -> str:
    """The cause as a sentence by its main parameter: `the load cell is stiffer …, by 6.3 ± 0.3 %`.

    Parameters
    ----------
    beside : whether another cause is told before it
    sized : whether the size is told, or its direction alone
    """
    known = _WORDS.get(mechanism)
    if mechanism == UNLISTED:
        return "something that is in no list acts beside that" if beside else "the cause is in no list"
    if isinstance(parameters.get(FINDING), str):
        return str(parameters[FINDING])
    if known is None:
        return f"the cause is {plain_name(mechanism)}"
    main = next((key for key in known.parameters if key in parameters), None)
    if main is None or (mechanism == RIG and not sized):
        return known.unsigned or _leave_size_out(known.finding)
    if mechanism == RIG:
        return ", and ".join(_rig_finding(k, parameters[k]) for k in list_sure(mechanism, parameters))
    text, size = known.finding, parameters[main]
    if known.reverse and _value(size) < 0:
        text, size = known.reverse, _positive(size)
    channel = parameters.get("channel")
    if isinstance(channel, str):
        text = text.replace("a sensor is", f"the {channel} channel is").replace("a channel reads", f"{channel} reads")
    return text.format(amount(mechanism, main, size)) if sized and _is_resolved(size) else _leave_size_out(text)


def list_sure(mechanism: str, parameters: Mapping[str, Any]) -> list[str]:
    """Parameters of a severity that are off by more than their uncertainty explains, the clearest first; that one alone where none is."""
    known = _WORDS[mechanism].parameters
    by_z = sorted((k for k in known if k in parameters), key=lambda k: -_z(parameters[k]))
    return [k for k in by_z if _z(parameters[k]) > _SURE] or by_z[:1]


def _leave_size_out(finding: str) -> str:
    return finding.partition(",")[0].replace(" {}", "")


def _is_resolved(value: Any) -> bool:
    """Whether a severity is a number that is known to something."""
    return not isinstance(value, dict) or is_usable(value.get("sd"))


def _positive(value: Any) -> Any:
    """The size of a severity without its sign."""
    return {**value, "value": abs(_value(value))} if isinstance(value, dict) else abs(_value(value))


def _value(value: Any) -> float:
    number = value.get("value") if isinstance(value, dict) else value
    return float(number) if isinstance(number, int | float) else 0.0


_SURE = 2.0
"""Standard deviations from which on each constant of a rig that is off is told."""


def _z(value: Any) -> float:
    sd = value.get("sd") if isinstance(value, dict) else None
    return abs(_value(value)) / sd if sd else abs(_value(value))


def _rig_finding(parameter: str, value: Any) -> str:
    part, more, less = (
        ("clamp", "heavier", "lighter") if parameter == "mass_error" else ("load cell", "stiffer", "softer")
    )
    what = more if _value(value) >= 0 else less
    return f"the {part} is {what} than its file says, by {amount(RIG, parameter, _positive(value))}"


def model_name(order: int) -> str:
    """`third-order`, `first-order (Zener)`."""
    return f"{ordinal(order)}-order" + (f"{NBSP}(Zener)" if order == 1 else "")
