"""The end of an MCAP file: what its summary says is in the data section.

The data section is read without it. It is a second witness: definitions whose first copy was lost with a chunk, places
of chunks that a damaged length made unreachable, and how many messages there should be.

Does not belong here: the data section.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field

from ingest.mcap_records import (
    CHANNEL,
    CHUNK_INDEX,
    FOOTER,
    FOOTER_SIZE,
    HEAD_SIZE,
    MAGIC,
    METADATA_INDEX,
    SCHEMA,
    STATISTICS,
    ByteSource,
    Channel,
    MalformedError,
    Schema,
    fields,
    walk,
)

_LARGEST = 16 << 20
"""Longest summary that is read, bytes: the index of more than 100 000 chunks."""

LARGEST_DEFINITIONS = 8 << 20
"""Most bytes of schemas and channels that are kept; a few thousand are usual, and small texts grow tenfold in memory."""

_LARGEST_RECORD = 1 << 20
_INDEX_HEAD = struct.Struct("<QQQQ")


@dataclass
class Summary:
    """What the end of a file says. Places are (offset of the record's head, length with head)."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[tuple[int, int]] = field(default_factory=list)
    metadata: list[tuple[int, int]] = field(default_factory=list)
    message_counts: Mapping[int, int] | None = None


def read_summary(source: ByteSource) -> Summary | None:
    """The summary of a file; None where there is none.

    Raises `MalformedError` when there is one but its length, its checksum or its records are wrong.
    """
    footer_at = source.size - len(MAGIC) - FOOTER_SIZE
    if footer_at < len(MAGIC) or bytes(source.read(source.size - len(MAGIC), len(MAGIC))) != MAGIC:
        return None
    footer = bytes(source.read(footer_at, FOOTER_SIZE))
    if footer[0] != FOOTER or int.from_bytes(footer[1:HEAD_SIZE], "little") != FOOTER_SIZE - HEAD_SIZE:
        return None
    found = fields(FOOTER, footer[HEAD_SIZE:])
    start = found["summary_start"]
    if start == 0:
        start = footer_at
    if not len(MAGIC) <= start <= footer_at:
        raise MalformedError(f"the summary is said to start at byte {start}", footer_at)
    if footer_at - start > _LARGEST:
        raise MalformedError(f"the summary has {footer_at - start} bytes, more than {_LARGEST}", start)
    content = source.read(start, footer_at - start)
    if found["summary_crc"] and zlib.crc32(footer[:-4], zlib.crc32(content)) != found["summary_crc"]:
        raise MalformedError("the checksum (CRC-32) of the summary does not match", start)
    return _parsed(source, start, footer_at)


def _parsed(source: ByteSource, start: int, end: int) -> Summary:
    summary = Summary()
    definitions_left = LARGEST_DEFINITIONS
    for opcode, offset, length in walk(source, start):
        if offset >= end:
            break
        if length > _LARGEST_RECORD and opcode != CHUNK_INDEX:
            continue
        if opcode in (SCHEMA, CHANNEL):
            definitions_left -= length
            if definitions_left < 0:
                raise MalformedError("its definitions take too many bytes", offset)
        if opcode == SCHEMA:
            schema = Schema.parse(source.read(offset, length))
            summary.schemas[schema.id] = schema
        elif opcode == CHANNEL:
            channel = Channel.parse(source.read(offset, length))
            summary.channels[channel.id] = channel
        elif opcode == CHUNK_INDEX and length >= _INDEX_HEAD.size:
            # only the place is wanted: the map of message offsets that follows it may be long
            _, _, place, size = _INDEX_HEAD.unpack(source.read(offset, _INDEX_HEAD.size))
            summary.chunks.append((place, size))
        elif opcode == METADATA_INDEX:
            found = fields(METADATA_INDEX, source.read(offset, length))
            summary.metadata.append((found["offset"], found["length"]))
        elif opcode == STATISTICS:
            summary.message_counts = fields(STATISTICS, source.read(offset, length))["channel_message_counts"]
    return summary
