"""MCAP record layout: walking a file or a chunk record by record, and reading one record's fields.

Every length in a file is a claim and is checked against what is left before anything is read. The same walker serves
the file, the content of its chunks and the conformance test. Layout: MCAP format specification, version 0.

Does not belong here: decompression (ingest.mcap_chunks) and the meaning of messages (ingest.mcap_blocks,
ingest.mcap_messages).
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from io import FileIO
from typing import IO, Any, Protocol

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(0x01, 0x09)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(0x09, 0x10)
HEAD_SIZE = 9
FOOTER_SIZE = HEAD_SIZE + 20
"""A footer record without padding, its head included, bytes."""

_HEAD = struct.Struct("<BQ")
_WINDOW = 1 << 16
"""Bytes that are read at once when a small read misses the window of a file."""


class MalformedError(Exception):
    """The bytes at `offset` are not what the format says; caught within the reader and turned into a problem."""

    def __init__(self, reason: str, offset: int = 0) -> None:
        super().__init__(reason)
        self.reason = reason
        self.offset = offset


class ByteSource(Protocol):
    """Bytes with random access: a file, or the content of a chunk in memory."""

    @property
    def size(self) -> int: ...

    def read(self, offset: int, length: int) -> bytes | memoryview:
        """`length` bytes from `offset`, fewer at the end."""
        ...


class MemorySource:
    """Bytes in memory; `read` gives views, nothing is copied."""

    def __init__(self, content: bytes) -> None:
        self._view = memoryview(content)
        self.size = len(content)

    def read(self, offset: int, length: int) -> memoryview:
        return self._view[offset : offset + length]


class FileSource:
    """A part of an open file, whole by default. Read, not mapped: a file that shrinks meanwhile must not kill us."""

    def __init__(self, file: FileIO | IO[bytes], *, start: int = 0, size: int | None = None) -> None:
        self._file = file
        self._start = start
        self.size = file.seek(0, 2) - start if size is None else size
        self._window = b""
        self._window_offset = 0

    def read(self, offset: int, length: int) -> bytes:
        length = max(0, min(length, self.size - offset))
        begin = offset - self._window_offset
        if begin >= 0 and begin + length <= len(self._window):
            return self._window[begin : begin + length]
        self._file.seek(self._start + offset)
        if length >= _WINDOW:
            return self._file.read(length) or b""
        self._window = self._file.read(min(_WINDOW, self.size - offset)) or b""
        self._window_offset = offset
        return self._window[:length]


def pieces(source: ByteSource, offset: int, length: int, piece: int = 1 << 20) -> Iterator[bytes | memoryview]:
    """The bytes of a range, piece by piece; ends early where the source does."""
    end = offset + length
    while offset < end:
        part = source.read(offset, min(piece, end - offset))
        if not part:
            return
        yield part
        offset += len(part)


def walk(source: ByteSource, start: int = 0) -> Iterator[tuple[int, int, int]]:
    """The records of a source in order: opcode, offset of the content, length of the content.

    Raises `MalformedError` at the first place where there is no whole record.
    """
    offset, size = start, source.size
    while offset < size:
        head = source.read(offset, HEAD_SIZE)
        if len(head) < HEAD_SIZE:
            raise MalformedError("it ends inside the head of a record", offset)
        opcode, length = _HEAD.unpack(head)
        if opcode == 0:
            raise MalformedError("a record has the opcode 0, which none may have", offset)
        offset += HEAD_SIZE
        if length > size - offset:
            raise MalformedError(
                f"a record claims {length} bytes where {size - offset} are left", offset=offset - HEAD_SIZE
            )
        yield opcode, offset, length
        offset += length


FieldReader = Callable[[memoryview, int], tuple[Any, int]]


def _number(code: str) -> FieldReader:
    layout = struct.Struct("<" + code)

    def read(view: memoryview, at: int) -> tuple[Any, int]:
        if at + layout.size > len(view):
            raise MalformedError("a field goes beyond the end of its record")
        return layout.unpack_from(view, at)[0], at + layout.size

    return read


_U8, _U16, _U32, _U64 = (_number(code) for code in "BHIQ")


def _prefixed(prefix: FieldReader) -> FieldReader:
    def read(view: memoryview, at: int) -> tuple[memoryview, int]:
        length, at = prefix(view, at)
        if length > len(view) - at:
            raise MalformedError("a field goes beyond the end of its record")
        return view[at : at + length], at + length

    return read


_BYTES32, _BYTES64 = _prefixed(_U32), _prefixed(_U64)


def _string(view: memoryview, at: int) -> tuple[str, int]:
    content, at = _BYTES32(view, at)
    try:
        return str(content, "utf-8"), at
    except UnicodeDecodeError:
        raise MalformedError("a text is not UTF-8") from None


def _rest(view: memoryview, at: int) -> tuple[memoryview, int]:
    return view[at:], len(view)


def _entries(first: FieldReader, second: FieldReader) -> FieldReader:
    def read(view: memoryview, at: int) -> tuple[list[tuple[Any, Any]], int]:
        content, end = _BYTES32(view, at)
        entries, at = [], 0
        while at < len(content):
            key, at = first(content, at)
            value, at = second(content, at)
            entries.append((key, value))
        return entries, end

    return read


def _map(key: FieldReader, value: FieldReader) -> FieldReader:
    entries = _entries(key, value)

    def read(view: memoryview, at: int) -> tuple[dict[Any, Any], int]:
        found, at = entries(view, at)
        return dict(found), at

    return read


LAYOUTS: Mapping[int, tuple[str, tuple[tuple[str, FieldReader], ...]]] = {
    HEADER: ("Header", (("profile", _string), ("library", _string))),
    FOOTER: ("Footer", (("summary_start", _U64), ("summary_offset_start", _U64), ("summary_crc", _U32))),
    SCHEMA: ("Schema", (("id", _U16), ("name", _string), ("encoding", _string), ("data", _BYTES32))),
    CHANNEL: (
        "Channel",
        (
            ("id", _U16),
            ("schema_id", _U16),
            ("topic", _string),
            ("message_encoding", _string),
            ("metadata", _map(_string, _string)),
        ),
    ),
    MESSAGE: (
        "Message",
        (("channel_id", _U16), ("sequence", _U32), ("log_time", _U64), ("publish_time", _U64), ("data", _rest)),
    ),
    CHUNK: (
        "Chunk",
        (
            ("message_start_time", _U64),
            ("message_end_time", _U64),
            ("uncompressed_size", _U64),
            ("uncompressed_crc", _U32),
            ("compression", _string),
            ("records", _BYTES64),
        ),
    ),
    MESSAGE_INDEX: ("MessageIndex", (("channel_id", _U16), ("records", _entries(_U64, _U64)))),
    CHUNK_INDEX: (
        "ChunkIndex",
        (
            ("message_start_time", _U64),
            ("message_end_time", _U64),
            ("chunk_start_offset", _U64),
            ("chunk_length", _U64),
            ("message_index_offsets", _map(_U16, _U64)),
            ("message_index_length", _U64),
            ("compression", _string),
            ("compressed_size", _U64),
            ("uncompressed_size", _U64),
        ),
    ),
    ATTACHMENT: (
        "Attachment",
        (
            ("log_time", _U64),
            ("create_time", _U64),
            ("name", _string),
            ("media_type", _string),
            ("data", _BYTES64),
            ("crc", _U32),
        ),
    ),
    ATTACHMENT_INDEX: (
        "AttachmentIndex",
        (
            ("offset", _U64),
            ("length", _U64),
            ("log_time", _U64),
            ("create_time", _U64),
            ("data_size", _U64),
            ("name", _string),
            ("media_type", _string),
        ),
    ),
    STATISTICS: (
        "Statistics",
        (
            ("message_count", _U64),
            ("schema_count", _U16),
            ("channel_count", _U32),
            ("attachment_count", _U32),
            ("metadata_count", _U32),
            ("chunk_count", _U32),
            ("message_start_time", _U64),
            ("message_end_time", _U64),
            ("channel_message_counts", _map(_U16, _U64)),
        ),
    ),
    METADATA: ("Metadata", (("name", _string), ("metadata", _map(_string, _string)))),
    METADATA_INDEX: ("MetadataIndex", (("offset", _U64), ("length", _U64), ("name", _string))),
    SUMMARY_OFFSET: ("SummaryOffset", (("group_opcode", _U8), ("group_start", _U64), ("group_length", _U64))),
    DATA_END: ("DataEnd", (("data_section_crc", _U32),)),
}
"""Name and fields of each record, in the order of the format. Bytes after the last field are padding."""


def fields(opcode: int, content: bytes | memoryview) -> dict[str, Any]:
    """The fields of one record by name; bytes stay views. Raises `MalformedError` when they do not fit the content."""
    view = memoryview(content)
    at = 0
    found = {}
    for name, read in LAYOUTS[opcode][1]:
        found[name], at = read(view, at)
    return found


@dataclass(frozen=True)
class Schema:
    """Definition of a message type."""

    id: int
    name: str
    encoding: str
    data: bytes

    @classmethod
    def parse(cls, content: bytes | memoryview) -> Schema:
        found = fields(SCHEMA, content)
        return cls(found["id"], found["name"], found["encoding"], bytes(found["data"]))


@dataclass(frozen=True)
class Channel:
    """Definition of a stream of messages."""

    id: int
    schema_id: int
    topic: str
    message_encoding: str
    metadata: Mapping[str, str]

    @classmethod
    def parse(cls, content: bytes | memoryview) -> Channel:
        return cls(**fields(CHANNEL, content))
