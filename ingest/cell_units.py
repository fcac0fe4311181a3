"""Units as a file gives them (header, unit row, behind single numbers), against those of the mapping.

A mapping's unit that says something else than the file's is refused, where both are understood. Does not belong here:
how units convert (`schemas.units`), how cells are written (`ingest.notations`).
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

import numpy as np

from ingest.columns import Numbers
from ingest.notations import ALIKE, PREFIXES, THOUSANDS
from schemas.arrays import Float, Int
from schemas.errors import RefusedError
from schemas.units import ANY, Conversion, conversion

_BRACKETS = ("[]", "()", "{}", "<>")
_UNIT_IN_NAME = re.compile(
    r"^(?P<name>.*?)\s*(?:\[(?P<a>[^\[\]]*)\]|\((?P<b>[^()]*)\)|/\s*(?P<c>[^/\s]{1,8}))\s*$", re.DOTALL
)
SUFFIXES = frozenset(
    (
        *("s", "ms", "us", "µs", "min", "h", "V", "kV", "mV", "N", "mN", "kN", "gf", "lbf", "mm", "um", "µm", "m"),
        *("cm", "in", "pF", "nF", "A", "mA", "uA", "µA", "nA", "Pa", "kPa", "MPa", "Hz", "degC", "degF", "K"),
    )
)
"""Units as they stand behind a name: `force_V`, `HV_kV`."""
_WRITTEN = re.compile(r"^(?P<name>.+?)(?:\s+(?:in|-)\s+|[_ ])(?P<unit>[A-Za-zµ]{1,4})$")
_IN_UNIT = re.compile(r"^(?P<name>.+?)\s+in\s+(?P<unit>\S{1,10})$")
"""A unit in whatever characters behind `in`: `T in °C`."""
_SHOUTED_SECONDS, _CLOCK = ("S", "SEC", "Sec"), re.compile(r"(t|time|zeit|temps|elapsed|run ?time)\b|time$")
"""Seconds behind the name of a clock in capitals: `Time_S`; behind another name they are siemens, or an index."""
_SI_BASE = {"n": "N", "v": "V", "kv": "kV", "hz": "Hz", "mpa": "MPa", "kpa": "kPa", "pa": "Pa", "pf": "pF"}
"""Units that a program which writes all in small letters means."""
_ALSO_WORDS = frozenset(("in", *(unit for unit in SUFFIXES if len(unit) == 1)))
"""Units that may as well be a word or an index behind a name: `x_in`, `F_N` of a normal force, `x_m` of a measured one."""
_TAKES_PREFIX = ("V", "N", "A", "F", "Pa", "Hz", "W", "J")
"""Units that a prefix alone behind a number belongs to (`6.000k` in V); one that has a prefix takes no second."""
_MEASURED = (
    "N",
    "mm",
    "kV",
    "pF",
    "µA",
    "degC",
    "kPa",
    "bar",
    "s",
    "Hz",
    "rad",
    "N/mm",
    "mm/N",
    "mm/s/N",
    "mm/s^2/N",
    "1",
)
_FEW = 0.2
"""A notation in fewer cells than `ALIKE` and this share of a column is damage: a random byte makes a `-` or an `m`."""


def name_and_unit(name: str) -> tuple[str, str]:
    """A column's name without the unit that stands in it, and that unit: `Force (mN)`, `Weg [mm]`, `F / N`."""
    match = _UNIT_IN_NAME.match(name)
    if match is None:
        return name, ""
    return match["name"], match["a"] or match["b"] or match["c"] or ""


def unit_behind(name: str) -> tuple[str, str]:
    """A column's name and the unit behind it without brackets: `HV_kV`, `Weg µm`, `T in °C`; no unit where none is known there."""
    match = _IN_UNIT.match(name)
    if match is not None and is_unit(match["unit"]):
        return match["name"], match["unit"]
    match = _WRITTEN.match(name)
    if match is None:
        return name, ""
    written = match["unit"]
    if written in _SHOUTED_SECONDS and _CLOCK.match(match["name"].lower()):
        return match["name"], "s"
    known = _SI_BASE.get(written, written) if name == name.lower() else written
    return (match["name"], known) if known in SUFFIXES else (name, "")


def plain_unit(text: str | None) -> str | None:
    """A unit without the brackets that exporters put around it."""
    text = (text or "").strip()
    while len(text) > 1 and text[0] + text[-1] in _BRACKETS and _enclose(text):
        text = text[1:-1].strip()
    return text or None


def _enclose(text: str) -> bool:
    """Whether the first and the last character are a pair of brackets, and not the first and last of several."""
    depth = 0
    for character in text[:-1]:
        depth += (character == text[0]) - (character == text[-1])
        if not depth:
            return False
    return True


def same_unit(one: str, other: str, canonical: str) -> bool | None:
    """Whether two units mean the same; None where one of them is not understood, or they measure different things."""
    try:
        a, b = conversion(one, canonical), conversion(other, canonical)
    except RefusedError:
        return None
    return math.isclose(a.scale, b.scale, rel_tol=1e-9) and math.isclose(
        a.offset, b.offset, rel_tol=1e-9, abs_tol=1e-12
    )


def is_unit(text: str) -> bool:
    """Whether a text is a unit of anything that is measured here."""
    for canonical in _MEASURED:
        try:
            conversion(text, canonical)
        except RefusedError:
            continue
        return True
    return False


def checked_unit(own: str | None, said: str, label: str, canonical: str, name: str, *, where: str) -> str:
    """The mapping's unit, after the file's own has been compared with it. Raises `RefusedError` where they contradict.

    What the file says in a way that is not understood does not overrule the mapping.
    """
    own = plain_unit(own)
    conversion(said, canonical, where=f"{where}: {name}")
    if not own or canonical == ANY or same_unit(own, said, canonical) or not is_unit(own):
        return said
    raise _contradiction("unit row says", own, label, said, name, where)


def check_name(column: str | int | None, said: str, canonical: str, name: str, *, where: str) -> None:
    """Refuses a unit of the same kind in the column's name that is another one than the mapping's (`F (mN)` or `F_mN`, and N)."""
    unit = ""
    if isinstance(column, str):
        behind = unit_behind(column)[1]
        unit = name_and_unit(column)[1] or ("" if behind in _ALSO_WORDS else behind)
    if unit and canonical != ANY and same_unit(unit, said, canonical) is False:
        raise _contradiction("name says", unit, f'"{column}"', said, name, where)


def _contradiction(where_found: str, own: str, label: str, said: str, name: str, where: str) -> RefusedError:
    return RefusedError(
        f'the {where_found} "{own}" for column {label}, the mapping says "{said}" for {name}',
        where=where,
        expected="the same unit in both",
        remedy="Correct unit in the mapping TOML; where the file is wrong, say overrule_unit = true beside it",
    )


@dataclass(frozen=True)
class Resolved:
    """Numbers all in one unit, with notes about how some of them are written."""

    numbers: Numbers
    notes: tuple[str, ...] = ()


def resolved(
    numbers: Numbers, unit: str, label: str, name: str, *, where: str, few_are_damage: bool, scaled: bool = False
) -> Resolved:
    """Numbers whose cells may carry units of their own, all in `unit`.

    `few_are_damage`: in a record of samples a notation that occurs once or twice is a damaged byte, and its samples are
    lost. `scaled`: the mapping scales the column, so that it cannot be told what a unit behind a number belongs to.

    Raises `RefusedError` for units that do not convert, and for bounds (`> 5`) where values are expected.
    """
    values, lost = numbers.values, np.zeros(numbers.values.size, dtype=bool)
    notes = [f"{name}: {note}" for note in numbers.notes]
    for how, rows in numbers.notations.items():
        if few_are_damage and how != THOUSANDS and _are_few(rows, values.size):
            lost[rows] = True
        else:
            notes.append(
                f'{name}: {rows.size} numbers are written with {how}, such as "{numbers.odd.get(int(rows[0]), "")}"'
            )
    bounds = [row for row in numbers.bounds if not lost[row]]
    if few_are_damage and bounds:
        raise _odd(
            numbers, bounds[0], label, where, "values: what is only known to be above or below something is none"
        )
    values = values.copy() if numbers.units or lost.any() else values
    for own, rows in numbers.units.items():
        change = None if scaled else _change(own, unit)
        if change is None and few_are_damage and _are_few(rows, values.size):
            lost[rows] = True
        elif change is None:
            expected = f'plain numbers, or the unit "{unit}" or one that converts to it'
            raise _odd(numbers, int(rows[0]), label, where, expected + (", and no scale" if scaled else ""))
        else:
            values[rows] = change.apply(values[rows])
    if lost.any():
        values[lost] = np.nan
    example = numbers.example or next((numbers.odd[int(r)] for r in np.flatnonzero(lost) if int(r) in numbers.odd), "")
    found = replace(
        numbers, values=values, texts=numbers.texts + int(lost.sum()), example=example, units={}, notations={}
    )
    return Resolved(found, tuple(notes))


def with_own_units(numbers: Numbers, unit: str, label: str, *, where: str) -> Float:
    """The values of a column of times in `unit`; see `resolved`."""
    return resolved(numbers, unit, label, "time", where=where, few_are_damage=True).numbers.values


def _are_few(rows: Int, count: int) -> bool:
    return rows.size < ALIKE and rows.size < _FEW * count


def _change(own: str, unit: str) -> Conversion | None:
    """Conversion from what stands behind a number to the column's unit; None where it has no single meaning."""
    try:
        as_unit = conversion(own, unit)
    except RefusedError:
        as_unit = None
    if own in PREFIXES:
        if as_unit is None and unit in _TAKES_PREFIX:
            return Conversion(PREFIXES[own])
        return as_unit if own == "K" else None
    return as_unit


def _odd(numbers: Numbers, row: int, label: str, where: str, expected: str) -> RefusedError:
    return RefusedError(
        f'column {label} holds "{numbers.odd.get(row, "")}" in row {row + 1} of the data',
        where=where,
        expected=expected,
        remedy="Export plain numbers, or correct unit in the mapping TOML",
    )
