"""MATLAB v5 files that are cut: scipy refuses them whole, and all variables but the last are there.

A file is a head and one element for each variable. Of the variable that the file ends in an array of numbers is kept with
what is lost of it as NaN; of any other kind it is left out. Runs in the child process of `ingest.matlab_reader`.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass

import numpy as np

_HEAD = 128
_LITTLE = b"IM"
_COMPRESSED, _MATRIX, _DOUBLE = 15, 14, 9
_NUMBERS = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 9: "<f8", 12: "<i8", 13: "<u8"}
"""Types of an element that holds numbers."""
_CLASSES = range(6, 16)
"""Classes of variables that are arrays of numbers: double, single and the whole numbers."""
_COMPLEX = 0x800
_MOST_INFLATED = 1 << 28
_MOST_TIMES = 64
"""A variable that says it has more than this many times the numbers that are there is damaged itself."""


@dataclass(frozen=True)
class Left:
    """A file of whole elements, and what was lost."""

    content: bytes
    problems: tuple[str, ...] = ()


def complete(content: bytes) -> Left:
    """The content as it is, or where it is cut as far as it goes."""
    if content[_HEAD - 2 : _HEAD] != _LITTLE:
        return Left(content)
    at = _HEAD
    while at + 8 <= len(content):
        kind, size = struct.unpack_from("<II", content, at)
        if kind not in (_COMPRESSED, _MATRIX):
            return Left(content)  # damaged in another way
        if at + 8 + size > len(content):
            break
        at += 8 + size
    if at == len(content):
        return Left(content)
    last, lost = _mend(content[at:])
    return Left(content[:at] + last, (f"the file is cut: {lost}",))


def _mend(element: bytes) -> tuple[bytes, str]:
    """A whole element in place of a cut one, or none; and what is lost."""
    try:
        return _mend_numbers(element)
    except (struct.error, zlib.error, ValueError, IndexError, UnicodeDecodeError):
        return b"", "the variable that it ends in is left out"


def _mend_numbers(element: bytes) -> tuple[bytes, str]:
    if struct.unpack_from("<I", element)[0] == _COMPRESSED:
        element = zlib.decompressobj().decompress(element[8:], _MOST_INFLATED)
    at = 8
    parts = []
    for _ in range(3):  # what it is, its dimensions, its name
        part, following = _read_part(element, at)
        parts.append((element[at:following], part))
        at = following
    (what,) = struct.unpack_from("<I", parts[0][1])
    name = parts[2][1].decode("ascii")
    shape = np.frombuffer(parts[1][1], "<i4")
    count = math.prod(shape.tolist())
    kind, size = struct.unpack_from("<II", element, at)
    if what & 0xFF not in _CLASSES or what & _COMPLEX or kind not in _NUMBERS:
        return b"", f"the variable {name} is left out"
    width = np.dtype(_NUMBERS[kind]).itemsize
    there = min((len(element) - at - 8) // width, count)
    if size != count * width or not 0 < count <= _MOST_TIMES * there:
        return b"", f"the variable {name} is left out"
    values = np.full(count, np.nan)
    values[:there] = np.frombuffer(element, _NUMBERS[kind], there, at + 8)
    flags = struct.pack("<IIII", 6, 8, what & ~0xFF | 6, 0)
    body = flags + parts[1][0] + parts[2][0] + struct.pack("<II", _DOUBLE, 8 * count) + values.tobytes()
    return struct.pack("<II", _MATRIX, len(body)) + body, f"{name} has {there} of {count} values"


def _read_part(element: bytes, at: int) -> tuple[bytes, int]:
    """The bytes of a part, and where the next one begins. Raises `ValueError` where it is cut."""
    (first,) = struct.unpack_from("<I", element, at)
    if first >> 16:  # a short part stands in its own tag
        size, begin, following = first >> 16, at + 4, at + 8
    else:
        size, begin = struct.unpack_from("<I", element, at + 4)[0], at + 8
        following = begin + (size + 7) // 8 * 8
    if following > len(element) or (first >> 16) > 4:
        raise ValueError("a part is cut")
    return element[begin : begin + size], following
