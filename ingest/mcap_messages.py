"""MCAP files with one JSON or protobuf message per sample, as a file of columns.

A mapping's `column` is the topic, its `field` the key inside a message, with dots for deeper keys and numbers for
places in a list. The time of a sample is the message's log time, unless the mapping's time names a field (of the same
topic). A topic of `dealab.SampleBlock`s is mapped without a field.

Does not belong here: the record layout (ingest.mcap_scan), decoding (ingest.mcap_decoders), scaling, units and times (ingest.assemble).
"""

from __future__ import annotations

import dataclasses
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ingest.columns import Numbers, OwnTime, missing_column
from ingest.mapping import ColumnMapping, ColumnName, FileMapping, TimeMapping
from ingest.mcap_blocks import BlockCollector, Samples, is_block_schema
from ingest.mcap_decoders import LARGEST_MESSAGE, Decoder, decoder
from ingest.mcap_records import Channel, Schema
from ingest.mcap_scan import scan
from schemas.arrays import Int
from schemas.errors import RefusedError


@dataclass
class _Column:
    """One field of a topic's messages, a value or a gap for each message."""

    path: tuple[str, ...]
    get: Callable[[Any], Any]
    cells: list[str] | None
    values: array[float] = field(default_factory=lambda: array("d"))
    empty: bytearray = field(default_factory=bytearray)
    texts: int = 0
    example: str = ""

    def take(self, message: Any) -> None:
        value = self.get(message)
        if self.cells is not None:
            self.cells.append("" if value is None else str(value)[:64])
        number = float("nan")
        if value is not None:
            try:
                number = float(value) if isinstance(value, int | float) else number
            except OverflowError:
                number = float("inf")
            if not isinstance(value, int | float):
                self.texts += 1
                self.example = self.example or str(value)[:40]
        self.values.append(number)
        self.empty.append(value is None)


class _FieldCollector:
    """The mapped fields of one topic."""

    def __init__(self, decoder: Decoder, columns: Mapping[str, tuple[str, ...]], keep_cells: bool) -> None:
        self._decoder = decoder
        self.columns = {n: _Column(p, decoder.getter(p), [] if keep_cells else None) for n, p in columns.items()}
        self.log_times = array("q")
        self.undecoded = 0
        self.fields: Sequence[str] = ()

    def add(self, content: memoryview, log_time: int, sequence: int) -> None:
        """Takes one message; one that cannot be decoded is counted."""
        try:
            if len(content) > LARGEST_MESSAGE or log_time >= 2**63:
                raise ValueError("too long, or recorded after the year 2262")
            message = self._decoder.decode(content)
        except ValueError:
            self.undecoded += 1
            return
        if not self.log_times:
            self.fields = self._decoder.fields(message)
        self.log_times.append(log_time)
        for column in self.columns.values():
            column.take(message)


class MessageColumns:
    """An MCAP file as a `ColumnFile` whose columns are called `/topic.field`."""

    def __init__(self, mapping: FileMapping, where: str) -> None:
        self._where = where
        self._keep_cells = mapping.time is not None and mapping.time.format is not None
        self._topics: dict[str, dict[str, tuple[str, ...]]] = {}
        self.mapping = dataclasses.replace(
            mapping,
            columns={name: self._localised(name, column, mapping.time) for name, column in mapping.columns.items()},
        )
        self._collectors: dict[str, _FieldCollector | BlockCollector] = {}
        self._samples: dict[str, Samples] = {}
        self._others: list[str] = []
        self._units: dict[str, str] = {}

    def _localised(self, quantity: str, column: ColumnMapping, time: TimeMapping | None) -> ColumnMapping:
        """The column with its topic, field and index in one name, and with the time field of its own topic."""
        topic = column.column
        if not isinstance(topic, str):
            raise RefusedError(
                f"columns.{quantity}.column is {topic!r}",
                where=self._where,
                expected="a topic of the MCAP file as text",
                remedy="Correct the mapping TOML",
            )
        path = column.field.split(".") if column.field else []
        if column.index is not None:
            path.append(str(column.index))
        wanted = self._topics.setdefault(topic, {})
        name = ".".join((topic, *path))
        wanted[name] = tuple(path)
        time_field = column.time if column.time is not None else (time.column if time is not None else None)
        time_name = None
        if time_field is not None:
            time_name = f"{topic}.{time_field}"
            wanted[time_name] = tuple(str(time_field).split("."))
        return dataclasses.replace(column, column=name, field=None, index=None, time=time_name)

    def choose(self, channel: Channel, schema: Schema | None) -> _FieldCollector | BlockCollector | None:
        """The collector of a mapped topic. `RefusedError` when its messages cannot be decoded or lack the field."""
        topic = channel.topic
        if topic not in self._topics:
            self._others.append(topic)
            return None
        if topic in self._collectors:
            return self._collectors[topic]
        columns = self._topics[topic]
        if "unit" in channel.metadata:
            self._units[topic] = channel.metadata["unit"]
        where = f"{self._where}: {topic[:80]}"
        if is_block_schema(channel, schema) and not any(columns.values()):
            self._collectors[topic] = BlockCollector()
            return self._collectors[topic]
        self._collectors[topic] = _FieldCollector(decoder(channel, schema, where), columns, self._keep_cells)
        return self._collectors[topic]

    @property
    def problems(self) -> tuple[str, ...]:
        told = []
        for topic, collector in self._collectors.items():
            if isinstance(collector, _FieldCollector) and collector.undecoded:
                told.append(f"{topic}: {collector.undecoded} messages could not be decoded")
        return (*told, *(f"{topic}: {p}" for topic, s in self._samples.items() for p in s.problems))

    @property
    def notes(self) -> tuple[str, ...]:
        return tuple(f"{topic}: {note}" for topic, samples in self._samples.items() for note in samples.notes)

    def names(self) -> tuple[str, ...]:
        return (*self._collectors, *self._others)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        topic, collector = self._collector(column)
        if isinstance(collector, BlockCollector):
            values = self._block_samples(topic, collector).values
            return Numbers(values, np.zeros(values.shape, dtype=bool))
        found = collector.columns[str(column)]
        empty = np.frombuffer(bytes(found.empty), dtype=bool)
        if empty.all():
            raise RefusedError(
                f'no message of {topic[:80]} has the field "{".".join(found.path)[:80]}"',
                where=self._where,
                expected="one of " + ", ".join(f[:80] for f in collector.fields) if collector.fields else "",
                remedy="Correct field in the mapping TOML",
            )
        return Numbers(np.array(found.values), empty, found.texts, found.example)

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        _, collector = self._collector(column)
        if isinstance(collector, BlockCollector):
            return list(self.numbers(column).values)
        return collector.columns[str(column)].cells or []

    def unit(self, column: ColumnName) -> str | None:
        return self._units.get(self._collector(column)[0])

    def own_time(self, column: ColumnName) -> OwnTime:
        topic, collector = self._collector(column)
        if isinstance(collector, BlockCollector):
            times: Int = self._block_samples(topic, collector).time_ns
        else:
            times = np.array(collector.log_times, dtype=np.int64)
        start = int(times[0]) if times.size else 0
        return OwnTime(np.asarray((times - start) * 1e-9, dtype=np.float64), start)

    def _collector(self, column: ColumnName) -> tuple[str, _FieldCollector | BlockCollector]:
        for topic, names in self._topics.items():
            if column in names and topic in self._collectors:
                return topic, self._collectors[topic]
        raise missing_column(self.names(), column, self._where)

    def _block_samples(self, topic: str, collector: BlockCollector) -> Samples:
        if topic not in self._samples:
            self._samples[topic] = collector.samples({})
        return self._samples[topic]


def topic_fields(path: Path) -> dict[str, tuple[str, ...]]:
    """The topics of a file that need a mapping, each with the fields of its first message, as a mapping writes them.

    None are listed for an encoding that cannot be read. Raises `RefusedError` when the file is no MCAP file.
    """
    found: dict[str, tuple[str, ...]] = {}

    def choose(channel: Channel, schema: Schema | None) -> _FirstMessage | None:
        if is_block_schema(channel, schema) or channel.topic in found:
            return None
        found[channel.topic] = ()
        try:
            return _FirstMessage(channel.topic, decoder(channel, schema, path.name), found)
        except RefusedError:
            return None

    scan(path, choose, ())
    return found


@dataclass
class _FirstMessage:
    """Lists the fields of the first message that can be decoded."""

    topic: str
    decoder: Decoder
    found: dict[str, tuple[str, ...]]

    def add(self, content: memoryview, log_time: int, sequence: int) -> None:
        if self.found[self.topic] or len(content) > LARGEST_MESSAGE:
            return
        try:
            self.found[self.topic] = tuple(self.decoder.fields(self.decoder.decode(content)))
        except ValueError:
            return
