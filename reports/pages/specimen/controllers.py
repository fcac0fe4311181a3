"""The part of a specimen's page about controllers designed on its model, beside the gains that the thesis prints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Figure, Head, Row, Section, Table, bold, equation, flow
from reports.figures.controllers import Course, controllers
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import ABSENT, NBSP, capital, compact, significant, with_unit

_SQL = """SELECT *
FROM controller_designs
WHERE specimen_id = $specimen
ORDER BY list_position(['printed', 'gentle', 'quick'], goal),
    list_position(['PI, thesis', 'PI, shaped', 'film inverse and PI', 'predictive'], controller)"""
_COURSE_SQL = """SELECT *
FROM controller_courses
WHERE specimen_id = $specimen AND time_s > 0 AND controller IN ('PI, thesis', 'film inverse and PI')
ORDER BY list_position(['printed', 'gentle', 'quick'], goal), controller, time_s"""
_GOALS = {"printed": "as printed", "gentle": "gentle", "quick": "quick"}
_DRAWN = {"printed": "thesis’ gains", "gentle": "inverse, gentle", "quick": "inverse, quick"}


def section(draft: Draft) -> Section | None:
    """What each controller would do, with limits over the films that the fit leaves possible."""
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    blocks = [b for b in (_figure(draft, found), _table(query, found)) if b is not None]
    return Section("controllers", _heading(found), "Controllers", tuple(blocks))


def _heading(found: Sequence[Record]) -> str:
    by = {(r["goal"], r["controller"]): r for r in found}
    best, printed = by.get(("gentle", "film inverse and PI")), by.get(("printed", "PI, thesis"))
    if best is None or printed is None or best["settling_time_s"] is None:
        return "Controllers designed on the model"
    slow = printed["settling_time_s"]
    beside = "do not settle" if slow is None else f"take {with_unit(significant(slow, 2), 's')}"
    return (
        f"Designed on the model, a controller settles in {with_unit(significant(best['settling_time_s'], 2), 's')} while the"
        f" force overshoots by {significant(best['force_overshoot_percent'], 2)}{NBSP}%; the printed gains {beside}"
    )


def _figure(draft: Draft, found: Sequence[Record]) -> Figure | None:
    points = draft.results.rows(Query(_COURSE_SQL, {"specimen": draft.item}))
    if not points:
        return None
    courses = []
    for goal in dict.fromkeys(p["goal"] for p in points):
        own = [p for p in points if p["goal"] == goal]
        column = {n: np.array([p[n] for p in own], dtype=float) for n in own[0] if n not in _TEXTS}
        courses.append(
            Course(
                _DRAWN[goal],
                column["time_s"],
                column["voltage_kv"],
                column["capacitance_change_pf"],
                np.stack([column["capacitance_change_pf_lower"], column["capacitance_change_pf_upper"]]),
                1e3 * column["force_drop_n"],
                1e3 * np.stack([column["force_drop_n_lower"], column["force_drop_n_upper"]]),
            )
        )
    demand = found[0]["demand_step_pf"]
    words = (
        "To be quick in capacitance the force has to overshoot, for the film relaxes. Gentle: as quick as an overshoot of the force"
        f" by 10{NBSP}% allows. Quick: a rise within 0.5{NBSP}s, the thesis’ goal, with the least overshoot of the force."
        " Bands: 95 % of the films that the fit leaves possible."
    )
    alt = f"Voltage, capacitance and force of {short(draft.item, 40)} after a step of {significant(demand, 2)} pF. {words}"
    columns = {name: [p[name] for p in points] for name in points[0]}
    return Figure(
        controllers(courses, demand, alt=alt),
        flow(bold("A step of the demand."), f" {words}"),
        draft.data("controllers", columns),
    )


_TEXTS = ("specimen_id", "goal", "controller")


def _table(query: Query, found: Sequence[Record]) -> Table:
    rows = tuple(
        Row(
            (
                _GOALS[r["goal"]], r["controller"], _gains(r), compact(r["phase_margin_deg"], 2),
                compact(r["gain_margin"], 2), _limited(r, "rise_time_s"), _limited(r, "settling_time_s"),
                _limited(r, "overshoot_percent"), _limited(r, "force_overshoot_percent"), _limited(r, "peak_kv"),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Goal"), Head("Controller"), Head("Kp, V/pF; Ki, V/pF/s", "n"), Head("Phase margin, °", "n"), Head("Gain margin", "n"),
        Head("Rise, s", "n"), Head("Settled, s", "n"), Head("Over­shoot, %", "n"), Head("Force over­shoot, %", "n"), Head("Peak, kV", "n"),
    )  # fmt: skip
    below = flow(
        f"A step of {significant(found[0]['demand_step_pf'], 2)}{NBSP}pF, simulated with the film as fitted; in brackets 95 % limits"
        " over the films that the fit leaves possible, without noise. Margins are those that 95 % of these keep. Designed gains are"
        " those of a square-root drive (",
        equation("V² = u V_largest"),
        f"). Predictive is the ceiling: it plans at each decision. {capital(found[0]['note'] or '')}.",
    )
    return Table("Controllers designed on the model", heads, rows, query.shown(), below=below, kind="wide")


def _gains(row: Record) -> str:
    if row["proportional_gain"] is None:
        return ABSENT
    return f"{significant(row['proportional_gain'])}; {significant(row['integral_gain'])}"


def _limited(row: Record, name: str) -> str:
    """Value with its limits; an upper one that more than 2.5 % of the films never reach is open."""
    value = row[name]
    if value is None:
        return "never"
    low, high = row[f"{name}_lower"], row[f"{name}_upper"]
    told = f"{significant(low, 2)}–{'∞' if high is None else significant(high, 2)}"
    middle = significant(value, 2)
    return middle if told == f"{middle}–{middle}" else f"{middle} ({told})"
