"""From a night's decisions to what changes in the lab: samples, quarantine, and the rows of the next snapshot."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from ingest.atomic import flush
from ingest.discover import SourceFile
from ingest.quarantine import quarantine, release
from ingest.remote import forget, staged
from pipeline.annotations import Annotation
from pipeline.night import Context
from pipeline.paths import below, source_text
from pipeline.plan import DUPLICATE, Look, Row
from pipeline.reading import Read
from pipeline.stages.tasks import (
    DIAGNOSIS,
    DIAGNOSIS_TABLES,
    GROUP,
    GROUPS,
    RECORDING,
    RECORDING_TABLES,
    SPECIMEN,
    SPECIMEN_TABLES,
    item_id,
)
from pipeline.store.checks import ANALYSED
from pipeline.store.journal import DAMAGED, FAILED, PENDING, QUARANTINED, Outcome, entry_path, read_tables, unwritable
from pipeline.store.manifest import KnownRecording
from pipeline.store.manifest import published as snapshot
from pipeline.store.publish import Changes, Deletion, Rows, publish
from pipeline.tabulate.recordings import as_json, joined, recordings_rows
from schemas.errors import RefusedError
from schemas.version import software_version

_Complete = Callable[[Row, Mapping[str, Any]], dict[str, Any]]


@dataclass(frozen=True)
class Night:
    """What was decided tonight: all rows that `recordings` has to have, and all items of the later stages."""

    run_id: str
    started_at: datetime
    read: Read
    rows: Sequence[Row]
    derived: frozenset[str]
    annotations: Sequence[Annotation]


@dataclass(frozen=True)
class Counts:
    """Numbers of a run, named as the columns of `runs`."""

    found: int
    ingested: int
    reused: int
    quarantined: int
    failed: int
    damaged: int
    duplicates: int
    pending: int
    unmapped: int


def count(context: Context, night: Night) -> Counts:
    """The numbers of a night."""
    looked = {look.path for look in night.read.found.looks}
    tonight = [row for row in night.rows if row.source_path in looked and row.source_present]
    statuses = [row.status for row in tonight]
    read = {item for item in context.done if item.startswith(f"{RECORDING}:")}
    contents = {item_id(RECORDING, row.source_sha256) for row in tonight if row.source_sha256 is not None}
    accepted = {item_id(RECORDING, sha) for sha in night.read.accepted}
    return Counts(
        found=len(night.read.found.looks),
        ingested=len(read & contents & accepted),
        reused=len(contents - read),
        quarantined=statuses.count(QUARANTINED),
        failed=len(failures(context, night)),
        damaged=statuses.count(DAMAGED),
        duplicates=statuses.count(DUPLICATE),
        pending=statuses.count(PENDING),
        unmapped=len(night.read.found.unmapped),
    )


def failures(context: Context, night: Night) -> dict[str, str]:
    """Items that stand in the lab as failed, with the first line of their reason."""
    standing = night.derived | {item_id(RECORDING, sha) for sha in night.read.accepted}
    errors = {
        item: made.error or "" for item in standing if (made := _outcome(context, item)) and made.outcome == FAILED
    }
    return {item: error.splitlines()[0] if error else "no reason given" for item, error in sorted(errors.items())}


def publish_night(context: Context, night: Night) -> None:
    """Puts samples and refused files in their place, publishes the database, and removes what no row speaks of any more.

    Raises `LabError`; the published database is then as it was.
    """
    changed = _changed(context, night)
    _place_samples(context, night)
    _place_refused(context, night, changed)
    publish(context.lab, Changes(list(_deletions(context, night, changed)), _insertions(context, night, changed)))
    _remove_old_samples(context, night)


# --- what changes -------------------------------------------------------------------------------------------------------


def _changed(context: Context, night: Night) -> list[Row]:
    """The rows of `recordings` that differ from the published ones, or whose content was read again."""
    known = {(row.source_path, row.source_sha256): row for row in context.manifest.recordings}
    return [row for row in night.rows if not _stands(context, row, known.get(row.key))]


def _stands(context: Context, row: Row, before: KnownRecording | None) -> bool:
    again = row.source_sha256 is not None and item_id(RECORDING, row.source_sha256) in context.done
    return before is not None and not again and _same(row, before)


def _same(row: Row, before: KnownRecording) -> bool:
    return (row.status, row.problem, row.recording_id, row.source_present) == (
        before.status,
        before.problem,
        before.recording_id,
        bool(before.source_present),
    )


def _deletions(context: Context, night: Night, changed: Sequence[Row]) -> Iterator[Deletion]:
    known = context.manifest.recordings
    wanted = {row.key for row in night.rows}
    kept = wanted - {row.key for row in changed}
    gone = [row for row in known if (row.source_path, row.source_sha256) not in kept]
    if gone:
        keys: dict[str, list[str | None]] = {
            "source_path": [r.source_path for r in gone],
            "source_sha256": [r.source_sha256 for r in gone],
        }
        yield Deletion("recordings", keys)
    recording_ids = sorted({str(row.recording_id) for row in _without_results(context, night)})
    for table, where in RECORDING_TABLES.items():
        yield Deletion(table, {"recording_id": recording_ids}, where)
    items = _items_gone(context, night)
    for stage, tables in ((SPECIMEN, SPECIMEN_TABLES), (DIAGNOSIS, DIAGNOSIS_TABLES)):
        specimens = [item.partition(":")[2] for item in items if item.startswith(f"{stage}:")]
        for table, where in tables.items():
            yield Deletion(table, {"specimen_id": specimens}, where)
    for name, group in GROUPS.items():
        if item_id(GROUP, name) in items:
            yield from (Deletion(table) for table in group.tables)
    yield Deletion("items", {"item_id": items})
    yield Deletion("files", {"path": _files_gone(context, night)})
    yield Deletion("annotations")


def _without_results(context: Context, night: Night) -> list[KnownRecording]:
    """Published recordings whose rows go: read again, no longer accepted, or forgotten."""
    accepted = set(night.read.accepted)
    return [
        row
        for row in context.manifest.recordings
        if row.status in ANALYSED
        and (row.source_sha256 not in accepted or item_id(RECORDING, row.source_sha256) in context.done)
    ]


def _items_gone(context: Context, night: Night) -> list[str]:
    """Items whose entry goes: made again tonight, or about something that is no longer there."""
    standing = _contents(night) | night.derived
    return sorted(item for item in context.manifest.items if item in context.done or item not in standing)


def _contents(night: Night) -> set[str]:
    """The items of all contents that some row speaks of."""
    return {item_id(RECORDING, row.source_sha256) for row in night.rows if row.source_sha256 is not None}


def _files_gone(context: Context, night: Night) -> list[str]:
    found = {look.path for look in night.read.found.looks}
    gone = [
        path
        for path in context.manifest.files
        if path not in found and any(below(path, root) for root in night.read.found.roots)
    ]
    return sorted(gone + [path for path in night.read.found.seen if path in context.manifest.files])


def _insertions(context: Context, night: Night, changed: Sequence[Row]) -> Iterator[Mapping[str, Rows]]:
    accepted = {item_id(RECORDING, sha) for sha in night.read.accepted} | night.derived
    complete = _completer(context, night)
    left: dict[str, list[Row]] = {}
    for row in changed:
        left.setdefault(item_id(RECORDING, row.source_sha256 or ""), []).append(row)
    standing = _contents(night) | night.derived
    made = [outcome for item, outcome in sorted(context.done.items()) if item in standing]
    for outcome in made:
        tables = read_tables(entry_path(context.lab.journal, outcome.item_id))
        read = tables.pop("recordings", None)
        if read is not None:
            (full,) = recordings_rows(read)
            yield {"recordings": [complete(row, full) for row in left.pop(outcome.item_id, ())]}
        if outcome.item_id in accepted:
            yield tables
    yield {"recordings": _as_published(context, [row for rows in left.values() for row in rows], complete)}
    for outcome in made:
        yield {"items": [_item_row(outcome, night.run_id)]}
    for path, seen in night.read.found.seen.items():
        yield {"files": [{"path": path, **asdict(seen)}]}
    yield {
        "annotations": [{**asdict(one), "at": datetime.fromisoformat(one.at)} for one in night.annotations],
        "runs": [_run_row(context, night)],
    }


def _as_published(context: Context, changed: Sequence[Row], complete: _Complete) -> list[dict[str, Any]]:
    """The changed rows of `recordings` that nothing was read for tonight, completed from what is published."""
    contents = sorted({row.source_sha256 for row in changed if row.source_sha256})
    published: dict[str, dict[str, Any]] = {}
    with snapshot(context.lab) as reader:
        if contents and reader is not None:
            for full in reader.rows("recordings", None, "source_sha256", contents):
                if full["status"] != DUPLICATE:
                    published[full["source_sha256"]] = full
    return [complete(row, published.get(row.source_sha256 or "", {})) for row in changed]


def _completer(context: Context, night: Night) -> _Complete:
    """Makes a whole row of `recordings` from what the night says of it and what its content gave when it was read.

    Not as an arrow table, which would cost an import of pandas.
    """
    earlier = {(row.source_path, row.source_sha256): row for row in context.manifest.recordings}

    def complete(row: Row, full: Mapping[str, Any]) -> dict[str, Any]:
        before = earlier.get(row.key)
        as_before = before is not None and _same(row, before)
        return {
            "software_version": software_version(),
            **full,
            **({"samples_path": None} if row.status in (DUPLICATE, QUARANTINED) else {}),
            "recording_id": row.recording_id,
            "source_path": row.source_path,
            "source_sha256": row.source_sha256,
            "status": row.status,
            "problem": row.problem,
            "source_present": row.source_present,
            "run_id": before.run_id if before is not None and as_before else night.run_id,
        }

    return complete


def _item_row(outcome: Outcome, run_id: str) -> dict[str, Any]:
    return {
        "item_id": outcome.item_id,
        "stage": outcome.stage,
        **asdict(outcome.freshness),
        "outcome": outcome.outcome,
        "seconds": outcome.seconds,
        "error": outcome.error,
        "notes": joined(outcome.facts.get("notes", ())),
        "run_id": run_id,
    }


def _run_row(context: Context, night: Night) -> dict[str, Any]:
    notes = [*night.read.found.notes, *(f"{path}: no mapping" for path in night.read.found.unmapped)]
    stages = (RECORDING, SPECIMEN, DIAGNOSIS, GROUP)
    return {
        "run_id": night.run_id,
        "started_at": night.started_at,
        "finished_at": datetime.now(UTC),
        "software_version": software_version(),
        **asdict(count(context, night)),
        "notes": json.dumps(notes, ensure_ascii=False),
        "settings": as_json(context.settings.as_dict()),
        "code_version": as_json({stage: context.version(stage)[0] for stage in stages}),
    }


def _outcome(context: Context, item: str) -> Any:
    return context.done.get(item) or context.manifest.items.get(item)


# --- files --------------------------------------------------------------------------------------------------------------


def _place_samples(context: Context, night: Night) -> None:
    """Moves the samples of accepted recordings from where the workers wrote them. Done twice, it does nothing twice."""
    folders = set()
    for sha256 in night.read.accepted:
        outcome = context.done.get(item_id(RECORDING, sha256))
        relative = None if outcome is None else outcome.facts.get("samples_path")
        if relative is None:
            continue
        waiting, place = context.lab.staged(sha256), context.lab.folder / relative
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            if waiting.exists():
                waiting.replace(place)
                folders.add(place.parent)
        except OSError as error:
            raise unwritable(place.parent, error) from error
    for folder in folders:
        flush(folder)


def _place_refused(context: Context, night: Night, changed: Sequence[Row]) -> None:
    """Copies newly refused files into quarantine, and releases files that have become good."""
    looks = {look.path: look for look in night.read.found.looks}
    refused_before = {row.source_path for row in context.manifest.recordings if row.status == QUARANTINED}
    refused_now = {row.source_path for row in night.rows if row.status == QUARANTINED}
    try:
        for row in changed:
            look = looks.get(row.source_path)
            if look is not None and look.sha256 == row.source_sha256 and row.status == QUARANTINED:
                _quarantine(context, night, look, row)
        for path in (refused_before - refused_now) & looks.keys():
            release(_place(looks[path].source) or looks[path].source.path, context.lab.folder)
    except OSError as error:
        raise unwritable(context.lab.quarantine, error) from error


def _quarantine(context: Context, night: Night, look: Look, row: Row) -> None:
    reading = None if look.sha256 is None else night.read.verdicts.readings.get(look.sha256)
    error = look.error if reading is None else reading.refusal
    with staged(look.source.path, look.source.remote):
        quarantine(
            look.source.path,
            context.lab.folder,
            error or RefusedError(row.problem or "refused"),
            sha256=look.sha256,
            when=night.started_at,
            place=_place(look.source),
        )


def _place(source: SourceFile) -> str | None:
    """The address of a file that is here only for now."""
    return None if source.remote is None else source_text(source)


def _remove_old_samples(context: Context, night: Night) -> None:
    """Samples of recordings that were read again under another name, or are forgotten."""
    current = {
        outcome.facts.get("samples_path")
        for sha in night.read.accepted
        if (outcome := context.done.get(item_id(RECORDING, sha))) is not None
    }
    root = context.lab.samples_folder.resolve()
    for row in _without_results(context, night):
        if row.samples_path is not None and row.samples_path not in current:
            path = (context.lab.folder / row.samples_path).resolve()
            if root in path.parents:
                path.unlink(missing_ok=True)


def discard_work(context: Context) -> None:
    """Removes the journal and everything half done: all of it is published."""
    shutil.rmtree(context.lab.work, ignore_errors=True)
    forget(context.lab.remote)
