"""The text of a drafted mapping: TOML with a comment wherever something was guessed, measured or has to be answered."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from ingest.mapping_keys import OF_A_PART

UNANSWERED = "?"
"""What stands for an answer that has to be given: no number and no name, so that the file is refused until it is."""


def toml_string(text: str) -> str:
    """A TOML basic string of any text; lone surrogates, which TOML cannot hold, become question marks."""
    plain = text.encode("utf-8", "replace").decode()
    return json.dumps(plain, ensure_ascii=False).replace("\x7f", "\\u007F")


def toml_value(value: Any) -> str:
    """A value as TOML writes it; None is unanswered."""
    if value is None:
        return toml_string(UNANSWERED)
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(v) for v in value) + "]"
    if isinstance(value, int | float):
        return repr(value)
    return toml_string(str(value))


def toml_text(
    name: str,
    content: Mapping[str, Any],
    remarks: Mapping[str, str],
    asked: Mapping[str, str],
    unmapped: Sequence[tuple[str | int, str | None, str]],
    about: Sequence[str] = (),
) -> str:
    """A mapping as text.

    Parameters
    ----------
    name : of the data file
    content : the tables
    remarks : comments by key, such as `recording.protocol`
    asked : keys that are still a question, with it
    unmapped : names (or numbers) and units of columns that are not mapped, and the names of those that have a number
    about : comments of the format's table
    """
    if asked:
        lines = [f"# Draft for {toml_string(name)}: check every line marked CHECK, then save it beside the file as"]
    else:
        lines = [f"# What {toml_string(name)} holds: its mapping, beside it as"]
    lines += [f"# {toml_string(name + '.toml')}", f"kind = {toml_value(content['kind'])}"]
    if "format" in content:
        lines.append(f"format = {toml_value(content['format'])}")
    if "repeated" in content:
        lines.append(
            f"repeated = {toml_value(content['repeated'])}  # rows at the same frequency (or time) are one, their mean"
        )
    for table, entries in content.items():
        if not isinstance(entries, Mapping):
            continue
        if table == "columns":
            for quantity, column in entries.items():
                lines += ["", f"[columns.{quantity}]", *_pairs(f"columns.{quantity}", column, remarks, asked)]
            lines += _others(unmapped)
        else:
            lines += ["", f"[{table}]"]
            if table not in ("time", "recording", "rig"):
                lines += [f"# {_one_line(text)}" for text in about]
            lines += _pairs(table, entries, remarks, asked)
    for entry in content.get("select", ()):
        lines += ["", "[[select]]"]
        lines += [f"{key} = {toml_value(value)}" for key, value in entry.items() if key not in OF_A_PART]
        own = {f"select.{name}": entry.get(name, {}) for name in ("time", "recording")}
        own |= {f"select.columns.{name}": column for name, column in entry.get("columns", {}).items()}
        for name, keys in own.items():
            lines += [f"[{name}]"] if keys else []
            lines += [f"{key} = {toml_value(value)}" for key, value in keys.items()]
    return "\n".join([*lines, ""])


def _pairs(table: str, entries: Mapping[str, Any], remarks: Mapping[str, str], asked: Mapping[str, str]) -> list[str]:
    lines = []
    for key, value in entries.items():
        full = f"{table}.{key}"
        said = [f"CHECK: {asked[full]}"] if full in asked else []
        said += [remarks[full]] if full in remarks else []
        comment = f"  # {_one_line('; '.join(said))}" if said else ""
        lines.append(f"{key} = {toml_value(value)}{comment}")
    return lines


def _others(unmapped: Sequence[tuple[str | int, str | None, str]]) -> list[str]:
    if not unmapped:
        return []
    lines = ["", "# CHECK: columns that are not mapped. Map them like this where they matter:"]
    for column, unit, name in dict.fromkeys(unmapped):
        written = str(column) if isinstance(column, int) else toml_string(column)
        called = f", {toml_string(name)}" if name and isinstance(column, int) else ""
        lines.append(f"# [columns.<name>]   column = {written}{called}" + (f" in {_one_line(unit)}" if unit else ""))
    return lines


def _one_line(text: str) -> str:
    """A text for a comment: control characters as escapes, quotation marks as they are."""
    return toml_string(text)[1:-1].replace('\\"', '"')
