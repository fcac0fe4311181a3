"""Parquet, Feather and Arrow files through pyarrow, in a process of their own.

A column is named; `a.b` is a field of a column of structures. The metadata `unit` of a field is its unit. Dates are times,
of UTC where their type has a zone; durations are seconds. Feather and Arrow without their end are read by whole blocks of rows;
Parquet without its end is nothing: what stands where is said there alone. Does not belong here: which rows and columns are meant (`ingest.select`, `ingest.mapping`).
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from ingest.apart import Apart
from ingest.array_numbers import TRUTHS, numbers_from_cells
from ingest.columns import CELL_LIMIT, Numbers, OwnTime, named_column
from ingest.mapping import ColumnName, FileMapping, column_label
from schemas.arrays import Float
from schemas.errors import RefusedError

_PARQUET, _FEATHER_1, _ARROW = b"PAR1", b"FEA1", b"ARRO"
_SMALLEST_PARQUET = 12
_BEFORE_SEQUENCE = 8
"""Bytes of an Arrow file with a directory before its sequence of blocks, which is the same as in one without."""
_END = b"\xff\xff\xff\xff\x00\x00\x00\x00"
"""What stands behind the last block."""
_LARGEST = 1 << 31
"""Most bytes that a column, or a batch of rows, may take once it is inflated."""
_UNITS = (b"unit", b"units", b"Unit", b"Units")
_DAMAGED = (pa.ArrowException, OSError, ValueError, TypeError, KeyError, IndexError, OverflowError, MemoryError)
"""What pyarrow raises for damaged files."""


@dataclass(frozen=True)
class _Listed:
    """A column that a file lists: its place in the schema, its unit, and why it is no column of numbers (`refusal`)."""

    name: str
    path: tuple[int, ...]
    unit: str | None
    refusal: str = ""


@dataclass(frozen=True)
class ArrowFile:
    """A table of columns with types; a `ColumnFile`. Each column is read when it is asked for."""

    path: Path
    listed: tuple[_Listed, ...]
    parsed: Apart = field(repr=False)
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def where(self) -> str:
        return self.path.name

    @cached_property
    def _read_before(self) -> dict[int, Any]:
        return {}

    def names(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.listed)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        values = self._column(column, index)
        if pa.types.is_temporal(values.type):
            raise RefusedError(
                f"{column_label(column)} holds {values.type}: times, not numbers",
                where=self.where,
                expected="real numbers",
                remedy='They are the times of samples: [time] with format = "iso"',
            )
        empty = np.asarray(values.is_null(), dtype=bool)
        if pa.types.is_string(values.type):
            found = numbers_from_cells(values.to_pylist(), column, self.where)
            if found.texts and not np.isfinite(found.values).any():
                raise RefusedError(
                    f'{column_label(column)} holds text, not numbers, such as "{found.example}"',
                    where=self.where,
                    expected="real numbers",
                )
            return found
        notes = (TRUTHS,) if pa.types.is_boolean(values.type) else ()
        return Numbers(
            np.array(values.cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)), empty, notes=notes
        )

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        values = self._column(column, index)
        if pa.types.is_timestamp(values.type):
            zone = values.type.tz is not None
            found = values.cast(pa.timestamp("us", values.type.tz), safe=False).to_pylist()
            return [t if t is None or not zone else t.astimezone(UTC) for t in found]
        cells: list[Any] = values.to_pylist()
        return cells

    def unit(self, column: ColumnName) -> str | None:
        return self.listed[named_column(self.names(), column, self.where)].unit

    def own_time(self, column: ColumnName) -> OwnTime | None:
        return None

    def own_frequency(self, column: ColumnName) -> Float | None:
        return None

    def _column(self, column: ColumnName, index: int | None) -> Any:
        if index is not None:
            raise RefusedError(f"index is {index}", where=self.where, expected="no index: tables have no matrices")
        at = named_column(self.names(), column, self.where)
        one = self.listed[at]
        if one.refusal:
            raise RefusedError(
                f"{column_label(column)} is {one.refusal}",
                where=self.where,
                expected="numbers, texts or dates",
                remedy="Write it as columns of numbers",
            )
        if at not in self._read_before:
            self._read_before[at] = self.parsed(_read_column, self.path, one)
        return self._read_before[at]


def read_arrow(path: Path, mapping: FileMapping) -> ArrowFile:
    """The columns of a Parquet, Feather or Arrow file. Raises `RefusedError` for a damaged or oversized one."""
    import pyarrow.parquet  # noqa: F401 - in this process, so that no child has to

    parsed = Apart(path)
    rows, listed, problems = parsed(_list_columns, path)
    if not listed:
        raise RefusedError("the file has no columns", where=path.name, expected="columns")
    if rows is not None and not 0 < rows <= CELL_LIMIT:
        raise RefusedError(
            "there are no rows of data" if rows == 0 else f"the file has {rows} rows",
            where=path.name,
            expected=f"1 to {CELL_LIMIT} rows",
        )
    times = Counter(one.name for one in listed)
    twice = "one of several columns of that name"
    columns = tuple(replace(o, refusal=twice) if times[o.name] > 1 else o for o in listed)
    return ArrowFile(path, columns, parsed, problems)


def _list_columns(path: Path) -> tuple[int | None, tuple[_Listed, ...], tuple[str, ...]]:
    """The number of rows, None where only reading tells it, the columns, and what was lost; runs in the child."""
    try:
        with pa.OSFile(str(path)) as file:
            start = file.read(4)
            file.seek(0)
            if start == _PARQUET:
                import pyarrow.parquet as pq

                _refuse_without_end(file, path)
                found = pq.ParquetFile(file)
                return found.metadata.num_rows, tuple(_list_fields(found.schema_arrow)), ()
            source = _open_batches(file, start, path)
            if start == _ARROW and source.is_directory:
                return None, tuple(_list_fields(source.reader.schema)), ()
            lost = _find_loss(source, path)
            return None, tuple(_list_fields(source.reader.schema)), lost
    except _DAMAGED as error:
        raise _unreadable(path, error) from None


def _list_fields(fields: Any, path: tuple[int, ...] = (), prefix: str = "") -> Iterator[_Listed]:
    for i, one in enumerate(fields):
        name = prefix + one.name
        if pa.types.is_struct(one.type):
            inside = [one.type.field(k) for k in range(one.type.num_fields)]
            yield from _list_fields(inside, (*path, i), name + ".")
            continue
        held = one.metadata or {}
        unit = next((held[key].decode("utf-8", "replace") for key in _UNITS if held.get(key)), None)
        if pa.types.is_duration(one.type):
            unit = "s"
        yield _Listed(name, (*path, i), unit, "" if _is_readable(one.type) else f"a column of {str(one.type)[:60]}")


def _is_readable(kind: Any) -> bool:
    if pa.types.is_dictionary(kind):
        return _is_readable(kind.value_type)
    tests = (
        pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_decimal, pa.types.is_string,
        pa.types.is_large_string, pa.types.is_timestamp, pa.types.is_date, pa.types.is_time, pa.types.is_duration,
    )  # fmt: skip
    return any(test(kind) for test in tests)


@dataclass(frozen=True)
class _Batches:
    """The blocks of rows of an Arrow file: by the directory at its end, or one after the other as a program sent them."""

    file: Any
    reader: Any
    is_directory: bool

    def __iter__(self) -> Iterator[Any]:
        """The blocks; of a sequence those before its end or before the first that is damaged."""
        if self.is_directory:
            yield from (self.reader.get_batch(i) for i in range(self.reader.num_record_batches))
            return
        with contextlib.suppress(pa.ArrowException, OSError):
            yield from self.reader


def _open_batches(file: Any, start: bytes, path: Path) -> _Batches:
    if start == _FEATHER_1:
        raise RefusedError(
            "the file is Feather of version 1, which is no longer written",
            where=path.name,
            expected="Parquet, or Feather of version 2",
            remedy="Read it with the program that wrote it, and write it anew",
        )
    if start != _ARROW:
        return _Batches(file, pa.ipc.open_stream(file), is_directory=False)
    try:
        return _Batches(file, pa.ipc.open_file(file), is_directory=True)
    except (pa.ArrowException, OSError):
        file.seek(_BEFORE_SEQUENCE)
        return _Batches(file, pa.ipc.open_stream(file), is_directory=False)


def _find_loss(source: _Batches, path: Path) -> tuple[str, ...]:
    """What is lost of a sequence of blocks: nothing where its mark of the end is there and no directory should follow it."""
    rows = sum(batch.num_rows for batch in source)
    at = source.file.tell()
    source.file.seek(max(0, at - len(_END)))
    is_ended = source.file.read(len(_END)) == _END
    source.file.seek(0)
    if not rows:
        raise RefusedError(
            "the file ends before its first block of rows does" if not is_ended else "there are no rows of data",
            where=path.name,
            expected="a block of rows that is whole",
            remedy="Copy the file again, or write it anew",
        )
    if not is_ended:
        return (f"the file ends too early: {rows} rows in whole blocks are read, what comes after them is lost",)
    if source.file.read(len(_ARROW)) == _ARROW:
        return (f"the file's directory, at its end, is damaged or missing: the {rows} rows before it are read",)
    return ()


def _refuse_without_end(file: Any, path: Path) -> None:
    """Raises `RefusedError` for Parquet whose last bytes are not those of Parquet."""
    file.seek(max(0, file.size() - len(_PARQUET)))
    ending = file.read(len(_PARQUET))
    file.seek(0)
    if ending != _PARQUET or file.size() < _SMALLEST_PARQUET:
        raise RefusedError(
            "the file cannot be read: its end is missing, and with it the only list of what its columns are, of which type and where"
            " they stand",
            where=path.name,
            expected="a whole Parquet file",
            remedy="Copy the file again, or write it anew",
        )


def _read_column(path: Path, one: _Listed) -> Any:
    """(n,) values of a column as one array of a plain type; runs in the child."""
    try:
        with pa.OSFile(str(path)) as file:
            start = file.read(4)
            file.seek(0)
            chunks = _read_parquet(file, one, path) if start == _PARQUET else _read_batches(file, start, one, path)
        values = pa.chunked_array(chunks).combine_chunks()
        values.validate(full=True)
        return _as_plain(values)
    except _DAMAGED as error:
        raise _unreadable(path, error) from None


def _read_parquet(file: Any, one: _Listed, path: Path) -> list[Any]:
    import pyarrow.parquet as pq

    found = pq.ParquetFile(file, pre_buffer=False)
    about = found.metadata
    leaves = [i for i in range(about.num_columns) if found.schema.column(i).path == one.name]
    size = sum(
        about.row_group(g).column(i).total_uncompressed_size for g in range(about.num_row_groups) for i in leaves
    )
    _check_size(size, path)
    table = found.read(columns=[one.name], use_threads=False, use_pandas_metadata=False)
    column = table.column(0)
    for k in _path_in(table.schema.field(0), one.name):
        column = pc.struct_field(column, k)
    return list(column.chunks) or [pa.array([], column.type)]


def _path_in(top: Any, name: str) -> Iterator[int]:
    """Places of the fields of structures down to a column, of which only those of that name were read."""
    kind = top.type
    while pa.types.is_struct(kind):
        yield 0
        kind = kind.field(0).type


def _read_batches(file: Any, start: bytes, one: _Listed, path: Path) -> list[Any]:
    chunks, rows = [], 0
    for batch in _open_batches(file, start, path):
        _check_size(batch.nbytes, path)
        batch.validate(full=True)
        rows += batch.num_rows
        if rows > CELL_LIMIT:
            raise RefusedError("the file has too many rows", where=path.name, expected=f"at most {CELL_LIMIT}")
        values = batch.column(one.path[0])
        for k in one.path[1:]:
            values = pc.struct_field(values, k)
        chunks.append(values)
    if not rows:
        raise RefusedError("there are no rows of data", where=path.name, expected="rows")
    return chunks


def _check_size(size: int, path: Path) -> None:
    if size > _LARGEST:
        raise RefusedError(
            f"a column inflates to {size >> 20} MiB",
            where=path.name,
            expected=f"at most {_LARGEST >> 20} MiB",
            remedy="Split the file",
        )


def _as_plain(values: Any) -> Any:
    """Values without dictionary, texts of one kind, durations in seconds."""
    if pa.types.is_dictionary(values.type):
        values = values.dictionary_decode()
    if pa.types.is_large_string(values.type):
        values = values.cast(pa.string())
    if pa.types.is_duration(values.type):
        steps = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[values.type.unit]
        values = pc.multiply(values.cast(pa.int64()).cast(pa.float64(), safe=False), steps)
    return values


def _unreadable(path: Path, error: Exception) -> RefusedError:
    said = next(iter(str(error).splitlines()), type(error).__name__)
    return RefusedError(
        f"the file cannot be read as Parquet or Arrow: {said[:200]}",
        where=path.name,
        expected="a whole Parquet, Feather or Arrow file",
        remedy="Copy the file again, or write it anew",
    )
