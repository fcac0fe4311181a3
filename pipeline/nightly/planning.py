"""The plan over all recordings, however many: who meets whom is asked of the ledger, what follows is decided by `pipeline.nightly.ownership`.

Rows are streamed in an order in which those that are decided about together stand together, so that only these are in
memory. Does not belong here: reading files, workers, the published database.
"""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from pipeline.lab.checks import ANALYSED
from pipeline.lab.journal import PENDING, QUARANTINED, USABLE
from pipeline.lab.paths import below
from pipeline.nightly.ledger import Ledger
from pipeline.nightly.ownership import (
    DUPLICATE,
    Candidate,
    Look,
    Placed,
    Reading,
    Row,
    judge,
    kept,
    placed,
    reading_before,
    row_of,
)
from pipeline.nightly.stages import RECORDING, as_facts, item_id
from schemas.errors import PendingError

ITEM = f"'{item_id(RECORDING, '')}' || "
"""SQL that makes the item of a content from its hash, which follows."""
ANALYSED_SQL = f"IN {ANALYSED!r}"
_USABLE_SQL = f"IN {USABLE!r}"
HAS_CONTENT = f"source_sha256 IS NOT NULL AND status NOT IN ('{DUPLICATE}', '{PENDING}')"
"""Condition of the known rows that say what reading their content gave."""


def place_contents(ledger: Ledger, still_there: Callable[[str], bool]) -> None:
    """Fills `contents`: those that were found tonight, and those with results that were not."""
    looks = ledger.each(
        "SELECT sha256, path, id,"
        f" (SELECT source_path FROM known WHERE source_sha256 = l.sha256 AND {HAS_CONTENT} ORDER BY rowid DESC LIMIT 1)"
        " FROM looks l WHERE sha256 IS NOT NULL ORDER BY sha256, length(path), path"
    )
    groups = ((sha256, list(group)) for sha256, group in itertools.groupby(looks, itemgetter(0)))
    ledger.add("contents", (_content(sha256, group, still_there) for sha256, group in groups))
    ledger.run(f"INSERT OR IGNORE INTO contents {_unseen('true')}")


def _content(sha256: str, looks: Sequence[tuple[Any, ...]], still_there: Callable[[str], bool]) -> tuple[Any, ...]:
    paths = [path for _, path, _, _ in looks]
    at: Placed = placed(paths, looks[0][3], still_there)
    return sha256, at.path, looks[at.look][2], at.at_home, len(paths[0]), paths[0]


def _unseen(condition: str) -> str:
    """The contents of known results as if nobody had looked at them."""
    return (
        "SELECT source_sha256, source_path, NULL, 0, -1, '' FROM known"
        f" WHERE source_sha256 IS NOT NULL AND status {ANALYSED_SQL} AND {condition} ORDER BY rowid DESC"
    )


def set_aside(ledger: Ledger, changing: Collection[str]) -> None:
    """Contents that changed while they were read: their files are pending, earlier results stay as they are."""
    for sha256 in changing:
        for look, place in list(ledger.each("SELECT id, place FROM looks WHERE sha256 = ?", [sha256])):
            name = Path(os.fsdecode(place)).name
            problem = str(PendingError("the file changed while it was read", where=name))
            ledger.run("UPDATE looks SET sha256 = NULL, problem = ?, pending = 1 WHERE id = ?", [problem, look])
        ledger.run("DELETE FROM contents WHERE sha256 = ?", [sha256])
        ledger.run(f"INSERT OR IGNORE INTO contents {_unseen('source_sha256 = ?')}", [sha256])


def take_readings(ledger: Ledger) -> None:
    """Fills `readings`: what each content gave, as far as it has been read, and who owns which recording id."""
    ledger.run("DELETE FROM readings")
    ledger.run("DELETE FROM superseded")
    ledger.run("DELETE FROM judged")
    ledger.add("readings", _readings(ledger))
    conflicts = ledger.each(
        "SELECT recording_id, r.sha256, path, status, look IS NOT NULL, length, first,"
        f" EXISTS (SELECT 1 FROM known WHERE source_sha256 = r.sha256 AND status {ANALYSED_SQL}),"
        " (SELECT sha256 FROM looks WHERE looks.path = c.path AND sha256 IS NOT NULL)"
        " FROM readings r JOIN contents c USING (sha256)"
        " WHERE accepted AND recording_id IN"
        " (SELECT recording_id FROM readings WHERE accepted GROUP BY recording_id HAVING count(*) > 1)"
        " ORDER BY recording_id"
    )
    for recording_id, group in itertools.groupby(conflicts, itemgetter(0)):
        verdict = judge(recording_id, [_candidate(row) for row in group])
        ledger.add("superseded", ((sha256,) for sha256 in verdict.superseded))
        ledger.add("judged", ((sha, str(error), json.dumps(as_facts(error))) for sha, error in verdict.refused.items()))
    ledger.run("DELETE FROM readings WHERE sha256 IN (SELECT sha256 FROM superseded)")
    ledger.run(
        f"UPDATE readings SET status = '{QUARANTINED}', accepted = 0, (problem, refusal) ="
        " (SELECT problem, refusal FROM judged WHERE judged.sha256 = readings.sha256)"
        " WHERE sha256 IN (SELECT sha256 FROM judged)"
    )


def _readings(ledger: Ledger) -> Iterator[tuple[Any, ...]]:
    found = ledger.each(
        "SELECT c.sha256, o.item_id, o.recording_id, o.status, o.problem, o.refusal,"
        " k.recording_id, k.status, k.problem, i.outcome"
        f" FROM contents c LEFT JOIN outcomes o ON o.done AND o.item_id = {ITEM} c.sha256"
        f" LEFT JOIN known k ON k.rowid = (SELECT max(rowid) FROM known WHERE source_sha256 = c.sha256 AND {HAS_CONTENT})"
        f" LEFT JOIN items i ON i.item_id = {ITEM} c.sha256"
    )
    for sha256, item, *row in found:
        if item is not None:
            reading, refusal = Reading(*row[:3]), row[3]
        else:
            reading, refusal = reading_before(*row[4:]), None
        yield sha256, reading.recording_id, reading.status, reading.problem, refusal, reading.status in USABLE


def _candidate(row: tuple[Any, ...]) -> Candidate:
    _, sha256, path, status, looked, length, first, owns, successor = row
    return Candidate(sha256, path, status, bool(owns), bool(looked), (length, first), successor)


def write_rows(ledger: Ledger, roots: Sequence[str], excluded: Collection[str]) -> None:
    """Fills `rows`: all that `recordings` has to have after tonight, `changed` where that is not what is published. Then
    `standing`: the items of their contents and those of the later stages."""
    ledger.add("rows", _rows_of_looks(ledger, excluded))
    ledger.add("rows", _rows_kept(ledger, roots, excluded))
    ledger.run(
        f"INSERT INTO standing SELECT DISTINCT {ITEM} source_sha256,"
        " EXISTS (SELECT 1 FROM readings r WHERE r.accepted AND r.sha256 = source_sha256)"
        " FROM rows WHERE source_sha256 IS NOT NULL"
    )
    ledger.run("INSERT INTO standing SELECT item_id, 1 FROM derived")


def _rows_of_looks(ledger: Ledger, excluded: Collection[str]) -> Iterator[tuple[Any, ...]]:
    found = ledger.each(
        "SELECT l.id, l.path, l.sha256, l.problem, l.pending, c.path, r.recording_id, r.status, r.problem,"
        f" EXISTS (SELECT 1 FROM outcomes WHERE done AND item_id = {ITEM} l.sha256),"
        " k.rowid, k.status, k.problem, k.recording_id, k.source_present, k.run_id"
        " FROM looks l LEFT JOIN contents c ON c.sha256 = l.sha256 LEFT JOIN readings r ON r.sha256 = l.sha256"
        " LEFT JOIN known k ON k.source_path = l.path AND k.source_sha256 IS l.sha256"
    )
    for look, path, sha256, problem, pending, home, *rest in found:
        reading = None if rest[1] is None else Reading(*rest[:3])
        row = row_of(Look(path, sha256, problem, bool(pending)), home, reading, excluded)
        yield _booked(row, look, bool(rest[3]), rest[4:])


def _rows_kept(ledger: Ledger, roots: Sequence[str], excluded: Collection[str]) -> Iterator[tuple[Any, ...]]:
    found = ledger.each(
        "SELECT k.source_path, k.source_sha256, r.recording_id, r.status, r.problem,"
        " EXISTS (SELECT 1 FROM looks WHERE path = k.source_path),"
        " c.look IS NOT NULL AND c.path <> k.source_path,"
        f" EXISTS (SELECT 1 FROM outcomes WHERE done AND item_id = {ITEM} k.source_sha256),"
        " k.rowid, k.status, k.problem, k.recording_id, k.source_present, k.run_id"
        " FROM known k LEFT JOIN contents c ON c.sha256 = k.source_sha256"
        " LEFT JOIN readings r ON r.sha256 = k.source_sha256"
        " WHERE NOT EXISTS (SELECT 1 FROM looks WHERE path = k.source_path AND sha256 IS k.source_sha256)"
        " AND NOT EXISTS (SELECT 1 FROM superseded WHERE sha256 = k.source_sha256)"
    )
    for path, sha256, *rest in found:
        recording_id, status, problem, path_looked, moved, again, *before = rest
        _, old_status, old_problem, old_id, present, _ = before
        row = kept(
            Row(path, sha256, old_status, old_problem, old_id, bool(present)),
            path_looked=bool(path_looked),
            looked_for=bool(path_looked) or any(below(path, root) for root in roots),
            moved=bool(moved),
            reading=None if status is None else Reading(recording_id, status, problem),
            excluded=excluded,
        )
        if row is not None:
            yield _booked(row, None, bool(again), before)


def _booked(row: Row, look: int | None, again: bool, before: Sequence[Any]) -> tuple[Any, ...]:
    """A row for the ledger. `before` is the published row of the same file and content, its rowid NULL where there is none."""
    rowid, status, problem, recording_id, present, run_id = before
    same = rowid is not None and (row.status, row.problem, row.recording_id, row.source_present) == (
        status,
        problem,
        recording_id,
        bool(present),
    )
    return (
        row.source_path,
        row.source_sha256,
        row.status,
        row.problem,
        row.recording_id,
        row.source_present,
        look,
        again or not same,
        run_id if same else None,
    )
