"""A table and its columns: arrow schema, DDL with comments, and rows from what analyses compute.

Does not belong here: the tables themselves, which stand in the other modules of this package by subject.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

if TYPE_CHECKING:
    import pyarrow as pa

TEXT, REAL, WHOLE, TRUTH, TIME, LIST = "VARCHAR", "DOUBLE", "BIGINT", "BOOLEAN", "TIMESTAMPTZ", "VARCHAR[]"

StageName: TypeAlias = Literal["recording", "specimen", "diagnosis", "group", "night"]
"""What makes rows: the stages of a night by what they are about, and the night itself."""
Page: TypeAlias = Literal["index", "control", "campaign", "specimen", "recording"]
"""Kinds of pages of a report; the lists of recordings, of specimens and of refused files belong to the index."""

OWNERS: Mapping[str, str] = {"recording": "recording_id", "specimen": "specimen_id", "diagnosis": "specimen_id"}
"""By stage, the column that says whose rows they are. A group's rows are replaced as a whole."""


@dataclass(frozen=True)
class MadeBy:
    """A stage that makes rows of a table.

    Parameters
    ----------
    stage : the stage
    where : which of the rows, a condition in SQL; needed where several stages share a table
    group : which analysis over many specimens, for the stage "group"
    """

    stage: StageName
    where: str = "true"
    group: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Parameters
    ----------
    name : in SQL
    type : in SQL
    unit : of its values; "" for text and pure numbers
    meaning : in words
    required : it is never NULL
    refers_to : the column of `recordings` in which an analysed recording has every value of this one; "" for none
    """

    name: str
    type: str
    unit: str
    meaning: str
    required: bool = False
    refers_to: str = ""

    @property
    def comment(self) -> str:
        return f"{self.meaning} [{self.unit}]" if self.unit else self.meaning


@dataclass(frozen=True)
class Table:
    """A table of `results.duckdb`: all that the other packages know of it.

    Parameters
    ----------
    name : in SQL
    meaning : of its rows, in words
    columns : in their order
    key : the columns that tell its rows apart; rows are published in their order
    made_by : the stages that make its rows
    pages : the kinds of pages that show its rows; such a page is made again when they change
    internal : bookkeeping, no result
    result_where : which of its rows are a result of their recording, a condition in SQL; "false" for what only tells
        what came in and how it was read
    """

    name: str
    meaning: str
    columns: tuple[Column, ...]
    key: tuple[str, ...]
    made_by: tuple[MadeBy, ...]
    pages: tuple[Page, ...]
    internal: bool = False
    result_where: str = "true"

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(c.name for c in self.columns)

    @functools.cached_property
    def arrow_schema(self) -> pa.Schema:
        import pyarrow as pa

        types = {
            TEXT: pa.string(),
            REAL: pa.float64(),
            WHOLE: pa.int64(),
            TRUTH: pa.bool_(),
            TIME: pa.timestamp("us", tz="UTC"),
            LIST: pa.list_(pa.string()),
        }
        return pa.schema([pa.field(c.name, types[c.type], nullable=not c.required) for c in self.columns])

    def ddl(self) -> str:
        """CREATE TABLE and COMMENT statements."""
        body = ",\n".join(f'    "{c.name}" {c.type}{" NOT NULL" if c.required else ""}' for c in self.columns)
        lines = [f"CREATE TABLE {self.name} (\n{body}\n);", f"COMMENT ON TABLE {self.name} IS {_quoted(self.meaning)};"]
        lines += [f'COMMENT ON COLUMN {self.name}."{c.name}" IS {_quoted(c.comment)};' for c in self.columns]
        return "\n".join(lines)

    def rows(self, rows: Iterable[Mapping[str, Any]]) -> pa.Table:
        """An arrow table from mappings, a row each. Absent keys are NULL.

        Raises
        ------
        KeyError
            A key is no column.
        """
        import pyarrow as pa

        rows = list(rows)
        self._refuse_unknown({key for row in rows for key in row})
        return pa.Table.from_pylist(
            [{n: _plain(row.get(n)) for n in self.names} for row in rows], schema=self.arrow_schema
        )

    def from_objects(self, objects: Iterable[Any], **members: Any) -> pa.Table:
        """An arrow table from objects, such as frozen dataclasses, a row each.

        Parameters
        ----------
        objects : each column takes the member of its name. A member that is an estimate gives its `value`, and its
            `sd`, `lower` and `upper` to the columns `<name>_sd`, `<name>_lower` and `<name>_upper`. Several texts are
            joined with "; " where the column holds one; none are NULL. NaN is NULL
        members : what the objects lack or call otherwise, by the column's name: a function of the object, or one value
            for all rows

        Raises
        ------
        KeyError
            A key of `members` is no column, or neither the object nor `members` has anything for a column: no column
            is left NULL by mistake.
        """
        import pyarrow as pa

        self._refuse_unknown(members)
        rows = [{c.name: self._value(c, one, members) for c in self.columns} for one in objects]
        return pa.Table.from_pylist(rows, schema=self.arrow_schema)

    def _value(self, column: Column, one: Any, members: Mapping[str, Any]) -> Any:
        """What a column takes from an object, fit for arrow."""

        def member(name: str) -> Any:
            if name not in members:
                return getattr(one, name, _MISSING)
            return members[name](one) if callable(members[name]) else members[name]

        value = member(column.name)
        if value is _MISSING:
            name, _, part = column.name.rpartition("_")
            estimate = member(name) if part in ("sd", "lower", "upper") else _MISSING
            value = None if estimate is None else getattr(estimate, part, _MISSING)
            if value is _MISSING or (estimate is not None and not hasattr(estimate, "value")):
                raise KeyError(f"{type(one).__name__} has nothing for the column {column.name} of {self.name}")
        value = getattr(value, "value", value)
        if column.type == TEXT and isinstance(value, tuple | list):
            value = "; ".join(value) or None
        return _plain(value)

    def arrays(self, length: int, **columns: Any) -> pa.Table:
        """An arrow table of `length` rows from arrays or scalars by column. Absent columns, NaN and infinity are NULL.

        Raises
        ------
        KeyError
            A key is no column.
        """
        import pyarrow as pa

        self._refuse_unknown(columns)
        fields = []
        for column, kind in zip(self.columns, self.arrow_schema, strict=True):
            value = columns.get(column.name)
            if value is None:
                fields.append(pa.nulls(length, kind.type))
            elif isinstance(value, str | bytes) or (not isinstance(value, Sequence) and not hasattr(value, "__len__")):
                fields.append(pa.repeat(pa.scalar(_plain(value), kind.type), length))
            else:
                values = _finite(value) if column.type == REAL else value
                fields.append(pa.array(values, kind.type, from_pandas=True))
        return pa.Table.from_arrays(fields, schema=self.arrow_schema)

    def stack(self, parts: Iterable[pa.Table]) -> pa.Table:
        """The rows of all parts, one below the other; an empty table for none."""
        import pyarrow as pa

        return pa.concat_tables([self.empty(), *parts])

    def empty(self) -> pa.Table:
        """A table of no rows."""
        return self.arrow_schema.empty_table()

    def _refuse_unknown(self, names: Iterable[str]) -> None:
        unknown = set(names) - set(self.names)
        if unknown:
            raise KeyError(f"{self.name} has no column {sorted(unknown)}")


_MISSING = object()
"""Stands for a member that an object lacks; None is a value."""


def _plain(value: Any) -> Any:
    """NaN and infinity become NULL, numpy scalars become Python's."""
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, tuple):
        return list(value)
    return value


def _finite(values: Any) -> Any:
    """(n,) real numbers with NaN for infinity."""
    import numpy as np

    real_values = np.asarray(values, dtype=float)
    return np.where(np.isfinite(real_values), real_values, np.nan)


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


# --- columns ----------------------------------------------------------------------------------------------------------


def text(name: str, meaning: str, *, required: bool = False, refers_to: str = "") -> Column:
    """A column of text."""
    return Column(name, TEXT, "", meaning, required, refers_to)


def texts(name: str, meaning: str) -> Column:
    """A column of lists of texts."""
    return Column(name, LIST, "", meaning)


def real(name: str, unit: str, meaning: str) -> Column:
    """A column of real numbers."""
    return Column(name, REAL, unit, meaning)


def whole(name: str, meaning: str) -> Column:
    """A column of whole numbers."""
    return Column(name, WHOLE, "", meaning)


def truth(name: str, meaning: str) -> Column:
    """A column of true and false."""
    return Column(name, TRUTH, "", meaning)


def instant(name: str, meaning: str) -> Column:
    """A column of points in time."""
    return Column(name, TIME, "", meaning)


def with_sd(name: str, unit: str, meaning: str) -> tuple[Column, Column]:
    """Value and standard deviation."""
    sd = f"standard deviation of {name}; NULL where unresolved or at a bound"
    return real(name, unit, meaning), real(f"{name}_sd", unit, sd)


def with_bounds(name: str, unit: str, meaning: str) -> tuple[Column, Column, Column]:
    """Value and 95 % limits."""
    return (
        real(name, unit, meaning),
        real(f"{name}_lower", unit, f"lower 95 % limit of {name}"),
        real(f"{name}_upper", unit, f"upper 95 % limit of {name}"),
    )


def with_uncertainty(name: str, unit: str, meaning: str) -> tuple[Column, ...]:
    """Value, standard deviation and 95 % limits."""
    value, lower, upper = with_bounds(name, unit, meaning)
    return value, real(f"{name}_sd", unit, f"standard deviation of {name}"), lower, upper


RECORDING_ID = text("recording_id", "the recording", refers_to="recording_id")
SPECIMEN_ID = text("specimen_id", "the specimen", refers_to="specimen_id")
CAMPAIGN = text("campaign", "the campaign, to which the group belongs; NULL for lives that name none")
CONFIGURATION = text("configuration", "how the specimen is built: the group it is compared in")
