"""The part of a specimen's page about its closed loop: against open loop, its gains, how steady it is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Pair, Row, Section, Table, Text, bold, filled, flow
from reports.figures import sensing as figures
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.words import remark
from schemas.numbers import NBSP, capital, compact, pm, significant

_SQL = """SELECT l.*, r.started_at
FROM loop_responses AS l JOIN recordings AS r USING (recording_id)
WHERE l.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY r.started_at, l.recording_id"""
_OPEN_SQL = """SELECT s.recording_id, s.start_s, s.end_s, s.voltage_kv, s.force_rest_n, s.capacitance_step_pf
FROM step_responses AS s JOIN recordings AS r USING (recording_id)
WHERE r.specimen_id = $specimen AND r.status IN ('ok', 'damaged') AND s.capacitance_step_pf IS NOT NULL
  AND s.recording_id NOT IN (SELECT recording_id FROM loop_responses)
ORDER BY abs(s.capacitance_step_pf - $step), s.recording_id, s.cycle
LIMIT 1"""
_PREVIEW_SQL = """SELECT time_s, (low + high) / 2 AS middle
FROM previews
WHERE recording_id = $recording AND quantity = $quantity AND time_s BETWEEN $first AND $last
ORDER BY time_s"""
_LONGEST_S = 60.0
"""A hold that is compared with open loop; longer ones are for the drift."""


def section(draft: Draft) -> Section | None:
    """Does the loop hold the capacitance, how quickly, and does the force keep its relation?"""
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    proposals = draft.results.rows(
        Query(
            "SELECT * FROM controller_gains WHERE specimen_id = $specimen ORDER BY demand_step_pf",
            {"specimen": draft.item},
        )
    )
    blocks: list[Block | Fold] = []
    tried = [_gains(draft, found, proposal) for proposal in proposals]
    drawn = [f for f in (_compared(draft, found), *tried) if f is not None]
    blocks += [Pair(tuple(drawn[i : i + 2])) for i in range(0, len(drawn), 2)]
    blocks += [Text(flow(bold("Gains."), f" {capital(remark(p['statement']))}.")) for p in proposals]
    table = _table(draft, query, found)
    blocks.append(Fold(f"All {len(found)} closed loops", (table,)) if len(found) > 6 else table)
    return Section("loop", _heading(found), "Closed loop", tuple(blocks))


def _heading(found: Sequence[Record]) -> str:
    followed = [r for r in found if r["relation_drift_percent"] is not None]
    if followed:
        r = followed[-1]
        drift, sd = r["relation_drift_percent"], r["relation_drift_percent_sd"]
        hold = compact(r["hold_s"], 3)
        if abs(drift) > 3 * sd:
            return (
                f"Held at its demand for {hold}{NBSP}s, the force at given capacitance drifts by {pm(drift, sd, '%')}"
            )
        return f"Held at its demand for {hold}{NBSP}s, force and capacitance keep their relation within {significant(2 * sd, 2)}{NBSP}%"
    settled = [r for r in found if r["settling_time_s"] is not None]
    if settled:
        best = min(settled, key=lambda r: r["settling_time_s"])
        return f"The loop settles within {significant(best['settling_time_s'], 2)}{NBSP}s"
    return "The loop does not settle"


def _compared(draft: Draft, found: Sequence[Record]) -> Figure | None:
    """The first closed loop of a common length beside the open-loop step nearest to it."""
    loops = [r for r in found if r["demand_step_pf"] is not None and r["hold_s"] <= _LONGEST_S]
    if not loops:
        return None
    loop = max(loops, key=lambda r: r["hold_s"])
    steps = draft.results.rows(Query(_OPEN_SQL, {"specimen": draft.item, "step": loop["demand_step_pf"]}))
    runs = [_run(draft, loop["recording_id"], loop["start_s"], loop["hold_s"], "closed loop", closed=True)]
    if steps:
        step = steps[0]
        length = step["end_s"] - step["start_s"]
        runs.append(_run(draft, step["recording_id"], step["start_s"], length, "open loop", closed=False))
    drawn = [run for run in runs if run.channels]
    if not drawn:
        return None
    demand = loop["capacitance_rest_pf"] + loop["demand_step_pf"]
    words = (
        f"Closed loop ({compact(loop['proportional_gain'])}{NBSP}V/pF, {compact(loop['integral_gain'])}{NBSP}V/pF/s): up to"
        f" {significant(loop['peak_kv'], 2)}{NBSP}kV at first, {significant(loop['final_kv'], 2)}{NBSP}kV in the end;"
        f" rise {_s(loop['rise_time_s'])}, settled after {_s(loop['settling_time_s'])};"
        f" the force overshoots by {significant(loop['force_overshoot_percent'], 2)}{NBSP}%."
    )
    if steps:
        words += f" Open loop: {significant(steps[0]['voltage_kv'], 2)}{NBSP}kV throughout."
    columns: dict[str, list[object]] = {"run": [], "quantity": [], "time_s": [], "value": []}
    for run in drawn:
        for quantity, channel in run.channels.items():
            columns["run"] += [run.name] * channel.time.size
            columns["quantity"] += [quantity] * channel.time.size
            columns["time_s"] += channel.time.tolist()
            columns["value"] += channel.value.tolist()
    return Figure(
        figures.open_closed(drawn, demand, loop["hold_s"], alt=f"Open against closed loop of {short(draft.item, 40)}. {words}"),
        flow(bold("Open against closed loop."), f" {words} As recorded (middle of the envelope)."),
        draft.data("loop", columns),
    )  # fmt: skip


def _s(value: float | None) -> str:
    return "never" if value is None else f"{significant(value, 2)}{NBSP}s"


def _run(draft: Draft, recording: str, start: float, length: float, name: str, *, closed: bool) -> figures.Run:
    channels = {}
    for quantity in ("voltage", "capacitance", "force"):
        data = draft.results.columns(
            Query(
                _PREVIEW_SQL,
                {"recording": recording, "quantity": quantity, "first": start - 0.1 * length, "last": start + length},
            )
        )
        time, value = data["time_s"].astype(float) - start, data["middle"].astype(float)
        if time.size < 8:
            continue
        if quantity == "force":
            before = time < -0.01 * length
            value = -1e3 * (value - float(np.nanmean(value[before])) if before.any() else value - value[0])
        channels[quantity] = figures.Channel(time, value)
    return figures.Run(name, closed, channels)


def _gains(draft: Draft, found: Sequence[Record], proposal: Record) -> Figure | None:
    step = proposal["demand_step_pf"]
    tried = [
        r
        for r in found
        if r["demand_step_pf"] is not None
        and abs(r["demand_step_pf"] - step) <= 0.02 * abs(step)
        and r["proportional_gain"] is not None
        and r["integral_gain"]
    ]
    # Several loops of one pair differ in their length; the shortest are those of the grid.
    pairs = {(r["proportional_gain"], r["integral_gain"]): r for r in sorted(tried, key=lambda r: -r["hold_s"])}
    rows = []
    for proportional in sorted({p for p, _ in pairs}):
        row = [pairs[key] for key in sorted(pairs) if key[0] == proportional]
        column = {
            n: np.array([np.nan if r[n] is None else r[n] for r in row], dtype=float) for n in row[0] if n in _DRAWN
        }
        rows.append(
            figures.Gains(
                proportional,
                column["integral_gain"],
                column["rise_time_s"],
                column["overshoot_percent"],
                column["force_overshoot_percent"],
                np.isfinite(column["settling_time_s"]),
            )
        )
    if len(rows) < 2:
        return None
    best = None if proposal["recording_id"] is None else (proposal["proportional_gain"], proposal["integral_gain"])
    kept = [pairs[key] for key in sorted(pairs)]
    return Figure(
        figures.gains(rows, best, alt=f"Rise time and overshoot by gains of the controller, {len(pairs)} pairs."),
        flow(
            bold("Gains of the controller."),
            f" {len(pairs)} pairs, a step of {significant(step)}{NBSP}pF. Grey: the goal, 0.5{NBSP}s and 10{NBSP}%. Open: not"
            " settled at the end of the hold. Ring: proposed.",
        ),
        draft.data("gains", {n: [r[n] for r in kept] for n in _DRAWN}),
    )


_DRAWN = (
    "proportional_gain", "integral_gain", "rise_time_s", "overshoot_percent", "force_overshoot_percent", "settling_time_s",
)  # fmt: skip


def _table(draft: Draft, query: Query, found: Sequence[Record]) -> Table:
    rows = tuple(
        Row(
            (
                draft.site.recording(r["recording_id"]), compact(r["proportional_gain"]), compact(r["integral_gain"]),
                significant(r["demand_step_pf"]), significant(r["rise_time_s"], 2), significant(r["overshoot_percent"], 2),
                significant(r["settling_time_s"], 2), significant(_milli(r["error_rms_pf"]), 2), significant(_milli(r["force_step_n"])),
                significant(r["force_overshoot_percent"], 2), significant(r["peak_kv"], 2), significant(r["final_kv"], 2),
                pm(r["relation_drift_percent"], r["relation_drift_percent_sd"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Recording"), Head("Kp, V/pF", "n"), Head("Ki, V/pF/s", "n"), Head("Demand, pF", "n"), Head("Rise, s", "n"),
        Head("Over­shoot, %", "n"), Head("Settled, s", "n"), Head("Error, fF", "n"), Head("Force, mN", "n"),
        Head("Force over­shoot, %", "n"), Head("Peak, kV", "n"), Head("Final, kV", "n"), Head("Drift of the relation, %", "n"),
    )  # fmt: skip
    kept, rows = filled(heads, rows)
    below = (
        "Rise, overshoot and settling (±5 %) of the capacitance on its way to the demand; error: root mean square once settled."
        " Drift: change of the force at given capacitance from 20 s on."
    )
    warned = sorted({r["warnings"] for r in found if r["warnings"]})
    if warned:
        below += " " + " ".join(f"{capital(visible(w))}." for w in warned[:3])
    return Table("Closed loops", kept, rows, query.shown(), below=below, kind="wide")


def _milli(value: float | None) -> float | None:
    return None if value is None else 1e3 * value
