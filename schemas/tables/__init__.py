"""Every table of `results.duckdb`, once: the public door to the tables, which stand in this package by subject.

From one `Table` come the arrow schema that workers fill, the DDL with its comments, which rows a night replaces, the
references that are checked before publishing, the pages that are made again when rows change, and the table reference
(`dealab schema`). Views are in `schemas.views`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from schemas.tables import (
    calibrations,
    creep,
    diagnosis,
    electrodes,
    fits,
    force,
    housekeeping,
    lifetimes,
    recordings,
    responses,
    sensing,
    temperatures,
    weak_regions,
)
from schemas.tables.fits import ARMS
from schemas.tables.table import OWNERS, Column, StageName, Table

__all__ = [
    "ARMS",
    "OWNERS",
    "TABLES",
    "Column",
    "StageName",
    "Table",
    "find_references",
    "find_rows_made_by",
    "reference",
]

_SUBJECTS = (
    recordings,
    responses,
    fits,
    creep,
    temperatures,
    sensing,
    electrodes,
    force,
    lifetimes,
    weak_regions,
    diagnosis,
    calibrations,
    housekeeping,
)
TABLES: dict[str, Table] = {table.name: table for subject in _SUBJECTS for table in subject.TABLES}


def find_rows_made_by(stage: StageName, group: str = "") -> Mapping[str, str]:
    """The tables with rows of a stage, and which of their rows these are, a condition in SQL.

    Parameters
    ----------
    stage : the stage
    group : of the stage "group", whose analyses fill different tables: which one
    """
    return {
        table.name: maker.where
        for table in TABLES.values()
        for maker in table.made_by
        if (maker.stage, maker.group) == (stage, group)
    }


def find_references() -> Iterator[tuple[str, str, str]]:
    """Every column that refers to recordings: its table, its name, the column of `recordings` that has its values."""
    for table in TABLES.values():
        for column in table.columns:
            if column.refers_to:
                yield table.name, column.name, column.refers_to


def reference() -> str:
    """The table reference in Markdown, for the documents and `dealab schema`."""
    parts = []
    for table in TABLES.values():
        parts.append(f"### `{table.name}`\n{table.meaning[0].upper()}{table.meaning[1:]}.\n")
        parts.append(f"{_origin(table)}\n")
        parts.append("| column | type | unit | meaning |\n|---|---|---|---|")
        parts += [f"| `{c.name}` | {c.type} | {c.unit} | {c.meaning.replace('|', '&#124;')} |" for c in table.columns]
        parts.append("")
    return "\n".join(parts)


def _origin(table: Table) -> str:
    """Key, makers and pages of a table in one line."""
    makers = (
        f"{maker.group or maker.stage}{'' if maker.where == 'true' else f' (`{maker.where}`)'}"
        for maker in table.made_by
    )
    key = ", ".join(f"`{name}`" for name in table.key)
    return f"Key: {key}. Made by: {', '.join(makers)}. Pages: {', '.join(table.pages) or 'none'}."
