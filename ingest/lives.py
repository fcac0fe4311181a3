"""Lives of specimens from a table: failures, survivors as people write them, and rows that say neither.

Whether a life is a failure tells the column `failed` (or `censored`), or the life itself (`> 3600`, `3600+`, `≥ 3600`).
Where a table has neither, every life is a failure, which a note says. A failure found at an inspection lies between two of
them (`alive_at`, `lifetime`), one that nobody saw alive is left-censored (`< 3600`), a specimen may come under watch late
(`entered`). A row that is not understood refuses the table:
without it the failures alone would be left, or the survivors counted as failures.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ingest.columns import Numbers
from ingest.plausible import find_unbelievable
from ingest.select import same_cell
from ingest.spans import ENDED, STARTED, Spans, note_contradictions, read_spans
from ingest.table_rows import TableRows, cell_text
from schemas.arrays import Bool, Float
from schemas.assumptions import Assumption
from schemas.errors import RefusedError
from schemas.lifetimes import OTHER, classify_failure_mode
from schemas.numbers import counted
from schemas.units import conversion

_CYCLES = {"cycle": 1.0, "cycles": 1.0, "kcycle": 1e3, "kcycles": 1e3, "Mcycle": 1e6, "Mcycles": 1e6}
"""Units of lives that count cycles of an alternating voltage or of a motion."""
_SUMMARY = re.compile(
    r"(mittel(wert)?|mean|average|avg\.?|median|summe|sum|total|gesamt|moyenne|stabw\.?|standardabweichung|st\.? ?dev\.?|[øσΣ∑])\b.*"
)
"""What stands in place of a specimen's name before a mean or a sum."""
_AGES = ("lifetime", "alive_at", "entered", "test_duration")


@dataclass(frozen=True)
class Lives:
    """Of the selected rows: `life_s` (n,), NaN where a row has none and is left out; `failed` (n,).

    `alive_at_s` (n,) NaN where a life is exact or right-censored; `entered_s` (n,) NaN where it was watched from its start.
    """

    life_s: Float
    failed: Bool
    alive_at_s: Float
    entered_s: Float


def read_lives(table: TableRows) -> Lives:
    """Lives and failures of a table. Raises `RefusedError` with the row that cannot be read, or contradicts itself."""
    is_spanned = "lifetime" not in table.mapping.columns and {STARTED, ENDED} <= set(table.mapping.columns)
    if not is_spanned:
        table.require("lifetime")
    _leave_out_no_specimens(table)
    period = _take_cycles(table)
    numbers, unit = (_no_numbers(table), "s") if is_spanned else table.written("lifetime", "s")
    seconds = conversion(unit, "s", where=f"{table.where}: lifetime").apply(numbers.values)[table.rows]
    seconds = seconds * period["lifetime"]
    rows = table.row_numbers - 1
    for why, here in find_unbelievable(numbers.values[table.rows], seconds, "s").items():
        row = int(rows[int(np.argmax(here))])
        raise table.refused_row(
            row, f"the life, {numbers.values[row]:g} {unit}, is {why}", "how long the specimen lived"
        )
    bounds = np.array([numbers.bounds.get(int(row), 0) for row in rows], dtype=np.int8)
    cells = [""] * seconds.size if is_spanned else [cell_text(cell) or "" for cell in table.cells("lifetime")]
    flags, earlier = _flags(table, bounds)
    failed = bounds <= 0 if flags is None else flags
    alive = table.numbers_or("alive_at", "s", None, seconds.size) * period["alive_at"]
    entered = table.numbers_or("entered", "s", None, seconds.size) * period["entered"]
    planned = _planned(table, seconds.size) * period["test_duration"]
    lives = seconds.copy()
    spans = read_spans(table, failed)
    if spans is not None:
        note_contradictions(table, spans, lives)
        _take_spans(table, spans, lives, cells)
    blank = []
    filled = 0
    for i, row in enumerate(rows.tolist()):
        shown = f'the life is "{cells[i][:40]}"'
        if bounds[i] < 0 and not failed[i]:
            raise table.refused_row(row, f"{shown}, and the specimen has survived", "one of the two")
        if bounds[i] > 0 and failed[i]:
            raise table.refused_row(row, f"{shown}, and the specimen has failed", "one of the two")
        if math.isnan(lives[i]) and not cells[i] and alive[i] > 0 and (flags is None or not failed[i]):
            lives[i], failed[i] = alive[i], False
        elif math.isnan(lives[i]) and not failed[i] and math.isfinite(planned[i]):
            lives[i] = planned[i]
            filled += 1
        elif math.isnan(lives[i]) and (cells[i] or not failed[i]):
            raise table.refused_row(
                row,
                f"{shown}, which is no number" if cells[i] else "a survivor without a life",
                "how long the specimen lived or was under test",
                "Write it into the row; of survivors, columns.test_duration or test_duration_s in the mapping may say it",
            )
        elif math.isnan(lives[i]) or (lives[i] == 0 and not failed[i]):
            lives[i] = math.nan
            blank.append(row + 1)
        elif lives[i] < 0 or not math.isfinite(lives[i]):
            raise table.refused_row(row, f"{shown}: {lives[i]:g} s", "a life not below 0")
        alive[i] = _last_seen_alive(table, row, shown, alive[i], lives[i], bool(failed[i]), bool(earlier[i]))
        if entered[i] < 0 or entered[i] >= lives[i]:
            raise table.refused_row(
                row,
                f"{shown}, and it came under watch at {entered[i]:g} s",
                "an age not below 0 and before the end of the life",
            )
        entered[i] = entered[i] if entered[i] > 0 else math.nan
    if blank:
        table.problems.append(
            f"{len(blank)} of {lives.size} rows have no life, or survived 0 s (row {blank[0]}): left out"
        )
    _note_inspections(table, alive, entered)
    if filled:
        table.notes.append(f"{filled} survivors have no life of their own: taken as the planned duration of their test")
        table.assumptions.append(
            Assumption(
                f"life of {filled} survivors",
                "the planned duration of their test",
                "they have no life of their own in the table",
                "survival",
            )
        )
    if flags is None:
        survivors = int((~failed).sum())
        table.notes.append(
            f"no column says which specimens failed: {survivors} lives are written as survived, the others count as"
            " failures"
        )
        because = "no column says which specimens failed"
        table.assumptions.append(Assumption("lives that are not written as survived", "failures", because, "survival"))
    return Lives(lives, failed, alive, entered)


def _no_numbers(table: TableRows) -> Numbers:
    """A column of no lives: what they are follows from dates."""
    return Numbers(np.full(table.rows.size, math.nan), np.ones(table.rows.size, dtype=bool))


def _take_spans(table: TableRows, spans: Spans, lives: Float, cells: list[str]) -> None:
    """Fills lives that are not written with the time between start and end, which a note and an assumption say."""
    taken = np.isnan(lives) & np.isfinite(spans.seconds) & np.array([not cell for cell in cells], dtype=bool)
    lives[taken] = spans.seconds[taken]
    if taken.any():
        numbers = ", ".join(str(int(row)) for row in table.row_numbers[taken][:8])
        said = f"{counted(int(taken.sum()), 'life', 'lives')}: the time between start and end, which are written to {spans.step_s:g} s"
        table.notes.append(f"{said} (row {numbers})")
        because = "the table has no life there"
        table.assumptions.append(
            Assumption(f"life of row {numbers}", "the time between start and end", because, "survival")
        )


def _take_cycles(table: TableRows) -> dict[str, Float]:
    """(n,) seconds that one unit of each age stands for, by its name: 1 but for ages in cycles, which are then read as numbers.

    Raises
    ------
    RefusedError
        A row in cycles has no frequency above 0, which alone says how long a cycle took.
    """
    count = int(table.rows.sum())
    seconds = {name: np.ones(count) for name in _AGES}
    columns = dict(table.mapping.columns)
    in_cycles = [name for name in _AGES if name in columns and (columns[name].unit or "").strip() in _CYCLES]
    if not in_cycles:
        return seconds
    frequency = table.numbers_or("frequency", "Hz", None, count)
    for i in np.flatnonzero(~(frequency > 0))[:1]:
        raise table.refused_row(
            int(table.row_numbers[i]) - 1,
            f"the {in_cycles[0]} is in cycles, and the row has no frequency above 0",
            "the frequency of the cycles",
            'Map columns.frequency, or state the same one for all rows: value = 1 and unit = "Hz"',
        )
    for name in in_cycles:
        seconds[name] = _CYCLES[str(columns[name].unit).strip()] / frequency
        columns[name] = replace(columns[name], unit="s", overrule_unit=True)
    table.mapping = replace(table.mapping, columns=columns)
    table.notes.append("lives in cycles are times by the frequency of their row")
    return seconds


def _leave_out_no_specimens(table: TableRows) -> None:
    """Leaves out the rows of a sheet that are no test of a specimen, each kind with a note.

    Such are rows with neither a life nor an outcome (torn when it was mounted), and rows without a voltage and without a specimen or an
    outcome, where the table has such columns (a largest value, a mean below the table), and of tables without outcomes those with neither a
    life nor a voltage (a remark below the table). A row with a life and an outcome is a test
    whatever else it lacks: cells that are merged, or copied from a group's first row, are empty in all others.
    """
    columns = table.mapping.columns
    outcome = next((name for name in ("failed", "censored") if name in columns), None)
    _leave_out_marked(table, outcome)
    says_blank = outcome is not None and any(
        str(value).strip() == "" for key in columns[outcome].meanings.values() for value in key
    )
    tests = _have_life_and_outcome(table, outcome, says_blank=says_blank)
    pairs = [(("specimen_id", "voltage"), "without a specimen and without a voltage")]
    if outcome is None:
        pairs.append((("lifetime", "voltage"), "without a life and without a voltage"))
    if outcome is not None and not says_blank and "alive_at" not in columns:
        pairs += [
            (("lifetime", outcome), "without a life and without an outcome"),
            (("voltage", outcome), "without a voltage and without an outcome"),
        ]
    for names, what in pairs:
        if any(name not in columns or columns[name].column is None for name in names):
            continue
        cells = [[cell_text(cell) for cell in table.cells(name)] for name in names]
        empty = np.array([not any(pair) for pair in zip(*cells, strict=True)], dtype=bool) & ~tests[table.rows]
        if empty.any() and not empty.all():
            where = np.flatnonzero(table.rows)[empty]
            numbers = ", ".join(str(int(row) + 1) for row in where[:8])
            table.notes.append(f"{counted(int(empty.sum()), 'row')} {what}: left out as no tests (row {numbers})")
            table.rows[where] = False


def _leave_out_marked(table: TableRows, outcome: str | None) -> None:
    """Leaves out rows of specimens that do not count, and those of means and sums below a group of specimens."""
    columns = table.mapping.columns
    where = np.flatnonzero(table.rows)
    ended = [None] * where.size if outcome is None else [cell_text(cell) for cell in table.cells(outcome)]
    if outcome is not None and (marks := columns[outcome].meanings.get("no_test")):
        void = np.array([any(same_cell(cell, mark) for mark in marks) for cell in table.cells(outcome)], dtype=bool)
        if void.any():
            table.notes.append(f"{counted(int(void.sum()), 'specimen')} marked as no test: left out")
            table.rows[where[void]] = False
            where, ended = where[~void], [e for e, gone in zip(ended, void, strict=True) if not gone]
    if "specimen_id" in columns and columns["specimen_id"].column is not None:
        names = [cell_text(cell) or "" for cell in table.cells("specimen_id")]
        pairs = zip(names, ended, strict=True)
        summary = np.array([_SUMMARY.fullmatch(n.lower()) is not None and not e for n, e in pairs], dtype=bool)
        if summary.any() and not summary.all():
            table.notes.append(f"{counted(int(summary.sum()), 'row')} of means or sums: left out as no specimens")
            table.rows[where[summary]] = False


def _have_life_and_outcome(table: TableRows, outcome: str | None, *, says_blank: bool) -> Bool:
    """(N,) rows of the whole file that say how long a specimen lived and how it ended; `says_blank`: an empty cell says it.

    A life that is written as a bound (`> 3600`) is its own outcome. What the mapping says of the duration of all tests is
    the life of rows whose outcome is written.
    """
    columns = table.mapping.columns
    found = np.zeros(table.rows.size, dtype=bool)
    if outcome is None:
        life = columns.get("lifetime")
        if life is not None and life.column is not None:
            found[list(table.file.numbers(life.column, life.index).bounds)] = True
        return found
    lived = np.zeros(int(table.rows.sum()), dtype=bool)
    for name in ("lifetime", "alive_at", "test_duration"):
        if name in columns and columns[name].column is not None:
            lived |= np.array([cell_text(cell) is not None for cell in table.cells(name)], dtype=bool)
    if STARTED in columns and ENDED in columns:
        both = zip(table.cells(STARTED), table.cells(ENDED), strict=True)
        lived |= np.array([None not in (cell_text(one), cell_text(other)) for one, other in both], dtype=bool)
    ended = np.array([cell_text(cell) is not None for cell in table.cells(outcome)], dtype=bool)
    is_planned = table.metadata.test_duration_s is not None
    found[table.rows] = (lived & (ended | says_blank)) | (ended & is_planned)
    return found


def _last_seen_alive(
    table: TableRows, row: int, shown: str, alive: float, life: float, failed: bool, earlier: bool
) -> float:
    """When the specimen was last found alive in s where its failure is only known to lie after that; NaN else."""
    if alive < 0 or alive > life:
        raise table.refused_row(
            row,
            f"{shown}, and it was seen alive at {alive:g} s, after that",
            "an inspection before the life, not below 0",
        )
    if not failed or alive == life:
        return math.nan
    if earlier:
        if alive > 0:
            raise table.refused_row(
                row, f"{shown}: it is left-censored, and was seen alive at {alive:g} s", "one of the two"
            )
        return 0.0
    return alive


def _note_inspections(table: TableRows, alive: Float, entered: Float) -> None:
    known = int(np.isfinite(alive).sum())
    if known:
        left = int((alive == 0).sum())
        table.notes.append(
            f"{known} failures are only known to lie between inspections, {left} of them before the first"
        )
    late = int(np.isfinite(entered).sum())
    if late:
        table.notes.append(f"{late} specimens came under watch late: those that failed before are not in the table")


def _planned(table: TableRows, count: int) -> Float:
    """(n,) planned duration of each test in s, NaN where nothing says it."""
    return table.numbers_or("test_duration", "s", table.metadata.test_duration_s, count)


def _flags(table: TableRows, bounds: NDArray[np.int8]) -> tuple[Bool | None, Bool]:
    """(n,) true for a failure, None where no column says it; and (n,) true for one that came earlier than the life says.

    `bounds` (n,) is below 0 where the life itself is written as an upper bound.
    """
    earlier = bounds < 0
    given = [name for name in ("failed", "censored") if name in table.mapping.columns]
    source = table.mapping.source or table.where
    if len(given) != 1:
        if given:
            raise RefusedError(
                "columns.failed and columns.censored are both mapped", where=source, expected="one of them"
            )
        return None, earlier
    name = given[0]
    meanings = table.mapping.columns[name].meanings
    if not any(meanings.get(key) for key in ("failed", "censored", "left_censored")):
        raise RefusedError(
            f"columns.{name} does not say which values mean what",
            where=source,
            expected="failed_values = [1] and censored_values = [0], as this table means it",
            remedy="Look it up at the source of the table: the convention is not the same everywhere",
        )
    failed = np.zeros(int(table.rows.sum()), dtype=bool)
    for i, cell in enumerate(table.cells(name)):
        means = [m for m, values in meanings.items() if any(same_cell(cell, value) for value in values)]
        if len(means) != 1:
            both = " and ".join(m.replace("_", "-") for m in means) or "neither failed nor censored"
            raise RefusedError(
                f'"{cell_text(cell) or ""}" in row {table.row_numbers[i]} of the data means {both}',
                where=table.where,
                expected="each value in one of failed_values and censored_values",
                remedy=f"Correct [columns.{name}] in the mapping TOML",
            )
        failed[i] = means[0] != "censored"
        earlier[i] |= means[0] == "left_censored"
    return failed, earlier


def read_failure_modes(table: TableRows, failed: Bool) -> list[tuple[str | None, str | None]]:
    """The failure mode of each selected row and what the table calls it; (None, None) where it says nothing. `failed` (n,) of the rows.

    Words of failures that neither the mapping nor `schemas.lifetimes` knows are `other`, which a note says.
    """
    if "failure_mode" not in table.mapping.columns:
        return [(None, None)] * int(table.rows.sum())
    meanings = table.mapping.columns["failure_mode"].meanings
    found: list[tuple[str | None, str | None]] = []
    unknown: dict[str, None] = {}
    for i, cell in enumerate(table.cells("failure_mode")):
        written = cell_text(cell)
        if not written:
            found.append((None, None))
            continue
        said = [mode for mode, values in meanings.items() if any(same_cell(cell, value) for value in values)]
        if len(said) > 1:
            raise RefusedError(
                f'"{written}" in row {table.row_numbers[i]} of the data means {" and ".join(said)}',
                where=table.where,
                expected="each value in one list",
                remedy="Correct [columns.failure_mode] in the mapping TOML",
            )
        mode = said[0] if said else classify_failure_mode(written)
        if mode == OTHER and not said and failed[i]:
            unknown[written] = None
        found.append((mode, written))
    if unknown:
        shown = ", ".join(f'"{text[:40]}"' for text in list(unknown)[:5])
        table.notes.append(
            f"failure modes that no word tells count as other: {shown}; columns.failure_mode in the mapping may say what they"
            " mean"
        )
    return found
