"""What a diagnosis compares, in the form that figures need it: kinds of features in words and units, blocks as curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.comparison import Compared
from reports.results import Row
from reports.words import plain
from schemas.arrays import Complex, Float
from schemas.numbers import compact

Values = Complex | Float


@dataclass(frozen=True)
class Kind:
    """A kind of features: what it is in words, what its axis says, the factor from stored to shown unit.

    `line`: its values lie on a curve over frequency or time, else they are drawn as marks; `column`: its name in the map of
    residuals.
    """

    words: str
    title: str
    column: str
    factor: float = 1.0
    line: bool = False


_RESPONSE, _HARMONICS, _LEVEL, _FORCE, _CAPACITANCE, _DRIVE, _REST, _UNSEEN = (
    "response", "harmonics", "mean force", "force", "capacitance", "drive", "rest", "left out",
)  # fmt: skip
COLUMNS = (_RESPONSE, _HARMONICS, _LEVEL, _FORCE, _CAPACITANCE, _DRIVE, _REST, _UNSEEN, "calibration")

KINDS = {
    "chirp.response": Kind("response in the sweep", "Response |F/x|, N/mm", _RESPONSE, 1.0, True),
    "chirp.harmonic": Kind("harmonics of the sweep's force", "Harmonics of the force, mN", _HARMONICS, 1e3),
    "chirp.level": Kind("mean force of the sweeps", "Mean force against rest, mN", _LEVEL, 1e3),
    "sphs.response": Kind("response to voltage", "Response |F/V²|, mN/kV²", _RESPONSE, 1e3, True),
    "sphs.detection": Kind("force at lines that were not excited", "Force beside the lines, mN", _HARMONICS, 1e3),
    "sphs.voltage": Kind("voltage over command", "Voltage over command, kV/V", _DRIVE, 1.0, True),
    "sphs.capacitance": Kind(
        "capacitance over voltage squared", "Capacitance over V², pF/kV²", _CAPACITANCE, 1.0, True
    ),
    "electrical_chirp.response": Kind(
        "response in the sweep of the voltage", "Response |F/V²|, mN/kV²", _RESPONSE, 1e3, True
    ),
    "electrical_chirp.harmonic": Kind(
        "harmonics of the force in the sweep of the voltage", "Harmonics of the force, mN", _HARMONICS, 1e3
    ),
    "electrical_chirp.capacitance": Kind(
        "capacitance in the sweep of the voltage", "Capacitance over V², pF/kV²", _CAPACITANCE, 1.0, True
    ),
    "electrical_chirp.voltage": Kind(
        "voltage over command in the sweep", "Voltage over command, kV/V", _DRIVE, 1.0, True
    ),
    "cyclic.response": Kind("response in the cycles", "Response |F/x|, N/mm", _RESPONSE),
    "cyclic.harmonic": Kind("harmonics of the cycles' force", "Harmonics of the force, mN", _HARMONICS, 1e3),
    "cyclic.level": Kind("mean force of the cycles", "Mean force against rest, mN", _LEVEL, 1e3),
    "cyclic.capacitance": Kind("capacitance in the cycles", "Capacitance over x, pF/mm", _CAPACITANCE),
    "step.force": Kind("force after the edges", "Loss of tension, mN", _FORCE, 1e3, True),
    "step.capacitance": Kind("capacitance after the edges", "Change of the capacitance, pF", _CAPACITANCE, 1.0, True),
    "step.voltage": Kind("voltage after the edges of the command", "Voltage over command, kV/V", _DRIVE, 1.0, True),
    "relaxation.force": Kind("force after the step of displacement", "Force against rest, mN", _FORCE, 1e3, True),
    "cycle.force": Kind("force over the large cycle", "Force against rest, mN", _FORCE, 1e3, True),
    "cycle.stress": Kind("stress over the large cycle", "Stress, kPa", _FORCE, 1.0, True),
    "cycle.unseen": Kind("stress as the fit to the loading alone predicts it", "Stress, kPa", _UNSEEN, 1.0, True),
    "system.output": Kind("output of the system", "Output", "output", 1.0, True),
    "rest.hum": Kind("mains in the rest", "Mains in the rest, SD", _REST),
    "tap.ring": Kind("ringing of the clamp", "Ringing of the clamp", "calibration"),
    "weight.gain": Kind("weights", "Recorded force over weight", "calibration"),
}


def kind_of(name: str) -> Kind:
    """The kind of that name; one that is not listed is called what it is."""
    return KINDS.get(name, Kind(plain(name.replace(".", " ")), plain(name.replace(".", " ")), plain(name)))


_FREQUENCY, _TIME = ("Frequency, Hz", True), ("Time since the start of the recording, s", False)
_TOLD_BY = {
    "amplitude": ("strain amplitude, %", 100.0),
    "voltage_kv": ("voltage, kV", 1.0),
    "frequency_hz": ("frequency, Hz", 1.0),
    "cycle": ("cycle", 1.0),
}
_NAMED = 9
"""Most names on an axis in the order of the session."""


def compared(kind: str, rows: Sequence[Row], *, together: bool) -> Compared | None:
    """Values of one kind: of one block over frequency or time, or of small blocks `together` in the order of the session."""
    real = [r for r in rows if r["component"] != "imaginary"]
    imaginary = [r for r in rows if r["component"] == "imaginary"]
    about = kind_of(kind)
    if imaginary and len(imaginary) != len(real):
        return None

    def values(name: str) -> Values:
        parts = [np.array([r[name] for r in part], dtype=float) for part in (real, imaginary)]
        return about.factor * (parts[0] + 1j * parts[1] if imaginary else parts[0])

    groups: tuple[tuple[float, str], ...] = ()
    if together:
        x = np.arange(len(real), dtype=float)
        groups, title = _groups(real)
        log = False
    else:
        frequencies = all(r["frequency_hz"] for r in real) and len({r["frequency_hz"] for r in real}) > 1
        over_time = kind.partition(".")[0] in ("step", "relaxation", "cycle", "system") or not frequencies
        title, log = _TIME if over_time else _FREQUENCY
        x = np.array([r["time_s" if over_time else "frequency_hz"] for r in real], dtype=float)
        if not np.isfinite(x).all():
            return None
    extended = values("extended")
    return Compared(
        x=x,
        measured=values("measured"),
        plain=values("plain"),
        extended=extended if np.isfinite(extended).all() else None,
        sd=about.factor * np.array([r["sd"] for r in real], dtype=float),
        title=about.title,
        x_title=title,
        x_log=log and bool(np.all(x > 0)),
        lines=about.line and not together,
        groups=groups,
    )


def _groups(rows: Sequence[Row]) -> tuple[tuple[tuple[float, str], ...], str]:
    """Each recording's place in the order of the session, named by the covariate that tells recordings apart."""
    order = list(dict.fromkeys(r["recording_id"] for r in rows))
    places = {name: [i for i, r in enumerate(rows) if r["recording_id"] == name] for name in order}
    best: tuple[tuple[float, str], ...] = ()
    title, kinds = "Values in the order of the session", 1
    for name, (words, factor) in _TOLD_BY.items():
        found = [rows[places[recording][0]][name] for recording in order]
        if any(v is None for v in found):
            continue
        texts = [compact(factor * v, 2) for v in found]
        if len(set(texts)) > kinds:
            kinds, title = len(set(texts)), f"Recordings in their order, by {words}"
            named = [(sum(places[r]) / len(places[r]), text) for r, text in zip(order, texts, strict=True)]
            best = tuple(named[:: -(-len(named) // _NAMED)])
    return best, title
