"""The data of a figure as CSV text: one header line with units in the names, a full stop as decimal mark."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_FORMULA = ("=", "+", "-", "@", "\t", "\r")


Column = Sequence[Any] | NDArray[Any]


def csv(columns: Mapping[str, Column]) -> str:
    """CSV of columns of equal length. Numbers to seven digits, absent ones empty, text quoted where it must be.

    Text that a spreadsheet would run as a formula gets an apostrophe in front: names come from rigs.
    """
    texts = [_column(values) for values in columns.values()]
    rows = map(",".join, zip(*texts, strict=True))
    return "\n".join((",".join(columns), *rows)) + "\n"


def _column(values: Column) -> list[str]:
    """The cells of a column; real arrays and repeated names, the bulk of all data, without a look at each cell's kind."""
    if isinstance(values, np.ndarray) and values.dtype.kind == "f":
        return [f"{v:.7g}" if math.isfinite(v) else "" for v in values.tolist()]
    cells = values.tolist() if isinstance(values, np.ndarray) else values
    if len(cells) and isinstance(cells[0], str):
        known = {v: write_cell(v) for v in set(cells)}
        return [known[v] for v in cells]
    return [write_cell(v) for v in cells]


def write_cell(value: Any) -> str:
    """A cell of CSV: numbers to seven digits, text quoted where it must be and never a formula."""
    if value is None:
        return ""
    if isinstance(value, str):
        text = "'" + value if value.startswith(_FORMULA) else value
        return '"' + text.replace('"', '""') + '"' if any(c in text for c in ',"\r\n') else text
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    number = float(value)
    return f"{number:.7g}" if math.isfinite(number) else ""
