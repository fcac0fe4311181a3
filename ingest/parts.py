"""One file that holds several recordings: the parts that `each` and `part` of selections tell apart, each with its mapping.

A part is known by its label: its name, the value as it is written or, where a tolerance is given, the value that is meant: with
`tolerance = 0.5` the rows at 24.98 and 25.03 are the part `25`. Does not belong here: which rows a selection keeps
(`ingest.select`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ingest.columns import ColumnFile
from ingest.mapping import FileMapping, Selection, column_label, format_of
from ingest.mapping_keys import EACH, OF_A_PART
from ingest.notations import read_cell
from ingest.select import selected_rows, split_runs
from schemas.arrays import Bool
from schemas.errors import RefusedError

MOST = 1000
"""Most recordings of one file: more are a column that counts samples."""
_AGAIN = "-run"
"""Stands between a value that comes back and the number of the time."""
_NOT_IN_IDS = re.compile(r"[^A-Za-z0-9._-]+")


def list_parts(path: Path, mapping: FileMapping) -> tuple[str, ...]:
    """The labels of the parts of a file, in the order of their values; empty for a mapping that does not part it.

    Raises `RefusedError` where the values of the column run into each other, are too many or are none.
    """
    from ingest.read import open_columns

    if named := name_parts(mapping.content):
        return named
    by = _parting(mapping)
    if by is None:
        return ()
    if by.each_of and by.runs is None:
        return tuple(dict.fromkeys(_plain(str(value)) for value in by.each_of))
    where = path.name
    file = open_columns(path, str(format_of(path, mapping)), mapping)
    assert by.column is not None  # where the rows are counted nothing has `each`
    cells = list(file.cells(by.column))
    others = tuple(s for s in mapping.select if s is not by)
    keep = selected_rows(file, others, len(cells), where) if others else np.ones(len(cells), dtype=bool)
    texts = [str(cell).strip() for cell, kept in zip(cells, keep, strict=True) if kept and str(cell).strip()]
    decimal = str(mapping.options.get("decimal", "."))
    if by.each_of:
        labels = tuple(dict.fromkeys(_plain(str(value)) for value in by.each_of))
    else:
        labels = _near(texts, by, decimal, where) if by.tolerance else tuple(dict.fromkeys(map(_plain, texts)))
    if not 0 < len(labels) <= MOST:
        raise RefusedError(
            f"column {column_label(by.column)} of [[select]] holds {len(labels)} values",
            where=where,
            expected=f"1 to {MOST} of them, one for each recording",
            remedy="Give tolerance beside each, or another column",
        )
    return labels if by.runs is None else tuple(_count_runs(file, by, keep, labels, where))


def _count_runs(file: ColumnFile, by: Selection, keep: Bool, labels: tuple[str, ...], where: str) -> Iterator[str]:
    """The labels with a number behind each value that comes back."""
    for label in labels:
        alone = Selection(by.column, (label,), by.tolerance)
        here = selected_rows(file, (alone,), keep.size, where) & keep
        for number, _ in enumerate(split_runs(here), start=1):
            yield label if number == 1 else f"{label}{_AGAIN}{number}"


def count_left_out(path: Path, mapping: FileMapping) -> tuple[int, int]:
    """How many rows of a file belong to none of its parts, and how many it has."""
    from ingest.read import open_columns

    file = open_columns(path, str(format_of(path, mapping)), mapping)
    columns = [name for name in mapping.columns_of_file() if name is not None]
    count = len(file.cells(columns[0])) if columns else 0
    kept = np.zeros(count, dtype=bool)
    for label in list_parts(path, mapping):
        kept |= selected_rows(file, part_of(mapping, label).select, count, path.name)
    return int(count - kept.sum()), count


def part_of(mapping: FileMapping, label: str) -> FileMapping:
    """The mapping of one part: its rows alone, and `{each}` replaced by its label."""
    if not mapping.parts_file:
        raise RefusedError("the mapping does not part the file", where=mapping.source, expected="each = true")
    content = content_of_part(mapping.content, label)
    suffix = f".{mapping.format}" if mapping.format is None else ""
    part = FileMapping.parse({**content, "format": mapping.format}, stem="", suffix=suffix, source=mapping.source)
    return replace(part, is_part=True)


def name_parts(content: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of the parts that a mapping names itself, in its order; empty where values of a column tell them apart."""
    entries = content.get("select", [])
    entries = entries if isinstance(entries, list) else []
    return tuple(dict.fromkeys(e["part"] for e in entries if isinstance(e, Mapping) and isinstance(e.get("part"), str)))


def content_of_part(content: Mapping[str, Any], label: str) -> dict[str, Any]:
    """The tables of a mapping as they are for one part: its rows, its own keys of `[recording]`, and `{each}` replaced."""
    own: dict[str, dict[str, Any]] = {name: {} for name in OF_A_PART}
    select = []
    for entry in content["select"]:
        if not isinstance(entry, Mapping) or entry.get("part", label) != label:
            continue
        for name in OF_A_PART:
            if isinstance(entry.get(name), Mapping):
                own[name] |= entry[name]
        kept = {k: v for k, v in entry.items() if k not in ("each", "each_of", "runs", "part", *OF_A_PART)}
        if entry.get("each") or entry.get("each_of"):
            kept |= _pick(label) if "runs" in entry else {"equals": label}
        select.append(kept)
    found = {**content, "select": select}
    for name in ("recording", "time"):
        if own[name] and isinstance(content.get(name, {}), Mapping):
            found[name] = {**content.get(name, {}), **own[name]}
    if own["columns"]:
        mapped = content.get("columns", {})
        found["columns"] = {
            **mapped,
            **{name: {**mapped.get(name, {}), **more} for name, more in own["columns"].items()},
        }
    for table in ("recording", "rig"):
        if table in found:
            found[table] = _with_label(found[table], label)
    about = found.get("recording", {})
    if isinstance(about, Mapping) and isinstance(about.get("recording_id"), str):
        found["recording"] = {**about, "recording_id": _NOT_IN_IDS.sub("_", about["recording_id"])}
    return found


def _pick(label: str) -> dict[str, Any]:
    """The value and the number of the run that a label means."""
    value, again, number = label.rpartition(_AGAIN)
    return (
        {"equals": value, "run": int(number)} if again and value and number.isdigit() else {"equals": label, "run": 1}
    )


def _parting(mapping: FileMapping) -> Selection | None:
    return next((s for s in mapping.select if s.each or s.each_of), None)


def _near(texts: list[str], by: Selection, decimal: str, where: str) -> tuple[str, ...]:
    """Labels of groups of numbers that lie within the tolerance of what they stand for."""
    found = [read_cell(text, decimal) for text in texts]
    wrong = next((text for text, number in zip(texts, found, strict=True) if number is None), None)
    if wrong is not None:
        raise RefusedError(
            f'column {column_label(by.column)} of [[select]] holds "{wrong[:40]}"', where=where, expected="numbers"
        )
    values = np.sort([number.value for number in found if number is not None and np.isfinite(number.value)])
    if not values.size:
        return ()
    groups = np.split(values, np.flatnonzero(np.diff(values) > by.tolerance) + 1)
    for group in groups:
        if group[-1] - group[0] > 2 * by.tolerance:
            raise RefusedError(
                f"column {column_label(by.column)} of [[select]] holds {group.size} values from {group[0]:g} to"
                f" {group[-1]:g} without a gap",
                where=where,
                expected=f"groups no wider than twice the tolerance {by.tolerance:g}",
                remedy="Give a tolerance that fits, or ranges with at_least and at_most",
            )
    step = 10.0 ** np.floor(np.log10(by.tolerance))
    step = step * (5 if by.tolerance >= 5 * step else 2 if by.tolerance >= 2 * step else 1)
    return tuple(f"{round(float(np.median(group)) / step) * step + 0.0:.10g}" for group in groups)


def _plain(text: str) -> str:
    """A value as it is written, whole numbers of spreadsheets without their `.0`."""
    return text.removesuffix(".0") if re.fullmatch(r"-?\d+\.0", text) else text


def _with_label(value: Any, label: str) -> Any:
    if isinstance(value, str):
        return value.replace(EACH, label)
    return {k: _with_label(v, label) for k, v in value.items()} if isinstance(value, dict) else value
