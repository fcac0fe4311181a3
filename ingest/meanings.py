"""What a column seems to mean, by its name and unit. Guesses for drafts alone: readers never guess."""

from __future__ import annotations

import functools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from ingest.cell_units import SUFFIXES, name_and_unit, unit_behind
from schemas.errors import RefusedError
from schemas.quantities import QUANTITIES
from schemas.units import ANY, conversion

TIME, NOTHING = "time", "nothing"
_SENSOR_UNITS = ("v", "volt", "volts", "mv")
"""Units of a signal that is recorded as it comes from its amplifier, whatever it measures."""
_NAMES: tuple[tuple[str, str], ...] = (
    (TIME, r"^t\d?$|time|zeit|temps|tiempo|elapsed|timestamp|date|micros|millis|^x[ _-]?(axis|value)|^clock$|uhr|时间"),
    ("leakage_current", r"current|strom|courant|leak|^i$|电流"),
    ("temperature", r"temp|^t_?film|^t \(?deg|温度"),
    ("capacitance", r"capac|kapaz|^c$|电容"),
    ("demand", r"demand|set ?point|soll"),
    ("command", r"command|^cmd|drive|control|^ao\d?$"),
    ("stretch", r"stretch|lambda|strain|dehnung|déformation|应变"),
    ("stress", r"stress|sigma|^p$|contrainte|应力"),
    ("voltage", r"volt|spannung|^tension|^u$|^hv|^v$|^u_?(mon|out|ist)|电压"),
    ("stress", r"spannung|tensi[oó]n"),
    ("pressure", r"press|druck|压力"),
    ("force_1", r"^(force|load|kraft|f)[ _-]?1$"),
    ("force_2", r"^(force|load|kraft|f)[ _-]?2$"),
    ("force", r"force|load|kraft|effort|fuerza|cell|^f$|载荷|力"),
    (
        "displacement",
        r"disp|position|^pos$|weg|extension|travel|stroke|way|hub|elong|crosshead|traverse|vibrom|laser|d[ée]placement"
        r"|länge|^s$|^x$|^z$|位移",
    ),
    ("input", r"^in(put)?$|^v1$|valve|ventil"),
    ("output", r"^out(put)?$|^v2$"),
)
_BY_UNIT = (TIME, "force", "displacement", "voltage", "capacitance", "leakage_current", "temperature")
"""What a unit alone stands for; a pressure may be a stress, so neither is here."""
_ELAPSED = ("s", "ms", "min", "h", "sec")
"""Units in which a time has elapsed."""
_SECOND = r"absol|demand|command|set ?-?point|setpt|\bsoll|sollwert|consigne|target|programm?ed"
"""Names of a machine's own position, and of what it was told to do: they stand beside what the film was measured to do."""
_OF_COUNTS = re.compile(
    r"^(no\.?|nr\.?|lfd\.?( ?nr\.?)?|scan|index|sample|#|sequence|point|interval data:?|cycle count|n[°º]|num[ée]ro|reading|messung|序号|编号|番号)$"
)
"""Names of columns that count rows."""


@dataclass(frozen=True)
class GuessedColumn:
    """A column of a file: its name or number, the unit found for it, and what it seems to be (None: no guess).

    `index`: which column of a matrix. `is_raw`: it is named as its quantity is, and stands in volts: its sensor's scale
    is not in the file. `is_asked`: its meaning was taken from its numbers, since no name tells it.
    """

    column: str | int
    unit: str | None
    meaning: str | None
    is_raw: bool = False
    index: int | None = None
    is_asked: bool = False
    name: str = ""
    """What the file calls a column that a mapping knows by its number, or by another name."""
    written_unit: str = ""
    """What stands as its unit, whether that is one or not: `×1000`."""


def guess_columns(
    header: Sequence[str], units: Sequence[str], fields: int, said: Mapping[str, str] = MappingProxyType({})
) -> tuple[GuessedColumn, ...]:
    """What columns seem to be; each meaning once, a column that is named so before one that only has the unit.

    Parameters
    ----------
    header, units : names, and the row of units; empty where there is none
    fields : number of columns
    said : what a person says that columns are, by name or number: a quantity, `time` or `nothing`
    """
    counts = Counter(header)
    found: dict[int, GuessedColumn] = {}
    taken: set[str] = {meaning for meaning in said.values() if meaning != NOTHING}
    second = _find_second(header, units)
    for by_name in (True, False):
        for i in range(fields):
            name = header[i] if i < len(header) else ""
            if (header and not name) or (i in found and found[i].meaning is not None):
                continue
            label: str | int = name if name and counts[name] == 1 else i
            plain, *said_units = _split_head(name, units, i)
            written = next((u for u in said_units if u), "")
            unit = next((u for u in said_units if u and is_any_unit(u)), "")
            if str(label) in said:
                meaning: str | None = None if said[str(label)] == NOTHING else said[str(label)]
                raw = meaning is not None and (not _fits(meaning, unit) or is_scope(plain)) and meaning != TIME
                found[i] = GuessedColumn(
                    label, unit or None, meaning, raw and unit.lower() in ("", *_SENSOR_UNITS), written_unit=written
                )
                continue
            meaning = guess_meaning(plain if by_name else "", unit) if plain or not by_name else None
            if by_name and i in second:
                meaning = None
            raw = by_name and meaning is None and unit.lower() in _SENSOR_UNITS and named_as(plain) in _WITH_SENSOR
            if raw:
                meaning = named_as(plain)
            if by_name and meaning is not None and not raw and meaning not in _named(plain):
                meaning = None  # by its unit alone: after those that have the name
            is_named = len(plain) > 1 and named_as(plain) is not None
            if meaning in taken or (not by_name and (is_named or _OF_COUNTS.match(plain.lower()))):
                meaning, raw = None, False
            if meaning is not None:
                taken.add(meaning)
            own = name if isinstance(label, int) else ""  # one of several of that name
            found[i] = GuessedColumn(label, unit or None, meaning, raw, name=own, written_unit=written)
    return _with_elapsed(tuple(found[i] for i in sorted(found)))


def _split_head(name: str, units: Sequence[str], i: int) -> tuple[str, str, str]:
    """The name of column i, what the row of units has below it, and the unit in the name itself."""
    plain, inside = split_name(name)
    return plain, (units[i] if i < len(units) else "").strip("[]() "), inside.strip("[]() ")


def _find_second(header: Sequence[str], units: Sequence[str]) -> set[int]:
    """The columns that are named as others are, and are said to be a command or the machine's own: the others come first."""
    meant: dict[str, list[int]] = {}
    for i, name in enumerate(header):
        plain, below, inside = _split_head(name, units, i)
        meaning = guess_meaning(plain, below or inside)
        if meaning is not None and meaning in _named(plain):
            meant.setdefault(meaning, []).append(i)
    found: set[int] = set()
    for columns in meant.values():
        second = {i for i in columns if re.search(_SECOND, header[i].lower())}
        found |= second if len(second) < len(columns) else set()
    return found


def guess_joined(names: Sequence[str], fields: int, said: Mapping[str, str]) -> tuple[GuessedColumn, ...]:
    """What columns seem to be by names that no single row of the file has: a mapping knows them by their numbers."""
    named = {name: said[str(i)] for i, name in enumerate(names) if str(i) in said}
    places = {name: i for i, name in enumerate(names)}
    guessed = guess_columns(names, [], fields, named)
    return tuple(
        replace(c, column=places.get(str(c.column), c.column), name=str(c.column)) if isinstance(c.column, str) else c
        for c in guessed
    )


def _with_elapsed(columns: tuple[GuessedColumn, ...]) -> tuple[GuessedColumn, ...]:
    """Of a date, an hour and a time that has elapsed the last is the time: it alone is named with a unit."""
    chosen = next((i for i, c in enumerate(columns) if c.meaning == TIME), None)
    if chosen is None or columns[chosen].unit:
        return columns
    for i, column in enumerate(columns):
        if column.meaning is None and column.unit in _ELAPSED and named_as(str(column.column)) == TIME:
            return tuple(replace(c, meaning={chosen: None, i: TIME}.get(j, c.meaning)) for j, c in enumerate(columns))
    return columns


def counts_rows(column: GuessedColumn) -> bool:
    """Whether a column counts rows, by its name: its even steps are no time."""
    return _OF_COUNTS.match((column.name or str(column.column)).strip().lower()) is not None


def is_scope(name: str) -> bool:
    """Whether a name is that of a channel of a scope or logger, which says nothing of what it measures."""
    return (
        re.fullmatch(r"(ch(annel|an)?|kanal|trace)?[ _-]*[0-9a-d]|ampl(itude)?|untitled( \d+)?", name.lower())
        is not None
    )


def is_sensor_unit(unit: str | None) -> bool:
    """Whether a unit is that of a signal as it comes from an amplifier."""
    return (unit or "").lower() in _SENSOR_UNITS


_WITH_SENSOR = ("force", "displacement", "force_1", "force_2", "stress", "pressure", "temperature")


def split_name(name: str) -> tuple[str, str]:
    """A column's name and the unit in it: `Force (mN)`, `F / N`, `force_V`, `kV`; no unit where none is known there."""
    plain, unit = name_and_unit(name)
    if unit:
        return plain, unit
    if name in SUFFIXES and len(name) > 1:
        return "", name
    return unit_behind(name)


def guess_meaning(name: str, unit: str) -> str | None:
    """`time`, a quantity, or None: what a column of that name and unit seems to be."""
    plain = name.strip().lower()
    if _OF_COUNTS.match(plain):
        return None
    if plain == "s" and not unit:
        return TIME
    named = _named(plain)
    fitting = [meaning for meaning in named if _fits(meaning, unit)]
    if fitting:
        return fitting[0]
    if named and unit and len(plain) > 1:
        return None  # of a single letter (`T in °C`) the unit says what it is
    if named and not unit:
        return named[0]
    if not unit or unit in ("-", "%", "1"):
        return None
    if unit.lower() in _SENSOR_UNITS:
        return None
    return next((q for q in _BY_UNIT if _converts(unit, "s" if q == TIME else QUANTITIES[q].unit)), None)


@functools.lru_cache(maxsize=4096)
def is_any_unit(unit: str) -> bool:
    """Whether a text is a unit of something that is measured here."""
    canonical = {q.unit for q in QUANTITIES.values() if q.unit != ANY} | {"s", "Hz", "MPa", "N/mm", "rad"}
    return any(_converts(unit, one) for one in canonical)


def named_as(name: str) -> str | None:
    """The first meaning whose words stand in a name; None where none does."""
    return next(iter(_named(name)), None)


def _named(name: str) -> list[str]:
    """All meanings whose words stand in a name, the likeliest first: a German stress is called as a voltage is."""
    return [meaning for meaning, pattern in _NAMES if re.search(pattern, name.strip().lower())]


def _fits(meaning: str, unit: str) -> bool:
    canonical = "s" if meaning == TIME else QUANTITIES[meaning].unit
    return not unit.strip() or canonical == ANY or _converts(unit, canonical)


def _converts(unit: str, canonical: str) -> bool:
    try:
        conversion(unit.strip().strip("[]()"), canonical)
    except RefusedError:
        return False
    return True
