"""The part of a specimen's page about a voltage that goes up and down slowly: drop of the force over the squared voltage."""

from __future__ import annotations

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Row, Section, Table, bold, flow
from reports.figures.slow_voltage import DropCurve, slow_voltage
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query, tell_warnings, write_bounds
from reports.results import Row as Record
from schemas.numbers import compact, significant, with_unit

_TESTS_SQL = """SELECT t.*
FROM voltage_cycles AS t JOIN recordings AS r USING (recording_id)
WHERE t.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY r.started_at, t.recording_id"""
_CURVE_SQL = "SELECT * FROM voltage_cycle_curves WHERE recording_id = $recording ORDER BY point"
_SHOWN = 4
"""Tests that are drawn."""


def of_specimen(draft: Draft) -> Section | None:
    """All tests with a slow voltage of a specimen, the first ones drawn."""
    query = Query(_TESTS_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    blocks: list[Block | Fold] = [_draw(draft, row) for row in found[:_SHOWN]]
    return Section(
        "slow-voltage", finding(found[0]), "Force under a slow voltage", (*blocks, _tests(draft, query, found))
    )


def finding(row: Record) -> str:
    """`The force drops by 0.00431 N/kV², at 5 kV by 108 mN`; rises where it does."""
    drop, peak = row["drop_n_per_kv2"], row["peak_kv"]
    verb = "drops" if drop >= 0 else "rises"
    whole = with_unit(significant(1000 * abs(drop) * peak**2, 3), "mN")
    return f"The force {verb} by {with_unit(significant(abs(drop), 3), 'N/kV²')}, at {with_unit(compact(peak), 'kV')} by {whole}"


def _draw(draft: Draft, row: Record) -> Figure:
    recording = row["recording_id"]
    points = draft.results.rows(Query(_CURVE_SQL, {"recording": recording}))
    columns = {name: np.array([p[name] for p in points]) for name in ("time_s", "voltage_kv", "drop_n", "modelled_n")}
    law = with_unit(write_bounds(row, "drop_n_per_kv2"), "N/kV²")
    alt = f"Drop of force of {short(recording, 60)} over the squared voltage, {law}."
    caption = flow(bold(draft.site.recording(recording)), f": drop of the force, its drift taken off; line: {law}.")
    curve = DropCurve(columns["voltage_kv"], columns["drop_n"], row["drop_n_per_kv2"])
    return Figure(slow_voltage(curve, alt=alt), caption, draft.data(f"slow_voltage_{recording}", columns))


def _tests(draft: Draft, query: Query, found: list[Record]) -> Table:
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]),
                str(r["cycles"]),
                compact(r["peak_kv"]),
                write_bounds(r, "drop_n_per_kv2"),
                significant(r["exponent"], 3),
                significant(r["rest_n"], 3),
                significant(1000 * r["drift_n_per_min"], 2),
                significant(1000 * r["misfit_n"], 2),
            )
        )
        for r in found
    ]
    heads = (
        Head("Recording"), Head("Cycles", "n"), Head("Peak, kV", "n"), Head("Drop over V², N/kV²", "n"), Head("Power of V", "n"),
        Head("Force at rest, N", "n"), Head("Drift, mN/min", "n"), Head("Left over, mN", "n"),
    )  # fmt: skip
    below = "Positive where the tension falls under voltage. 95 % limits by the scatter from cycle to cycle."
    below += tell_warnings(found, "tests")
    return Table("Tests under a slow voltage", heads, tuple(rows), query.shown(), below=below, kind="narrow")
