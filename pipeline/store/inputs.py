"""Recordings' results for the later stages, from the journal where they are new and from the snapshot where not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.analyse.inputs import RecordingInput
from pipeline.store.journal import Freshness, read_tables
from pipeline.store.manifest import Reader

if TYPE_CHECKING:
    import pyarrow as pa


@dataclass(frozen=True)
class Included:
    """A recording that takes part in the analysis.

    `kinds` are the kinds of its carried results, `made_from` what they were made from, `entry` its journal file, None
    where its results are in the published snapshot.
    """

    recording_id: str
    specimen_id: str | None
    rig_id: str | None
    kinds: frozenset[str]
    made_from: Freshness
    entry: Path | None = None


def fetch(
    recordings: Sequence[Included], reader: Reader | None, *, only: str = "", but: str = ""
) -> tuple[RecordingInput, ...]:
    """The inputs of recordings, in the order given. `reader` may be None where nothing has been published.

    `only` one kind of carried results, or all `but` one: the others are not even read.
    """
    where = f"kind = '{only}'" if only else f"kind <> '{but}'"
    published = [r.recording_id for r in recordings if r.entry is None]
    about: dict[str, dict[str, Any]] = {}
    carried: dict[str, list[dict[str, Any]]] = {}
    if published and reader is not None:
        rows = reader.rows(
            "recordings", ("recording_id", "kind", "metadata", "status", "problem"), "recording_id", published
        )
        about = {row["recording_id"]: row for row in rows if row["status"] in ("ok", "damaged", "excluded")}
        for row in reader.rows("carried", None, "recording_id", published, where=where):
            carried.setdefault(row["recording_id"], []).append(row)
    inputs = []
    for recording in recordings:
        name = recording.recording_id
        if recording.entry is None:
            row, results = about[name], carried.get(name, [])
        else:
            tables = read_tables(recording.entry, ("recordings", "carried"))
            (row,) = tables["recordings"].select(["kind", "metadata", "status", "problem"]).to_pylist()
            results = _rows(tables.get("carried"), only, but)
        damage = (row["problem"] or "damaged") if row["status"] == "damaged" else ""
        inputs.append(RecordingInput(name, row["kind"], row["metadata"], tuple(results), damage))
    return tuple(inputs)


def _rows(carried: pa.Table | None, only: str, but: str) -> list[dict[str, Any]]:
    if carried is None:
        return []
    import pyarrow as pa

    kinds = carried.column("kind").to_pylist()
    wanted = pa.array([kind == only if only else kind != but for kind in kinds], pa.bool_())
    rows: list[dict[str, Any]] = carried.filter(wanted).to_pylist()
    return rows
