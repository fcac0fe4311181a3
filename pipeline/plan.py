"""The night's decisions on recordings, as pure functions: what is new, who owns a recording id, what each row says.

Identity is content: the same bytes again are a duplicate, the same recording id with other bytes is a conflict and the
first stays. Does not belong here: reading files, the database, processes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from ingest.discover import SourceFile
from pipeline.paths import below
from pipeline.store.checks import ANALYSED
from pipeline.store.journal import DAMAGED, PENDING, QUARANTINED, USABLE
from pipeline.store.manifest import KnownRecording
from schemas.errors import DealabError, RefusedError

DUPLICATE, EXCLUDED = "duplicate", "excluded"


@dataclass(frozen=True, slots=True)
class Look:
    """A raw file as it was found tonight. `error` says why its content could not be had (`sha256` is None then)."""

    source: SourceFile
    path: str
    sha256: str | None
    error: DealabError | None = None


@dataclass(frozen=True, slots=True)
class Content:
    """One content, wherever it lies.

    Parameters
    ----------
    sha256 : of the content
    path : the place whose mapping and rig count
    looks : tonight's looks at it, the primary one first; empty for contents that were not looked at
    order : place in tonight's order, −1 for contents that were not looked at
    """

    sha256: str
    path: str
    looks: tuple[Look, ...]
    order: int

    @property
    def primary(self) -> Look | None:
        """Tonight's look at its own place; None when that was not looked at."""
        return self.looks[0] if self.looks and self.looks[0].path == self.path else None


@dataclass(frozen=True, slots=True)
class Reading:
    """What reading a content gave, tonight or earlier.

    `status` is ok, damaged or quarantined; `refusal` is the error behind `problem` where the content was refused tonight.
    """

    recording_id: str | None
    status: str
    problem: str | None
    refusal: DealabError | None = None


@dataclass(frozen=True, slots=True)
class Row:
    """What a row of `recordings` has to say about one file and one content."""

    source_path: str
    source_sha256: str | None
    status: str
    problem: str | None
    recording_id: str | None
    source_present: bool

    @property
    def key(self) -> tuple[str, str | None]:
        return self.source_path, self.source_sha256


def contents(
    looks: Sequence[Look], known: Iterable[KnownRecording], still_there: Callable[[str], bool]
) -> dict[str, Content]:
    """The contents that are looked at tonight, by hash.

    A content keeps the place it was first found at while it is there (`still_there` answers for places outside of
    tonight's folders); it moves to tonight's first place otherwise. Of several new places the shortest path comes first,
    since copies mostly have longer names.
    """
    homes = {
        row.source_sha256: row.source_path
        for row in known
        if row.source_sha256 is not None and row.status not in (DUPLICATE, PENDING)
    }
    found: dict[str, list[Look]] = {}
    for look in sorted(looks, key=lambda one: (len(one.path), one.path)):
        if look.sha256 is not None:
            found.setdefault(look.sha256, []).append(look)
    result = {}
    for order, (sha256, places) in enumerate(found.items()):
        home = homes.get(sha256)
        at_home = [look for look in places if look.path == home]
        if at_home:
            places = at_home + [look for look in places if look.path != home]
            path = places[0].path
        elif home is not None and still_there(home):
            path = home
        else:
            path = places[0].path
        result[sha256] = Content(sha256, path, tuple(places), order)
    return result


def unseen(known: Iterable[KnownRecording], seen: Collection[str]) -> dict[str, Content]:
    """Contents with results that were not looked at tonight; they keep their recording ids."""
    return {
        row.source_sha256: Content(row.source_sha256, row.source_path, (), -1)
        for row in known
        if row.source_sha256 is not None and row.source_sha256 not in seen and row.status in ANALYSED
    }


@dataclass(frozen=True)
class Verdicts:
    """Readings after identity: conflicts are quarantined, `superseded` contents are to be forgotten."""

    readings: Mapping[str, Reading]
    superseded: frozenset[str]

    def accepted(self, sha256: str) -> bool:
        """Whether a content has results of its own in the lab."""
        return self.readings[sha256].status in USABLE


def judge(readings: Mapping[str, Reading], places: Mapping[str, Content], known: Iterable[KnownRecording]) -> Verdicts:
    """Gives each recording id to one content.

    The content that has it already keeps it; among new ones the first in order. A damaged content gives way to one that
    has replaced it in its own file.
    """
    owners = {row.source_sha256 for row in known if row.status in ANALYSED}
    tonight = {look.path: sha for sha, content in places.items() for look in content.looks}
    candidates: dict[str, list[str]] = {}
    for sha256, reading in readings.items():
        if reading.status in USABLE and reading.recording_id is not None:
            candidates.setdefault(reading.recording_id, []).append(sha256)
    judged = dict(readings)
    superseded = set()
    for recording_id, shas in candidates.items():
        if len(shas) == 1:
            continue
        replaced = {
            sha
            for sha in shas
            if not places[sha].looks
            and readings[sha].status == DAMAGED
            and tonight.get(places[sha].path) in set(shas) - {sha}
        }
        superseded |= replaced
        standing = [sha for sha in shas if sha not in replaced]
        owner = min(standing, key=lambda sha: (sha not in owners, places[sha].order, sha))
        for sha in standing:
            if sha != owner:
                judged[sha] = _conflict(readings[sha], recording_id, places[owner], places[sha])
    return Verdicts({s: r for s, r in judged.items() if s not in superseded}, frozenset(superseded))


def _conflict(reading: Reading, recording_id: str, owner: Content, other: Content) -> Reading:
    where = "this file's earlier content" if owner.path == other.path else f"{owner.path}"
    problem = RefusedError(
        f'recording_id "{recording_id}" belongs to other content already: {where} (SHA-256 {owner.sha256[:12]}…)',
        where=other.path,
        expected="one recording_id per recording",
        remedy="Give this recording an id of its own, or remove the file",
    )
    return replace(reading, status=QUARANTINED, problem=str(problem), refusal=problem)


def rows(
    looks: Sequence[Look],
    places: Mapping[str, Content],
    verdicts: Verdicts,
    known: Sequence[KnownRecording],
    *,
    roots: Sequence[str],
    excluded: Collection[str],
) -> list[Row]:
    """All rows that `recordings` has to have after tonight."""
    found = [_row_of(look, places, verdicts, excluded) for look in looks]
    keys = {row.key for row in found}
    paths = {look.path for look in looks}
    for row in known:
        kept = _kept(row, keys, paths, places, verdicts, roots, excluded)
        if kept is not None:
            found.append(kept)
    return found


def _row_of(look: Look, places: Mapping[str, Content], verdicts: Verdicts, excluded: Collection[str]) -> Row:
    if look.sha256 is None:
        status = PENDING if look.error is not None and look.error.transient else QUARANTINED
        return Row(look.path, None, status, str(look.error), None, True)
    content, reading = places[look.sha256], verdicts.readings[look.sha256]
    if look.path != content.path:
        refused = "" if reading.status in USABLE else ", which was refused"
        problem = f"the same content as {content.path}{refused}"
        return Row(look.path, look.sha256, DUPLICATE, problem, reading.recording_id, True)
    return Row(look.path, look.sha256, _status(reading, excluded), reading.problem, reading.recording_id, True)


def _kept(
    row: KnownRecording,
    keys: Collection[tuple[str, str | None]],
    paths: Collection[str],
    places: Mapping[str, Content],
    verdicts: Verdicts,
    roots: Sequence[str],
    excluded: Collection[str],
) -> Row | None:
    """A row of before that no look of tonight speaks of; None when it is to go."""
    sha256 = row.source_sha256
    if (row.source_path, sha256) in keys or sha256 in verdicts.superseded:
        return None
    looked_for = row.source_path in paths or any(below(row.source_path, root) for root in roots)
    if row.status in (DUPLICATE, PENDING) or sha256 is None:
        return None if looked_for else _as_it_was(row, bool(row.source_present))
    content = places.get(sha256)
    if content is not None and content.looks and content.path != row.source_path:
        return None
    if row.status not in ANALYSED:
        return None if row.source_path in paths else _as_it_was(row, bool(row.source_present) and not looked_for)
    present = bool(row.source_present) and not looked_for
    status = _status(verdicts.readings[sha256], excluded)
    return Row(row.source_path, sha256, status, row.problem, row.recording_id, present)


def _as_it_was(row: KnownRecording, present: bool) -> Row:
    return Row(row.source_path, row.source_sha256, row.status, row.problem, row.recording_id, present)


def _status(reading: Reading, excluded: Collection[str]) -> str:
    if reading.status in USABLE and reading.recording_id in excluded:
        return EXCLUDED
    return reading.status
