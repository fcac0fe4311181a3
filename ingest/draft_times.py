"""How the times of a file without a mapping are to be read: samples a second, a column of seconds, clock times and their origin."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date, datetime
from typing import Any

from ingest.clocks import duration_s, moment
from ingest.draft_files import Opened
from ingest.meanings import TIME, GuessedColumn
from ingest.questions import Question, ask_unit

_DAYS = (
    *("%d.%m.%Y", "%Y/%m/%d", "%m/%d/%Y", "%d/%m/%Y", "%d-%b-%Y", "%Y-%m-%d", "%Y.%m.%d", "%d-%m-%Y"),
    *("%d.%m.%y", "%m/%d/%y", "%d/%m/%y", "%y/%m/%d", "%d-%b-%y"),
)
_HOURS = ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M:%S:%f", "%H:%M:%S,%f", "%H:%M", "%I:%M:%S %p", "%I:%M %p")
_CLOCK = re.compile(r"\d{1,2}:\d\d(:\d\d([.,:]\d+)?)?( [AaPp]\.?[Mm]\.?)?")


def make_time_keys(time: GuessedColumn, opened: Opened, questions: list[Question]) -> dict[str, Any]:
    """Unit of a column of times, or how its dates are written."""
    cells = [c for c in opened.cells(time) if str(c).strip()]
    first = cells[0] if cells else ""
    if not isinstance(first, float | int):
        keys = _with_date_column(time, opened) or _text_times(cells)
        if keys is not None:
            if (other := find_other_order(cells, str(keys.get("format", "")))) is not None:
                keys["format"] = prefer_order(keys["format"], other, opened)
                questions.append(ask_order("time.format", cells[0], keys["format"]))
            if keys.get("format") not in ("elapsed", "mm:ss") and not _has_zone(first):
                keys["zone"] = "UTC"
                questions.append(Question("time.zone", "time zone of the clock", "UTC"))
            return keys
    origin = _origin(first, opened)
    if origin is not None:
        if origin.get("origin") in ("excel", "matlab"):
            origin["zone"] = "UTC"
            questions.append(Question("time.zone", "time zone of the clock", "UTC"))
        return origin
    unit = time.unit or {"micros": "us", "millis": "ms"}.get(str(time.column).lower())
    if unit is None:
        questions.append(ask_unit("time", time, "s"))
    return {"unit": unit or "s"}


def _with_date_column(time: GuessedColumn, opened: Opened) -> dict[str, Any] | None:
    """The keys of a date in one column and a time of day in another, whichever of the two was taken for the time."""
    for other in opened.columns:
        if other is time or other.meaning not in (None, TIME):
            continue
        for day, clock in ((other, time), (time, other)):
            pairs = list(zip(_filled(day, opened), _filled(clock, opened), strict=False))
            if not pairs or not all(_CLOCK.fullmatch(c) for _, c in pairs):
                continue
            for pattern in _DAYS:
                for hours in _HOURS:
                    if all(moment(f"{d} {c}", f"{pattern} {hours}") is not None for d, c in pairs):
                        place = {"column": clock.column, "date_column": day.column}
                        return place | {"format": f"{pattern} {hours}"}
    return None


def _filled(column: GuessedColumn, opened: Opened) -> list[str]:
    return [str(cell).strip() for cell in opened.cells(column) if str(cell).strip()]


def _text_times(cells: Sequence[Any]) -> dict[str, Any] | None:
    """The format of times as text; None where they are none."""
    texts = [str(c).strip() for c in cells]
    if moment(cells[0], None) is not None if cells else False:
        return {"format": "iso"}
    for day in _DAYS:
        for clock in _HOURS:
            if texts and all(moment(text, f"{day} {clock}") is not None for text in texts):
                return {"format": f"{day} {clock}"}
    if texts and re.fullmatch(r"\d{1,2}:\d\d:\d\d([.,]\d+)?", texts[0]):
        return {"format": "time_of_day" if not texts[0].startswith(("0:", "00:")) else "elapsed"}
    if texts and duration_s(texts[0], minutes=True) is not None and ":" in texts[0]:
        return {"format": "mm:ss"}
    return None


def find_other_order(cells: Sequence[Any], pattern: str) -> str | None:
    """The pattern with day and month in the other order where all cells fit it as well; None where they do not."""
    if not pattern.startswith(("%m/%d", "%d/%m")):
        return None
    other = ("%d/%m" if pattern.startswith("%m") else "%m/%d") + pattern[5:]
    filled = [str(c).strip() for c in cells if str(c).strip()]
    fits = all(moment(text, other) is not None for text in filled)
    return other if fits and any(moment(t, other) != moment(t, pattern) for t in filled) else None


def prefer_order(pattern: str, other: str, opened: Opened) -> str:
    """Of two orders of day and month the one that goes with the file's decimal mark: who writes a comma writes the day first."""
    first = "%d" if opened.options.get("decimal") == "," else "%m"
    return pattern if pattern.startswith(first) else other


def ask_order(key: str, cell: Any, pattern: str) -> Question:
    """The question in which order the day and the month of dates stand that nothing tells."""
    return Question(key, f'whether day or month comes first in "{cell}" (%d the day, %m the month)', pattern)


def find_date_format(cells: Sequence[Any]) -> str | None:
    """The pattern of cells that are all dates, with their time of day or without; None where they are none, or there are none."""
    filled = [c for c in cells if str(c).strip()]
    if not filled or not all(isinstance(c, datetime | date) or re.search(r"\d[-./ ]", str(c)) for c in filled):
        return None
    if all(moment(c, None) is not None for c in filled):
        return "iso"
    found = _text_times(filled) or {}
    pattern = str(found.get("format", ""))
    return pattern if "%d" in pattern and "%y" in pattern.lower() else None


def _has_zone(cell: Any) -> bool:
    found = moment(cell, None)
    return found is not None and found.tzinfo is not None


def _origin(first: Any, opened: Opened) -> dict[str, Any] | None:
    """The origin of times that are counted from a calendar's day, by their size; None for times since the start."""
    try:
        value = float(str(first).replace(opened.options.get("decimal", "."), "."))
    except ValueError:
        return None
    for low, high, keys in (
        (1e12, 4e12, {"unit": "ms", "origin": "unix"}),
        (1e9, 2.5e9, {"unit": "s", "origin": "unix"}),
        (3e9, 4.2e9, {"unit": "s", "origin": "labview"}),
        (7.2e5, 7.6e5, {"origin": "matlab"}),
        (3.6e4, 6e4, {"origin": "excel"}),
    ):
        if low < value < high and not (keys.get("origin") == "excel" and value.is_integer()):
            return dict(keys)
    return None
