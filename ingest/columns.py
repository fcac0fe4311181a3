"""What every reader of columns yields, and how cells become numbers.

`ColumnFile` is the small protocol behind which all formats look alike; `ingest.assemble`
and `ingest.tables` take it from there. Does not belong here: any file format, units, the meaning of a column.
"""

from __future__ import annotations

import contextlib
import unicodedata
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from ingest.mapping import ColumnName, column_label
from schemas.arrays import Bool, Float, Int
from schemas.errors import RefusedError
from schemas.units import Conversion

CELL_LIMIT = 1 << 28
"""Most numbers that one column or array may hold (2 GiB of doubles)."""
_MOST_TOLD = 4
"""Things that are wrong with a file and told beside the reason for which it is refused, at most."""


@dataclass(frozen=True)
class Numbers:
    """A column as numbers: `values` (n,) with NaN where a cell has none; `texts` cells held something else.

    `example` is the first such cell, for messages; `empty` (n,) marks cells that hold nothing at all.

    Of cells that are no plain numbers: `units` says which rows carry a unit of their own, their values as they stand
    there; `notations` which rows are written in which way; `bounds` which are only known to be above (1) or below (−1);
    `odd` how they are written, for messages. Rows count from 0.

    Of packed numbers: `unpacked` is what the file itself says to be done to its raw numbers, and was done; `doubtful`
    names attributes that may be a scale as well. `notes` is what is worth knowing.
    """

    values: Float
    empty: Bool
    texts: int = 0
    example: str = ""
    units: Mapping[str, Int] = field(default_factory=dict)
    notations: Mapping[str, Int] = field(default_factory=dict)
    bounds: Mapping[int, int] = field(default_factory=dict)
    odd: Mapping[int, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    unpacked: Conversion | None = None
    doubtful: tuple[str, ...] = ()


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

    def own_frequency(self, column: ColumnName) -> Float | None:
        """(n,) frequencies in Hz that the file itself gives the column, None when it gives none."""


def named_column(names: Sequence[str], column: ColumnName, where: str) -> int:
    """Position of a column given by its name or its number from 0.

    Raises `RefusedError` when there is no such column or when several have the name.
    """
    if isinstance(column, int):
        if column < len(names):
            return column
        raise missing_column(names, column, where)
    positions = [i for i, name in enumerate(names) if name == column.strip()]
    if not positions:
        positions = [i for i, name in enumerate(names) if plain_name(name) == plain_name(column)]
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


def plain_name(name: str) -> str:
    """A name as it looks: what the eye cannot tell apart (blanks, µ and μ, composed letters) is the same."""
    return " ".join(unicodedata.normalize("NFKC", name).split())


@contextlib.contextmanager
def telling(problems: Sequence[str]) -> Iterator[None]:
    """A refusal within it tells beside its reason what is wrong with the file: what is asked for may be lost with it."""
    try:
        yield
    except RefusedError as error:
        if not problems:
            raise
        told = f"{error.problem} ({'; '.join(problems[:_MOST_TOLD])})"
        raise RefusedError(told, where=error.where, expected=error.expected, remedy=error.remedy) from None


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
