"""The parts of pages that hold specimens against the requirement of the thesis' chapter 1: a sheet of each, one of a campaign."""

from __future__ import annotations

from collections.abc import Sequence

from reports.blocks import Head, Piece, Row, Section, Table
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import ABSENT, NBSP, capital, compact, counted, significant, with_unit

_SQL = """SELECT quantity, value, value_lower, value_upper, unit, voltage_kv, required, meets, multiple, multiplied, note
FROM specifications
WHERE specimen_id = $specimen
ORDER BY list_position(['force', 'stroke', 'stroke at rest', 'bandwidth', 'efficiency'], quantity)"""
_CAMPAIGN_SQL = """SELECT *
FROM specifications
WHERE specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $campaign)
ORDER BY specimen_id, quantity"""
_ASKED = (
    "Asked for: suppressing the postural tremor of a hand, 0.4 N and 1 mm at up to 10 Hz (thesis, section 1.3). Layers lie side by"
    " side and add their forces, strips lie behind each other and add their strokes. A film gives force and stroke at once only in"
    " part: the numbers count half of each, where it gives most work, from the lower limit."
)


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
                ABSENT if r["required"] is None else compact(r["required"]),
                _meets(r),
                ABSENT if r["multiple"] is None else f"{r['multiple']} {r['multiplied']}",
                r["note"],
            )
        )
        for r in found
    )
    heads = (
        Head("Quantity"), Head("Value (95 %)", "n"), Head("Asked for", "n"), Head("Meets it"), Head("Would do"), Head("How it is meant", "text"),
    )  # fmt: skip
    table = Table("Specification sheet", heads, rows, query.shown(), below=_ASKED, kind="wide")
    return Section("requirement", _heading(found), "Requirement", (table,))


def _value(row: Record) -> str:
    """Value with its limits to three digits: a requirement is not known better. Limits that round to the value are left out."""
    scale = 1.0 if row["unit"] else 100.0
    value, low, high = (significant(scale * row[f"value{end}"]) for end in ("", "_lower", "_upper"))
    return value if low == high else f"{value} ({low}–{high})"


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
    where = f"{capital(counted(alone, 'specimen')) if alone else 'No specimen'} of {len(names)} meets the requirement of a tremor alone"
    return Section("requirement", where, "Requirement", (table,))
