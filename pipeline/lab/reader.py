"""Rows of a database file of the pipeline's under today's column names, whichever version wrote it.

An older release's database may lack tables and columns; they read as empty. Light on purpose, since stages depend on
it: the lab's paths and queries do not belong here.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from schemas.database import REBUILD, connect
from schemas.errors import LabError
from schemas.tables import TABLES, Column

NIGHT_MEMORY = "64MB"
"""What DuckDB may use to read for a night."""
_MEMORY_OF_WHOLE_RESULTS = "4GB"
"""The same for a lab of before results were dealt into parts: DuckDB holds thousands of rows at once, however
long they are."""
_AT_ONCE = 500
_IN_ALL = "recordings"
"""The table that databases of all releases have."""


def open_published(database: Path) -> contextlib.AbstractContextManager[Reader | None]:
    """A reader of a snapshot for a `with` block of a night; None where nothing has been published."""
    return Reader(database, memory=NIGHT_MEMORY) if database.exists() else contextlib.nullcontext()


class Reader:
    """Rows of a published snapshot under today's column names; a context manager.

    `memory` is what DuckDB may use, None for what it likes: it keeps what it has read.
    """

    def __init__(self, database: Path, *, memory: str | None = None) -> None:
        self._database = database
        self._memory = memory
        self._connection: Any = None
        self._columns: dict[str, set[str]] = {}

    def __enter__(self) -> Reader:
        import duckdb

        try:
            self._connection = connect(self._database)
            if self._memory is not None:
                self._connection.execute("SET threads = 1")
                self._connection.execute(f"SET memory_limit = '{self._memory}'")
            found = self._connection.execute("SELECT table_name, column_name FROM duckdb_columns()").fetchall()
            for table, column in found:
                self._columns.setdefault(table, set()).add(column)
            if self._memory is not None and "part" not in self._columns.get("carried", {"part"}):
                self._connection.execute(f"SET memory_limit = '{_MEMORY_OF_WHOLE_RESULTS}'")
        except duckdb.Error as error:
            raise self._explain(error) from None
        if _IN_ALL not in self._columns:
            self._connection.close()
            raise self._explain(f"it has no table {_IN_ALL}")
        return self

    def _explain(self, error: Exception | str) -> LabError:
        return LabError(
            f"the published database cannot be read: {str(error).splitlines()[0][:300]}",
            where=str(self._database),
            remedy=REBUILD,
        )

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def rows(
        self,
        name: str,
        columns: Sequence[str] | None = None,
        key: str | None = None,
        among: Iterable[str] = (),
        where: str = "true",
        *,
        ordered: bool = True,
    ) -> list[dict[str, Any]]:
        """Rows of a table, all or those whose `key` is `among` the given; an absent column is NULL.

        `where` is a condition of ours on the columns. Not `ordered`: in any order, for rows that are longer than
        DuckDB can sort.
        """
        return list(self._iterate(name, columns, self._make_query(name, columns, key, among, where, ordered=ordered)))

    def each(self, name: str, columns: Sequence[str] | None = None) -> Iterator[dict[str, Any]]:
        """All rows one by one, for what has many; nothing else may be asked meanwhile."""
        return self._iterate(name, columns, self._make_query(name, columns, None, ()))

    def values(self, name: str, columns: Sequence[str]) -> Iterator[tuple[Any, ...]]:
        """The same without names and in no order; the columns are given in that of the table."""
        return self._iterate_values(self._make_query(name, columns, None, (), ordered=False))

    def list_rigs_without_constants(self) -> list[str]:
        """What is told of each rig whose constants recordings need and do not have."""
        return [problem for _, problem in self._list_attention("rig")]

    def list_specimens_without_model(self) -> list[tuple[str, str]]:
        """Each specimen that has results and no model, with what its models lacked."""
        return self._list_attention("specimen")

    def _list_attention(self, what: str) -> list[tuple[str, str]]:
        """Names and problems of one kind in the view; a database of before it has none to tell."""
        view = "needs_attention"
        if view not in self._columns:
            return []
        query = f"SELECT name, problem FROM {view} WHERE what = '{what}' ORDER BY name"
        return [(name, problem) for name, problem in self._iterate_values((query, []))]

    def _iterate(
        self, name: str, columns: Sequence[str] | None, query: tuple[str, list[list[str]]] | None
    ) -> Iterator[dict[str, Any]]:
        names = [column.name for column in self._choose_columns(name, columns)]
        return (dict(zip(names, row, strict=True)) for row in self._iterate_values(query))

    def _iterate_values(self, query: tuple[str, list[list[str]]] | None) -> Iterator[tuple[Any, ...]]:
        if query is None:
            return
        import duckdb

        try:
            found = self._connection.execute(*query)
            while some := found.fetchmany(_AT_ONCE):
                yield from some
        except duckdb.Error as error:  # a damaged block is noticed when it is read
            raise self._explain(error) from None

    def _choose_columns(self, name: str, columns: Sequence[str] | None) -> list[Column]:
        return [c for c in TABLES[name].columns if columns is None or c.name in columns]

    def _make_query(
        self,
        name: str,
        columns: Sequence[str] | None,
        key: str | None,
        among: Iterable[str],
        where: str = "true",
        *,
        ordered: bool = True,
    ) -> tuple[str, list[list[str]]] | None:
        """The SELECT and its parameters; None where there are no such rows."""
        present = self._columns.get(name, set())
        if not present or (key is not None and key not in present):
            return None
        selected = ", ".join(
            f'"{c.name}"' if c.name in present else f'CAST(NULL AS {c.type}) AS "{c.name}"'
            for c in self._choose_columns(name, columns)
        )
        order = ", ".join(f'"{c}"' for c in TABLES[name].key if ordered and c in present)
        condition = f"WHERE {where}" if key is None else f'WHERE "{key}" IN (SELECT unnest(?::VARCHAR[])) AND {where}'
        sort = f"ORDER BY {order}" if order else ""
        return f"SELECT {selected} FROM {name} {condition} {sort}", [] if key is None else [list(among)]
