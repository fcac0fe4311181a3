"""The night's first half: raw files to recordings that are accepted, refused, duplicates or waiting."""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from ingest.discover import with_mapping
from pipeline.lab.inputs import kinds_of
from pipeline.lab.journal import PENDING, entries, entry_name
from pipeline.lab.paths import is_there
from pipeline.nightly.context import Context
from pipeline.nightly.look import SOURCE, Found, source_of
from pipeline.nightly.planning import ANALYSED_SQL, HAS_CONTENT, ITEM, place_contents, set_aside, take_readings
from pipeline.nightly.stages import (
    CALIBRATION_KINDS,
    RECORDING,
    RecordingTask,
    input_hash,
    item_id,
    recording_casualty,
)
from pipeline.nightly.workers import Casualty

_CONTENT = ", ".join(f"l.{name.strip()}" for name in SOURCE.split(","))
"""Columns of the file that a content is read from."""


def adopt_journal(context: Context) -> None:
    """Takes over the whole entries that a killed night left, and removes what it left half done."""
    journal, staging, ledger = context.lab.journal, context.lab.staging, context.ledger
    journal.mkdir(parents=True, exist_ok=True)
    context.keep(
        (outcome for path, outcome in entries(journal) if path.name == entry_name(outcome.item_id)), done=False
    )
    for path in _listed(journal):
        if ledger.row("SELECT 1 FROM outcomes WHERE entry = ?", [path.name]) is None:
            path.unlink()
    for path in _listed(staging) if staging.is_dir() else ():
        if path.is_dir():
            shutil.rmtree(path)
        elif ledger.row("SELECT 1 FROM outcomes WHERE item_id = ?", [item_id(RECORDING, path.stem)]) is None:
            path.unlink()


def _listed(folder: Path) -> Iterator[Path]:
    with os.scandir(folder) as found:
        for one in found:
            yield Path(one.path)


def read(context: Context, found: Found) -> None:
    """Reads what is new, and again what a verdict turns out to need. Files that change meanwhile become pending."""
    ledger = context.ledger
    place_contents(ledger, functools.partial(is_there, roots=found.roots))
    ledger.add("expected", _expected(context))
    context.leave_out_fresh(RECORDING)
    prefix = len(item_id(RECORDING, ""))
    ledger.run(
        "INSERT INTO stale SELECT DISTINCT substr(item_id, ?) FROM expected WHERE stage = ?", [prefix + 1, RECORDING]
    )
    while True:
        set_aside(ledger, _read_contents(context))
        take_readings(ledger)
        ledger.run("DELETE FROM stale")
        ledger.run(
            "INSERT INTO stale SELECT sha256 FROM readings r WHERE accepted"
            f" AND NOT EXISTS (SELECT 1 FROM known WHERE source_sha256 = r.sha256 AND status {ANALYSED_SQL})"
            f" AND NOT EXISTS (SELECT 1 FROM outcomes WHERE done AND item_id = {ITEM} r.sha256)"
        )
        if not ledger.number("SELECT count(*) FROM stale"):
            return


def include(context: Context, excluded: frozenset[str]) -> None:
    """Books the recordings that take part in the analysis."""
    ledger = context.ledger
    found = ledger.each(
        "SELECT r.recording_id, o.item_id, o.specimen_id, o.rig_id, o.carried, o.input_hash, o.code_version,"
        " o.settings_hash, o.entry, k.specimen_id, k.rig_id,"
        " (SELECT group_concat(kind) FROM carried c WHERE c.recording_id = r.recording_id),"
        " i.input_hash, i.code_version, i.settings_hash, NULL"
        f" FROM readings r LEFT JOIN outcomes o ON o.done AND o.item_id = {ITEM} r.sha256"
        " LEFT JOIN known k ON k.rowid ="
        f" (SELECT max(rowid) FROM known WHERE source_sha256 = r.sha256 AND status {ANALYSED_SQL})"
        f" LEFT JOIN items i ON i.item_id = {ITEM} r.sha256"
        " WHERE r.accepted AND r.recording_id IS NOT NULL"
    )

    def included() -> Iterator[tuple[Any, ...]]:
        for name, item, *rest in found:
            specimen_id, rig_id, kinds, *made_from = rest[:7] if item is not None else rest[7:]
            if name not in excluded:
                calibrates = not CALIBRATION_KINDS.isdisjoint(kinds_of(kinds))
                yield name, specimen_id, rig_id, kinds, calibrates, *made_from

    ledger.add("included", included())


def _expected(context: Context) -> Iterator[tuple[str, str, str | None]]:
    """The contents, each with what reading it now would make its results from; its rig is that of an earlier reading."""
    found = context.ledger.each(
        f"SELECT c.sha256, l.mapping, o.item_id, o.rig_id, k.rowid, k.rig_id, {_CONTENT}"
        " FROM contents c JOIN looks l ON l.id = c.look"
        f" LEFT JOIN outcomes o ON o.item_id = {ITEM} c.sha256"
        f" LEFT JOIN known k ON k.rowid = (SELECT max(rowid) FROM known WHERE source_sha256 = c.sha256 AND {HAS_CONTENT})"
        " WHERE c.at_home"
    )
    for sha256, mapping, left, left_rig, row, known_rig, *where in found:
        item = item_id(RECORDING, sha256)
        rigs = {rig for there, rig in ((left, left_rig), (row, known_rig)) if there is not None}
        for rig_id in rigs:
            rig = "" if rig_id is None else context.rig_hash(source_of(*where), rig_id)
            yield item, RECORDING, input_hash(mapping, sha256, rig)
        if not rigs:
            yield item, RECORDING, None


def _read_contents(context: Context) -> list[str]:
    """Reads the stale contents in workers; returns those that could not be read because they change."""
    ledger = context.ledger
    count = ledger.number("SELECT count(*) FROM stale")
    changing = []
    for task, result in context.run(_tasks(context), count, "recordings"):
        if isinstance(result, Casualty):
            result = recording_casualty(replace(task, settings_hash=context.limits_hash), result.reason)
        if result.outcome == PENDING:
            changing.append(task.sha256)
        else:
            context.keep([result], done=True)
    return changing


def _tasks(context: Context) -> Iterator[RecordingTask]:
    """One for each stale content, in the order of the files (those not looked at first)."""
    code, settings = context.version(RECORDING)
    found = context.ledger.each(
        f"SELECT c.sha256, {_CONTENT} FROM stale JOIN contents c USING (sha256) JOIN looks l ON l.id = c.look"
        " ORDER BY c.length, c.first, c.sha256"
    )
    for sha256, *where in found:
        yield RecordingTask(
            source=with_mapping(source_of(*where)),
            sha256=sha256,
            rigs=context.rigs,
            lab=context.lab.folder,
            staged=context.lab.staged(sha256),
            journal=context.lab.journal,
            code_version=code,
            settings_hash=settings,
        )
