"""Compound files, which old programs of Microsoft keep their streams in: one stream by its name.

Every chain of sectors is followed once at most, so that no loop in a damaged file goes on for ever. Does not belong here: what
the streams hold.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path

_MARK = b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1"
_HEAD = 512
_LARGEST_SECTOR = 0xFFFFFFF9
"""Numbers above are marks: the end of a chain, a free sector."""
_ENTRY = 128
_ROOT = 5


def is_compound(path: Path) -> bool:
    """The file begins as a compound file does."""
    with path.open("rb") as file:
        return file.read(len(_MARK)) == _MARK


def read_stream(content: bytes, name: str) -> bytes:
    """The bytes of a stream as far as they are there, empty where there is none of that name."""
    if len(content) < _HEAD:
        return b""
    power, small_power = struct.unpack_from("<HH", content, 30)
    if not 7 <= power <= 16 or not 4 <= small_power <= power:
        return b""
    size = 1 << power
    directory_at, small_below, small_table_at, more_at = (
        struct.unpack_from("<I", content, place)[0] for place in (48, 56, 60, 68)
    )
    sectors = _list_table_sectors(content, size, more_at)
    table = _as_numbers(b"".join(_sector(content, size, number) for number in sectors))
    directory = _read_chain(content, size, table, directory_at, offset=1)
    entries = [directory[at : at + _ENTRY] for at in range(0, len(directory) - _ENTRY + 1, _ENTRY)]
    for entry in entries:
        if _name_of(entry) != name.casefold():
            continue
        start, length = _place_of(entry)
        if length >= small_below:
            return _read_chain(content, size, table, start, offset=1)[:length]
        root = next((one for one in entries if one[66] == _ROOT), None)
        small = _read_chain(content, size, table, _place_of(root)[0], offset=1) if root is not None else b""
        small_table = _as_numbers(_read_chain(content, size, table, small_table_at, offset=1))
        return _read_chain(small, 1 << small_power, small_table, start, offset=0)[:length]
    return b""


def _list_table_sectors(content: bytes, size: int, more_at: int) -> list[int]:
    """The sectors that hold the table of all sectors: 109 of them stand in the head, the others in a chain of lists."""
    sectors = list(_as_numbers(content[76:_HEAD]))
    for _ in range(len(content) // size):
        if more_at > _LARGEST_SECTOR:
            break
        *listed, more_at = _as_numbers(_sector(content, size, more_at)) or (_LARGEST_SECTOR + 1,)
        sectors += listed
    return [number for number in sectors if number <= _LARGEST_SECTOR][: len(content) // size + 1]


def _read_chain(content: bytes, size: int, table: Sequence[int], start: int, *, offset: int) -> bytes:
    """The sectors of a chain, one behind the other, as long as none comes twice; `offset` sectors stand before the first."""
    parts: list[bytes] = []
    number, seen = start, set()
    while number <= _LARGEST_SECTOR and number not in seen:
        seen.add(number)
        begin = (number + offset) * size
        parts.append(content[begin : begin + size])
        if number >= len(table):
            break
        number = table[number]
    return b"".join(parts)


def _sector(content: bytes, size: int, number: int) -> bytes:
    return content[(number + 1) * size : (number + 2) * size]


def _as_numbers(content: bytes) -> tuple[int, ...]:
    return struct.unpack(f"<{len(content) // 4}I", content[: len(content) // 4 * 4])


def _name_of(entry: bytes) -> str:
    length = int.from_bytes(entry[64:66], "little")
    return entry[: max(0, min(length, 64) - 2)].decode("utf-16-le", "replace").casefold()


def _place_of(entry: bytes) -> tuple[int, int]:
    """The first sector of a stream, and how many bytes it has."""
    start, length = struct.unpack_from("<II", entry, 116)
    return start, length
