"""What the database says about a specimen, in the form that sentences and figures need it.

Which fit to show, whether its residual is noise, what the verdict is: decided here once for index, specimen and campaign
pages. Sentences are made in `reports.findings`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from reports.figures.curves import arms, band, rig, stiffness
from reports.figures.responses import Curve, Lines, Residual, residual
from reports.results import Query, Results, Row
from schemas.arrays import Complex, Float

STIFFNESS = "stiffness_n_per_mm"
MISSES = 0.2
"""Relative error from which a model does not predict, but misses."""
_LOADINGS = {"mechanical": 0, "joint": 1, "electrical": 2}
_METHODS = {"forward": 0, "corrected": 1, "time_domain": 2}
_IN_99_OF_100 = 2.326
"""Standard deviations of a normal number that one in a hundred exceeds."""


def choice(fits: Sequence[Row]) -> Row | None:
    """The fit to use: selected and without extension; mechanical before joint before electrical, forward before divided."""
    plain = [f for f in fits if f["selected"] and not f["extension"]]
    return min(plain, key=_preference, default=None)


def _preference(fit: Row) -> tuple[int, int]:
    return _LOADINGS.get(fit["loading"], 9), _METHODS.get(fit["method"], 9)


def siblings(fits: Sequence[Row], chosen: Row) -> list[Row]:
    """All orders of the chosen fit's loading, method and weighting, without extension, ascending."""
    alike = ("loading", "method", "weighting")
    same = [f for f in fits if all(f[name] == chosen[name] for name in alike)]
    return sorted((f for f in same if not f["extension"]), key=lambda f: f["model_order"])


def extended(fits: Sequence[Row], chosen: Row) -> Row | None:
    """The fit with mechanisms in it, of the same loading, where a diagnosis left one."""
    found = [f for f in fits if f["extension"] and f["loading"] in (chosen["loading"], "joint")]
    return min(
        found,
        key=lambda f: (f["model_order"] != chosen["model_order"], not f["selected"], _preference(f)),
        default=None,
    )


def noise_limit(fit: Row) -> float:
    """Largest reduced χ² that noise alone reaches in 99 of 100 fits with as many degrees of freedom."""
    return _noise_quantile(fit, _IN_99_OF_100)


def _noise_quantile(fit: Row, deviations: float) -> float:
    """Reduced χ² of noise alone that many standard deviations from its middle.

    Wilson and Hilferty's normal approximation; each fitted line has two components.
    """
    lines = fit["frequency_lines"] or 1
    return _quantile(max(1, 2 * lines - (2 * fit["model_order"] + 1)), deviations)


def _quantile(freedom: int, deviations: float) -> float:
    spread = 2 / (9 * freedom)
    return float(max(1 - spread + deviations * math.sqrt(spread), 0.0) ** 3)


def plain_beyond_noise(diagnosis: Row) -> bool:
    """The plain model of a diagnosis misses its recordings by more than noise: what it says of the film has no ± that would hold."""
    chi2, count = diagnosis["chi2"], diagnosis["feature_count"]
    return bool(chi2 and count) and chi2 / count > _quantile(count, _IN_99_OF_100)


def beyond_noise(fit: Row) -> bool:
    """The residual of the fit is no noise."""
    return fit["reduced_chi2"] is not None and fit["reduced_chi2"] > noise_limit(fit)


def times_noise(fit: Row) -> float | None:
    """How many times the noise the fit leaves over all that it was fitted to, √ of reduced χ²: the one measure of headlines and pictures."""
    return None if fit["reduced_chi2"] is None else float(fit["reduced_chi2"]) ** 0.5


def less_than_noise(fit: Row) -> bool:
    """The model leaves less than noise of the stated size would: the errors that the fit reckoned with are too large."""
    return fit["reduced_chi2"] is not None and fit["reduced_chi2"] < _noise_quantile(fit, -_IN_99_OF_100)


def no_relaxation(fit: Row) -> bool:
    """Not even the best relaxation of any order describes the response: the positivity alarm."""
    chi2 = fit["positivity_chi2"]
    return chi2 is not None and chi2 > max(1.5, noise_limit(fit))


def told(diagnosis: Row | None) -> Row | None:
    """A row of `diagnoses` that has a verdict; else None."""
    return diagnosis if diagnosis is not None and diagnosis["verdict"] else None


def unasked(diagnosis: Row | None) -> tuple[str, ...]:
    """Why there is no verdict, where a row of `diagnoses` says so."""
    return () if diagnosis is None or diagnosis["verdict"] else tuple(diagnosis["could_not_ask"] or ())


@dataclass(frozen=True)
class Standing:
    """How a specimen stands: its diagnosis if one was made, else its fit."""

    specimen_id: str
    material: str | None
    configuration: str | None
    fit: Row | None
    diagnosis: Row | None
    stated: Mapping[str, Any] = field(default_factory=dict)
    """Constants of the rig as the recordings state them."""
    unasked: tuple[str, ...] = ()
    """Why no diagnosis could be made of what was measured."""
    batch: str = ""
    """The batch of film, or of specimens, that the recordings name."""
    taps: bool = False
    """Taps of the clamp are among the recordings that the diagnosis rests on: they tell mass and stiffness without a film."""
    owner: str = ""
    """Whose the foreign recordings among them may be, in a sentence; empty where there are none, or no specimen is like them."""
    extension: Row | None = None
    """The fit with the causes in it that the diagnosis found."""
    negative: str = ""
    """What came out negative that no film has, and why that may be; empty where nothing did."""

    @property
    def verdict(self) -> str:
        """named, ambiguous, unknown, none; empty where no diagnosis was made."""
        return str(self.diagnosis["verdict"]) if self.diagnosis else ""

    @property
    def mechanisms(self) -> tuple[str, ...]:
        """The causes that the diagnosis names."""
        return tuple(self.diagnosis["mechanisms"] or ()) if self.diagnosis else ()

    @property
    def alarm(self) -> bool:
        """Somebody should look: something is negative, a cause was found or searched in vain, or more than noise is left."""
        if self.negative:
            return True
        if self.diagnosis:
            return self.verdict != "none"
        return self.fit is not None and (no_relaxation(self.fit) or beyond_noise(self.fit))


RESPONSE_SQL = """SELECT recording_id, stage, frequency_hz, "real", imag, standard_error, amplification, usable, amplitude,
       between_spread, unusable_because
FROM frequency_responses
WHERE specimen_id = $specimen AND loading = $loading
ORDER BY stage, recording_id, frequency_hz"""


@dataclass(frozen=True)
class Measured:
    """The responses of a specimen under one loading: by recording and stage, and the averaged one."""

    by_recording: dict[tuple[str, str], Lines]
    averaged: Lines | None
    amplitude: dict[str, float]

    def stage(self, stage: str) -> dict[str, Lines]:
        """Responses of that stage by recording."""
        return {recording: lines for (found, recording), lines in self.by_recording.items() if found == stage}

    @property
    def film(self) -> Lines | None:
        """What models are drawn against: averaged, else corrected, else measured lines of all recordings."""
        if self.averaged is not None:
            return self.averaged
        for stage in ("corrected", "measured"):
            parts = list(self.stage(stage).values())
            if parts:
                return together(parts)
        return None

    @property
    def recorded(self) -> Lines | None:
        """The record before correction, where there is a corrected one: of the recording with most lines."""
        raw = self.stage("measured")
        if not raw or (self.averaged is None and not self.stage("corrected")):
            return None
        most = max(lines.size for lines in raw.values())
        if most == 1:
            found = together(list(raw.values()))
        else:
            found = next(lines for lines in raw.values() if lines.size == most)
        return found if self._differs(found) else None

    def _differs(self, recorded: Lines) -> bool:
        """The correction changes something that can be seen: more than 1 % anywhere."""
        film = self.film
        if film is None or film.size < 2:
            return film is not None
        parts = (np.interp(recorded.frequency, film.frequency, p) for p in (film.value.real, film.value.imag))
        real, imag = parts
        corrected = real + 1j * imag
        with np.errstate(divide="ignore", invalid="ignore"):
            return bool(np.nanmax(np.abs(recorded.value / corrected - 1), initial=0.0) > 0.01)


def measured(results: Results, specimen: str, loading: str) -> Measured:
    """The responses of a specimen under that loading."""
    query = Query(RESPONSE_SQL, {"specimen": specimen, "loading": loading})
    data = results.columns(query)
    stages, recordings = data["stage"], data["recording_id"]
    keys = [(str(s), "" if r is None else str(r)) for s, r in zip(stages, recordings, strict=True)]
    by_recording: dict[tuple[str, str], Lines] = {}
    amplitude: dict[str, float] = {}
    averaged = None
    for key in dict.fromkeys(keys):
        rows = np.array([k == key for k in keys])
        if key[0] == "averaged":
            averaged = _lines(data, rows)
        else:
            by_recording[key] = _lines(data, rows)
            amplitude[key[1]] = float(data["amplitude"][rows][0])
    return Measured(by_recording, averaged, amplitude)


def _lines(data: dict[str, Any], rows: Any) -> Lines:
    def real(column: str) -> Float:
        return np.asarray(data[column][rows], dtype=float)

    value = real("real") + 1j * real("imag")
    usable = np.array([bool(u) for u in data["usable"][rows]]) & np.isfinite(value)
    return Lines(real("frequency_hz"), value, real("standard_error"), usable, real("amplification"))


def together(parts: Sequence[Lines]) -> Lines:
    """Lines of several recordings in one, by frequency."""
    frequency = np.concatenate([p.frequency for p in parts])
    order = np.argsort(frequency, kind="stable")
    return Lines(
        frequency[order],
        np.concatenate([p.value for p in parts])[order],
        np.concatenate([p.error for p in parts])[order],
        np.concatenate([p.usable for p in parts])[order],
        np.concatenate([p.amplification for p in parts])[order],
    )


def curve(fit: Row, found: Measured, lines: Lines, stated: Mapping[str, Any], *, points: int = 160) -> Curve:
    """The fit's model on the film's lines and on a grid over them, its band where the covariance is stored, its residual.

    A model that was fitted forward is judged where it was fitted: on the recorded response, through the fitted rig and with
    the factor that the fit gave each recording. Any other is judged on the corrected lines.
    """
    low, high = float(lines.frequency.min()), float(lines.frequency.max())
    grid = np.geomspace(low, high, points) if high > low else np.array([low])
    return Curve(
        order=int(fit["model_order"]),
        selected=bool(fit["selected"]),
        at_lines=stiffness(fit, lines.frequency),
        grid=grid,
        on_grid=stiffness(fit, grid),
        residual=_recorded_residual(fit, found, stated) or residual(lines, stiffness(fit, lines.frequency)),
        sd=band(fit, grid) if fit["selected"] else None,
        times_noise=times_noise(fit),
    )


def _recorded_residual(fit: Row, found: Measured, stated: Mapping[str, Any]) -> Residual | None:
    """The residual of the recorded responses; None where the fit was not forward or the rig is not known."""
    constants = rig(fit, stated)
    parts = found.stage("measured")
    if fit["method"] != "forward" or constants is None or not parts:
        return None
    gains = _gains(fit)
    expected = []
    for recording, lines in parts.items():
        k = stiffness(fit, lines.frequency)
        # The fit names what moves alike by three digits of the amplitude; that of a record has more.
        gain = gains.get(recording, gains.get(f"amplitude {found.amplitude[recording]:.3g}", 1.0))
        expected.append(gain * constants.recorded(k, lines.frequency))
    level = _find_level(list(parts.values()), expected) if gains else 1.0
    residuals = [
        residual(lines, level * values, recorded=True) for lines, values in zip(parts.values(), expected, strict=True)
    ]
    frequency = np.concatenate([r.frequency for r in residuals])
    order = np.argsort(frequency, kind="stable")
    return Residual(
        frequency[order],
        np.concatenate([r.magnitude for r in residuals])[order],
        np.concatenate([r.phase for r in residuals])[order],
        recorded=True,
    )


def _find_level(measured: Sequence[Lines], expected: Sequence[Complex]) -> float:
    """The common factor by which records are nearest to what is expected of them; 1 where no noise is known.

    The factors of recordings are stored as of the best relaxation of any order, which has a level of its own: their ratios alone hold
    for each model.
    """
    lines = together(measured)
    model = np.concatenate(expected)[np.argsort(np.concatenate([m.frequency for m in measured]), kind="stable")]
    good = lines.usable & (lines.component > 0)
    weight = lines.component[good] ** -2.0
    size = float(np.sum(weight * np.abs(model[good]) ** 2))
    return float(np.sum(weight * (np.conj(model[good]) * lines.value[good]).real)) / size if size > 0 else 1.0


def _gains(fit: Row) -> dict[str, float]:
    """Factor of each recording, or of each amplitude, that the fit found beyond the noise."""
    try:
        stored = json.loads(fit["spread"] or "{}")
        return {str(name): float(gain) for name, gain in stored.get("gains", {}).items()}
    except (ValueError, TypeError, AttributeError):
        return {}


def drawable(fit: Row) -> bool:
    """The row has parameters to draw a curve from."""
    return fit["k0_n_per_mm"] is not None and bool(arms(fit))
