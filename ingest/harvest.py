"""What a file says of a test beside its columns: specimen, operator, date, sizes of the film, interval of the samples.

Read for drafts alone, from the lines above a table and from the attributes of HDF5 files. What is found is written into
the draft with the words that it was read from, so that a person can see it.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from schemas.errors import RefusedError
from schemas.units import conversion

SAMPLE_RATE = "sample_rate_hz"
STARTED_AT = "started_at"
_SIZES: tuple[tuple[str, str], ...] = (
    ("film_length_mm", r"^l0$|^lo$|(gauge|gage|initial|clamp|grip|film|sample|specimen)[ _-]*length|^length\b|einspannl|"
     r"(mess|pr.f|klemm)l.nge|^l.nge$|longueur"),
    ("film_width_mm", r"^b0$|^w0$|(film|sample|specimen)?[ _-]*width|breite|largeur"),
    ("film_thickness_mm", r"^a0$|^d0$|^t0$|^h0$|(film|sample|specimen)?[ _-]*thickness|dicke|(?<!dr)st.rke|.paisseur"),
)  # fmt: skip
_TEXTS: tuple[tuple[str, str], ...] = (
    ("specimen_id", r"^(specimen|sample|probe[n]?)([ _-]*(label|name|id|no\.?|nr\.?|nummer|bezeichnung|kennung))?$|"
     r"^pr.fling$|^试样编号$|^.chantillon$"),
    ("operator", r"^(operator|user|tester|pr.fer|bediener|op.rateur|technician)$"),
    ("material", r"^(material|werkstoff|mat.riau)$"),
)  # fmt: skip
_DATE = (
    r"^(date|datum|datum ?/ ?uhrzeit|run date|test date|(test )?start(ed)?( date| time| at|zeit|datum)?|date and time|t0|date/time"
    r"|date of (test|measurement)|measurement (date|start|time)|acquired|recorded( at| on)?|(pr.f|test|mess|versuchs?)(datum|beginn|start)"
    r"|beginn( der (pr.fung|messung))?|datum der (pr.fung|messung)|date (de l'|d')?essai|d.but( de l')?( ?essai)?|fecha|data( e ora)?|trigger date)$"
)
_INTERVAL = (
    r"sample interval|sampling( interval| period)?$|sample period|^dt$|^delta_?[xt]$|^x_?inc(rement)?$|abtastintervall"
)
_RATE = r"sampl(e|ing) (rate|frequency)|^fs$|abtastrate|messrate"
_CLOCK = r"^(uhrzeit|time|start(ed)? ?(time|zeit)?|test time|time of day|heure|hora|ora)$"
_CLOCK_PATTERNS = ("%H:%M:%S", "%H:%M", "%H:%M:%S.%f", "%I:%M:%S %p", "%I:%M %p")
_NO_CLOCK = "T00:00:00"
_NOON = "T12:00:00"
"""Of a day without an hour: the day stays the same in nearly all zones."""
_PATTERNS = (
    "%m/%d/%Y %I:%M:%S %p",
    "%m/%d/%Y %I:%M %p",
    "%d.%m.%Y %H:%M:%S",
    "%d.%m.%Y %H:%M",
    "%Y/%m/%d %H:%M:%S",
    "%d-%b-%Y %H:%M:%S",
    "%d.%m.%Y",
    "%d-%b-%Y",
)
_VALUE = re.compile(r"^\s*(?P<number>[+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*(?P<unit>[^\d\s].*)?$")
_PAIR = re.compile(r"^\s*[#;%]?\s*(?P<key>[^:=\t;,]{1,60}?)\s*[:=\t;,]\s*(?P<value>.+)$")
_STAMP = re.compile(
    r"(?:^|\s)(?P<moment>\d{2}\.\d{2}\.\d{4} \d{2}:\d{2}:\d{2}|\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}:\d{2})$"
)
"""A date and hour that stand at the end of a line without a key, as machines begin a block of data."""
_UNIT_IN_KEY = re.compile(r"^(?P<key>.*?)\s*[\[(/]\s*(?P<unit>[^\])]+?)[\])]?$")


OWN_FACTS = ("specimen_id", "film_length_mm", "film_width_mm", "film_thickness_mm", "material")
"""What each of several runs in one file may have of its own."""


@dataclass(frozen=True)
class Fact:
    """A key of `[recording]` (or the sample rate) with its value and the words it was read from.

    `lacks_unit`: a size that is a number alone, as if it were in mm.
    """

    key: str
    value: Any
    words: str
    lacks_unit: bool = False


def harvest_lines(lines: Iterable[str]) -> tuple[Fact, ...]:
    """The facts that the lines above a table say, the first of each kind; a size with its unit before one without."""
    found: dict[str, Fact] = {}
    clock = stamp = None
    for line in lines:
        stamp = stamp or _stamp(line)
        match = _PAIR.match(line.replace('"', ""))
        if match is None:
            continue
        words = " ".join(line.replace('"', "").split())[:100]
        key, value = match["key"].strip(), match["value"].strip(" ,;\t")
        fact = _fact(key, value, words)
        if fact is not None:
            _keep_first(found, fact)
        elif clock is None and re.search(_CLOCK, key.lower()):
            clock = _hour(value, words)
    if stamp is not None and (STARTED_AT not in found or _is_day_of(found[STARTED_AT], stamp)):
        found[STARTED_AT] = stamp
    if STARTED_AT in found:
        found[STARTED_AT] = _with_hour(found[STARTED_AT], clock)
    return tuple(found.values())


def harvest_rows(rows: Iterable[Iterable[Any]]) -> tuple[Fact, ...]:
    """The facts that the rows of a sheet above its table say."""
    return harvest_lines("\t".join("" if cell is None else str(cell) for cell in row) for row in rows)


def harvest_columns(rows: Sequence[Sequence[str]]) -> tuple[Fact, ...]:
    """The facts of small tables above the table, as of results: a row of names, perhaps one of units, and one of values.

    Parameters
    ----------
    rows : cells of the lines above the table. Several rows of values, of several specimens, tell nothing of one
    """
    found: list[Fact] = []
    plain = [[" ".join(str(cell).split()) for cell in row] for row in rows]
    for i, names in enumerate(plain):
        known = [j for j, name in enumerate(names) if any(re.search(p, _bare(name)) for _, p in (*_SIZES, *_TEXTS))]
        if len([name for name in names if name]) < 2 or not known:
            continue
        units, *rest = plain[i + 1 : i + 4] or [[]]
        if not any(_VALUE.match(cell) for cell in units):
            values, further = (rest[0] if rest else []), rest[1:]
        else:
            units, values, further = [], units, rest[:1]
        if any(row and len(row) > max(known) and all(row[j] for j in known) for row in further):
            continue
        for j in (j for j in known if j < len(values)):
            unit = units[j].strip("[]() ") if j < len(units) else ""
            key = f"{names[j]} [{unit}]" if unit else names[j]
            fact = _fact(key, values[j], f"{names[j]} {values[j]} {unit}".strip())
            found += [] if fact is None else [fact]
    return tuple(found)


def harvest_blocks(lines: Iterable[str], is_row: Callable[[str], bool]) -> list[Mapping[str, Fact]]:
    """What is said above each of several runs that one file holds one below the other, by key; blocks that say nothing are none.

    Parameters
    ----------
    lines : of the whole file
    is_row : whether a line is a row of samples
    """
    found: list[Mapping[str, Fact]] = []
    block: list[str] = []
    for line in lines:
        if not is_row(line):
            block.append(line)
            continue
        if block and (facts := by_key(harvest_lines(block))):
            found.append(facts)
        block = []
    return found


def harvest_hdf5(path: Path) -> tuple[Fact, ...]:
    """The facts that the attributes of an HDF5 file say."""
    import h5py

    lines: list[str] = []

    def look(name: str, item: Any) -> None:
        for key, value in item.attrs.items():
            text = value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
            lines.append(f"{key}: {text}")

    try:
        with h5py.File(path) as file:
            look("", file)
            file.visititems(look)
    except (OSError, RuntimeError, KeyError, ValueError):
        return ()
    return harvest_lines(lines[:2000])


def own_interval(names: Iterable[str], units: Iterable[str]) -> Fact | None:
    """The interval of the samples where a scope writes it into the row of units: `Increment` over `2.0e-02`."""
    for name, unit in zip(names, units, strict=False):
        fact = _fact(name.strip(), unit.strip(), f"{name} {unit}".strip())
        if fact is not None and fact.key == SAMPLE_RATE:
            return fact
    return None


def _fact(key: str, value: str, words: str) -> Fact | None:
    plain = key.lower()
    for name, pattern in _SIZES:
        if re.search(pattern, _bare(key)):
            size = _size_mm(key, value)
            if size is None and (size := _bare_number(key, value)) is not None:
                return Fact(name, size, words, lacks_unit=True)
            return None if size is None else Fact(name, size, words)
    for name, pattern in _TEXTS:
        if re.search(pattern, plain) and value:
            return Fact(name, value[:80], words)
    if re.search(_DATE, plain):
        moment = _moment(value)
        return None if moment is None else Fact(STARTED_AT, moment, words)
    if re.search(_INTERVAL, plain) or plain == "increment":
        step = _number(value, "s", "s")
        return Fact(SAMPLE_RATE, float(f"{1 / step:.9g}"), words) if step else None
    if re.search(_RATE, plain):
        rate = _number(value, "Hz", "Hz")
        return Fact(SAMPLE_RATE, rate, words) if rate else None
    return None


def _bare(key: str) -> str:
    """A key in small letters without the unit behind it."""
    return key.lower().split("[")[0].split("(")[0].split("/")[0].strip()


def _size_mm(key: str, value: str) -> float | None:
    match = _UNIT_IN_KEY.match(key)
    return _number(value, match["unit"] if match else "", "mm")


def _bare_number(key: str, value: str) -> float | None:
    """A positive number without a unit beside it or in its key; None where there is one, or no number."""
    match = _VALUE.match(value)
    if match is None or match["unit"] or _UNIT_IN_KEY.match(key):
        return None
    return _number(value, "mm", "mm")


def _number(value: str, unit: str, canonical: str) -> float | None:
    """A positive number with its unit, in the canonical one; None where either is not understood."""
    match = _VALUE.match(re.sub(r"[\t;]+|,(?=\s*[A-Za-zµ])", " ", value))
    if match is None:
        return None
    said = (match["unit"] or unit).strip(" []()")
    if not said:
        return None
    try:
        number = float(match["number"].replace(",", ".")) * conversion(said, canonical).scale
    except RefusedError:
        return None
    return float(f"{number:.9g}") if 0 < number < 1e9 else None


def _moment(value: str) -> str | None:
    """A date as ISO 8601, without a zone where it has none; None where it is none or may mean two days."""
    text = re.sub(r"[\t;]+", " ", value).strip()
    try:
        return datetime.fromisoformat(text).isoformat() if len(text) >= 10 else None
    except ValueError:
        pass
    for pattern in _PATTERNS:
        try:
            return datetime.strptime(text, pattern).isoformat()
        except ValueError:
            continue
    return None


def read_moment(text: str) -> str | None:
    """The date, and hour where there is one, that a text begins with, as ISO 8601; None where there is none."""
    words = text.replace(",", " ").replace("Uhr", " ").split()
    for count in (3, 2, 1):
        moment = _moment(" ".join(words[:count])) if len(words) >= count else None
        if moment is not None:
            return moment
    return None


def _stamp(line: str) -> Fact | None:
    """A date and hour at the end of a line; None where there is none."""
    words = " ".join(line.replace('"', "").split())
    match = _STAMP.search(words)
    moment = None if match is None else _moment(match["moment"])
    return None if moment is None else Fact(STARTED_AT, moment, words[:100])


def _is_day_of(day: Fact, moment: Fact) -> bool:
    """Whether a fact is a day without an hour, and a moment is on that day."""
    return _lacks_hour(day) and str(day.value)[:10] == str(moment.value)[:10]


def _lacks_hour(day: Fact) -> bool:
    return str(day.value).endswith(_NO_CLOCK) and re.search(r"\d:\d", day.words) is None


def _hour(value: str, words: str) -> Fact | None:
    """A time of day as ISO 8601; None where it is none."""
    for pattern in _CLOCK_PATTERNS:
        try:
            return Fact(STARTED_AT, datetime.strptime(value, pattern).time().isoformat(), words)
        except ValueError:
            continue
    return None


def _with_hour(day: Fact, clock: Fact | None) -> Fact:
    """A day with the time of day that another line gives; noon where none does."""
    if not _lacks_hour(day):
        return day
    if clock is None:
        return Fact(STARTED_AT, day.value.replace(_NO_CLOCK, _NOON), f"{day.words} (no hour: noon)")
    return Fact(STARTED_AT, day.value.replace(_NO_CLOCK, f"T{clock.value}"), f"{day.words} {clock.words}")


def name_fact(fact: Fact) -> Any:
    """A fact's value as a draft has it. A specimen that a file only numbers has the file's name before its number: every file has a `1`."""
    if fact.key == "specimen_id" and (number := re.fullmatch(r"(\d{1,4})(\.0)?", str(fact.value))):
        return f"{{stem}}-{number[1]}"
    return fact.value


def by_key(facts: Iterable[Fact]) -> Mapping[str, Fact]:
    """Facts by their key, the first of each; a size with its unit before one without."""
    found: dict[str, Fact] = {}
    for fact in facts:
        _keep_first(found, fact)
    return found


def _keep_first(found: dict[str, Fact], fact: Fact) -> None:
    if fact.key not in found or (found[fact.key].lacks_unit and not fact.lacks_unit):
        found[fact.key] = fact
