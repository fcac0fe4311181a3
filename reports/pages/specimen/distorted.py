"""The parts of specimen and recording pages about lines that a linear system would leave empty."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.blocks import Figure, Fold, Head, Row, Section, Table, bold, filled, flow, name
from reports.figures.steps import Level, distortion
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import capital, scaled, significant

_HEADING = "Lines that a linear system would leave empty"
_CLEAR = 4.0
"""Times the median of the noise from which a distortion is called one."""
_LISTED = 12
"""Recordings listed without a fold."""
_SUMMARY_SQL = """SELECT d.recording_id, d.unit, max(d.level) FILTER (d.kind = 'even') AS even, max(d.level) FILTER (d.kind = 'odd') AS odd,
       median(d.level) FILTER (d.kind = 'noise') AS noise, greatest(even, odd) / nullif(noise, 0) AS ratio
FROM distortions AS d JOIN recordings AS r USING (recording_id)
WHERE r.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
GROUP BY d.recording_id, d.unit
ORDER BY ratio DESC NULLS LAST, d.recording_id"""


def of_recording(draft: Draft) -> Section | None:
    """The levels of one recording by kind."""
    figure = _figure(draft, draft.item, flow(bold("Distortions.")))
    return None if figure is None else Section("distortions", _HEADING, "Distortions", (figure,))


def of_specimen(draft: Draft) -> Section | None:
    """Levels of all recordings; the one in which they stand out most is drawn."""
    query = Query(_SUMMARY_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    table = _table(draft, query, found)
    strongest = found[0]
    if strongest["ratio"] is None:
        return Section("distortions", "Distortions", "Distortions", (table,))
    heading = f"No line left empty rises more than {_CLEAR:g} times above the noise"
    if strongest["ratio"] > _CLEAR:
        kind = "even" if (strongest["even"] or 0.0) >= (strongest["odd"] or 0.0) else "odd"
        heading = f"{capital(kind)} distortion rises {significant(strongest['ratio'], 2)} times above the noise"
    figure = _figure(
        draft,
        strongest["recording_id"],
        flow(bold("Where it stands out most:"), " ", name(strongest["recording_id"], 60), "."),
    )
    return Section("distortions", heading, "Distortions", (figure, table) if figure else (table,))


def _figure(draft: Draft, recording: str, caption: str) -> Figure | None:
    data = draft.results.columns(
        Query(
            "SELECT kind, frequency_hz, level, unit FROM distortions WHERE recording_id = $recording ORDER BY kind, frequency_hz",
            {"recording": recording},
        )
    )
    level = data["level"].astype(float)
    if not np.any(level > 0):
        return None
    factor, unit = scaled(visible(str(data["unit"][0] or "")), float(np.nanmax(level)))
    kinds = np.array([str(k) for k in data["kind"]])
    levels = [
        Level(kind, data["frequency_hz"][kinds == kind].astype(float), factor * level[kinds == kind])
        for kind in dict.fromkeys(kinds.tolist())
    ]
    words = "; ".join(
        f"{v.kind} median {significant(float(np.nanmedian(v.level)), 2)}, highest {significant(float(np.nanmax(v.level)), 2)} {unit}".strip()
        for v in levels
    )
    alt = f"Levels at lines left empty in {short(recording, 60)}. {words}."
    return Figure(
        distortion(levels, unit, alt=alt), flow(caption, f" {capital(words)}."), draft.data("distortions", data)
    )


def _table(draft: Draft, query: Query, found: Sequence[Record]) -> Table | Fold:
    """A row per recording, those in which lines stand out most first; folded where there are many."""
    largest = max((r[k] for r in found for k in ("even", "odd", "noise") if r[k] is not None), default=0.0)
    factor, unit = scaled(visible(found[0]["unit"] or ""), largest)
    rows = [
        Row(
            (
                draft.site.recording(r["recording_id"]),
                *(significant(None if r[k] is None else factor * r[k], 2) for k in ("even", "odd", "noise")),
                significant(r["ratio"], 2),
            )
        )
        for r in found
    ]
    heads = (
        Head("Recording"), Head(f"Even, highest, {unit}", "n"), Head(f"Odd, highest, {unit}", "n"),
        Head(f"Noise, median, {unit}", "n"), Head("Highest over the noise", "n"),
    )  # fmt: skip
    caption = "Levels at lines that a linear film would leave empty, the strongest first"
    table = Table(caption, *filled(heads, rows), query.shown(), kind="narrow")
    return table if len(rows) <= _LISTED else Fold(f"Levels of all {len(rows)} recordings", (table,))
