"""SQL for the recordings and tables that led to no result: found anew at the end of every night, from all that is there.

A result is a row of any table that says what came out, with the recording's id. Results that have none are found by what
the recording carried into the analysis of many (`_BY_SPECIMEN`).
"""

from __future__ import annotations

from collections.abc import Iterator

from schemas.tables import TABLES

_BY_SPECIMEN = {"ForceMapReadings": "force_maps"}
"""Kinds of carried results that show in the rows of their specimen, and in which table."""


def _find_given() -> Iterator[str]:
    """Queries for the ids of recordings that led to something."""
    for table in TABLES.values():
        if "recording_id" in table.names and not table.internal and table.result_where != "false":
            yield f"SELECT recording_id FROM {table.name} WHERE {table.result_where}"
    for kind, name in _BY_SPECIMEN.items():
        yield (
            f"SELECT recording_id FROM carried JOIN recordings USING (recording_id) WHERE carried.kind = '{kind}'"
            f" AND specimen_id IN (SELECT specimen_id FROM {name})"
        )


_FIND = f"""
INSERT INTO without_result (recording_id, source_path, status, what_was_missing)
WITH given AS ({" UNION ".join(_find_given())}),
why AS (SELECT item_id, coalesce(notes, split_part(error, chr(10), 1)) AS text FROM items)
SELECT r.recording_id, r.source_path, r.status,
    CASE WHEN r.status = 'quarantined' THEN coalesce(r.problem, 'no reason is recorded')
    ELSE coalesce(
        nullif(concat_ws('; ', r.problem, nullif(own.text, r.problem)), ''),
        nullif(concat_ws('; ', specimen.text, diagnosis.text), ''),
        concat('its analysis (', concat_ws(' ', r.loading, r.protocol), ') gave no number, and said no reason')
    ) END
FROM recordings AS r
LEFT JOIN why AS own ON own.item_id = concat('recording:', r.source_sha256)
LEFT JOIN why AS specimen ON specimen.item_id = concat('specimen:', r.specimen_id)
LEFT JOIN why AS diagnosis ON diagnosis.item_id = concat('diagnosis:', r.specimen_id)
WHERE r.status = 'quarantined'
    OR (r.status IN ('ok', 'damaged') AND r.recording_id NOT IN (SELECT recording_id FROM given WHERE recording_id IS NOT NULL))
ORDER BY r.source_path, r.recording_id"""
_COUNT = """
UPDATE runs SET without_result = (SELECT count(*) FROM without_result WHERE status <> 'quarantined')
WHERE run_id = (SELECT max(run_id) FROM runs)"""
STATEMENTS = ("DELETE FROM without_result", _FIND, _COUNT)
"""Fill the table `without_result` anew, and book in the last run how many of its rows were not refused."""
