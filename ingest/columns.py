"""What every reader of columns yields, and how cells become numbers.

`ColumnFile` is the small protocol behind which CSV, Excel, MATLAB, HDF5, TDMS and UFF look alike; `ingest.assemble`
and `ingest.tables` take it from there. Does not belong here: any file format, units, the meaning of a column.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ingest.mapping import ColumnName, column_label
from schemas.arrays import Bool, Float
from schemas.errors import RefusedError

CELL_LIMIT = 1 << 28
"""Most numbers that one column or array may hold (2 GiB of doubles)."""


@dataclass(frozen=True)
class Numbers:
    """A column as numbers: `values` (n,) with NaN where a cell has none; `texts` cells held something else.

    `example` is the first such cell, for messages; `empty` (n,) marks cells that hold nothing at all.
    """

    values: Float
    empty: Bool
    texts: int = 0
    example: str = ""


@dataclass(frozen=True)
class OwnTime:
    """Time base that a file gives a column by itself: `elapsed_s` (n,) from `start_ns` (Unix), None when unknown."""

    elapsed_s: Float
    start_ns: int | None


class ColumnFile(Protocol):
    """A file of columns. Names that do not exist raise `RefusedError` naming those that do."""

    @property
    def problems(self) -> tuple[str, ...]:
        """What is lost or wrong in the file."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth knowing and no fault."""

    def names(self) -> tuple[str, ...]:
        """The columns that can be mapped, for messages and `inspect`."""

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        """A column as numbers."""

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        """A column as it stands: text, numbers or times."""

    def unit(self, column: ColumnName) -> str | None:
        """The unit that the file itself gives the column, None when it gives none."""

    def own_time(self, column: ColumnName) -> OwnTime | None:
        """The time base that the file itself gives the column, None when it gives none."""


_SEPARATED = re.compile(r"[+-]?\d{1,3}(?:[.,'’ \u00a0\u202f]\d{3})+(?:[.,]\d+)?")
_OTHER_MARK = re.compile(r"[+-]?\d+[.,]\d+(?:[eE][+-]?\d+)?")


def refuse_other_notation(text: str, column: ColumnName, decimal: str, where: str) -> None:
    """Raises `RefusedError` for a cell that is a number in another notation than the mapping says.

    Such a cell is no lost sample: leaving it out would drop exactly the numbers from 1000 up, or all with decimals.
    """
    if _OTHER_MARK.fullmatch(text) or _SEPARATED.fullmatch(text):
        raise RefusedError(
            f'column {column_label(column)} holds "{text[:40]}"',
            where=where,
            expected=f'numbers with the decimal mark "{decimal}" and without thousands separators',
            remedy="Correct decimal in the mapping TOML, or export without thousands separators",
        )


def named_column(names: Sequence[str], column: ColumnName, where: str) -> int:
    """Position of a column given by its name or its number from 0.

    Raises `RefusedError` when there is no such column or when several have the name.
    """
    if isinstance(column, int):
        if column < len(names):
            return column
        raise missing_column(names, column, where)
    positions = [i for i, name in enumerate(names) if name == column.strip()]
    if len(positions) > 1:
        raise RefusedError(
            f'{len(positions)} columns are named "{column}" (numbers {", ".join(map(str, positions))})',
            where=where,
            expected="one column of that name",
            remedy="Give the column's number (from 0) in the mapping TOML",
        )
    if not positions:
        raise missing_column(names, column, where)
    return positions[0]


def missing_column(names: Sequence[str], column: ColumnName, where: str) -> RefusedError:
    """The error for a mapped column that the file does not have."""
    shown = ", ".join(f'"{name[:60]}"' for name in names[:40] if name)
    if not shown:
        shown = f"numbers 0 to {len(names) - 1}" if names else "none: the file has no columns"
    elif len(names) > 40:
        shown += f" and {len(names) - 40} more"
    return RefusedError(
        f"column {column_label(column)} is not in the file",
        where=where,
        expected=f"one of its columns: {shown}",
        remedy="Correct the column in the mapping TOML",
    )


def numbers_from_array(array: Any, column: ColumnName, index: int | None, where: str) -> Numbers:
    """One column of a numeric array; a matrix needs `index`. Raises `RefusedError` for anything else."""
    values = np.asarray(array)
    label = column_label(column, index)
    if values.dtype.kind not in "biuf":
        raise RefusedError(f"{label} holds {values.dtype}, not numbers", where=where, expected="real numbers")
    if values.ndim == 2 and 1 in values.shape and index is None:
        values = values.reshape(-1)
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
            remedy="Give index, the column of the matrix from 0, in the mapping TOML",
        )
    return Numbers(np.array(values, dtype=np.float64), np.zeros(values.shape, dtype=bool))
