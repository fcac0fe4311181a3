"""MCAP files for tests, made without the reader or the writer under test: struct, the mcap package and protobuf."""

from __future__ import annotations

import functools
import struct
import zlib
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import zstandard
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from mcap.writer import CompressionType, Writer

MAGIC = b"\x89MCAP0\r\n"
START = 1_772_000_000_000_000_000
METADATA = {
    "recording_id": "run_7",
    "protocol": "cyclic",
    "loading": "mechanical",
    "specimen_id": "acrylic_3",
    "started_at": "2026-02-25T06:13:20+00:00",
}
_FIELDS = descriptor_pb2.FieldDescriptorProto


@functools.cache
def descriptor_set() -> bytes:
    """`dealab.SampleBlock` as the contract writes it."""
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="block.proto", package="dealab", syntax="proto3")
    message = file.message_type.add(name="SampleBlock")
    message.field.add(name="start_time_ns", number=1, type=_FIELDS.TYPE_SFIXED64, label=1)
    message.field.add(name="sample_interval_s", number=2, type=_FIELDS.TYPE_DOUBLE, label=1)
    message.field.add(name="values", number=3, type=_FIELDS.TYPE_DOUBLE, label=3)
    return files.SerializeToString()


def message_type(descriptors: bytes, name: str) -> Any:
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(descriptors).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


@functools.cache
def _block_type() -> Any:
    return message_type(descriptor_set(), "dealab.SampleBlock")


def block(start: int, interval: float, values: Any) -> bytes:
    """A SampleBlock as protobuf's own code serialises it."""
    return _block_type()(start_time_ns=start, sample_interval_s=interval, values=list(values)).SerializeToString()


def parsed_block(content: bytes) -> Any:
    return _block_type().FromString(content)


def text(value: str) -> bytes:
    return struct.pack("<I", len(value.encode())) + value.encode()


def mapping(entries: dict[str, str]) -> bytes:
    content = b"".join(text(k) + text(v) for k, v in entries.items())
    return struct.pack("<I", len(content)) + content


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def schema(number: int = 1, name: str = "dealab.SampleBlock") -> bytes:
    data = descriptor_set()
    return record(3, struct.pack("<H", number) + text(name) + text("protobuf") + struct.pack("<I", len(data)) + data)


def channel(number: int, topic: str, metadata: dict[str, str], schema_id: int = 1) -> bytes:
    return record(4, struct.pack("<HH", number, schema_id) + text(topic) + text("protobuf") + mapping(metadata))


def message(channel_id: int, sequence: int, log_time: int, data: bytes) -> bytes:
    return record(5, struct.pack("<HIQQ", channel_id, sequence, log_time, log_time) + data)


def metadata(entries: dict[str, str], name: str = "recording") -> bytes:
    return record(0x0C, text(name) + mapping(entries))


def chunk(
    content: bytes,
    compression: str = "zstd",
    *,
    stored: bytes | None = None,
    size: int | None = None,
    crc: int | None = None,
    times: tuple[int, int] = (START, START),
) -> bytes:
    """A chunk record; what is not given is made right."""
    if stored is None:
        stored = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)(content)
    head = struct.pack(
        "<QQQI", *times, len(content) if size is None else size, zlib.crc32(content) if crc is None else crc
    )
    return record(6, head + text(compression) + struct.pack("<Q", len(stored)) + stored)


def whole(*records: bytes, begin: bytes | None = None) -> bytes:
    """A file of these data records, without a summary."""
    header = record(1, text("") + text("test")) if begin is None else begin
    return b"".join(
        (MAGIC, header, *records, record(0x0F, struct.pack("<I", 0)), record(2, struct.pack("<QQI", 0, 0, 0)), MAGIC)
    )


DEFINITIONS = schema() + channel(1, "/force", {"unit": "N"}) + channel(2, "/displacement", {"unit": "mm"})


def values_of(quantity: str, samples: int) -> Any:
    """Samples of a channel that no other channel and no other place has."""
    return {"force": 1.0, "displacement": -1.0}[quantity] * (1.0 + np.arange(samples) / 1024)


def packaged(
    path: Path,
    *,
    blocks: int = 12,
    size: int = 16,
    interval: float = 1e-3,
    chunk_size: int = 600,
    compression: CompressionType = CompressionType.ZSTD,
    data_crc: bool = True,
    **options: Any,
) -> None:
    """A file as the mcap package writes it: two channels, a few chunks, checksums everywhere."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, compression=compression, enable_data_crcs=data_crc, **options)
        writer.start(library="test")
        writer.add_metadata("recording", METADATA)
        schema_id = writer.register_schema("dealab.SampleBlock", "protobuf", descriptor_set())
        units = {"force": "N", "displacement": "mm"}
        ids = {q: writer.register_channel(f"/{q}", "protobuf", schema_id, {"unit": u}) for q, u in units.items()}
        for number in range(blocks):
            start = START + round(number * size * interval * 1e9)
            for quantity, channel_id in ids.items():
                part = values_of(quantity, blocks * size)[number * size : (number + 1) * size]
                writer.add_message(channel_id, start, block(start, interval, part), start, number)
        writer.finish()


def varint(number: int) -> bytes:
    """A number as protobuf writes it, seven bits at a time."""
    encoded = b""
    while number > 127:
        encoded += bytes([number & 127 | 128])
        number >>= 7
    return encoded + bytes([number])
