"""The night's decisions on recordings, as pure functions: where a content lies, who owns a recording id, what each row says.

Identity is content: the same bytes again are a duplicate, the same recording id with other bytes is a conflict and the
first stays. Each function decides about one content, one recording id or one row, whatever else there is. Does not belong
here: who meets whom (`pipeline.nightly.planning`), reading files, the database, processes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from pipeline.lab.checks import ANALYSED
from pipeline.lab.journal import DAMAGED, OK, PENDING, QUARANTINED, USABLE
from schemas.errors import RefusedError

DUPLICATE, EXCLUDED = "duplicate", "excluded"


@dataclass(frozen=True, slots=True)
class Look:
    """A raw file as it was found tonight. `problem` says why its content could not be had (`sha256` is None then),
    `pending` that this will pass."""

    path: str
    sha256: str | None
    problem: str | None = None
    pending: bool = False


@dataclass(frozen=True, slots=True)
class Placed:
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
class Candidate:
    """A content that says it is a certain recording.

    Parameters
    ----------
    sha256, path : of the content
    status : of its reading
    owns : it has results in the lab
    looked : tonight's looks found it somewhere
    order : its place in tonight's order; contents that were not looked at come first
    successor : the content that was found tonight at its path
    """

    sha256: str
    path: str
    status: str
    owns: bool
    looked: bool
    order: tuple[int, str]
    successor: str | None


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


def placed(paths: Sequence[str], home: str | None, still_there: Callable[[str], bool]) -> Placed:
    """Where a content lies that was found tonight at `paths`, shortest first, since copies mostly have longer names.

    It keeps the place it was first found at while it is there (`still_there` answers for places outside of tonight's
    folders); it moves to tonight's first place otherwise.
    """
    if home in paths:
        look = paths.index(home)
        return Placed(paths[look], look, True)
    if home is not None and still_there(home):
        return Placed(home, 0, False)
    return Placed(paths[0], 0, True)


def reading_before(recording_id: str | None, status: str, problem: str | None, outcome: str | None) -> Reading:
    """What reading a content gave that is as an earlier night left it: its row, and the outcome of its item."""
    if outcome in USABLE:
        return Reading(recording_id, outcome, problem)
    if status in ANALYSED:
        return Reading(recording_id, status if status in USABLE else OK, problem)
    return Reading(recording_id, QUARANTINED, problem)


def judge(recording_id: str, candidates: Sequence[Candidate]) -> Verdict:
    """Gives a recording id to one of the contents that claim it.

    The content that has it already keeps it; among new ones the first in order. A damaged content gives way to one that
    has replaced it in its own file.
    """
    names = {one.sha256 for one in candidates}
    superseded = frozenset(
        one.sha256
        for one in candidates
        if not one.looked and one.status == DAMAGED and one.successor in names - {one.sha256}
    )
    standing = [one for one in candidates if one.sha256 not in superseded]
    owner = min(standing, key=lambda one: (not one.owns, one.order, one.sha256))
    refused = {one.sha256: _conflict(recording_id, owner, one) for one in standing if one is not owner}
    return Verdict(refused, superseded)


def _conflict(recording_id: str, owner: Candidate, other: Candidate) -> RefusedError:
    where = "this file's earlier content" if owner.path == other.path else f"{owner.path}"
    return RefusedError(
        f'recording_id "{recording_id}" belongs to other content already: {where} (SHA-256 {owner.sha256[:12]}…)',
        where=other.path,
        expected="one recording_id per recording",
        remedy="Give this recording an id of its own, or remove the file",
    )


def row_of(look: Look, path: str | None, reading: Reading | None, excluded: Collection[str]) -> Row:
    """The row of a file that was looked at; `path` is the place of its content, where it has one."""
    if look.sha256 is None or reading is None:
        return Row(look.path, None, PENDING if look.pending else QUARANTINED, look.problem, None, True)
    if look.path != path:
        refused = "" if reading.status in USABLE else ", which was refused"
        problem = f"the same content as {path}{refused}"
        return Row(look.path, look.sha256, DUPLICATE, problem, reading.recording_id, True)
    return Row(look.path, look.sha256, _status(reading, excluded), reading.problem, reading.recording_id, True)


def kept(
    row: Row, *, path_looked: bool, looked_for: bool, moved: bool, reading: Reading | None, excluded: Collection[str]
) -> Row | None:
    """A row of before that no look of tonight speaks of; None when it is to go.

    Parameters
    ----------
    path_looked : some file was found at its path tonight, with another content
    looked_for : its path was looked at, or lies below a folder that was looked through
    moved : its content was found tonight and lies elsewhere now
    reading : of its content, where it has results
    """
    if row.status in (DUPLICATE, PENDING) or row.source_sha256 is None:
        return None if looked_for else row
    if moved:
        return None
    gone = replace(row, source_present=row.source_present and not looked_for)
    if row.status not in ANALYSED or reading is None:
        return None if path_looked else gone
    return replace(gone, status=_status(reading, excluded))


def _status(reading: Reading, excluded: Collection[str]) -> str:
    if reading.status in USABLE and reading.recording_id in excluded:
        return EXCLUDED
    return reading.status
