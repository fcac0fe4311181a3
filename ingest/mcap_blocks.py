"""`dealab.SampleBlock` messages: parsing one, collecting those of a channel, times and order of their samples.

Blocks may arrive in any order, twice, or overlapping: the samples that come out are ascending in time, and what was
left out for it is told.

Does not belong here: the MCAP records around the messages (ingest.mcap_records), units and plausibility
(ingest.canonical).
"""

from __future__ import annotations

import math
import struct
import sys
from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ingest.mcap_records import Channel, Schema
from ingest.mcap_words import iso, plural
from schemas.arrays import Float, Int

SCHEMA_NAME = "dealab.SampleBlock"


_USUAL = struct.Struct("<BqBdB")
"""The fields in ascending order, as every protobuf writer puts them: tag, start, tag, interval, tag of the values."""

_START_TAG, _INTERVAL_TAG, _PACKED_TAG, _SINGLE_TAG = 0x09, 0x11, 0x1A, 0x19
_VARINT, _FIXED64, _LENGTH, _GROUP, _GROUP_END, _FIXED32 = range(6)
_LAST_NS, _LONGEST_NS = 2**63 - 1, 2**62
_SLAB = 1 << 16
"""Samples whose times are computed at once, so that the work stays in the processor's cache."""


def is_block_schema(channel: Channel, schema: Schema | None) -> bool:
    """Whether a channel holds sample blocks, by what its message encoding and its schema are called."""
    return (
        channel.message_encoding == "protobuf"
        and schema is not None
        and schema.name == SCHEMA_NAME
        and schema.encoding == "protobuf"
    )


class BlockError(Exception):
    """A block whose samples cannot be used; the text says why, without numbers, so that equal reasons can be counted."""


def parse_block(content: memoryview) -> tuple[int, float, list[memoryview]]:
    """Start in ns, interval in s, and the stretches of packed little-endian doubles of one serialised message.

    Fields in any order, the last of a repeated single field counts, packed and unpacked values may alternate and
    unknown fields are skipped, as the protobuf encoding has it. Raises `BlockError` when the bytes are no such message.
    """
    if len(content) > _USUAL.size:
        start_tag, start, interval_tag, interval, values_tag = _USUAL.unpack_from(content)
        if start_tag == _START_TAG and interval_tag == _INTERVAL_TAG and values_tag == _PACKED_TAG:
            length, at = _varint(content, _USUAL.size)
            if at + length == len(content) and length % 8 == 0:
                return start, interval, [content[at:]]
    return _parse_any(content)


def _parse_any(content: memoryview) -> tuple[int, float, list[memoryview]]:
    start, interval = 0, 0.0
    values: list[memoryview] = []
    at, end = 0, len(content)
    while at < end:
        tag, at = _varint(content, at)
        if tag in (_START_TAG, _INTERVAL_TAG, _SINGLE_TAG):
            if at + 8 > end:
                raise BlockError("a field goes beyond the end of the message")
            if tag == _START_TAG:
                (start,) = struct.unpack_from("<q", content, at)
            elif tag == _INTERVAL_TAG:
                (interval,) = struct.unpack_from("<d", content, at)
            else:
                values.append(content[at : at + 8])
            at += 8
        elif tag == _PACKED_TAG:
            length, at = _varint(content, at)
            if length > end - at:
                raise BlockError("a field goes beyond the end of the message")
            if length % 8:
                raise BlockError("the packed values are not a whole number of doubles")
            values.append(content[at : at + length])
            at += length
        else:
            at = _skipped(content, at, tag)
    return start, interval, values


def _varint(content: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while at < len(content) and shift < 70:
        byte = content[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
    raise BlockError("a number in the message does not end")


def _skipped(content: memoryview, at: int, tag: int) -> int:
    """The place after an unknown field; groups, which may hold groups, are skipped to their end."""
    open_groups: list[int] = []
    while True:
        field, wire = tag >> 3, tag & 7
        if field == 0:
            raise BlockError("a field has the number 0")
        if wire == _VARINT:
            _, at = _varint(content, at)
        elif wire == _FIXED64:
            at += 8
        elif wire == _LENGTH:
            length, at = _varint(content, at)
            at += length
        elif wire == _FIXED32:
            at += 4
        elif wire == _GROUP:
            open_groups.append(field)
        elif wire == _GROUP_END and open_groups and open_groups[-1] == field:
            open_groups.pop()
        else:
            raise BlockError("a field has an impossible type")
        if at > len(content):
            raise BlockError("a field goes beyond the end of the message")
        if not open_groups:
            return at
        tag, at = _varint(content, at)


@dataclass(frozen=True)
class Samples:
    """Samples of one channel, `time_ns` (n,) strictly ascending, `values` (n,); what is wrong and worth knowing."""

    time_ns: Int
    values: Float
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


class _Doubles:
    """Doubles that arrive in stretches of bytes.

    Kept in arrays that grow with what is there already, joined once at the end: one array that grows would be copied
    or moved at each step, and keeping the stretches would keep the chunks that they are parts of.
    """

    _SMALLEST, _LARGEST = 1 << 9, 1 << 23

    def __init__(self) -> None:
        self._full: list[Float] = []
        self._open = np.empty(0)
        self._bytes = memoryview(b"")
        self._used = 0
        self._size = 0

    def extend(self, content: memoryview) -> None:
        """Adds little-endian doubles; a whole number of them."""
        end = self._used + len(content)
        if end > len(self._bytes):
            self._full.append(self._open[: self._used // 8])
            capacity = max(len(content), self._SMALLEST, min(8 * self._size, self._LARGEST))
            self._open = np.empty(capacity // 8)
            self._bytes = self._open.data.cast("B")
            self._used, end = 0, len(content)
        self._bytes[self._used : end] = content
        self._used = end
        self._size += len(content)

    def joined(self) -> Float:
        """All of them, (n,)."""
        joined: Float = np.concatenate([*self._full, self._open[: self._used // 8]])
        return joined if sys.byteorder == "little" else joined.byteswap()


class BlockCollector:
    """Collects the blocks of one channel as they are read: 32 bytes for each block, 8 for each sample."""

    def __init__(self) -> None:
        self._start = array("q")
        self._interval = array("d")
        self._count = array("q")
        self._sequence = array("q")
        self._values = _Doubles()
        self._refused: Counter[str] = Counter()
        self._shifted = 0

    def add(self, content: memoryview, log_time: int, sequence: int) -> None:
        """Takes one message; a block that cannot be used is counted with its reason, nothing is raised."""
        try:
            start, interval, values = parse_block(content)
            count = sum(len(v) for v in values) // 8
            if count == 0:
                return
            if not math.isfinite(interval) or interval <= 0:
                raise BlockError("sample_interval_s is not a finite number above 0")
            if interval < 1e-9 and count > 1:
                raise BlockError("sample_interval_s is below 1 ns")
            span = (count - 1) * interval * 1e9
            if span >= _LONGEST_NS or start + span >= _LAST_NS:
                raise BlockError("the times go beyond the year 2262")
        except BlockError as error:
            self._refused[str(error)] += 1
            return
        self._start.append(start)
        self._interval.append(interval)
        self._count.append(count)
        self._sequence.append(sequence)
        for part in values:
            self._values.extend(part)
        self._shifted += log_time != start

    def samples(self, known_times: dict[tuple[bytes, bytes, bytes], Int]) -> Samples:
        """All samples, ascending in time; to be called once, the collector gives them away.

        `known_times` is shared by the channels of a file: those with the same time base get the same array.
        """
        problems = [f"{plural(number, 'block')} left out: {reason}" for reason, number in sorted(self._refused.items())]
        notes = []
        if self._shifted:
            notes.append(f"log_time is not start_time_ns in {plural(self._shifted, 'block')}; start_time_ns is used")
        start, count, sequence = (np.array(a, dtype=np.int64) for a in (self._start, self._count, self._sequence))
        interval = np.array(self._interval, dtype=np.float64)
        values = self._values.joined()
        self._values = _Doubles()
        if np.any(np.diff(start) < 0):
            order = np.argsort(start, kind="stable")
            values = values[_sample_order(count, order)]
            start, interval, count, sequence = start[order], interval[order], count[order], sequence[order]
            notes.append("blocks were not in the order of time; sorted")
        key = start.tobytes(), interval.tobytes(), count.tobytes()
        if key not in known_times:
            known_times[key] = block_times(start, interval, count)
        times = known_times[key]
        ends = times[np.cumsum(count) - 1]
        if np.any(start[1:] <= ends[:-1]):
            times, values, told = _without_overlaps(times, values)
            problems += told.problems
            notes += told.notes
        problems += missing_blocks(sequence)
        return Samples(times, values, tuple(problems), tuple(notes))


def block_times(start: Int, interval: Float, count: Int) -> Int:
    """Time of every sample: start + round(i × interval × 10⁹) ns for i = 0 … count − 1 of each block.

    `start` in ns, `interval` in s, `count`: (blocks,). Returns (sum of count,).
    """
    times = np.empty(int(count.sum()), dtype=np.int64)
    ends = np.cumsum(count)
    for first, last in _slabs(ends):
        counts = count[first:last]
        at = int(ends[first] - count[first])
        begins = ends[first:last] - counts
        local = np.arange(at, int(ends[last - 1]), dtype=np.int64) - np.repeat(begins, counts)
        offset = np.rint(local * np.repeat(interval[first:last], counts) * 1e9).astype(np.int64)
        np.add(offset, np.repeat(start[first:last], counts), out=times[at : at + offset.size])
    return times


def _slabs(ends: Int) -> Iterator[tuple[int, int]]:
    """Ranges of blocks that hold about `_SLAB` samples together, at least one block each."""
    first = 0
    while first < ends.size:
        done = ends[first - 1] if first else 0
        last = max(first + 1, int(np.searchsorted(ends, done + _SLAB, side="right")))
        yield first, last
        first = last


def _sample_order(count: Int, order: Int) -> Int:
    """Indices of the samples when their blocks are put into `order`."""
    begins = (np.cumsum(count) - count)[order]
    counts = count[order]
    ends = np.cumsum(counts)
    indices: Int = np.arange(int(ends[-1]), dtype=np.int64) + np.repeat(begins - (ends - counts), counts)
    return indices


def _without_overlaps(times: Int, values: Float) -> tuple[Int, Float, Samples]:
    """Keeps each sample that is later than all before it, blocks being in the order of their starts.

    A sample left out that equals a kept one of the same time is a duplicate; any other contradicts what is kept.
    """
    latest = np.maximum.accumulate(times)
    keep = np.concatenate(([True], times[1:] > latest[:-1]))
    kept_times, kept_values = times[keep], values[keep]
    out_times, out_values = times[~keep], values[~keep]
    place = np.searchsorted(kept_times, out_times).clip(max=kept_times.size - 1)
    same = (kept_times[place] == out_times) & (kept_values[place].view(np.int64) == out_values.view(np.int64))
    duplicates, conflicts = int(same.sum()), int((~same).sum())
    problems, notes = [], []
    if duplicates:
        notes.append(f"{plural(duplicates, 'sample')} recorded twice; kept once")
    if conflicts:
        first = iso(int(out_times[~same].min()))
        problems.append(f"{plural(conflicts, 'sample')} left out: blocks overlap with other values from {first} on")
    return kept_times, kept_values, Samples(kept_times, kept_values, tuple(problems), tuple(notes))


def missing_blocks(sequence: Int) -> list[str]:
    """What the blocks' numbers, in the order of time, say about lost ones; nothing where blocks carry no numbers."""
    numbers = np.unique(sequence)
    if numbers.size <= 1:
        return []
    if np.any(np.diff(sequence) < 0):
        return ["the blocks' sequence numbers do not ascend with their times"]
    gaps = np.flatnonzero(np.diff(numbers) > 1)
    lost = [(int(numbers[i]) + 1, int(numbers[i + 1]) - 1) for i in gaps]
    if numbers[0] > 0:
        lost.insert(0, (0, int(numbers[0]) - 1))
    if not lost:
        return []
    shown = ", ".join(f"{a}" if a == b else f"{a}–{b}" for a, b in lost[:5])
    more = f" and {len(lost) - 5} more gaps" if len(lost) > 5 else ""
    return [f"{plural(sum(b - a + 1 for a, b in lost), 'block')} missing (sequence {shown}{more})"]
