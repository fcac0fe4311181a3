"""What must hold in a database before it is published: as SQL, and that all of it can be read.

`dealab doctor` asks the same of a published one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from schemas.tables import TABLES, find_references
from schemas.views import VIEWS

STATUSES = ("ok", "damaged", "quarantined", "duplicate", "pending", "excluded")
ANALYSED = ("ok", "damaged", "excluded")
"""Statuses of recordings that have results of their own."""

_ANALYSED_SQL = "('" + "', '".join(ANALYSED) + "')"

CHECKS: Mapping[str, str] = {
    "every status is one of the contract": (
        f"SELECT status FROM recordings WHERE status IS NULL OR status NOT IN {STATUSES!r}"
    ),
    "a recording id belongs to one analysed recording": (
        f"SELECT recording_id FROM recordings WHERE status IN {_ANALYSED_SQL} GROUP BY recording_id HAVING count(*) > 1"
    ),
    "an analysed recording has an id": (
        f"SELECT source_path FROM recordings WHERE status IN {_ANALYSED_SQL} AND recording_id IS NULL"
    ),
    "a refused recording has a reason": (
        "SELECT source_path FROM recordings WHERE status IN ('quarantined', 'damaged', 'pending') AND problem IS NULL"
    ),
    "one chosen order per specimen, loading, method and extension": (
        "SELECT specimen_id FROM model_fits WHERE selected "
        "GROUP BY specimen_id, loading, method, extension HAVING count(*) > 1"
    ),
    "items are booked once": "SELECT item_id FROM items GROUP BY item_id HAVING count(*) > 1",
}
"""What must hold, and the query whose rows break it."""


def _references() -> Iterator[tuple[str, str]]:
    """The same for every column that refers to recordings: no row speaks of what no analysed recording has."""
    for table, column, key in find_references():
        yield (
            f"{table}: every {column} is an analysed recording's",
            f"SELECT DISTINCT {column} FROM {table} WHERE {column} IS NOT NULL AND {column} NOT IN "
            f"(SELECT {key} FROM recordings WHERE status IN {_ANALYSED_SQL} AND {key} IS NOT NULL)",
        )


def find_violations(connection: Any, rows: Mapping[str, int] | None = None) -> Iterator[str]:
    """What does not hold, in words. `rows` are the numbers of rows that the tables must have."""
    present = {name for (name,) in connection.execute("SELECT table_name FROM duckdb_tables()").fetchall()}
    missing = [name for name in TABLES if name not in present]
    if missing:
        yield "tables are missing: " + ", ".join(missing)
        return
    for table, expected in (rows or {}).items():
        (found,) = connection.execute(f"SELECT count(*) FROM {table}").fetchone()
        if found != expected:
            yield f"{table} has {found} rows, {expected} were written"
    for statement, query in (*CHECKS.items(), *_references()):
        broken = connection.execute(f"SELECT * FROM ({query}) LIMIT 3").fetchall()
        if broken:
            yield f"not so: {statement} ({', '.join(str(row[0]) for row in broken)})"


def find_edits(connection: Any) -> Iterator[str]:
    """Tables of today's that lack columns, have others, or are not there, though the database says it has all of them.

    A database is replaced whole, never edited: what somebody took out of it is not made again by itself.
    """
    found: dict[str, set[str]] = {}
    for name, column in connection.execute(
        "SELECT table_name, column_name FROM duckdb_columns() WHERE NOT internal AND database_name = current_database()"
    ).fetchall():
        found.setdefault(name, set()).add(column)
    for table in TABLES.values():
        there, meant = found.get(table.name, set()), set(table.names)
        if not there:
            yield f"{table.name} is missing"
        elif lacking := sorted(meant - there):
            yield f"{table.name} lacks {', '.join(lacking)}"
        elif foreign := sorted(there - meant):
            yield f"{table.name} also has {', '.join(foreign)}"
    macros = connection.execute("SELECT function_name FROM duckdb_functions() WHERE NOT internal").fetchall()
    present = {*found, *(name for (name,) in macros)}
    for view in VIEWS:
        if view.name not in present:
            yield f"{view.name} is missing"


_OUT_OF_MEMORY = ("failed to allocate", "could not allocate", "failed to pin")


def is_short_of_memory(error: BaseException | None) -> bool:
    """Whether DuckDB wanted more than it may use, also behind what came of it, such as an aborted transaction."""
    import duckdb

    if error is None:
        return False
    told = isinstance(error, duckdb.OutOfMemoryException) or any(text in str(error) for text in _OUT_OF_MEMORY)
    return told or is_short_of_memory(error.__context__)


def find_damage(open_database: Callable[[], Any]) -> Iterator[str]:
    """The tables that cannot be read to their ends, with the reason.

    DuckDB compares the checksum of every block that it reads, and reads a block when somebody asks for what is in it: a
    broken one may be copied from night to night.

    Parameters
    ----------
    open_database : gives a connection to the database; called again after each damaged table, which spoils a connection

    Raises
    ------
    duckdb.Error
        The database cannot be opened, or takes more memory than it may.
    """
    import duckdb

    connection = open_database()
    try:
        for (name,) in connection.execute("SELECT table_name FROM duckdb_tables() ORDER BY table_name").fetchall():
            try:
                connection.execute(f'SELECT bit_xor(hash(t)) FROM "{name}" AS t').fetchall()
            except duckdb.Error as error:
                if is_short_of_memory(error):
                    raise
                yield f"{name} ({str(error).splitlines()[0][:160]})"
                connection.close()
                connection = open_database()
    finally:
        connection.close()
