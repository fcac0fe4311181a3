"""Numbers as people and machines write them into cells: what is read, what stands for no value, what is not understood.

Only what has a single meaning is read: other minus signs (U+2212, dashes, a minus behind the number, parentheses of
accounting), blanks after a sign, thousands separators, the exponents of Fortran, a unit or SI prefix behind the number
(`512.3 mN`, `53.251m`), durations (`26:15:00`), bounds (`> 3600`). What has two meanings (`1,234`) is refused.

A cell that is not understood is damage where it stands alone. Where several are written alike they are a notation, and
leaving them out would drop numbers by their value (all negative ones, all large ones): the column is refused.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ingest.columns import Numbers
from ingest.mapping import ColumnName, column_label
from schemas.arrays import Bool, Float, Int
from schemas.errors import RefusedError

_MINUS = str.maketrans(dict.fromkeys("\u2212\u2013\u2014\u2010\u2011\ufe63\uff0d", "-"))
_BLANKS = " \t\u00a0\u2007\u2009\u202f"
_MARKS = frozenset(
    [
        "na",
        "n/a",
        "n.a.",
        "#n/a",
        "null",
        "none",
        "nil",
        "nan",
        "inf",
        "infinity",
        "∞",
        "ol",
        "o.l",
        "o.l.",
        "over",
        "overload",
        "overflow",
        "overrange",
        "ovld",
        "ovrld",
        "ovf",
        "ovfl",
        "ovrng",
        "ofl",
        "under",
        "underrange",
        "unfl",
        "err",
        "error",
        "invalid",
        "bad",
        "burnout",
        "open",
        "missing",
        "#div/0!",
        "#value!",
        "#ref!",
        "#name?",
        "#num!",
        "#null!",
        "1.#inf",
        "1.#qnan",
        "1.#ind",
    ]
)
"""Words of instruments and spreadsheets that stand for no value, whatever their sign."""
_ONLY_SIGNS = re.compile(r"[-+*#?=~._/]+")
_BOUND = re.compile(r"(?P<low>>=|=>|>|≥|⩾)|(?P<high><=|=<|<|≤|⩽)")
_DURATION = re.compile(r"(?P<h>\d+):(?P<m>[0-5]?\d):(?P<s>[0-5]?\d(?:[.,]\d*)?)")
_NUMBER = re.compile(
    rf"(?P<sign>[+-]?)(?P<body>\d[\d.,'’{_BLANKS}]*\d|\d|[.,]\d+)(?P<point>[.,]?)"
    rf"(?P<exponent>[eEdD][+-]?\d{{1,3}}|[+-]\d{{3}})?(?P<unit>[{_BLANKS}]*[^\d{_BLANKS}.,'’+-][^\d]{{0,11}}\d?)?"
)
_LIKE_A_NUMBER = re.compile(r"[^\w\s]{0,3}\s*[.,]?\d")
_AFTER_A_WORD = re.compile(r"[^\W\d_][^\d]{0,15}\d*[.,]\d")
"""A fraction behind a word, `minus 0.017`: a number in words, where it is another one from cell to cell, and no code of a fault."""
_MOST = 20
"""So many times more fractions with the decimal mark of the mapping than cells with the other one: the mapping is right."""
ALIKE = 3
_SHARE = 0.2
"""Cells that are not understood are a notation when this many, and this share of them, are written alike: of cells that
lost a random byte far fewer are."""
PREFIXES: Mapping[str, float] = {
    "f": 1e-15, "p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3,
    "k": 1e3, "K": 1e3, "M": 1e6, "G": 1e9,
}  # fmt: skip
"""SI prefixes that stand alone behind a number."""
THOUSANDS = "thousands separators"
AMBIGUOUS = "ambiguous"
"""Notation of a number whose only separator may be a decimal mark."""
_OTHER_MARK = re.compile(r"[+-]?\d+[.,]\d+(?:[eE][+-]?\d+)?")


@dataclass(frozen=True)
class Written:
    """A cell that was understood: `value`, NaN where it stands for none; `unit` as it stands behind the number.

    `bound` is 1 for `> value`, −1 for `< value`, 0 else. `notation` says how it differs from a plain number.
    """

    value: float
    unit: str = ""
    bound: int = 0
    notation: str = ""


def read_cell(text: str, decimal: str = ".", thousands: str = "") -> Written | None:
    """What a cell says; None where it is not understood. `decimal` and `thousands` are the marks of the file."""
    plain = text.translate(_MINUS).strip(_BLANKS)
    word = plain.casefold().lstrip("+- ")
    if not plain or word in _MARKS or _ONLY_SIGNS.fullmatch(plain):
        return Written(math.nan, notation="no value")
    bound, plain = split_bound(plain)
    duration = _DURATION.fullmatch(plain)
    if duration is not None:
        seconds = 3600.0 * int(duration["h"]) + 60.0 * int(duration["m"]) + float(duration["s"].replace(",", "."))
        return Written(seconds, "s", bound, "hours, minutes and seconds")
    negative, notation, plain = _sign(plain)
    match = _NUMBER.fullmatch(plain)
    if match is None:
        return None
    size, how = _size(match["body"], decimal, thousands)
    if size is None:
        return None
    if match["point"] and (match["point"] != decimal or decimal in match["body"]):
        return None
    if (match["exponent"] or "")[:1] in ("+", "-") and not match["point"] and decimal not in match["body"]:
        return None  # two whole numbers, such as a range: Fortran leaves the letter out behind a fraction only
    exponent = int(match["exponent"].lstrip("eEdD")) if match["exponent"] else 0
    if match["exponent"] and match["exponent"][0] not in "eE":
        notation = notation or "an exponent of Fortran"
    try:
        value = float(f"{size}e{exponent}")
    except OverflowError:
        return None
    if (match["sign"] == "-") != negative:
        value = -value
    unit = (match["unit"] or "").strip(_BLANKS)
    if text.translate(_MINUS) != text:
        notation = notation or "another sign for minus"
    notation = how or ("a unit behind the number" if unit else "") or notation
    return Written(value, unit, bound, "a bound" if bound else notation)


def split_bound(text: str) -> tuple[int, str]:
    """1, −1 or 0, and the text without the sign that says so (`> 5`, `5+`)."""
    match = _BOUND.match(text)
    if match is not None:
        return (1 if match["low"] else -1), text[match.end() :].strip(_BLANKS)
    if text.endswith("+") and text[:-1].strip(_BLANKS)[-1:].isalnum():
        return 1, text[:-1].strip(_BLANKS)
    return 0, text


def _sign(text: str) -> tuple[bool, str, str]:
    """Whether the notation makes the number negative, what it is called, and the text without it."""
    if text.startswith("(") and text.endswith(")"):
        return True, "parentheses for minus", text[1:-1].strip(_BLANKS)
    if text.endswith("-") and text[:1] not in "+-":
        return True, "a minus behind the number", text[:-1].strip(_BLANKS)
    if text[:1] in "+-" and text[1:2].isspace():
        return False, "blanks behind the sign", text[0] + text[1:].strip(_BLANKS)
    return False, "", text


def _size(body: str, decimal: str, thousands: str) -> tuple[str | None, str]:
    """Digits with a point, and the notation; None where the separators fit neither mark."""
    mark = re.escape(decimal)
    if re.fullmatch(rf"\d+(?:{mark}\d*)?|{mark}\d+", body):
        return body.replace(decimal, "."), ""
    other = "," if decimal == "." else "."
    match = re.fullmatch(rf"\d{{1,3}}(?:(?P<by>[{other}'’{_BLANKS}])\d{{3}})(?:(?P=by)\d{{3}})*(?:{mark}\d*)?", body)
    if match is None:
        return None, ""
    by = match["by"]
    certain = by != other or by == thousands or decimal in body or body.count(by) > 1
    return body.replace(by, "").replace(decimal, "."), THOUSANDS if certain else AMBIGUOUS


def read_column(
    values: Float,
    empty: Bool,
    rows: Int,
    texts: Sequence[str],
    column: ColumnName,
    where: str,
    *,
    decimal: str = ".",
    thousands: str = "",
) -> Numbers:
    """A column whose plain numbers are read already, with what its other cells say.

    Parameters
    ----------
    values : (n,), NaN in the rows that are no plain numbers; filled in place
    empty : (n,), true where a cell holds nothing
    rows, texts : the cells that hold something else

    Raises
    ------
    RefusedError : cells in a notation that is not read, or that has two meanings
    """
    found = {text: read_cell(text, decimal, thousands) for text in dict.fromkeys(texts)}
    first = dict(zip(reversed(texts), reversed(rows.tolist()), strict=True))
    grouped = any(w is not None and w.notation == THOUSANDS for w in found.values())
    fractions = int(np.count_nonzero(values[np.isfinite(values)] % 1))
    other_mark = sum(_OTHER_MARK.fullmatch(text) is not None for text in texts)
    unknown: Counter[str] = Counter()
    nothing = 0
    example = ""
    units: dict[str, list[int]] = {}
    notations: dict[str, list[int]] = {}
    bounds: dict[int, int] = {}
    for row, text in zip(rows.tolist(), texts, strict=True):
        cell = found[text]
        if cell is None:
            unknown[text] += 1
            example = example or text
            continue
        if cell.notation == AMBIGUOUS and not grouped:
            raise _two_meanings(text, row, column, decimal, where, alike=other_mark, fractions=fractions)
        values[row] = cell.value
        if math.isnan(cell.value):
            nothing += 1
            example = example or text
            continue
        if cell.unit:
            units.setdefault(cell.unit, []).append(row)
        if cell.bound:
            bounds[row] = cell.bound
        notations.setdefault(THOUSANDS if cell.notation == AMBIGUOUS else cell.notation, []).append(row)
    for text in unknown:
        if _OTHER_MARK.fullmatch(text):
            raise _two_meanings(text, first[text], column, decimal, where, alike=other_mark, fractions=fractions)
    _check_understood(unknown, first, values.size, column, where)
    return Numbers(
        values,
        empty,
        nothing + sum(unknown.values()),
        example[:40],
        {unit: np.array(where_, dtype=np.int64) for unit, where_ in units.items()},
        {how: np.array(where_, dtype=np.int64) for how, where_ in notations.items() if how},
        bounds,
        {row: text[:40] for text, row in first.items()},
    )


def _two_meanings(
    text: str, row: int, column: ColumnName, decimal: str, where: str, *, alike: int, fractions: int
) -> RefusedError:
    """`alike` cells hold the other mark, `fractions` are written with the mark of the mapping: where these are most, the cells are wrong."""
    few = fractions > _MOST * alike
    others = f'; {fractions} others are fractions with "{decimal}"' if few else ""
    cells = "this cell" if alike == 1 else f"these {alike} cells"
    return RefusedError(
        f'column {column_label(column)} holds "{text[:40]}" in row {row + 1} of the data{others}',
        where=where,
        expected=f'numbers with the decimal mark "{decimal}", without thousands separators unless thousands names one',
        remedy=(
            f"Correct {cells} in the file, or name the text in missing of the mapping TOML; give thousands if it groups digits"
            if few
            else "Correct decimal in the mapping TOML, or give thousands beside it"
        ),
    )


def _check_understood(
    unknown: Mapping[str, int], first: Mapping[str, int], count: int, column: ColumnName, where: str
) -> None:
    """Refuses a column whose cells are not understood in a way that is no random damage."""
    numbers = {text: n for text, n in unknown.items() if _LIKE_A_NUMBER.match(text)}
    shapes: Counter[str] = Counter()
    for text, n in numbers.items():
        shapes[_shape(text)] += n
    words = [text for text in unknown if text not in numbers and _AFTER_A_WORD.match(text)]
    for shape, alike in Counter(_shape(text) for text in words).items():
        if alike >= ALIKE:
            example = next(text for text in words if _shape(text) == shape)
            n = sum(unknown[text] for text in words if _shape(text) == shape)
            raise refused_notation(example, n, count, first[example], column, where)
    if not shapes:
        return
    shape, n = shapes.most_common(1)[0]
    if n >= ALIKE and n >= _SHARE * sum(numbers.values()):
        example = next(text for text in numbers if _shape(text) == shape)
        raise refused_notation(example, n, count, first[example], column, where)


def refused_notation(example: str, number: int, count: int, row: int, column: ColumnName, where: str) -> RefusedError:
    """The error for cells that look like numbers in a notation that is not read; `row` from 0."""
    return RefusedError(
        f'column {column_label(column)} holds "{example[:40]}" in row {row + 1} of the data; {number} of {count}'
        " cells are written like it and are no numbers",
        where=where,
        expected="numbers: to leave out what is written in one way would drop values by how large they are",
        remedy="Export plain numbers; texts that stand for no value can be named in missing of the mapping TOML",
    )


def _shape(text: str) -> str:
    return re.sub(r"\d+", "0", text)
