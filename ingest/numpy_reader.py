"""NumPy files: `.npz` by the names of its arrays, `.npy` as its one array `arr_0`. Pickled objects are never opened.

`index` is the column of a matrix; a field of a structured array is `array/field`. Sizes are checked before anything is
inflated. A `.npy` that was cut keeps its whole rows, a `.npz` its whole arrays and what there is of the last. Does not belong here: what is done with arrays (`ingest.arrays`).
"""

from __future__ import annotations

import ast
import functools
import io
import math
import struct
import warnings
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy

from ingest.arrays import ArrayFile, Held
from ingest.columns import CELL_LIMIT, telling
from ingest.mapping import FileMapping
from ingest.zip_cut import Member, is_cut, list_members
from schemas.errors import RefusedError

_ONLY = "arr_0"
"""What NumPy itself calls an array without a name."""
_LARGEST = CELL_LIMIT * 8
_LARGEST_HEAD = 1 << 16
_MOST_TIMES = 2000
"""An array that says it is this many times larger than what there is of it is damaged itself; zeros deflate a thousandfold."""
_DAMAGED = (
    OSError, ValueError, TypeError, EOFError, RuntimeError, KeyError, SyntaxError, MemoryError, OverflowError,
    zipfile.BadZipFile, zlib.error, struct.error, AttributeError,
)  # fmt: skip
"""What NumPy and zipfile raise for damaged files."""


@dataclass(frozen=True)
class _Head:
    """What the head of an array says: its shape, order and type, and how many bytes it takes itself."""

    shape: tuple[int, ...]
    by_columns: bool
    kind: np.dtype[Any]
    size: int

    @property
    def rows(self) -> int:
        return self.shape[0] if self.shape else 1

    @property
    def row_bytes(self) -> int:
        return math.prod(self.shape[1:]) * self.kind.itemsize


def read_numpy(path: Path, mapping: FileMapping) -> ArrayFile:
    """The arrays of a file. Raises `RefusedError` for a damaged or oversized one."""
    with path.open("rb") as file:
        is_archive = file.read(2) == b"PK"
    problems: list[str] = []
    if not is_archive:
        listed = _list_single(path, problems)
    elif is_cut(path):
        listed = _list_cut_archive(path, problems)
    else:
        listed = _list_archive(path)
    held = dict(listed)
    if not held:
        with telling(problems):
            raise RefusedError("the file holds no arrays", where=path.name, expected="arrays")
    return ArrayFile(
        where=path.name,
        held=held,
        separator="/",
        root=mapping.options.get("root", ""),
        transpose=mapping.options.get("transpose", False),
        problems=tuple(problems),
    )


def _list_single(path: Path, problems: list[str]) -> Iterator[tuple[str, Held]]:
    try:
        with path.open("rb") as file:
            head = _read_head(file)
    except _DAMAGED as error:
        raise _unreadable(path, error) from None
    there = path.stat().st_size - head.size
    rows = head.rows if head.row_bytes == 0 else min(head.rows, there // head.row_bytes)
    if rows < head.rows and not head.kind.hasobject:
        if head.by_columns and len(head.shape) > 1:
            raise _unreadable(path, EOFError("it is cut, and its columns stand one behind the other"))
        if not rows:
            raise _unreadable(path, EOFError("it has no whole row"))
        problems.append(f"{_ONLY} has {rows} of {head.rows} rows: the file is cut")
    yield from _hold(path, _ONLY, head, functools.partial(_read_single, path, head, rows), rows)


def _read_single(path: Path, head: _Head, rows: int) -> Any:
    try:
        with path.open("rb") as file:
            file.seek(head.size)
            return _as_array(file.read(rows * head.row_bytes), head, rows)
    except _DAMAGED as error:
        raise _unreadable(path, error) from None


def _list_archive(path: Path) -> Iterator[tuple[str, Held]]:
    try:
        with zipfile.ZipFile(path) as archive:
            members = [m for m in archive.infolist() if m.filename.endswith(".npy")]
            heads = []
            for member in members:
                with archive.open(member) as file:
                    heads.append(_read_head(file))
    except _DAMAGED as error:
        raise _unreadable(path, error) from None
    for member, head in zip(members, heads, strict=True):
        name = member.filename.removesuffix(".npy")
        yield from _hold(path, name, head, functools.partial(_read_member, path, member.filename, head), head.rows)


def _list_cut_archive(path: Path, problems: list[str]) -> Iterator[tuple[str, Held]]:
    """The arrays of an archive without its end; rows that are lost of the last one are NaN."""
    problems.append("the file ends too early: arrays that stood behind its end are lost")
    for member in list_members(path.read_bytes()):
        name = member.name.removesuffix(".npy")
        try:
            head = _read_head(io.BytesIO(member.begin(_LARGEST_HEAD)))
        except _DAMAGED:
            problems.append(f"{name[:60]} is left out: its beginning is damaged or cut")
            continue
        if member.is_whole:
            yield from _hold(path, name, head, functools.partial(_read_begin, path, member, head), head.rows)
            continue
        rows = 0 if member.is_there else _count_rows(member, head)
        if not rows:
            problems.append(
                f"{name[:60]} is left out: " + ("its checksum does not agree" if member.is_there else "it is cut")
            )
            continue
        problems.append(f"{name[:60]} has {rows} of {head.rows} rows: the file is cut")
        kept = rows if head.kind.names else head.rows  # fields are all as long
        yield from _hold(path, name, head, functools.partial(_read_begin, path, member, head, rows), kept)


def _count_rows(member: Member, head: _Head) -> int:
    """Whole rows that are there of an array that is cut; none where they cannot be told apart or completed."""
    by_rows = not head.by_columns or len(head.shape) < 2
    whole = head.rows * head.row_bytes
    if (
        not by_rows
        or head.kind.kind not in "iufV"
        or head.kind.hasobject
        or not 0 < whole <= min(_LARGEST, _MOST_TIMES * len(member.packed))
    ):
        return 0
    try:
        return max(0, len(member.begin(head.size + whole)) - head.size) // head.row_bytes
    except zlib.error:
        return 0


def _read_begin(path: Path, member: Member, head: _Head, rows: int | None = None) -> Any:
    """The array of a member; of one that is cut its first `rows`, and NaN."""
    try:
        there = head.rows if rows is None else rows
        content = member.begin(head.size + there * head.row_bytes)[head.size :]
        array = _as_array(content, head, there)
        if rows is None or head.kind.names:
            return array
        lost = np.full((head.rows - rows, *head.shape[1:]), np.nan)
        return np.concatenate((array.astype(np.float64), lost))
    except _DAMAGED as error:
        raise _unreadable(path, error) from None


def _read_member(path: Path, name: str, head: _Head) -> Any:
    try:
        with zipfile.ZipFile(path) as archive, archive.open(name) as file:
            file.read(head.size)
            content = file.read(head.rows * head.row_bytes + 1)
        if len(content) != head.rows * head.row_bytes:
            raise EOFError(f"{name} has not as many bytes as its head says")
        return _as_array(content, head, head.rows)
    except _DAMAGED as error:
        raise _unreadable(path, error) from None


def _read_head(file: IO[bytes]) -> _Head:
    """The head of an array, without evaluating anything in it. Raises `ValueError` and others for a damaged one."""
    start = file.read(8)
    if not start.startswith(npy.MAGIC_PREFIX) or len(start) < 8:
        raise ValueError("it does not begin as an array")
    wide = start[6] > 1
    (length,) = struct.unpack("<I" if wide else "<H", file.read(4 if wide else 2))
    if start[6] > 3 or length > _LARGEST_HEAD:
        raise ValueError(f"a head of version {start[6]} with {length} bytes")
    text = file.read(length).decode("utf-8" if start[6] > 2 else "latin-1")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what Python has to say about the text of a damaged head
        try:
            said = ast.literal_eval(text.strip())
        except Exception:  # its reasons name places in memory
            raise ValueError("its head does not describe an array") from None
    shape, kind = said["shape"], npy.descr_to_dtype(said["descr"])
    if not isinstance(shape, tuple) or not all(isinstance(n, int) and n >= 0 for n in shape):
        raise ValueError(f"the shape {str(shape)[:60]}")
    return _Head(shape, bool(said["fortran_order"]), kind, 8 + (4 if wide else 2) + length)


def _hold(path: Path, name: str, head: _Head, read: Any, rows: int) -> Iterator[tuple[str, Held]]:
    """The array, or each field of a structured one."""
    shape = (rows, *head.shape[1:]) if head.shape else (1,)
    refusal = remedy = ""
    if head.kind.hasobject:
        refusal, remedy = "pickled Python objects, which are never opened", "Save it as plain numbers"
    elif not head.rows * head.row_bytes:
        refusal = "empty"
    elif head.rows * head.row_bytes > _LARGEST:
        refusal, remedy = f"{head.rows * head.row_bytes >> 20} MiB", f"Save at most {_LARGEST >> 20} MiB in an array"
    if head.kind.names is None or refusal:
        yield name, Held(functools.partial(_plain, read), shape, _unit_of(head.kind), refusal=refusal, remedy=remedy)
        return
    for one in head.kind.names:
        kind, deeper = head.kind[one], head.kind[one].shape
        yield f"{name}/{one}", Held(functools.partial(_plain, read, one), (*shape, *deeper), _unit_of(kind))


def _plain(read: Any, name: str | None = None) -> Any:
    """An array, or one field of it, with durations as seconds and dates as times to the microsecond."""
    array = read() if name is None else read()[name]
    if array.dtype.kind == "m":
        seconds: Any = array / np.timedelta64(1, "s")
        return seconds
    if array.dtype.kind == "M":
        return np.array([None if cell is None else cell for cell in array.astype("datetime64[us]").tolist()], object)
    return array


def _unit_of(kind: np.dtype[Any]) -> str | None:
    return "s" if kind.kind == "m" else None


def _as_array(content: bytes, head: _Head, rows: int) -> Any:
    array = np.frombuffer(content, head.kind)
    shape = (rows, *head.shape[1:]) if head.shape else (1,)
    return array.reshape(shape, order="F" if head.by_columns else "C")


def _unreadable(path: Path, error: BaseException) -> RefusedError:
    return RefusedError(
        f"the file cannot be read as NumPy: {str(error)[:200] or type(error).__name__}",
        where=path.name,
        expected="a whole .npy or .npz file",
        remedy="Copy the file again, or save it anew",
    )
