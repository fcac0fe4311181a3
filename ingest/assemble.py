"""From a file of columns and its mapping to a `RawRecording`. The same for every foreign format.

Does not belong here: parsing of formats, conversion to canonical units and validation (`ingest.canonical`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from datetime import datetime

import numpy as np

from ingest.cell_units import Resolved, check_name, checked_unit, plain_unit, resolved
from ingest.clocks import LOST
from ingest.columns import ColumnFile, Numbers
from ingest.mapping import ColumnMapping, FileMapping, TimeMapping
from ingest.select import SelectedRows, selected_rows
from ingest.times import own_time, start_ns, time_column, uniform, with_zone, zone_of
from schemas.arrays import Bool, Float, Int
from schemas.assumptions import Assumption
from schemas.errors import RefusedError
from schemas.metadata import RecordingMetadata, RigConstants, check_keys
from schemas.quantities import QUANTITIES
from schemas.recording import RawChannel, RawRecording
from schemas.units import ANY, Conversion

_ZONE = "time zone"
"""What the assumption is called that times without a zone have that of the mapping."""


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
    assumptions: list[Assumption] = field(default_factory=list)
    no_sample: list[tuple[Bool, Bool]] = field(default_factory=list)
    """Of each channel: rows without a number, and those of them that hold a text."""


def assemble(file: ColumnFile, mapping: FileMapping, *, where: str) -> RawRecording:
    """The raw recording: mapped columns scaled into the mapping's units, each with its instants.

    Cells that hold no number become NaN; a column without any is refused. Raises `RefusedError`.
    """
    zone = zone_of(mapping.time, mapping.source)
    check_keys(mapping.recording, RecordingMetadata, "recording", mapping.source)
    check_keys(mapping.rig, RigConstants, "rig", mapping.source)
    file = _selected(file, mapping, where)
    shared = _Assembly(file, mapping, where, with_zone(mapping.recording, zone))
    started = shared.metadata.get("started_at")
    if zone is not None and isinstance(started, datetime) and started.tzinfo is zone:
        shared.assumptions.append(_assume_zone(mapping))
    channels = tuple(_channel(quantity, column, shared) for quantity, column in mapping.columns.items())
    has_column = mapping.time is not None and mapping.time.column is not None
    if zone is not None and has_column and not any(one.what == _ZONE for one in shared.assumptions):
        shared.notes.append(
            "zone of [time] has no effect here: neither started_at nor a time in the file lacks its own"
        )
    if mapping.counts_rows_as_time:
        channels = _without_summary(channels, shared)
    if "started_at" not in shared.metadata and channels:
        shared.assumptions.append(
            Assumption("start of the recording", "its first sample", "no started_at", "the order of the recordings")
        )
        first = min(int(c.time_ns[0]) for c in channels if c.time_ns.size)
        shared.metadata["started_at"] = np.datetime_as_string(np.datetime64(first // 1000, "us"), timezone="UTC")
    elif mapping.is_part and channels:
        shared.metadata["started_at"] = _start_of_part(channels, shared)
    return RawRecording(
        metadata=shared.metadata,
        rig=mapping.rig,
        channels=channels,
        problems=(*file.problems, *dict.fromkeys(shared.problems)),
        notes=(*file.notes, *dict.fromkeys(shared.notes)),
        assumptions=tuple(dict.fromkeys(shared.assumptions)),
    )


def _start_of_part(channels: tuple[RawChannel, ...], shared: _Assembly) -> object:
    """When a part of a longer record began: with its first sample, where that comes after what is stated for the whole."""
    stated = start_ns(shared.metadata, shared.where)
    first = min((int(c.time_ns[0]) for c in channels if c.time_ns.size), default=stated)
    if first <= stated:
        return shared.metadata["started_at"]
    return np.datetime_as_string(np.datetime64(first // 1000, "us"), timezone="UTC")


def _assume_zone(mapping: FileMapping) -> Assumption:
    """The zone that the mapping gives to times without one."""
    zone = (mapping.time.zone if mapping.time is not None else None) or "that of started_at"
    return Assumption(
        _ZONE,
        zone,
        "the times in the file have none; the mapping gives it",
        "started_at and the order of recordings",
    )


def _selected(file: ColumnFile, mapping: FileMapping, where: str) -> ColumnFile:
    """The file, or its selected rows."""
    first = next((c for c in mapping.columns.values() if c.column is not None), None)
    if not mapping.select or first is None or first.column is None:
        return file
    count = len(file.cells(first.column, first.index))
    return SelectedRows(file, selected_rows(file, mapping.select, count, where))


def _without_summary(channels: tuple[RawChannel, ...], shared: _Assembly) -> tuple[RawChannel, ...]:
    """The channels without rows at the end that hold words and no number: no samples, though they would count."""
    sizes = {nothing.size for nothing, _ in shared.no_sample}
    if len(sizes) != 1:
        return channels
    nothing = np.logical_and.reduce([n for n, _ in shared.no_sample])
    words = np.logical_or.reduce([w for _, w in shared.no_sample])
    last = int(np.flatnonzero(~nothing)[-1]) + 1 if not nothing.all() else nothing.size
    if last == nothing.size or not words[last:].any():
        return channels
    shared.problems.append(f"the last {nothing.size - last} rows hold no number: a summary? They are left out")
    end = max(int(c.time_ns[-1]) for c in channels if c.time_ns.size)
    step = 1e9 / shared.mapping.time.sample_rate_hz if shared.mapping.time and shared.mapping.time.sample_rate_hz else 0
    until = end - round((nothing.size - last - 0.5) * step)
    return tuple(replace(c, time_ns=c.time_ns[c.time_ns < until], values=c.values[c.time_ns < until]) for c in channels)


def scaled_numbers(
    file: ColumnFile, column: ColumnMapping, name: str, unit: str, *, where: str, few_are_damage: bool = True
) -> Resolved:
    """A mapped column in `unit`, scale and offset applied. Raises `RefusedError` when none of its cells is a number."""
    if column.column is None:
        raise RefusedError(f"{name} has no column", where=where, expected="a column of the file")
    scaled = column.scale != 1.0 or column.offset != 0.0
    found = resolved(
        file.numbers(column.column, column.index),
        unit,
        column.label,
        name,
        where=where,
        few_are_damage=few_are_damage,
        scaled=scaled,
    )
    numbers = found.numbers
    if numbers.texts and not np.isfinite(numbers.values).any():
        raise RefusedError(
            f'column {column.label} for {name} holds no numbers, such as "{numbers.example}"',
            where=where,
            expected="numbers",
            remedy="Check column, decimal, header and unit_row in the mapping TOML",
        )
    if not (math.isfinite(column.scale) and math.isfinite(column.offset)) or column.scale == 0:
        raise RefusedError(
            f"columns.{name}: scale {column.scale}, offset {column.offset}", where=where, expected="a scale but 0"
        )
    _check_scaled_once(numbers, column, name, where)
    values = Conversion(column.scale, column.offset).apply(numbers.values)
    return replace(found, numbers=replace(numbers, values=values))


def _check_scaled_once(numbers: Numbers, column: ColumnMapping, name: str, where: str) -> None:
    """Refuses a mapping that does what the file has asked for already, and numbers that may have a scale nobody knows."""
    if numbers.doubtful and not column.says_scale:
        raise RefusedError(
            f"column {column.label} for {name} holds whole numbers beside {', '.join(numbers.doubtful)}, which may be"
            " their scale",
            where=where,
            expected="scale and offset in the mapping (scale = 1 where the numbers stand as they are meant)",
            remedy=f"Add scale to [columns.{name}] in the mapping TOML",
        )
    own = numbers.unpacked
    if own is not None and column.scale != 1.0 and math.isclose(column.scale, own.scale, rel_tol=1e-6):
        raise RefusedError(
            f"columns.{name}: scale {column.scale:g} is that of the file itself, which is applied already",
            where=where,
            expected="a scale beside the file's own, or none",
            remedy=f"Take scale and offset out of [columns.{name}] in the mapping TOML",
        )


def unit_of(file: ColumnFile, column: ColumnMapping, name: str, canonical: str, *, where: str) -> str:
    """The unit of a mapped column: the mapping's, else the file's own.

    Raises `RefusedError` when there is none, or when the file's own unit says something else than the mapping. A column
    that the mapping scales is not compared: raw volts may stand where newtons come out.
    """
    own = None if column.column is None else plain_unit(file.unit(column.column))
    if column.unit is None:
        if not own:
            raise RefusedError(
                f"columns.{name} has no unit",
                where=where,
                expected="the unit of its values",
                remedy=f"Add unit to [columns.{name}] in the mapping TOML",
            )
        return own
    if column.overrule_unit or column.scale != 1.0 or column.offset != 0.0 or canonical == ANY:
        return column.unit
    check_name(column.column, column.unit, canonical, name, where=where)
    return checked_unit(own, column.unit, column.label, canonical, name, where=where)


def _channel(quantity: str, column: ColumnMapping, shared: _Assembly) -> RawChannel:
    where = shared.where
    unit = unit_of(shared.file, column, quantity, QUANTITIES[quantity].unit, where=where)
    found = scaled_numbers(shared.file, column, quantity, unit, where=where)
    shared.notes += found.notes
    numbers = found.numbers
    lost = ~np.isfinite(numbers.values)
    shared.no_sample.append((lost, lost & ~numbers.empty))
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
        elapsed = time is not None and time.is_elapsed
        found = own_time(own, shared.metadata, column.label, shared.where, elapsed=elapsed)
        shared.problems += found.problems
        shared.notes += found.notes
        return found.time_ns
    time = time or TimeMapping(unit="s")
    if column.time is None and time.sample_rate_hz is not None:
        key: object = count
        if key not in shared.times:
            start = start_ns(shared.metadata, shared.where)
            shared.times[key] = uniform(count, time.sample_rate_hz, start)
            shared.assumptions.append(
                Assumption(
                    "times of the samples",
                    f"one every 1/{time.sample_rate_hz:g} s, no row missing",
                    "the mapping gives a sample rate and no time column",
                    "frequencies, relaxation times, lives",
                )
            )
        return shared.times[key]
    source, index = (column.time, None) if column.time is not None else (time.column, time.index)
    key = (source, index)
    if key not in shared.times:
        if source is None:
            raise RefusedError("the time has no column", where=shared.where, expected="[time] with column")
        found = time_column(
            shared.file, time, source, index, shared.metadata, source=shared.mapping.source, where=shared.where
        )
        shared.problems += found.problems
        shared.notes += found.notes
        if found.zone_given:
            shared.assumptions.append(_assume_zone(shared.mapping))
        shared.times[key] = found.time_ns
    return shared.times[key]
