"""The parts of a specimen's page about voltage: response, blocked force, predictions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Figure, Head, Pair, Row, Section, Table, bold, flow
from reports.evidence import MISSES, Measured, drawable
from reports.figures import electrical as figures
from reports.figures.curves import Rig, stiffness
from reports.figures.electrical import Drive
from reports.figures.responses import Lines
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import ABSENT, compact, digits, percent, pm, significant, with_unit

_MOST = 6
"""Recordings drawn at most; the rest stand in the data file."""


def force_per_square(fits: Sequence[Record], blocked: Sequence[Lines]) -> tuple[float | None, float | None, str]:
    """F_A/V² in N/kV² with its SD and its origin: fitted, else the median of the usable blocked force."""
    fitted = [f for f in fits if f["force_per_voltage_squared_n_per_kv2"] is not None and f["selected"]]
    if fitted:
        best = min(fitted, key=lambda f: (f["extension"] or "", f["loading"], f["method"]))
        return best["force_per_voltage_squared_n_per_kv2"], best["force_per_voltage_squared_n_per_kv2_sd"], "fitted"
    values = [np.abs(b.value[b.usable]) for b in blocked]
    together = np.concatenate(values) if values else np.empty(0)
    return (float(np.median(together)), None, "median of the blocked force") if together.size else (None, None, "")


def response(
    draft: Draft, fits: Sequence[Record], chosen: Record | None, found: Measured, constants: Rig | None
) -> Section | None:
    """Electrical response with the prediction from the mechanical model, and the blocked force."""
    raw = found.stage("measured")
    if not raw:
        return None
    blocked = found.stage("corrected")
    force, force_sd, origin = force_per_square(fits, list(blocked.values()))
    names = _drive_names(draft, list(raw))
    model = chosen if chosen is not None and chosen["loading"] != "electrical" and drawable(chosen) else None
    f = np.concatenate([lines.frequency for lines in raw.values()])
    grid = np.geomspace(float(f.min()), float(f.max()), 200)

    def predicted(frequency: np.ndarray) -> np.ndarray | None:
        if model is None or constants is None or force is None:
            return None
        return force * constants.actuated(stiffness(model, frequency), frequency)

    drives = [Drive(names[r], lines, predicted(lines.frequency)) for r, lines in list(raw.items())[:_MOST]]
    curve = predicted(grid)
    href = draft.data("electrical", _data(raw, blocked))
    words = _prediction_words(draft)
    figures_ = [
        Figure(
            figures.response(
                drives, grid, curve,
                alt=f"Force per voltage squared of {short(draft.item, 40)} in {digits(len(raw), 'recording')}. {words}",
            ),
            flow(bold("Force under voltage."), " ", words or "No mechanical model predicts it.",
                 f" Line: the mechanical model behind clamp and load cell, F/V² {origin}." if curve is not None else ""),
            href,
        )
    ]  # fmt: skip
    if blocked:
        level = ABSENT if not force else with_unit(significant(1e3 * force), "mN/kV²")
        if force and force_sd:
            level = pm(1e3 * force, 1e3 * force_sd, "mN/kV²")
        figures_.append(
            Figure(
                figures.blocked_force(
                    [Drive(names.get(r, r), lines, None) for r, lines in list(blocked.items())[:_MOST]],
                    force, force_sd, alt=f"Blocked force per voltage squared, {level}, {origin}.",
                ),
                flow(bold("Blocked force."), f" {level}, {origin}. What slopes here is drive, permittivity or a wrong model, not the film."),
                href,
            )
        )  # fmt: skip
    heading = words.rstrip(".") if words else "Force under voltage"
    return Section("electrical", heading, "Force under voltage", (Pair(tuple(figures_)),))


def _drive_names(draft: Draft, recordings: Sequence[str]) -> dict[str, str]:
    """Peak voltage of each recording where the metadata give it, else the end of its name."""
    query = Query(
        "SELECT recording_id, TRY_CAST(coalesce(json_extract_string(metadata, '$.drive_kv'),"
        " json_extract_string(metadata, '$.recording.drive_kv')) AS DOUBLE) AS kv"
        " FROM recordings WHERE specimen_id = $specimen AND json_valid(metadata)",
        {"specimen": draft.item},
    )
    volts = {r["recording_id"]: r["kv"] for r in draft.results.rows(query)}
    known = [volts.get(r) for r in recordings]
    if all(v is not None for v in known) and len(set(known)) == len(known):
        return {r: f"{compact(v, 2)} kV" for r, v in zip(recordings, known, strict=True)}
    common = short(draft.item, 40)
    return {r: short(r.removeprefix(common).lstrip("_-. ") or r, 16) for r in recordings}


def _data(raw: dict[str, Lines], blocked: dict[str, Lines]) -> dict[str, list[object]]:
    columns: dict[str, list[object]] = {
        key: []
        for key in ("recording_id", "stage", "frequency_hz", "real_n_per_kv2", "imag_n_per_kv2",
                    "standard_error_n_per_kv2", "usable")
    }  # fmt: skip
    for stage, parts in (("measured", raw), ("corrected", blocked)):
        for recording, lines in parts.items():
            columns["recording_id"] += [recording] * lines.size
            columns["stage"] += [stage] * lines.size
            columns["frequency_hz"] += lines.frequency.tolist()
            columns["real_n_per_kv2"] += lines.value.real.tolist()
            columns["imag_n_per_kv2"] += lines.value.imag.tolist()
            columns["standard_error_n_per_kv2"] += lines.error.tolist()
            columns["usable"] += lines.usable.tolist()
    return columns


_PREDICTIONS = Query("SELECT fitted_on, predicted, magnitude_error, phase_error_deg, relative_error\nFROM predictions")


def _predictions(draft: Draft) -> tuple[Query, list[Record]]:
    query = Query(
        _PREDICTIONS.sql + "\nWHERE specimen_id = $specimen\nORDER BY fitted_on, predicted", {"specimen": draft.item}
    )
    return query, draft.results.rows(query)


def _prediction_words(draft: Draft) -> str:
    for row in _predictions(draft)[1]:
        if row["fitted_on"].startswith("mechanical") and row["predicted"].startswith(("electrical", "sphs")):
            error = row["relative_error"]
            if error is not None and error >= MISSES:
                return f"The mechanical model misses the force under voltage by {percent(error)}."
            return f"The mechanical model predicts the force under voltage to {percent(error)}."
    return ""


def _magnitude(row: Record) -> str:
    """The error of a magnitude with its unit: of a stiffness, or of force over V² where a voltage drives."""
    if row["predicted"].startswith(("electrical", "sphs")):
        return with_unit(
            significant(None if row["magnitude_error"] is None else 1e3 * row["magnitude_error"], 2), "mN/kV²"
        )
    return with_unit(significant(row["magnitude_error"], 2), "N/mm")


def predictions(draft: Draft) -> Section | None:
    """What the model of one loading says about recordings of another."""
    query, found = _predictions(draft)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                visible(r["fitted_on"]), visible(r["predicted"]), _magnitude(r),
                significant(r["phase_error_deg"], 2), percent(r["relative_error"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Fitted on"), Head("Predicted"), Head("Magnitude error", "n"), Head("Phase error, °", "n"),
        Head("Relative error", "n"),
    )  # fmt: skip
    worst = max((r["relative_error"] for r in found if r["relative_error"] is not None), default=None)
    heading = "Predictions" if worst is None else f"What was not fitted is predicted to {percent(worst)} or better"
    table = Table("The model of one loading against recordings of another", heads, rows, query.shown(), kind="narrow")
    return Section("predictions", heading, "Predictions", (table,))
