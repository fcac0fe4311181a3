"""Publishing: a new database file from the old one and what changed, checked, then put in its place in one step.

DuckDB allows one writer or many readers. So the published file is never opened for writing: a copy is edited, or a
file of another schema is read into a new one, and the result is checkpointed, closed, opened read-only and checked
before it is renamed over the old. Readers keep the file they have open.
"""

from __future__ import annotations

import functools
import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import pyarrow as pa

from ingest.atomic import flush
from pipeline.lab.checks import find_damage, find_edits, find_violations, is_short_of_memory
from pipeline.lab.lab import Lab
from schemas import without_result
from schemas.control import REMEMBER
from schemas.database import REBUILD, connect, spell_database
from schemas.errors import LabError
from schemas.tables import TABLES, Table
from schemas.views import VIEWS, fingerprint

_BATCH_BYTES = 8 << 20
_TOLD = 5
"""Damaged tables that are named."""
BATCH_PIECES = 500
"""What is inserted at once. A small arrow table, or a row as a dictionary, holds ten times the bytes of its values, so
their number counts as well."""
_THREADS, _MEMORY = 1, ("32MB", "128MB", "512MB", "2GB")
"""What DuckDB may use while it edits the copy, however many rows there are and whatever machine it is on; the rest goes
to its file. The first is enough but for very long texts, of which it holds a row group at a time."""
_ROW_GROUP = 4096
"""Rows that DuckDB compresses together, which it does in memory: with much text, the usual 122880 are too many."""
READABLE_FROM = {"storage_compatibility_version": "v1.2.0"}
"""The file opens with any DuckDB from 1.2 on: people's command lines and other programs are seldom the newest."""
_TODAY = {"schema": fingerprint(), "row_group": str(_ROW_GROUP)}
"""What a database of today says of itself. One of other row groups is made anew: DuckDB would join small to large."""

Rows: TypeAlias = "pa.Table | Sequence[Mapping[str, Any]]"
"""Many rows as an arrow table, or a few as dictionaries (without arrow's import of pandas, which takes a while)."""


@dataclass(frozen=True)
class Deletion:
    """Rows that go: those whose values in the columns of `keys` stand there side by side, all rows without `keys`."""

    table: str
    keys: Mapping[str, Sequence[str | None]] | None = None
    where: str = "true"


class Streamed:
    """What a function gives piece by piece, from the beginning each time that it is gone through."""

    def __init__(self, function: Callable[..., Iterator[Any]], *given: Any) -> None:
        self._function, self._given = function, given

    def __iter__(self) -> Iterator[Any]:
        return self._function(*self._given)


@dataclass(frozen=True)
class Changes:
    """What a night changes: deletions, then insertions. Both may be many; they are streamed, each time anew."""

    deletions: Iterable[Deletion] = ()
    insertions: Iterable[Mapping[str, Rows]] = field(default_factory=tuple)


def publish(lab: Lab, changes: Changes) -> None:
    """Publishes the lab's database with the changes made.

    Raises `LabError` when the result does not pass its checks, or when somebody has the database open for writing; the
    published file is then as it was.
    """
    import duckdb

    _refuse_open_writer(lab.database)
    lab.work.mkdir(parents=True, exist_ok=True)
    building = lab.work / "building.duckdb"
    try:
        _build_database(lab.database, building, changes)
        flush(building)
        _refuse_open_writer(lab.database)
        building.replace(lab.database)
        flush(lab.folder)
    except duckdb.Error as error:
        _refuse_damaged_before(lab.database)
        raise LabError(
            f"the database could not be built: {str(error).splitlines()[0]}",
            where=str(building),
            remedy=f"The published database is as it was. Free disk space, or run {lab.spell_command('doctor')}",
        ) from error
    finally:
        discard(building)


def _build_database(published: Path, building: Path, changes: Changes) -> None:
    """Builds and checks the next database, in as little memory as will do."""
    import duckdb

    for memory in _MEMORY:
        discard(building)
        try:
            connection = _open_base(published, building, memory)
            try:
                _apply_changes(connection, changes)
                rows = _finish(connection)
            finally:
                connection.close()
            _refuse_damaged(published, building)
            _check_database(building, rows, memory)
            return
        except duckdb.Error as error:
            if memory == _MEMORY[-1] or not is_short_of_memory(error):
                raise


def _refuse_damaged(published: Path, building: Path) -> None:
    """Raises `LabError` where a block of the next database cannot be read: what is broken is never published."""
    if damage := _read_all(building):
        _refuse_damaged_before(published)
        raise LabError(
            f"the new database is damaged: {'; '.join(damage[:_TOLD])}",
            where=str(building),
            remedy="The published database is as it was. Run the nightly again; look at this machine's disk and memory",
        )


def _refuse_damaged_before(published: Path) -> None:
    """Raises `LabError` where the published database was damaged before this night."""
    if damage := _read_all(published) if published.exists() else []:
        raise LabError(
            f"the published database is damaged: {'; '.join(damage[:_TOLD])}",
            where=str(published),
            remedy=REBUILD,
        )


def _read_all(database: Path) -> list[str]:
    """What of a database cannot be read, in as little memory as will do."""
    import duckdb

    for memory in _MEMORY:
        try:
            return list(find_damage(functools.partial(_open_to_read, database, memory)))
        except duckdb.Error as error:
            if memory == _MEMORY[-1] or not is_short_of_memory(error):
                return [str(error).splitlines()[0]]
    return []


def discard(database: Path) -> None:
    """Removes a database file that is not published, with what DuckDB may have left beside it."""
    for path in (database, database.with_name(database.name + ".wal")):
        path.unlink(missing_ok=True)
    shutil.rmtree(_name_spill_folder(database), ignore_errors=True)


def _refuse_open_writer(database: Path) -> None:
    journal = database.with_name(database.name + ".wal")
    if journal.exists():
        raise LabError(
            "somebody has opened the published database for writing",
            where=str(journal),
            remedy="Close that program, remove the .wal file and run the nightly again; open the database read-only",
        )


def _open_base(published: Path, building: Path, memory: str) -> Any:
    """A writable connection to a file that holds what is published, under today's schema."""
    import duckdb

    if not published.exists():
        return _make_empty(building, memory)
    _copy_file(published, building)
    try:
        connection = _open(building, memory)
    except duckdb.Error as error:
        raise LabError(
            f"the published database cannot be read: {str(error).splitlines()[0]}",
            where=str(published),
            remedy=REBUILD,
        ) from None
    if _read_about(connection) == _TODAY:
        if edits := list(find_edits(connection)):
            connection.close()
            raise LabError(
                f"somebody has edited the published database: {'; '.join(edits[:_TOLD])}",
                where=str(published),
                expected="a database that is only read",
                remedy=REBUILD,
            )
        return connection
    connection.close()
    discard(building)
    connection = _make_empty(building, memory)
    _migrate(connection, published)
    return connection


def _open(database: Path, memory: str) -> Any:
    """A writable connection to the file."""
    connection = _bound(connect(), database, memory)
    new = f", STORAGE_VERSION '{READABLE_FROM['storage_compatibility_version']}'"
    options = f"ROW_GROUP_SIZE {_ROW_GROUP}{'' if database.exists() else new}"
    connection.execute(f"ATTACH '{_quote(spell_database(database))}' AS building ({options})")
    connection.execute("USE building")
    return connection


def _make_empty(database: Path, memory: str) -> Any:
    """A writable connection to a new database with empty tables."""
    connection = _open(database, memory)
    _create_tables(connection)
    return connection


def _bound(connection: Any, database: Path, memory: str) -> Any:
    """The connection, kept to what DuckDB may use."""
    connection.execute(f"SET threads = {_THREADS}")
    connection.execute(f"SET memory_limit = '{memory}'")
    connection.execute(f"SET temp_directory = '{_quote(_name_spill_folder(database))}'")
    return connection


def _name_spill_folder(database: Path) -> str:
    """The folder of what DuckDB has no memory for."""
    return f"{spell_database(database)}.tmp"


def _read_about(connection: Any) -> dict[str, str]:
    """What a database says of itself."""
    import duckdb

    try:
        return dict(connection.execute("SELECT key, value FROM lab").fetchall())
    except duckdb.CatalogException:
        return {}


def _copy_file(source: Path, target: Path) -> None:
    """Copies a file; on file systems that can, the two share their blocks until one changes."""
    with source.open("rb") as read, target.open("wb") as written:
        left = os.fstat(read.fileno()).st_size
        try:
            while left > 0:
                count = os.copy_file_range(read.fileno(), written.fileno(), left)
                if count == 0:
                    break
                left -= count
        except (OSError, AttributeError):
            read.seek(0)
            written.seek(0)
            written.truncate()
            shutil.copyfileobj(read, written, 16 << 20)


def _create_tables(connection: Any) -> None:
    connection.execute("BEGIN")  # each definition for itself would be written to the disk for itself
    for table in TABLES.values():
        connection.execute(table.ddl())
    for view in VIEWS:
        connection.execute(view.ddl())
    for key, value in _TODAY.items():
        connection.execute("INSERT INTO lab VALUES (?, ?)", [key, value])
    connection.execute("COMMIT")


def _migrate(connection: Any, published: Path) -> None:
    """Rows of a database of another schema: columns of the same name, cast where the type has changed."""
    connection.execute(f"ATTACH '{_quote(spell_database(published))}' AS old (READ_ONLY)")
    columns = connection.execute(
        "SELECT table_name, column_name FROM duckdb_columns() WHERE database_name = 'old' AND NOT internal"
    ).fetchall()
    for table in TABLES.values():
        if table.name == "lab":
            continue
        common = [c for c in table.columns if (table.name, c.name) in columns]
        if common:
            names = ", ".join(f'"{c.name}"' for c in common)
            values = ", ".join(f'TRY_CAST("{c.name}" AS {c.type})' for c in common)
            connection.execute(f"INSERT INTO {table.name} ({names}) SELECT {values} FROM old.{table.name}")
    connection.execute("DETACH old")


def _apply_changes(connection: Any, changes: Changes) -> None:
    connection.execute("BEGIN")
    for deletion in changes.deletions:
        if deletion.keys is None:
            connection.execute(f"DELETE FROM {deletion.table} WHERE {deletion.where}")
        elif any(deletion.keys.values()):
            given = ", ".join(f'unnest(?::VARCHAR[]) AS "{name}"' for name in deletion.keys)
            match = " AND ".join(
                f'{deletion.table}."{name}" IS NOT DISTINCT FROM given."{name}"' for name in deletion.keys
            )
            connection.execute(
                f"DELETE FROM {deletion.table} USING (SELECT {given}) AS given WHERE {match} AND ({deletion.where})",
                [list(values) for values in deletion.keys.values()],
            )
    for tables in gather(changes.insertions):
        for name, rows in tables.items():
            _insert(connection, TABLES[name], rows)
        connection.execute("COMMIT")  # nobody sees the copy yet; a transaction's rows stay in memory until then
        connection.execute("BEGIN")
    connection.execute("COMMIT")


def gather(parts: Iterable[Mapping[str, Rows]]) -> Iterable[dict[str, list[Rows]]]:
    """The same rows in fewer, larger pieces: DuckDB takes few large tables faster than many small ones."""
    waiting: dict[str, list[Rows]] = {}
    size = pieces = 0
    for part in parts:
        for name, rows in part.items():
            waiting.setdefault(name, []).append(rows)
            size += rows.nbytes if isinstance(rows, pa.Table) else 0
            pieces += 1 if isinstance(rows, pa.Table) else len(rows)
        if size >= _BATCH_BYTES or pieces >= BATCH_PIECES:
            yield waiting
            waiting, size, pieces = {}, 0, 0
    yield waiting


def _insert(connection: Any, table: Table, pieces: Sequence[Rows]) -> None:
    arrow = [piece for piece in pieces if isinstance(piece, pa.Table) and piece.num_rows]
    order = ", ".join(f'"{name}"' for name in table.key)
    if arrow:
        names = ", ".join(f'"{name}"' for name in arrow[0].column_names)
        connection.register("given", pa.concat_tables(arrow))
        try:
            connection.execute(f"INSERT INTO {table.name} ({names}) SELECT {names} FROM given ORDER BY {order}")
        finally:
            connection.unregister("given")
    few = [row for piece in pieces if not isinstance(piece, pa.Table) for row in piece]
    if few:
        values = ", ".join(f'unnest(?::{c.type}[]) AS "{c.name}"' for c in table.columns)
        connection.execute(
            f"INSERT INTO {table.name} SELECT * FROM (SELECT {values}) ORDER BY {order}",
            [[row.get(c.name) for row in few] for c in table.columns],
        )


def _finish(connection: Any) -> dict[str, int]:
    """Books what the run changed, writes everything into the one file, returns the number of rows of each table."""
    connection.execute(REMEMBER)
    for statement in without_result.STATEMENTS:
        connection.execute(statement)
    rows = {name: connection.execute(f"SELECT count(*) FROM {name}").fetchone()[0] for name in TABLES}
    connection.execute("CHECKPOINT")
    return rows


def _open_to_read(database: Path, memory: str) -> Any:
    """A connection to the file as readers will have it."""
    return _bound(connect(database), database, memory)


def _check_database(database: Path, rows: Mapping[str, int], memory: str) -> None:
    with _open_to_read(database, memory) as connection:
        broken = list(find_violations(connection, rows))
    if broken:
        raise LabError(
            "the new database does not pass its checks: " + "; ".join(broken),
            remedy="The published database is as it was. This is a defect of dealab; report it with this text",
        )


def _quote(text: str) -> str:
    return text.replace("'", "''")
