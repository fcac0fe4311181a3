"""Text that TRIOS exports (rheometers and DMA machines of TA Instruments) in both layouts: a table for each step.

A column is the name of a variable. Steps are read one behind the other, and the column `step` says of each row which it
belongs to; a step without one of the mapped columns is left out, and a note says so. Does not belong here: rows of text
(`ingest.csv_reader`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path

import pyarrow as pa

from ingest.columns import plain_name
from ingest.compressed import read_plain_content
from ingest.csv_dialect import Dialect, as_utf8
from ingest.csv_reader import CsvFile
from ingest.csv_rows import cut_reason
from ingest.mapping import FileMapping
from schemas.errors import RefusedError

STEP = "step"
MARKS = ("[step]", "[Step]")
_NAMES, _UNITS, _ROW = "Variables", "Units", "Data point"


@dataclass(frozen=True)
class _Step:
    """A step: its name, the names and units of its columns, its rows, and how many rows it says it has."""

    name: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    said: int | None = None


def read_trios(path: Path, mapping: FileMapping) -> CsvFile:
    """The steps that a mapping needs. Raises `RefusedError` for text without steps, or with steps that differ."""
    plain = read_plain_content(path)
    where = path.name
    encoding = mapping.options.get("encoding", "utf-8")
    text, notes = as_utf8(plain.content, Dialect(encoding=encoding), where)
    steps, problems = _check_end(list_steps(text.decode("utf-8", "replace"), where), text)
    problems += [
        f'step "{one.name}" has {len(one.rows)} of {one.said} rows: the file is cut'
        for one in steps
        if one.said is not None and len(one.rows) < one.said
    ]
    wanted = [name for name in mapping.columns_of_file() if isinstance(name, str) and plain_name(name) != STEP]
    known = {plain_name(name) for one in steps for name in one.names}
    wanted = [name for name in wanted if plain_name(name) in known]  # others are refused by name when they are read
    fit = [one for one in steps if {plain_name(n) for n in wanted} <= {plain_name(n) for n in one.names} and one.rows]
    left = [one.name for one in steps if one not in fit]
    if not fit:
        raise RefusedError(
            f"no step has all of {', '.join(wanted)[:200]}",
            where=where,
            expected="a step with the mapped columns: "
            + "; ".join(f"{s.name}: {len(s.names)} columns" for s in steps)[:300],
            remedy="Map columns of one kind of step",
        )
    if left:
        notes.append(f"steps without the mapped columns are left out: {', '.join(left)[:300]}")
    names = tuple(dict.fromkeys(name for one in fit for name in one.names))
    units = _common_units(fit, names, {plain_name(name) for name in wanted}, where)
    columns: list[list[str | None]] = [[] for _ in (STEP, *names)]
    for one in fit:
        places = [one.names.index(name) if name in one.names else None for name in names]
        for row in one.rows:
            columns[0].append(one.name)
            for column, place in zip(columns[1:], places, strict=True):
                column.append(row[place] or None if place is not None else None)
    table = pa.table({str(i): pa.array(column, pa.string()) for i, column in enumerate(columns)})
    dialect = Dialect(delimiter="\t", encoding=encoding, decimal=_find_decimal(fit))
    return CsvFile(where, dialect, (STEP, *names), ("", *units), table, (*plain.problems, *problems), tuple(notes))


def _check_end(steps: Sequence[_Step], text: bytes) -> tuple[list[_Step], list[str]]:
    """The steps without a last row that may be cut: of text without a line end at its end, as `ingest.csv_rows` says."""
    last = steps[-1]
    if not last.rows or text.endswith((b"\n", b"\r")):
        return list(steps), []
    line = text[max(text.rfind(b"\n"), text.rfind(b"\r")) + 1 :].decode("utf-8", "replace")
    found = len(line.split("\t")) - line.startswith(_ROW)
    if found < len(last.names):
        why = f"ends in the middle of a line ({found} of {len(last.names)} cells)"
    elif found == len(last.names) and (reason := cut_reason(pa.array([row[-1] for row in last.rows]))):
        why = f"has no line end behind its last line and {reason}"
    else:
        return list(steps), []
    whole = replace(last, rows=last.rows[:-1])
    return [*steps[:-1], whole], [f'the file {why}: that row of step "{last.name}" is left out']


def list_steps(text: str, where: str) -> list[_Step]:
    """The steps of a file. Raises `RefusedError` where there are none, or where one is no table."""
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    starts = [i for i, line in enumerate(lines) if line.strip() in MARKS]
    if not starts:
        raise RefusedError(
            "the file has no [step]",
            where=where,
            expected="text that TRIOS exports, with a table for each step",
            remedy='Other text is read with format = "csv"',
        )
    steps = []
    for start, end in zip(starts, [*starts[1:], len(lines)], strict=True):
        block = lines[start + 1 : end]
        labelled = any(line.startswith(_NAMES + "\t") for line in block[:12])
        found = _read_labelled(block) if labelled else _read_plain(block)
        if found is not None:
            steps.append(found)
    if not any(one.rows for one in steps):
        raise RefusedError("there are no rows of data", where=where, expected="rows in a [step]")
    names = Counter(one.name for one in steps)
    return [_renamed(one, i, steps) if names[one.name] > 1 else one for i, one in enumerate(steps)]


def find_facts(text: str) -> list[str]:
    """The lines above the first step, as keys and values."""
    head = text.replace("\r\n", "\n").split("\n[step]")[0].split("\n[Step]")[0]
    pairs = (line.split("\t", 1) for line in head.split("\n") if "\t" in line.strip())
    return [f"{key.strip()}: {value.strip()}" for key, value in pairs if key.strip() and value.strip()]


def _read_labelled(block: Sequence[str]) -> _Step | None:
    """A step whose lines say what they are: `Variables`, `Units`, `Data point`."""
    said: dict[str, list[str]] = {}
    rows = []
    for line in block:
        label, *cells = (cell.strip() for cell in line.split("\t"))
        if label == _ROW:
            rows.append(cells)
        elif label:
            said.setdefault(label, cells)
    names, units = said.get(_NAMES, []), said.get(_UNITS, [])
    count = next(iter(said.get("Number of points", [])), "")
    return _as_step(
        " ".join(said.get("Step name", [])[:1]), names, units, rows, int(count) if count.isdecimal() else None
    )


def _read_plain(block: Sequence[str]) -> _Step | None:
    """A step as a name, a line of names, a line of units and rows up to a blank line."""
    filled = [line for line in block if line.strip()]
    if len(filled) < 3:
        return None
    end = next((i for i, line in enumerate(block[1:], 1) if not line.strip()), len(block))
    lines = [[cell.strip() for cell in line.split("\t")] for line in block[:end]]
    if len(lines) < 3:
        return None
    return _as_step(" ".join(lines[0][:1]), lines[1], lines[2], lines[3:], None)


def _as_step(
    name: str, names: Sequence[str], units: Sequence[str], rows: Sequence[Sequence[str]], said: int | None
) -> _Step | None:
    """A step with cells for every named column; trailing cells without a name are none."""
    width = max((i + 1 for i, n in enumerate(names) if n), default=0)
    if not width:
        return None
    seen: Counter[str] = Counter()
    own = []
    for i, n in enumerate(names[:width]):
        seen[n] += 1
        own.append(f"{n} {seen[n]}" if n and seen[n] > 1 else n or f"column {i}")
    padded = [tuple([*row, *[""] * width][:width]) for row in rows]
    return _Step(name or "step", tuple(own), tuple([*units, *[""] * width][:width]), tuple(padded), said)


def _renamed(one: _Step, place: int, steps: Sequence[_Step]) -> _Step:
    """Steps of the same name are counted, from 1."""
    number = sum(other.name == one.name for other in steps[: place + 1])
    return _Step(f"{one.name} ({number})", one.names, one.units, one.rows, one.said)


def _common_units(steps: Sequence[_Step], names: Sequence[str], wanted: Set[str], where: str) -> tuple[str, ...]:
    """The units of columns, none where steps differ. Raises `RefusedError` where those of a wanted column do."""
    units = []
    for name in names:
        found = {one.units[one.names.index(name)] for one in steps if name in one.names}
        if len(found) > 1 and plain_name(name) in wanted:
            raise RefusedError(
                f'column "{name}" is in {" and ".join(sorted(found))} in different steps',
                where=where,
                expected="the same unit in all steps",
                remedy="Export the steps in the same units",
            )
        units.append(found.pop() if len(found) == 1 else "")
    return tuple(units)


def _find_decimal(steps: Sequence[_Step]) -> str:
    """The decimal mark: cells are between tabs, so that a comma in a number is one."""
    cells = (cell for one in steps for row in one.rows[:50] for cell in row)
    commas = sum("," in cell and "." not in cell for cell in cells)
    points = sum("." in cell and "," not in cell for one in steps for row in one.rows[:50] for cell in row)
    return "," if commas > points else "."
