"""Excel and OpenDocument sheets through python-calamine. Columns from A = 0, rows as the sheet shows them.

Does not belong here: formulas (their stored results are read), units and time (`ingest.assemble`).
"""

from __future__ import annotations

import contextlib
import math
import tempfile
import zipfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from datetime import date, datetime, time, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from ingest.apart import Apart
from ingest.clocks import seconds_of_day
from ingest.columns import CELL_LIMIT, Numbers, OwnTime, named_column, telling
from ingest.mapping import ColumnName, FileMapping
from ingest.notations import read_cell, read_column
from ingest.repeats import REPEATED, find_repeated_heads
from ingest.sheet_size import Size, measure_sheet, measure_workbook
from ingest.workbook_cut import mend_workbook
from ingest.zip_cut import is_cut
from schemas.arrays import Float
from schemas.errors import RefusedError

_INFLATED_LIMIT = 1 << 29
"""Most bytes that a workbook may inflate to."""

_DAMAGED = (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, ValueError, OSError)
"""What reading a damaged archive raises."""
_BYTES_PER_S = 2e5
"""Slowest parsing of a sound workbook: a million cells, 4 MB, take two seconds."""
_MOST_CELLS = CELL_LIMIT >> 4
"""Cells of a sheet, each of which takes 100 bytes on its way."""
SHEET = "sheet"
"""The column of the names of sheets that are read one below the other."""


@dataclass(frozen=True)
class SheetFile:
    """One sheet; a `ColumnFile`. `rows` are the rows of data, wholly blank ones left out."""

    where: str
    header: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[Sequence[Any], ...]
    decimal: str = "."
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return self.header

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        cells = self.cells(column, index)
        values = np.full(len(cells), np.nan)
        empty = np.zeros(len(cells), dtype=bool)
        durations: list[int] = []
        rows: list[int] = []
        texts: list[str] = []
        for row, cell in enumerate(cells):
            if isinstance(cell, int | float) and not isinstance(cell, bool):
                values[row] = cell
            elif isinstance(cell, timedelta | time):
                values[row] = seconds_of_day(cell)
                durations.append(row)
            elif cell is None or not str(cell).strip():
                empty[row] = True
            else:
                rows.append(row)
                texts.append(str(cell).strip())
        found = read_column(
            values, empty, np.array(rows, dtype=np.int64), texts, column, self.where, decimal=self.decimal
        )
        as_text = np.array([r for r, t in zip(rows, texts, strict=True) if _is_plain(t, self.decimal)], dtype=np.int64)
        notations = {**found.notations, **({"numbers stored as text": as_text} if as_text.size else {})}
        if durations:
            units = {**found.units, "s": np.union1d(found.units.get("s", as_text[:0]), durations)}
            return replace(found, units=units, notations=notations)
        return replace(found, notations=notations)

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        if index is not None:
            raise RefusedError(f"index is {index}", where=self.where, expected="no index: sheets have no matrices")
        position = named_column(self.header, column, self.where)
        return [row[position] for row in self.rows]

    def unit(self, column: ColumnName) -> str | None:
        position = named_column(self.header, column, self.where)
        return self.units[position] or None if self.units else None

    def own_time(self, column: ColumnName) -> OwnTime | None:
        return None

    def own_frequency(self, column: ColumnName) -> Float | None:
        return None


def read_excel(path: Path, mapping: FileMapping) -> SheetFile:
    """The sheet that a mapping names. Raises `RefusedError` when it is missing, damaged, locked or oversized."""
    options = mapping.options
    sheet = options.get("sheet")
    if isinstance(sheet, list):
        return _join_sheets(path, mapping, sheet)
    rows, lost = _read_sheet(path, sheet)
    rows = rows[options.get("skip_rows", 0) :]
    header: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    if options.get("header", True) and rows:
        header, rows = _texts(rows[0]), rows[1:]
    if options.get("unit_row", False) and rows:
        units, rows = _texts(rows[0]), rows[1:]
    decimal = str(options.get("decimal", "."))
    repeated = find_repeated_heads(rows, header, decimal)
    notes = (REPEATED.format(rows=len(repeated)),) if repeated else ()
    rows = [row for i, row in enumerate(rows) if i not in repeated]
    filled = [row for row in rows if not _is_blank(row)]
    if not filled:
        raise RefusedError("there are no rows of data", where=path.name, expected="rows after the header")
    problems = lost
    if mapping.counts_rows_as_time:
        last = max(i for i, row in enumerate(rows) if not _is_blank(row))
        blank = last + 1 - len(filled)
        filled = list(rows[: last + 1])
        problems += (f"{blank} rows are blank: samples that were lost",) if blank else ()
    return SheetFile(path.name, header or ("",) * len(filled[0]), units, tuple(filled), decimal, problems, notes)


def _join_sheets(path: Path, mapping: FileMapping, sheets: Sequence[str | int]) -> SheetFile:
    """Sheets one below the other, with a column that has the name of the sheet. Raises `RefusedError` where their columns differ."""
    if not sheets:
        raise RefusedError("sheet is an empty list", where=path.name, expected="names of sheets")
    read = [read_excel(path, replace(mapping, options={**mapping.options, "sheet": sheet})) for sheet in sheets]
    first = read[0]
    for sheet, file in zip(sheets, read, strict=True):
        if file.header != first.header or SHEET in file.header:
            raise RefusedError(
                f'the sheet "{str(sheet)[:60]}" has other columns than "{str(sheets[0])[:60]}", or one named {SHEET}',
                where=path.name,
                expected="sheets with the same columns",
                remedy="Leave it out of sheet in [excel] of the mapping TOML",
            )
    width = len(first.header)
    rows = tuple(
        (*row[:width], *[""] * (width - len(row)), str(sheet))
        for sheet, file in zip(sheets, read, strict=True)
        for row in file.rows
    )
    units = (*first.units, *[""] * (width - len(first.units)), "") if first.units else ()
    problems = tuple(dict.fromkeys(problem for file in read for problem in file.problems))
    notes = tuple(dict.fromkeys(note for file in read for note in file.notes))
    return SheetFile(path.name, (*first.header, SHEET), units, rows, first.decimal, problems, notes)


def _is_blank(row: Sequence[Any]) -> bool:
    return not any(str(cell).strip() for cell in row)


def _is_plain(text: str, decimal: str) -> bool:
    """Whether a text is a number as every program writes it."""
    found = read_cell(text, decimal)
    return found is not None and math.isfinite(found.value) and not (found.notation or found.unit)


def sheet_names(path: Path) -> tuple[str, ...]:
    """Names of the sheets of a workbook."""
    with _whole_workbook(path) as (apart, whole, _):
        return apart(_list_sheets, whole)


def _list_sheets(path: Path) -> tuple[str, ...]:
    return tuple(_workbook(path).sheet_names)


def sheet_rows(path: Path, sheet: str | int | None) -> list[list[Any]]:
    """All rows of a sheet, by name or number from 0; the only sheet where `sheet` is None."""
    return _read_sheet(path, sheet)[0]


def _read_sheet(path: Path, sheet: str | int | None) -> tuple[list[list[Any]], tuple[str, ...]]:
    """All rows of a sheet, and what is lost of its workbook."""
    with _whole_workbook(path) as (apart, whole, lost), telling(lost):
        return apart(_read_rows, whole, sheet), lost


@contextlib.contextmanager
def _whole_workbook(path: Path) -> Iterator[tuple[Apart, Path, tuple[str, ...]]]:
    """What parses the file apart; the file, or a workbook of what is left of it where its end is missing; and what is lost."""
    apart = _open_apart(path)
    if not is_cut(path):
        yield apart, path, ()
        return
    content, lost = apart(mend_workbook, path)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        copy.write_bytes(content)
        yield apart, copy, lost


def _open_apart(path: Path) -> Apart:
    import python_calamine  # noqa: F401 - in this process, so that no child has to

    return Apart(path, bytes_per_s=_BYTES_PER_S)


def _read_rows(path: Path, sheet: str | int | None) -> list[list[Any]]:
    where = path.name
    book = _workbook(path)
    names = list(book.sheet_names)
    if sheet is None and len(names) == 1:
        sheet = 0
    known = sheet in names if isinstance(sheet, str) else sheet is not None and 0 <= sheet < len(names)
    if not known:
        shown = ", ".join(f'"{name[:60]}"' for name in names[:40])
        raise RefusedError(
            f"the workbook has {len(names)} sheets" if sheet is None else f'there is no sheet "{str(sheet)[:60]}"',
            where=where,
            expected=f"sheet = one of {shown}",
            remedy="Give sheet in [excel] of the mapping TOML",
        )
    name = sheet if isinstance(sheet, str) else names[sheet or 0]
    _refuse_size(_guarded(measure_sheet, path, names.index(name), where=where), where=where)
    found = _guarded(book.get_sheet_by_name, name, where=where)
    height, width = found.total_height, found.total_width
    _refuse_size(Size(height, width, height * width, height * width), where=where)
    rows: list[list[Any]] = list(_guarded(found.to_python, skip_empty_area=False, where=where))
    # old files of two-byte letters come with a zero byte behind each
    return [[c.replace("\x00", "") if isinstance(c, str) and "\x00" in c else c for c in row] for row in rows]


def _refuse_size(size: Size, *, where: str) -> None:
    if max(size.cells, size.stated) <= _MOST_CELLS and not size.is_sparse:
        return
    told = f"the sheet has {size.height} × {size.width} cells"
    if size.cells > size.height * size.width:
        told = f"the sheets have {size.cells} cells, the largest {size.height} × {size.width}"
    elif size.stated > max(size.cells, _MOST_CELLS):
        told = f"a sheet says that it has {size.stated} cells"
    raise RefusedError(
        told + (f", and something stands in {size.filled} of them" if size.is_sparse else ""),
        where=where,
        expected=f"at most {_MOST_CELLS}" + (", and no cells far away from the others" if size.is_sparse else ""),
        remedy="Delete what stands far away from the data",
    )


def _workbook(path: Path) -> Any:
    import python_calamine

    if zipfile.is_zipfile(path):
        try:
            with zipfile.ZipFile(path) as archive:
                size = sum(member.file_size for member in archive.infolist())
        except _DAMAGED as error:
            raise _unreadable(path.name, error) from None
        if size > _INFLATED_LIMIT:
            raise RefusedError(
                f"the workbook inflates to {size >> 20} MiB",
                where=path.name,
                expected=f"at most {_INFLATED_LIMIT >> 20} MiB",
            )
    _refuse_size(_guarded(measure_workbook, path, where=path.name), where=path.name)
    return _guarded(python_calamine.load_workbook, str(path), where=path.name)


def _guarded(call: Any, *arguments: Any, where: str, **options: Any) -> Any:
    """The call's result; whatever the library raises for a damaged workbook becomes a `RefusedError`."""
    import python_calamine

    try:
        return call(*arguments, **options)
    except python_calamine.PasswordError:
        raise RefusedError(
            "the workbook is locked with a password",
            where=where,
            expected="a readable workbook",
            remedy="Save it without",
        ) from None
    except (*_DAMAGED, python_calamine.CalamineError) as error:
        raise _unreadable(where, error) from None
    except BaseException as error:
        if type(error).__name__ == "PanicException":  # a bug of the library in compiled code; no Exception subclass
            raise _unreadable(where, error) from None
        raise


def _unreadable(where: str, error: BaseException) -> RefusedError:
    return RefusedError(
        f"the workbook cannot be read: {' '.join(str(error).split())[:200] or type(error).__name__}",
        where=where,
        expected="a whole Excel or OpenDocument file",
        remedy="Copy the file again, or save it anew",
    )


def _texts(row: Sequence[Any]) -> tuple[str, ...]:
    return tuple(" ".join(_shown(cell).split()) for cell in row)


def _shown(cell: Any) -> str:
    if isinstance(cell, float) and cell.is_integer():
        return str(int(cell))
    if isinstance(cell, datetime | date | time):
        return cell.isoformat()
    return "" if cell is None else str(cell)
