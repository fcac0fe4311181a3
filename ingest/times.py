"""Instants of samples as int64 nanoseconds of Unix time, from what a foreign file has.

Elapsed time from the recording's start, time since 1970, absolute times as text or Excel dates, a sample rate, or the
file's own time base. Absolute times without a zone are refused unless the mapping gives one. Jitter and gaps stay.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta, tzinfo
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np

from ingest.columns import ColumnFile, OwnTime
from ingest.mapping import ColumnName, TimeMapping, column_label
from schemas.arrays import Float, Int
from schemas.errors import RefusedError
from schemas.metadata import instant
from schemas.units import conversion

LOST = np.iinfo(np.int64).min
"""Stands for an instant that the file does not tell."""
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LATEST_S = 2**62 / 1e9
"""About the year 2116: later times are a wrong unit or a wrong origin."""


def zone_of(time: TimeMapping | None, where: str) -> tzinfo | None:
    """The zone that a mapping gives to times without one. `RefusedError` when there is no such zone."""
    if time is None or time.zone is None:
        return None
    try:
        return ZoneInfo(time.zone)
    except (KeyError, ValueError, OSError):
        raise RefusedError(
            f'time.zone is "{time.zone[:80]}"',
            where=where,
            expected="a zone such as Europe/Zurich or UTC",
            remedy="Correct the mapping TOML",
        ) from None


def with_zone(metadata: Mapping[str, Any], zone: tzinfo | None) -> dict[str, Any]:
    """The metadata with the zone added to a `started_at` that has none; other values as they are."""
    started = metadata.get("started_at")
    if zone is None or started is None:
        return dict(metadata)
    try:
        time = started if isinstance(started, datetime) else datetime.fromisoformat(str(started).strip())
    except ValueError:
        return dict(metadata)
    return {**metadata, "started_at": time.replace(tzinfo=zone) if time.tzinfo is None else time}


def start_ns(metadata: Mapping[str, Any], where: str) -> int:
    """`started_at` in nanoseconds. `RefusedError` when it is missing, malformed or without zone."""
    if metadata.get("started_at") in (None, ""):
        raise RefusedError(
            "required key started_at is missing: elapsed times cannot become instants",
            where=where,
            expected="an ISO 8601 time with zone",
            remedy="Add started_at to [recording] in the mapping TOML",
        )
    try:
        return nanoseconds(instant(metadata["started_at"]))
    except ValueError as error:
        raise RefusedError(
            f'started_at is "{str(metadata["started_at"])[:80]}"', where=where, expected=str(error)
        ) from None


def nanoseconds(time: datetime) -> int:
    """Unix time of an aware datetime, exact to its microsecond."""
    return (time - _EPOCH) // timedelta(microseconds=1) * 1000


def uniform(count: int, rate_hz: float, start: int) -> Int:
    """(count,) instants of a constant sample rate, each rounded to its own nanosecond."""
    elapsed: Int = np.rint(np.arange(count) * (1e9 / rate_hz)).astype(np.int64)
    return elapsed + start


def time_column(
    file: ColumnFile,
    time: TimeMapping,
    column: ColumnName,
    index: int | None,
    metadata: Mapping[str, Any],
    *,
    source: str,
    where: str,
) -> Int:
    """(n,) instants of a time column; `LOST` where a row has none. Raises `RefusedError` when it cannot be read."""
    if time.format is not None:
        return _absolute(file.cells(column, index), time, column, source, where)
    found = file.unit(column)
    unit = time.unit or found
    if unit is None:
        cells = file.cells(column, index)
        if any(isinstance(cell, datetime) for cell in cells[:10]):
            return _absolute(cells, time, column, source, where)
        raise RefusedError(
            "time has no unit", where=source, expected='unit = "s", or format for dates', remedy="Add it to [time]"
        )
    numbers = file.numbers(column, index)
    if not np.isfinite(numbers.values).any():
        shown = f', such as "{numbers.example}"' if numbers.example else ""
        raise RefusedError(
            f"time column {column_label(column, index)} holds no numbers{shown}",
            where=where,
            expected=f"times in {unit}, or format for dates as text",
        )
    seconds = conversion(unit, "s", where=f"{where}: time").apply(numbers.values)
    start = 0 if time.origin == "unix" else start_ns(metadata, where)
    return from_seconds(seconds, start, where)


def own_time(own: OwnTime, metadata: Mapping[str, Any], where: str) -> Int:
    """(n,) instants of a time base that the file itself gives; its start is the recording's where it has none."""
    start = own.start_ns if own.start_ns is not None else start_ns(metadata, where)
    return from_seconds(own.elapsed_s, start, where)


def from_seconds(seconds: Float, start: int, where: str) -> Int:
    """(n,) instants from seconds after `start` (ns); `LOST` where not finite."""
    finite = np.isfinite(seconds)
    if finite.any() and np.abs(seconds[finite]).max() + start * 1e-9 > _LATEST_S:
        worst = seconds[finite][np.argmax(np.abs(seconds[finite]))]
        raise RefusedError(
            f"a time is {worst:.6g} s",
            where=where,
            expected="times before the year 2116",
            remedy="Check unit and origin of [time] in the mapping TOML",
        )
    whole = np.floor(np.where(finite, seconds, 0.0))
    rest = np.where(finite, seconds, 0.0) - whole
    times = start + whole.astype(np.int64) * 1_000_000_000 + np.rint(rest * 1e9).astype(np.int64)
    return np.where(finite, times, LOST)


def _absolute(cells: Sequence[Any], time: TimeMapping, column: ColumnName, source: str, where: str) -> Int:
    zone = zone_of(time, source)
    times = np.empty(len(cells), dtype=np.int64)
    for row, cell in enumerate(cells):
        found = _moment(cell, time.format)
        if found is None:
            if str(cell).strip():
                raise RefusedError(
                    f'time column {column_label(column)} holds "{str(cell)[:40]}" in row {row + 1} of the data',
                    where=where,
                    expected=f'times written as "{time.format}"' if time.format else "dates with time",
                )
            times[row] = LOST
            continue
        if found.tzinfo is None:
            if zone is None:
                raise RefusedError(
                    f'time "{str(cell)[:40]}" has no zone',
                    where=where,
                    expected="times with a zone",
                    remedy='Add zone = "Europe/Zurich" (or UTC, …) to [time] in the mapping TOML',
                )
            found = found.replace(tzinfo=zone)
        times[row] = nanoseconds(found)
    return times


def _moment(cell: Any, pattern: str | None) -> datetime | None:
    if isinstance(cell, datetime):
        return cell
    try:
        text = str(cell).strip()
        return datetime.fromisoformat(text) if pattern in (None, "iso") else datetime.strptime(text, str(pattern))
    except ValueError:
        return None
