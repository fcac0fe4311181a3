"""Trees of arrays: the `ColumnFile` that MATLAB and HDF5 share. A path names an array, `index` a column of a matrix."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ingest.array_numbers import cell_text, column_of, numbers_from_array
from ingest.columns import Numbers, OwnTime, missing_column
from ingest.mapping import ColumnName, column_label
from ingest.packing import Packing
from schemas.arrays import Float
from schemas.errors import RefusedError

_ELEMENT = re.compile(r"[({](\d+)[)}]")
"""An element as MATLAB writes it, counted from 1: `ch(2)`, `c{2}`."""


@dataclass(frozen=True)
class Held:
    """What stands at a path: how it is read, its shape and unit, and how its numbers are packed.

    `refusal` says what it is where it is no array of numbers or texts (`a sparse matrix`), `remedy` what to do then.
    """

    read: Callable[[], Any]
    shape: tuple[int, ...] = ()
    unit: str | None = None
    packing: Packing | None = None
    refusal: str = ""
    remedy: str = ""


@dataclass(frozen=True)
class ArrayFile:
    """Arrays by path; a `ColumnFile`.

    Each array is read when it is asked for, so that only mapped ones are. With `transpose` samples run along the columns
    of a matrix instead of its rows. `root` stands before every path.
    """

    where: str
    held: Mapping[str, Held]
    separator: str
    root: str = ""
    transpose: bool = False
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return tuple(name for name, held in self.held.items() if not held.refusal)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        held = self._held(column)
        found = numbers_from_array(self._array(held), column, index, self.where)
        return found if held.packing is None else held.packing.unpack(found)

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        held = self._held(column)
        array = np.asarray(self._array(held))
        if array.dtype.kind in "biuf":
            return list(self.numbers(column, index).values)
        values = column_of(array, column, index, self.where)
        return [cell_text(c) if isinstance(c, bytes | str) else c for c in values.tolist()]

    def shape(self, column: ColumnName) -> tuple[int, ...]:
        """The shape of an array, for people who map it."""
        return self._held(column).shape

    def unit(self, column: ColumnName) -> str | None:
        return self._held(column).unit

    def own_time(self, column: ColumnName) -> OwnTime | None:
        return None

    def own_frequency(self, column: ColumnName) -> Float | None:
        return None

    def _path(self, column: ColumnName) -> str:
        parts = [p for p in (self.root.strip(self.separator), str(column).strip(self.separator)) if p]
        path = self.separator.join(parts)
        if path in self.held or self.separator != ".":
            return path
        return _ELEMENT.sub(lambda match: f".{int(match[1]) - 1}", path)

    def _held(self, column: ColumnName) -> Held:
        path = self._path(column)
        if path not in self.held:
            raise missing_column(self.names() or self._others(), path, self.where)
        held = self.held[path]
        if held.refusal:
            raise RefusedError(
                f"{column_label(column)} is {held.refusal}",
                where=self.where,
                expected="an array of numbers",
                remedy=held.remedy or "Save it as plain numbers",
            )
        return held

    def _others(self) -> tuple[str, ...]:
        """What the file holds that is no array, for the message about a file without any."""
        return tuple(f"{name} ({held.refusal})" for name, held in self.held.items())

    def _array(self, held: Held) -> Any:
        array = held.read()
        return np.asarray(array).T if self.transpose else array
