"""Lives of specimens from a table: failures, survivors as people write them, and rows that say neither.

Whether a life is a failure tells the column `failed` (or `censored`), or the life itself (`> 3600`, `3600+`, `≥ 3600`).
Where a table has neither, every life is a failure, which a note says. A row that is not understood refuses the table:
without it the failures alone would be left, or the survivors counted as failures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ingest.plausible import find_unbelievable
from ingest.select import same_cell
from ingest.table_rows import TableRows, cell_text
from schemas.arrays import Bool, Float
from schemas.assumptions import Assumption
from schemas.errors import RefusedError
from schemas.units import conversion


@dataclass(frozen=True)
class Lives:
    """Of the selected rows: `life_s` (n,), NaN where a row has none and is left out; `failed` (n,)."""

    life_s: Float
    failed: Bool


def read_lives(table: TableRows) -> Lives:
    """Lives and failures of a table. Raises `RefusedError` with the row that cannot be read, or contradicts itself."""
    table.require("lifetime")
    numbers, unit = table.written("lifetime", "s")
    seconds = conversion(unit, "s", where=f"{table.where}: lifetime").apply(numbers.values)[table.rows]
    rows = table.row_numbers - 1
    for why, here in find_unbelievable(numbers.values[table.rows], seconds, "s").items():
        row = int(rows[int(np.argmax(here))])
        raise table.refused_row(
            row, f"the life, {numbers.values[row]:g} {unit}, is {why}", "how long the specimen lived"
        )
    bounds = np.array([numbers.bounds.get(int(row), 0) for row in rows], dtype=np.int8)
    cells = [cell_text(cell) or "" for cell in table.cells("lifetime")]
    flags = _flags(table)
    failed = bounds == 0 if flags is None else flags
    planned = _planned(table, seconds.size)
    lives = seconds.copy()
    blank = []
    for i, row in enumerate(rows.tolist()):
        shown = f'the life is "{cells[i][:40]}"'
        if bounds[i] < 0:
            raise table.refused_row(
                row, f"{shown}: it is left-censored, only known to be shorter", "failures and right-censored lives"
            )
        if bounds[i] > 0 and failed[i]:
            raise table.refused_row(row, f"{shown}, and the specimen has failed", "one of the two")
        if math.isnan(lives[i]) and not failed[i] and math.isfinite(planned[i]):
            lives[i] = planned[i]
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
    if blank:
        table.problems.append(
            f"{len(blank)} of {lives.size} rows have no life, or survived 0 s (row {blank[0]}): left out"
        )
    filled = int((np.isnan(seconds) & ~np.isnan(lives)).sum())
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
        survivors = int((bounds > 0).sum())
        table.notes.append(
            f"no column says which specimens failed: {survivors} lives are written as survived, the others count as"
            " failures"
        )
        because = "no column says which specimens failed"
        table.assumptions.append(Assumption("lives that are not written as survived", "failures", because, "survival"))
    return Lives(lives, failed)


def _planned(table: TableRows, count: int) -> Float:
    """(n,) planned duration of each test in s, NaN where nothing says it."""
    return table.numbers_or("test_duration", "s", table.metadata.test_duration_s, count)


def _flags(table: TableRows) -> Bool | None:
    """(n,) true for a failure, false for a life that is only known to be longer; None where no column says it."""
    given = [name for name in ("failed", "censored") if name in table.mapping.columns]
    source = table.mapping.source or table.where
    if len(given) != 1:
        if given:
            raise RefusedError(
                "columns.failed and columns.censored are both mapped", where=source, expected="one of them"
            )
        return None
    name = given[0]
    meanings = table.mapping.columns[name].meanings
    if not meanings.get("failed") and not meanings.get("censored"):
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
        if means[0] == "left_censored":
            raise table.refused_row(
                int(table.row_numbers[i]) - 1,
                "it is left-censored: its life is only known to be shorter",
                "failures and right-censored lives",
                "Survival curves from left-censored lives are not estimated here",
            )
        failed[i] = means[0] == "failed"
    return failed
