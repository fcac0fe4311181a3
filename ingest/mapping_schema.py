"""The JSON Schema of a mapping, derived from `ingest.mapping_keys`; and all schemas by their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from ingest.mapping_keys import (
    COLUMN,
    COVARIATE,
    COVARIATES,
    EACH,
    FORMATS,
    IGNORE,
    KINDS,
    LIFETIMES,
    MEAN,
    OPTIONS,
    RECORDING,
    SELECT,
    TABLE_COLUMN,
    TABLE_COLUMNS,
    TIME,
    TOP,
    Key,
)
from schemas.json_schema import describe_keys, head, recording_schema, rig_schema
from schemas.metadata import RecordingMetadata, RigConstants, TableMetadata
from schemas.quantities import QUANTITIES

_NAMES = {str: "string", int: "integer", float: "number", bool: "boolean", list: "array", dict: "object"}
_PLACEHOLDERS = ("{stem}", EACH)


def mapping_schema() -> dict[str, Any]:
    """Of a mapping: `<file>.toml`, with the keys at the top, or `recordings.toml`, with `[[files]]` entries."""
    one: dict[str, Any] = {
        "type": "object",
        "properties": {
            "kind": {"enum": list(KINDS), "description": TOP["kind"]},
            "format": {"enum": list(FORMATS), "description": TOP["format"]},
            "repeated": {"enum": [MEAN], "description": TOP["repeated"]},
            "match": {"type": "string", "description": "of an entry of recordings.toml: which files it is for"},
            "time": _table(TIME),
            "columns": {"type": "object"},
            COVARIATES: {"type": "object", "additionalProperties": _refer("covariate")},
            "recording": {"type": "object"},
            "rig": describe_keys(RigConstants, placeholders=_PLACEHOLDERS),
            "select": {"type": "array", "items": _selection()},
            **{name: _table(keys) for name, keys in OPTIONS.items()},
        },
        "additionalProperties": False,
        "allOf": [_of_kind(kind) for kind in KINDS if kind != IGNORE],
    }
    definitions = {
        "mapping": one,
        "entry": {"allOf": [_refer("mapping")], "required": ["match"]},
        "channel": _table(COLUMN),
        "column": _table(TABLE_COLUMN),
        "covariate": _table(COVARIATE),
        "recording": describe_keys(RecordingMetadata, placeholders=_PLACEHOLDERS, required=False, has_zone=True),
        "table": describe_keys(TableMetadata, placeholders=_PLACEHOLDERS, has_zone=True),
    }
    folder = {"properties": {"files": {"type": "array", "items": _refer("entry")}}, "additionalProperties": False}
    return head("mapping", "Mapping of a file for dealab") | {
        "if": {"required": ["files"]},
        "then": folder,
        "else": _refer("mapping"),
        "$defs": definitions,
    }


SCHEMAS: Mapping[str, Callable[[], dict[str, Any]]] = {
    "recording": recording_schema,
    "rig": rig_schema,
    "mapping": mapping_schema,
}
"""By name, as `dealab validate --schema NAME` prints them."""


def _of_kind(kind: str) -> dict[str, Any]:
    """Columns and metadata of a mapping of one kind; one that names no kind is that of a recording."""
    is_kind: dict[str, Any] = {"properties": {"kind": {"const": kind}}}
    if kind == RECORDING:
        columns = {name: _refer("channel") for name in QUANTITIES}
        about = _refer("recording")
    else:
        is_kind["required"] = ["kind"]
        columns = {name: {"description": said} | _refer("column") for name, said in TABLE_COLUMNS[kind].items()}
        about = _refer("table")
    named = {"type": "object", "properties": columns, "additionalProperties": False}
    others: dict[str, Any] = {} if kind == LIFETIMES else {COVARIATES: False}
    return {"if": is_kind, "then": {"properties": {"columns": named, "recording": about, **others}}}


def _selection() -> dict[str, Any]:
    """An entry of `[[select]]`; the keys that a part has for itself are those of `[recording]`."""
    found = _table(SELECT)
    own: dict[str, dict[str, Any]] = {
        "recording": {"anyOf": [_refer("recording"), _refer("table")]},
        "columns": {"type": "object", "additionalProperties": _refer("channel")},
        "time": _table(TIME),
    }
    said = {name: schema | {"description": SELECT[name].meaning} for name, schema in own.items()}
    return found | {"properties": {**found["properties"], **said}}


def _refer(name: str) -> dict[str, Any]:
    return {"$ref": f"#/$defs/{name}"}


def _table(keys: Mapping[str, Key]) -> dict[str, Any]:
    """A table whose keys are all known and of their types."""
    found = {name: {"description": key.meaning, "type": [_NAMES[t] for t in key.types]} for name, key in keys.items()}
    return {"type": "object", "properties": found, "additionalProperties": False}
