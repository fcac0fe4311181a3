"""JSON Schemas of recording metadata and rig files, for software that writes them: derived from `schemas.metadata`, no second list.

What a value may be is asked of the parser of its key. Where JSON Schema cannot say what a parser checks, the schema lets it pass:
whatever the pipeline takes, the schema takes. The version changes when a document that was valid no longer is.

Does not belong here: the schema of mappings (`ingest.mapping_schema`); our own messages, which come from the parsers.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any

from schemas.metadata import RECORDING_ID, RecordingMetadata, RigConstants, TableMetadata, known_keys
from schemas.protocols import PROTOCOL_NAMES

VERSION = 1
DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NUMBER = r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*$"
_NOTHING = {"type": "string", "pattern": r"^\s*$"}
"""A key with an empty text counts as absent."""
_TIME = r"^\s*\d{4}-?\d{2}-?\d{2}.*([Zz]|[+-]\d{2}(:?\d{2})?)\s*$"
_LOCAL_TIME = r"^\s*\d{4}-?\d{2}-?\d{2}"
_SCALAR = {"type": ["string", "number", "boolean"]}


def head(name: str, title: str) -> dict[str, Any]:
    """How every schema of ours begins."""
    return {"$schema": DIALECT, "$id": f"urn:dealab:{name}:{VERSION}", "title": title}


def recording_schema() -> dict[str, Any]:
    """Of the metadata of a recording, as MCAP has them (all texts) or as JSON: two tables, `recording` and `rig`."""
    return head("recording", "Metadata of a dealab recording") | {
        "type": "object",
        "required": ["recording"],
        "properties": {
            "recording": describe_keys(RecordingMetadata),
            "rig": describe_keys(RigConstants),
        },
    }


def rig_schema() -> dict[str, Any]:
    """Of a rig file, `<rig_id>.toml`."""
    return head("rig", "Constants of a rig for dealab") | describe_keys(RigConstants)


def describe_keys(
    cls: type[RecordingMetadata] | type[TableMetadata] | type[RigConstants],
    *,
    placeholders: tuple[str, ...] = (),
    required: bool = True,
    has_zone: bool = False,
) -> dict[str, Any]:
    """The schema of the keys of a class of metadata.

    Parameters
    ----------
    cls : the class
    placeholders : texts that a mapping may hold in place of a value, such as `{stem}`
    required : whether keys that the class requires have to be there
    has_zone : whether a zone may stand elsewhere, so that times need none of their own
    """
    hints = typing.get_type_hints(cls)
    fields = [f for f in dataclasses.fields(cls) if "parser" in f.metadata]
    meanings = {f.name: f.metadata["meaning"] for f in dataclasses.fields(RecordingMetadata) if "meaning" in f.metadata}
    found = {}
    for f in fields:
        meaning = f.metadata["meaning"] or meanings.get(f.name, "")
        value = _value(f.name, hints[f.name], f.metadata["parser"], placeholders, _LOCAL_TIME if has_zone else _TIME)
        found[f.name] = ({"description": meaning} if meaning else {}) | value
    for name in known_keys(cls):  # the noise of each channel, which no field of its own holds
        found.setdefault(name, _number({"minimum": 0}))
    needed = [f.name for f in fields if f.default is dataclasses.MISSING] if required else []
    keys: dict[str, Any] = {"type": "object", "properties": found, "additionalProperties": _SCALAR}
    return keys | ({"required": needed} if needed else {})


def _value(
    name: str, hint: object, parser: Callable[[Any], Any], placeholders: tuple[str, ...], time: str
) -> dict[str, Any]:
    options = typing.get_args(hint) if isinstance(hint, types.UnionType) else (hint,)
    kind = next(option for option in options if option is not type(None))
    forms = _forms(name, typing.get_origin(kind) or kind, parser, time)
    forms += [{"type": "string", "pattern": p.replace("{", r"\{").replace("}", r"\}")} for p in placeholders]
    forms.append(_NOTHING)
    return forms[0] if forms[0] == _SCALAR else {"anyOf": forms}


def _forms(name: str, kind: object, parser: Callable[[Any], Any], time: str) -> list[dict[str, Any]]:
    """What a value may be, asked of the parser: its choices, its least value, its pattern."""
    if kind is float:
        return list(_number(_least(parser))["anyOf"])
    if kind is int:
        return list(_number({"minimum": 1})["anyOf"])
    if kind is tuple:
        return [{"type": "array", "items": _number(_least(lambda v: parser([v])))}, {"type": "string"}]
    if kind is str:
        choices = list(PROTOCOL_NAMES) if name == "protocol" else _choices(parser)
        if choices:
            return [{"enum": choices}]
        if not _takes(parser, "-"):
            return [{"type": "string", "pattern": f"^{RECORDING_ID.pattern}$"}]
        return [_SCALAR]
    return [{"type": "string", "pattern": time}]


def _number(limits: Mapping[str, Any]) -> dict[str, Any]:
    """A number, or its text."""
    return {"anyOf": [{"type": "number", **limits}, {"type": "string", "pattern": _NUMBER}]}


def _least(parser: Callable[[Any], Any]) -> dict[str, Any]:
    if _takes(parser, -1.0):
        return {}
    return {"minimum": 0} if _takes(parser, 0.0) else {"exclusiveMinimum": 0}


def _choices(parser: Callable[[Any], Any]) -> list[str]:
    """The choices that a parser names when it is given none of them."""
    try:
        parser("?")
    except ValueError as error:
        if str(error).startswith("one of "):
            return str(error).removeprefix("one of ").split(", ")
    return []


def _takes(parser: Callable[[Any], Any], value: Any) -> bool:
    try:
        parser(value)
    except ValueError:
        return False
    return True
