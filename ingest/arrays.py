"""Trees of arrays: the `ColumnFile` that MATLAB and HDF5 share. A path names an array, `index` a column of a matrix."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ingest.columns import Numbers, OwnTime, missing_column, numbers_from_array
from ingest.mapping import ColumnName


@dataclass(frozen=True)
class ArrayFile:
    """Arrays by path; a `ColumnFile`.

    `arrays` gives each array when it is asked for, so that only mapped ones are read. With `transpose` samples run
    along the columns of a matrix instead of its rows. `root` stands before every path.
    """

    where: str
    arrays: Mapping[str, Callable[[], Any]]
    separator: str
    root: str = ""
    transpose: bool = False
    units: Mapping[str, str] = field(default_factory=dict)
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return tuple(self.arrays)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        return numbers_from_array(self._array(column), column, index, self.where)

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        array = np.asarray(self._array(column))
        if array.dtype.kind in "biuf":
            return list(numbers_from_array(array, column, index, self.where).values)
        if array.ndim == 2 and index is not None and index < array.shape[1]:
            array = array[:, index]
        return [c.decode("utf-8", "replace") if isinstance(c, bytes) else c for c in array.reshape(-1).tolist()]

    def shape(self, column: ColumnName) -> tuple[int, ...]:
        """The shape of an array, for people who map it."""
        return tuple(np.asarray(self._array(column)).shape)

    def unit(self, column: ColumnName) -> str | None:
        return self.units.get(self._path(column))

    def own_time(self, column: ColumnName) -> OwnTime | None:
        return None

    def _path(self, column: ColumnName) -> str:
        parts = [p for p in (self.root.strip(self.separator), str(column).strip(self.separator)) if p]
        return self.separator.join(parts)

    def _array(self, column: ColumnName) -> Any:
        path = self._path(column)
        if path not in self.arrays:
            raise missing_column(self.names(), path, self.where)
        array = self.arrays[path]()
        return np.asarray(array).T if self.transpose else array
