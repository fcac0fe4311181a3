"""Ingest of one native recording, 10⁶ samples × 4 channels, MCAP (zstd) to samples Parquet, against two others.

Side by side in one run, repetitions interleaved, medians:

- `mcap package`: its reader, its protobuf messages one by one, pyarrow's default Parquet. What one would write in an hour.
- `limit`: what no reader can go below: read the file, inflate each chunk, its CRC-32, `frombuffer` on each block whose
  place is known beforehand, one array per channel, and the same Parquet write as ours.
"""

from __future__ import annotations

import os
import statistics
import struct
import tempfile
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard

from ingest.canonical import canonical
from ingest.mcap_blocks import parse_block
from ingest.mcap_chunks import Chunk
from ingest.mcap_reader import read_mcap
from ingest.mcap_records import CHUNK, DATA_END, MAGIC, MESSAGE, FileSource, MemorySource, walk
from ingest.mcap_writer import RecordingWriter
from ingest.samples import TIME, samples_table, write_samples, write_table

TITLE = "Ingest of 10⁶ samples × 4 channels"
SAMPLES = int(os.environ.get("DEALAB_BENCH_SAMPLES", "1000000"))
INTERVAL = 1e-4
START = 1_772_000_000_000_000_000
REPETITIONS = 9
CHANNELS = {
    # unit, amplitude, noise (standard deviation), step of the converter
    "voltage": ("kV", 3.0, 3e-3, 6 / 65536),
    "force": ("N", 0.3, 1e-3, 1 / 65536),
    "displacement": ("mm", 0.5, 5e-4, 1e-4),
    "capacitance": ("pF", 0.5, 2e-3, 1e-3),
}
METADATA = {
    "recording_id": "bench",
    "protocol": "sphs",
    "loading": "electrical",
    "specimen_id": "bench",
    "started_at": "2026-02-25T06:13:20Z",
}


def make_recording(path: Path, samples: int = SAMPLES, compression: str = "zstd") -> None:
    """A recording of four noisy 16-bit channels."""
    rng = np.random.default_rng(20260301)
    phase = 2 * np.pi * 5.0 * INTERVAL * np.arange(samples)
    with RecordingWriter(path, METADATA, compression=compression) as writer:
        values = {}
        for name, (unit, amplitude, noise, step) in CHANNELS.items():
            writer.add_channel(name, unit, resolution=step)
            values[name] = np.round((amplitude * np.sin(phase) + rng.normal(0, noise, samples)) / step) * step
        for at in range(0, samples, 1000):
            for name, channel in values.items():
                writer.append(name, START + round(at * INTERVAL * 1e9), INTERVAL, channel[at : at + 1000])


def ours(path: Path, folder: Path) -> None:
    write_samples(canonical(read_mcap(path), where=path.name), folder)


def reading_only(path: Path, folder: Path) -> None:
    read_mcap(path)


def mcap_package(path: Path, folder: Path) -> None:
    pq.write_table(mcap_package_reading(path, folder), folder / "mcap_package.parquet")


def mcap_package_reading(path: Path, folder: Path) -> pa.Table:
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
    from mcap.reader import make_reader

    kind: Any = None
    times: dict[str, list[Any]] = {}
    values: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if kind is None:
                assert schema is not None
                pool = descriptor_pool.DescriptorPool()
                for description in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(description)
                kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            block = kind.FromString(message.data)
            part = np.array(block.values)
            values.setdefault(channel.topic, []).append(part)
            offset = np.rint(np.arange(part.size) * block.sample_interval_s * 1e9).astype(np.int64)
            times.setdefault(channel.topic, []).append(block.start_time_ns + offset)
    columns = {topic.removeprefix("/"): np.concatenate(parts) for topic, parts in values.items()}
    return pa.table({TIME: np.concatenate(times["/force"]), **columns})


@dataclass(frozen=True)
class _Place:
    """Where a chunk lies, and where the values of each of its blocks lie in its inflated content."""

    start: int
    length: int
    size: int
    crc: int
    blocks: tuple[tuple[int, int, int], ...]


def places(path: Path) -> list[_Place]:
    """What `limit` is told beforehand."""
    found = []
    with path.open("rb", buffering=0) as file:
        source = FileSource(file)
        for opcode, offset, length in walk(source, len(MAGIC)):
            if opcode != CHUNK:
                if opcode == DATA_END:
                    break
                continue
            chunk = Chunk.parse(source, offset, length)
            content = zstandard.decompress(source.read(chunk.start, chunk.length))
            blocks = []
            for inner, at, size in walk(MemorySource(content)):
                if inner == MESSAGE:
                    (channel,) = struct.unpack_from("<H", content, at)
                    values = parse_block(memoryview(content)[at + 22 : at + size])[2][0]
                    blocks.append((channel, at + size - len(values), len(values) // 8))
            found.append(_Place(chunk.start, chunk.length, chunk.size, chunk.crc, tuple(blocks)))
    return found


def limit(path: Path, folder: Path, known: list[_Place], schema: pa.Schema) -> None:
    content = path.read_bytes()
    parts: list[list[Any]] = [[] for _ in CHANNELS]
    decompressor = zstandard.ZstdDecompressor()
    for place in known:
        inflated = decompressor.decompress(content[place.start : place.start + place.length])
        if zlib.crc32(inflated) != place.crc:
            raise ValueError("CRC")
        for channel, offset, count in place.blocks:
            parts[channel - 1].append(np.frombuffer(inflated, "<f8", count, offset))
    columns = [np.concatenate(part) for part in parts]
    times = START + np.rint(np.arange(columns[0].size) * INTERVAL * 1e9).astype(np.int64)
    write_table(pa.Table.from_arrays([pa.array(c) for c in (times, *columns)], schema=schema), folder / "limit.parquet")


def run(samples: int = SAMPLES, repetitions: int = REPETITIONS) -> list[dict[str, float | str]]:
    """Median seconds of each way, and their ratio to the limit."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "bench.mcap"
        make_recording(path, samples)
        known = places(path)
        schema = samples_table(canonical(read_mcap(path), where=path.name)).schema
        ways: dict[str, Callable[[], object]] = {
            "limit": lambda: limit(path, folder, known, schema),
            "dealab": lambda: ours(path, folder),
            "dealab, reading alone": lambda: reading_only(path, folder),
            "mcap package": lambda: mcap_package(path, folder),
            "mcap package, reading alone": lambda: mcap_package_reading(path, folder),
        }
        seconds: dict[str, list[float]] = {way: [] for way in ways}
        for _ in range(repetitions):
            for way, call in ways.items():
                begin = time.perf_counter()
                call()
                seconds[way].append(time.perf_counter() - begin)
        sizes = {
            "dealab": next(folder.glob("samples/**/*.parquet")).stat().st_size,
            "mcap package": (folder / "mcap_package.parquet").stat().st_size,
        }
    medians = {way: statistics.median(values) for way, values in seconds.items()}
    rows: list[dict[str, float | str]] = []
    for way, median in medians.items():
        row: dict[str, float | str] = {
            "name": f"ingest {samples:.0e} x {len(CHANNELS)}: {way}",
            "seconds": median,
            "ratio": median / medians["limit"],
        }
        row["note"] = "ratio: times the limit" + (f"; {sizes[way] / 1e6:.1f} MB" if way in sizes else "")
        rows.append(row)
    return rows
