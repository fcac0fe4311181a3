"""The part of a specimen's page about creep: how the film gives way under a load, what comes back, and its retardation times."""

from __future__ import annotations

import json

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Row, Section, Table, bold, flow
from reports.figures.creep import HeldCurve, creep
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query, tell_warnings, write_bounds
from reports.results import Row as Record
from schemas.numbers import ABSENT, compact, digits, percent, pm, significant, with_unit

_TESTS_SQL = """SELECT t.*
FROM creep_tests AS t JOIN recordings AS r USING (recording_id)
WHERE t.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY r.started_at, t.recording_id"""
_FITS_SQL = """SELECT f.*
FROM creep_fits AS f JOIN recordings AS r USING (recording_id)
WHERE f.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY r.started_at, f.recording_id, f.model_order"""
_CURVE_SQL = """SELECT hold, time_s, since_s, load_n, displacement_mm, modelled_mm
FROM creep_curves
WHERE recording_id = $recording AND usable
ORDER BY time_s"""
_SHOWN = 4
"""Tests that are drawn."""


def of_specimen(draft: Draft) -> Section | None:
    """All creep tests of a specimen, the first ones drawn."""
    tests, fits = Query(_TESTS_SQL, {"specimen": draft.item}), Query(_FITS_SQL, {"specimen": draft.item})
    found, orders = draft.results.rows(tests), draft.results.rows(fits)
    if not found:
        return None
    blocks: list[Block | Fold] = [block for row in found[:_SHOWN] for block in _draw(draft, row)]
    return Section(
        "creep", finding(found[0]), "Creep", (*blocks, _tests(draft, tests, found), _orders(draft, fits, orders))
    )


def finding(row: Record) -> str:
    """`Under 0.5 N the film gives way by 1.2 mm in 600 s; 97 % of it comes back`."""
    text = (
        f"Under {with_unit(significant(row['load_n'], 3), 'N')} the film gives way by "
        f"{with_unit(significant(row['end_mm'], 3), 'mm')} in {with_unit(compact(row['hold_s']), 's')}"
    )
    share = row["recovered_share"]
    return text if share is None else f"{text}; {percent(share)} of it comes back"


def _draw(draft: Draft, row: Record) -> list[Block]:
    recording = row["recording_id"]
    data = draft.results.columns(Query(_CURVE_SQL, {"recording": recording}))
    if not data["hold"].size:
        return []
    holds, load = data["hold"].astype(int), data["load_n"].astype(float)
    loaded = np.abs(load) > 0.02 * np.abs(load).max()
    rests = bool(~loaded[holds == holds.min()].any())
    rest = float(np.mean(data["modelled_mm"][holds == 0].astype(float))) if rests else 0.0
    curves = []
    for hold in np.unique(holds):
        rows = (holds == hold) & (data["since_s"].astype(float) > 0)
        if (rests and hold == 0) or rows.sum() < 2:
            continue
        level = float(np.mean(load[rows]))
        curves.append(
            HeldCurve(
                f"under {significant(level, 2)} N" if loaded[rows].any() else "load off",
                data["since_s"][rows].astype(float),
                data["displacement_mm"][rows].astype(float) - rest,
                data["modelled_mm"][rows].astype(float) - rest,
            )
        )
    if not curves:
        return []
    off = np.concatenate([c.measured - c.modelled for c in curves])
    misses = with_unit(significant(1e3 * float(np.sqrt(np.mean(off**2))), 2), "µm")
    alt = f"Displacement of {short(recording, 60)} after each change of the load; the model is off by {misses}, root mean square."
    caption = flow(
        bold(draft.site.recording(recording)),
        f": means over windows of time after each change of the load; line: {digits(row['model_order'], 'retardation time')}, off by {misses} (root mean square).",
    )
    return [Figure(creep(tuple(curves), alt=alt), caption, draft.data(f"creep_{recording}", data))]


def _tests(draft: Draft, query: Query, found: list[Record]) -> Table:
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]),
                pm(r["load_n"], r["load_n_sd"], "N"),
                _times(r),
                write_bounds(r, "elastic_mm"),
                write_bounds(r, "end_mm"),
                write_bounds(r, "compliance_mm_per_n"),
                write_bounds(r, "left_mm"),
                write_bounds(r, "recovered_share"),
                write_bounds(r, "drift_mm_per_h"),
            )
        )
        for r in found
    ]
    heads = (
        Head("Recording"), Head("Load", "n"), Head("On, off, s", "n"), Head("At once, mm", "n"), Head("At the end, mm", "n"),
        Head("Compliance, mm/N", "n"), Head("Left, mm", "n"), Head("Share that came back", "n"), Head("Drift, mm/h", "n"),
    )  # fmt: skip
    below = (
        "Values with their 95 % intervals. What is left is read off the record; its interval knows noise and wander of the"
        " displacement, and holds both readings of a constant drift: none, and the one that the fit finds."
    )
    below += tell_warnings(found, "tests")
    return Table("Creep and recovery", heads, tuple(rows), query.shown(), below=below, kind="narrow")


def _times(row: Record) -> str:
    off = "not taken off" if row["recovery_s"] is None else compact(row["recovery_s"])
    return f"{compact(row['hold_s'])}, {off}"


def _orders(draft: Draft, query: Query, found: list[Record]) -> Table:
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]),
                f"{r['model_order']}{' ✓' if r['selected'] else ''}",
                ABSENT if r["p_value"] is None else significant(r["p_value"], 2),
                significant(r["reduced_chi2"], 3),
                pm(r["instant_mm_per_n"], r["instant_mm_per_n_sd"]),
                _entries(r["retardations"], ("compliance_mm_per_n", "mm/N"), ("time_s", "s")),
                ABSENT if r["k0_n_per_mm"] is None else pm(r["k0_n_per_mm"], r["k0_n_per_mm_sd"]),
                _entries(r["arms"], ("k_n_per_mm", "N/mm"), ("tau_s", "s")),
            ),
            "sel" if r["selected"] else "",
        )
        for r in found
    ]
    heads = (
        Head("Recording"), Head("Order"), Head("p, no more", "n"), Head("χ²/ν", "n"), Head("At once, mm/N", "n"),
        Head("Retardations"), Head("k0, N/mm", "n"), Head("Arms of the same film"),
    )  # fmt: skip
    below = (
        "The least order is taken that a further retardation time does not improve (p above 0.01). Retardations and arms are"
        " one film in two descriptions: Kelvin-Voigt elements in series, Maxwell arms in parallel. ± is one standard deviation."
    )
    return Table("Retardation times", heads, tuple(rows), query.shown(), below=below, kind="narrow")


def _entries(text: str | None, *keys: tuple[str, str]) -> str:
    parts = []
    for entry in json.loads(text or "[]"):
        parts.append(" at ".join(pm(entry[key], entry[f"{key}_sd"], unit) for key, unit in keys))
    return visible("; ".join(parts)) or ABSENT
