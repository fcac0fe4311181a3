"""What of JSON Schema our published schemas use, so that tests can ask whether a document keeps to them."""

from __future__ import annotations

import re
from typing import Any

_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,), "array": (list,), "string": (str,), "number": (int, float), "integer": (int,), "boolean": (bool,),
}  # fmt: skip
USED = {
    "$schema", "$id", "$defs", "$ref", "title", "description", "type", "properties", "required", "additionalProperties", "items",
    "enum", "const", "pattern", "minimum", "exclusiveMinimum", "anyOf", "allOf", "if", "then", "else",
}  # fmt: skip


def is_valid(value: Any, schema: dict[str, Any], root: dict[str, Any] | None = None) -> bool:
    """Whether a document keeps to a schema (draft 2020-12, as far as we use it)."""
    root = schema if root is None else root
    assert set(schema) <= USED, set(schema) - USED

    def holds(part: dict[str, Any], it: Any = value) -> bool:
        return is_valid(it, part, root)

    if "$ref" in schema and not holds(root["$defs"][schema["$ref"].rpartition("/")[2]]):
        return False
    if "type" in schema and not any(_is(value, t) for t in _as_list(schema["type"])):
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    if "const" in schema and value != schema["const"]:
        return False
    if isinstance(value, str) and "pattern" in schema and not re.search(schema["pattern"], value):
        return False
    if _is(value, "number") and (
        value < schema.get("minimum", value) or value <= schema.get("exclusiveMinimum", -1e300)
    ):
        return False
    if isinstance(value, list) and "items" in schema and not all(holds(schema["items"], v) for v in value):
        return False
    if isinstance(value, dict):
        known, rest = schema.get("properties", {}), schema.get("additionalProperties", True)
        if any(name not in value for name in schema.get("required", ())):
            return False
        for name, member in value.items():
            if name in known and not holds(known[name], member):
                return False
            if name not in known and (rest is False or (rest is not True and not holds(rest, member))):
                return False
    if "anyOf" in schema and not any(holds(part) for part in schema["anyOf"]):
        return False
    if not all(holds(part) for part in schema.get("allOf", ())):
        return False
    return "if" not in schema or holds(schema.get("then" if holds(schema["if"]) else "else", {}))


def _is(value: Any, kind: str) -> bool:
    return isinstance(value, _TYPES[kind]) and (kind == "boolean" or not isinstance(value, bool))


def _as_list(kinds: str | list[str]) -> list[str]:
    return [kinds] if isinstance(kinds, str) else kinds
