"""The tests that one record of a testing machine holds, as entries of `[[select]]`: a relaxation, and the cycles before or after it.

Does not belong here: where a record is cut (`ingest.segments`), which test each part shows (`ingest.shapes`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ingest.compressed import read_plain_content
from ingest.csv_dialect import Dialect
from ingest.draft_files import Opened, map_each_column, read_numbers
from ingest.harvest import OWN_FACTS, harvest_blocks, name_fact
from ingest.mapping import FileMapping
from ingest.mapping_keys import RECORDING
from ingest.meanings import TIME, GuessedColumn
from ingest.read import open_columns
from ingest.segments import Segment, find_segments
from ingest.select import as_number
from ingest.shapes import SURE, Shape
from ingest.sniff import count_numbers
from schemas.errors import DealabError

_DRIVES = ("displacement", "stretch")
_NAMES: Mapping[str, str] = {"step": "relaxation", "cycle": "cycles", "cyclic": "sinusoid"}
"""What the parts are called, by protocol; others by the protocol itself."""
_MOVES = ("cycle", "cyclic", "pull", "noise", "chirp")
"""Protocols of movements that may stand beside a relaxation."""


_FEWEST = 10
"""Rows of a file in which runs are looked for."""
_NEAR = 0.02
"""How near to the first time of a file another run's begins, as a share of the longest run."""
_SCRAP = 0.1
"""Shortest run beside the longest one: less is a clock that was set, or a start that was broken off."""


def find_parts(opened: Opened, time_of: GuessedColumn | None) -> list[tuple[bool | None, dict[str, Any]]]:
    """For each test of a record: whether it is a step and hold, and which rows are its; empty where it is one test alone."""
    drive = next((c for name in _DRIVES for c in opened.columns if c.meaning == name), None)
    if drive is None or time_of is None or not any(c.meaning in ("force", "stress") for c in opened.columns):
        return []
    mapping = FileMapping(RECORDING, opened.format, dict(opened.options), None, {}, {}, {})
    try:
        file = open_columns(opened.path, opened.format, map_each_column(mapping, opened.columns))
        times, moved = read_numbers(file, time_of), read_numbers(file, drive)
        if times is None or moved is None or times.size != moved.size:
            return []
        cells = file.cells(time_of.column, time_of.index)
    except DealabError:
        return []
    rows = np.flatnonzero(np.isfinite(times) & np.isfinite(moved))
    segments = find_segments(times[rows], moved[rows])
    runs = bool((np.diff(times[rows]) > 0).all()) and time_of.index is None
    runs = runs and all(as_number(cells[rows[i]]) == times[rows[i]] for s in segments for i in (s.first, s.last))
    return [(s.is_hold, _range(s, rows, times, time_of if runs else None)) for s in segments]


def find_runs(opened: Opened, time_of: GuessedColumn | None) -> list[tuple[bool | None, dict[str, Any]]]:
    """The runs of a file to which one was written behind the other, as entries of rows; empty where it holds one.

    The file tells them apart, or its times begin anew.
    """
    begins, count = list(opened.begins), None
    if len(begins) == 1 and time_of is not None:
        mapping = FileMapping(RECORDING, opened.format, dict(opened.options), None, {}, {}, {})
        try:
            times = read_numbers(open_columns(opened.path, opened.format, map_each_column(mapping, [time_of])), time_of)
        except DealabError:
            return []
        if times is None:
            return []
        begins, count = _find_restarts(times), times.size
    if len(begins) == 1:
        return []
    found: list[tuple[bool | None, dict[str, Any]]] = []
    owned = _list_own_facts(opened, len(begins))
    for first, after, own in zip(begins, [*begins[1:], count], owned, strict=True):
        entry = ({"first_row": first} if first else {}) | ({} if after in (None, count) else {"last_row": after - 1})
        found.append((None, entry | ({"recording": own} if own else {})))
    return found


def find_beside(opened: Opened, time_of: GuessedColumn | None) -> list[tuple[bool | None, dict[str, Any]]]:
    """The tests of specimens whose columns stand side by side under the same names, as entries with columns of their own; empty where
    there is one."""
    places: dict[str, list[GuessedColumn]] = {}
    for column in opened.columns:
        places.setdefault(column.name or str(column.column), []).append(column)
    counts = {len(own) for own in places.values()}
    wanted = {c.meaning: places[c.name or str(c.column)] for c in opened.columns if c.meaning is not None}
    if time_of is None or len(counts) != 1 or counts == {1} or len(wanted) < 2:
        return []
    mapping = FileMapping(RECORDING, opened.format, dict(opened.options), None, {}, {}, {})
    found: list[tuple[bool | None, dict[str, Any]]] = []
    for number in range(counts.pop()):
        own = {str(meaning): columns[number] for meaning, columns in wanted.items()}
        try:
            times = read_numbers(
                open_columns(opened.path, opened.format, map_each_column(mapping, [own[TIME]])), own[TIME]
            )
        except DealabError:
            return []
        if times is None or not np.isfinite(times).any():
            return []
        last = int(np.flatnonzero(np.isfinite(times))[-1])
        entry: dict[str, Any] = {"first_row": 0} | ({} if last == times.size - 1 else {"last_row": last})
        if number:
            entry["time"] = {"column": own[TIME].column}
            entry["columns"] = {name: {"column": c.column} for name, c in own.items() if name != TIME}
        label = f"specimen-{number + 1}"
        found.append((None, entry | {"part": label, "recording": {"specimen_id": f"{{stem}}-{number + 1}"}}))
    return found


def _list_own_facts(opened: Opened, runs: int) -> list[dict[str, Any]]:
    """What a text says above each of its runs and not alike above all: specimen, sizes; nothing where not every run has words of its own."""
    nothing: list[dict[str, Any]] = [{} for _ in range(runs)]
    if opened.format != "csv":
        return nothing
    text = read_plain_content(opened.path).content.decode(str(opened.options.get("encoding", "utf-8")), "replace")
    delimiter, decimal = str(opened.options["delimiter"]), str(opened.options["decimal"])
    dialect = Dialect(delimiter=delimiter, decimal=decimal)
    told = harvest_blocks(text.splitlines(), lambda line: count_numbers(line, dialect) > 0)
    if len(told) != runs:
        return nothing
    blocks = [{key: fact for key, fact in block.items() if not fact.lacks_unit} for block in told]
    keys = [key for key in OWN_FACTS if len({block[key].value if key in block else None for block in blocks}) > 1]
    return [{key: name_fact(block[key]) for key in keys if key in block} for block in blocks]


def _find_restarts(times: Any) -> list[int]:
    """The first rows of runs whose times begin anew: each steps back to where the first began, and is no scrap."""
    rows = np.flatnonzero(np.isfinite(times))
    if rows.size < _FEWEST:
        return [0]
    known = times[rows]
    back = np.flatnonzero(np.diff(known) < 0) + 1
    spans = [float(np.ptp(run)) for run in np.split(known, back)]
    near = np.abs(known[back] - known[0]) <= _NEAR * max(spans)
    if not back.size or not near.all() or min(spans) < _SCRAP * max(spans):
        return [0]
    return [0, *(int(rows[at]) for at in back)]


def _range(segment: Segment, rows: Any, times: Any, column: GuessedColumn | None) -> dict[str, Any]:
    """The rows of a segment by their times, or counted where the clock does not tell them apart."""
    first, last = int(rows[segment.first]), int(rows[segment.last])
    keys = ("first_row", "last_row") if column is None else ("at_least", "at_most")
    found: dict[str, Any] = {} if column is None else {"column": column.column}
    if segment.first > 0:
        found[keys[0]] = first if column is None else float(times[first])
    if segment.last < rows.size - 1:
        found[keys[1]] = last if column is None else float(times[last])
    return found


def name_parts(tests: Sequence[tuple[bool | None, dict[str, Any]]], shapes: Sequence[Shape]) -> list[dict[str, Any]]:
    """The entries of `[[select]]` with a name for each part and what its metadata have of their own; empty where a part shows
    no test that may stand beside the others.

    A part that is a sheet, or a run, where None stands in place of whether it is a hold, has the name of the sheet, or `run`.
    """
    pairs = list(zip(tests, shapes, strict=True))
    if any(
        is_hold is not None and shape.protocol not in (("step",) if is_hold else _MOVES)
        for (is_hold, _), shape in pairs
    ):
        return []
    entries: list[dict[str, Any]] = []
    names: list[str] = []
    for (is_hold, entry), shape in pairs:
        name = (
            str(entry.get("part", entry.get("equals", "run")))
            if is_hold is None
            else _NAMES.get(shape.protocol, shape.protocol)
        )
        names.append(name)
        count = names.count(name)
        own: dict[str, Any] = {} if shape.protocol == shapes[0].protocol else {"protocol": shape.protocol}
        own |= {} if shape.loading == shapes[0].loading else {"loading": shape.loading}
        entries.append(
            entry
            | {
                "part": name if count == 1 else f"{name}-{count}",
                "recording": own | dict(shape.constants) | dict(entry.get("recording", {})),
            }
        )
    return [{k: v for k, v in entry.items() if v != {}} for entry in entries]


def join_shapes(shapes: Sequence[Shape]) -> Shape:
    """What the whole record shows."""
    seen = "; then ".join(f"{shape.protocol}: {shape.seen}" for shape in shapes)
    return Shape(shapes[0].protocol, shapes[0].loading, SURE, f"{len(shapes)} tests in one record, {seen}")
