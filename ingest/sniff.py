"""Guesses for the draft of a mapping: how a text file is written, and what columns mean by name and unit.

Only `dealab inspect` uses these, and only to draft a TOML that a person then checks. Readers never guess.
"""

from __future__ import annotations

import codecs
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from ingest.cell_units import name_and_unit
from ingest.csv_dialect import WHITESPACE, Dialect
from schemas.errors import RefusedError
from schemas.quantities import QUANTITIES
from schemas.units import ANY, conversion

TIME = "time"
_SAMPLE = 1 << 18
"""Bytes of a file that are looked at."""
_ROWS = 200
_FEWEST, _MOST = 4, 0.7
"""Rows of a table with words in it, and their share of all lines: fewer are a text."""
_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf)", re.IGNORECASE),
    ",": re.compile(r"[+-]?(?:\d+,?\d*|,\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf)", re.IGNORECASE),
}
_DELIMITERS = ("\t", ";", ",", "|", WHITESPACE)
_NAMES: tuple[tuple[str, str], ...] = (
    (TIME, r"^t$|time|zeit|elapsed|timestamp|date|时间"),
    ("leakage_current", r"current|strom|leak|^i$|电流"),
    ("temperature", r"temp|^t_?film|温度"),
    ("capacitance", r"capac|kapaz|^c$|电容"),
    ("demand", r"demand|set ?point|soll"),
    ("command", r"command|^cmd|drive|control"),
    ("voltage", r"volt|spannung|^u$|^hv|^v$|电压"),
    ("stress", r"stress|sigma|^p$|应力"),
    ("stretch", r"stretch|lambda"),
    ("pressure", r"press|druck|压力"),
    ("force_1", r"(force|load|kraft|f).*[ _-]?1$"),
    ("force_2", r"(force|load|kraft|f).*[ _-]?2$"),
    ("force", r"force|load|kraft|^f$|载荷|力"),
    ("displacement", r"disp|position|weg|extension|travel|hub|elong|crosshead|^x$|位移"),
    ("input", r"^in(put)?$|^v1$"),
    ("output", r"^out(put)?$|^v2$"),
)
_BY_UNIT = ("force", "displacement", "voltage", "capacitance", "leakage_current", "temperature")
"""What a unit alone stands for; a pressure may be a stress, so neither is here."""


@dataclass(frozen=True)
class GuessedColumn:
    """A column of a file: its name or number, the unit found for it, and what it seems to be (None: no guess)."""

    column: str | int
    unit: str | None
    meaning: str | None


@dataclass(frozen=True)
class GuessedTable:
    """How a text file seems to be written, and its columns."""

    dialect: Dialect
    columns: tuple[GuessedColumn, ...]
    rows: tuple[tuple[str, ...], ...]


def guess_text(content: bytes) -> GuessedTable:
    """The dialect and columns of a text file. Raises `RefusedError` when no rows of numbers are found."""
    encoding = guess_encoding(content)
    text = content[:_SAMPLE].decode(encoding, "replace").removeprefix("\ufeff")
    lines = text.splitlines()
    if len(content) > _SAMPLE:
        lines = lines[:-1]
    best: tuple[float, Dialect, int, int] | None = None
    for delimiter in _DELIMITERS:
        for decimal in (".", ","):
            if decimal != delimiter:
                dialect = Dialect(delimiter=delimiter, decimal=decimal, encoding=encoding)
                score, start, fields = _score(lines, dialect)
                if best is None or score > best[0]:
                    best = (score, dialect, start, fields)
    if best is None or best[0] <= 0:
        best = _with_words(lines, encoding)
    if best is None:
        raise RefusedError("no rows of numbers are found in the text", expected="delimited columns of numbers")
    _, dialect, start, fields = best
    above = [i for i in range(start) if lines[i].strip()]
    header, units = _heads(lines, above, dialect, fields)
    first = above[-(len(header) > 0) - (len(units) > 0)] if header else start
    dialect = replace(dialect, skip_rows=first, header=bool(header), unit_row=bool(units))
    rows = tuple(tuple(_split(line, dialect)) for line in lines[start : start + _ROWS] if line.strip())
    return GuessedTable(dialect, guess_columns(header, units, fields), rows)


def _with_words(lines: Sequence[str], encoding: str) -> tuple[float, Dialect, int, int] | None:
    """The dialect of a table in which words and dates stand beside numbers; None where the lines are no table."""
    best: tuple[float, Dialect, int, int] | None = None
    filled = [(i, line) for i, line in enumerate(lines) if line.strip()]
    if len(filled) < _FEWEST:
        return None
    for delimiter in _DELIMITERS[:-1]:
        for decimal in (".", ","):
            dialect = Dialect(delimiter=delimiter, decimal=decimal, encoding=encoding)
            if decimal == delimiter:
                continue
            rows = [(i, _split(line, dialect)) for i, line in filled]
            widths = Counter(len(row) for _, row in rows)
            fields, _ = max(widths.items(), key=lambda item: (item[1] * min(item[0], 8), item[0]))
            alike = [(i, row) for i, row in rows if len(row) == fields]
            numbers = [sum(bool(_NUMBER[decimal].fullmatch(f.strip())) for f in row) for _, row in alike]
            start = next((i for (i, _), n in zip(alike, numbers, strict=True) if n), None)
            share = sum(n > 0 for n in numbers) / len(filled)
            if start is not None and fields > 1 and len(alike) >= _FEWEST and share > _MOST:
                score = share + sum(numbers) / (fields * len(alike))
                if best is None or score > best[0]:
                    best = (score, dialect, start, fields)
    return best


def guess_encoding(content: bytes) -> str:
    """By the byte-order mark, else UTF-8 when it decodes, else GBK when that gives Chinese text, else cp1252."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if content.startswith(codecs.BOM_UTF8):
        return "utf-8-sig"
    start = content[:_SAMPLE]
    try:
        codecs.getincrementaldecoder("utf-8")().decode(start)
        return "utf-8"
    except UnicodeDecodeError:
        pass
    try:
        text = codecs.getincrementaldecoder("gbk")().decode(start)
    except UnicodeDecodeError:
        return "cp1252"
    foreign = [c for c in text if not c.isascii()]
    chinese = sum("\u4e00" <= c <= "\u9fa5" or c == "℃" for c in foreign)
    return "gbk" if chinese > len(foreign) / 2 and chinese > 1 else "cp1252"


def guess_columns(header: Sequence[str], units: Sequence[str], fields: int) -> tuple[GuessedColumn, ...]:
    """What columns seem to be, by their names, units in brackets and unit row; each meaning once."""
    columns: list[GuessedColumn] = []
    taken: set[str] = set()
    counts = Counter(header)
    for i in range(fields):
        name = header[i] if i < len(header) else ""
        if header and not name:
            continue
        plain, inside = name_and_unit(name)
        unit = (units[i] if i < len(units) else "") or inside
        meaning = guess_meaning(plain, unit)
        if meaning in taken:
            meaning = None
        if meaning is not None:
            taken.add(meaning)
        columns.append(GuessedColumn(name if name and counts[name] == 1 else i, unit.strip("[]()") or None, meaning))
    return tuple(columns)


def guess_meaning(name: str, unit: str) -> str | None:
    """`time`, a quantity, or None: what a column of that name and unit seems to be."""
    named = [meaning for meaning, pattern in _NAMES if re.search(pattern, name.strip().lower())]
    if named:
        return next((meaning for meaning in named if _fits(meaning, unit)), None)
    if not unit or unit in ("-", "%"):
        return None
    return next((name for name in _BY_UNIT if _converts(unit, QUANTITIES[name].unit)), None)


def _fits(meaning: str, unit: str) -> bool:
    canonical = "s" if meaning == TIME else QUANTITIES[meaning].unit
    return not unit.strip() or canonical == ANY or _converts(unit, canonical)


def _converts(unit: str, canonical: str) -> bool:
    try:
        conversion(unit.strip().strip("[]()"), canonical)
    except RefusedError:
        return False
    return True


def _score(lines: Sequence[str], dialect: Dialect) -> tuple[float, int, int]:
    """How well a dialect splits lines into numbers; where the rows begin; their number of fields."""
    numeric = [_numeric_fields(line, dialect) for line in lines]
    counts = Counter(n for n in numeric if n)
    if not counts:
        return 0.0, 0, 0
    fields, rows = max(counts.items(), key=lambda item: (item[1] * min(item[0], 8), item[0]))
    start = next(i for i, n in enumerate(numeric) if n == fields)
    share = rows / max(1, sum(1 for line in lines[start:] if line.strip()))
    return share * (1.0 + min(fields, 20) / 20 + (fields > 1)), start, fields


def _numeric_fields(line: str, dialect: Dialect) -> int:
    """Number of fields when the line holds numbers (and empty fields) only, else 0."""
    if not line.strip():
        return 0
    fields = [f.strip() for f in _split(line, dialect)]
    pattern = _NUMBER[dialect.decimal]
    filled = [f for f in fields if f]
    return len(fields) if filled and all(pattern.fullmatch(f) for f in filled) else 0


def _split(line: str, dialect: Dialect) -> list[str]:
    return line.split() if dialect.delimiter == WHITESPACE else dialect.fields(line)


def _heads(
    lines: Sequence[str], above: Sequence[int], dialect: Dialect, fields: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Header and unit row above the rows of numbers; empty where there is none."""
    rows = [tuple(" ".join(f.split()) for f in _split(lines[i], dialect)) for i in above[-2:]]
    rows = [row for row in rows if abs(len(row) - fields) <= 1]
    if not rows:
        return (), ()
    if len(rows) == 2 and _are_units(rows[1]):
        return rows[0], rows[1]
    return rows[-1], ()


def _are_units(cells: Sequence[str]) -> bool:
    filled = [c.strip("[]() ") for c in cells if c.strip("[]() ")]
    canonical = {q.unit for q in QUANTITIES.values() if q.unit != ANY} | {"s", "Hz", "MPa", "N/mm"}
    return bool(filled) and sum(any(_converts(c, u) for u in canonical) for c in filled) > len(filled) / 2
