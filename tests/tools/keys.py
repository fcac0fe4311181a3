"""What `ingest/README.md` lists, from the modules that check it: formats, channels, keys of mappings, recordings and rigs."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Iterable, Mapping, Sequence

from ingest.mapping_keys import (
    COLUMN,
    COVARIATE,
    COVARIATES,
    FORMATS,
    KINDS,
    OPTIONS,
    SELECT,
    TABLE_COLUMN,
    TABLE_COLUMNS,
    TIME,
    TOP,
    TYPE_NAMES,
    Key,
)
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.protocols import PROTOCOLS
from schemas.quantities import QUANTITIES

_NAMED_BY = {
    "mcap": "topic of a channel; the native format needs no mapping",
    "csv": "name in the header, or number from 0",
    "excel": "name in the header, or number from A = 0",
    "matlab": "variable, `structure.field`, or `ch(2).data` of a structure array; `index` is the column of a matrix",
    "hdf5": "path of a dataset, `group/dataset`, or `dataset/field` of a table; `index` is the column of a matrix",
    "mdf": "name of the channel, or `group/channel` (groups from 0) where several have it",
    "tdms": "`group/channel`, or the channel where `[tdms]` has the group",
    "lvm": "name of the channel; `X_Value` is its column of times where it has one",
    "trios": 'name of the variable; `step` is the name of the step (no ending of its own: `format = "trios"`)',
    "arrow": "name of the column (Parquet, Feather, Arrow), `a.b` for a field of structures",
    "numpy": "name of the array, `arr_0` where it is the only one, or `array/field`; `index` is the column of a matrix",
    "uff": "number of the data set (type 58) from 0, or its first description line",
}
"""How a mapping names a column of each format."""
_WORDS = {str: "text", int: "whole number", float: "number", tuple: "list of numbers"}


def as_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *([cell.replace("|", "&#124;") for cell in row] for row in rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def formats() -> str:
    """The formats with their file endings, and how a mapping names their columns."""
    rows = ([f"`{name}`", ", ".join(endings), _NAMED_BY[name]] for name, endings in FORMATS.items())
    return as_table(["format", "files", "a column is named by"], rows)


def channels() -> str:
    """Which channels each protocol needs, and what the channels are."""
    rows = []
    for p in PROTOCOLS.values():
        needed = " or ".join(", ".join(f"`{name}`" for name in names) for names in p.required)
        more = ", ".join(f"`{name}`" for name in p.optional) or "–"
        rows.append([f"`{p.name}`", p.loading, needed, more, p.meaning])
    quantities = ([f"`{q.name}`", q.unit, q.meaning] for q in QUANTITIES.values())
    return "\n\n".join(
        [
            as_table(["`protocol`", "`loading`", "channels", "may have", "what it is"], rows),
            as_table(["channel", "in SQL", "what it is"], quantities),
        ]
    )


def mapping_keys() -> str:
    """Every key of a mapping, with the types of its value and what it means."""
    rows = [["`kind`", ", ".join(KINDS), TOP["kind"]], ["`format`", ", ".join(FORMATS), TOP["format"]]]
    rows += _rows(TIME, "time")
    for name, keys in OPTIONS.items():
        rows += _rows(keys, name)
    rows += _rows(COLUMN, "columns.<quantity>")
    rows += _rows({name: key for name, key in TABLE_COLUMN.items() if name not in COLUMN}, "columns.<name>")
    rows += _rows(COVARIATE, f"{COVARIATES}.<name>")
    rows += _rows(SELECT, "select")
    of_tables = (
        [f"`{kind}`", f"`{name}`", meaning] for kind, names in TABLE_COLUMNS.items() for name, meaning in names.items()
    )
    return "\n\n".join(
        [
            as_table(["key", "value", "meaning"], rows),
            "A recording has `columns.<quantity>` for the channels above. The columns of tables, which know `column`, `index`, `unit`,"
            " `scale` and `offset` as well:",
            as_table(["`kind`", "`columns.<name>`", "meaning"], of_tables),
        ]
    )


def metadata_keys() -> str:
    """The keys of `[recording]`."""
    return as_table(["key", "value", "meaning"], _fields(RecordingMetadata))


def rig_keys() -> str:
    """The keys of a rig file; standard deviations are told with the key that they belong to."""
    rows = [row for row in _fields(RigConstants) if not row[0].endswith("_sd`")]
    known = {f.name for f in dataclasses.fields(RigConstants)}
    for row in rows:
        name = row[0].strip("`")
        row[0] += f", `{name}_sd`" if f"{name}_sd" in known else ""
    rows.append(
        ["`<quantity>_noise_sd`", "number", "standard deviation of one raw sample of that channel, in its unit in SQL"]
    )
    return as_table(["key", "value", "meaning"], rows)


def _rows(keys: Mapping[str, Key], table: str) -> list[list[str]]:
    return [
        [f"`{table}.{name}`", " or ".join(TYPE_NAMES[t].removeprefix("a ") for t in _told(key)), key.meaning]
        for name, key in keys.items()
    ]


def _told(key: Key) -> list[type]:
    """The types of a key's value; a whole number is a number."""
    return [t for t in key.types if not (t is int and float in key.types)]


def _fields(cls: type) -> list[list[str]]:
    hints = typing.get_type_hints(cls)
    return [
        [f"`{f.name}`", _value(hints[f.name], f.metadata["parser"]), f.metadata["meaning"]]
        for f in dataclasses.fields(cls)
        if "parser" in f.metadata
    ]


def _value(hint: object, parser: typing.Callable[[str], object]) -> str:
    """What a value has to be, in words: the choices where there are some, which the parser names when it is given none of them."""
    try:
        parser("?")
    except ValueError as error:
        if str(error).startswith("one of "):
            return str(error).removeprefix("one of ")
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    kind = next(option for option in options if option is not type(None))
    return _WORDS.get(typing.get_origin(kind) or kind, "time")
