"""What a build knows of each item, page and file while it is at work, in a private file: its memory does not grow with them.

SQLite makes the file where temporary files are and removes its name at once, so nothing is left of it, not even by a kill.
Does not belong here: what the tables mean to the site (`reports.site`), the plan (`reports.plan`) and the manifest.
"""

from __future__ import annotations

import itertools
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

from schemas.errors import LabError

AT_ONCE = 500
"""Rows that are in memory at a time, on their way in or out."""
_CACHE_KB = 2048

_TABLES: Mapping[str, str] = {
    # Which items have a page (`reports.site`).
    "recordings": "recording_id TEXT PRIMARY KEY, specimen_id TEXT, kind TEXT",
    "specimens": "specimen_id TEXT PRIMARY KEY",
    # Values of a column that pages ask about before they ask for its rows.
    "there": "what TEXT, value TEXT, PRIMARY KEY (what, value)",
    "digests": "kind TEXT, item TEXT, digest TEXT, PRIMARY KEY (kind, item)",
    # Pages that are to be, in the order in which they are made.
    "pages": "place INTEGER PRIMARY KEY, path TEXT UNIQUE, kind TEXT, item TEXT, digest TEXT",
    # What the last manifest says, and what is below the reports' folder.
    "known": "path TEXT PRIMARY KEY, digest TEXT",
    "data": "page TEXT, path TEXT, PRIMARY KEY (page, path)",
    "found": "path TEXT PRIMARY KEY",
    "stale": "place INTEGER PRIMARY KEY",
}
_WITH_ROWID = ("pages", "stale")


class Ledger:
    """The tables of a build; one connection, one thread. Raises `LabError` where there is no room for them."""

    def __init__(self) -> None:
        self._connection = sqlite3.connect("", isolation_level=None)
        self._connection.create_function("casefold", 1, str.casefold, deterministic=True)
        # Nobody else reads it and nothing has to outlive the build: no journal, one transaction that never ends.
        for setting in ("journal_mode = OFF", "synchronous = OFF", "temp_store = FILE", f"cache_size = -{_CACHE_KB}"):
            self._connection.execute(f"PRAGMA {setting}")
        self.run("BEGIN")
        for name, columns in _TABLES.items():
            self.run(f"CREATE TABLE {name} ({columns}){'' if name in _WITH_ROWID else ' WITHOUT ROWID'}")
        self._filled: dict[str, bool] = {}

    def close(self) -> None:
        self._connection.close()

    def run(self, statement: str, values: Sequence[Any] = ()) -> int:
        """Executes a statement; the number of rows that it changed."""
        return self._execute(statement, values).rowcount

    def add(self, table: str, rows: Iterable[Sequence[Any]]) -> None:
        """Puts rows into a table, whole ones in the order of its columns; of the same key the later one stays."""
        for some in batches(rows):
            marks = ", ".join("?" * len(some[0]))
            try:
                self._connection.executemany(f"INSERT OR REPLACE INTO {table} VALUES ({marks})", some)
            except sqlite3.Error as error:
                raise _full(error) from error

    def each(self, query: str, values: Sequence[Any] = ()) -> Iterator[tuple[Any, ...]]:
        """The rows of a query, one by one. Rows that it has yet to come to must not be changed meanwhile."""
        cursor = self._execute(query, values)
        while True:
            try:
                some = cursor.fetchmany(AT_ONCE)
            except sqlite3.Error as error:
                raise _full(error) from error
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

    def has(self, what: str, value: str, values: Callable[[], Iterable[str]]) -> bool:
        """The value is one of `values`, which are asked for once, at the first question about `what`."""
        if what not in self._filled:
            self.add("there", ((what, one) for one in values()))
            self._filled[what] = self.row("SELECT 1 FROM there WHERE what = ? LIMIT 1", (what,)) is not None
        if not self._filled[what]:
            return False
        return self.row("SELECT 1 FROM there WHERE what = ? AND value = ?", (what, value)) is not None

    def _execute(self, statement: str, values: Sequence[Any]) -> sqlite3.Cursor:
        try:
            return self._connection.execute(statement, values)
        except sqlite3.Error as error:
            raise _full(error) from error


def batches(rows: Iterable[Any], size: int = AT_ONCE) -> Iterator[list[Any]]:
    """The same in lists of a size that fits in memory."""
    waiting = iter(rows)
    while some := list(itertools.islice(waiting, size)):
        yield some


def _full(error: sqlite3.Error) -> LabError:
    return LabError(
        f"what the report notes while it is made cannot be written: {error}",
        remedy="Free space where temporary files are kept (TMPDIR) and make the report again",
    )
