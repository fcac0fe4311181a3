"""From a file of columns and its mapping to a `RawRecording`. The same for every foreign format.

Does not belong here: parsing of formats, conversion to canonical units and validation (`ingest.canonical`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ingest.columns import ColumnFile, Numbers
from ingest.mapping import ColumnMapping, FileMapping, TimeMapping
from ingest.times import LOST, own_time, start_ns, time_column, uniform, with_zone, zone_of
from schemas.arrays import Float, Int
from schemas.errors import RefusedError
from schemas.quantities import QUANTITIES
from schemas.recording import RawChannel, RawRecording
from schemas.units import ANY, Conversion, conversion

_BRACKETS = ("[]", "()", "{}", "<>")


@dataclass
class _Assembly:
    """What one file's channels share: the time columns already read, problems and notes found so far."""

    file: ColumnFile
    mapping: FileMapping
    where: str
    metadata: dict[str, object]
    times: dict[object, Int] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def assemble(file: ColumnFile, mapping: FileMapping, *, where: str) -> RawRecording:
    """The raw recording: mapped columns scaled into the mapping's units, each with its instants.

    Cells that hold no number become NaN; a column without any is refused. Raises `RefusedError`.
    """
    zone = zone_of(mapping.time, mapping.source)
    shared = _Assembly(file, mapping, where, with_zone(mapping.recording, zone))
    channels = tuple(_channel(quantity, column, shared) for quantity, column in mapping.columns.items())
    if "started_at" not in shared.metadata and channels:
        first = min(int(c.time_ns[0]) for c in channels if c.time_ns.size)
        shared.metadata["started_at"] = np.datetime_as_string(np.datetime64(first // 1000, "us"), timezone="UTC")
    return RawRecording(
        metadata=shared.metadata,
        rig=mapping.rig,
        channels=channels,
        problems=(*file.problems, *dict.fromkeys(shared.problems)),
        notes=(*file.notes, *dict.fromkeys(shared.notes)),
    )


def scaled_numbers(file: ColumnFile, column: ColumnMapping, name: str, *, where: str) -> Numbers:
    """A mapped column with scale and offset applied. Raises `RefusedError` when none of its cells is a number."""
    if column.column is None:
        raise RefusedError(f"{name} has no column", where=where, expected="a column of the file")
    numbers = file.numbers(column.column, column.index)
    if numbers.texts and not np.isfinite(numbers.values).any():
        raise RefusedError(
            f'column {column.label} for {name} holds no numbers, such as "{numbers.example}"',
            where=where,
            expected="numbers",
            remedy="Check column, decimal, header and unit_row in the mapping TOML",
        )
    values = numbers.values
    if not (math.isfinite(column.scale) and math.isfinite(column.offset)) or column.scale == 0:
        raise RefusedError(
            f"columns.{name}: scale {column.scale}, offset {column.offset}", where=where, expected="a scale but 0"
        )
    values = Conversion(column.scale, column.offset).apply(values)
    return Numbers(values, numbers.empty, numbers.texts, numbers.example)


def unit_of(file: ColumnFile, column: ColumnMapping, name: str, canonical: str, *, where: str) -> str:
    """The unit of a mapped column: the mapping's, else the file's own.

    Raises `RefusedError` when there is none, or when the file's own unit says something else than the mapping. A column
    that the mapping scales is not compared: raw volts may stand where newtons come out.
    """
    own = None if column.column is None else _plain_unit(file.unit(column.column))
    if column.unit is None:
        if not own:
            raise RefusedError(
                f"columns.{name} has no unit",
                where=where,
                expected="the unit of its values",
                remedy=f"Add unit to [columns.{name}] in the mapping TOML",
            )
        return own
    if not own or column.scale != 1.0 or column.offset != 0.0 or canonical == ANY:
        return column.unit
    said = conversion(column.unit, canonical, where=f"{where}: {name}")
    try:
        found = conversion(own, canonical)
    except RefusedError:
        same = False
    else:
        same = math.isclose(found.scale, said.scale, rel_tol=1e-9) and math.isclose(
            found.offset, said.offset, rel_tol=1e-9, abs_tol=1e-12
        )
    if not same:
        raise RefusedError(
            f'the unit row says "{own}" for column {column.label}, the mapping says "{column.unit}" for {name}',
            where=where,
            expected="the same unit in both",
            remedy="Correct unit in the mapping TOML, or leave it out to take the file's own",
        )
    return column.unit


def _plain_unit(text: str | None) -> str | None:
    """A unit without the brackets that exporters put around it."""
    text = (text or "").strip()
    while len(text) > 1 and text[0] + text[-1] in _BRACKETS:
        text = text[1:-1].strip()
    return text or None


def _channel(quantity: str, column: ColumnMapping, shared: _Assembly) -> RawChannel:
    where = shared.where
    numbers = scaled_numbers(shared.file, column, quantity, where=where)
    unit = unit_of(shared.file, column, quantity, QUANTITIES[quantity].unit, where=where)
    values = numbers.values
    times = _times(column, values.size, shared)
    if times.size != values.size:
        raise RefusedError(
            f"{quantity} has {values.size} values but {times.size} times",
            where=where,
            expected="a time for each value",
            remedy="Give the channel its own time column: time in its table of the mapping TOML",
        )
    if numbers.texts:
        shared.problems.append(f'{quantity}: {numbers.texts} cells hold no number, such as "{numbers.example}"')
    times, values = _with_time(times, values, numbers, column, shared)
    return RawChannel(quantity, unit, times, values, column.metadata)


def _with_time(
    times: Int, values: Float, numbers: Numbers, column: ColumnMapping, shared: _Assembly
) -> tuple[Int, Float]:
    """Rows that have a time, and for a sparse column those that have a cell."""
    keep = times != LOST
    lost = int(keep.size - keep.sum())
    if lost == keep.size:
        raise RefusedError("no row has a time", where=shared.where, expected="times in the time column")
    if lost:
        shared.problems.append(f"{lost} of {keep.size} rows have no time: left out")
    if column.sparse:
        keep = keep & ~numbers.empty
    return (times, values) if keep.all() else (times[keep], values[keep])


def _times(column: ColumnMapping, count: int, shared: _Assembly) -> Int:
    time = shared.mapping.time
    own = None
    if column.time is None and (time is None or (time.column is None and time.sample_rate_hz is None)):
        own = None if column.column is None else shared.file.own_time(column.column)
        if own is None:
            raise RefusedError(
                "the mapping has no time",
                where=shared.mapping.source or shared.where,
                expected="[time] with column or sample_rate_hz",
                remedy="Add it to the mapping TOML",
            )
        return own_time(own, shared.metadata, shared.where)
    time = time or TimeMapping(unit="s")
    if column.time is None and time.sample_rate_hz is not None:
        key: object = count
        if key not in shared.times:
            start = start_ns(shared.metadata, shared.where)
            shared.times[key] = uniform(count, time.sample_rate_hz, start)
        return shared.times[key]
    source, index = (column.time, None) if column.time is not None else (time.column, time.index)
    key = (source, index)
    if key not in shared.times:
        if source is None:
            raise RefusedError("the time has no column", where=shared.where, expected="[time] with column")
        shared.times[key] = time_column(
            shared.file, time, source, index, shared.metadata, source=shared.mapping.source, where=shared.where
        )
    return shared.times[key]
