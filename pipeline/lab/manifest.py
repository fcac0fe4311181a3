"""What the lab knows before a night: items and what they were made from, recordings, raw files as last seen.

Read from the published snapshot. An older release's database may lack tables and columns; they read as empty.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pipeline.lab.journal import Freshness
from pipeline.lab.lab import Lab
from pipeline.lab.reader import Reader


@dataclass(frozen=True, slots=True)
class BookedItem:
    """An item of an earlier night."""

    item_id: str
    stage: str
    freshness: Freshness
    outcome: str
    error: str | None


@dataclass(frozen=True, slots=True)
class KnownRecording:
    """A row of `recordings`, as far as the plan needs it."""

    source_path: str
    source_sha256: str | None
    recording_id: str | None
    specimen_id: str | None
    protocol: str | None
    rig_id: str | None
    status: str
    problem: str | None
    samples_path: str | None
    source_present: bool | None
    run_id: str | None


@dataclass(frozen=True, slots=True)
class SeenFile:
    """A raw file as it was when it was hashed."""

    size: int
    mtime_ns: int
    inode: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """Everything that is known, for a look at the whole of it."""

    items: Mapping[str, BookedItem] = field(default_factory=dict)
    recordings: Sequence[KnownRecording] = ()
    files: Mapping[str, SeenFile] = field(default_factory=dict)


def load(lab: Lab) -> Manifest:
    """The manifest of a lab; empty where nothing has been published. Raises `LabError` for an unreadable database."""
    if not lab.database.exists():
        return Manifest()
    with Reader(lab.database) as reader:
        items = {
            row["item_id"]: BookedItem(
                row["item_id"],
                row["stage"],
                Freshness(row["input_hash"], row["code_version"], row["settings_hash"]),
                row["outcome"],
                row["error"],
            )
            for row in _shared(reader.each("items"), "stage", "code_version", "settings_hash", "outcome")
        }
        known = reader.each("recordings", tuple(KnownRecording.__dataclass_fields__))
        recordings = tuple(
            KnownRecording(**row) for row in _shared(known, "source_sha256", "protocol", "rig_id", "status", "run_id")
        )
        files = {row.pop("path"): SeenFile(**row) for row in _shared(reader.each("files"), "sha256")}
    return Manifest(items, recordings, files)


def _shared(rows: Iterable[dict[str, Any]], *names: str) -> Iterator[dict[str, Any]]:
    """Rows with the texts of these columns, which many have in common, held once for all of them."""
    for row in rows:
        for name in names:
            if row[name] is not None:
                row[name] = sys.intern(row[name])
        yield row


def known_recordings(lab: Lab) -> frozenset[str]:
    """Ids of all recordings in a lab. Raises `LabError` where nothing has been published."""
    lab.require_database()
    with Reader(lab.database) as reader:
        return frozenset(row["recording_id"] for row in reader.rows("recordings", ("recording_id",)))
