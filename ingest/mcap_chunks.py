"""Content of MCAP chunks: bounded decompression, checksum, no more memory than a small chunk needs.

Small chunks are inflated in memory. Larger ones go to an anonymous temporary file piece by piece, so that a bomb costs
neither memory nor, beyond what the chunk declares, disk.

Does not belong here: what the records inside a chunk mean.
"""

from __future__ import annotations

import tempfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import IO, cast

import lz4.frame
import zstandard

from ingest.mcap_records import CHUNK, ByteSource, FileSource, MalformedError, MemorySource, fields, pieces

LARGEST_CHUNK = 256 << 20
"""Most bytes that a compressed chunk may inflate to."""

_IN_MEMORY = 16 << 20
"""Chunks up to this size, inflated and as stored, are held in memory."""

_PIECE = 1 << 20
_FEED = 1 << 16
"""Stored bytes given to a decompressor at once; it copies what it has not consumed on each call."""

_WINDOW = 1 << 27
"""Largest window that a zstd frame may ask for; the format's own limit without special options."""

_LZ4_PIECE = _IN_MEMORY + 1
"""Most bytes that one lz4 call may give: a small chunk comes out in one call, without copying its rest."""

_FRAMES = 64
"""Most lz4 frames in one chunk; a writer makes one. Each further one copies what is left of the input."""

_HEAD = 4096
"""A chunk record's fields before its content take fewer bytes than this."""


@dataclass(frozen=True)
class Chunk:
    """A chunk record without its content. Times of its messages in ns; `start`, `length`: the stored content."""

    first_ns: int
    last_ns: int
    size: int
    crc: int
    compression: str
    start: int
    length: int

    @classmethod
    def parse(cls, source: ByteSource, offset: int, length: int) -> Chunk:
        """The chunk whose record content is at `offset`. Raises `MalformedError` when its fields do not fit."""
        head = bytes(source.read(offset, min(length, _HEAD)))
        compression_end = 32 + int.from_bytes(head[28:32], "little")
        if len(head) < 32 or compression_end + 8 > len(head):
            raise MalformedError("its fields go beyond its end", offset)
        stored = int.from_bytes(head[compression_end : compression_end + 8], "little")
        if stored > length - compression_end - 8:
            raise MalformedError(f"it claims {stored} bytes where {length - compression_end - 8} are left", offset)
        found = fields(CHUNK, head[:compression_end] + bytes(8))
        return cls(
            first_ns=found["message_start_time"],
            last_ns=found["message_end_time"],
            size=found["uncompressed_size"],
            crc=found["uncompressed_crc"],
            compression=found["compression"],
            start=offset + compression_end + 8,
            length=stored,
        )


@contextmanager
def opened(source: ByteSource, chunk: Chunk) -> Iterator[ByteSource]:
    """The inflated and checked content of a chunk.

    Raises `MalformedError` with the reason when the compression is unknown, the content does not inflate to exactly
    the declared size, that size is beyond `LARGEST_CHUNK`, or the CRC-32 (where the chunk has one) does not match.
    """
    if chunk.compression not in ("", "zstd", "lz4"):
        raise MalformedError(f'unknown compression "{chunk.compression[:40]}"')
    if chunk.compression == "" and chunk.size != chunk.length:
        raise MalformedError("its content has another size than it declares")
    if chunk.compression and chunk.size > LARGEST_CHUNK:
        raise MalformedError(f"it would inflate to more than {LARGEST_CHUNK >> 20} MiB")
    if max(chunk.size, chunk.length) <= _IN_MEMORY:
        content = _inflated(bytes(source.read(chunk.start, chunk.length)), chunk)
        _check(zlib.crc32(content), chunk)
        yield MemorySource(content)
    elif chunk.compression == "":
        crc = 0
        for piece in pieces(source, chunk.start, chunk.length, _PIECE):
            crc = zlib.crc32(piece, crc)
        _check(crc, chunk)
        yield _Part(source, chunk.start, chunk.size)
    else:
        with tempfile.TemporaryFile(prefix="dealab-chunk-") as spool:
            crc = written = 0
            for piece in _stream(pieces(source, chunk.start, chunk.length, _FEED), chunk):
                crc = zlib.crc32(piece, crc)
                written += spool.write(piece)
            _check_size(written, chunk)
            _check(crc, chunk)
            yield FileSource(spool, size=chunk.size)


class _Part:
    """A range of another source."""

    def __init__(self, source: ByteSource, start: int, size: int) -> None:
        self._source = source
        self._start = start
        self.size = size

    def read(self, offset: int, length: int) -> bytes | memoryview:
        return self._source.read(self._start + offset, max(0, min(length, self.size - offset)))


def _inflated(stored: bytes, chunk: Chunk) -> bytes:
    if chunk.compression == "":
        return stored
    if chunk.compression == "zstd" and _is_plain_frame(stored, chunk.size):
        try:
            content = zstandard.ZstdDecompressor(max_window_size=_WINDOW).decompress(
                stored, max_output_size=chunk.size, allow_extra_data=False
            )
        except zstandard.ZstdError:
            content = b""
        if len(content) == chunk.size:
            return content
    parts = list(_stream(iter([stored]), chunk))
    content = parts[0] if len(parts) == 1 else b"".join(parts)
    _check_size(len(content), chunk)
    return content


def _is_plain_frame(stored: bytes, size: int) -> bool:
    """Whether one call may inflate it: the frame tells no other size (one call would allocate whatever it tells)."""
    try:
        told = zstandard.frame_content_size(stored)
    except zstandard.ZstdError:
        return False
    return size > 0 and told in (-1, size)


def _stream(stored: Iterator[bytes | memoryview], chunk: Chunk) -> Iterator[bytes]:
    """Inflated pieces, at most one byte more than declared; several frames in a row are one content."""
    try:
        yield from (_zstd if chunk.compression == "zstd" else _lz4)(stored, chunk.size)
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError) as error:
        reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
        raise MalformedError(f"its {chunk.compression} content cannot be inflated ({reason})") from None


def _zstd(stored: Iterator[bytes | memoryview], size: int) -> Iterator[bytes]:
    left = size + 1
    with zstandard.ZstdDecompressor(max_window_size=_WINDOW).stream_reader(
        cast(IO[bytes], _Readable(stored)), read_size=_FEED, read_across_frames=True
    ) as reader:
        while left > 0 and (piece := reader.read(min(_PIECE, left))):
            left -= len(piece)
            yield piece


class _Readable:
    """Pieces of bytes as a file, of which zstandard's reader wants no more than `read`."""

    def __init__(self, parts: Iterator[bytes | memoryview]) -> None:
        self._parts = parts
        self._rest = memoryview(b"")

    def read(self, length: int = -1) -> bytes:
        while not self._rest:
            part = next(self._parts, None)
            if part is None:
                return b""
            self._rest = memoryview(part)
        taken, self._rest = self._rest[:length], self._rest[length:]
        return bytes(taken)


def _lz4(stored: Iterator[bytes | memoryview], size: int) -> Iterator[bytes]:
    left = size + 1
    fed = b""
    for _ in range(_FRAMES):
        decompressor = lz4.frame.LZ4FrameDecompressor()
        while left > 0 and not decompressor.eof:
            if not fed and decompressor.needs_input:
                fed = bytes(next(stored, b""))
            ended = not fed and decompressor.needs_input
            piece = decompressor.decompress(fed, max_length=min(left, _LZ4_PIECE))
            fed = b""
            left -= len(piece)
            if piece:
                yield piece
            elif ended:
                return
        fed = decompressor.unused_data or bytes(next(stored, b""))
        if left <= 0 or not fed:
            return
    raise MalformedError(f"its content has more than {_FRAMES} frames")


def _check_size(found: int, chunk: Chunk) -> None:
    if found != chunk.size:
        than = "more" if found > chunk.size else f"only {found}"
        raise MalformedError(f"its content inflates to {than} bytes, {chunk.size} are declared")


def _check(crc: int, chunk: Chunk) -> None:
    """A chunk's CRC of 0 means that the writer did not compute one."""
    if chunk.crc and crc != chunk.crc:
        raise MalformedError("the checksum (CRC-32) of its content does not match")
