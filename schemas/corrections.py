"""Corrections of faults as a TOML text: what would stand in mappings and in a rig's file, to be read and accepted."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from schemas.numbers import significant

_RIG = "rig."


def write_corrections(rows: Iterable[Mapping[str, Any]]) -> str:
    """The most probable correction of each key, from rows of `corrections`; empty where there is none.

    Keys of recordings stand in one `[[files]]` each, keys of a rig's file once at the end, as they stand in that file.
    """
    best: dict[tuple[str, str], Mapping[str, Any]] = {}
    chosen: dict[str, str] = {}
    for row in sorted(rows, key=lambda r: -(r["probability"] or 0.0)):
        if not row["key"] or row["value_proposed"] is None:
            continue
        recording = str(row["recording_id"])
        own = "" if row["key"].startswith(_RIG) else recording
        if chosen.setdefault(recording, row["cause"]) == row["cause"]:
            best.setdefault((own, row["key"]), row)
    lines: list[str] = []
    for name in dict.fromkeys(recording for recording, _ in sorted(best, key=lambda pair: (pair[0] == "", pair[0]))):
        lines += ["[[files]]", f'match = "{name}*"'] if name else ["# in the rig's file"]
        lines += [line for (recording, key), row in best.items() if recording == name for line in _write_key(key, row)]
    return "\n".join(lines)


def _write_key(key: str, row: Mapping[str, Any]) -> tuple[str, ...]:
    """The table and the line of one key."""
    table, _, own = key.removeprefix(_RIG).rpartition(".")
    head = () if key.startswith(_RIG) else (f"[files.{table or 'recording'}]",)
    value = row["value_proposed"]
    shown = value if _is_number(value) else f'"{value}"'
    now = f"now {row['value_now']}" if row["value_now"] is not None else "now absent"
    return *head, f"{own} = {shown}  # {row['cause']}, probability {significant(row['probability'], 2)}, {now}"


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
