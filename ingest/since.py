"""Units of time that count from a date, as netCDF files write them: `seconds since 2026-03-01 14:00:00`.

CF conventions, section 4.4; the words and the ways to write a date are those of UDUNITS. Seconds are the same in every calendar, dates
are not: in `noleap` the 1 March follows the 28 February in all years, so what counts from a date there is another instant.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone

from schemas.errors import RefusedError

_UNIT = re.compile(
    r"\s*(?P<unit>[^\W\d_]\w*)\s+(?:since|after|from|ref|@)\s+(?P<since>[-+]?\d.*?)\s*(?:, calendar (?P<calendar>.+))?",
    re.I,
)
_DATE = re.compile(
    r"(?P<year>\d{1,4})-(?P<month>\d{1,2})-(?P<day>\d{1,2})"
    r"(?:[T\s]+(?P<hour>\d{1,2})(?::(?P<minute>\d{1,2})(?::(?P<second>\d{1,2})(?P<fraction>\.\d*)?)?)?)?"
    r"\s*(?P<zone>UTC|GMT|Z|(?P<sign>[-+])(?P<zone_hour>\d{1,2})(?::?(?P<zone_minute>\d{2}))?)?",
    re.I,
)
_ORDINARY = ("standard", "gregorian", "proleptic_gregorian")
_PROLEPTIC = "proleptic_gregorian"
_REFORM = (1582, 10, 15)
"""From this day on the calendars `standard` and `proleptic_gregorian` are the same; before, they are days apart."""
_UNEQUAL = re.compile(r"(?:common_)?(?:mon|month|yr|year|a|annum|decade|century)s?", re.I)


@dataclass(frozen=True)
class Since:
    """Times in a unit from an instant on: text in ISO 8601 with its zone."""

    unit: str
    origin: str


def with_calendar(unit: str, calendar: str | None) -> str:
    """A unit of times since a date with the name of another calendar behind it; any other unit as it is."""
    is_other = calendar is not None and calendar.strip().casefold() not in _ORDINARY[:2]
    return f"{unit}, calendar {calendar}" if is_other and is_since(unit) else unit


def is_since(unit: str | None) -> bool:
    """Whether a unit is one of times that count from a date."""
    return _UNIT.fullmatch(unit or "") is not None


def plain_unit_of_time(text: str | None) -> str | None:
    """The unit alone of times that count from a date; any other unit as it is."""
    found = _UNIT.fullmatch(text or "")
    return text if found is None else found["unit"]


def read_since(text: str | None, label: str, where: str) -> Since | None:
    """Unit and first instant of times that count from a date, UTC where it has no zone; None where the unit is no such one.

    Raises `RefusedError` for a date that is none, for months and years, which have not all one length, and for other calendars.
    """
    found = _UNIT.fullmatch(text or "")
    if found is None:
        return None
    calendar = (found["calendar"] or _ORDINARY[0]).strip().casefold()
    remedy = 'Give unit and origin in [time] of the mapping TOML, origin = "started_at" for the start of the test'
    if calendar not in _ORDINARY:
        raise RefusedError(
            f'the times of {label} count from a date of the calendar "{calendar[:40]}"',
            where=where,
            expected="the calendar of everyday (standard, gregorian or proleptic_gregorian)",
            remedy=remedy,
        )
    if _UNEQUAL.fullmatch(found["unit"]):
        raise RefusedError(
            f"the times of {label} are in {found['unit']}, which are not all of one length",
            where=where,
            expected="seconds, minutes, hours or days",
            remedy=remedy,
        )
    day = _DATE.fullmatch(found["since"])
    origin = None if day is None else _instant(day)
    if day is None or origin is None:
        raise RefusedError(
            f'the times of {label} count from "{found["since"][:40]}"', where=where, expected="a date", remedy=remedy
        )
    if calendar != _PROLEPTIC and (int(day["year"]), int(day["month"]), int(day["day"])) < _REFORM:
        raise RefusedError(
            f"the times of {label} count from {found['since'][:40]}, before the calendar was reformed in 1582: programs"
            " differ by days in what they mean",
            where=where,
            expected="a date from 15 October 1582 on, or the calendar proleptic_gregorian",
            remedy=remedy,
        )
    return Since(found["unit"], origin.isoformat())


def _instant(found: re.Match[str]) -> datetime | None:
    """The instant of a written date; None where it is none, such as a 13th month."""
    offset = timedelta(hours=int(found["zone_hour"] or 0), minutes=int(found["zone_minute"] or 0))
    year, month, day, hour, minute, second = (
        int(found[part] or 0) for part in ("year", "month", "day", "hour", "minute", "second")
    )
    try:
        zone = timezone(-offset if found["sign"] == "-" else offset)
        whole = datetime(year, month, day, hour, minute, second, tzinfo=zone)
    except ValueError:
        return None
    return whole + timedelta(seconds=float("0" + (found["fraction"] or ".0")))
