"""The part of a campaign's page about holding the passive part of a self-sensing film, and about its geometry."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Block, Figure, Head, Pair, Row, Section, Table, bold, flow, sub
from reports.figures.sensing import Pairing, constraint, sensitivity_map
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import NBSP, compact, pm, significant

_SQL = """SELECT *
FROM constraint_gains
WHERE campaign = $campaign
ORDER BY free_specimen, constrained_specimen, voltage_kv"""
_MAP_SQL = """SELECT f.specimen_id, f.sensitivity, f.sensitivity_sd,
       g.sensing_mm / g.active_mm AS r,
       (g.total_mm - g.active_mm - g.sensing_mm - g.held_mm) / g.active_mm AS r_d
FROM sensing_fits f JOIN (
    SELECT specimen_id, any_value(TRY_CAST(metadata ->> '$.recording.total_length_mm' AS DOUBLE)) AS total_mm,
           any_value(TRY_CAST(metadata ->> '$.recording.active_length_mm' AS DOUBLE)) AS active_mm,
           any_value(TRY_CAST(metadata ->> '$.recording.sensing_length_mm' AS DOUBLE)) AS sensing_mm,
           coalesce(any_value(TRY_CAST(metadata ->> '$.recording.constrained_length_mm' AS DOUBLE)), 0) AS held_mm
    FROM recordings
    WHERE campaign = $campaign AND specimen_id IS NOT NULL
    GROUP BY specimen_id) AS g USING (specimen_id)
WHERE f.sensing_region = 'separate' AND f.sensitivity IS NOT NULL AND g.total_mm IS NOT NULL
ORDER BY f.specimen_id"""
_CLAIMED = 3.0
"""Factor by which the thesis' constraint raised both outputs from 6 to 10 kV (its figure 5-11)."""


def section(draft: Draft) -> Section | None:
    """Outputs of a held against a free film, and the map of sensitivity over geometry."""
    query = Query(_SQL, {"campaign": draft.item})
    found = draft.results.rows(query)
    drawn: list[Figure] = []
    blocks: list[Block] = []
    heading = "Sensitivity over geometry"
    if found:
        drawn.append(_outputs(draft, found))
        heading = _heading(found)
        blocks.append(_table(query, found))
    place = _map(draft)
    if place is not None:
        drawn.append(place)
    if not drawn:
        return None
    return Section("constraint", heading, "Constraint", (Pair(tuple(drawn)), *blocks))


def _mean(found: Sequence[Record], what: str) -> tuple[float, float]:
    """Mean over the voltages and its standard deviation from their scatter."""
    values = np.array([r[what] for r in found])
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(values.size)) if values.size > 1 else float("nan")


def _heading(found: Sequence[Record]) -> str:
    force, strain = (_mean(found, f"{what}_gain") for what in ("force", "capacitance"))
    expected = significant(found[0]["expected_gain"])
    return (
        f"A held passive part raises the force {significant(force[0])} times and the capacitive strain {significant(strain[0])} times;"
        f" {expected} is expected, the thesis found {compact(_CLAIMED)}"
    )


def _outputs(draft: Draft, found: Sequence[Record]) -> Figure:
    first = (found[0]["free_specimen"], found[0]["constrained_specimen"])
    rows = [r for r in found if (r["free_specimen"], r["constrained_specimen"]) == first]
    columns = {
        n: np.array([r[n] for r in rows], dtype=float)
        for n in rows[0]
        if n.endswith(("_n", "_kv", "_strain", "_gain", "_sd"))
    }
    gain, volts = columns["expected_gain"], columns["voltage_kv"]
    pairings = [
        Pairing(
            volts,
            scale * columns[f"free_{n}"],
            scale * columns[f"constrained_{n}"],
            scale * gain * columns[f"free_{n}"],
            title,
        )
        for n, scale, title in (
            ("force_n", 1e3, "Drop of tension, mN"),
            ("capacitive_strain", 100.0, "Capacitive strain, %"),
        )
    ]
    force, strain = (_mean(rows, f"{what}_gain")[0] for what in ("force", "capacitance"))
    words = f"{short(first[1], 20)} over {short(first[0], 20)}: force {significant(force)}, capacitive strain {significant(strain)} times"
    return Figure(
        constraint(pairings, alt=f"{words}."),
        flow(bold("Held against free."), f" {words}. Line: free times the whole length over that which is not held."),
        draft.data("constraint", columns),
    )


def _map(draft: Draft) -> Figure | None:
    rows = draft.results.rows(Query(_MAP_SQL, {"campaign": draft.item}))
    if not rows:
        return None
    names = [short(r["specimen_id"], 12) for r in rows]
    sensing, rest, measured = (np.array([r[n] for r in rows], dtype=float) for n in ("r", "r_d", "sensitivity"))
    words = "; ".join(f"{n} {significant(abs(float(m)), 2)}" for n, m in zip(names, measured, strict=True))
    told = _tell_most_sensitive(rows)
    return Figure(
        sensitivity_map(names, sensing, rest, np.abs(measured), alt=f"Sensitivity over geometry. {told} Measured: {words}."),
        flow(bold("Sensitivity over geometry."), f" {told} Lines: 1/(R + R", sub("", "d"), "), R of the sensing region and R", sub("", "d"), " of the free rest: change of the capacitive strain per stretch of the active region"
             " (thesis, eq 5.19 to 5.23). Points: specimens with the value found. Held parts count as no length."),
        draft.data("sensitivity-map", {"specimen_id": names, "r": sensing, "r_d": rest, "sensitivity": measured}),
    )  # fmt: skip


def _tell_most_sensitive(rows: Sequence[Record]) -> str:
    """`Most sensitive is H-1, with 0.61 ± 0.02: 1.7 times F-1, the least.` A sentence, also for one specimen."""
    ranked = sorted(rows, key=lambda r: -abs(r["sensitivity"]))
    most, least = ranked[0], ranked[-1]
    value, sd = abs(most["sensitivity"]), most["sensitivity_sd"]
    size = significant(value) if sd is None else pm(value, sd)
    if len(ranked) == 1:
        return f"{short(most['specimen_id'], 20)} has a sensitivity of {size}."
    times = ""
    if least["sensitivity"]:
        ratio = abs(most["sensitivity"] / least["sensitivity"])
        times = f": {significant(ratio, 2)} times {short(least['specimen_id'], 20)}, the least"
    return f"Most sensitive is {short(most['specimen_id'], 20)}, with {size}{times}."


def _table(query: Query, found: Sequence[Record]) -> Table:
    rows = tuple(
        Row(
            (
                f"{short(r['constrained_specimen'], 20)} over {short(r['free_specimen'], 20)}", compact(r["voltage_kv"], 2),
                significant(1e3 * r["free_force_n"]), significant(1e3 * r["constrained_force_n"]),
                pm(r["force_gain"], r["force_gain_sd"]), pm(r["capacitance_gain"], r["capacitance_gain_sd"]),
                significant(r["expected_gain"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Specimens"), Head("Voltage, kV", "n"), Head("Free, mN", "n"), Head("Held, mN", "n"), Head("Force, times", "n"),
        Head("Capacitive strain, times", "n"), Head("Expected", "n"),
    )  # fmt: skip
    below = (
        "± one standard deviation of the steps; the films differ in stiffness and permittivity beside, which is not in it. Expected:"
        f" a{NBSP}film in series whose held part takes no share. Holding raises both outputs alike; a factor of 3 for both would need"
        " two thirds of the length to be held."
    )
    return Table("What holding the passive part adds", heads, rows, query.shown(), below=below, kind="narrow")
