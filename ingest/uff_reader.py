"""Universal files (UFF, data sets of type 58) through pyuff, an optional extra.

A column is the number of a type-58 set from 0, or its first description line where only one set has it. The set's own
abscissa is its time where the mapping gives none; its ordinate's label is its unit.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ingest.columns import Numbers, OwnTime, named_column, numbers_from_array
from ingest.mapping import ColumnName, FileMapping
from schemas.errors import MissingExtraError, RefusedError

_FUNCTION = 58
_TIME_RESPONSE = 1


@dataclass(frozen=True)
class UffFile:
    """The type-58 sets of a file; a `ColumnFile`."""

    where: str
    sets: tuple[Mapping[str, Any], ...]
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def names(self) -> tuple[str, ...]:
        return tuple(str(s.get("id1", "")).strip() for s in self.sets)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        return numbers_from_array(self._set(column)["data"], column, index, self.where)

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        return list(self.numbers(column, index).values)

    def unit(self, column: ColumnName) -> str | None:
        label = str(self._set(column).get("ordinate_axis_units_lab", "")).strip()
        return label if label and label.upper() != "NONE" else None

    def own_time(self, column: ColumnName) -> OwnTime | None:
        found = self._set(column)
        if int(found.get("func_type", 0)) != _TIME_RESPONSE:
            raise RefusedError(
                f"set {column} has function type {found.get('func_type')}",
                where=self.where,
                expected="type 1, a time response",
            )
        return OwnTime(np.asarray(found["x"], dtype=np.float64), None)

    def _set(self, column: ColumnName) -> Mapping[str, Any]:
        return self.sets[named_column(self.names(), column, self.where)]


def read_uff(path: Path, mapping: FileMapping) -> UffFile:
    """The type-58 sets of a file. Raises `MissingExtraError` without pyuff, `RefusedError` for a damaged file."""
    try:
        with warnings.catch_warnings():  # pyuff sets the process's warning filters when it is imported
            import pyuff
    except ImportError:
        raise MissingExtraError(
            "UFF files need the package pyuff, which is not installed",
            where=path.name,
            remedy="Install it: pip install dealab[uff]",
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            file = pyuff.UFF(str(path))
            numbers = [i for i, kind in enumerate(file.get_set_types()) if int(kind) == _FUNCTION]
            sets = tuple(file.read_sets(i) for i in numbers)
    except Exception as error:  # pyuff raises bare Exception and whatever its parser meets in a damaged file
        raise RefusedError(
            f"the file cannot be read as UFF: {str(error)[:200] or type(error).__name__}",
            where=path.name,
            expected="a whole universal file",
            remedy="Copy the file again, or export it anew",
        ) from None
    if not sets:
        raise RefusedError("the file has no data set of type 58", where=path.name, expected="time responses")
    return UffFile(path.name, sets)
