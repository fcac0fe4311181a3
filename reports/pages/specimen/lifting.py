"""The part of a specimen's page about strokes at constant load: by level of the voltage, at once and slowly."""

from __future__ import annotations

import math

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Row, Section, Table, bold, flow
from reports.figures.isotonic import StrokeCurve, isotonic
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query, tell_warnings, write_bounds
from reports.results import Row as Record
from schemas.numbers import ABSENT, compact, percent, significant, with_unit

_TESTS_SQL = """SELECT t.*
FROM isotonic_tests AS t JOIN recordings AS r USING (recording_id)
WHERE t.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY r.started_at, t.recording_id"""
_STROKES_SQL = """SELECT s.*
FROM isotonic_strokes AS s JOIN recordings AS r USING (recording_id)
WHERE s.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY r.started_at, s.recording_id, s.voltage_kv"""
_SHOWN = 4
"""Tests that are drawn."""


def of_specimen(draft: Draft) -> Section | None:
    """All tests at constant load of a specimen, the first ones drawn."""
    tests, levels = Query(_TESTS_SQL, {"specimen": draft.item}), Query(_STROKES_SQL, {"specimen": draft.item})
    found, strokes = draft.results.rows(tests), draft.results.rows(levels)
    if not found:
        return None
    by_test = {row["recording_id"]: [s for s in strokes if s["recording_id"] == row["recording_id"]] for row in found}
    blocks: list[Block | Fold] = [_draw(draft, row, by_test[row["recording_id"]]) for row in found[:_SHOWN]]
    return Section(
        "isotonic",
        finding(found[0], by_test[found[0]["recording_id"]]),
        "Strokes at constant load",
        (*blocks, _tests(draft, tests, found), _strokes(draft, levels, strokes)),
    )


def finding(row: Record, strokes: list[Record]) -> str:
    """`At 5 kV the film moves 1 N by 0.62 mm, 91 % of it at once`."""
    last = strokes[-1]
    load = "its load" if row["load_n"] is None else with_unit(significant(row["load_n"], 3), "N")
    stroke = with_unit(significant(last["stroke_mm"], 3), "mm")
    share = last["instant_mm"] / last["stroke_mm"] if last["stroke_mm"] and last["instant_mm"] is not None else math.nan
    text = f"At {with_unit(compact(last['voltage_kv']), 'kV')} the film moves {load} by {stroke}"
    return f"{text}, {percent(share)} of it at once" if 0 <= share <= 1 else text


def _draw(draft: Draft, row: Record, strokes: list[Record]) -> Figure:
    recording = row["recording_id"]
    curve = StrokeCurve(
        np.array([s["voltage_kv"] for s in strokes]),
        np.array([s["stroke_mm"] for s in strokes]),
        np.array([[s["stroke_mm_lower"], s["stroke_mm_upper"]] for s in strokes], dtype=float),
        np.array([s["instant_mm"] for s in strokes], dtype=float),
        np.array([[s["instant_mm_lower"], s["instant_mm_upper"]] for s in strokes], dtype=float),
        row["mm_per_kv2"],
    )
    law = with_unit(write_bounds(row, "mm_per_kv2"), "mm/kV²")
    alt = f"Strokes of {short(recording, 60)} over the squared voltage, {law}."
    if row["instant_within_s"] is None:
        rise, fall = (with_unit(significant(row[f"mm_per_kv2_{way}"], 3), "mm/kV²") for way in ("rising", "falling"))
        text = f": stroke at the peak of a slow voltage; line: {law}, {rise} on the way up and {fall} on the way down."
    else:
        within = significant(row["instant_within_s"], 2)
        text = f": strokes with their 95 % intervals; line: {law}. At once: faster than {within} s."
    caption = flow(bold(draft.site.recording(recording)), text)
    columns = {"voltage_kv": curve.voltage, "stroke_mm": curve.stroke, "instant_mm": curve.instant}
    return Figure(isotonic(curve, alt=alt), caption, draft.data(f"isotonic_{recording}", columns))


def _tests(draft: Draft, query: Query, found: list[Record]) -> Table:
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]),
                ABSENT if r["load_n"] is None else significant(r["load_n"], 3),
                write_bounds(r, "mm_per_kv2"),
                write_bounds(r, "exponent"),
                ABSENT if r["p_value"] is None else significant(r["p_value"], 2),
                write_bounds(r, "free_strain"),
                write_bounds(r, "strain_per_field_squared_m2_per_mv2"),
                write_bounds(r, "drift_mm_per_h"),
            )
        )
        for r in found
    ]
    heads = (
        Head("Recording"), Head("Load, N", "n"), Head("Stroke over V², mm/kV²", "n"), Head("Power of V", "n"), Head("p, V²", "n"),
        Head("Free strain", "n"), Head("Strain over field², (m/MV)²", "n"), Head("Drift, mm/h", "n"),
    )  # fmt: skip
    below = "Values with their 95 % intervals. Free strain is the largest stroke over the length of the film under its load."
    below += tell_warnings(found, "tests")
    return Table("Tests at constant load", heads, tuple(rows), query.shown(), below=below, kind="narrow")


def _strokes(draft: Draft, query: Query, found: list[Record]) -> Table:
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]),
                compact(r["voltage_kv"]),
                str(r["repeats"]),
                ABSENT if r["on_s"] is None else compact(r["on_s"]),
                write_bounds(r, "stroke_mm"),
                write_bounds(r, "instant_mm"),
                write_bounds(r, "slow_mm"),
            )
        )
        for r in found
    ]
    heads = (
        Head("Recording"), Head("Voltage, kV", "n"), Head("Times", "n"), Head("On, s", "n"), Head("Stroke, mm", "n"),
        Head("At once, mm", "n"), Head("Slowly, mm", "n"),
    )  # fmt: skip
    below = (
        "Extension positive, 95 % intervals. What a level moves slowly is creep under voltage; it is told apart by the"
        " retardation times of the whole record, so that what is left of one level does not count for the next."
    )
    return Table("Strokes by level", heads, tuple(rows), query.shown(), below=below, kind="narrow")
