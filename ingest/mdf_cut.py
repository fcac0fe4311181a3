"""MDF 4 files that are cut within their last samples: asammdf refuses them whole, and all that stands before the end is there.

A program that writes while it measures puts the description of all channels first and the samples behind it. Where the file
ends within a block of samples, the block is made as short as what is left of it, in memory: the file stays as it is. Runs in
the child process of `ingest.mdf_reader`.
"""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import BinaryIO

_VERSION_AT, _FOUR = 28, 400
_HEADER_AT = 64
_BLOCK = struct.Struct("<4s4xQQ")
"""The head of a block: its kind, its length and how many links follow."""
_GROUPS_MOST = 100_000
_SIZES = struct.Struct("<QQHH4xII")
"""Of a group of channels: its number, its count of samples, flags, a separator, and the bytes of a sample and its marks."""


def open_left(path: Path) -> Path | BinaryIO:
    """The file as it is, or where it ends within a block of samples its content with that block made shorter."""
    there = path.stat().st_size
    with path.open("rb") as file:
        try:
            shorter = _find_cut(file, there)
        except struct.error:  # it ends within its description
            return path
        if not shorter:
            return path
        file.seek(0)
        content = bytearray(file.read())
    for at, length in shorter.items():
        struct.pack_into("<Q", content, at + 8, length)
    return io.BytesIO(content)


def _find_cut(file: BinaryIO, there: int) -> dict[int, int]:
    """Places of blocks of samples that the file ends within, and the length of what is left of each in whole samples."""
    found: dict[int, int] = {}
    file.seek(0)
    start = file.read(_HEADER_AT)
    if not start.startswith(b"MDF     ") or struct.unpack_from("<H", start, _VERSION_AT)[0] < _FOUR:
        return found
    links = _read_links(file, _HEADER_AT, b"##HD")
    seen = {0}
    group = links[0] if links else 0
    while group not in seen and len(seen) < _GROUPS_MOST:
        seen.add(group)
        links = _read_links(file, group, b"##DG")
        if len(links) < 3:
            break
        number_bytes = file.read(1)
        following, channels, samples = links[:3]
        kind, length, _ = _BLOCK.unpack(_read_at(file, samples, _BLOCK.size)) if samples else (b"", 0, 0)
        if kind == b"##DT" and number_bytes == b"\0" and samples + length > there:
            _read_links(file, channels, b"##CG")
            *_, size, marks = _SIZES.unpack(file.read(_SIZES.size))
            if size + marks:
                left = (there - samples - _BLOCK.size) // (size + marks)
                found[samples] = _BLOCK.size + left * (size + marks)
        group = following
    return found


def _read_links(file: BinaryIO, at: int, kind: bytes) -> tuple[int, ...]:
    """The links of a block, none where it is of another kind; the file then stands behind them."""
    found, length, count = _BLOCK.unpack(_read_at(file, at, _BLOCK.size))
    if found != kind or 8 * count > length:
        return ()
    return struct.unpack(f"<{count}Q", file.read(8 * count))


def _read_at(file: BinaryIO, at: int, count: int) -> bytes:
    file.seek(at)
    return file.read(count)
