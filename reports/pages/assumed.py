"""What a specimen's or a recording's numbers rest on that nothing says: one line beside the number, and all of it below."""

from __future__ import annotations

from reports.blocks import Block, Fold, Head, Row, Table, Text, bold, flow
from reports.names import short
from reports.results import Query
from reports.site import Site
from schemas.numbers import ABSENT, capital, counted, digits

_TOLD = 4
"""Assumptions that stand in the line itself; the others only in the table."""
_RANK = ("sizes of the film", "channel", "pre-stretch", "clamp", "load-cell", "time zone")
"""Beginnings of the assumptions that move numbers most, which are told first."""


def blocks(site: Site, column: str, item: str) -> tuple[Block | Fold, ...]:
    """The line and the table of the assumptions of one recording (`recording_id`) or specimen (`specimen_id`)."""
    query = Query(
        "SELECT what, value, because, touches, count(DISTINCT recording_id) AS recordings\nFROM assumptions\n"
        f"WHERE {column} = $item\nGROUP BY ALL\nORDER BY what, value, because",
        {"item": item},
    )
    found = site.results.rows(query)
    if not found:
        return ()
    first = sorted(found, key=lambda r: (_rank(r["what"]), r["what"]))
    told = "; ".join(f"{short(r['what'], 60)}: {short(r['value'], 80)}" for r in first[:_TOLD])
    more = len(found) - _TOLD
    below = f"; {counted(more, 'more', 'more')} below" if more > 0 else ""
    line = Text(flow(bold("Assumed."), f" {capital(told)}{below}."), "sub")
    rows = tuple(
        Row(
            (
                capital(short(r["what"], 100)),
                short(r["value"], 160),
                short(r["because"] or ABSENT, 200),
                short(r["touches"] or ABSENT, 160),
                str(r["recordings"]),
            )
        )
        for r in first
    )
    heads = (
        Head("What"),
        Head("Taken as", "text"),
        Head("Because", "text"),
        Head("Touches", "text"),
        Head("Recordings", "n"),
    )
    table = Table(
        "Taken for granted", heads, rows, query.shown(), "what the numbers rest on that nothing in the data says"
    )
    return (line, Fold(f"{capital(digits(len(rows), 'assumption'))}: what, why, and what rests on it", (table,)))


def _rank(what: str) -> int:
    return next((i for i, start in enumerate(_RANK) if what.startswith(start)), len(_RANK))
