"""Times as clocks write them: dates and times of day as text, local times through the change from summer time.

Everything here is in nanoseconds of Unix time; `naive` means counted as if the local time were UTC. Which column of
which file is read, and from what, is in `ingest.times`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, date, datetime, time, timedelta, tzinfo
from typing import Any

import numpy as np

from schemas.arrays import Bool, Int

LOST = np.iinfo(np.int64).min
"""Stands for an instant that the file does not tell."""
SECOND = 1_000_000_000
DAY = 86_400 * SECOND
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_BUCKET = 900 * SECOND
"""Offsets of zones from UTC change at whole quarters of an hour."""
_DATES = re.compile(r"%[aAbBdDjmuUVwWxcyYGF]")
_DURATION = re.compile(
    r"(?:(?P<days>\d+)(?:\.(?=\d+:\d+:)|\s*d(?:ays?)?,?\s+))?"
    r"(?:(?P<hours>\d+):)?(?P<minutes>\d+):(?P<seconds>[0-5]?\d(?:[.,]\d*)?)(?P<milliseconds>:\d{3})?"
)
"""`26:15:00.5`, and with days as .NET (`1.02:15:00`), Python (`1 day, 2:15:00`) and pandas (`1 days 02:15:00`) write them, or with
milliseconds behind a colon (`00:00:01:500`)."""


_BELOW_A_MICROSECOND = re.compile(r"(?<=[.,]\d{6})\d{1,3}(?!\d)")
"""What `datetime` does not hold of the seven digits of .NET and the nine of pandas."""
_MONTHS = {
    "January": "januar jänner janvier enero gennaio janeiro januari jan janv ene gen",
    "February": "februar feber février febrero febbraio fevereiro februari feb févr fév fev",
    "March": "märz mars marzo março maart mär mrz mar mrt",
    "April": "april avril abril aprile apr avr abr",
    "May": "mai mayo maggio maio mei may mag",
    "June": "juni juin junio giugno junho jun giu",
    "July": "juli juillet julio luglio julho jul juil lug",
    "August": "august août agosto augustus aug ago",
    "September": "september septembre septiembre settembre setembro sep sept set",
    "October": "oktober octobre octubre ottobre outubro okt oct ott out",
    "November": "november novembre noviembre novembro nov",
    "December": "dezember décembre diciembre dicembre dezembro december dez déc dic dec",
}
"""Months as machines of German, French, Spanish, Italian, Portuguese and Dutch settings write them, in full and cut."""
_MONTH_OF = {word: month for month, words in _MONTHS.items() for word in words.split()}
_WORD = re.compile(r"(?P<word>[^\W\d_]+)\.?")
_HALVES = (("AM", re.compile(r"上午|午前|오전|a\.\s?m\.", re.I)), ("PM", re.compile(r"下午|午後|오후|p\.\s?m\.", re.I)))
"""The two halves of a day in Chinese, Japanese, Korean and Spanish."""


def nanoseconds(moment: datetime) -> int:
    """Unix time of an aware datetime, exact to its microsecond; of a naive one as if it were UTC."""
    aware = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    return (aware - _EPOCH) // timedelta(microseconds=1) * 1000


def has_date(pattern: str) -> bool:
    """Whether a strptime pattern says which day it is."""
    return pattern == "iso" or _DATES.search(pattern) is not None


def moment(cell: Any, pattern: str | None) -> datetime | None:
    """The time that a cell says, None where it is none in that pattern (ISO 8601 where that is None or "iso")."""
    if isinstance(cell, datetime):
        return cell
    if isinstance(cell, date):
        return datetime(cell.year, cell.month, cell.day)
    text = _BELOW_A_MICROSECOND.sub("", str(cell).strip())
    try:
        if pattern is None or pattern == "iso":
            return datetime.fromisoformat(text)
        try:
            return datetime.strptime(text, pattern)
        except ValueError:
            return datetime.strptime(*_in_english(text, pattern))
    except ValueError:
        return None


def _in_english(text: str, pattern: str) -> tuple[str, str]:
    """A time with its words as `strptime` knows them, and the pattern for it: a month that is cut has no dot behind it."""
    if "%p" in pattern:
        for half, words in _HALVES:
            text = words.sub(half, text)
    if "%b" in pattern or "%B" in pattern:
        text = _WORD.sub(_english_month, text)
        pattern = re.sub(r"%[bB]\.?", "%B", pattern)
    return text, pattern


def _english_month(found: re.Match[str]) -> str:
    return _MONTH_OF.get(found["word"].casefold(), found[0])


def moments(cells: Sequence[Any], pattern: str | None) -> tuple[Int, Bool, int | None]:
    """(n,) times of cells, naive where not `zoned`, `LOST` where a cell is empty; and the first row that is no time."""
    times = np.full(len(cells), LOST, dtype=np.int64)
    zoned = np.zeros(len(cells), dtype=bool)
    for row, cell in enumerate(cells):
        found = moment(cell, pattern)
        if found is not None:
            finer = _BELOW_A_MICROSECOND.search(cell) if isinstance(cell, str) else None
            times[row] = nanoseconds(found) + (int(finer[0].ljust(3, "0")) if finer else 0)
            zoned[row] = found.tzinfo is not None
        elif cell is not None and str(cell).strip():
            return times, zoned, row
    return times, zoned, None


def seconds_of_day(cell: Any) -> float | None:
    """Seconds since midnight of a time of day as text or cell, None where it is none."""
    if isinstance(cell, time):
        return 3600.0 * cell.hour + 60.0 * cell.minute + cell.second + 1e-6 * cell.microsecond
    if isinstance(cell, timedelta):
        return cell.total_seconds()
    return duration_s(str(cell))


def duration_s(text: str, *, minutes: bool = False) -> float | None:
    """Seconds of `hh:mm:ss`, or of `mm:ss` where `minutes` says so or decimals show it; None for other text."""
    match = _DURATION.fullmatch(text.strip())
    if match is None:
        return None
    hours, last, thousandths = match["hours"], match["seconds"], match["milliseconds"]
    has_fraction = re.search("[.,]", last) is not None
    if hours is None and (match["days"] or thousandths or not (minutes or has_fraction)):
        return None
    if thousandths and has_fraction:
        return None
    whole = 86_400.0 * int(match["days"] or 0) + 3600.0 * int(hours or 0) + 60.0 * int(match["minutes"])
    return whole + float(last.replace(",", ".")) + int((thousandths or ":0")[1:]) / 1000


def days_of_times(seconds: np.ndarray, started_at: datetime) -> Int:
    """(n,) naive times of day, the first next to `started_at`; each step back of more than half a day is midnight."""
    finite = np.isfinite(seconds)
    known = seconds[finite]
    midnight = nanoseconds(started_at.replace(hour=0, minute=0, second=0, microsecond=0, tzinfo=None))
    local = nanoseconds(started_at.replace(tzinfo=None))
    steps = np.diff(known)
    day = np.concatenate(([0], np.cumsum((steps < -43_200).astype(np.int64) - (steps > 43_200))))
    times = np.full(seconds.size, LOST, dtype=np.int64)
    times[finite] = midnight + day * DAY + np.rint(known * 1e9).astype(np.int64)
    if known.size:
        first = int(times[finite][0])
        times[finite] += DAY * round((local - first) / DAY)
    return times


def utc_of_local(naive: Int, zone: tzinfo, near: int | None = None) -> tuple[Int, bool]:
    """(n,) UTC times of local ones, and whether an hour that occurs twice was told apart by nothing.

    In the hour that occurs twice at the end of summer time the order of the rows says which is meant: from a step back
    on it is the second. Where there is no step, it is the one that leaves no gap to the rows after it, else the one that
    is nearer to `near`, else the first.
    """
    known = naive != LOST
    utc = naive.copy()
    if not known.any():
        return utc, False
    local = naive[known]
    buckets, place = np.unique(local // _BUCKET, return_inverse=True)
    first, second = (np.array([_offset(int(b) * _BUCKET, zone, fold) for b in buckets]) for fold in (0, 1))
    early, late = local - first[place], local - second[place]
    twice = late > early
    chosen = early.copy()
    unsure = False
    for begin, end in _runs(twice):
        back = np.flatnonzero(np.diff(local[begin:end]) < 0)
        if back.size:
            from_here = begin + int(back[0]) + 1
        else:
            gap_early = early[end] - early[end - 1] if end < local.size else None
            if gap_early is not None:
                second_one = gap_early >= 2700 * SECOND and early[end] >= late[end - 1]
            elif begin > 0:
                second_one = False
            elif near is not None:
                second_one = abs(late[begin] - near) < abs(early[begin] - near)
            else:
                second_one, unsure = False, True
            from_here = begin if second_one else end
        chosen[from_here:end] = late[from_here:end]
    utc[known] = chosen
    return utc, unsure


def skipped(naive: Int, zone: tzinfo) -> Bool:
    """(n,) local times that no clock of the zone shows: those of the hour that is left out when summer time begins."""
    buckets, place = np.unique(naive // _BUCKET, return_inverse=True)
    known = [int(b) * _BUCKET for b in buckets]
    jumps = np.array([_offset(b, zone, 0) < _offset(b, zone, 1) for b in known], dtype=bool)
    gone: Bool = jumps[place] & (naive != LOST)
    return gone


def _offset(naive: int, zone: tzinfo, fold: int) -> int:
    moment_ = (_EPOCH + timedelta(microseconds=naive // 1000)).replace(tzinfo=zone, fold=fold)
    offset = moment_.utcoffset()
    return 0 if offset is None else offset // timedelta(microseconds=1) * 1000


def _runs(mask: Bool) -> list[tuple[int, int]]:
    """Begin and end of each run of true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
