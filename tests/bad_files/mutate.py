"""Mutations of files: what disks, networks, editors and bad faith do to bytes. Pure: bytes and a random source in, bytes out."""

from __future__ import annotations

import random
import struct
import zlib
from collections.abc import Callable

import lz4.frame
import zstandard

_EDGES = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 32, (1 << 63) - 1, (1 << 64) - 1)
_WORDS = (b"nan", b"inf", b"-1e999", b"1e308", b",", b";", b"\t", b'"', b"\r\n", b"\x00", b"\xff\xfe", b"\xef\xbb\xbf")
_LONGEST = 64
_CHUNK_HEAD = struct.Struct("<QQQI")


def mutated(content: bytes, rng: random.Random) -> bytes:
    """One to four mutations of a file's bytes."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 3, 4))):
        rng.choice(_MUTATIONS)(data, rng)
    return bytes(data)


def resealed(content: bytes, rng: random.Random) -> bytes | None:
    """An MCAP file of which one chunk is mutated inside, with a right checksum and size again; None without chunks.

    What checksums would turn away reaches the parsers of records and blocks this way.
    """
    chunks = list(_chunks(content))
    if not chunks:
        return None
    at, length = rng.choice(chunks)
    body = content[at : at + length]
    start, end, _, _ = _CHUNK_HEAD.unpack_from(body)
    (name_length,) = struct.unpack_from("<I", body, _CHUNK_HEAD.size)
    name_at = _CHUNK_HEAD.size + 4
    compression = body[name_at : name_at + name_length].decode()
    stored = body[name_at + name_length + 8 :]
    inner = mutated({"zstd": zstandard.decompress, "lz4": lz4.frame.decompress}.get(compression, bytes)(stored), rng)
    packed = {"zstd": zstandard.compress, "lz4": lz4.frame.compress}.get(compression, bytes)(inner)
    head = _CHUNK_HEAD.pack(start, end, len(inner), zlib.crc32(inner)) + struct.pack("<I", name_length)
    record = head + compression.encode() + struct.pack("<Q", len(packed)) + packed
    return content[: at - 9] + struct.pack("<BQ", 6, len(record)) + record + content[at + length :]


def _chunks(content: bytes) -> list[tuple[int, int]]:
    """Place and length of the content of each chunk record of a valid file."""
    found, at = [], 8
    while at + 9 <= len(content) - 8:
        opcode, length = struct.unpack_from("<BQ", content, at)
        if opcode == 6:
            found.append((at + 9, length))
        at += 9 + length
    return found


def _place(data: bytearray, rng: random.Random) -> int:
    return rng.randrange(len(data) + 1) if data else 0


def _flip(data: bytearray, rng: random.Random) -> None:
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def _overwrite(data: bytearray, rng: random.Random) -> None:
    at = _place(data, rng)
    length = min(rng.randint(1, _LONGEST), len(data) - at)
    data[at : at + length] = rng.randbytes(length)


def _zero(data: bytearray, rng: random.Random) -> None:
    """A sector that never reached the disk."""
    at = _place(data, rng)
    length = min(rng.choice((8, 64, 512, 4096)), len(data) - at)
    data[at : at + length] = bytes(length)


def _remove(data: bytearray, rng: random.Random) -> None:
    at = _place(data, rng)
    del data[at : at + rng.randint(1, _LONGEST)]


def _insert(data: bytearray, rng: random.Random) -> None:
    at = _place(data, rng)
    data[at:at] = rng.choice(_WORDS) if rng.random() < 0.5 else rng.randbytes(rng.randint(1, _LONGEST))


def _repeat(data: bytearray, rng: random.Random) -> None:
    at = _place(data, rng)
    data[at:at] = data[at : at + rng.choice((1, 16, 256, 2048))]


def _move(data: bytearray, rng: random.Random) -> None:
    at, length = _place(data, rng), rng.choice((4, 64, 512))
    part = data[at : at + length]
    del data[at : at + length]
    to = _place(data, rng)
    data[to:to] = part


def _cut(data: bytearray, rng: random.Random) -> None:
    del data[_place(data, rng) :]


def _number(data: bytearray, rng: random.Random) -> None:
    """A length, count or offset at the edge of its range."""
    width = rng.choice((1, 2, 4, 8))
    value = (rng.choice(_EDGES) + rng.randint(-2, 2)) % (1 << 8 * width)
    if len(data) >= width:
        at = rng.randrange(len(data) - width + 1)
        data[at : at + width] = value.to_bytes(width, rng.choice(("little", "big")))


def _digit(data: bytearray, rng: random.Random) -> None:
    """Another character in a text."""
    places = [i for i in range(min(len(data), 4096)) if 48 <= data[i] <= 57]
    if places:
        data[rng.choice(places)] = rng.choice(b"0123456789eE+-.,xn ")


_MUTATIONS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    _flip, _flip, _overwrite, _zero, _remove, _insert, _repeat, _move, _cut, _number, _number, _digit,
)  # fmt: skip
