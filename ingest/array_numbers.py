"""Arrays of binary files as columns of numbers: matrices by column, texts by what they say, everything else refused by name.

Shared by HDF5, MATLAB, TDMS, UFF and MCAP messages. Does not belong here: how a format stores its arrays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ingest.columns import Numbers
from ingest.mapping import ColumnName, column_label
from ingest.notations import read_column
from schemas.errors import RefusedError

_REAL = "biuf"
_TEXT = "OUS"
TRUTHS = "true and false are read as 1 and 0"
"""A note: a flag may be meant, a valve that is open, and may be the wrong column."""
_KINDS = {"c": "complex numbers", "M": "dates", "m": "durations", "V": "structures"}
"""What arrays hold that are no real numbers, by numpy's kind."""


def numbers_from_array(array: Any, column: ColumnName, index: int | None, where: str) -> Numbers:
    """One column of an array as numbers; a matrix needs `index`. Raises `RefusedError` for what holds no real numbers."""
    values = column_of(array, column, index, where)
    if values.dtype.kind in _TEXT:
        found = numbers_from_cells(values.tolist(), column, where)
        if found.texts and not np.isfinite(found.values).any():
            raise RefusedError(
                f'{column_label(column, index)} holds text, not numbers, such as "{found.example}"',
                where=where,
                expected="real numbers",
            )
        return found
    if values.dtype.kind not in _REAL:
        what = _KINDS.get(values.dtype.kind, "something else")
        raise RefusedError(
            f"{column_label(column, index)} holds {values.dtype}: {what}, not numbers",
            where=where,
            expected="real numbers",
            remedy="Save real and imaginary part as arrays of their own" if values.dtype.kind == "c" else "",
        )
    notes = (TRUTHS,) if values.dtype.kind == "b" else ()
    return Numbers(np.array(values, dtype=np.float64), np.zeros(values.shape, dtype=bool), notes=notes)


def column_of(array: Any, column: ColumnName, index: int | None, where: str) -> NDArray[Any]:
    """(n,) values of a vector, or of one column of a matrix. Raises `RefusedError` for other shapes."""
    values = np.asarray(array)
    label = column_label(column, index)
    if values.ndim == 2 and 1 in values.shape and index is None:
        values = values.reshape(-1)
    if values.ndim == 1 and index:
        raise RefusedError(
            f"{label}: there is one column",
            where=where,
            expected="no index, or index 0",
            remedy="Take index out of the mapping TOML",
        )
    if values.ndim == 2 and index is not None:
        if index >= values.shape[1]:
            raise RefusedError(
                f"{label}: the matrix has {values.shape[1]} columns",
                where=where,
                expected=f"index 0 to {values.shape[1] - 1}",
            )
        values = values[:, index]
    if values.ndim != 1:
        shape = " × ".join(map(str, values.shape)) or "one number"
        raise RefusedError(
            f"{label} is {shape}",
            where=where,
            expected="one column of numbers",
            remedy="Give index, the column of the matrix from 0, in the mapping TOML"
            if values.ndim < 3
            else "Save its columns as vectors",
        )
    return values


def numbers_from_cells(cells: Sequence[Any], column: ColumnName, where: str) -> Numbers:
    """Cells of which some or all are texts, read as those of a spreadsheet: see `ingest.notations`."""
    values = np.full(len(cells), math.nan)
    empty = np.zeros(len(cells), dtype=bool)
    rows: list[int] = []
    texts: list[str] = []
    example: str | None = None
    for row, cell in enumerate(cells):
        if cell is None:
            empty[row] = True
        elif isinstance(cell, Real | np.bool_):
            values[row] = as_double(cell)
        else:
            text = cell_text(cell)
            example = example or text
            empty[row] = not text.strip()
            if text.strip():
                rows.append(row)
                texts.append(text)
    found = read_column(values, empty, np.array(rows, dtype=np.int64), texts, column, where)
    if any(isinstance(cell, bool | np.bool_) for cell in cells):
        found = replace(found, notes=(*found.notes, TRUTHS))
    if example is not None and not np.isfinite(found.values).any():
        return replace(found, texts=max(found.texts, 1), example=found.example or example[:40])
    return found


def as_double(number: Any) -> float:
    """A number as a double; whole numbers beyond all doubles are infinite."""
    try:
        return float(number)
    except OverflowError:
        return math.inf if number > 0 else -math.inf


def cell_text(cell: Any) -> str:
    """A cell as text, without the zero bytes that fill fixed lengths."""
    text = cell.decode("utf-8", "replace") if isinstance(cell, bytes) else str(cell)
    return text.rstrip("\x00")
