"""Guesses for the draft of a mapping: how a text file is written, where its table begins, what stands above it.

Only drafts use these, for a person to check. Readers never guess. What the columns mean is in `ingest.meanings`, the
encoding in `ingest.encodings`.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from ingest.csv_dialect import WHITESPACE, Dialect
from ingest.encodings import guess_encoding
from ingest.harvest import Fact, harvest_columns, harvest_lines, own_interval
from ingest.heads import join_heads
from ingest.meanings import GuessedColumn, guess_columns, guess_joined, is_any_unit
from ingest.notations import PREFIXES, read_cell
from schemas.errors import RefusedError

_SAMPLE = 1 << 18
"""Bytes of a file that are looked at."""
_ROWS = 200
_LAST_LINES = 12
_FEWEST, _MOST = 4, 0.7
"""Rows of a table with words in it, and their share of all lines: fewer are a text."""
_NEARLY = 0.75
"""Share of the cells that rows of a table fill from which a row is one of it."""
_GAP_OF_TABLE, _SCRAP = 2, 0.1
"""Lines from one row of a table to the next one at most, a blank one between them; share of the longest table that is one still."""
_CHANNEL = re.compile(r"(ch|chan|channel|kanal|ai|voie|canal|in|input)[ _-]?\d{1,3}", re.IGNORECASE)
"""What a recorder calls its inputs."""
_NUMBER = {
    ".": re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf)", re.IGNORECASE),
    ",": re.compile(r"[+-]?(?:\d+,?\d*|,\d+)(?:[eE][+-]?\d+)?|[+-]?(?:nan|inf)", re.IGNORECASE),
}
_CLOCK = re.compile(r"[<>≥≤=\s]*\d+:\d\d|\d{1,4}[-./]\d{1,2}[-./]\d{2,4}(?:[T ].*)?")
"""Durations such as `64:33`, and dates: what a list of lives may have in place of every number."""
_LISTED = re.compile(
    r"^[#%;\s\"']*(?:sig(?:nal)?|ch(?:annel)?|col(?:umn)?|var(?:iable)?|field|kanal|spalte|feld|gr[öo][ßs]+e|voie|colonne|canal|columna)?"
    r"[ _.-]*(?P<number>\d{1,2})\"?\s*[:=.\t;,|) ]\s*(?P<name>[^\W\d_].*)$",
    re.IGNORECASE,
)
"""A line that names one column of the table below by its number."""
_MARK = re.compile(r"-\d{1,4}(?:[.,]0*)?")
_FEWEST_ALIKE = 3
"""Columns of which the same negative whole number in all is a mark: of two it may be measured."""
_ROWS_ABOVE: Mapping[str, str] = {
    "names": r"kommentare?|comments?|bezeichnung(en)?|beschreibung|descriptions?|(channel |signal|kanal|sensor)?\s?names?|labels?|messstellen?|d[ée]signations?"
    r"|commentaires?|nombres?|descripci[óo]n",
    "units": r"einheit(en)?|units?|unit[ée]s?|unidad(es)?|dimension|单位",
}
"""What stands in the first cell of a row that says something of each column."""
_DELIMITERS = ("\t", ";", ",", "|", WHITESPACE)


@dataclass(frozen=True)
class GuessedTable:
    """How a text file seems to be written, its columns, and what the lines above its table say."""

    dialect: Dialect
    columns: tuple[GuessedColumn, ...]
    rows: tuple[tuple[str, ...], ...]
    facts: tuple[Fact, ...] = ()
    words: tuple[str, ...] = ()
    """The lines above the table and the last ones, as far as they hold words."""


def guess_text(content: bytes, said: Mapping[str, str] = MappingProxyType({})) -> GuessedTable:
    """The dialect and columns of a text file; `said` as `ingest.meanings.guess_columns` has it.

    Raises `RefusedError` when no rows of numbers are found.
    """
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
    start = _first_row(lines, start, dialect, fields)
    above = [i for i in range(start) if lines[i].strip()]
    header, units = _heads(lines, above, dialect, fields)
    fields = max(fields, len(header) if len(header) == len(_split(lines[start], dialect)) else 0)
    first = above[-(len(header) > 0) - (len(units) > 0)] if header else start
    marks = find_marks(lines[start:], dialect, fields)
    dialect = replace(dialect, skip_rows=first, header=bool(header), unit_row=bool(units), comment=marks)
    rows = tuple(
        tuple(_split(line, dialect)) for line in lines[start : start + _ROWS] if line.strip() and line.strip() != marks
    )
    heads = [lines[i] for i in above if i < first]
    facts = (*harvest_lines(heads), *harvest_columns([_split(line, dialect) for line in heads]))
    interval = own_interval(header, units)
    labels, scope_units = _of_scope([lines[i] for i in above if i < first], dialect, header)
    told, told_units = _of_rows([lines[i] for i in above if i < first], dialect, header)
    labels, scope_units = labels or told or _of_list(heads, dialect, header), scope_units or told_units
    listed = [] if header else list_columns([lines[i] for i in above], fields)
    known = list(units or scope_units)
    columns = guess_columns(header, known, fields, said)
    adjacent = len(above) > 1 and header and not units and above[-1] - above[-2] == 1
    listed = listed or (join_heads(_split(lines[above[-2]], dialect), header) if adjacent else [])
    if listed:
        columns = guess_joined(listed, fields, said)
    if labels and len(columns) == len(labels):
        shown = [own if own in said else label for own, label in zip(header, labels, strict=False)]
        guessed = guess_columns(shown, known, fields, said)
        columns = tuple(replace(g, column=c.column, name=str(g.column)) for g, c in zip(guessed, columns, strict=True))
    if interval is not None:  # the first column counts samples: the interval beside its name makes times of them
        columns = tuple(replace(c, meaning=None) if c.column in ("X", "x") else c for c in columns)
    words = tuple(
        line for line in (*(lines[i] for i in above), *lines[-_LAST_LINES:]) if re.search(r"[^\W\d]{2}", line)
    )
    return GuessedTable(dialect, columns, rows, facts if interval is None else (interval, *facts), words)


def _first_row(lines: Sequence[str], start: int, dialect: Dialect, fields: int) -> int:
    """Where the rows begin: those above that hold a number beside marks such as `----` or `WAIT` are rows as well."""
    while start and lines[start - 1].strip():
        cells = [c.strip() for c in _split(lines[start - 1], dialect)]
        numbers = sum(is_number(c, dialect.decimal) for c in cells)
        if abs(len(cells) - fields) > 1 or are_units(cells) or not numbers or (numbers < 2 and len(cells) != fields):
            break
        start -= 1
    return start


def _with_words(lines: Sequence[str], encoding: str) -> tuple[float, Dialect, int, int] | None:
    """The dialect of a table in which words and dates stand beside numbers; None where the lines are no table."""
    best: tuple[float, Dialect, int, int] | None = None
    filled = [
        (i, line) for line, i in {line: i for i, line in reversed(list(enumerate(lines)))}.items() if line.strip()
    ]
    filled.sort()  # each line once: heads may be said again above each interval
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
            numbers = [sum(_is_measured(f.strip(), decimal) for f in row) for _, row in alike]
            start = _first_of_table(alike, numbers)
            share = sum(n > 0 for n in numbers) / len(filled)
            if start is not None and fields > 1 and len(alike) >= _FEWEST and share > _MOST:
                score = share + sum(numbers) / (fields * len(alike))
                if best is None or score > best[0]:
                    best = (score, dialect, start, fields)
    return best


def _first_of_table(rows: Sequence[tuple[int, Sequence[str]]], numbers: Sequence[int]) -> int | None:
    """The line in which a table begins: the first one with a number that is filled nearly as rows of the table are, and no scrap of another.

    Lines above a table are padded with delimiters by spreadsheets: they have its width, and a number here and there; a list of channels
    and their ranges is a small table of the same width.

    Parameters
    ----------
    rows : numbers of lines of one width, with their fields
    numbers : how many fields of each are numbers
    """
    filled = [sum(bool(field.strip()) for field in row) for _, row in rows]
    usual = Counter(count for count, own in zip(filled, numbers, strict=True) if own)
    if not usual:
        return None
    least = _NEARLY * max(usual, key=lambda count: (usual[count], count))
    kept = [i for (i, _), own, count in zip(rows, numbers, filled, strict=True) if own and count >= least]
    blocks: list[list[int]] = []
    for i in kept:
        if blocks and i - blocks[-1][-1] <= _GAP_OF_TABLE:
            blocks[-1].append(i)
        else:
            blocks.append([i])
    longest = max(len(block) for block in blocks)
    least_rows = max(min(2, longest), _SCRAP * longest)  # one line alone is no table beside others
    return next(block[0] for block in blocks if len(block) >= least_rows)


def _score(lines: Sequence[str], dialect: Dialect) -> tuple[float, int, int]:
    """How well a dialect splits lines into numbers; where the rows begin; their number of fields."""
    numeric = [count_numbers(line, dialect) for line in lines]
    counts = Counter(n for n in numeric if n)
    if not counts:
        return 0.0, 0, 0
    fields, rows = max(counts.items(), key=lambda item: (item[1] * min(item[0], 8), item[0]))
    start = next(i for i, n in enumerate(numeric) if n == fields)
    share = rows / max(1, sum(1 for line in lines[start:] if line.strip()))
    return share * (1.0 + min(fields, 20) / 20 + (fields > 1)), start, fields


def count_numbers(line: str, dialect: Dialect) -> int:
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
    rows = [_without_end([" ".join(f.split()) for f in _split(lines[i], dialect)], fields) for i in above[-2:]]
    if len(rows) == 2 and len(rows[0]) == len(rows[1]) > fields and are_units(rows[1]):
        return rows[0], rows[1]
    rows = [row for row in rows if abs(len(row) - fields) <= 1]
    if not rows:
        return (), ()
    if len(rows) == 2 and (are_units(rows[1]) or _repeats_units(*rows)):
        return _without_end(rows[0]), rows[1]
    return _without_end(rows[-1]), ()


def _repeats_units(names: Sequence[str], row: Sequence[str]) -> bool:
    """Whether a row says the same unit twice below names that differ: columns are not called so."""
    places: dict[str, list[int]] = {}
    for i, cell in enumerate(row):
        if (unit := cell.strip("[]() ")) and is_any_unit(unit):
            places.setdefault(unit, []).append(i)
    above = [[names[i] for i in own if i < len(names)] for own in places.values() if len(own) > 1]
    return any(all(own) and len(set(own)) == len(own) and not any(is_any_unit(name) for name in own) for own in above)


def _without_end(cells: Sequence[str], fields: int = 0) -> tuple[str, ...]:
    """A row without the empty cells that delimiters at its end make; the first `fields` cells stay.

    Columns at the end of a table may have no unit: their empty cells belong to the row of units.
    """
    count = len(cells)
    while count > fields and not cells[count - 1]:
        count -= 1
    return tuple(cells[:count])


def list_columns(lines: Sequence[str], fields: int) -> list[str]:
    """The names of columns that have no header, where the lines above list them by number, from 0 or 1: `Sig1 Time (min)`.

    Empty where they do not list each of them once.
    """
    found: dict[int, str] = {}
    for line in lines:
        match = _LISTED.match(line)
        if match is not None:
            if int(match["number"]) in found:
                return []
            found[int(match["number"])] = " ".join(match["name"].strip('" ;,\t').split())
    first = min(found, default=0)
    return (
        [found[first + i] for i in range(fields)]
        if first < 2 and set(found) == set(range(first, first + fields))
        else []
    )


def find_marks(rows: Sequence[str], dialect: Dialect, fields: int) -> str:
    """How lines begin that are marks of the machine between blocks: one negative whole number in all columns; empty where there are none."""
    if fields < _FEWEST_ALIKE:
        return ""
    marks = {
        line.strip()
        for line in rows
        if len(cells := [cell.strip() for cell in _split(line, dialect)]) >= fields
        and len(set(cells)) == 1
        and _MARK.fullmatch(cells[0])
    }
    return marks.pop() if len(marks) == 1 else ""


def _of_scope(lines: Sequence[str], dialect: Dialect, header: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names and units of an oscilloscope's columns, as the lines above its table give them for each channel.

    The time comes first in the table and has a line of its own. Empty where no such lines are.
    """
    said = {
        cells[0].lower(): list(_without_end(cells[1:]))
        for line in lines
        if (cells := [c.strip() for c in _split(line, dialect)])
    }
    channels = len(header) - 1
    labels, units = said.get("label", said.get("labels", [])), said.get("vertical units", [])
    across = said.get("horizontal units", [])
    names = [header[0], *labels] if channels > 0 and len(labels) == channels and all(labels) else []
    return names, [across[0], *units] if channels > 0 and len(units) == channels and len(across) == 1 else []


def _of_rows(lines: Sequence[str], dialect: Dialect, header: Sequence[str]) -> tuple[list[str], list[str]]:
    """Names and units of a logger's columns (`M00`, `CH3`), as rows above its table say them below each other: `Kommentar:`, `Einheit:`.

    Such a row has a key in its first cell and what it says in the place of each column; columns without a word keep the header's.
    Empty where no such rows are.
    """
    found: dict[str, list[str]] = {}
    for line in lines:
        cells = [cell.strip() for cell in _split(line, dialect)]
        key = cells[0].lower().strip(" :#")
        kind = next((kind for kind, words in _ROWS_ABOVE.items() if re.fullmatch(words, key)), None)
        if kind is not None and len(header) - 1 <= len(cells) <= len(header) + 1 and any(cells[1:]):
            found.setdefault(kind, ["", *cells[1:], *[""] * len(header)][: len(header)])
    names = [said or own for said, own in zip(found["names"], header, strict=True)] if "names" in found else []
    return names, found.get("units", [])


def _of_list(lines: Sequence[str], dialect: Dialect, header: Sequence[str]) -> list[str]:
    """Names of a logger's columns (`CH1`), as a list above its table says them, a channel in each line; empty where none has one."""
    said: dict[str, str] = {}
    for line in lines:
        name, *rest = [cell.strip() for cell in _split(line, dialect)] or [""]
        if rest and _CHANNEL.fullmatch(name) and re.search(r"[^\W\d_]{2}", rest[0]):
            said.setdefault(name, rest[0])
    return [said.get(name, name) for name in header] if said.keys() & set(header) else []


def is_number(text: str, decimal: str) -> bool:
    """Whether a cell is a number as people and machines write it, with a unit or prefix behind it or not."""
    found = read_cell(text, decimal)
    if found is None or not math.isfinite(found.value):
        return False
    return not found.unit or found.unit in PREFIXES or is_any_unit(found.unit)


def _is_measured(text: str, decimal: str) -> bool:
    """Whether a cell is a number, a date, or a duration of two parts."""
    return is_number(text, decimal) or _CLOCK.fullmatch(text) is not None


def are_units(cells: Sequence[str]) -> bool:
    """Whether a row holds units: half of its cells that are no numbers are some, and one is no `-`."""
    filled = [c.strip("[]() ") for c in cells if c.strip("[]() ") and not is_number(c.strip(), ".")]
    units = [c for c in filled if is_any_unit(c)]
    return len(units) >= len(filled) / 2 and any(c not in ("-", "1", "%") for c in units)
