"""Instants of samples as int64 nanoseconds of Unix time, from what a foreign file has.

Elapsed time from the recording's start, time since 1970, absolute times as text or Excel dates, a sample rate, or the
file's own time base. Absolute times without a zone are refused unless the mapping gives one. Jitter and gaps stay.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime, timedelta, tzinfo
from typing import Any
from zoneinfo import ZoneInfo

import numpy as np

from ingest.cell_units import check_name, checked_unit, with_own_units
from ingest.clocks import (
    DAY,
    LOST,
    SECOND,
    days_of_times,
    duration_s,
    has_date,
    moment,
    moments,
    nanoseconds,
    seconds_of_day,
    skipped,
    utc_of_local,
)
from ingest.columns import ColumnFile, OwnTime
from ingest.mapping import ELAPSED, MINUTES, ORIGINS, STARTED_AT, ColumnName, TimeMapping, column_label
from ingest.since import is_since, plain_unit_of_time, read_since
from schemas.arrays import Float, Int
from schemas.errors import RefusedError
from schemas.metadata import instant
from schemas.units import conversion

_LATEST_S = 2**62 / 1e9
"""About the year 2116: later times are a wrong unit or a wrong origin."""
_APART_S = 36 * 3600.0
"""A clock that is further from `started_at` than a day and a zone shows another date."""
_EARLIEST_NS = 10 * 365 * DAY
_HALF_HOUR_S = 1800.0
_MINUTE_S = 60.0
TIME_OF_DAY = "time_of_day"


@dataclass(frozen=True)
class Instants:
    """Instants of rows.

    Parameters
    ----------
    time_ns : (n,) Unix time, `LOST` where a row has none
    problems, notes : what is wrong with them, and what is worth knowing
    zone_given : the file's times have no zone of their own
    """

    time_ns: Int
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    zone_given: bool = False


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
) -> Instants:
    """The instants of a time column. Raises `RefusedError` when it cannot be read."""
    reading = _Reading(file, time, column, index, metadata, source, where)
    if time.format is not None or time.date_column is not None:
        return reading.written()
    found = file.unit(column)
    if time.unit is None and not time.is_elapsed and time.origin == STARTED_AT:
        counted = read_since(found, column_label(column, index), where)
        if counted is not None:
            time = replace(time, origin=counted.origin)
            reading = replace(reading, time=time)
    elif is_since(found) and time.unit is not None and not time.is_elapsed and time.origin == STARTED_AT:
        note = f"{column_label(column, index)} is in {found}: as the mapping gives its unit, it counts from started_at"
        reading = replace(reading, notes=(note,))
    found = plain_unit_of_time(found)
    unit = time.unit or found
    origin, is_utc = origin_of(time)
    if unit is None and origin is not None and not is_utc:
        unit = "d"
    if unit is None:
        return reading.guided_by_cells()
    if not time.overrule_unit:
        check_name(column, unit, "s", "time", where=where)
        checked_unit(found, unit, column_label(column, index), "s", "time", where=where)
    return reading.numbers(unit)


@dataclass(frozen=True)
class _Reading:
    """One time column on its way to instants."""

    file: ColumnFile
    time: TimeMapping
    column: ColumnName
    index: int | None
    metadata: Mapping[str, Any]
    source: str
    where: str
    notes: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        return column_label(self.column, self.index)

    def cells(self) -> Sequence[Any]:
        return self.file.cells(self.column, self.index)

    def guided_by_cells(self) -> Instants:
        """Of a column without a unit: its cells say themselves that they are dates, times of day or durations."""
        cells = self.cells()
        first = next((cell for cell in cells if cell is not None and str(cell).strip()), "")
        if isinstance(first, date) or moment(first, None) is not None:
            return self.absolute(cells, None)
        seconds = seconds_of_day(first)
        if seconds is not None and seconds < _MINUTE_S:
            return self.elapsed(cells, None)
        if seconds is not None and self._is_clock(seconds):
            note = f"the times of day are those of started_at: {self.label} begins with {first}"
            return replace(self.time_of_day(cells, None), notes=(note,))
        if seconds is not None:
            raise RefusedError(
                f'time column {self.label} begins with "{str(first)[:40]}", a time of day or a time since the start',
                where=self.source or self.where,
                expected='format = "time_of_day" (with started_at for the date) or format = "elapsed"',
                remedy="Add format to [time] in the mapping TOML",
            )
        raise RefusedError(
            f"time column {self.label} has no unit",
            where=self.source or self.where,
            expected='unit = "s", or format for dates',
            remedy="Add it to [time]",
        )

    def written(self) -> Instants:
        """Of a column whose format the mapping gives."""
        pattern = self.time.format
        cells = self.cells()
        if self.time.date_column is not None:
            days = self.file.cells(self.time.date_column)
            return self.absolute([_joined(d, t) for d, t in zip(days, cells, strict=True)], pattern or "iso")
        if pattern in (ELAPSED, MINUTES):
            return self.elapsed(cells, pattern)
        if pattern == TIME_OF_DAY or not has_date(str(pattern)):
            return self.time_of_day(cells, None if pattern == TIME_OF_DAY else pattern)
        return self.absolute(cells, pattern)

    def numbers(self, unit: str) -> Instants:
        """Of a column of numbers, or of durations that carry their own unit."""
        numbers = self.file.numbers(self.column, self.index)
        if not np.isfinite(numbers.values).any():
            shown = f', such as "{numbers.example}"' if numbers.example else ""
            raise RefusedError(
                f"time column {self.label} holds no numbers{shown}",
                where=self.where,
                expected=f"times in {unit}, or format for dates as text",
            )
        values = with_own_units(numbers, unit, self.label, where=self.where)
        seconds = conversion(unit, "s", where=f"{self.where}: time").apply(values)
        if numbers.units and self._is_clock(float(seconds[np.isfinite(seconds)][0])):
            raise RefusedError(
                f"time column {self.label} begins at the time of day of started_at: it may be a time of day, and a time"
                " since the start as well",
                where=self.source or self.where,
                expected='format = "time_of_day" or format = "elapsed"',
                remedy="Put it in the place of unit in [time] of the mapping TOML",
            )
        origin, is_utc = origin_of(self.time)
        if origin is None:
            times = from_seconds(seconds, start_ns(self.metadata, self.where), self.where)
            return Instants(times, notes=self.notes)
        times = from_seconds(seconds, _part_of_second(self.time.origin), self.where, epoch_s=origin)
        return self.checked(times) if is_utc else self.local(times)

    def absolute(self, cells: Sequence[Any], pattern: str | None) -> Instants:
        """Of dates with times."""
        times, zoned, wrong = moments(cells, pattern)
        if wrong is not None:
            raise RefusedError(
                f'time column {self.label} holds "{str(cells[wrong])[:40]}" in row {wrong + 1} of the data',
                where=self.where,
                expected=f'times written as "{pattern}"' if pattern else "dates with time",
            )
        return self.checked(times) if zoned.any() else self.local(times)

    def elapsed(self, cells: Sequence[Any], pattern: str | None) -> Instants:
        """Of times since the start, as hours, minutes and seconds."""
        short = pattern == MINUTES
        seconds = [
            seconds_of_day(c) if not isinstance(c, str) else duration_s(c, minutes=short) if c.strip() else np.nan
            for c in cells
        ]
        self._check_read(seconds, cells, "mm:ss" if short else "hh:mm:ss")
        return Instants(from_seconds(_floats(seconds), start_ns(self.metadata, self.where), self.where))

    def time_of_day(self, cells: Sequence[Any], pattern: str | None) -> Instants:
        """Of times of day, whose date is that of `started_at`."""
        started = _started(self.metadata)
        if started is None:
            raise RefusedError(
                f"time column {self.label} holds times of day and there is no started_at",
                where=self.where,
                expected="a date for them",
                remedy="Give started_at in [recording], or date_column in [time], in the mapping TOML",
            )
        zone = zone_of(self.time, self.source) or started.tzinfo
        if zone is None:
            raise self._no_zone(cells[0])
        if pattern is None:
            seconds = [np.nan if c is None or c == "" else seconds_of_day(c) for c in cells]
        else:
            found = [moment(c, pattern) for c in cells]
            seconds = [
                (np.nan if c is None or c == "" else None) if m is None else seconds_of_day(m.time())
                for c, m in zip(cells, found, strict=True)
            ]
        self._check_read(seconds, cells, pattern or "hh:mm:ss")
        return self.local(days_of_times(_floats(seconds), started.astimezone(zone)), zone)

    def local(self, naive: Int, zone: tzinfo | None = None) -> Instants:
        """Of local times without a zone of their own."""
        zone = zone or zone_of(self.time, self.source)
        if zone is None:
            raise self._no_zone(next((c for c in self.cells() if c is not None and str(c).strip()), ""))
        started = _started(self.metadata)
        near = None if started is None or started.tzinfo is None else nanoseconds(started)
        times, unsure = utc_of_local(naive, zone, near)
        found = replace(self.checked(times), zone_given=True)
        gone = skipped(naive, zone)
        if gone.any():
            first = np.datetime64(int(naive[np.argmax(gone)]), "ns").astype("datetime64[s]")
            problem = (
                f"time column {self.label}: {int(gone.sum())} times such as {str(first).replace('T', ' ')} do not exist in"
                f" {zone}, whose clocks skip that hour: the zone is another one, or the clock keeps to winter time"
            )
            found = replace(found, problems=(*found.problems, problem))
        if not unsure:
            return found
        note = "the times lie in the hour that occurs twice at the end of summer time: taken for the first"
        return replace(found, notes=(*found.notes, note))

    def checked(self, times: Int) -> Instants:
        """Absolute times against the calendar and `started_at`; see `check_calendar`."""
        return check_calendar(times, f"time column {self.label}", self.metadata, self.where)

    def _no_zone(self, cell: Any) -> RefusedError:
        return RefusedError(
            f'time "{str(cell)[:40]}" of column {self.label} has no zone',
            where=self.where,
            expected="times with a zone",
            remedy='Add zone = "Europe/Zurich" (or UTC, …) to [time] in the mapping TOML',
        )

    def _is_clock(self, seconds: float) -> bool:
        """Whether a time of day is that of `started_at`, to the minute."""
        started = _started(self.metadata)
        if started is None:
            return False
        zone = zone_of(self.time, self.source)
        local = started.astimezone(zone) if zone is not None and started.tzinfo is not None else started
        of_day = 3600 * local.hour + 60 * local.minute + local.second
        return seconds > _MINUTE_S and abs(seconds - of_day) <= _MINUTE_S

    def _check_read(self, seconds: Sequence[float | None], cells: Sequence[Any], expected: str) -> None:
        if None in seconds:
            row = seconds.index(None)
            raise RefusedError(
                f'time column {self.label} holds "{str(cells[row])[:40]}" in row {row + 1} of the data',
                where=self.where,
                expected=f"times written as {expected}",
                remedy="Correct format of [time] in the mapping TOML",
            )


def origin_of(time: TimeMapping) -> tuple[int | None, bool]:
    """Seconds from 1970 that times count from, None for `started_at`; and whether they are UTC."""
    if time.origin == STARTED_AT:
        return None, True
    if time.origin in ORIGINS:
        return ORIGINS[time.origin]
    found = datetime.fromisoformat(time.origin)
    return nanoseconds(found) // SECOND, found.tzinfo is not None


def _part_of_second(origin: str) -> int:
    """Nanoseconds by which a date that times count from is later than its whole second."""
    return 0 if origin in ORIGINS else nanoseconds(datetime.fromisoformat(origin)) % SECOND


def _joined(day: Any, hour: Any) -> Any:
    """Date and time of day of one row; as cells of a spreadsheet or as text."""
    if isinstance(day, date):
        of_day = seconds_of_day(hour)
        return None if of_day is None else datetime(day.year, day.month, day.day) + timedelta(seconds=of_day)
    return f"{day} {hour}".strip()


def _floats(seconds: Sequence[float | None]) -> Float:
    return np.array(seconds, dtype=np.float64)


def _started(metadata: Mapping[str, Any]) -> datetime | None:
    started = metadata.get("started_at")
    if started in (None, ""):
        return None
    try:
        return started if isinstance(started, datetime) else datetime.fromisoformat(str(started).strip())
    except ValueError:
        return None


def own_time(own: OwnTime, metadata: Mapping[str, Any], label: str, where: str, *, elapsed: bool = False) -> Instants:
    """The instants of a time base that the file itself gives.

    Its start is the recording's where it has none, or where `elapsed` says that its own counts for nothing.
    """
    if own.start_ns is None or elapsed:
        return Instants(from_seconds(own.elapsed_s, start_ns(metadata, where), where))
    return check_calendar(
        from_seconds(own.elapsed_s, own.start_ns, where), f"the file's time of {label}", metadata, where
    )


def check_calendar(times: Int, label: str, metadata: Mapping[str, Any], where: str) -> Instants:
    """Absolute times against the calendar and `started_at`: a wrong epoch, another date, a step of half hours.

    Raises `RefusedError` for times that are not since 1980 or lie in the future.
    """
    known = times[times != LOST]
    if not known.size:
        return Instants(times)
    first = int(known[0])
    if not _EARLIEST_NS < first < nanoseconds(datetime.now(UTC)) + 366 * DAY:
        raise RefusedError(
            f"{label} begins in {np.datetime_as_string(np.datetime64(first // SECOND, 's'))}Z",
            where=where,
            expected="a time since 1980 that is not in the future",
            remedy="Check origin, unit, format and zone of [time] in the mapping TOML, and started_at",
        )
    started = _started(metadata)
    if started is None or started.tzinfo is None:
        return Instants(times)
    apart = (first - nanoseconds(started)) * 1e-9
    side = "after" if apart > 0 else "before"
    steps = round(apart / _HALF_HOUR_S)
    if abs(apart) > _APART_S:
        problem = f"{label} begins {abs(apart) / 86_400:.4g} d {side} started_at: one of the two is wrong"
    elif steps and abs(apart - steps * _HALF_HOUR_S) <= _MINUTE_S:
        problem = f"{label} begins {abs(steps) / 2:g} h {side} started_at, as if its zone were another"
    else:
        return Instants(times)
    return Instants(times, problems=(problem,))


def from_seconds(seconds: Float, start: int, where: str, *, epoch_s: int = 0) -> Int:
    """(n,) instants from seconds after `start` (ns) and `epoch_s`; `LOST` where not finite.

    An epoch is added to the whole seconds, so that fractions keep what the doubles hold of them.
    """
    finite = np.isfinite(seconds)
    if finite.any() and np.abs(seconds[finite] + epoch_s).max() + start * 1e-9 > _LATEST_S:
        worst = seconds[finite][np.argmax(np.abs(seconds[finite]))]
        raise RefusedError(
            f"a time is {worst:.6g} s",
            where=where,
            expected="times before the year 2116",
            remedy="Check unit and origin of [time] in the mapping TOML",
        )
    whole = np.floor(np.where(finite, seconds, 0.0))
    rest = np.where(finite, seconds, 0.0) - whole
    times = start + (whole.astype(np.int64) + epoch_s) * 1_000_000_000 + np.rint(rest * 1e9).astype(np.int64)
    return np.where(finite, times, LOST)
