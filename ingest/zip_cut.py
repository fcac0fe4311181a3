"""Archives (zip) without their end, where the list of their files stands: the files in them, one after the other.

Before each file stands a head of its own, so that all but the last can be had whole, and of the last what is there. Does not
belong here: what the files hold.
"""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

_HEAD = struct.Struct("<4s2xHH4xLLLHH")
"""Mark, flags, compression, checksum, sizes as stored and as inflated, lengths of the name and of what follows it."""
_MARK, _LIST, _BEHIND = b"PK\x03\x04", b"PK\x01\x02", b"PK\x07\x08"
_LOCKED, _SIZE_BEHIND, _UTF_8 = 1, 8, 0x800
_WIDE = 0xFFFFFFFF
"""A size that stands in eight bytes among what follows the name."""
_PIECE = 1 << 20


@dataclass(frozen=True)
class Member:
    """A file in an archive: its `packed` bytes as far as they are there, and the checksum that its head says."""

    name: str
    packed: memoryview
    deflated: bool
    checksum: int | None
    is_there: bool
    """All of its bytes are."""

    def begin(self, size: int) -> bytes:
        """The first bytes of its content, at most so many; fewer where it is cut. Raises `zlib.error` where it is damaged."""
        if not self.deflated:
            return bytes(self.packed[:size])
        inflater, made = zlib.decompressobj(wbits=-15), bytearray()
        for start in range(0, len(self.packed), _PIECE):
            made += inflater.decompress(self.packed[start : start + _PIECE], size - len(made) + 1)
            if inflater.eof or len(made) > size:
                break
        return bytes(made[:size])

    @cached_property
    def is_whole(self) -> bool:
        """It is there to its last byte, and its checksum agrees."""
        if not self.is_there:
            return False
        found = 0
        try:
            for made in self._pieces():
                found = zlib.crc32(made, found)
        except zlib.error:
            return False
        return self.checksum in (None, found)

    def _pieces(self) -> Iterator[bytes]:
        if not self.deflated:
            yield bytes(self.packed)
            return
        inflater = zlib.decompressobj(wbits=-15)
        piece: memoryview | bytes = self.packed
        while piece and not inflater.eof:
            yield inflater.decompress(piece, _PIECE)
            piece = inflater.unconsumed_tail


def is_cut(path: Path) -> bool:
    """The file begins as an archive and has no list of its files at its end."""
    with path.open("rb") as file:
        return file.read(4) == _MARK and not zipfile.is_zipfile(path)


def list_members(content: bytes) -> list[Member]:
    """The files of an archive, in the order in which they stand; the last may be cut."""
    members: list[Member] = []
    at = 0
    while (at := _begin_of_next(content, at)) >= 0:
        if len(content) < at + _HEAD.size:
            break
        _, flags, how, checksum, stored, inflated, names, more = _HEAD.unpack_from(content, at)
        begin = at + _HEAD.size + names + more
        if begin > len(content) or flags & _LOCKED or how not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            break
        name = content[at + _HEAD.size : begin - more].decode("utf-8" if flags & _UTF_8 else "cp437", "replace")
        stored = _read_wide_size(content[begin - more : begin], stored, inflated)
        deflated = how == zipfile.ZIP_DEFLATED
        if flags & _SIZE_BEHIND or (not stored and deflated):
            end = _find_end(content, begin) if deflated else None
            checksum = _read_checksum_behind(content, end) if end is not None else None
        else:
            end = begin + stored if begin + stored <= len(content) else None
        members.append(Member(name, memoryview(content)[begin:end], deflated, checksum, end is not None))
        if end is None:
            break
        at = end
    return members


def _begin_of_next(content: bytes, at: int) -> int:
    """Where the next head begins: there, or behind a checksum that stands before it; −1 where there is none."""
    found = content.find(_MARK, at, at + 32)
    return found if found >= 0 and not content.startswith(_LIST, at) else -1


def _read_wide_size(more: bytes, stored: int, inflated: int) -> int:
    """The size as stored, of large files from what follows the name."""
    at = 0
    while at + 4 <= len(more):
        kind, size = struct.unpack_from("<HH", more, at)
        if kind == 1 and stored == _WIDE:
            place = at + 4 + (8 if inflated == _WIDE else 0)
            return int(struct.unpack_from("<Q", more, place)[0]) if place + 8 <= len(more) else stored
        at += 4 + size
    return stored


def _find_end(content: bytes, begin: int) -> int | None:
    """The place behind deflated bytes that do not say how many they are; None where they have no end."""
    inflater = zlib.decompressobj(wbits=-15)
    view = memoryview(content)
    try:
        for start in range(begin, len(content), _PIECE):
            piece: memoryview | bytes = view[start : start + _PIECE]
            while piece:
                inflater.decompress(piece, _PIECE)
                if inflater.eof:
                    return min(start + _PIECE, len(content)) - len(inflater.unused_data)
                piece = inflater.unconsumed_tail
    except zlib.error:
        pass
    return None


def _read_checksum_behind(content: bytes, end: int) -> int | None:
    """The checksum that stands behind a file, with a mark of its own or without; None where it is cut off."""
    at = end + 4 * content.startswith(_BEHIND, end)
    return int.from_bytes(content[at : at + 4], "little") if at + 4 <= len(content) else None
