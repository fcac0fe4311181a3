"""The parts of pages that hold specimens against the requirement of the thesis' chapter 1: a sheet of each, one of a campaign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Figure, Head, Piece, Row, Section, Table, bold, flow
from reports.figures.actuator import Line, force_stroke
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import ABSENT, NBSP, among, bounds, capital, compact, digits, significant, with_unit

_SQL = """SELECT quantity, value, value_lower, value_upper, value_lower_90, value_upper_90, unit, voltage_kv, required, meets,
       multiple, multiplied, note
FROM specifications
WHERE specimen_id = $specimen
ORDER BY list_position(['force', 'stroke', 'slow stroke', 'bandwidth', 'efficiency', 'capacitance', 'current', 'field',
    'pull-in margin'], quantity)"""
_LINE_SQL = """SELECT frequency_hz, stroke_mm, force_n, force_n_lower, force_n_upper, force_n_lower_90, force_n_upper_90
FROM force_strokes
WHERE specimen_id = $specimen
ORDER BY frequency_hz, stroke_mm"""
_CAMPAIGN_SQL = """SELECT *
FROM specifications
WHERE specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $campaign)
ORDER BY specimen_id, quantity"""
_ASKED = (
    "For tremor: suppressing the postural tremor of a hand, 0.4 N and 1 mm at up to 10 Hz (thesis, section 1.3). Layers lie side by"
    " side and add their forces, strips lie behind each other and add their strokes. A film gives force and stroke at once only in"
    " part: the numbers count half of each, where it gives most work, from the lower limit."
)
_OTHER = " The command design answers for other sizes and other requirements."


def of_specimen(draft: Draft) -> Section | None:
    """Force, stroke, bandwidth and efficiency with limits, and how many layers or strips would do."""
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                f"{capital(r['quantity'])}, {r['unit'] or '%'}",
                _value(r),
                _limits(r, "_90"),
                ABSENT if r["required"] is None else compact(r["required"]),
                _meets(r),
                ABSENT if r["multiple"] is None else f"{r['multiple']} {r['multiplied']}",
                r["note"],
            )
        )
        for r in found
    )
    heads = (
        Head("Quantity"), Head("Value (95 %)", "n"), Head("90 %", "n"), Head("For tremor", "n"), Head("Meets it"), Head("Would do"), Head("How it is meant", "text"),
    )  # fmt: skip
    table = Table("Specification sheet", heads, rows, query.shown(), below=_ASKED + _OTHER, kind="wide")
    figure = _figure(draft)
    return Section("requirement", _heading(found), "Requirement", (table,) if figure is None else (figure, table))


def _figure(draft: Draft) -> Figure | None:
    """Force over stroke, a line for each frequency; None where no stiffness is known."""
    points = draft.results.rows(Query(_LINE_SQL, {"specimen": draft.item}))
    if not points:
        return None
    columns = {name: np.array([p[name] for p in points], dtype=float) for name in points[0]}
    lines = []
    for hz in np.unique(columns["frequency_hz"]):
        own = {name: values[columns["frequency_hz"] == hz] for name, values in columns.items()}
        name = with_unit(compact(float(hz), 3), "Hz")
        lines.append(Line(name, own["stroke_mm"], own["force_n"], own["force_n_lower"], own["force_n_upper"]))
    last = lines[-1]
    found = f"{with_unit(significant(float(last.force[0])), 'N')} blocked, {with_unit(significant(float(last.stroke[-1])), 'mm')} free at {last.name}"
    caption = flow(
        bold("Force left at a stroke"),
        f": {found}; with the 95 % band of the fit and the permittivity; marks: most work. The load moves with the film’s own phase; sizes are taken as exact.",
    )
    return Figure(
        force_stroke(lines, alt=f"{short(draft.item, 40)}: {found}."), caption, draft.data("force-stroke", columns)
    )


def _value(row: Record) -> str:
    """Value with its limits; those that round to three digits of the value are left out: a requirement is not known better."""
    value, limits = significant((1.0 if row["unit"] else 100.0) * row["value"]), _limits(row)
    if limits == f"{value}–{value}":
        return value
    return bounds(row["value"], row["value_lower"], row["value_upper"], 1.0 if row["unit"] else 100.0)


def _limits(row: Record, level: str = "") -> str:
    scale = 1.0 if row["unit"] else 100.0
    return "–".join(significant(scale * row[f"value_{end}{level}"]) for end in ("lower", "upper"))


def _meets(row: Record) -> str:
    return ABSENT if row["meets"] is None else "yes" if row["meets"] else "no"


def _heading(found: Sequence[Record]) -> str:
    by = {r["quantity"]: r for r in found}
    parts = []
    for quantity in ("force", "stroke"):
        r = by.get(quantity)
        if r is not None and r["multiple"]:
            thing = r["multiplied"] if r["multiple"] > 1 else r["multiplied"].removesuffix("s")
            parts.append(f"{r['multiple']} {thing} for the {quantity}")
    volts = with_unit(compact(found[0]["voltage_kv"], 2), "kV")
    return (
        f"Against a tremor, at {volts}: {' and '.join(parts)} would do"
        if parts
        else "Against the requirement of a tremor"
    )


def of_campaign(draft: Draft) -> Section | None:
    """All specimens against the requirement, a row each."""
    query = Query(_CAMPAIGN_SQL, {"campaign": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    names = list(dict.fromkeys(r["specimen_id"] for r in found))
    by = {(r["specimen_id"], r["quantity"]): r for r in found}
    rows = []
    for name in names:
        cells: list[Piece] = [
            draft.site.specimen(name),
            compact(next(r["voltage_kv"] for r in found if r["specimen_id"] == name), 2),
        ]
        for quantity in ("force", "stroke", "bandwidth", "efficiency"):
            r = by.get((name, quantity))
            cells.append(ABSENT if r is None else _value(r))
        for quantity in ("force", "stroke"):
            r = by.get((name, quantity))
            cells.append(ABSENT if r is None or r["multiple"] is None else str(r["multiple"]))
        rows.append(Row(tuple(cells)))
    heads = (
        Head("Specimen"), Head("Voltage, kV", "n"), Head("Force, N", "n"), Head(f"Stroke at 10{NBSP}Hz, mm", "n"), Head("Bandwidth, Hz", "n"),
        Head("Efficiency, %", "n"), Head("Layers", "n"), Head("Strips", "n"),
    )  # fmt: skip
    below = f"Values with 95 % limits. {_ASKED}"
    table = Table(
        "Specimens against the requirement of a tremor", heads, tuple(rows), query.shown(), below=below, kind="wide"
    )
    alone = sum(
        bool(by.get((n, "force"), {}).get("meets")) and bool(by.get((n, "stroke"), {}).get("meets")) for n in names
    )
    if alone:
        who = f"{capital(among(alone, len(names), 'specimen'))} {'meets' if alone == 1 else 'meet'}"
    else:
        who = "The one specimen does not meet" if len(names) == 1 else f"None of {digits(len(names), 'specimen')} meets"
    where = f"{who} the requirement of a tremor alone"
    return Section("requirement", where, "Requirement", (table,))
