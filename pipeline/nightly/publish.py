"""The night's fourth step: what it decided and made is put in its place, and the next database is published.

Samples and refused files go first, so that the database never speaks of what is not there. Does not belong here: how a
database is built, checked and put in place (`pipeline.lab.snapshot`).
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any

from ingest.atomic import flush
from ingest.discover import SourceFile
from ingest.paths import is_below, spell_source
from ingest.quarantine import quarantine, release, release_strays
from ingest.remote import forget, staged
from pipeline.analyse.description import as_json, recordings_rows
from pipeline.lab.journal import (
    DAMAGED,
    DIAGNOSIS,
    FAILED,
    GROUP,
    PENDING,
    QUARANTINED,
    RECORDING,
    SPECIMEN,
    entry_path,
    explain_unwritable,
    make_item_id,
    read_tables,
)
from pipeline.lab.reader import Reader, open_published
from pipeline.lab.snapshot import Changes, Deletion, Rows, Streamed, publish
from pipeline.nightly.ledger import describe_accident, split
from pipeline.nightly.look import FILE, NO_MAPPING, SOURCE, Found, make_source
from pipeline.nightly.ownership import ANALYSED_SQL, DUPLICATE, ITEM
from pipeline.nightly.stages import (
    GROUPS,
    STAGES,
    Night,
)
from schemas.errors import DealabError, RefusedError
from schemas.tables import OWNERS, TABLES, StageName, find_rows_made_by
from schemas.version import software_version

_KEYS_AT_ONCE = 10_000
"""Rows that one deletion names."""
_ITEM = (
    "item_id", "stage", "input_hash", "code_version", "settings_hash", "outcome", "seconds", "error", "notes",
)  # fmt: skip
_FILE = ("path", "size", "mtime_ns", "inode", "sha256")
_ROW = "source_path, source_sha256, status, problem, recording_id, source_present, run_id"
_AGAIN = f"EXISTS (SELECT 1 FROM outcomes o WHERE o.done AND o.item_id = {ITEM} source_sha256)"
"""SQL condition on rows: their content was read tonight, or by a killed night."""
_RESULTS = f"EXISTS (SELECT 1 FROM standing s WHERE s.results AND s.item_id = {ITEM} source_sha256)"
"""SQL condition on rows: their content has results of its own in the lab."""
_WITHOUT_RESULTS = f"FROM known WHERE status {ANALYSED_SQL} AND (NOT {_RESULTS} OR {_AGAIN})"
"""Published recordings whose rows go: read again, no longer accepted, or forgotten."""
_ITEMS_GONE = (
    "FROM items i WHERE (EXISTS (SELECT 1 FROM outcomes o WHERE o.done AND o.item_id = i.item_id)"
    " OR NOT EXISTS (SELECT 1 FROM standing s WHERE s.item_id = i.item_id)"
    " AND NOT EXISTS (SELECT 1 FROM passed p WHERE p.item_id = i.item_id AND p.line = i.error))"
)
"""Items whose entry goes: made again tonight, about something that is no longer there, or passed over otherwise."""
_BY_ACCIDENT = (
    "EXISTS (SELECT 1 FROM standing s WHERE s.item_id = i.item_id)"
    " AND EXISTS (SELECT 1 FROM accidents a WHERE a.item_id = i.item_id)"
)
"""SQL condition on items: trouble of the machine ended them tonight, so that their earlier results stay."""


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


def count_files(night: Night, found: Found) -> Counts:
    """The numbers of a night."""
    ledger = night.ledger
    tonight = "FROM rows WHERE look IS NOT NULL"
    statuses = dict(ledger.each(f"SELECT status, count(*) {tonight} GROUP BY status"))
    contents = f"SELECT count(DISTINCT source_sha256) {tonight} AND source_sha256 IS NOT NULL AND"
    return Counts(
        found=ledger.number("SELECT count(*) FROM looks"),
        ingested=ledger.number(f"{contents} {_AGAIN} AND {_RESULTS}"),
        reused=ledger.number(f"{contents} NOT {_AGAIN}"),
        quarantined=statuses.get(QUARANTINED, 0),
        failed=len(list_failures(night)) + ledger.number("SELECT count(*) FROM accidents WHERE stage = ?", [RECORDING]),
        damaged=statuses.get(DAMAGED, 0),
        duplicates=statuses.get(DUPLICATE, 0),
        pending=statuses.get(PENDING, 0),
        unmapped=len(found.unmapped),
    )


def list_failures(night: Night) -> dict[str, str]:
    """Items that stand in the lab as failed, with the first line of their reason."""
    errors = night.ledger.each(
        "SELECT s.item_id, CASE WHEN o.item_id IS NULL THEN i.error ELSE o.error END FROM standing s"
        " LEFT JOIN outcomes o ON o.done AND o.item_id = s.item_id LEFT JOIN items i ON i.item_id = s.item_id"
        " WHERE s.results AND CASE WHEN o.item_id IS NULL THEN i.outcome ELSE o.outcome END = ? ORDER BY s.item_id",
        [FAILED],
    )
    return {item: error.splitlines()[0] if error else "no reason given" for item, error in errors}


def list_attention(night: Night) -> tuple[str, ...]:
    """Every file that was refused or is damaged, every accident and every analysis that failed, with its reason."""
    rows = night.ledger.each(
        "SELECT r.status, r.source_path, r.problem FROM rows r JOIN looks l ON l.id = r.look"
        " WHERE r.status IN (?, ?) ORDER BY l.place",
        [QUARANTINED, DAMAGED],
    )
    files = [f"{status}: {path}: {problem}" for status, path, problem in rows]
    accidents = list(night.ledger.each("SELECT item_id, source_path, reason, nights FROM accidents ORDER BY item_id"))
    told = [f"{place or item}: {describe_accident(reason, nights)}" for item, place, reason, nights in accidents]
    failures = list_failures(night)
    for item, *_ in accidents:
        failures.pop(item, None)
    return (*files, *told, *(f"failed: {item}: {reason}" for item, reason in failures.items()))


def list_without_result(night: Night) -> tuple[str, ...]:
    """Every recording or table in the published lab that was taken in and led to no result, with what was missing."""
    with open_published(night.lab.database) as reader:
        if reader is None:
            return ()
        return tuple(
            f"no result: {row['source_path']}: {row['what_was_missing']}"
            for row in reader.each("without_result", ("status", "source_path", "what_was_missing"))
            if row["status"] != QUARANTINED
        )


def list_rigs_without_constants(night: Night) -> tuple[str, ...]:
    """What is told of each rig of the published lab whose constants recordings need and do not have."""
    with open_published(night.lab.database) as reader:
        return () if reader is None else tuple(reader.list_rigs_without_constants())


def count_results(night: Night) -> int:
    """How many results the night made, or took over from a killed one."""
    return night.ledger.number("SELECT count(*) FROM outcomes WHERE done")


def count_missing(night: Night) -> int:
    """How many known recordings have no file any more."""
    return night.ledger.number("SELECT count(*) FROM rows WHERE NOT source_present")


def publish_night(night: Night, found: Found) -> datetime:
    """Puts samples and refused files in their place, publishes the database, removes what no row speaks of any more.

    Returns when the night was over but for its pages, as `runs` has it. Raises `LabError`; the published database is
    then as it was.
    """
    _place_samples(night)
    _place_refused(night)
    _book_passed(night, found)
    finished_at = datetime.now(UTC)
    insertions = Streamed(_list_insertions, night, found, finished_at)
    publish(night.lab, Changes(Streamed(_list_deletions, night, found), insertions))
    _remove_old_samples(night)
    _release_strays(night)
    return finished_at


def _book_passed(night: Night, found: Found) -> None:
    """Books what was passed over, so that each such file, or line for many, has an item that says why."""
    passed = [(make_item_id(FILE, one.place), "passed over", str(one)) for one in found.passed]
    unmapped = ((make_item_id(FILE, path), "unmapped", f"{path}: {NO_MAPPING}") for path in found.unmapped)
    night.ledger.add("passed", itertools.chain(passed, unmapped))


# --- what changes -----------------------------------------------------------------------------------------------------


def _list_deletions(night: Night, found: Found) -> Iterator[Deletion]:
    """What goes, in parts that fit in memory."""
    ledger, each = night.ledger, night.ledger.each
    ledger.run("DELETE FROM going")
    ledger.run(f"INSERT INTO going SELECT DISTINCT 'recording_id', recording_id {_WITHOUT_RESULTS}")
    ledger.run(f"INSERT INTO going SELECT stage, item_id {_ITEMS_GONE} AND NOT ({_BY_ACCIDENT})")
    named = "SELECT name FROM going WHERE what = ?"
    gone = each(
        "SELECT source_path, source_sha256 FROM known k WHERE NOT EXISTS (SELECT 1 FROM rows r"
        " WHERE r.source_path = k.source_path AND r.source_sha256 IS k.source_sha256 AND NOT r.changed)"
    )
    yield from _delete_in_parts("recordings", ("source_path", "source_sha256"), gone)
    for table, where in find_rows_made_by(RECORDING).items():
        yield from _delete_in_parts(table, (OWNERS[RECORDING],), each(named, ["recording_id"]), where)
    stages: tuple[StageName, ...] = (SPECIMEN, DIAGNOSIS)
    for stage in stages:
        begin = len(make_item_id(stage, ""))
        for table, where in find_rows_made_by(stage).items():
            specimens = ((item[begin:],) for (item,) in each(named, [stage]))
            yield from _delete_in_parts(table, (OWNERS[stage],), specimens, where)
    for name in GROUPS:
        if ledger.row("SELECT 1 FROM going WHERE name = ?", [make_item_id(GROUP, name)]) is not None:
            yield from (Deletion(table) for table in find_rows_made_by(GROUP, name))
    yield from _delete_in_parts("items", ("item_id",), each(f"SELECT item_id {_ITEMS_GONE}"))
    yield from _delete_in_parts("files", ("path",), ((path,) for path in _list_files_gone(night, found)))
    yield Deletion("annotations")
    yield Deletion("accidents")


def _delete_in_parts(
    table: str, columns: Sequence[str], keys: Iterable[tuple[str | None, ...]], where: str = "true"
) -> Iterator[Deletion]:
    for some in split(keys, _KEYS_AT_ONCE):
        yield Deletion(table, dict(zip(columns, zip(*some, strict=True), strict=True)), where)


def _list_files_gone(night: Night, found: Found) -> Iterator[str]:
    files = night.ledger.each(
        "SELECT path, EXISTS (SELECT 1 FROM looks l WHERE l.path = f.path),"
        " EXISTS (SELECT 1 FROM looks l WHERE l.path = f.path AND settled) FROM files f"
    )
    for path, seen, again in files:
        if again or (not seen and any(is_below(path, root) for root in found.roots)):
            yield path


def _list_insertions(night: Night, found: Found, finished_at: datetime) -> Iterator[Mapping[str, Rows]]:
    ledger = night.ledger
    changed = f"SELECT {_ROW} FROM rows WHERE changed"
    made = "FROM outcomes o JOIN standing s USING (item_id) WHERE o.done ORDER BY item_id"
    for item, has_results in ledger.each(f"SELECT item_id, s.results {made}"):
        tables = read_tables(entry_path(night.lab.journal, item))
        read = tables.pop("recordings", None)
        if read is not None:
            (full,) = recordings_rows(read)
            rows = ledger.each(f"{changed} AND source_sha256 = ?", [item.partition(":")[2]])
            yield {"recordings": [_complete_row(night, row, full) for row in rows]}
        if has_results:
            yield tables
    with open_published(night.lab.database) as reader:
        for some in split(ledger.each(f"{changed} AND NOT {_AGAIN}")):
            yield {"recordings": _complete_rows(night, some, reader)}
    for some in split(ledger.each(f"SELECT {', '.join(f'o.{name}' for name in _ITEM)} {made}")):
        yield {"items": [{**dict(zip(_ITEM, row, strict=True)), "run_id": night.run_id} for row in some]}
    as_before = "SELECT 1 FROM items i WHERE i.item_id = p.item_id AND i.error = p.line"
    passed = f"SELECT item_id, outcome, line FROM passed p WHERE NOT EXISTS ({as_before}) ORDER BY item_id"
    for some in split(ledger.each(passed)):
        yield {
            "items": [
                {"item_id": item, "stage": FILE, "outcome": outcome, "error": line, "run_id": night.run_id}
                for item, outcome, line in some
            ]
        }
    for some in split(ledger.each(f"SELECT {', '.join(_FILE)} FROM looks WHERE settled ORDER BY path")):
        yield {"files": [dict(zip(_FILE, row, strict=True)) for row in some]}
    # An accident stays booked until its file is met again: tonight's folders may be others.
    kept = "SELECT * FROM earlier_accidents WHERE stage = ? AND source_path NOT IN (SELECT path FROM looks)"
    earlier = (row for row in ledger.each(kept, [RECORDING]) if not any(is_below(row[2], root) for root in found.roots))
    for some in split(itertools.chain(ledger.each("SELECT * FROM accidents"), earlier)):
        yield {"accidents": [dict(zip(TABLES["accidents"].names, row, strict=True)) for row in some]}
    yield {
        "annotations": [{**asdict(one), "at": datetime.fromisoformat(one.at)} for one in night.annotations],
        "runs": [_describe_run(night, found, finished_at)],
    }


def _complete_rows(night: Night, changed: Sequence[tuple[Any, ...]], reader: Reader | None) -> list[dict[str, Any]]:
    """Changed rows of `recordings` that nothing was read for tonight, completed from what is published."""
    contents = sorted({sha256 for _, sha256, *_ in changed if sha256})
    published: dict[str, dict[str, Any]] = {}
    if contents and reader is not None:
        for full in reader.rows("recordings", None, "source_sha256", contents):
            if full["status"] != DUPLICATE:
                published[full["source_sha256"]] = full
    return [_complete_row(night, row, published.get(row[1] or "", {})) for row in changed]


def _complete_row(night: Night, row: Sequence[Any], full: Mapping[str, Any]) -> dict[str, Any]:
    """A whole row of `recordings` from what the night says of it and what its content gave when it was read.

    Not as an arrow table, which would cost an import of pandas.
    """
    said = dict(zip(_ROW.split(", "), row, strict=True))
    return {
        "software_version": software_version(),
        **full,
        **({"samples_path": None} if said["status"] in (DUPLICATE, QUARANTINED) else {}),
        **said,
        "source_present": bool(said["source_present"]),
        "run_id": said["run_id"] or night.run_id,
    }


def _describe_run(night: Night, found: Found, finished_at: datetime) -> dict[str, Any]:
    notes = [*map(str, found.passed), *(f"{path}: {NO_MAPPING}" for path in found.unmapped)]
    return {
        "run_id": night.run_id,
        "started_at": night.started_at,
        "finished_at": finished_at,
        "software_version": software_version(),
        **asdict(count_files(night, found)),
        "notes": json.dumps(notes, ensure_ascii=False),
        "settings": as_json(night.settings.as_dict()),
        "code_version": as_json({stage: night.version(stage)[0] for stage in STAGES}),
    }


# --- files ------------------------------------------------------------------------------------------------------------


def _place_samples(night: Night) -> None:
    """Moves the samples of accepted recordings from where the workers wrote them. Done twice, it does nothing twice."""
    folders = set()
    made = night.ledger.each(
        f"SELECT r.sha256, o.samples_path FROM outcomes o JOIN readings r ON o.item_id = {ITEM} r.sha256"
        " WHERE o.done AND r.accepted AND o.samples_path IS NOT NULL"
    )
    for sha256, relative in made:
        waiting, place = night.lab.staged(sha256), night.lab.folder / relative
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
            if waiting.exists():
                waiting.replace(place)
                folders.add(place.parent)
        except OSError as error:
            raise explain_unwritable(place.parent, error) from error
    for folder in folders:
        flush(folder)


def _place_refused(night: Night) -> None:
    """Copies newly refused files into quarantine, and releases files that have become good."""
    each = night.ledger.each
    source = ", ".join(f"l.{name.strip()}" for name in SOURCE.split(","))
    refused = each(
        f"SELECT l.sha256, w.problem, coalesce(r.refusal, l.refusal), {source}"
        " FROM rows w JOIN looks l ON l.id = w.look LEFT JOIN readings r ON r.sha256 = l.sha256"
        " WHERE w.changed AND w.status = ? ORDER BY l.place",
        [QUARANTINED],
    )
    good = each(
        f"SELECT DISTINCT {source} FROM known k JOIN looks l ON l.path = k.source_path WHERE k.status = ?"
        " AND NOT EXISTS (SELECT 1 FROM rows w WHERE w.source_path = k.source_path AND w.status = ?)",
        [QUARANTINED, QUARANTINED],
    )
    try:
        for sha256, problem, refusal, *where in refused:
            error = RefusedError(problem or "refused") if refusal is None else DealabError(**json.loads(refusal))
            _quarantine(night, make_source(*where), sha256, error)
        for there in (make_source(*where) for where in good):
            release(spell_source(there), night.lab.folder)
    except OSError as error:
        raise explain_unwritable(night.lab.quarantine, error) from error


def _quarantine(night: Night, source: SourceFile, sha256: str | None, error: DealabError) -> None:
    with staged(source.path, source.remote):
        quarantine(
            source.path,
            night.lab.folder,
            error,
            sha256=sha256,
            when=night.started_at,
            place=spell_source(source),
            root=source.root,
        )


def _remove_old_samples(night: Night) -> None:
    """Samples of recordings that were read again under another name, or are forgotten."""
    old = night.ledger.each(
        f"SELECT samples_path {_WITHOUT_RESULTS} AND samples_path IS NOT NULL AND samples_path NOT IN"
        f" (SELECT o.samples_path FROM outcomes o JOIN readings r ON o.item_id = {ITEM} r.sha256"
        " WHERE o.done AND r.accepted AND o.samples_path IS NOT NULL)"
    )
    root = night.lab.samples_folder.resolve()
    for (relative,) in old:
        path = (night.lab.folder / relative).resolve()
        if root in path.parents:
            path.unlink(missing_ok=True)


def _release_strays(night: Night) -> None:
    """Removes copies in quarantine of a night that ended before it published, or of a database that was moved away."""

    def looked_at() -> Iterator[str]:
        looks = night.ledger.each(f"SELECT {SOURCE} FROM looks")
        return (spell_source(make_source(*look)) for look in looks)

    if not night.lab.quarantine.is_dir():
        return
    with open_published(night.lab.database) as reader:
        assert reader is not None, "this night has published"
        refused = reader.rows("recordings", ("source_path",), where="status = 'quarantined'")
        release_strays(night.lab.folder, (row["source_path"] for row in refused), looked_at)


def discard_work(night: Night) -> None:
    """Removes the journal and what is half done, also by a killed night: all of it is published.

    The ledger removes itself.
    """
    for place in (path for path in night.lab.work.iterdir() if path != night.lab.ledger):
        with suppress(OSError), os.scandir(place) as found:  # one by one: to remove a folder lists all of it first
            for one in found:
                os.unlink(one.path)
        if place.is_dir():
            shutil.rmtree(place, ignore_errors=True)
        else:
            place.unlink(missing_ok=True)
    for folder in (night.lab.samples_folder, night.lab.quarantine, night.lab.reports):
        _remove_half_written(folder)
    forget(night.lab.remote)


def _remove_half_written(folder: str | os.PathLike[str]) -> None:
    """Removes what somebody who was killed wrote under a temporary name. The lab is ours: nobody writes it now."""
    with suppress(FileNotFoundError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                if entry.name.startswith(".partial-"):
                    shutil.rmtree(entry.path, ignore_errors=True)
                else:
                    _remove_half_written(entry.path)
            elif entry.name.startswith(".") and entry.name.endswith(".tmp"):
                os.unlink(entry.path)
