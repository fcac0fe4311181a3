"""One pass over an MCAP file: every message that can be trusted goes to a collector, every loss is told.

A chunk is taken whole after its checksum has been verified, or not at all. What the file's end says (its summary) is
used as a second witness: for definitions that were lost, for chunks that a damaged length made unreachable, and for
the number of messages.

Does not belong here: what a message means (the collectors), what a recording needs (ingest.mcap_reader).
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from ingest.mcap_chunks import LARGEST_CHUNK, Chunk, opened
from ingest.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEAD_SIZE,
    MAGIC,
    MESSAGE,
    METADATA,
    SCHEMA,
    ByteSource,
    Channel,
    FileSource,
    MalformedError,
    Schema,
    fields,
    pieces,
    walk,
)
from ingest.mcap_summary import LARGEST_DEFINITIONS, Summary, read_summary
from ingest.mcap_words import Loss, iso, losses_in_words, plural
from schemas.errors import RefusedError

_MESSAGE = struct.Struct("<HIQQ")
_LARGEST_MESSAGE = 64 << 20
"""Longest message that is taken, bytes: 8 million samples in one block."""

_LARGEST_METADATA = 1 << 20
_MOST_PROBLEMS = 50
"""Problems told one by one; of further ones the number."""

_INFLATION_FLOOR, _INFLATION_FACTOR, _INFLATION_CEILING = 32 << 20, 512, 8 << 30
"""Chunks may together inflate to the factor times the file's size, or to the floor if that is more, never beyond the
ceiling (10⁹ samples). Blocks of 1000 equal samples inflate by about 250: their times and numbers do not compress."""

_SAME_LOOKING = 4
"""Chunks with equal heads that a further one is compared with, byte by byte, to see whether it is a duplicate."""


class Collector(Protocol):
    """Takes the messages of a channel."""

    def add(self, content: memoryview, log_time: int, sequence: int) -> None: ...


Choose = Callable[[Channel, Schema | None], Collector | None]
"""The collector for a channel, None when its messages are not wanted; asked once for each channel with messages."""


@dataclass
class Scan:
    """What a file holds besides the messages. `metadata`: the first record of each wanted name."""

    metadata: dict[str, Mapping[str, str]] = field(default_factory=dict)
    message_count: int = 0
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    losses: tuple[Loss, ...] = ()

    def lost_before(self, time_ns: int) -> bool:
        """Whether a damaged chunk was lost that may hold messages from before an instant."""
        return any(loss.first_ns is None or loss.first_ns < time_ns for loss in self.losses)


def scan(path: Path, choose: Choose, wanted_metadata: tuple[str, ...]) -> Scan:
    """Reads a file once and hands its messages to the collectors that `choose` gives.

    Raises `RefusedError` when the file is empty or is not an MCAP file; all other damage is told in `problems`.
    """
    with path.open("rb", buffering=0) as file:
        return _Scanner(FileSource(file), choose, wanted_metadata, path.name).run()


@dataclass
class _Definitions:
    """Schemas and channels by their numbers."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)


class _Scanner:
    def __init__(self, source: FileSource, choose: Choose, wanted_metadata: tuple[str, ...], where: str) -> None:
        self._source = source
        self._choose = choose
        self._wanted = wanted_metadata
        self._where = where
        self._found = Scan()
        self._summary: Summary | None = None
        self._defined = _Definitions()
        self._loose = _Definitions()
        self._loose_messages = 0
        self._collectors: dict[int, Collector | None] = {}
        self._counts: Counter[int] = Counter()
        self._undefined: Counter[int] = Counter()
        self._seen: dict[int, int] = {}
        self._chunks: dict[tuple[int, ...], list[Chunk]] = defaultdict(list)
        self._duplicates = 0
        self._losses: list[Loss] = []
        self._definitions_left = LARGEST_DEFINITIONS
        self._untold = 0
        self._inflation_left = min(max(_INFLATION_FLOOR, _INFLATION_FACTOR * source.size), _INFLATION_CEILING)
        # apart, for one chunk with a wrong size must not use up what the others need
        self._inflation_in_vain_left = self._inflation_left

    def run(self) -> Scan:
        self._check_magic()
        damaged_summary = ""
        try:
            self._summary = read_summary(self._source)
        except MalformedError as error:
            damaged_summary = f"the end of the file is damaged: {error.reason}"
        self._check_crc(self._data_section())
        if damaged_summary:
            self._tell(damaged_summary)
        if self._summary is not None:
            self._from_index(self._summary)
        if self._loose_messages:
            indexed = self._summary.chunks if self._summary is not None else []
            self._take_loose_messages(bool(self._chunks or self._losses or indexed))
        self._found.losses = tuple(self._losses)
        self._tell_losses()
        if self._summary is not None:
            self._compare(self._summary)
        if self._untold:
            self._found.problems.append(f"and {self._untold} more problems")
        self._found.message_count = self._counts.total()
        return self._found

    def _tell(self, problem: str) -> None:
        problems = self._found.problems
        if problem not in problems:
            if len(problems) < _MOST_PROBLEMS:
                problems.append(problem)
            else:
                self._untold += 1

    def _note(self, note: str) -> None:
        if note not in self._found.notes:
            self._found.notes.append(note)

    def _check_magic(self) -> None:
        source = self._source
        if source.size == 0:
            raise RefusedError("the file is empty", where=self._where, expected="an MCAP file")
        if bytes(source.read(0, len(MAGIC))) == MAGIC:
            return
        if source.size < len(MAGIC) or bytes(source.read(source.size - len(MAGIC), len(MAGIC))) != MAGIC:
            raise RefusedError(
                "the file does not begin as an MCAP file does",
                where=self._where,
                expected="the eight bytes \\x89MCAP0\\r\\n",
            )
        self._tell("the first eight bytes of the file are damaged")

    def _data_section(self) -> tuple[int, int] | None:
        """Reads all records up to the end; returns where the data section ends and its CRC-32 as recorded."""
        source = self._source
        data_end: tuple[int, int] | None = None
        try:
            for opcode, offset, length in walk(source, len(MAGIC)):
                if opcode == FOOTER:
                    self._check_end(offset + length, data_end)
                    return data_end
                if data_end is not None:
                    continue
                if opcode == DATA_END:
                    data_end = offset - HEAD_SIZE, int.from_bytes(source.read(offset, min(length, 4)), "little")
                else:
                    self._record(opcode, offset, length)
            self._tell(f"the file is cut at byte {source.size}: its end is missing, what came after is lost")
        except MalformedError as error:
            self._tell_cut(error)
        return data_end

    def _record(self, opcode: int, offset: int, length: int) -> None:
        if opcode == CHUNK:
            self._seen[offset - HEAD_SIZE] = length
            self._chunk(offset, length)
        elif opcode == METADATA:
            self._seen[offset - HEAD_SIZE] = length
            self._metadata(offset, length)
        elif opcode == MESSAGE:
            self._loose_messages += 1
        elif opcode in (SCHEMA, CHANNEL):
            self._loose_record(opcode, offset, length)

    def _loose_record(self, opcode: int, offset: int, length: int) -> None:
        """A message or a definition outside the chunks: no checksum of a chunk covers it."""
        try:
            if opcode == MESSAGE:
                self._message(self._source, offset, length)
            else:
                self._define(self._loose, opcode, self._source, offset, length)
        except MalformedError as error:
            self._tell(f"a record at byte {offset - HEAD_SIZE} cannot be read: {error.reason}")

    def _take_loose_messages(self, has_chunks: bool) -> None:
        """Takes the messages outside the chunks, last of all.

        In a damaged file that has chunks they are likely the inside of one whose head was lost, checked by nothing.
        """
        if has_chunks and (self._losses or self._found.problems):
            self._tell(
                f"{plural(self._loose_messages, 'message')} outside the chunks left out: nothing vouches for them"
            )
            return
        try:
            for opcode, offset, length in walk(self._source, len(MAGIC)):
                if opcode == DATA_END:
                    return
                if opcode == MESSAGE:
                    self._loose_record(opcode, offset, length)
        except MalformedError:
            return  # told when the file was walked first

    def _chunk(self, offset: int, length: int) -> None:
        try:
            chunk = Chunk.parse(self._source, offset, length)
        except MalformedError as error:
            self._losses.append(Loss(offset - HEAD_SIZE, error.reason))
            return
        if self._is_duplicate(chunk):
            self._duplicates += 1
            return
        whole = True
        try:
            with self._opened(chunk) as content:
                whole = False
                for opcode, at, size in walk(content):
                    if opcode == MESSAGE:
                        self._message(content, at, size)
                    elif opcode in (SCHEMA, CHANNEL):
                        self._define(self._defined, opcode, content, at, size)
        except MalformedError as error:
            self._losses.append(Loss(offset - HEAD_SIZE, error.reason, chunk.first_ns, chunk.last_ns, whole))

    @contextmanager
    def _opened(self, chunk: Chunk) -> Iterator[ByteSource]:
        """The content of a chunk, within what the file's chunks may inflate to."""
        inflated = 0 if chunk.compression == "" or chunk.size > LARGEST_CHUNK else chunk.size
        if inflated > min(self._inflation_left, self._inflation_in_vain_left):
            raise MalformedError(f"the chunks would inflate to more than {_INFLATION_FACTOR} times the file's size")
        self._inflation_in_vain_left -= inflated
        with opened(self._source, chunk) as content:
            self._inflation_in_vain_left += inflated
            self._inflation_left -= inflated
            yield content

    def _message(self, content: ByteSource, offset: int, length: int) -> None:
        if length < _MESSAGE.size:
            raise MalformedError("a message is shorter than its head")
        channel_id, sequence, log_time, _ = _MESSAGE.unpack(content.read(offset, _MESSAGE.size))
        self._counts[channel_id] += 1
        try:
            collector = self._collectors[channel_id]
        except KeyError:
            collector = self._new_collector(channel_id)
        if collector is None:
            return
        if length > _LARGEST_MESSAGE:
            raise MalformedError(f"a message has more than {_LARGEST_MESSAGE >> 20} MiB")
        message = content.read(offset + _MESSAGE.size, length - _MESSAGE.size)
        collector.add(memoryview(message), log_time, sequence)

    def _new_collector(self, channel_id: int) -> Collector | None:
        # what a checksum covers comes before what none does
        known = (self._defined, self._summary or _Definitions(), self._loose)
        channel = next((d.channels[channel_id] for d in known if channel_id in d.channels), None)
        if channel is None:
            self._undefined[channel_id] += 1
            return None
        number = channel.schema_id
        schema = next((d.schemas[number] for d in known if number in d.schemas), None)
        collector = self._choose(channel, schema)
        self._collectors[channel_id] = collector
        return collector

    def _define(self, known: _Definitions, opcode: int, content: ByteSource, offset: int, length: int) -> None:
        if length > self._definitions_left:
            raise MalformedError(f"the definitions of channels take more than {LARGEST_DEFINITIONS >> 20} MiB")
        record = content.read(offset, length)
        if opcode == SCHEMA:
            schema = Schema.parse(record)
            is_new = schema.id not in known.schemas
            same = known.schemas.setdefault(schema.id, schema) == schema
        else:
            channel = Channel.parse(record)
            is_new = channel.id not in known.channels
            same = known.channels.setdefault(channel.id, channel) == channel
        if is_new:
            self._definitions_left -= length
        elif not same:
            kind = "schema" if opcode == SCHEMA else "channel"
            self._tell(f"a {kind} is defined twice and differently; the first definition is used")

    def _metadata(self, offset: int, length: int) -> None:
        try:
            if length > _LARGEST_METADATA:
                raise MalformedError(f"it has {length} bytes, more than {_LARGEST_METADATA}")
            found = fields(METADATA, self._source.read(offset, length))
        except MalformedError as error:
            self._tell(f"a metadata record at byte {offset - HEAD_SIZE} cannot be read: {error.reason}")
            return
        name = found["name"]
        if name not in self._wanted:
            return
        if name not in self._found.metadata:
            self._found.metadata[name] = found["metadata"]
        elif self._found.metadata[name] != found["metadata"]:
            self._note(f'a further metadata record "{name}" says something else; the first is used')
        else:
            self._note(f'the metadata record "{name}" is there twice')

    def _is_duplicate(self, chunk: Chunk) -> bool:
        alike = self._chunks[chunk.crc, chunk.size, chunk.length, chunk.first_ns, chunk.last_ns]
        for other in alike:
            pair = (pieces(self._source, c.start, c.length) for c in (chunk, other))
            if chunk.compression == other.compression and all(a == b for a, b in zip(*pair, strict=True)):
                return True
        if len(alike) < _SAME_LOOKING:
            alike.append(chunk)
        return False

    def _from_index(self, summary: Summary) -> None:
        """Takes the chunks and metadata that the index knows and the walk did not meet, or met with a wrong length."""
        recovered = 0
        failed = {loss.offset for loss in self._losses}
        for places, take in ((summary.chunks, self._chunk), (summary.metadata, self._metadata)):
            for place, length in places:
                known = self._seen.get(place)
                retry = known is None or (known != length - HEAD_SIZE and place in failed)
                if retry and length > HEAD_SIZE and place + length <= self._source.size:
                    self._seen[place] = length - HEAD_SIZE
                    self._losses = [loss for loss in self._losses if loss.offset != place]
                    take(place + HEAD_SIZE, length - HEAD_SIZE)
                    recovered += 1
        if recovered:
            self._tell(f"{plural(recovered, 'record')} could be reached only through the index at the end of the file")

    def _check_end(self, offset: int, data_end: tuple[int, int] | None) -> None:
        if data_end is None:
            self._tell("the record that ends the data section is missing")
        if bytes(self._source.read(offset, len(MAGIC))) != MAGIC:
            self._tell("the closing mark of the file is missing or damaged")
        elif offset + len(MAGIC) != self._source.size:
            self._tell(f"{self._source.size - offset - len(MAGIC)} bytes follow the end of the file; left out")

    def _check_crc(self, data_end: tuple[int, int] | None) -> None:
        """A data section's CRC-32 of 0 means that the writer did not compute one."""
        if data_end is None or data_end[1] == 0 or self._losses:
            return
        crc = 0
        for piece in pieces(self._source, 0, data_end[0]):
            crc = zlib.crc32(piece, crc)
        if crc != data_end[1]:
            what = "samples and metadata" if self._loose_messages else "metadata"
            self._tell(f"the checksum (CRC-32) of the data section does not match; {what} may have changed")

    def _tell_cut(self, error: MalformedError) -> None:
        text = f"the file cannot be followed beyond byte {error.offset} of {self._source.size}: {error.reason}"
        head = bytes(self._source.read(error.offset, HEAD_SIZE + 16))
        if len(head) == HEAD_SIZE + 16 and head[0] == CHUNK:
            text += (
                f"; a chunk with data from {iso(int.from_bytes(head[HEAD_SIZE : HEAD_SIZE + 8], 'little'))} on is cut"
            )
        self._tell(text)

    def _tell_losses(self) -> None:
        for problem in losses_in_words(self._losses):
            self._tell(problem)
        if self._duplicates:
            self._note(f"{plural(self._duplicates, 'chunk')} recorded twice; taken once")
        if self._undefined:
            self._tell(f"{plural(self._undefined.total(), 'message')} left out: their channels are defined nowhere")

    def _compare(self, summary: Summary) -> None:
        """What the summary says against what was found; told only where no other loss explains a difference."""
        for known in (self._defined, self._loose):
            pairs = ((known.channels, summary.channels), (known.schemas, summary.schemas))
            if any(theirs[i] != found for ours, theirs in pairs for i, found in ours.items() if i in theirs):
                self._tell("a channel is defined differently at the end of the file")
        counts = summary.message_counts
        if counts is not None and not self._found.problems and not self._duplicates:
            expected, found = sum(counts.values()), self._counts.total()
            if expected != found or any(self._counts[i] != n for i, n in counts.items()):
                self._tell(f"the file says that it has {expected} messages, {found} were found")
