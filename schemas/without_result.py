"""SQL for the recordings and tables that led to no result: found anew at the end of every night, from all that is there.

A result is a row of any table that says what came out, with the recording's id. Results that have none are found by what
the recording carried into the analysis of many (`_BY_SPECIMEN`). A recording that has a result and cannot be asked by the
diagnosis, because a key is missing that its protocol needs (`schemas.protocols.NEEDS`), is told as well.
"""

from __future__ import annotations

from collections.abc import Iterator

from schemas.protocols import NEEDS, tell_needed
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


def _list_needs() -> Iterator[str]:
    """Rows of protocol, loading, key and the channel that stands instead."""
    for (protocol, loading), need in NEEDS.items():
        yield from (f"('{protocol}', '{loading}', '{key}', '{need.unless}')" for key in need.keys)


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
_FIND_NEEDY = f"""
INSERT INTO without_result (recording_id, source_path, status, what_was_missing)
WITH needs(protocol, loading, key, "unless") AS (VALUES {", ".join(_list_needs())}),
lacks AS (
    SELECT r.recording_id, r.source_path, r.status, string_agg(key, ' and ' ORDER BY key) AS keys
    FROM recordings AS r JOIN needs USING (protocol, loading)
    WHERE r.status IN ('ok', 'damaged') AND r.kind = 'recording'
        AND json_extract_string(r.metadata, concat('$.recording.', key)) IS NULL
        AND NOT EXISTS (SELECT 1 FROM previews AS p WHERE p.recording_id = r.recording_id AND p.quantity = "unless")
    GROUP BY ALL
)
SELECT recording_id, source_path, status, format('{tell_needed("{0}")}', keys)
FROM lacks
WHERE recording_id NOT IN (SELECT recording_id FROM without_result WHERE recording_id IS NOT NULL)
ORDER BY source_path, recording_id"""
_COUNT = """
UPDATE runs SET without_result = (SELECT count(*) FROM without_result WHERE status <> 'quarantined')
WHERE run_id = (SELECT max(run_id) FROM runs)"""
STATEMENTS = ("DELETE FROM without_result", _FIND, _FIND_NEEDY, _COUNT)
"""Fill the table `without_result` anew, and book in the last run how many of its rows were not refused."""
