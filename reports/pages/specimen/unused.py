"""The part of a specimen's page about lines of its responses that nothing was fitted to, and why."""

from __future__ import annotations

from reports.blocks import Fold, Head, Row, Section, Table
from reports.names import visible
from reports.pages.draft import Draft
from reports.results import Query
from schemas.numbers import NBSP, capital, compact, counted, digits

_SQL = """WITH counted AS (
    SELECT *, max(stage = 'corrected') OVER (PARTITION BY recording_id, loading) AS divided
    FROM frequency_responses
    WHERE specimen_id = $specimen AND recording_id IS NOT NULL
)
SELECT recording_id, loading, coalesce(nullif(unusable_because, ''), 'not said') AS why, count(*) AS lines,
       min(frequency_hz) AS low_hz, max(frequency_hz) AS high_hz, sum(count(*)) OVER () AS unused
FROM counted
WHERE NOT usable AND stage = CASE WHEN divided THEN 'corrected' ELSE 'measured' END
GROUP BY recording_id, loading, why
ORDER BY loading DESC, recording_id, low_hz"""
_LISTED = 12
"""Rows listed without a fold."""


def section(draft: Draft) -> Section | None:
    """Lines left out by recording and reason; None where every line is used."""
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                draft.site.recording(r["recording_id"]),
                visible(r["loading"] or ""),
                str(r["lines"]),
                _from_to(float(r["low_hz"]), float(r["high_hz"])),
                capital(visible(r["why"])),
            )
        )
        for r in found
    )
    heads = (Head("Recording"), Head("Loading"), Head("Lines", "n"), Head("Frequency, Hz", "n"), Head("Why"))
    table = Table(
        "Lines that are not used, by reason",
        heads,
        rows,
        query.shown(),
        below="Of the corrected response where there is one. They are drawn grey, and neither fits nor errors take them.",
    )
    lines, recordings = int(found[0]["unused"]), len({r["recording_id"] for r in found})
    heading = f"{capital(digits(lines, 'line'))} of {counted(recordings, 'recording')} not used"
    block = table if len(rows) <= _LISTED else Fold(f"Reasons, by recording: {digits(len(rows), 'row')}", (table,))
    return Section("unused", heading, "Not used", (block,))


def _from_to(low: float, high: float) -> str:
    return compact(low) if high - low < 1e-3 * high else f"{compact(low)}{NBSP}to{NBSP}{compact(high)}"
