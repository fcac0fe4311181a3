"""Rows of `lifetimes`.

Belongs here: single lives. Does not belong here: what is fitted to many of them (`survival`), whose code would then be
part of what every recording is made from.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from typing import TYPE_CHECKING

from pipeline.analyse.rows.recordings import joined
from schemas.lifetimes import LifetimeRow
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def lifetime_table(rows: Iterable[LifetimeRow]) -> pa.Table:
    """Table `lifetimes` from all rows, also those that the survival analysis leaves out."""
    table = TABLES["lifetimes"]
    names = {f.name for f in fields(LifetimeRow)} & set(table.names)
    return table.rows({name: getattr(row, name) for name in names} | {"warnings": joined(row.warnings)} for row in rows)
