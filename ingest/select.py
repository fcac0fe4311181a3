"""The rows of a file that a mapping selects: one of several runs, specimens or sets in one file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ingest.columns import ColumnFile, Numbers, OwnTime
from ingest.mapping import ColumnName, Selection, column_label
from ingest.notations import read_cell
from schemas.arrays import Bool, Float, Int
from schemas.errors import RefusedError

_AWAY = 3
"""Rows in between from which a value has come back: fewer are outliers."""
_LAST_DIGIT = 1e-9
"""Share of a tolerance by which the last digit of a double may miss it."""


def selected_rows(file: ColumnFile, select: Sequence[Selection], count: int, where: str) -> Bool:
    """(count,) true for the rows that pass every selection. Raises `RefusedError` when none does."""
    keep = np.ones(count, dtype=bool)
    for selection in select:
        if selection.column is None:
            keep &= _counted(selection, count, where)
            continue
        cells = file.cells(selection.column)
        if len(cells) != count:
            raise RefusedError(
                f"column {column_label(selection.column)} of [[select]] has {len(cells)} rows, others {count}",
                where=where,
                expected="columns of the same length",
            )
        here = np.fromiter((_passes(cell, selection) for cell in cells), bool, len(cells))
        if selection.run is not None:
            runs = split_runs(here)
            here = np.isin(np.arange(count), runs[selection.run - 1]) if selection.run <= len(runs) else here & False
        keep &= here
        if not keep.any():
            shown = ", ".join(dict.fromkeys(str(cell)[:20] for cell in list(cells)[:200]))
            raise RefusedError(
                f"no row has {_wanted(selection)} in column {column_label(selection.column)}",
                where=where,
                expected=f"one of {shown[:200]}",
            )
    return keep


def split_runs(here: Bool) -> list[Int]:
    """The rows of each time that a column comes to a value, where (n,) rows hold it: several rows of others stand between."""
    rows = np.flatnonzero(here)
    return [run for run in np.split(rows, np.flatnonzero(np.diff(rows) > _AWAY) + 1) if run.size]


def _counted(selection: Selection, count: int, where: str) -> Bool:
    """(count,) true from the first to the last row of a selection that counts them."""
    first = selection.first_row or 0
    last = count - 1 if selection.last_row is None else min(selection.last_row, count - 1)
    if not 0 <= first <= last:
        raise RefusedError(
            f"[[select]] asks for the rows {first} to {last} of {count}",
            where=where,
            expected="rows of the file, from 0",
        )
    rows = np.arange(count)
    return (rows >= first) & (rows <= last)


def _passes(cell: Any, selection: Selection) -> bool:
    """Whether a cell is one of the values, within the tolerance, or lies in the range."""
    if selection.at_least is None and selection.at_most is None and not selection.tolerance:
        return any(same_cell(cell, v) for v in selection.equals)
    number = as_number(cell)
    if number is None:
        return False
    if selection.tolerance:
        wanted = [as_number(v) for v in selection.equals]
        return any(abs(number - v) <= selection.tolerance * (1 + _LAST_DIGIT) for v in wanted if v is not None)
    low, high = selection.at_least, selection.at_most
    return (low is None or number >= low) and (high is None or number <= high)


def as_number(cell: Any) -> float | None:
    """A cell as a number, with a decimal point or comma; None where it is none."""
    try:
        number = float(cell)
    except (TypeError, ValueError):
        found = read_cell(str(cell).strip(), ",") if "," in str(cell) else read_cell(str(cell).strip())
        number = math.nan if found is None else found.value
    return number if math.isfinite(number) else None


def _wanted(selection: Selection) -> str:
    if selection.equals:
        near = f" ± {selection.tolerance:g}" if selection.tolerance else ""
        return f"{list(selection.equals)}{near}"
    low, high = selection.at_least, selection.at_most
    return f"a number{'' if low is None else f' from {low:g}'}{'' if high is None else f' to {high:g}'}"


@dataclass(frozen=True)
class SelectedRows:
    """A file of columns of which only the rows in `keep` (n,) are there; a `ColumnFile`."""

    file: ColumnFile
    keep: Bool

    @property
    def problems(self) -> tuple[str, ...]:
        return self.file.problems

    @property
    def notes(self) -> tuple[str, ...]:
        return (*self.file.notes, f"{int(self.keep.sum())} of {self.keep.size} rows are selected")

    def names(self) -> tuple[str, ...]:
        return self.file.names()

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        found = self.file.numbers(column, index)
        if found.values.size != self.keep.size:
            return found
        place = np.cumsum(self.keep) - 1

        def moved(by_row: Mapping[int, Any]) -> dict[int, Any]:
            return {int(place[row]): value for row, value in by_row.items() if self.keep[row]}

        def rows(by_name: Mapping[str, Any]) -> dict[str, Any]:
            kept = {name: place[where[self.keep[where]]] for name, where in by_name.items()}
            return {name: where for name, where in kept.items() if where.size}

        values, empty = found.values[self.keep], found.empty[self.keep]
        return replace(
            found,
            values=values,
            empty=empty,
            texts=int((~np.isfinite(values) & ~empty).sum()) if found.texts else 0,
            units=rows(found.units),
            notations=rows(found.notations),
            bounds=moved(found.bounds),
            odd=moved(found.odd),
        )

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        cells = self.file.cells(column, index)
        return [c for c, kept in zip(cells, self.keep, strict=True) if kept] if len(cells) == self.keep.size else cells

    def unit(self, column: ColumnName) -> str | None:
        return self.file.unit(column)

    def own_time(self, column: ColumnName) -> OwnTime | None:
        own = self.file.own_time(column)
        if own is None or own.elapsed_s.size != self.keep.size:
            return own
        return replace(own, elapsed_s=own.elapsed_s[self.keep])

    def own_frequency(self, column: ColumnName) -> Float | None:
        own = self.file.own_frequency(column)
        return own if own is None or own.size != self.keep.size else own[self.keep]


def same_cell(cell: Any, value: Any) -> bool:
    """Whether a cell holds a value: as numbers where both are, as text without outer blanks else."""
    if isinstance(cell, bool) or isinstance(value, bool):
        return _as_truth(cell) == _as_truth(value)
    try:
        return math.isclose(float(cell), float(value), rel_tol=0.0, abs_tol=0.0)
    except (TypeError, ValueError):
        return str(cell).strip() == str(value).strip()


def _as_truth(value: Any) -> str:
    """A truth value as text; spreadsheets and arrays have 1 and 0 for it."""
    text = str(value).strip().lower()
    return {"1": "true", "1.0": "true", "0": "false", "0.0": "false"}.get(text, text)
