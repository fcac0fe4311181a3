"""Universal files (UFF, data sets of type 58) through pyuff, an optional extra.

A column is the number of a type-58 set from 0, or its first description line where only one set has it. The set's own
abscissa is its time, or the frequency of a response, where the mapping gives none; its labels are its unit. Responses are
complex, as e^{jωt}. Data sets of other types (meshes, modes) are left out.
"""

from __future__ import annotations

import contextlib
import re
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ingest.array_numbers import numbers_from_array
from ingest.columns import Numbers, OwnTime, named_column
from ingest.compressed import plain_file
from ingest.extras import advise_install
from ingest.mapping import ColumnName, FileMapping
from schemas.arrays import Float
from schemas.errors import DealabError, MissingExtraError, RefusedError
from schemas.units import conversion

_FUNCTION = 58
_TIME_RESPONSE, _FREQUENCY_RESPONSE = 1, 4
_TYPES = {
    0: "general", 1: "a time response", 2: "an auto spectrum", 3: "a cross spectrum", 4: "a frequency response",
    5: "a transmissibility", 6: "a coherence", 7: "an auto correlation", 8: "a cross correlation",
    9: "a power spectral density", 10: "an energy spectral density", 12: "a spectrum", 24: "a shock response spectrum",
    27: "an order function",
}  # fmt: skip
"""Function types of the standard's record 6."""
_ACCELERATION = 12
_MARK = re.compile(rb"(?m)^ {4}-1[ ]*\r?$")
"""The line before and behind each data set."""
_MARK_BEHIND = re.compile(rb" {4}-1[ ]*(?:\r?\n|\r?\Z)")
"""The mark behind binary numbers, which need not begin a line."""
_BINARY = re.compile(rb"[^\n]*\n *58b(?P<order>.{6}).{6}(?P<lines>.{12})(?P<size>.{12})[^\n]*\n", re.IGNORECASE)
"""The first two lines of a set of binary numbers: how many lines of text follow, and how many bytes behind them."""
_END = b"    -1\n"
_HEAD = 14
"""Lines of a set of type 58 up to its first values: the mark, the type, eleven lines of what it is."""
_FORM = 8
"""Which of them says how many values there are, of what type, and whether each has an abscissa of its own."""
_SIZES = {2: (4, 1), 4: (8, 1), 5: (4, 2), 6: (8, 2)}
"""Type of values → bytes of a number, numbers of a value."""
_NO_LABEL = ("", "NONE")


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
        found = self._set(column)
        if np.iscomplexobj(found["data"]):
            raise self._wrong_kind(column, int(found.get("func_type", 0)), _TIME_RESPONSE)
        return numbers_from_array(found["data"], column, index, self.where)

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        return list(np.asarray(self._set(column)["data"]).tolist())

    def unit(self, column: ColumnName) -> str | None:
        found = self._set(column)
        above, below = _unit(found, "ordinate"), _unit(found, "orddenom")
        if above is None or below is None or int(found.get("func_type", 0)) != _FREQUENCY_RESPONSE:
            return above
        return f"({above})/({below})"

    def own_time(self, column: ColumnName) -> OwnTime | None:
        found = self._set(column)
        elapsed = self._axis(column, found, _TIME_RESPONSE, "s")
        return OwnTime(elapsed, None)

    def own_frequency(self, column: ColumnName) -> Float | None:
        return self._axis(column, self._set(column), _FREQUENCY_RESPONSE, "Hz")

    def _axis(self, column: ColumnName, found: Mapping[str, Any], wanted: int, canonical: str) -> Float:
        """The abscissa of a set of the wanted function type, in a canonical unit."""
        kind = int(found.get("func_type", 0))
        if kind != wanted:
            raise self._wrong_kind(column, kind, wanted)
        unit = _unit(found, "abscissa") or canonical
        change = conversion(unit, canonical, where=f"{self.where}: abscissa of set {column}")
        return change.apply(np.asarray(found["x"], dtype=np.float64))

    def _wrong_kind(self, column: ColumnName, kind: int, wanted: int) -> RefusedError:
        return RefusedError(
            f"set {column} has function type {kind}, {_TYPES.get(kind, 'of another kind')}",
            where=self.where,
            expected=f"type {wanted}, {_TYPES[wanted]}",
            remedy='Map it with kind = "frequency_response" and [columns.response]'
            if kind == _FREQUENCY_RESPONSE
            else "",
        )

    def _set(self, column: ColumnName) -> Mapping[str, Any]:
        return self.sets[named_column(self.names(), column, self.where)]


def _unit(found: Mapping[str, Any], axis: str) -> str | None:
    """The unit of an axis; of an acceleration `g` is the earth's and no gram."""
    label = str(found.get(f"{axis}_axis_units_lab", "")).strip()
    if label.upper() in _NO_LABEL:
        return None
    return "g_0" if label == "g" and int(found.get(f"{axis}_spec_data_type", 0)) == _ACCELERATION else label


def read_uff(path: Path, mapping: FileMapping) -> UffFile:
    """The type-58 sets of a file. Raises `MissingExtraError` without pyuff, `RefusedError` for a damaged file."""
    try:
        with warnings.catch_warnings():  # pyuff sets the process's warning filters when it is imported
            import pyuff
    except ImportError:
        raise MissingExtraError(
            "UFF files need the package pyuff, which is not installed",
            where=path.name,
            remedy=advise_install("uff"),
        ) from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with plain_file(path) as (plain, lost), _ended(plain) as (whole, cut):
                file = pyuff.UFF(str(whole))
                kinds = [int(kind) for kind in file.get_set_types()]
                sets = tuple(file.read_sets(i) for i, kind in enumerate(kinds) if kind == _FUNCTION)
    except DealabError:
        raise
    except Exception as error:  # pyuff raises bare Exception and whatever its parser meets in a damaged file
        raise RefusedError(
            f"the file cannot be read as UFF: {str(error)[:200] or type(error).__name__}",
            where=path.name,
            expected="a whole universal file",
            remedy="Copy the file again, or export it anew",
        ) from None
    others = sorted(set(kinds) - {_FUNCTION})
    shown = ", ".join(map(str, others))
    if not sets:
        raise RefusedError(
            "the file has no data set of type 58" + (f"; it has sets of type {shown}" if others else ""),
            where=path.name,
            expected="time responses or frequency responses",
        )
    read = [_checked(found, i, path.name) for i, found in enumerate(sets)]
    return UffFile(
        path.name,
        tuple(found for found, _ in read),
        lost + cut + tuple(problem for _, problem in read if problem),
        (f"data sets of type {shown} are left out",) if others else (),
    )


@contextlib.contextmanager
def _ended(path: Path) -> Iterator[tuple[Path, tuple[str, ...]]]:
    """The file; where it ends within a data set, a copy in which that set ends behind its last whole value; and its problems.

    The parser passes over a set without an end.
    """
    content = path.read_bytes()
    begin = _find_open_set(content)
    if begin is None:
        yield path, ()
        return
    binary = _BINARY.match(content, begin)
    whole = _whole_values(content, begin, binary) if binary else content[: content.rfind(b"\n") + 1]
    if whole is None or (not binary and whole.count(b"\n", begin) < _HEAD):
        whole, end, lost = content[:begin], b"", "the file ends in the head of a data set, which is lost"
    else:
        end, lost = _END, "the last data set has no end"
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "ended.uff"
        copy.write_bytes(whole + end)
        yield copy, (lost,)


def _find_open_set(content: bytes) -> int | None:
    """Where the data set begins that has no end; None where each has one."""
    at = 0
    while (mark := _MARK.search(content, at)) is not None:
        binary = _BINARY.match(content, mark.start())
        if binary:
            values = _begin_of_values(content, mark.start(), binary)
            behind = values + max(0, _number(binary["size"]))  # a number of bytes that is wrong may lead beyond the end
            end = _MARK_BEHIND.search(content, behind) or _MARK_BEHIND.search(content, values)
        else:
            end = _MARK.search(content, mark.end())
        if end is None:
            return mark.start()
        at = end.end()
    return None


def _begin_of_values(content: bytes, begin: int, binary: re.Match[bytes]) -> int:
    """Where the numbers of a binary set begin; the end of the content where its head is not whole."""
    at = binary.end()
    for _ in range(_number(binary["lines"]) if _number(binary["lines"]) >= 0 else _HEAD - 3):
        at = content.find(b"\n", at) + 1
        if not at:
            return len(content)
    return at


def _whole_values(content: bytes, begin: int, binary: re.Match[bytes]) -> bytes | None:
    """The content up to the last whole value of a binary set that has no end; None where there is none."""
    at = _begin_of_values(content, begin, binary)
    head = content[begin:at].split(b"\n")
    if len(head) < _HEAD:
        return None
    form = head[_FORM]
    size, numbers = _SIZES.get(_number(form[:10]), (0, 0))
    value = size * (numbers + (_number(form[20:30]) == 0))
    there = len(content) - at
    if 0 < _number(binary["size"]) <= there:
        there = _number(binary["size"])
    kept = there // value * value if value else 0
    return content[: at + kept] if kept else None


def _number(text: bytes) -> int:
    """A whole number of a head; −1 where there is none."""
    try:
        return int(text)
    except ValueError:
        return -1


def _checked(found: Mapping[str, Any], number: int, where: str) -> tuple[Mapping[str, Any], str]:
    """A set with as many values as it says, and what is wrong where it has fewer."""
    if "data" not in found:  # pyuff passes over numbers of a type that it does not know
        raise RefusedError(
            f"set {number} has values of type {found.get('ord_data_type')}",
            where=where,
            expected=f"one of the types {', '.join(map(str, _SIZES))}",
            remedy="Copy the file again, or export it anew",
        )
    count, values, x = int(found.get("num_pts", 0)), np.asarray(found["data"]), np.asarray(found["x"])
    size = min(values.size, x.size)
    if size < count:
        return {**found, "data": values[:size], "x": x[:size]}, f"set {number} has {size} of {count} values: it is cut"
    return {**found, "data": values[:count], "x": x[:count]}, ""
