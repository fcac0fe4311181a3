"""What the lab knows before a night: items and what they were made from, recordings, raw files as last seen.

Read from the published snapshot. An older release's database may lack tables and columns; they read as empty.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pipeline.lab import Lab
from pipeline.store.journal import Freshness
from pipeline.store.reader import Reader

_COMMON = ("source_sha256", "protocol", "rig_id", "status", "run_id")


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
    """Everything that is known. `carried` has the kinds of carried results by recording."""

    items: Mapping[str, BookedItem] = field(default_factory=dict)
    recordings: Sequence[KnownRecording] = ()
    files: Mapping[str, SeenFile] = field(default_factory=dict)
    carried: Mapping[str, frozenset[str]] = field(default_factory=dict)
    last_run: int = 0


def load(lab: Lab) -> Manifest:
    """The manifest of a lab; empty where nothing has been published. Raises `LabError` for an unreadable database."""
    if not lab.database.exists():
        return Manifest()
    with Reader(lab.database) as reader:
        items = {
            row["item_id"]: BookedItem(
                row["item_id"],
                sys.intern(row["stage"]),
                Freshness(row["input_hash"], sys.intern(row["code_version"]), sys.intern(row["settings_hash"])),
                sys.intern(row["outcome"]),
                row["error"],
            )
            for row in reader.each("items")
        }
        fields = tuple(KnownRecording.__dataclass_fields__)
        recordings = tuple(_known(row) for row in reader.each("recordings", fields))
        files = {
            row.pop("path"): SeenFile(**{**row, "sha256": sys.intern(row["sha256"])}) for row in reader.each("files")
        }
        carried: dict[str, set[str]] = {}
        for row in reader.each("carried", ("recording_id", "kind")):
            carried.setdefault(row["recording_id"], set()).add(sys.intern(row["kind"]))
        runs = [int(row["run_id"]) for row in reader.each("runs", ("run_id",)) if str(row["run_id"]).isdigit()]
    sets = {kinds: kinds for kinds in map(frozenset, carried.values())}  # few, for many recordings
    same = {recording_id: sets[frozenset(kinds)] for recording_id, kinds in carried.items()}
    return Manifest(items, recordings, files, same, max(runs, default=0))


def _known(row: dict[str, Any]) -> KnownRecording:
    """A row with texts that many have in common held once for all of them; the content's hash is also that of its file."""
    for name in _COMMON:
        if row[name] is not None:
            row[name] = sys.intern(row[name])
    return KnownRecording(**row)


def known_recordings(lab: Lab) -> frozenset[str]:
    """Ids of all recordings in a lab. Raises `LabError` where nothing has been published."""
    lab.require_database()
    with Reader(lab.database) as reader:
        return frozenset(row["recording_id"] for row in reader.rows("recordings", ("recording_id",)))


def published(lab: Lab) -> contextlib.AbstractContextManager[Reader | None]:
    """A reader of the snapshot for a `with` block; None where nothing has been published."""
    return Reader(lab.database) if lab.database.exists() else contextlib.nullcontext()
