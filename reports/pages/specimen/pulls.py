"""The part of a specimen's page about pulls to failure: strength, stretch at break, stiffness, and the laws."""

from __future__ import annotations

import json
import math
from typing import Any

from reports.blocks import Block, Figure, Fold, Head, Row, Section, Table, bold, flow
from reports.figures.pull import PullCurve, pull
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query, tell_warnings
from reports.results import Row as Record
from schemas.numbers import ABSENT, bounds, percent, pm, significant, with_unit

_TESTS_SQL = """SELECT t.*
FROM pull_tests AS t JOIN recordings AS r USING (recording_id)
WHERE t.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY r.started_at, t.recording_id"""
_LAWS_SQL = """SELECT l.*
FROM pull_laws AS l JOIN recordings AS r USING (recording_id)
WHERE l.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY r.started_at, l.recording_id, l.selected DESC, l.law"""
_CURVES_SQL = """SELECT curve, stretch, stress_kpa
FROM pull_curves
WHERE recording_id = $recording
ORDER BY curve, sample"""
_SHOWN = 4
"""Pulls that are drawn."""


def of_specimen(draft: Draft) -> Section | None:
    """All pulls of a specimen, the first ones drawn."""
    tests, laws = Query(_TESTS_SQL, {"specimen": draft.item}), Query(_LAWS_SQL, {"specimen": draft.item})
    found, fits = draft.results.rows(tests), draft.results.rows(laws)
    if not found:
        return None
    blocks: list[Block | Fold] = []
    for row in found[:_SHOWN]:
        blocks += _draw(
            draft, row, next((f for f in fits if f["recording_id"] == row["recording_id"] and f["selected"]), None)
        )
    return Section(
        "pulls", _heading(found[0]), "Pull to failure", (*blocks, _tests(draft, tests, found), _laws(draft, laws, fits))
    )


def _heading(row: Record) -> str:
    strength, stretch = with_unit(significant(row["strength_kpa"], 3), "kPa"), significant(row["stretch_at_break"], 3)
    if row["broke"]:
        return f"The film breaks at stretch {stretch} under {strength}"
    return f"The film holds stretch {stretch} and {strength} without breaking"


def _draw(draft: Draft, row: Record, law: Record | None) -> list[Block]:
    recording = row["recording_id"]
    data = draft.results.columns(Query(_CURVES_SQL, {"recording": recording}))
    if law is None or not data["curve"].size:
        return []
    measured, modelled = data["curve"] == "measured", data["curve"] == law["law"]
    curve = PullCurve(
        data["stretch"][measured].astype(float),
        data["stress_kpa"][measured].astype(float),
        law["law"],
        data["stretch"][modelled].astype(float),
        data["stress_kpa"][modelled].astype(float),
        row["stretch_at_break"] if row["broke"] else None,
    )
    end = f"break at stretch {significant(row['stretch_at_break'], 4)}" if row["broke"] else "no break"
    left = f"{law['law']} leaves {percent(law['rmse_kpa'] / row['strength_kpa'])} of the strength"
    alt = f"Nominal stress of {short(recording, 60)} up to {significant(row['strength_kpa'])} kPa; {end}; {left}."
    caption = flow(bold(draft.site.recording(recording)), f": {end}. The law {left}, root mean square.")
    return [Figure(pull(curve, alt=alt), caption, draft.data(f"pull_{recording}", data))]


def _tests(draft: Draft, query: Query, found: list[Record]) -> Table:
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]),
                _between(r["modulus_kpa"], r["modulus_kpa_lower"], r["modulus_kpa_upper"]),
                _number(r["stress_at_100_kpa"]),
                _number(r["stress_at_300_kpa"]),
                _bound(r, r["strength_kpa"]) + (f" ± {significant(r['strength_kpa_sd'], 2)}" if r["broke"] else ""),
                _break(r),
                _bound(r, r["work_kpa"]),
                _number(r["rate_per_s"]),
            )
        )
        for r in found
    ]
    heads = (
        Head("Recording"), Head("Slope at the start, kPa", "n"), Head("Stress at 100 %, kPa", "n"), Head("at 300 %, kPa", "n"),
        Head("Strength, kPa", "n"), Head("Stretch at break", "n"), Head("Work, kJ/m³", "n"), Head("Rate, 1/s", "n"),
    )  # fmt: skip
    below = (
        "Nominal stresses, in terms of ISO 37. Slope with its 95 % interval; strength ± one standard deviation of a sample; the"
        " break lies between the last sample before and the first after it. ≥: not broken. One film tells nothing of how much"
        " films of its kind differ."
    )
    below += tell_warnings(found, "pulls")
    return Table("Pulls to failure", heads, tuple(rows), query.shown(), below=below, kind="narrow")


def _laws(draft: Draft, query: Query, found: list[Record]) -> Table:
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]),
                f"{visible(r['law'])}{' ✓' if r['selected'] else ''}",
                visible(_parameters(json.loads(r["parameters"] or "{}"))),
                _number(r["young_kpa"]),
                _number(r["rmse_kpa"]),
                _number(r["held_out_rmse_kpa"]),
            ),
            "sel" if r["selected"] else "",
        )
        for r in found
    ]
    heads = (
        Head("Recording"), Head("Law"), Head("Parameters"), Head("Slope at stretch 1, kPa", "n"), Head("RMS error, kPa", "n"),
        Head("On parts left out, kPa", "n"),
    )  # fmt: skip
    below = (
        "A law with more parameters is taken where it lowers the error on parts of the curve that were left out by a tenth. A"
        " pull at one rate cannot tell elastic from viscous stress: the laws hold for this rate. ± is one standard deviation."
    )
    return Table("Hyperelastic laws up to the break", heads, tuple(rows), query.shown(), below=below, kind="narrow")


_NOTHING = 1e-9
"""A parameter smaller than this share of the largest lies at its bound 0: its digits are those of the search."""


def _parameters(values: dict[str, Any]) -> str:
    parts = []
    for name, value in values.items():
        if not name.endswith("_sd"):
            sd = values.get(f"{name}_sd")
            unit = "kPa" if name.endswith("modulus") else ""
            largest = max(abs(v) for n, v in values.items() if not n.endswith("_sd"))
            if abs(value) < _NOTHING * largest:
                text = "0, its bound"
            else:
                text = with_unit(significant(value, 4), unit) if sd is None else pm(value, sd, unit)
            parts.append(f"{name.replace('_', ' ')} {text}")
    return ", ".join(parts)


def _number(value: float | None) -> str:
    return ABSENT if value is None or not math.isfinite(value) else significant(value, 3)


def _between(value: float, low: float, high: float) -> str:
    return bounds(value, low, high)


def _bound(row: Record, value: float) -> str:
    return f"{'' if row['broke'] else '≥ '}{significant(value, 3)}"


def _break(row: Record) -> str:
    if not row["broke"]:
        return _bound(row, row["stretch_at_break"])
    return f"{significant(row['stretch_at_break'], 4)} to {significant(row['stretch_at_break_upper'], 4)}"
