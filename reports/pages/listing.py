"""Tables of recordings and lifetimes that several pages show."""

from __future__ import annotations

from collections.abc import Sequence

from reports.blocks import Fold, Head, Piece, Row, Table, Text, code, flow, name, tag
from reports.names import short
from reports.results import Query, day
from reports.results import Row as Record
from reports.site import Site
from reports.words import remark
from schemas.numbers import ABSENT, compact, seconds, significant, with_unit


def status(row: Record) -> Piece:
    """Status with its sign."""
    return tag(row["status"] or "unknown")


def problem(text: str | None, limit: int = 400) -> str:
    """A reason on one line."""
    return short(text, limit) if text else ""


def recordings(
    site: Site, found: Sequence[Record], query: Query, caption: str, *, root: str = "../", note: str = ""
) -> Table:
    """Recordings with status and what is wrong with them."""
    rows = tuple(
        Row(
            (
                site.recording(r["recording_id"], root), code(r["protocol"] or ABSENT), day(r["started_at"]),
                seconds(r["duration_s"]), status(r), problem(r["problem"]) or problem(r["notes"], 160),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Recording"),
        Head("Protocol", "word"),
        Head("Measured"),
        Head("Duration", "n"),
        Head("Status"),
        Head("What is wrong or worth knowing", "text"),
    )
    return Table(caption, heads, rows, query.shown(), note)


def taken_out(site: Site, where: str, value: str, root: str = "../") -> Table | None:
    """Who took recordings out or back in, and why."""
    query = Query(
        "SELECT a.recording_id, a.action, a.why, a.author, a.at\n"
        f"FROM annotations AS a JOIN recordings AS r USING (recording_id)\nWHERE {where}\nORDER BY a.at, a.recording_id",
        {"item": value},
    )
    found = site.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                site.recording(r["recording_id"], root),
                r["action"] or ABSENT,
                short(r["why"] or "", 400),
                name(r["author"]),
                day(r["at"]),
            )
        )
        for r in found
    )
    heads = (Head("Recording"), Head("Action"), Head("Why", "text"), Head("By"), Head("On"))
    return Table("Taken out of the analysis, or back in", heads, rows, query.shown())


def files(found: Sequence[Record], summary: str) -> Fold:
    """Source files with their hashes."""
    rows = tuple(
        Row(
            (
                name(r["recording_id"], 60),
                code(short(r["source_path"] or ABSENT, 160)),
                code(r["source_sha256"] or ABSENT),
            )
        )
        for r in found
    )
    return Fold(summary, (Table("Files and their SHA-256", (Head("Recording"), Head("File"), Head("SHA-256")), rows),))


def lifetimes(
    site: Site,
    found: Sequence[Record],
    query: Query,
    caption: str,
    *,
    root: str = "../",
    unit: tuple[float, str] = (1.0, "s"),
) -> Table:
    """Lives, one a row."""
    rows = tuple(
        Row(
            (
                site.specimen(r["specimen_id"], root), name(r["configuration"]), compact(r["voltage_kv"]),
                significant(None if r["lifetime_s"] is None else unit[0] * r["lifetime_s"]), _end(r), ABSENT if r["probability_failed"] is None else f"{r['probability_failed']:.2f}", _place(r), remark(r["warnings"]), site.recording(r["recording_id"], root),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Specimen"), Head("Configuration"), Head("kV", "n"), Head(f"Life, {unit[1]}", "n"), Head("End"), Head("Breakdown?", "n"), Head("Where"),
        Head("Contradictions"), Head("Recording"),
    )  # fmt: skip
    return Table(caption, heads, rows, query.shown())


def _end(r: Record) -> Piece:
    """How the life ended, as far as the record tells."""
    said = "failed" if r["failed"] else flow("alive: ", short(r["censored_because"] or "end of test", 60))
    if r["breakdown_voltage_kv"]:
        said = flow(said, f", breakdown at {with_unit(compact(r['breakdown_voltage_kv']), 'kV')}")
    return flow("undecided, counted as ", said) if r["decided"] is False else said


def _place(r: Record) -> str:
    parts = [p for p in (r["failure_site"], r["failure_region"]) if p and p not in ("none",)]
    return ", ".join(parts) or ABSENT


def nothing(text: str) -> Text:
    """A sentence where a table would be empty."""
    return Text(text, "sub")
