"""What the lab knows before a night: items and what they were made from, recordings, raw files as last seen.

Read from the published snapshot. An older release's database may lack tables and columns; they read as empty.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import pyarrow as pa

from pipeline.lab import Lab
from pipeline.store.journal import Freshness
from schemas.errors import LabError
from schemas.tables import TABLES, Column


@dataclass(frozen=True, slots=True)
class BookedItem:
    """An item of an earlier night."""

    item_id: str
    stage: str
    freshness: Freshness
    outcome: str
    error: str | None


@dataclass(frozen=True, slots=True)
class KnownRecording:
    """A row of `recordings`, as far as the plan needs it."""

    source_path: str
    source_sha256: str | None
    recording_id: str | None
    specimen_id: str | None
    protocol: str | None
    rig_id: str | None
    status: str
    problem: str | None
    samples_path: str | None
    source_present: bool | None
    run_id: str | None


@dataclass(frozen=True, slots=True)
class SeenFile:
    """A raw file as it was when it was hashed."""

    size: int
    mtime_ns: int
    inode: int
    sha256: str


@dataclass(frozen=True)
class Manifest:
    """Everything that is known. `carried` has the kinds of carried results by recording."""

    items: Mapping[str, BookedItem] = field(default_factory=dict)
    recordings: Sequence[KnownRecording] = ()
    files: Mapping[str, SeenFile] = field(default_factory=dict)
    carried: Mapping[str, frozenset[str]] = field(default_factory=dict)
    last_run: int = 0


def load(lab: Lab) -> Manifest:
    """The manifest of a lab; empty where nothing has been published. Raises `LabError` for an unreadable database."""
    if not lab.database.exists():
        return Manifest()
    with Reader(lab) as reader:
        items = {
            row["item_id"]: BookedItem(
                row["item_id"],
                sys.intern(row["stage"]),
                Freshness(row["input_hash"], sys.intern(row["code_version"]), sys.intern(row["settings_hash"])),
                sys.intern(row["outcome"]),
                row["error"],
            )
            for row in reader.rows("items")
        }
        fields = tuple(KnownRecording.__dataclass_fields__)
        recordings = tuple(KnownRecording(**row) for row in reader.rows("recordings", fields))
        files = {row.pop("path"): SeenFile(**row) for row in reader.rows("files")}
        carried: dict[str, set[str]] = {}
        for row in reader.rows("carried", ("recording_id", "kind")):
            carried.setdefault(row["recording_id"], set()).add(row["kind"])
        runs = [int(row["run_id"]) for row in reader.rows("runs", ("run_id",)) if str(row["run_id"]).isdigit()]
    return Manifest(items, recordings, files, {k: frozenset(v) for k, v in carried.items()}, max(runs, default=0))


def known_recordings(lab: Lab) -> frozenset[str]:
    """Ids of all recordings in a lab. Raises `LabError` where nothing has been published."""
    lab.require_database()
    with Reader(lab) as reader:
        return frozenset(row["recording_id"] for row in reader.rows("recordings", ("recording_id",)))


def published(lab: Lab) -> contextlib.AbstractContextManager[Reader | None]:
    """A reader of the snapshot for a `with` block; None where nothing has been published."""
    return Reader(lab) if lab.database.exists() else contextlib.nullcontext()


class Reader:
    """Rows of the published snapshot under today's column names; a context manager."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._connection: Any = None
        self._columns: dict[str, set[str]] = {}

    def __enter__(self) -> Reader:
        import duckdb

        try:
            self._connection = duckdb.connect(str(self._lab.database), read_only=True)
            found = self._connection.execute("SELECT table_name, column_name FROM duckdb_columns()").fetchall()
        except duckdb.Error as error:
            raise LabError(
                f"the published database cannot be read: {str(error).splitlines()[0]}",
                where=str(self._lab.database),
                remedy="Move it away; the next nightly over all raw folders builds it anew",
            ) from None
        for table, column in found:
            self._columns.setdefault(table, set()).add(column)
        return self

    def __exit__(self, *_: object) -> None:
        self._connection.close()

    def table(
        self, name: str, columns: Sequence[str] | None = None, key: str | None = None, among: Iterable[str] = ()
    ) -> pa.Table:
        """Rows of a table, all or those whose `key` is `among` the given; an absent column is NULL."""
        schema = pa.schema([TABLES[name].arrow_schema.field(c.name) for c in self._wanted(name, columns)])
        query = self._query(name, columns, key, among)
        if query is None:
            return schema.empty_table()
        found: pa.Table = self._connection.sql(query[0], params=query[1]).to_arrow_table()
        return found.cast(schema)

    def rows(
        self,
        name: str,
        columns: Sequence[str] | None = None,
        key: str | None = None,
        among: Iterable[str] = (),
        where: str = "true",
    ) -> list[dict[str, Any]]:
        """The same as dictionaries; `where` is a condition of ours on the columns."""
        query = self._query(name, columns, key, among, where)
        if query is None:
            return []
        names = [column.name for column in self._wanted(name, columns)]
        return [dict(zip(names, row, strict=True)) for row in self._connection.execute(*query).fetchall()]

    def _wanted(self, name: str, columns: Sequence[str] | None) -> list[Column]:
        return [c for c in TABLES[name].columns if columns is None or c.name in columns]

    def _query(
        self,
        name: str,
        columns: Sequence[str] | None,
        key: str | None,
        among: Iterable[str],
        where: str = "true",
    ) -> tuple[str, list[list[str]]] | None:
        """The SELECT and its parameters; None where there are no such rows."""
        present = self._columns.get(name, set())
        if not present or (key is not None and key not in present):
            return None
        selected = ", ".join(
            f'"{c.name}"' if c.name in present else f'CAST(NULL AS {c.type}) AS "{c.name}"'
            for c in self._wanted(name, columns)
        )
        order = ", ".join(f'"{c}"' for c in TABLES[name].order if c in present)
        condition = f"WHERE {where}" if key is None else f'WHERE "{key}" IN (SELECT unnest(?::VARCHAR[])) AND {where}'
        return f"SELECT {selected} FROM {name} {condition} ORDER BY {order}", [] if key is None else [list(among)]
