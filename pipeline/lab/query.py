"""Read-only SQL on the published snapshot, and the samples of a recording in the same query.

Three locks, each enough alone for most of what could go wrong: the connection is read-only, the configuration is locked
with no access to files or the network, and the parser has to call the statement a SELECT, inside EXPLAIN and inside
every WITH as well (DuckDB lets a COPY or an INSERT stand there).
Samples reach DuckDB as Arrow data sets that are opened here, so that no query can name a file.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import queue
import re
import threading
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import pyarrow as pa

from pipeline.lab.lab import Lab
from schemas.database import REBUILD, connect
from schemas.errors import DealabError, LabError, UsageError

_READING_NODES = frozenset({"SELECT_NODE", "SET_OPERATION_NODE", "RECURSIVE_CTE_NODE", "CTE_NODE"})
_EXPLAIN = re.compile(r"(?:\s|--[^\n]*\n|/\*.*?\*/)*EXPLAIN\b(?:(?:\s|--[^\n]*\n|/\*.*?\*/)*ANALYZE\b)?", re.I | re.S)
_EXPLAIN_OPTIONS = re.compile(r"(?:\s|--[^\n]*\n|/\*.*?\*/)*\([^()]*\)")
_AT_ONCE = 100_000
"""Rows that are fetched together."""
_STOPPED_S = 2.0
"""How long a query may take to notice that it is to end."""
_LOCKED = {
    "python_enable_replacements": "false",
}


@dataclass(frozen=True)
class Limits:
    """What one query may take; 0 lifts a limit. Nothing is written to the disk, whatever a query needs.

    Parameters
    ----------
    seconds : time
    rows : rows of the result
    memory_mb : memory
    """

    seconds: float = 600.0
    rows: int = 10_000_000
    memory_mb: int = 4096


@contextlib.contextmanager
def _hear_interrupts() -> Iterator[None]:
    """Raises `KeyboardInterrupt` for what DuckDB makes of one that falls into a query here: an error of its own."""
    try:
        yield
    except RuntimeError as error:
        if str(error) == "Query interrupted":
            raise KeyboardInterrupt from None
        raise


class Query:
    """A locked connection to a lab's published snapshot; a context manager."""

    def __init__(self, lab: Lab, limits: Limits | None = None) -> None:
        self._lab, self._limits = lab, limits or Limits()
        self._connection: Any = None
        self._left_behind = False

    def __enter__(self) -> Self:
        import duckdb

        database = self._lab.require_database()
        try:
            self._connection = connect(database, **_LOCKED)
            self._connection.execute("SET TimeZone = 'UTC'")
            self._connection.execute("SET temp_directory = ''")
            if self._limits.memory_mb:
                self._connection.execute(f"SET memory_limit = '{self._limits.memory_mb}MiB'")
        except duckdb.Error as error:
            raise LabError(
                f"the database cannot be opened: {str(error).splitlines()[0]}",
                where=str(database),
                remedy=f"{self._lab.spell_command('doctor')} says more; a nightly over all raw folders builds it anew",
            ) from None
        return self

    def __exit__(self, *_: object) -> None:
        if not self._left_behind:  # DuckDB does not close what is at work, and says so with an error
            self._connection.close()

    def run(self, query: str) -> pa.Table:
        """The rows of one SELECT-type statement.

        Raises `UsageError` for what is no SELECT, `DealabError` with DuckDB's own words and pointer for a wrong query.
        """
        with _hear_interrupts():
            return self._run(query)

    def _run(self, query: str) -> pa.Table:
        import duckdb

        self._refuse_what_writes(query)
        try:
            self._offer_samples(query)
            self._connection.execute("SET enable_external_access = false")
            self._connection.execute("SET lock_configuration = true")
            return self._fetch_in_time(query)
        except duckdb.OutOfMemoryException as error:
            raise DealabError(
                f"the query needs more memory than it may take: {str(error).splitlines()[0]}",
                expected=f"at most {self._limits.memory_mb} MB",
                remedy="Select less, or allow more with --memory-mb",
            ) from None
        except duckdb.Error as error:
            raise DealabError(str(error).strip()) from None

    def _fetch_in_time(self, query: str) -> pa.Table:
        """The result, fetched in a thread, so that the clock and an interrupt reach a query that is at work."""
        ended: queue.SimpleQueue[pa.Table | BaseException] = queue.SimpleQueue()

        def fetch() -> None:
            result: pa.Table | BaseException
            try:
                result = self._fetch(query)
            except BaseException as error:
                result = error
            if self._left_behind:
                self._connection.close()
            ended.put(result)

        threading.Thread(target=fetch, daemon=True).start()
        try:
            result = ended.get(timeout=self._limits.seconds or None)
        except queue.Empty:
            self._stop(ended)
            raise DealabError(
                f"the query was stopped after {self._limits.seconds:g} s",
                remedy="Select less, or allow more with --timeout-s",
            ) from None
        except BaseException:
            self._stop(ended)
            raise
        if isinstance(result, BaseException):
            raise result
        return result

    def _stop(self, ended: queue.SimpleQueue[Any]) -> None:
        """Interrupts the query; one that takes no notice is left behind, and closes the connection when it ends."""
        self._left_behind = True
        self._connection.interrupt()
        with contextlib.suppress(queue.Empty):
            ended.get(timeout=_STOPPED_S)
            self._left_behind = False

    def _fetch(self, query: str) -> pa.Table:
        with warnings.catch_warnings():  # execute() makes one copy more than sql(), but its errors point at the place
            warnings.simplefilter("ignore", UserWarning)
            reader = self._connection.execute(query).to_arrow_reader(_AT_ONCE)
        batches, rows = [], 0
        with reader:  # one left open would keep the database open, and the next connection would wait for it
            for batch in reader:
                batches.append(batch)
                rows += batch.num_rows
                if self._limits.rows and rows > self._limits.rows:
                    break
            else:
                table = pa.Table.from_batches(batches, reader.schema)
                return table.rename_columns(_tell_apart(table.column_names))
        raise DealabError(
            f"the result has more than {self._limits.rows} rows", remedy="Select less, or allow more with --rows"
        )

    def _refuse_what_writes(self, query: str) -> None:
        import duckdb

        try:
            statements = self._connection.extract_statements(query)
        except duckdb.Error as error:
            raise DealabError(str(error).strip()) from None
        if len(statements) != 1:
            raise UsageError(f"{len(statements)} statements", expected="one SELECT statement")
        kind = statements[0].type.name
        inner = query
        if kind == "EXPLAIN":
            inner = self._find_explained(query)
        elif kind != "SELECT":
            remedy = "Name the columns of a PIVOT: PIVOT … ON column IN (…)" if kind == "MULTI" else ""
            raise UsageError(f"a {kind.replace('_', ' ')} statement", expected="a SELECT statement", remedy=remedy)
        self._refuse_writing_nodes(inner)

    def _find_explained(self, query: str) -> str:
        """The statement that an EXPLAIN explains, which has to be one of ours as well."""
        import duckdb

        prefix = _EXPLAIN.match(query)
        rest = "" if prefix is None else query[prefix.end() :]
        options = _EXPLAIN_OPTIONS.match(rest)
        for candidate in (rest, rest[options.end() :] if options else ""):
            try:
                statements = self._connection.extract_statements(candidate)
            except duckdb.Error:
                continue
            if [s.type.name for s in statements] == ["SELECT"]:
                return candidate
        raise UsageError("EXPLAIN of a statement that is no SELECT", expected="EXPLAIN SELECT …")

    def _refuse_writing_nodes(self, statement: str) -> None:
        (text,) = self._connection.execute("SELECT json_serialize_sql(?)", [statement]).fetchone()
        tree = json.loads(text)
        if tree.get("error"):
            raise UsageError(str(tree.get("error_message")), expected="a SELECT statement")
        writing = sorted(_list_node_kinds(tree) - _READING_NODES)
        if writing:
            kinds = ", ".join(kind.removesuffix("_NODE").removesuffix("_QUERY") for kind in writing)
            raise UsageError(f"a statement with {kinds} inside", expected="only SELECT, WITH included")

    def _offer_samples(self, query: str) -> None:
        """Defines `samples('<recording_id>')` for the recordings that the query names."""
        import duckdb
        import pyarrow.dataset

        try:
            known = self._connection.execute(
                "SELECT recording_id, samples_path FROM recordings "
                "WHERE samples_path IS NOT NULL AND status <> 'duplicate' AND contains(?, recording_id)",
                [query],
            ).fetchall()
        except duckdb.CatalogException:
            raise LabError(
                "the database is none of dealab's: it has no table recordings",
                where=str(self._lab.database),
                remedy=REBUILD,
            ) from None
        # Views have numbers: a dot in a name means a schema, and DuckDB does not tell upper from lower case in names.
        names = {"": ""}
        for number, (recording_id, samples_path) in enumerate(known):
            path = self._find_samples(samples_path)
            if path is not None:
                names[recording_id] = f"samples {number}"
                self._connection.register(names[recording_id], pyarrow.dataset.dataset(path, format="parquet"))
        offered = ", ".join(f"'{name}': '{view}'" for name, view in sorted(names.items()))
        self._connection.execute(
            "CREATE OR REPLACE TEMP MACRO samples(recording_id) AS TABLE SELECT * FROM query_table(coalesce("
            f"MAP {{{offered}}}[recording_id], "
            "error('no samples of recording \"' || recording_id || '\"; "
            "SELECT recording_id FROM recordings lists them, and the name has to stand in the query as it is')))"
        )

    def _find_samples(self, samples_path: str) -> Path | None:
        """The samples' file, if it exists and lies in the lab's samples folder."""
        root = self._lab.samples_folder.resolve()
        path = (self._lab.folder / samples_path).resolve()
        return path if root in path.parents and path.is_file() else None


def _tell_apart(names: Sequence[str]) -> list[str]:
    """Names of columns, a number behind those that came before: whoever takes rows by name would lose one otherwise."""
    found: list[str] = []
    for name in names:
        numbered = (f"{name}_{number}" for number in itertools.count(1))
        found.append(next(one for one in itertools.chain([name], numbered) if one not in found))
    return found


def _list_node_kinds(tree: Any) -> set[str]:
    if isinstance(tree, list):
        return set().union(*(_list_node_kinds(member) for member in tree)) if tree else set()
    if not isinstance(tree, dict):
        return set()
    kinds = set().union(*(_list_node_kinds(member) for member in tree.values()))
    kind = tree.get("type")
    if isinstance(kind, str) and kind.endswith("_NODE"):
        kinds.add(kind)
    return kinds
