"""The rows of a table that stands instead of recordings, read through its mapping: units, constants, selections, order.

What the columns of each kind mean is in `ingest.tables`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ingest.assemble import scaled_numbers, unit_of
from ingest.cell_units import plain_unit
from ingest.clocks import duration_s
from ingest.columns import ColumnFile, Numbers
from ingest.mapping import FileMapping
from ingest.mapping_keys import FREQUENCY_RESPONSE, LIFETIMES, RELAXATION
from ingest.notations import split_bound
from ingest.plausible import without_unbelievable
from ingest.select import selected_rows
from ingest.times import with_zone, zone_of
from schemas.arrays import Bool, Complex, Float, Int
from schemas.assumptions import Assumption
from schemas.errors import RefusedError
from schemas.metadata import RecordingMetadata, TableMetadata, check_keys
from schemas.units import conversion

MODULUS, STIFFNESS = "modulus", "stiffness"
CLOCKS = ("hh:mm", "mm:ss")
"""How durations of two parts are written."""
_ALIKE = 0.1
"""Difference of repeats from their mean that a stable film shows: a rheometer's noise is 1 to 2 %, a kelvin off its set point 5 to 10 %."""
_RESPONSES: Mapping[str, tuple[str, bool, int]] = {
    "MPa": (MODULUS, False, 0),
    "N/mm": (STIFFNESS, False, 0),
    "1/MPa": (MODULUS, True, 0),
    "mm/N": (STIFFNESS, True, 0),
    "mm/s/N": (STIFFNESS, True, 1),
    "mm/s^2/N": (STIFFNESS, True, 2),
    "N*s/mm": (STIFFNESS, False, 1),
    "N*s^2/mm": (STIFFNESS, False, 2),
}
"""Units of complex responses: what they become, whether by inversion, and by which power of jω."""

_OF_LIVES = ("voltage_setpoint_kv", "test_duration_s", "failure_site", "failure_region")
_OF_RESPONSES = ("strain_pp", "reference_temperature_c", "vertical_shift")
_IDLE_KEYS: Mapping[str, tuple[str, ...]] = {
    LIFETIMES: _OF_RESPONSES,
    FREQUENCY_RESPONSE: _OF_LIVES,
    RELAXATION: (*_OF_LIVES, "strain_pp"),
}
"""Keys of which nothing is made for a kind of table."""


class TableRows:
    """The selected rows of a file of columns, read through the mapping."""

    def __init__(self, file: ColumnFile, mapping: FileMapping, where: str) -> None:
        self.file, self.mapping, self.where = file, mapping, where
        zone = zone_of(mapping.time, mapping.source)
        check_keys(mapping.recording, RecordingMetadata, "recording", mapping.source)
        self.metadata = TableMetadata.parse(with_zone(mapping.recording, zone), where=where)
        self.problems: list[str] = list(file.problems)
        self.notes: list[str] = list(file.notes)
        if self.metadata.extra:
            unused = ", ".join(key[:80] for key in list(self.metadata.extra)[:40])
            self.notes.append(f"keys of recording that no table uses, kept and not used: {unused}")
        given = self.metadata.to_text()
        idle = [key for key in _IDLE_KEYS.get(mapping.kind, ()) if key in given]
        if idle:
            self.notes.append(f"keys of recording that a table of kind {mapping.kind} does not use: {', '.join(idle)}")
        self.assumptions: list[Assumption] = []
        self.rows = self._selected()

    @property
    def remarks(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Problems and notes, those of the file first."""
        return tuple(self.problems), tuple(self.notes)

    @property
    def row_numbers(self) -> Int:
        """Numbers from 1 of the selected rows in the file."""
        return np.flatnonzero(self.rows) + 1

    def require(self, *names: str) -> None:
        """Raises `RefusedError` for the first of these columns that is not mapped."""
        missing = [name for name in names if name not in self.mapping.columns]
        if missing:
            raise RefusedError(
                f"columns.{missing[0]} is missing",
                where=self.mapping.source or self.where,
                expected=f'for kind "{self.mapping.kind}": ' + ", ".join(names),
                remedy="Add it to the mapping TOML",
            )

    def one_of(self, *pairs: tuple[str, ...]) -> tuple[str, ...]:
        """The one set of columns that are all mapped; `RefusedError` when none or several are."""
        found = [pair for pair in pairs if all(name in self.mapping.columns for name in pair)]
        if len(found) != 1:
            raise RefusedError(
                f"{len(found)} complete pairs of columns",
                where=self.mapping.source or self.where,
                expected="one of " + " or ".join(" and ".join(pair) for pair in pairs),
                remedy="Correct the mapping TOML",
            )
        of_pairs = dict.fromkeys(name for pair in pairs for name in pair)
        beside = [name for name in of_pairs if name in self.mapping.columns and name not in found[0]]
        if beside:
            raise RefusedError(
                f"columns.{beside[0]} is not used beside {' and '.join(found[0])}",
                where=self.mapping.source or self.where,
                expected="only columns that have an effect",
                remedy="Correct the mapping TOML",
            )
        return found[0]

    def numbers(self, name: str, canonical: str) -> Float:
        """A column of the selected rows in a canonical unit, NaN where a cell has no number."""
        column = self.mapping.columns[name]
        if column.value is not None:
            return self._constant(name, canonical)
        found, unit = self.written(name, canonical)
        if found.bounds:
            row = min(found.bounds)
            raise self.refused_row(row, f'{name} is "{found.odd.get(row, "")}"', "a value, not a bound")
        if found.texts:
            self.problems.append(f'{name}: {found.texts} cells hold no number, such as "{found.example}"')
        whole = found.values
        if column.fill_down:
            above = self._filled_above(name)
            whole = np.where(above < 0, math.nan, whole[above])
        raw = whole[self.rows]
        values = conversion(unit, canonical, where=f"{self.where}: {name}").apply(raw)
        return without_unbelievable(raw, values, name, canonical, self.problems, where=self.where)

    def written(self, name: str, canonical: str) -> tuple[Numbers, str]:
        """A column of the whole file as its cells say, bounds included, and the unit of its values."""
        column = self.mapping.columns[name]
        if column.format is not None:
            return self._of_clock(name), canonical
        unit = self._unit(name, canonical)
        found = scaled_numbers(self.file, column, name, unit, where=self.where, few_are_damage=False)
        self.notes += found.notes
        self._check_length(name, found.numbers.values.size)
        return found.numbers, unit

    def _of_clock(self, name: str) -> Numbers:
        """A column of durations of two parts, `64:33`, of the whole file in s."""
        column = self.mapping.columns[name]
        assert column.column is not None  # one with a value has no format
        if column.format not in CLOCKS:
            raise RefusedError(
                f'columns.{name}.format is "{str(column.format)[:40]}"',
                where=self.mapping.source or self.where,
                expected=" or ".join(CLOCKS),
                remedy="Correct the mapping TOML",
            )
        texts = [cell_text(cell) or "" for cell in self.file.cells(column.column, column.index)]
        self._check_length(name, len(texts))
        bounds: dict[int, int] = {}
        values = np.full(len(texts), math.nan)
        for row, text in enumerate(texts):
            bound, plain = split_bound(text)
            seconds = duration_s(plain, minutes=True)
            if seconds is None:
                continue
            values[row] = seconds * (60.0 if column.format == CLOCKS[0] and plain.count(":") == 1 else 1.0)
            bounds |= {row: bound} if bound else {}
        empty = np.array([not text for text in texts], dtype=bool)
        odd = [text for text, value in zip(texts, values, strict=True) if text and math.isnan(value)]
        written = {row: texts[row] for row in bounds}
        return Numbers(values, empty, len(odd), odd[0] if odd else "", bounds=bounds, odd=written)

    def _unit(self, name: str, canonical: str) -> str:
        """The unit of a column; the canonical one where every number carries its own."""
        column = self.mapping.columns[name]
        if column.column is not None and column.unit is None and not self.file.unit(column.column):
            found = self.file.numbers(column.column, column.index)
            if found.units and sum(rows.size for rows in found.units.values()) == int(np.isfinite(found.values).sum()):
                return canonical
        return unit_of(self.file, column, name, canonical, where=self.where)

    def unit_as_written(self, name: str) -> str:
        """The unit in which the file, or the mapping, has a column; "" where neither names one."""
        column = self.mapping.columns[name]
        return str(column.unit or ("" if column.column is None else self.file.unit(column.column)) or "")

    def refused_row(self, row: int, problem: str, expected: str, remedy: str = "") -> RefusedError:
        """The error for one row of the file, counted from 0."""
        return RefusedError(
            f"row {row + 1} of the data: {problem}",
            where=self.where,
            expected=expected,
            remedy=remedy or "Correct the row, or the mapping TOML",
        )

    def numbers_or(self, name: str, canonical: str, default: float | None, count: int) -> Float:
        """A column as `numbers`, or `count` times the default (NaN for None) where it is not mapped."""
        if name in self.mapping.columns:
            return self.numbers(name, canonical)
        return np.full(count, math.nan if default is None else default)

    def cells(self, name: str) -> list[Any]:
        """The cells of a column in the selected rows, as they stand."""
        column = self.mapping.columns[name]
        if column.value is not None or column.column is None:
            return [column.value] * int(self.rows.sum())
        cells = self.file.cells(column.column, column.index)
        self._check_length(name, len(cells))
        if column.fill_down:
            cells = [cells[i] if i >= 0 else None for i in self._filled_above(name)]
        return [cell for cell, keep in zip(cells, self.rows, strict=True) if keep]

    def _filled_above(self, name: str) -> NDArray[np.intp]:
        """(N,) of each row of the file the row of the last filled cell of a column, its own included; −1 where there is none."""
        column = self.mapping.columns[name]
        assert column.column is not None  # one with a value is not filled down
        cells = self.file.cells(column.column, column.index)
        rows = [i if cell_text(cell) is not None else -1 for i, cell in enumerate(cells)]
        return np.maximum.accumulate(np.array(rows, dtype=np.intp))

    def texts_or(self, name: str, default: str | None, count: int) -> list[str | None]:
        """A column as text, the default where a cell is empty or the column is not mapped."""
        if name not in self.mapping.columns:
            return [default] * count
        return [cell_text(cell) or default for cell in self.cells(name)]

    def groups_or(self, name: str, default: str | None, count: int) -> list[str | None]:
        """A column of names of groups, as `texts_or`. Names that differ by case or blanks only are one, in the spelling that most rows have,
        with a note: a group of one that nobody meant would be compared with all others."""
        found = self.texts_or(name, default, count)
        spellings: dict[str, Counter[str]] = {}
        for text in found:
            if text is not None:
                spellings.setdefault(" ".join(text.split()).casefold(), Counter())[text] += 1
        meant = {text: own.most_common(1)[0][0] for own in spellings.values() for text in own}
        other = [f'"{text}" is read as "{one}"' for text, one in meant.items() if text != one]
        if other:
            self.notes.append(f"{name}: {', '.join(other[:5])}{', …' if len(other) > 5 else ''}")
        return [None if text is None else meant[text] for text in found]

    def elastic(self, name: str) -> tuple[Float, str]:
        """A column in MPa or N/mm, and which of the two its unit makes it."""
        canonical = self._of_one(("MPa", "N/mm"), name, "a modulus (such as MPa) or a stiffness (such as N/mm)")
        return self.numbers(name, canonical), MODULUS if canonical == "MPa" else STIFFNESS

    def response(self, frequency_hz: Float) -> tuple[Complex, str]:
        """The column `response` of complex numbers as a modulus in MPa or a stiffness in N/mm, and which of the two.

        Its unit says what it is: a modulus, a stiffness or what follows from one by powers of jω and inversion. With
        x ~ e^{jωt} a velocity is jω x and an acceleration (jω)² x.
        """
        column = self.mapping.columns["response"]
        if column.column is None:
            raise RefusedError("response has no column", where=self.where, expected="a column of complex numbers")
        values = np.asarray(self.file.cells(column.column, column.index))
        if values.dtype.kind != "c":
            raise RefusedError(
                f"column {column.label} for response holds no complex numbers",
                where=self.where,
                expected="complex numbers",
                remedy="Map storage and loss, or magnitude and phase, in the mapping TOML",
            )
        self._check_length("response", values.size)
        expected = "a modulus, a stiffness, a compliance, a mobility or an accelerance (such as MPa, N/mm, m/N, m/s/N)"
        canonical = self._of_one(tuple(_RESPONSES), "response", expected)
        unit = unit_of(self.file, column, "response", canonical, where=self.where)
        change = conversion(unit, canonical, where=f"{self.where}: response")
        found: Complex = (values.astype(np.complex128) * column.scale + column.offset)[self.rows] * change.scale
        measured_as, is_inverse, power = _RESPONSES[canonical]
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            found = (2j * math.pi * frequency_hz) ** power * (1 / found if is_inverse else found)
        if is_inverse or power:
            self.notes.append(f'the response is in "{unit}": the stiffness is computed from it')
        return np.where(np.isfinite(found), found, complex(math.nan, math.nan)), measured_as

    def own_frequency(self, name: str) -> Float | None:
        """(n,) frequencies in Hz of the selected rows where the file gives them to a column, None where it does not."""
        column = self.mapping.columns[name].column
        own = None if column is None else self.file.own_frequency(column)
        return None if own is None or own.size != self.rows.size else own[self.rows]

    def ratio(self, above: str, below: str) -> Float | None:
        """One column over another, lengths or angles, NaN where it does not exist; None where neither is mapped."""
        given = [name for name in (above, below) if name in self.mapping.columns]
        if not given:
            return None
        self.require(above, below)
        units = [self._of_one(("mm", "rad"), name, "a length (such as mm) or an angle (such as rad)") for name in given]
        if units[0] != units[1]:
            raise RefusedError(
                f"{above} is in {units[0]}, {below} in {units[1]}",
                where=self.where,
                expected="two lengths or two angles",
                remedy=f"Correct unit of [columns.{above}] or [columns.{below}] in the mapping TOML",
            )
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.abs(self.numbers(above, units[0]) / self.numbers(below, units[1]))
        return np.where(np.isfinite(found), found, math.nan)

    def _of_one(self, canonicals: tuple[str, ...], name: str, expected: str) -> str:
        """That of several canonical units which a column's unit converts to."""
        column = self.mapping.columns[name]
        unit = column.unit or (None if column.column is None else self.file.unit(column.column)) or ""
        for canonical in canonicals:
            try:
                conversion(plain_unit(unit) or "", canonical)
            except RefusedError:
                continue
            return canonical
        raise RefusedError(
            f'{name} has the unit "{unit[:40]}"',
            where=self.where,
            expected=expected,
            remedy=f"Correct unit of [columns.{name}] in the mapping TOML",
        )

    def note_signs(self, value: Complex) -> None:
        """Notes losses and storages that no passive material has."""
        lossless = int((value.imag < 0).sum())
        if lossless:
            self.notes.append(f"{lossless} of {value.size} rows have a negative loss: the machine's own compliance?")
        if (value.real <= 0).any():
            self.notes.append(f"{int((value.real <= 0).sum())} of {value.size} rows have a storage of 0 or below")

    def _constant(self, name: str, canonical: str) -> Float:
        column = self.mapping.columns[name]
        if column.unit is None or isinstance(column.value, str | bool):
            raise RefusedError(
                f"columns.{name}: value {column.value!r} with unit {column.unit!r}",
                where=self.mapping.source or self.where,
                expected="a number and its unit",
            )
        value = np.full(int(self.rows.sum()), float(column.value) * column.scale + column.offset)
        return conversion(column.unit, canonical, where=f"{self.where}: {name}").apply(value)

    def _selected(self) -> Bool:
        first = next((c for c in self.mapping.columns.values() if c.column is not None), None)
        if first is None or first.column is None:
            raise RefusedError("no column of the file is mapped", where=self.mapping.source or self.where)
        count = len(self.file.cells(first.column, first.index))
        return selected_rows(self.file, self.mapping.select, count, self.where)

    def _check_length(self, name: str, found: int) -> None:
        if found != self.rows.size:
            raise RefusedError(
                f"columns.{name} has {found} rows, others {self.rows.size}",
                where=self.where,
                expected="columns of the same length",
            )


def stiffness_scale(metadata: TableMetadata, measured_as: str, where: str) -> float:
    """N/mm per MPa of a modulus; 1 for a stiffness."""
    sides = (metadata.film_width_mm, metadata.film_thickness_mm, metadata.film_length_mm)
    if measured_as == STIFFNESS or sides == (None, None, None):
        return 1.0
    width, thickness, length = sides
    if width is None or thickness is None or length is None:
        raise RefusedError(
            "the geometry is incomplete: a modulus becomes a stiffness with all of film_length_mm, film_width_mm and "
            "film_thickness_mm",
            where=where,
            expected="all three, or none (a 1 mm cube)",
            remedy="Complete [recording] in the mapping TOML",
        )
    return width * thickness / length


def standard_error(table: TableRows, measured_as: str, count: int) -> Float:
    """The standard errors in the unit of the values (MPa or N/mm), NaN where the table has none."""
    if "standard_error" not in table.mapping.columns:
        return np.full(count, math.nan)
    error, same = table.elastic("standard_error")
    if same != measured_as or (error < 0).any():
        raise RefusedError(
            "standard_error is negative" if same == measured_as else f"standard_error is a {same}",
            where=table.where,
            expected=f"standard errors of the {measured_as}",
        )
    return error


def ordered(
    table: TableRows, axis: Float, usable: Bool, name: str, unit: str, *, left_out: Bool | None = None
) -> NDArray[np.intp]:
    """Positions of the usable rows in ascending order. Rows that are `left_out` are no loss."""
    usable = usable & np.isfinite(axis)
    unusable = ~usable if left_out is None else ~usable & ~left_out
    lost = int(unusable.sum())
    if not usable.any():
        raise RefusedError("no row holds numbers above 0", where=table.where, expected=f"{name} and value in each row")
    if lost:
        row = table.row_numbers[np.flatnonzero(unusable)[0]]
        table.problems.append(f"{lost} of {usable.size} rows lack a number (first: row {row} of the data): left out")
    keep = np.flatnonzero(usable)
    order = keep[np.argsort(axis[keep], kind="stable")]
    twice = np.flatnonzero(np.diff(axis[order]) == 0)
    if twice.size:
        raise RefusedError(
            f"{name} {axis[order][twice[0]]:g} {unit} stands in two rows ({twice.size} repeats in all)",
            where=table.where,
            expected=f"each {name} once",
            remedy='Pick one set of several with [[select]] in the mapping TOML, or say repeated = "mean" where they repeat one',
        )
    if (order != keep).any():
        table.notes.append(f"the rows were not in the order of {name}")
    return order


def join_repeats(table: TableRows, axis: Float, value: Complex, name: str) -> list[NDArray[np.intp]] | None:
    """Which rows stand at the same frequency (or time), where the mapping says that their mean is meant; None where it does not.

    A note tells how many there are and by how much they differ; where that is much, it is a problem: the film, or the test, was not
    the same.
    """
    usable = np.flatnonzero(np.isfinite(axis) & (axis > 0) & np.isfinite(value))
    if table.mapping.repeated is None or np.unique(axis[usable]).size == usable.size:
        return None
    order = usable[np.argsort(axis[usable], kind="stable")]
    groups = np.split(order, np.flatnonzero(np.diff(axis[order]) > 0) + 1)
    spread = [float(np.max(np.abs(value[g] / np.mean(value[g]) - 1))) for g in groups if g.size > 1]
    middle = float(np.median(spread))
    said = f"{order.size} rows stand at {len(groups)} values of the {name}: their means are taken, from which they differ by {middle:.2g}"
    (table.problems if middle > _ALIKE else table.notes).append(said)
    return groups


def cell_text(cell: Any) -> str | None:
    """A cell as text; whole numbers of a spreadsheet without their decimals; None when it is empty."""
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return None
    text = str(int(cell)) if isinstance(cell, float) and cell.is_integer() else str(cell).strip()
    if len(text) > 10_000 or "\x00" in text:
        text = text.replace("\x00", "")[:10_000]
    return text or None
