"""What a diagnosis found, in the terms of the virtual rig: severities of mechanisms become hidden effects.

The two are written apart from each other, so that they do not name everything alike, and the rig has not all of them.
What it cannot do is refused: a simulation without it would pass for one with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from schemas.errors import UsageError

Severity = Mapping[str, Any]
"""Parameters of a mechanism as `diagnoses.severity` has them: numbers, texts such as channel and form."""


def translate_severities(severities: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Effects of a campaign file, mechanism → parameters, that do what a diagnosis found.

    Parameters
    ----------
    severities : mechanism → parameter → number, text, or {value, sd, …}

    Raises
    ------
    UsageError : the virtual rig has no such effect, or none of that form
    """
    found = {}
    for mechanism, parameters in severities.items():
        if mechanism not in _AS_EFFECTS:
            raise _refuse(f"{mechanism} cannot be put on the virtual rig")
        plain = {k: v["value"] if isinstance(v, Mapping) else v for k, v in parameters.items()}
        found[mechanism] = _AS_EFFECTS[mechanism]({k: v for k, v in plain.items() if v is not None})
    return found


def _refuse(problem: str) -> UsageError:
    return UsageError(problem, expected=f"one of {', '.join(_AS_EFFECTS)}, in a form that it has")


def _as_it_is(own: Severity) -> dict[str, Any]:
    return dict(own)


def _lag(own: Severity) -> dict[str, Any]:
    forms = {"monitored": True, "hidden from the monitor": False}
    form = own.get("form", "monitored")
    if form not in forms:
        raise _refuse(f"drive_lag of the form “{form}” cannot be put on the virtual rig")
    return {**{k: v for k, v in own.items() if k != "form"}, "monitored": forms[form]}


def _hum(own: Severity) -> dict[str, Any]:
    amplitude = own["amplitude_n"]
    return {"amplitude_n": amplitude, "second_n": own["second"] * amplitude, "frequency_hz": own["frequency_hz"]}


def _drift(own: Severity) -> dict[str, Any]:
    if own.get("form", "recording") != "recording":
        raise _refuse("baseline_drift that runs through a session cannot be put on the virtual rig")
    return {"per_decade": own["per_decade"], "t0_s": own["onset_s"]}


_AS_EFFECTS: Mapping[str, Callable[[Severity], dict[str, Any]]] = {
    "rig_constants": _as_it_is,
    "drive_lag": _lag,
    "gain_error": _as_it_is,
    "sensor_delay": _as_it_is,
    "mains_hum": _hum,
    "baseline_drift": _drift,
}
"""How a severity becomes an effect, for every mechanism whose effect does the same."""
