"""The published database as the pages see it: read-only queries whose text the pages show.

A query that makes a table of a page is a `Query`; the page prints `Query.shown()`, which `dealab sql` answers with the
same rows. The database is opened read-only and nothing else is read.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import duckdb
import numpy as np
from numpy.typing import NDArray

from reports.ledger import AT_ONCE, Ledger
from reports.names import Verbatim, seen, visible
from schemas.database import connect
from schemas.errors import LabError
from schemas.numbers import bounds
from schemas.tables import TABLES
from schemas.views import VIEWS
from schemas.visible import quote_path

Row = dict[str, Any]
DATABASE = "results.duckdb"

MEMORY = ("32MB", "128MB", "512MB", "2GB")
"""What DuckDB may use, however many rows there are: what it has read it would keep, up to most of the machine's memory. The
first is enough but for very long texts; sorts that need more go to files beside the database."""
_OUT_OF_MEMORY = ("failed to allocate", "failed to pin")


def write_bounds(row: Row, column: str, scale: float = 1.0) -> str:
    """A column of a row with its 95 % limits, in words for a cell."""
    return bounds(row[column], row[f"{column}_lower"], row[f"{column}_upper"], scale)


def tell_warnings(found: Iterable[Row], what: str) -> str:
    """` The tests warn: …`, a sentence to go on with about what the rows of a table warn of, each warning once; empty where none does."""
    warnings = dict.fromkeys(w for r in found for w in (r["warnings"] or "").split("; ") if w)
    return f" The {what} warn: {visible('; '.join(warnings))}." if warnings else ""


def short_of_memory(error: Exception) -> bool:
    """Whether DuckDB wanted more than it may use."""
    return isinstance(error, duckdb.OutOfMemoryException) or any(text in str(error) for text in _OUT_OF_MEMORY)


@dataclass(frozen=True)
class Query:
    """A SELECT with named parameters (`$name`)."""

    sql: str
    parameters: Mapping[str, str | float] = field(default_factory=dict)

    def shown(self) -> Verbatim:
        """The statement as somebody can type it: parameters written out as literals."""
        text = self.sql
        for name in sorted(self.parameters, key=len, reverse=True):
            text = text.replace(f"${name}", literal(self.parameters[name]))
        return Verbatim(text + ";")


def literal(value: str | float | None) -> str:
    """The value as SQL; characters that cannot be seen are spelt out with chr()."""
    if value is None:
        return "NULL"
    if not isinstance(value, str):
        return repr(value)
    texts: list[str] = []
    for is_seen, run in itertools.groupby(value, key=seen):
        text = "".join(run)
        texts += ["'" + text.replace("'", "''") + "'"] if is_seen else [f"chr({ord(c)})" for c in text]
    if len(texts) == 1 and texts[0].startswith("'"):
        return texts[0]
    return f"({' || '.join(texts)})" if texts else "''"


class Results:
    """A published database, open for reading, and the ledger of who reads it. `LabError` where there is none or it is not one of ours.

    `memory` is what DuckDB may use.
    """

    def __init__(self, lab: Path, memory: str = MEMORY[0]) -> None:
        self.path = lab / DATABASE
        if not self.path.is_file():
            raise LabError(
                "there is no database to report on",
                where=str(self.path),
                remedy=f"Run `dealab nightly RAW --lab {quote_path(str(lab))}` first",
            )
        try:
            self._connection = connect(self.path)
            for setting in ("TimeZone = 'UTC'", "threads = 1", f"memory_limit = '{memory}'"):
                self._connection.execute(f"SET {setting}")
            named = "SELECT table_name FROM duckdb_tables() UNION ALL SELECT view_name FROM duckdb_views()"
            found = {name for (name,) in self._connection.execute(named).fetchall()}
            columns = "SELECT concat(table_name, '.', column_name) FROM duckdb_columns()"
            found |= {name for (name,) in self._connection.execute(columns).fetchall()}
        except duckdb.Error as error:
            raise LabError(
                f"the database cannot be read: {str(error).splitlines()[0]}",
                where=str(self.path),
                remedy=f"`dealab doctor --lab {quote_path(str(lab))}` says more; the next nightly over all raw folders builds it anew",
            ) from error
        missing = sorted({*TABLES, *(view.name for view in VIEWS if not view.parameters)} - found)
        what = "table"
        if not missing:
            missing = sorted({f"{table.name}.{column}" for table in TABLES.values() for column in table.names} - found)
            what = "column"
        if missing:
            self._connection.close()
            raise LabError(
                f"the database has no {what} {', '.join(missing)}",
                where=str(self.path),
                remedy="It was made by another version of dealab: run the nightly again",
            )
        self.ledger = Ledger()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self.ledger.close()
        self._connection.close()

    def rows(self, query: Query | str) -> list[Row]:
        """All rows, each a dictionary by column; times are aware datetimes in UTC."""
        query = Query(query) if isinstance(query, str) else query
        # Not through arrow, whose times with zone need pandas, which takes longer to import than a site to be checked.
        answer = self._connection.execute(query.sql, dict(query.parameters))
        names = [column[0] for column in answer.description]
        return [dict(zip(names, row, strict=True)) for row in answer.fetchall()]

    def columns(self, query: Query) -> dict[str, NDArray[Any]]:
        """All rows as one array per column; NULL in a real column is NaN."""
        answer = self._connection.execute(query.sql, dict(query.parameters)).fetchnumpy()
        return {name: _plain(np.ma.asarray(values)) for name, values in answer.items()}

    def each(self, query: Query | str) -> Iterator[Row]:
        """The same as `rows`, one by one, for what has many; other queries may be asked meanwhile."""
        query = Query(query) if isinstance(query, str) else query
        with self._connection.cursor() as cursor:
            cursor.execute("SET TimeZone = 'UTC'")
            answer = cursor.execute(query.sql, dict(query.parameters))
            names = [column[0] for column in answer.description]
            while some := answer.fetchmany(AT_ONCE):
                yield from (dict(zip(names, row, strict=True)) for row in some)

    def has(self, table: str, key: str, value: str) -> bool:
        """Some row of the table has that value in the column; asked once for all values, so that pages can skip queries."""
        sql = f'SELECT DISTINCT "{key}" AS value FROM {table} WHERE "{key}" IS NOT NULL'
        return self.ledger.has(f"{table}.{key}", value, lambda: (row["value"] for row in self.each(sql)))


def _plain(values: np.ma.MaskedArray[Any, Any]) -> NDArray[Any]:
    """The array with NaN where a number is NULL, None where anything else is."""
    if not np.ma.is_masked(values):
        return np.asarray(values.data)
    if values.dtype.kind in "iuf":
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    return np.asarray(np.ma.filled(values.astype(object), None))


def day(time: date | datetime | None) -> str:
    """`21 November 2026`."""
    if time is None:
        return "–"
    return f"{time.day}\u00a0{_MONTHS[time.month - 1]}\u00a0{time.year}"


def moment(time: datetime | None) -> str:
    """`21 November 2026, 05:12 UTC`."""
    return "–" if time is None else f"{day(time)}, {time:%H:%M}\u00a0UTC"


def days(first: datetime, last: datetime) -> str:
    """`18 to 20 November 2026`, as short as the span allows."""
    if first.date() == last.date():
        return day(first)
    if (first.year, first.month) == (last.year, last.month):
        return f"{first.day} to {day(last)}"
    return f"{day(first)} to {day(last)}"


_MONTHS = (
    "January", "February", "March", "April", "May", "June",
    "July", "August", "September", "October", "November", "December",
)  # fmt: skip
