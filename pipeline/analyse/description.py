"""What the table `recordings` says of a recording, of a table that stands instead of some, and of a refused file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

from schemas.metadata import RECORDING_ID, RecordingMetadata, TableMetadata
from schemas.recording import Recording
from schemas.tables import TABLES
from schemas.version import software_version

if TYPE_CHECKING:
    import pyarrow as pa

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DESCRIPTION = (
    "recording_id",
    "campaign",
    "specimen_id",
    "material",
    "configuration",
    "protocol",
    "loading",
    "rig_id",
    "operator",
    "started_at",
)


def recording_row(recording: Recording) -> dict[str, Any]:
    """What `recordings` says about a recording, its status and problems included."""
    return {
        **_described(recording.metadata),
        "rig_id": recording.metadata.rig_id or recording.rig.rig_id,
        "duration_s": recording.duration_s,
        "sample_count": recording.sample_count,
        "status": recording.status,
        "problem": join_texts(recording.problems),
        "notes": join_texts(recording.notes),
        "kind": "recording",
        "metadata": as_json({"recording": recording.metadata.to_text(), "rig": recording.rig.to_text()}),
    }


def table_row(about: TableMetadata, kind: str, problems: Sequence[str], notes: Sequence[str]) -> dict[str, Any]:
    """What `recordings` says about a table that stands instead of recordings."""
    return {
        **_described(about),
        "status": "damaged" if problems else "ok",
        "problem": join_texts(problems),
        "notes": join_texts(notes),
        "kind": kind,
        "metadata": as_json({"recording": about.to_text()}),
    }


def refused_row(given: Mapping[str, Any], problem: str, kind: str) -> dict[str, Any]:
    """What `recordings` says about a refused file: of its metadata whatever is plain text, and the reason."""
    row: dict[str, Any] = {
        key: text
        for key in _DESCRIPTION
        if key != "started_at" and (text := str(given.get(key, "")).strip()) and len(text) <= 200
    }
    if not RECORDING_ID.fullmatch(row.get("recording_id", "")):
        row.pop("recording_id", None)
    return {**row, "status": "quarantined", "problem": problem, "kind": kind}


def recordings_table(rows: Sequence[Mapping[str, Any]]) -> pa.Table:
    """Rows of `recordings`, stamped with the version that read them."""
    return TABLES["recordings"].rows({"software_version": software_version(), **row} for row in rows)


def recordings_rows(table: pa.Table) -> list[dict[str, Any]]:
    """Rows of `recordings` as dictionaries. Times come by whole microseconds: arrow's own way imports pandas."""
    import pyarrow as pa

    times = [f.name for f in table.schema if pa.types.is_timestamp(f.type)]
    whole = {name: table.column(name).cast(pa.int64()).to_pylist() for name in times}
    rows: list[dict[str, Any]] = table.drop_columns(times).to_pylist()
    for i, row in enumerate(rows):
        for name in times:
            since = whole[name][i]
            row[name] = None if since is None else _EPOCH + timedelta(microseconds=since)
    return rows


def join_texts(texts: Sequence[str]) -> str | None:
    """Several problems or notes as one text; NULL for none."""
    return "; ".join(texts) or None


def as_json(value: Any) -> str:
    return json.dumps(value, sort_keys=True, ensure_ascii=False)


def _described(about: RecordingMetadata | TableMetadata) -> dict[str, Any]:
    return {key: getattr(about, key) for key in _DESCRIPTION}
