"""What changed since the night before: results that moved, points out of control, run against run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reports.blocks import Block, Fold, Head, Heading, Piece, Row, Section, Table, Text, flow, link, name, tag
from reports.names import short
from reports.pages.index import control
from reports.results import Query, moment
from reports.results import Row as Record
from reports.site import CONTROL, Site
from reports.words import followed
from schemas.mechanisms import plain_name
from schemas.numbers import ABSENT, capital, counted, digits, joined, pm, seconds, significant, whole

_MOVED_SHOWN, _RUNS_SHOWN, _ALARMS_SHOWN = 40, 7, 6
_MOVED = Query(
    'SELECT item_kind, item, quantity, unit, before, before_sd, before_words, "after", after_sd, after_words, moved_sd,\n'
    "       because\nFROM moved"
)
_NIGHTS = Query(
    "SELECT run_id, started_at, seconds, found, ingested, quarantined, damaged, failed, code_changed\n"
    f"FROM nights\nLIMIT {_RUNS_SHOWN}"
)


def section(site: Site) -> Section | None:
    """The part of the index; None before the first night."""
    if not site.runs:
        return None
    blocks: list[Block | Fold] = []
    moved = _moved(site)
    if moved.shown:
        blocks.append(_moved_table(site, moved))
    blocks += _alarms(site)
    if len(site.runs) > 1:
        blocks.append(_nights(site))
    else:
        blocks.append(
            Text("This is the lab’s first run: from the next one on, results that move are named here.", "sub")
        )
    return Section("changed", _heading(site, moved), "What changed", tuple(blocks))


@dataclass(frozen=True)
class _Moved:
    """Results that the last run moved: those that are shown, their number and that of verdicts among them, whose they are."""

    shown: Sequence[Record]
    number: int
    verdicts: int
    items: Sequence[str]


def _moved(site: Site) -> _Moved:
    """Read one by one: another version of the code may move every result of the lab."""
    shown: list[Record] = []
    number = verdicts = 0
    items: dict[str, None] = {}
    for row in site.results.each(_MOVED) if len(site.runs) > 1 else ():
        if number < _MOVED_SHOWN:
            shown.append(row)
        number += 1
        verdicts += row["quantity"] == "verdict"
        items[short(row["item"], 24)] = None
    return _Moved(shown, number, verdicts, list(items))


def _heading(site: Site, moved: _Moved) -> str:
    if len(site.runs) < 2:
        return "Nothing to compare with yet"
    if not moved.shown:
        return "No result moved by more than its uncertainty allows"
    items = moved.items
    named = joined(items) if len(items) <= 4 else joined([*items[:3], f"{len(items) - 3} more"])
    what = counted(moved.number - moved.verdicts, "result") + " moved" if moved.number > moved.verdicts else ""
    judged = f"{counted(moved.verdicts, 'verdict')} changed" if moved.verdicts else ""
    return f"{capital(' and '.join(p for p in (judged, what) if p))} since the run before: {named}"


def _moved_table(site: Site, moved: _Moved) -> Table:
    rows = tuple(
        Row(
            (
                site.specimen(m["item"], "") if m["item_kind"] == "specimen" else name(m["item"]), followed(m["quantity"]), m["unit"] or "",
                _side(m, "before"), _side(m, "after"), significant(m["moved_sd"], 2), short(m["because"] or ABSENT, 120),
            )
        )
        for m in moved.shown
    )  # fmt: skip
    heads = (
        Head("Which"), Head("Quantity"), Head("Unit"), Head("Before", "n"), Head("Now", "n"), Head("Moved by, SD", "n"),
        Head("Because of", "text"),
    )  # fmt: skip
    shown = len(rows)
    note = (
        f"{shown} of {moved.number}"
        if shown < moved.number
        else "by more than twice the uncertainty of both together, or to an uncertainty three times as large"
    )
    return Table("Results that moved since the run before", heads, rows, _MOVED.shown(), note)


def _side(m: Record, side: str) -> Piece:
    words, value, sd = m[f"{side}_words"], m[side], m[f"{side}_sd"]
    if words:
        verdict, _, causes = words.partition(": ")
        named = ", ".join(plain_name(c).lower() for c in causes.split(", ")) if causes else ""
        return flow(tag(verdict), f" {short(named, 60)}" if named else "")
    if value is None:
        return "no longer there"
    if m["quantity"] == "model_order":
        return str(int(value))
    return significant(value, 4) if sd is None else pm(value, sd)


def _alarms(site: Site) -> list[Block | Fold]:
    """Points out of control, in sentences, and where the charts are."""
    if not site.controlled:
        return []
    found = control.alarms(site)
    blocks: list[Block | Fold] = [Heading("Out of control")] if found else []
    blocks += [Text(control.sentence(a)) for a in found[:_ALARMS_SHOWN]]
    more = len(found) - _ALARMS_SHOWN
    text = "No point of the control charts leaves its limits. " if not found else ""
    text += f"{capital(digits(more, 'further point'))} out of control. " if more > 0 else ""
    blocks.append(Text(flow(text, link("Control charts of rigs, batches, operators and nights", CONTROL), "."), "sub"))
    return blocks


def _nights(site: Site) -> Table:
    rows = tuple(
        Row(
            (
                name(r["run_id"]), moment(r["started_at"]), seconds(r["seconds"]), whole(r["found"]), whole(r["ingested"]),
                whole(r["quarantined"]), whole(r["damaged"]), whole(r["failed"]), ABSENT if r["code_changed"] is None else "changed" if r["code_changed"] else "the same",
            )
        )
        for r in site.results.rows(_NIGHTS)
    )  # fmt: skip
    heads = (
        Head("Run"), Head("Started"), Head("Took", "n"), Head("Files found", "n"), Head("Taken in", "n"), Head("Refused", "n"),
        Head("Damaged", "n"), Head("Failed", "n"), Head("Code"),
    )  # fmt: skip
    return Table("Run against run, the latest first", heads, rows, _NIGHTS.shown())
