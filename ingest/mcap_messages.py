"""MCAP files with one JSON or protobuf message per sample, as a file of columns.

A mapping's `column` is the topic, its `field` the key inside a message, with dots for deeper keys and numbers for
places in a list. The time of a sample is the message's log time, unless the mapping's time names a field (of the same
topic). Messages that the file has in another order are put into that of their log times. A topic of
`dealab.SampleBlock`s is mapped without a field.

Does not belong here: the record layout (ingest.mcap_scan), decoding (ingest.mcap_decoders), scaling, units and times (ingest.assemble).
"""

from __future__ import annotations

import dataclasses
import functools
import math
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ingest.array_numbers import TRUTHS, as_double, numbers_from_cells
from ingest.columns import Numbers, OwnTime, missing_column
from ingest.mapping import ColumnMapping, ColumnName, FileMapping, TimeMapping
from ingest.mcap_blocks import BlockCollector, Samples, is_block_schema
from ingest.mcap_decoders import LARGEST_MESSAGE, Decoder, decoder
from ingest.mcap_records import Channel, Schema
from schemas.arrays import Float, Int
from schemas.errors import RefusedError

_MOST_STEPS = 10_000
"""Places where time runs back that are looked at."""
_FEWEST_OUTSIDE = 10
_FEW_STEPS = 0.05
"""Where time runs back in fewer places than this share, messages that follow each other are a sample apart."""
_CROWDED = 1.5
"""Messages of two stretches that lie upon each other are twice as many as their time has place for."""


@dataclass
class _Column:
    """One field of a topic's messages: a number for each message, NaN where it has none, and texts by message."""

    path: tuple[str, ...]
    get: Callable[[Any], Any]
    keep_cells: bool
    values: array[float] = field(default_factory=lambda: array("d"))
    empty: bytearray = field(default_factory=bytearray)
    texts: dict[int, str] = field(default_factory=dict)
    cells: list[str] = field(default_factory=list)
    has_truths: bool = False

    def take(self, message: Any) -> None:
        self._take(self.get(message))

    def take_nothing(self) -> None:
        """A message that could not be decoded: a sample that was lost."""
        self._take(None)

    def _take(self, value: Any) -> None:
        if self.keep_cells:
            self.cells.append("" if value is None else str(value)[:64])
        self.has_truths |= isinstance(value, bool)
        if value is None or isinstance(value, int | float):
            self.values.append(math.nan if value is None else as_double(value))
        else:
            self.texts[len(self.values)] = str(value)[:64]
            self.values.append(math.nan)
        self.empty.append(value is None)


class _FieldCollector:
    """The mapped fields of one topic, a row for each message in the order of the file."""

    def __init__(
        self, decoder: Decoder, columns: Mapping[str, tuple[str, ...]], *, keep_cells: bool, keep_lost: bool
    ) -> None:
        self._decoder = decoder
        self._keep_lost = keep_lost
        self.columns = {n: _Column(p, decoder.getter(p), keep_cells) for n, p in columns.items()}
        self.log_times = array("q")
        self.undecoded = 0
        self.fields: Sequence[str] = ()

    def add(self, content: memoryview, log_time: int, sequence: int) -> None:
        """Takes one message; one that cannot be decoded is counted, and a row without values where rows are time."""
        try:
            if len(content) > LARGEST_MESSAGE or log_time >= 2**63:
                raise ValueError("too long, or recorded after the year 2262")
            message = self._decoder.decode(content)
        except ValueError:
            self.undecoded += 1
            if self._keep_lost:
                self.log_times.append(min(log_time, 2**63 - 1))
                for column in self.columns.values():
                    column.take_nothing()
            return
        self.log_times.append(log_time)
        if not self.fields:
            self.fields = self._decoder.fields(message)
        for column in self.columns.values():
            column.take(message)

    @functools.cached_property
    def order(self) -> Int | None:
        """Positions of the messages in the order of their times, None where they stand in it; see `time_order`."""
        return time_order(np.array(self.log_times, dtype=np.int64))


def time_order(time_ns: Int) -> Int | None:
    """Positions that sort (n,) instants, None where they ascend already or where a clock that was set back explains it.

    Writers with several threads, and those that sort by topic, leave messages in any order, and sorted they are as far
    apart as ever. After a clock was set back two stretches of the test lie upon each other: sorted, their messages are
    closer than the usual interval, and no order of theirs is right.
    """
    steps = np.diff(time_ns)
    if (steps >= 0).all():
        return None
    order: Int = np.argsort(time_ns, kind="stable")
    interleaved = np.diff(time_ns[order])
    moved = np.flatnonzero(steps < 0)
    overlap = np.zeros(interleaved.size, dtype=bool)
    for i in moved[:_MOST_STEPS]:
        first, last = np.searchsorted(time_ns[order], (time_ns[i + 1], time_ns[i]))
        overlap[first:last] = True
    outside = interleaved[~overlap]
    if outside.size >= _FEWEST_OUTSIDE:
        usual = float(np.median(outside))
    elif moved.size < _FEW_STEPS * steps.size:
        usual = float(np.median(steps[steps > 0]))
    else:
        return order
    crowded = float(overlap.sum()) * usual > _CROWDED * float(interleaved[overlap].sum()) + 2 * usual
    return None if crowded else order


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
        self._collectors[topic] = _FieldCollector(
            decoder(channel, schema, where),
            columns,
            keep_cells=self._keep_cells,
            keep_lost=self.mapping.counts_rows_as_time,
        )
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
        unordered = tuple(
            f"{topic}: messages are not in the order of their log times; sorted"
            for topic, collector in self._collectors.items()
            if isinstance(collector, _FieldCollector) and collector.order is not None
        )
        return (*unordered, *(f"{topic}: {note}" for topic, s in self._samples.items() for note in s.notes))

    def names(self) -> tuple[str, ...]:
        return (*self._collectors, *self._others)

    def numbers(self, column: ColumnName, index: int | None = None) -> Numbers:
        topic, collector = self._collector(column)
        if isinstance(collector, BlockCollector):
            values = self._block_samples(topic, collector).values
            return Numbers(values, np.zeros(values.shape, dtype=bool))
        found = collector.columns[str(column)]
        empty = self._in_order(collector, np.frombuffer(bytes(found.empty), dtype=bool))
        if empty.all():
            raise RefusedError(
                f'no message of {topic[:80]} has the field "{".".join(found.path)[:80]}"',
                where=self._where,
                expected="one of " + ", ".join(f[:80] for f in collector.fields) if collector.fields else "",
                remedy="Correct field in the mapping TOML",
            )
        values = self._in_order(collector, np.array(found.values))
        notes = (TRUTHS,) if found.has_truths else ()
        if not found.texts:
            return Numbers(values, empty, notes=notes)
        cells = values.astype(object)
        place = self._in_order(collector, np.arange(values.size))
        for row in np.flatnonzero(np.isin(place, list(found.texts))):
            cells[row] = found.texts[int(place[row])]
        cells[empty] = None
        mixed = numbers_from_cells(cells.tolist(), column, self._where)
        return dataclasses.replace(mixed, notes=(*mixed.notes, *notes))

    def cells(self, column: ColumnName, index: int | None = None) -> Sequence[Any]:
        _, collector = self._collector(column)
        if isinstance(collector, BlockCollector):
            return list(self.numbers(column).values)
        found = np.array(collector.columns[str(column)].cells, dtype=object)
        return list(self._in_order(collector, found).tolist())

    def unit(self, column: ColumnName) -> str | None:
        return self._units.get(self._collector(column)[0])

    def own_time(self, column: ColumnName) -> OwnTime:
        topic, collector = self._collector(column)
        if isinstance(collector, BlockCollector):
            times: Int = self._block_samples(topic, collector).time_ns
        else:
            times = self._in_order(collector, np.array(collector.log_times, dtype=np.int64))
        start = int(times[0]) if times.size else 0
        return OwnTime(np.asarray((times - start) * 1e-9, dtype=np.float64), start)

    def own_frequency(self, column: ColumnName) -> Float | None:
        return None

    @property
    def last_ns(self) -> int:
        """The latest log time of all messages that were taken; 0 where there are none."""
        found = [c.log_times for c in self._collectors.values() if isinstance(c, _FieldCollector)]
        return max((max(times) for times in found if times), default=0)

    def _collector(self, column: ColumnName) -> tuple[str, _FieldCollector | BlockCollector]:
        for topic, names in self._topics.items():
            if column in names and topic in self._collectors:
                return topic, self._collectors[topic]
        raise missing_column(self.names(), column, self._where)

    @staticmethod
    def _in_order(collector: _FieldCollector, rows: NDArray[Any]) -> NDArray[Any]:
        """Rows in the order of the messages' log times."""
        return rows if collector.order is None else rows[collector.order]

    def _block_samples(self, topic: str, collector: BlockCollector) -> Samples:
        if topic not in self._samples:
            self._samples[topic] = collector.samples({})
        return self._samples[topic]
