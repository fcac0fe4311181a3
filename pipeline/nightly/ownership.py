"""Who owns what: where each content lies, which recording it is, and what each row of `recordings` says.

Identity is content and what a mapping reads of it: the same again is a duplicate, the same recording id with other
content is a conflict and the first stays. The first part decides about one content, one recording id or one row by pure
functions. The second asks the ledger which of them meet, in an order in which those that are decided about together
stand together, so that only these are in memory. Does not belong here: reading files, workers, the published database.
"""

from __future__ import annotations

import itertools
import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path
from typing import Any

from ingest.paths import is_below
from pipeline.lab.checks import ANALYSED
from pipeline.lab.journal import DAMAGED, OK, PENDING, QUARANTINED, RECORDING, USABLE, make_item_id
from pipeline.nightly.ledger import Ledger
from schemas.errors import PendingError, RefusedError

DUPLICATE, EXCLUDED = "duplicate", "excluded"

ITEM = f"'{make_item_id(RECORDING, '')}' || "
"""SQL that makes the item of a content from its hash, which follows."""
ANALYSED_SQL = f"IN {ANALYSED!r}"
HAS_CONTENT = f"source_sha256 IS NOT NULL AND status NOT IN ('{DUPLICATE}', '{PENDING}')"
"""SQL condition on known rows: they say what reading their content gave."""
_PLAIN = "substr({}, 1, 64)"
"""SQL for the SHA-256 of a file, without the mark that tells ways of reading it apart."""


# --- decisions --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Look:
    """A raw file as it was found tonight. `problem` says why its content could not be had (`sha256` is None then),
    `pending` that this will pass."""

    path: str
    sha256: str | None
    problem: str | None = None
    pending: bool = False


@dataclass(frozen=True, slots=True)
class Place:
    """Where a content lies.

    Parameters
    ----------
    path : the place whose mapping and rig count
    look : place of tonight's look to read it from, among those given
    at_home : that look is at `path`
    """

    path: str
    look: int
    at_home: bool


@dataclass(frozen=True, slots=True)
class Reading:
    """What reading a content gave, tonight or earlier: status is ok, damaged or quarantined."""

    recording_id: str | None
    status: str
    problem: str | None


@dataclass(frozen=True, slots=True)
class Claim:
    """A content that says it is a certain recording.

    Parameters
    ----------
    sha256, path : of the content
    status : of its reading
    owns : it has results in the lab
    seen : tonight's looks found it somewhere
    order : its place in tonight's order; contents that were not looked at come first
    successor : the content that was found tonight at its path
    recording_id : as this content spells it
    """

    sha256: str
    path: str
    status: str
    owns: bool
    seen: bool
    order: tuple[int, str]
    successor: str | None
    recording_id: str = ""


@dataclass(frozen=True)
class Verdict:
    """Who gets a recording id: the contents that are refused it, each with the reason, and those to be forgotten."""

    refused: Mapping[str, RefusedError]
    superseded: frozenset[str]


@dataclass(frozen=True, slots=True)
class Row:
    """What a row of `recordings` has to say about one file and one content."""

    source_path: str
    source_sha256: str | None
    status: str
    problem: str | None
    recording_id: str | None
    source_present: bool


def choose_place(paths: Sequence[str], home: str | None, still_there: Callable[[str], bool]) -> Place:
    """Where a content lies that was found tonight at `paths`, shortest first, since copies mostly have longer names.

    It keeps the place it was first found at while it is there (`still_there` answers for places outside of tonight's
    folders); it moves to tonight's first place otherwise.
    """
    if home in paths:
        look = paths.index(home)
        return Place(paths[look], look, True)
    if home is not None and still_there(home):
        return Place(home, 0, False)
    return Place(paths[0], 0, True)


def recall_reading(recording_id: str | None, status: str, problem: str | None, outcome: str | None) -> Reading:
    """What reading a content gave that is as an earlier night left it: its row, and the outcome of its item."""
    if outcome in USABLE:
        return Reading(recording_id, outcome, problem)
    if status in ANALYSED:
        return Reading(recording_id, status if status in USABLE else OK, problem)
    return Reading(recording_id, QUARANTINED, problem)


def judge_claims(recording_id: str, claims: Sequence[Claim]) -> Verdict:
    """Gives a recording id to one of the contents that claim it.

    The content that has it already keeps it; among new ones the first in order. A damaged content gives way to one that
    has replaced it in its own file.
    """
    names = {one.sha256 for one in claims}
    superseded = frozenset(
        one.sha256 for one in claims if not one.seen and one.status == DAMAGED and one.successor in names - {one.sha256}
    )
    standing = [one for one in claims if one.sha256 not in superseded]
    owner = min(standing, key=lambda one: (not one.owns, one.order, one.sha256))
    refused = {one.sha256: _refuse_claim(recording_id, owner, one) for one in standing if one is not owner}
    return Verdict(refused, superseded)


def _refuse_claim(recording_id: str, owner: Claim, other: Claim) -> RefusedError:
    where = "this file's earlier content" if owner.path == other.path else f"{owner.path}"
    if owner.recording_id != other.recording_id:
        return RefusedError(
            f'recording_id "{other.recording_id}" differs by case only from "{owner.recording_id}" of {where},'
            " and the file system of this lab keeps one file for both",
            where=other.path,
            expected="ids that differ by more",
            remedy="Give this recording another id, or keep the lab where upper and lower case are told apart",
        )
    return RefusedError(
        f'recording_id "{recording_id}" belongs to other content already: {where} (SHA-256 {owner.sha256[:12]}…)',
        where=other.path,
        expected="one recording_id per recording",
        remedy="Give this recording an id of its own, or remove the file",
    )


def describe_look(look: Look, path: str | None, reading: Reading | None, excluded: Collection[str]) -> Row:
    """The row of a file that was looked at; `path` is the place of its content, where it has one."""
    if look.sha256 is None or reading is None:
        return Row(look.path, None, PENDING if look.pending else QUARANTINED, look.problem, None, True)
    if look.path != path:
        refused = "" if reading.status in USABLE else ", which was refused"
        problem = f"the same content as {path}{refused}"
        return Row(look.path, look.sha256, DUPLICATE, problem, reading.recording_id, True)
    return Row(look.path, look.sha256, _choose_status(reading, excluded), reading.problem, reading.recording_id, True)


def keep_row(
    row: Row, *, path_seen: bool, in_reach: bool, moved: bool, reading: Reading | None, excluded: Collection[str]
) -> Row | None:
    """A row of before that no look of tonight speaks of; None when it is to go.

    Parameters
    ----------
    path_seen : some file was found at its path tonight, with another content
    in_reach : its path was looked at, or lies below a folder that was looked through
    moved : its content was found tonight and lies elsewhere now
    reading : of its content, where it has results
    """
    if row.status in (DUPLICATE, PENDING) or row.source_sha256 is None:
        return None if in_reach else row
    if moved:
        return None
    gone = replace(row, source_present=row.source_present and not in_reach)
    if row.status not in ANALYSED or reading is None:
        return None if path_seen else gone
    return replace(gone, status=_choose_status(reading, excluded))


def _choose_status(reading: Reading, excluded: Collection[str]) -> str:
    if reading.status in USABLE and reading.recording_id in excluded:
        return EXCLUDED
    return reading.status


# --- who meets whom ---------------------------------------------------------------------------------------------------


def place_contents(ledger: Ledger, still_there: Callable[[str], bool]) -> None:
    """Fills `contents`: those that were found tonight, and those with results that were not."""
    looks = ledger.each(
        "SELECT sha256, path, id,"
        f" (SELECT source_path FROM known WHERE source_sha256 = l.sha256 AND {HAS_CONTENT} ORDER BY rowid DESC LIMIT 1)"
        " FROM looks l WHERE sha256 IS NOT NULL ORDER BY sha256, length(path), path"
    )
    groups = ((sha256, list(group)) for sha256, group in itertools.groupby(looks, itemgetter(0)))
    ledger.add("contents", (_locate_content(sha256, group, still_there) for sha256, group in groups))
    ledger.run(f"INSERT OR IGNORE INTO contents {_select_unseen('true')}")


def _locate_content(
    sha256: str, looks: Sequence[tuple[Any, ...]], still_there: Callable[[str], bool]
) -> tuple[Any, ...]:
    paths = [path for _, path, _, _ in looks]
    at = choose_place(paths, looks[0][3], still_there)
    return sha256, at.path, looks[at.look][2], at.at_home, len(paths[0]), paths[0]


def _select_unseen(condition: str) -> str:
    """The contents of known results as if nobody had looked at them."""
    return (
        "SELECT source_sha256, source_path, NULL, 0, -1, '' FROM known"
        f" WHERE source_sha256 IS NOT NULL AND status {ANALYSED_SQL} AND {condition} ORDER BY rowid DESC"
    )


def set_aside(ledger: Ledger, aside: Mapping[str, str]) -> None:
    """Contents of which nothing could be learnt, and why: their files are pending, earlier results stay as they are."""
    for sha256, reason in aside.items():
        for look, place in list(ledger.each("SELECT id, place FROM looks WHERE sha256 = ?", [sha256])):
            problem = str(PendingError(reason, where=Path(os.fsdecode(place)).name))
            ledger.run("UPDATE looks SET sha256 = NULL, problem = ?, pending = 1 WHERE id = ?", [problem, look])
        ledger.run("DELETE FROM contents WHERE sha256 = ?", [sha256])
        ledger.run(f"INSERT OR IGNORE INTO contents {_select_unseen('source_sha256 = ?')}", [sha256])


def collect_readings(ledger: Ledger, *, one_case: bool = False) -> None:
    """Fills `readings`: what each content gave, as far as it has been read, and who owns which recording id.

    With `one_case` ids that differ by case only are one: their samples would be one file.
    """
    spelt = "lower(recording_id)" if one_case else "recording_id"
    ledger.run("DELETE FROM readings")
    ledger.run("DELETE FROM superseded")
    ledger.run("DELETE FROM judged")
    ledger.add("readings", _list_readings(ledger))
    # A file whose mapping reads other columns or rows now: what it read before goes, unless a copy still reads it.
    ledger.run(
        "INSERT INTO superseded SELECT DISTINCT source_sha256 FROM known k WHERE EXISTS (SELECT 1 FROM looks l"
        f" WHERE l.path = k.source_path AND l.sha256 <> k.source_sha256 AND {_PLAIN.format('l.sha256')} ="
        f" {_PLAIN.format('k.source_sha256')}) AND NOT EXISTS (SELECT 1 FROM looks WHERE sha256 = k.source_sha256)"
    )
    ledger.run("DELETE FROM readings WHERE sha256 IN (SELECT sha256 FROM superseded)")
    conflicts = ledger.each(
        f"SELECT {spelt}, r.sha256, path, status, look IS NOT NULL, length, first,"
        f" EXISTS (SELECT 1 FROM known WHERE source_sha256 = r.sha256 AND status {ANALYSED_SQL}),"
        " (SELECT sha256 FROM looks WHERE looks.path = c.path AND sha256 IS NOT NULL), recording_id"
        " FROM readings r JOIN contents c USING (sha256)"
        f" WHERE accepted AND {spelt} IN (SELECT {spelt} FROM readings WHERE accepted GROUP BY 1 HAVING count(*) > 1)"
        " ORDER BY 1"
    )
    for recording_id, group in itertools.groupby(conflicts, itemgetter(0)):
        verdict = judge_claims(recording_id, [_make_claim(row) for row in group])
        ledger.add("superseded", ((sha256,) for sha256 in verdict.superseded))
        ledger.add("judged", ((sha, str(error), json.dumps(error.as_dict())) for sha, error in verdict.refused.items()))
    ledger.run("DELETE FROM readings WHERE sha256 IN (SELECT sha256 FROM superseded)")
    ledger.run(
        f"UPDATE readings SET status = '{QUARANTINED}', accepted = 0, (problem, refusal) ="
        " (SELECT problem, refusal FROM judged WHERE judged.sha256 = readings.sha256)"
        " WHERE sha256 IN (SELECT sha256 FROM judged)"
    )


def _list_readings(ledger: Ledger) -> Iterator[tuple[Any, ...]]:
    found = ledger.each(
        "SELECT c.sha256, o.item_id, o.recording_id, o.status, o.problem, o.refusal,"
        " k.recording_id, k.status, k.problem, i.outcome"
        f" FROM contents c LEFT JOIN outcomes o ON o.done AND o.item_id = {ITEM} c.sha256"
        " LEFT JOIN known k ON k.rowid ="
        f" (SELECT max(rowid) FROM known WHERE source_sha256 = c.sha256 AND {HAS_CONTENT})"
        f" LEFT JOIN items i ON i.item_id = {ITEM} c.sha256"
    )
    for sha256, item, *row in found:
        if item is not None:
            reading, refusal = Reading(*row[:3]), row[3]
        else:
            reading, refusal = recall_reading(*row[4:]), None
        yield sha256, reading.recording_id, reading.status, reading.problem, refusal, reading.status in USABLE


def _make_claim(row: tuple[Any, ...]) -> Claim:
    _, sha256, path, status, seen, length, first, owns, successor, recording_id = row
    return Claim(sha256, path, status, bool(owns), bool(seen), (length, first), successor, recording_id)


def write_rows(ledger: Ledger, roots: Sequence[str], excluded: Collection[str]) -> None:
    """Fills `rows`: all that `recordings` has to have after tonight, `changed` where that is not what is published.

    Then `standing`: the items of their contents and those of the later stages.
    """
    ledger.add("rows", _list_rows_of_looks(ledger, excluded))
    ledger.add("rows", _list_earlier_rows(ledger, roots, excluded))
    ledger.run(
        f"INSERT INTO standing SELECT DISTINCT {ITEM} source_sha256,"
        " EXISTS (SELECT 1 FROM readings r WHERE r.accepted AND r.sha256 = source_sha256)"
        " FROM rows WHERE source_sha256 IS NOT NULL"
    )
    ledger.run("INSERT INTO standing SELECT item_id, 1 FROM derived")


def _list_rows_of_looks(ledger: Ledger, excluded: Collection[str]) -> Iterator[tuple[Any, ...]]:
    found = ledger.each(
        "SELECT l.id, l.path, l.sha256, l.problem, l.pending, c.path, r.recording_id, r.status, r.problem,"
        f" EXISTS (SELECT 1 FROM outcomes WHERE done AND item_id = {ITEM} l.sha256),"
        " k.rowid, k.status, k.problem, k.recording_id, k.source_present, k.run_id"
        " FROM looks l LEFT JOIN contents c ON c.sha256 = l.sha256 LEFT JOIN readings r ON r.sha256 = l.sha256"
        " LEFT JOIN known k ON k.source_path = l.path AND k.source_sha256 IS l.sha256"
    )
    for look, path, sha256, problem, pending, home, *rest in found:
        reading = None if rest[1] is None else Reading(*rest[:3])
        row = describe_look(Look(path, sha256, problem, bool(pending)), home, reading, excluded)
        yield _make_row(row, look, bool(rest[3]), rest[4:])


def _list_earlier_rows(ledger: Ledger, roots: Sequence[str], excluded: Collection[str]) -> Iterator[tuple[Any, ...]]:
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
        recording_id, status, problem, path_seen, moved, again, *before = rest
        _, old_status, old_problem, old_id, present, _ = before
        row = keep_row(
            Row(path, sha256, old_status, old_problem, old_id, bool(present)),
            path_seen=bool(path_seen),
            in_reach=bool(path_seen) or any(is_below(path, root) for root in roots),
            moved=bool(moved),
            reading=None if status is None else Reading(recording_id, status, problem),
            excluded=excluded,
        )
        if row is not None:
            yield _make_row(row, None, bool(again), before)


def _make_row(row: Row, look: int | None, again: bool, before: Sequence[Any]) -> tuple[Any, ...]:
    """A row for the ledger. `before` is the published row of the same file and content, its rowid NULL without one."""
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
