"""How long the tests of a table ran by the dates of their starts and ends: the life of a row that has none of its own.

Does not belong here: instants of samples (`ingest.times`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ingest.clocks import DAY, LOST, SECOND, moments
from ingest.table_rows import TableRows, cell_text
from schemas.arrays import Bool, Float
from schemas.numbers import counted

STARTED, ENDED = "started", "ended"
_COARSE = (DAY, 3600 * SECOND, 60 * SECOND, SECOND)
"""What people write dates to; the finest one that all dates of a table are whole multiples of is how exact they are."""
_OFF = 2.0
"""Steps of the dates by which a life may differ from the time between them: each of the two is rounded."""


@dataclass(frozen=True)
class Spans:
    """Of the selected rows: `seconds` (n,) between start and end, NaN where either is not written, and how exact dates are."""

    seconds: Float
    step_s: float


def read_spans(table: TableRows, failed: Bool) -> Spans | None:
    """The time between `columns.started` and `columns.ended`; None where they are not mapped.

    Parameters
    ----------
    failed : (n,) of the rows; those that have not and have no end were under test until `open_until`

    Raises
    ------
    RefusedError
        A cell is no date in its `format`, a test ends before it starts, or one of the two columns is not mapped.
    """
    columns = table.mapping.columns
    if STARTED not in columns and ENDED not in columns:
        return None
    table.require(STARTED, ENDED)
    rows = table.row_numbers - 1
    read = {}
    for name in (STARTED, ENDED):
        cells = table.cells(name)
        plain = [None if cell is None or not str(cell).strip() else cell for cell in cells]
        found, zoned, wrong = moments(plain, columns[name].format)
        if wrong is not None:
            raise table.refused_row(
                int(rows[wrong]),
                f'{name} is "{(cell_text(cells[wrong]) or "")[:40]}"',
                f'a date and time as "{columns[name].format or "iso"}"',
                f"Correct columns.{name}.format, a strptime pattern",
            )
        read[name] = (found, zoned)
    (start, start_zoned), (end, end_zoned) = read[STARTED], read[ENDED]
    if columns[ENDED].open_until is not None:
        still = ~failed & (end == LOST) & (start != LOST)
        (until,), (zoned,), _ = moments([columns[ENDED].open_until], None)
        end[still], end_zoned[still] = until, zoned
        if still.any():
            count = counted(int(still.sum()), "specimen", "specimens")
            table.notes.append(
                f"{count} without an end: under test until {columns[ENDED].open_until}, the state of the list"
            )
    known = (start != LOST) & (end != LOST)
    for i in np.flatnonzero(known & ((end < start) | (start_zoned != end_zoned)))[:1]:
        problem = "ends before it starts" if end[i] < start[i] else "has a zone at one of its dates"
        raise table.refused_row(int(rows[i]), f"the test {problem}", "an end after its start, in the same clock")
    seconds = np.full(start.size, np.nan)
    seconds[known] = (end[known] - start[known]) / SECOND
    every = np.concatenate([start[known], end[known]])
    step = next((one for one in _COARSE if every.size and not (every % one).any()), 1)
    return Spans(seconds, step / SECOND)


def note_contradictions(table: TableRows, spans: Spans, life_s: Float) -> None:
    """Says which lives are longer than their dates are apart, by more than the dates are exact to.

    A life that is shorter contradicts nothing: the supply was raised first, or the film taken out later.
    """
    over = life_s - spans.seconds > _OFF * spans.step_s
    if over.any():
        numbers = ", ".join(str(int(row)) for row in table.row_numbers[over][:8])
        worst = float((life_s - spans.seconds)[over].max())
        table.problems.append(
            f"{counted(int(over.sum()), 'life is', 'lives are')} longer than their start and end are apart, by up to {worst:.4g} s (row {numbers}):"
            " the lives are taken"
        )
