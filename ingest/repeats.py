"""Heads that a table repeats inside itself: machines write one above each interval, temperature or page.

Does not belong here: where the table begins (`skip_rows` of the mapping).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ingest.notations import read_cell

REPEATED = "the head of the table is said again inside it: {rows} rows of heads are left out"
_FILLED = 0.5
"""Share of the columns that hold numbers in the first row of which any row of data fills more: a line above a head has one or two numbers."""


def find_repeated_heads(rows: Sequence[Sequence[Any]], header: Sequence[str], decimal: str = ".") -> set[int]:
    """Numbers of the rows that belong to a head said again: its names, and what stands around them up to the next row of data.

    Parameters
    ----------
    rows : the cells of each row below the first head, blank rows included
    header : names of the columns
    decimal : decimal mark of numbers that are text
    """
    again = [i for i, row in enumerate(rows) if is_head(row, header)]
    if not again:
        return set()
    first = next((row for row in rows if _numbers(row, decimal)), ())
    usual = _numbers(first, decimal)
    found: set[int] = set()
    for place in again:
        for step in (-1, 1):
            row = place
            while 0 <= row < len(rows) and not _is_data(rows[row], usual, decimal):
                found.add(row)
                row += step
    return found


def is_head(cells: Sequence[Any], header: Sequence[str]) -> bool:
    """Whether a row says the names of the columns; one name alone is none."""
    names = _plain(header)
    return sum(map(bool, names)) >= 2 and _plain(cells) == names


def _plain(cells: Sequence[Any]) -> list[str]:
    """Cells as text without outer blanks, and without the empty ones at the end."""
    texts = [" ".join(str("" if c is None else c).split()) for c in cells]
    while texts and not texts[-1]:
        texts.pop()
    return texts


def _numbers(row: Sequence[Any], decimal: str) -> set[int]:
    """Columns of a row that hold numbers."""
    return {i for i, cell in enumerate(row) if _is_number(cell, decimal)}


def _is_number(cell: Any, decimal: str) -> bool:
    if isinstance(cell, str):
        return bool(cell.strip()) and read_cell(cell.strip(), decimal) is not None
    return cell is not None and not isinstance(cell, bool)


def _is_data(row: Sequence[Any], usual: set[int], decimal: str) -> bool:
    return len(_numbers(row, decimal) & usual) > _FILLED * len(usual)
