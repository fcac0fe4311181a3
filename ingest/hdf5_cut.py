"""HDF5 files that are cut: their head says how long they were, the library refuses them whole, and most of them is there.

A cut file is opened as if zeros stood where it ends. Of each array the parts are known that lay behind the end: their
values are lost. Structures that lay there are none, and whatever needs them is refused. Runs in the child process of
`ingest.hdf5_reader`, but for `find_declared_size`.
"""

from __future__ import annotations

import contextlib
import io
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_PLACES = (0, 512, 1024, 2048)
"""Where the head of a file may stand: a program's own block before it is a power of two."""
_MOST_TIMES = 16
"""A head that says more than this many times what is there is damaged itself."""


def find_declared_size(path: Path) -> int | None:
    """How long a file was when it was closed, by its head; None where that is not more than what is there."""
    with path.open("rb") as file:
        start = file.read(_PLACES[-1] + 64)
    there = path.stat().st_size
    begin = next((place for place in _PLACES if start.startswith(_SIGNATURE, place)), None)
    if begin is None:
        return None
    head = start[begin + 8 : begin + 64]
    if len(head) < 56:
        return None
    version, widths = head[0], (head[5] if head[0] < 2 else head[1])
    if version > 3 or widths != 8:
        return None
    (declared,) = struct.unpack_from("<Q", head, {0: 32, 1: 36}.get(version, 20))
    return declared if there < declared <= _MOST_TIMES * there else None


@contextlib.contextmanager
def open_left(path: Path) -> Iterator[tuple[Any, int | None]]:
    """The open file, and how many bytes of it are there where it is cut."""
    import h5py

    declared = find_declared_size(path)
    if declared is None:
        with h5py.File(path, "r") as file:
            yield file, None
        return
    with _Padded(path, declared) as padded, h5py.File(padded, "r") as file:
        yield file, path.stat().st_size


def read_left(dataset: Any, there: int) -> tuple[Any, Any]:
    """The values of an array, and which of its elements are lost because they stood behind the end."""
    shape = dataset.shape
    lost = np.zeros(shape, dtype=bool)
    if dataset.chunks is None:
        begin = dataset.id.get_offset()
        if begin is not None:
            whole = max(there - begin, 0) // max(dataset.dtype.itemsize, 1)
            lost.reshape(-1)[whole:] = True
        return dataset[()], lost
    lost[...] = True
    values = np.zeros(shape, dtype=dataset.dtype)
    for number in range(dataset.id.get_num_chunks()):
        chunk = dataset.id.get_chunk_info(number)
        if chunk.byte_offset + chunk.size <= there:
            part = tuple(
                slice(at, min(at + width, end))
                for at, width, end in zip(chunk.chunk_offset, dataset.chunks, shape, strict=True)
            )
            values[part] = dataset[part]
            lost[part] = False
    return values, lost


def without_lost(values: Any, lost: Any) -> Any:
    """Numbers with the lost ones as NaN. Raises `ValueError` for what has no NaN."""
    if not lost.any():
        return values
    if values.dtype.kind not in "biufc":
        raise ValueError("part of it is lost, and it holds no numbers")
    values = values.astype(np.complex128 if values.dtype.kind == "c" else np.float64)
    values[lost] = np.nan
    return values


class _Padded(io.RawIOBase):
    """A file that goes on with zeros up to a size."""

    def __init__(self, path: Path, size: int) -> None:
        self._file = path.open("rb")
        self._size, self._at = size, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        self._at = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._at, os.SEEK_END: self._size}[whence]
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        wanted = memoryview(buffer).cast("B")
        count = max(0, min(len(wanted), self._size - self._at))
        self._file.seek(self._at)
        found = self._file.read(count)
        wanted[:count] = found + bytes(count - len(found))
        self._at += count
        return count

    def close(self) -> None:
        self._file.close()
        super().close()
