"""The columns of a table of lives that the laboratory has named itself: `[covariates.<name>]` of the mapping.

Their keys are in `ingest.mapping_keys`, what they become in `schemas.life_covariates`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ingest.cell_units import plain_unit
from ingest.mapping_keys import COVARIATES
from ingest.table_rows import TableRows, cell_text
from schemas.errors import RefusedError
from schemas.life_covariates import CATEGORY, OwnCovariate, from_metadata, make_covariate


def read_covariates(table: TableRows) -> list[tuple[OwnCovariate, ...]]:
    """The covariates of each selected row: those of its columns, else those of the whole table's metadata.

    Raises
    ------
    RefusedError
        A law takes numbers, and a cell holds none.
    """
    shared = from_metadata(table.metadata.extra, where=table.where)
    columns = {
        name: _read_column(table, f"{COVARIATES}.{name}", name)
        for name in (key.removeprefix(f"{COVARIATES}.") for key in table.mapping.columns if _is_own(key))
    }
    found = []
    for i in range(int(table.rows.sum())):
        own: Mapping[str, OwnCovariate] = {
            name: one for name, cells in columns.items() for one in [cells[i]] if one is not None
        }
        found.append((*own.values(), *(one for one in shared if one.name not in columns)))
    return found


def _unused(covariate: str, key: str, because: str, table: TableRows) -> RefusedError:
    """The error for a key of a covariate that its cells leave without effect."""
    return RefusedError(
        f"{covariate}.{key} is not used: {because}",
        where=table.mapping.source or table.where,
        expected="only keys that have an effect",
        remedy="Correct the mapping TOML",
    )


def _is_own(key: str) -> bool:
    return key.startswith(f"{COVARIATES}.")


def _read_column(table: TableRows, key: str, name: str) -> list[OwnCovariate | None]:
    """The covariate of each selected row. Without a law all cells are numbers, or all are categories."""
    column = table.mapping.columns[key]
    law, cells = column.law, [cell_text(cell) for cell in table.cells(key)]
    if law != CATEGORY and column.column is not None:
        found = table.file.numbers(column.column, column.index)
        values = found.values[table.rows]
        are_numbers = all(np.isfinite(value) for value, text in zip(values, cells, strict=True) if text)
        if law is None and not are_numbers:
            law = CATEGORY
            if column.unit or column.says_scale:
                raise _unused(key, "unit" if column.unit else "scale", "its cells are words", table)
        elif found.units and column.says_scale:
            raise _unused(key, "scale", "its cells have units of their own", table)
        elif not found.units:  # a cell with a unit of its own says both itself
            scaled = column.scale * values + column.offset
            cells = [repr(float(x)) if np.isfinite(x) else text for x, text in zip(scaled, cells, strict=True)]
    unit = column.unit or (None if column.column is None else plain_unit(table.file.unit(column.column))) or ""
    numbered = table.row_numbers
    return [
        make_covariate(name, cell, law, unit, where=f"{table.where}, row {numbered[i]} of the data")
        for i, cell in enumerate(cells)
    ]
