"""The parts of recording and specimen pages about calibrations of a rig: what a tap or known weights gave."""

from __future__ import annotations

from collections.abc import Sequence

from reports.blocks import Head, Row, Section, Table, flow, link
from reports.figures.curves import rig
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.site import CONTROL, stated_rig
from reports.words import followed, remark
from schemas.numbers import ABSENT, capital, pm, significant, with_unit

_SQL = """SELECT c.recording_id, c.quantity, c.unit, c."value", c.sd, c.repeats, c.warnings, r.started_at
FROM calibrations AS c JOIN recordings AS r USING (recording_id)
WHERE {where} AND r.status IN ('ok', 'damaged', 'excluded')
ORDER BY r.started_at, c.recording_id, c.quantity"""


def of_recording(draft: Draft) -> Section | None:
    """What this calibration gave, beside what the rig file lets expect."""
    return _section(draft, Query(_SQL.format(where="c.recording_id = $item"), {"item": draft.item}))


def of_specimen(draft: Draft) -> Section | None:
    """All calibrations that were made with this clamp."""
    return _section(draft, Query(_SQL.format(where="r.specimen_id = $item"), {"item": draft.item}))


def finding(found: Sequence[Record]) -> str:
    """`the clamp alone rings at 52.01 Hz`, of the last calibration; empty where there is none."""
    parts = []
    for quantity, words in (
        ("clamp_frequency_hz", "the clamp alone rings at"),
        ("force_gain", "the force channel reads"),
    ):
        last = [r for r in found if r["quantity"] == quantity]
        if last:
            ending = " times the true force" if quantity == "force_gain" else ""
            parts.append(f"{words} {with_unit(significant(last[-1]['value'], 4), last[-1]['unit'] or '')}{ending}")
    return "; ".join(parts)


def load(draft: Draft) -> list[Record]:
    """The calibrations made with a clamp that is kept as a specimen."""
    return draft.results.rows(Query(_SQL.format(where="r.specimen_id = $item"), {"item": draft.item}))


def _section(draft: Draft, query: Query) -> Section | None:
    found = draft.results.rows(query)
    if not found:
        return None
    expected = _expected(draft, found)
    rows = tuple(
        Row(
            (
                draft.site.recording(r["recording_id"]), capital(followed(r["quantity"])), r["unit"] or "", pm(r["value"], r["sd"]),
                expected.get(r["quantity"], ABSENT), str(r["repeats"] or ABSENT), remark(r["warnings"]),
            )
        )
        for r in found[-200:]
    )  # fmt: skip
    heads = (
        Head("Recording"), Head("Quantity"), Head("Unit"), Head("Found", "n"), Head("By the rig file", "n"), Head("Taps or levels", "n"),
        Head("What limits it", "text"),
    )  # fmt: skip
    charts = link("Control charts", f"../{CONTROL}") if draft.site.controlled else ""
    below = flow("Sharpens the rig’s constants for what is recorded after it. ", charts)
    table = Table("Calibration of the rig", heads, rows, query.shown(), below=below, kind="wide")
    return Section("calibration", capital(finding(found)) or "Calibration", "Calibration", (table,))


def _expected(draft: Draft, found: Sequence[Record]) -> dict[str, str]:
    """What the rig file of the last calibration says."""
    stated = stated_rig(
        draft.results.rows(
            Query(
                "SELECT loading, metadata FROM recordings WHERE recording_id = $item",
                {"item": found[-1]["recording_id"]},
            )
        )
    )
    constants = rig({}, stated)
    known = {"force_gain": "1", "force_offset_n": "0"}
    if constants is not None:
        known["clamp_frequency_hz"] = significant(constants.resonance_hz)
    return known
