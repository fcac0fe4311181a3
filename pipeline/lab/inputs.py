"""Recordings' results for the later stages, from the journal where they are new and from the snapshot where not.

`fetch_inputs` is for the inputs of a specimen, which the night sends along with the task; `fetch_results` for those of
a group, which may be all recordings there are: its worker fetches them itself.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pipeline.analyse.inputs import RecordingInput, Stored
from pipeline.lab.checks import ANALYSED
from pipeline.lab.journal import Freshness, read_tables
from pipeline.lab.reader import Reader

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


def split_kinds(text: str | None) -> frozenset[str]:
    """Kinds of results from a text with a comma between two; none where it is empty."""
    return frozenset(text.split(",")) if text else frozenset()


def write_members(file: Path, recordings: Iterable[Included]) -> bool:
    """Writes where the results of a group's recordings are, a line each; whether some are in the published snapshot."""
    published = False
    with file.open("w", encoding="utf-8") as lines:
        for one in recordings:
            published |= one.entry is None
            lines.write(json.dumps([one.recording_id, None if one.entry is None else one.entry.name]) + "\n")
    return published


def read_members(file: Path, journal: Path) -> tuple[Stored, ...]:
    """What `write_members` wrote of recordings whose entries are in this journal."""
    with file.open(encoding="utf-8") as lines:
        found = [json.loads(line) for line in lines]
    return tuple((name, None if entry is None else journal / entry) for name, entry in found)


def fetch_inputs(
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
        about = {row["recording_id"]: row for row in rows if row["status"] in ANALYSED}
        for row in reader.rows("carried", None, "recording_id", published, where=where, ordered=False):
            carried.setdefault(row["recording_id"], []).append(row)
    inputs = []
    for recording in recordings:
        name = recording.recording_id
        if recording.entry is None:
            row, results = about[name], carried.get(name, [])
        else:
            tables = read_tables(recording.entry, ("recordings", "carried"))
            (row,) = tables["recordings"].select(["kind", "metadata", "status", "problem"]).to_pylist()
            results = _choose_rows(tables.get("carried"), only, but)
        damage = (row["problem"] or "damaged") if row["status"] == "damaged" else ""
        inputs.append(RecordingInput(name, row["kind"], row["metadata"], tuple(results), damage))
    return tuple(inputs)


def fetch_results(
    recordings: Sequence[Stored], reader: Reader | None, kinds: Collection[str], *, mention: str | None = None
) -> tuple[RecordingInput, ...]:
    """The results of some `kinds` of recordings, in the order given; those without any are left out.

    Without `mention` nothing else of a recording is fetched. With it only recordings whose metadata mention that key
    are, with their metadata.
    """
    about = (
        _find_mentions(recordings, reader, mention)
        if mention is not None
        else {name: ("", "") for name, _ in recordings}
    )
    results: dict[str, list[dict[str, Any]]] = {}
    published = [name for name, entry in recordings if entry is None and name in about]
    if published and reader is not None:
        wanted = "kind IN ('" + "', '".join(sorted(kinds)) + "')"
        for row in reader.rows("carried", None, "recording_id", published, where=wanted, ordered=False):
            results.setdefault(row["recording_id"], []).append(row)
    for name, entry in recordings:
        if entry is not None and name in about:
            results[name] = _pick_rows(read_tables(entry, ("carried",)).get("carried"), kinds.__contains__)
    return tuple(
        RecordingInput(name, *about[name], tuple(results[name])) for name, _ in recordings if results.get(name)
    )


def _find_mentions(recordings: Sequence[Stored], reader: Reader | None, mention: str) -> dict[str, tuple[str, str]]:
    """Kind and metadata of the recordings whose metadata have a key of that name, by id."""
    key = f'"{mention}":'
    found: dict[str, tuple[str, str]] = {}
    published = [name for name, entry in recordings if entry is None]
    if published and reader is not None:
        where = f"contains(metadata, '{key}') AND status IN {ANALYSED!r}"
        for row in reader.rows(
            "recordings", ("recording_id", "kind", "metadata"), "recording_id", published, where=where
        ):
            found[row["recording_id"]] = (row["kind"], row["metadata"])
    for name, entry in recordings:
        if entry is not None:
            (row,) = read_tables(entry, ("recordings",))["recordings"].select(["kind", "metadata"]).to_pylist()
            if key in (row["metadata"] or ""):
                found[name] = (row["kind"], row["metadata"])
    return found


def _choose_rows(carried: pa.Table | None, only: str, but: str) -> list[dict[str, Any]]:
    return _pick_rows(carried, lambda kind: kind == only if only else kind != but)


def _pick_rows(carried: pa.Table | None, is_wanted: Callable[[str], bool]) -> list[dict[str, Any]]:
    """The rows of some kinds, picked one by one: arrow's own filter would take an array, and with it pandas."""
    if carried is None:
        return []
    kinds = enumerate(carried.column("kind").to_pylist())
    return [row for i, kind in kinds if is_wanted(kind) for row in carried.slice(i, 1).to_pylist()]
