"""The night's ledger: what is known of each raw file, content and result while a night is at work, in a private file.

So the memory of a night does not grow with the number of recordings. The file lies in the lab's work folder, belongs to
one process and one night, and is removed with it: what outlives a killed night is the journal. Does not belong here:
what is decided from the tables (`pipeline.nightly.ownership`).
"""

from __future__ import annotations

import contextlib
import itertools
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.analyse.description import join_texts
from pipeline.lab.journal import Outcome, entry_name
from pipeline.lab.lab import Lab
from pipeline.lab.reader import open_published
from schemas.errors import LabError

_AT_ONCE = 500
"""Rows that are in memory at a time, on their way in or out."""
_CACHE_KB = 2048

_LEARNT: Mapping[str, tuple[str, ...]] = {
    "recordings": (
        "recording_id",
        "specimen_id",
        "rig_id",
        "source_path",
        "source_sha256",
        "samples_path",
        "status",
        "problem",
        "run_id",
        "source_present",
    ),
    "items": ("item_id", "stage", "input_hash", "code_version", "settings_hash", "outcome", "error"),
    "files": ("path", "size", "mtime_ns", "inode", "sha256"),
    "carried": ("recording_id", "kind"),
    "accidents": ("item_id", "stage", "source_path", "reason", "nights", "first_run_id", "run_id"),
}
"""Tables of the snapshot that a night wants, and their columns in the order that the ledger has as well."""
_BOOKED = {"recordings": "known", "accidents": "earlier_accidents"}
"""The ledger's name of a table, where it is another."""
_ACCIDENTS = (
    "item_id TEXT PRIMARY KEY, stage TEXT, source_path TEXT, reason TEXT, nights INTEGER,"
    " first_run_id TEXT, run_id TEXT"
)

TABLES: Mapping[str, str] = {
    # What the lab knew before tonight: from the published snapshot.
    "known": (
        "recording_id TEXT, specimen_id TEXT, rig_id TEXT, source_path TEXT, source_sha256 TEXT, samples_path TEXT,"
        " status TEXT, problem TEXT, run_id TEXT, source_present INTEGER"
    ),
    "items": (
        "item_id TEXT PRIMARY KEY, stage TEXT, input_hash TEXT, code_version TEXT, settings_hash TEXT, outcome TEXT,"
        " error TEXT"
    ),
    "files": "path TEXT PRIMARY KEY, size INTEGER, mtime_ns INTEGER, inode INTEGER, sha256 TEXT",
    "carried": "recording_id TEXT, kind TEXT, PRIMARY KEY (recording_id, kind)",
    "earlier_accidents": _ACCIDENTS,
    # Tonight's accidents, with how many nights they have happened in a row.
    "accidents": _ACCIDENTS,
    # What is made: outcomes in the journal, `done` where they are tonight's or still good. Kinds of results stand in
    # one text, a comma between two.
    "outcomes": (
        "item_id TEXT PRIMARY KEY, stage TEXT, input_hash TEXT, code_version TEXT, settings_hash TEXT, outcome TEXT,"
        " seconds REAL, error TEXT, recording_id TEXT, specimen_id TEXT, rig_id TEXT, status TEXT, problem TEXT,"
        " samples_path TEXT, refusal TEXT, carried TEXT, notes TEXT, entry TEXT UNIQUE, done INTEGER"
    ),
    # Tonight's files. `size` to `inode` as the file was when it was looked at; `settled` where they are to be
    # remembered; `reads` is a hash of what the mapping reads of the content.
    "reached": "place TEXT PRIMARY KEY",
    "looks": (
        "id INTEGER PRIMARY KEY, path TEXT, place BLOB, root BLOB, found_size INTEGER, found_mtime_ns INTEGER,"
        " format TEXT, state TEXT, url TEXT, name TEXT, version INTEGER, whole INTEGER, part TEXT, mapping TEXT,"
        " size INTEGER, mtime_ns INTEGER, inode INTEGER, sha256 TEXT, problem TEXT, refusal TEXT,"
        " pending INTEGER, settled INTEGER, reads TEXT"
    ),
    # Items and what making them now would make them from, until it is found which of them are fresh.
    "expected": "item_id TEXT, stage TEXT, input_hash TEXT",
    # Who owns what. `look` is tonight's look to read a content from, NULL for one that was not looked at; `at_home`
    # where that look is at the place which counts. Contents come in the order of `length` and `first`, those not looked
    # at before all others.
    "contents": "sha256 TEXT PRIMARY KEY, path TEXT, look INTEGER, at_home INTEGER, length INTEGER, first TEXT",
    "stale": "sha256 TEXT PRIMARY KEY",
    "readings": "sha256 TEXT PRIMARY KEY, recording_id TEXT, status TEXT, problem TEXT, refusal TEXT, accepted INTEGER",
    "judged": "sha256 TEXT PRIMARY KEY, problem TEXT, refusal TEXT",
    "superseded": "sha256 TEXT PRIMARY KEY",
    "rows": (
        "source_path TEXT, source_sha256 TEXT, status TEXT, problem TEXT, recording_id TEXT, source_present INTEGER,"
        " look INTEGER, changed INTEGER, run_id TEXT"
    ),
    # Files that are passed over, or have no mapping, and why: their items say it.
    "passed": "item_id TEXT PRIMARY KEY, outcome TEXT, line TEXT",
    # Items that there have to be after tonight, and whether their results are in the lab.
    "standing": "item_id TEXT PRIMARY KEY, results INTEGER",
    # What goes from the snapshot: results of recordings by id (`what` is recording_id), items by stage.
    "going": "what TEXT, name TEXT",
    # The later stages.
    "included": (
        "recording_id TEXT PRIMARY KEY, specimen_id TEXT, rig_id TEXT, kinds TEXT, calibrates INTEGER, input_hash TEXT,"
        " code_version TEXT, settings_hash TEXT, entry TEXT"
    ),
    "derived": "item_id TEXT PRIMARY KEY, stage TEXT, input_hash TEXT, members INTEGER",
}
"""Every table by name. All but `looks`, whose ids are given out by it, take rows as wide as they are."""

_INDEXES = (
    "known_content ON known (source_sha256)",
    "known_place ON known (source_path, source_sha256)",
    "looks_content ON looks (sha256)",
    "looks_path ON looks (path)",
    "readings_of_id ON readings (recording_id)",
    "rows_content ON rows (source_sha256)",
    "rows_place ON rows (source_path, source_sha256)",
    "included_specimen ON included (specimen_id, recording_id)",
    "included_rig ON included (rig_id, calibrates)",
)


class Ledger:
    """The tables of a night; one connection, one thread. A context manager: the file is gone when it ends.

    Raises `LabError` where the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._connection: sqlite3.Connection

    def __enter__(self) -> Ledger:
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._path.unlink(missing_ok=True)  # a killed night's
            self._connection = sqlite3.connect(self._path, isolation_level=None)
        except (OSError, sqlite3.Error) as error:
            raise self._unwritable(error) from error
        # Nobody else reads it and nothing has to outlive the night: no journal, one transaction that never ends.
        for setting in (
            "journal_mode = OFF",
            "synchronous = OFF",
            "locking_mode = EXCLUSIVE",
            f"cache_size = -{_CACHE_KB}",
        ):
            self._connection.execute(f"PRAGMA {setting}")
        self.run("BEGIN")
        for name, columns in TABLES.items():
            self.run(f"CREATE TABLE {name} ({columns})")
        for index in _INDEXES:
            self.run(f"CREATE INDEX {index}")
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()
        self._path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):  # the journal is there: a later night takes it up
            self._path.parent.rmdir()

    def run(self, statement: str, values: Sequence[Any] = ()) -> int:
        """Executes a statement; the number of rows that it changed."""
        return self._execute(statement, values).rowcount

    def add(self, table: str, rows: Iterable[Sequence[Any]]) -> None:
        """Puts rows into a table, whole ones in the order of its columns; of the same key the later one stays."""
        for some in split(rows):
            marks = ", ".join("?" * len(some[0]))
            try:
                self._connection.executemany(f"INSERT OR REPLACE INTO {table} VALUES ({marks})", some)
            except sqlite3.Error as error:
                raise self._unwritable(error) from error

    def each(self, query: str, values: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]:
        """The rows of a query, one by one. Rows that it has yet to come to must not be changed meanwhile."""
        cursor = self._execute(query, values)
        while True:
            try:
                some = cursor.fetchmany(_AT_ONCE)
            except sqlite3.Error as error:
                raise self._unwritable(error) from error
            if not some:
                return
            yield from some

    def row(self, query: str, values: Sequence[Any] = ()) -> tuple[Any, ...] | None:
        """The first row of a query."""
        return next(self._execute(query, values), None)

    def number(self, query: str, values: Sequence[Any] = ()) -> int:
        """The one number that a query gives."""
        found = self.row(query, values)
        return 0 if found is None or found[0] is None else int(found[0])

    def _execute(self, statement: str, values: Sequence[Any]) -> sqlite3.Cursor:
        try:
            return self._connection.execute(statement, values)
        except sqlite3.Error as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: Exception) -> LabError:
        return LabError(
            f"the lab cannot be written: {error}",
            where=str(self._path.parent),
            remedy="Free disk space or permissions and run the nightly again; what is finished is kept",
        )


def split(rows: Iterable[Any], size: int = _AT_ONCE) -> Iterator[list[Any]]:
    """The rows in lists of a size that fits in memory."""
    waiting = iter(rows)
    while some := list(itertools.islice(waiting, size)):
        yield some


def learn_lab(lab: Lab, ledger: Ledger) -> int:
    """Books what a lab knows; returns the number of its last run, 0 where nothing has been published.

    Raises `LabError` for an unreadable database.
    """
    with open_published(lab.database) as reader:
        if reader is None:
            return 0
        for name, columns in _LEARNT.items():
            ledger.add(_BOOKED.get(name, name), reader.values(name, columns))
        runs = [int(row["run_id"]) for row in reader.each("runs", ("run_id",)) if str(row["run_id"]).isdigit()]
    return max(runs, default=0)


def book_outcomes(ledger: Ledger, outcomes: Iterable[Outcome], *, done: bool) -> None:
    """Books outcomes whose entries lie in the journal; `done` where they are tonight's."""
    ledger.add("outcomes", (_make_row(outcome, done) for outcome in outcomes))


def book_accident(ledger: Ledger, outcome: Outcome, run_id: str) -> str:
    """Books that trouble of the machine ended an item; returns that in words, with how often it has now."""
    place = outcome.facts.get("source_path")
    before = ledger.row("SELECT nights, first_run_id FROM earlier_accidents WHERE item_id = ?", [outcome.item_id])
    nights, first = (1, run_id) if before is None else (before[0] + 1, before[1])
    row = (outcome.item_id, outcome.stage, place, outcome.error, nights, first, run_id)
    ledger.add("accidents", [row])
    return describe_accident(outcome.error or "", nights)


def describe_accident(reason: str, nights: int) -> str:
    """An accident in words."""
    often = "" if nights == 1 else f", {nights} nights in a row"
    return f"an accident of the night{often}, no verdict: {reason}; the next nightly tries it again"


def _make_row(outcome: Outcome, done: bool) -> tuple[Any, ...]:
    facts = outcome.facts
    refusal = facts.get("refusal")
    return (
        outcome.item_id,
        outcome.stage,
        outcome.freshness.input_hash,
        outcome.freshness.code_version,
        outcome.freshness.settings_hash,
        outcome.outcome,
        outcome.seconds,
        outcome.error,
        *(facts.get(name) for name in ("recording_id", "specimen_id", "rig_id", "status", "problem", "samples_path")),
        None if refusal is None else json.dumps(refusal),
        ",".join(sorted(facts.get("carried", ()))),
        join_texts(facts.get("notes", ())),
        entry_name(outcome.item_id),
        done,
    )
