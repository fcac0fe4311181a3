"""Retention: what a lab can do without, what that is in bytes, and its removal.

Results stay: samples, copies of refused files and recordings whose raw file has gone are what can go. Samples come back
when their recording is read again. Does not belong here: backups (copies of the folder, see
`pipeline/nightly/README.md`).
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from ingest.quarantine import entries as quarantine_entries
from pipeline.lab.checks import ANALYSED
from pipeline.lab.interrupts import end_when_told
from pipeline.lab.journal import RECORDING, make_item_id
from pipeline.lab.lab import Lab
from pipeline.lab.lock import hold_lab
from pipeline.lab.reader import Reader
from pipeline.lab.snapshot import Changes, Deletion, publish
from schemas.tables import find_references


@dataclass(frozen=True)
class Rule:
    """What may go.

    Parameters
    ----------
    samples_days : samples of recordings that were measured more than so many days ago; None keeps them
    quarantine_days : copies of files that were refused more than so many days ago; None keeps them
    gone : recordings whose raw file has gone, with all their results
    """

    samples_days: float | None = None
    quarantine_days: float | None = None
    gone: bool = False


@dataclass(frozen=True)
class Part:
    """One kind of what goes: how many, and what that is in bytes."""

    what: str
    number: int
    size: int


@dataclass
class Plan:
    """What a rule takes out of a lab: rows of `recordings` that go or lose their samples, files and folders.

    `forgotten_specimens` are those of which no recording is left.
    """

    forgotten: list[dict[str, Any]] = field(default_factory=list)
    forgotten_specimens: list[str] = field(default_factory=list)
    bare: list[dict[str, Any]] = field(default_factory=list)
    parts: list[Part] = field(default_factory=list)
    paths: list[Path] = field(default_factory=list)

    def add(self, what: str, paths: list[Path]) -> None:
        self.parts.append(Part(what, len(paths), sum(_measure(path) for path in paths)))
        self.paths += paths


def plan_removal(lab: Lab, rule: Rule, now: datetime | None = None) -> Plan:
    """What would go; changes nothing. Raises `LabError` where nothing has been published."""
    now = now or datetime.now(UTC)
    lab.require_database()
    with Reader(lab.database) as reader:
        rows = reader.rows("recordings")
    found = Plan()
    if rule.gone:
        analysed = [row for row in rows if row["status"] in ANALYSED]
        found.forgotten = [row for row in analysed if row["source_present"] is False]
        left = {row["specimen_id"] for row in analysed if row["source_present"] is not False}
        found.forgotten_specimens = sorted({row["specimen_id"] for row in found.forgotten} - left - {None})
        found.add("recordings whose raw file has gone: samples", list(_find_samples(lab, found.forgotten)))
    if rule.samples_days is not None:
        limit = now - timedelta(days=rule.samples_days)
        kept = {row["recording_id"] for row in found.forgotten}
        found.bare = [
            row for row in rows if row["samples_path"] and row["started_at"] < limit and row["recording_id"] not in kept
        ]
        found.add("samples", list(_find_samples(lab, found.bare)))
    if rule.quarantine_days is not None:
        limit = now - timedelta(days=rule.quarantine_days)
        found.add("copies of refused files", list(_find_copies(lab, limit)))
    known = {row["samples_path"] for row in rows}
    stray = [
        path for path in lab.samples_folder.rglob("*.parquet") if path.relative_to(lab.folder).as_posix() not in known
    ]
    found.add("samples that no recording speaks of", stray)
    return found


def prune(lab: Lab, rule: Rule, now: datetime | None = None) -> Plan:
    """Removes what the rule says; the database is published first, so that it never speaks of what is not there.

    Specimens and groups that lose a recording are made again by the next nightly. Raises `LabError` as a nightly does.
    """
    lab.require_database()
    with end_when_told(), hold_lab(lab):
        found = plan_removal(lab, rule, now)
        if found.forgotten or found.bare:
            publish(lab, Changes(list(_list_deletions(found)), [{"recordings": _drop_samples(found.bare)}]))
            with contextlib.suppress(OSError):  # what a killed night left there is the next night's
                lab.work.rmdir()
        for path in found.paths:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
    return found


def _list_deletions(found: Plan) -> Iterator[Deletion]:
    forgotten: dict[str, list[str | None]] = {
        "recording_id": [row["recording_id"] for row in found.forgotten],
        "specimen_id": [*found.forgotten_specimens],
    }
    for table, column, key in find_references():
        yield Deletion(table, {column: forgotten[key]})
    yield Deletion("items", {"item_id": [make_item_id(RECORDING, row["source_sha256"]) for row in found.forgotten]})
    yield Deletion("files", {"path": [row["source_path"] for row in found.forgotten]})
    rows = [*found.forgotten, *found.bare]
    places = {key: [row[key] for row in rows] for key in ("source_path", "source_sha256")}
    yield Deletion("recordings", places)


def _drop_samples(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{**row, "samples_path": None} for row in rows]


def _find_samples(lab: Lab, rows: list[dict[str, Any]]) -> Iterator[Path]:
    root = lab.samples_folder.resolve()
    for row in rows:
        path = (lab.folder / (row["samples_path"] or "")).resolve()
        if root in path.parents and path.is_file():
            yield path


def _find_copies(lab: Lab, limit: datetime) -> Iterator[Path]:
    """Copied files in quarantine; the reason beside them stays."""
    for entry in quarantine_entries(lab.folder):
        name, when = entry.reason.get("file"), entry.reason.get("when")
        if isinstance(name, str) and isinstance(when, str) and datetime.fromisoformat(when) < limit:
            path = entry.folder / Path(name).name
            if path.is_file():
                yield path


def _measure(path: Path) -> int:
    return path.stat().st_size
