"""Files made to exhaust memory: refused or salvaged, under 300 MB, measured in a process of their own."""

from __future__ import annotations

import json
import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
import zstandard

from tests.helpers.mcap_files import (
    DEFINITIONS,
    METADATA,
    START,
    block,
    channel,
    chunk,
    message,
    metadata,
    record,
    schema,
    text,
    varint,
    whole,
)

ROOT = Path(__file__).resolve().parent.parent.parent
LIMIT_MB = 300
MIB = 1 << 20

_CHILD = """
import json, sys
from pathlib import Path
from ingest.mcap_reader import read_mcap
from schemas.errors import DealabError
from tests.helpers.machine import peak_mb
try:
    found = read_mcap(Path(sys.argv[1]))
    told = {"problems": found.problems, "values": {c.quantity: c.values.size for c in found.channels}}
except DealabError as error:
    told = {"refused": str(error)}
print(json.dumps({**told, "megabytes": peak_mb()}))
"""


def read_apart(path: Path) -> dict[str, Any]:
    """What a fresh process says of the file, and the most memory it had."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-c", _CHILD, str(path)], capture_output=True, text=True, timeout=60, env=environment
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    told: dict[str, Any] = json.loads(done.stdout)
    assert told["megabytes"] < LIMIT_MB
    return told


def repeated(piece: bytes, mebibytes: int) -> Iterator[bytes]:
    for _ in range(mebibytes):
        yield piece


def compressed(kind: str, parts: Iterator[bytes], *, tell_size: int | None = None) -> bytes:
    """One frame of all the parts, which are never in memory together."""
    if kind == "zstd":
        compressor = zstandard.ZstdCompressor().compressobj(size=-1 if tell_size is None else tell_size)
        return b"".join([*(compressor.compress(part) for part in parts), compressor.flush()])
    frame = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    begin = frame.begin(tell_size or 0)
    return b"".join([begin, *(frame.compress(part) for part in parts), frame.flush()])


def checksum(parts: Iterator[bytes]) -> int:
    crc = 0
    for part in parts:
        crc = zlib.crc32(part, crc)
    return crc


ZEROS = bytes(MIB)


@pytest.fixture(scope="module", params=["zstd", "lz4"])
def gibibyte(request: pytest.FixtureRequest) -> tuple[str, bytes]:
    """A compressed gibibyte of zeros."""
    return request.param, compressed(request.param, repeated(ZEROS, 1024))


GOOD = chunk(DEFINITIONS + message(1, 0, START, block(START, 1e-3, [1.0, 2.0])))


@pytest.mark.long_after(4)
@pytest.mark.parametrize("declared", [1024 * MIB, 256 * MIB, 10_000_000, 1000, 0, 2**63])
def test_a_gibibyte_bomb_costs_no_memory(tmp_path: Path, gibibyte: tuple[str, bytes], declared: int) -> None:
    kind, stored = gibibyte
    path = tmp_path / "bomb.mcap"
    path.write_bytes(whole(metadata(METADATA), GOOD, chunk(b"", kind, stored=stored, size=declared)))
    told = read_apart(path)
    assert told["values"] == {"force": 2}
    assert any("1 chunk left out" in problem for problem in told["problems"])


@pytest.mark.parametrize("kind", ["zstd", "lz4"])
def test_a_bomb_in_a_file_large_enough_to_be_tried(tmp_path: Path, kind: str) -> None:
    """The file is so large that the declared 256 MiB are believed: they are inflated, to disk, and no further."""
    path = tmp_path / "bomb.mcap"
    stored = compressed(kind, repeated(ZEROS, 1024))
    ballast = record(0x09, os.urandom(MIB))
    path.write_bytes(whole(metadata(METADATA), ballast, GOOD, chunk(b"", kind, stored=stored, size=256 * MIB)))
    told = read_apart(path)
    assert told["values"] == {"force": 2}
    assert any(f"more bytes, {256 * MIB} are declared" in problem for problem in told["problems"])


def test_many_chunks_of_256_mebibytes_each(tmp_path: Path) -> None:
    """Each keeps the rules, checksum included; its content is one record that a reader passes over."""
    size = 255 * MIB
    head = struct.pack("<BQ", 0x80, size - 9)
    body = [head + ZEROS[9:], *[ZEROS] * 254]
    stored = compressed("zstd", iter(body), tell_size=size)
    bad = chunk(b"", "zstd", stored=stored, size=size, crc=checksum(iter(body)))
    path = tmp_path / "many.mcap"
    # as the head of a duplicate is the same, each is given times of its own
    chunks = [bad[:9] + struct.pack("<QQ", START + i, START + i) + bad[25:] for i in range(20)]
    path.write_bytes(whole(metadata(METADATA), record(0x09, os.urandom(2 * MIB)), GOOD, *chunks))
    told = read_apart(path)
    assert told["values"] == {"force": 2}
    assert any("512 times" in problem for problem in told["problems"])


def test_a_zstd_frame_that_asks_for_a_large_window(tmp_path: Path) -> None:
    parameters = zstandard.ZstdCompressionParameters.from_level(3, window_log=30)
    compressor = zstandard.ZstdCompressor(compression_params=parameters).compressobj()
    stored = b"".join([*(compressor.compress(ZEROS) for _ in range(20)), compressor.flush()])
    path = tmp_path / "window.mcap"
    path.write_bytes(whole(metadata(METADATA), GOOD, chunk(b"", "zstd", stored=stored, size=20 * MIB, crc=0)))
    told = read_apart(path)
    assert any("cannot be inflated" in problem for problem in told["problems"])


def test_well_formed_samples_beyond_any_real_ratio(tmp_path: Path) -> None:
    """Equal samples in huge blocks, all checksums right: up to a limit they are data, beyond it a bomb."""

    def huge(number: int, samples: int) -> bytes:
        start = START + number * 10**15
        content = struct.pack("<BqBdB", 9, start, 17, 1e-3, 0x1A) + varint(8 * samples) + bytes(8 * samples)
        return chunk(message(1, number, start, content), times=(start, start))

    path = tmp_path / "samples.mcap"
    path.write_bytes(whole(metadata(METADATA), DEFINITIONS, *(huge(i, 2_000_000) for i in range(6))))
    told = read_apart(path)
    assert told["values"] == {"force": 4_000_000}
    assert any("4 chunks left out" in problem and "512 times" in problem for problem in told["problems"])


def test_a_message_beyond_64_mebibytes(tmp_path: Path) -> None:
    content = message(1, 1, START, bytes(70 * MIB))
    path = tmp_path / "message.mcap"
    path.write_bytes(whole(metadata(METADATA), GOOD, content))
    told = read_apart(path)
    assert told["values"] == {"force": 2}
    assert any("64 MiB" in problem for problem in told["problems"])


def test_definitions_that_grow_when_parsed(tmp_path: Path) -> None:
    """A million tiny keys: ten times as large in memory as in the file."""
    keys = {f"{i:x}": "" for i in range(60_000)}
    definitions = [channel(i, f"/c{i}", keys) for i in range(3, 40)]
    path = tmp_path / "definitions.mcap"
    path.write_bytes(whole(metadata(METADATA), GOOD, chunk(b"".join(definitions))))
    told = read_apart(path)
    assert told["values"] == {"force": 2}
    assert any("definitions" in problem for problem in told["problems"])


@pytest.mark.long
def test_as_many_channels_as_there_can_be(tmp_path: Path) -> None:
    count = 60_000
    definitions = b"".join(channel(i, f"/{i:x}", {}) for i in range(3, count))
    messages = b"".join(message(i, 0, START, block(START, 1e-3, [1.0])) for i in range(3, count))
    path = tmp_path / "channels.mcap"
    path.write_bytes(whole(metadata(METADATA), schema(), chunk(definitions), chunk(messages)))
    told = read_apart(path)
    assert len(told["values"]) == count - 3


def test_hundreds_of_thousands_of_blocks_of_one_sample(tmp_path: Path) -> None:
    single = block(START, 1e-3, [1.0])
    parts = []
    for i in range(300_000):
        at = struct.pack("<Q", START + i * 1_000_000)
        parts.append(struct.pack("<BQHI", 5, 22 + len(single), 1, i) + at + at + single[:1] + at + single[9:])
    path = tmp_path / "blocks.mcap"
    halves = (b"".join(parts[:150_000]), b"".join(parts[150_000:]))
    path.write_bytes(whole(metadata(METADATA), DEFINITIONS, *map(chunk, halves)))
    told = read_apart(path)
    assert told["problems"] == []
    assert told["values"] == {"force": 300_000}


@pytest.mark.parametrize("length", [2**31, 2**40, 2**63, 2**64 - 1])
@pytest.mark.parametrize("opcode", [3, 4, 5, 6, 7, 8, 9, 0x0C, 0x0F, 0x80])
def test_huge_lengths(tmp_path: Path, opcode: int, length: int) -> None:
    """In this process: were such a length believed, the machine would say so."""
    from ingest.mcap_reader import read_mcap

    path = tmp_path / "length.mcap"
    content = whole(metadata(METADATA), GOOD)
    at = content.index(GOOD) + len(GOOD)
    path.write_bytes(content[:at] + struct.pack("<BQ", opcode, length) + bytes(100))
    recording = read_mcap(path)
    assert recording.channels[0].values.tolist() == [1.0, 2.0]
    assert any(f"claims {length} bytes where 100 are left" in problem for problem in recording.problems)


def test_huge_lengths_inside_records(tmp_path: Path) -> None:
    from ingest.mcap_reader import read_mcap

    huge = struct.pack("<I", 2**32 - 1)
    broken = [
        record(4, struct.pack("<HH", 7, 1) + huge + b"x"),
        record(4, struct.pack("<HH", 7, 1) + text("/x") + text("protobuf") + huge),
        record(3, struct.pack("<H", 9) + text("a") + text("b") + huge),
        record(0x0C, huge),
        record(0x0C, text("rig") + struct.pack("<I", 12) + text("key") + huge),
        record(5, b"short"),
        record(6, struct.pack("<QQQI", 0, 0, 4, 0) + text("") + struct.pack("<Q", 2**64 - 1) + b"abcd"),
    ]
    path = tmp_path / "inside.mcap"
    path.write_bytes(whole(metadata(METADATA), GOOD, *broken))
    recording = read_mcap(path)
    assert recording.channels[0].values.tolist() == [1.0, 2.0]
    assert len(recording.problems) == len(broken)
