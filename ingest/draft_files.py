"""A file without a mapping as it seems to be: its format's own keys, its columns, some rows, and what it says of the test.

Does not belong here: what its columns mean (`ingest.draft_columns`), what has to be asked (`ingest.questions`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ingest import lvm_reader, trios_reader
from ingest.arrays import ArrayFile
from ingest.columns import ColumnFile
from ingest.compressed import TEXTS, find_held_suffix, is_compressed, read_plain_content
from ingest.encodings import guess_encoding
from ingest.formats import list_formats
from ingest.harvest import Fact, by_key, harvest_columns, harvest_hdf5, harvest_lines, harvest_rows
from ingest.heads import join_heads
from ingest.mapping import FileMapping, format_of, format_of_suffix
from ingest.mapping_keys import RECORDING
from ingest.meanings import TIME, GuessedColumn, guess_columns, guess_joined, is_any_unit
from ingest.read import open_columns
from ingest.sniff import are_units, guess_text, is_number
from schemas.errors import DealabError, RefusedError

_DECIMAL_COMMA = re.compile(r"-?\d+,\d+")
_MOST_MATRIX_COLUMNS = 12
_FIRST_CELLS = 2000
_TABBED = ("lvm", "trios")
_BEGINNING = 1 << 17
"""Bytes in which a text shows what wrote it: heads of TRIOS take some 20 kB."""
_FIRST_ROWS = 60
"""Rows of a sheet in which small tables of sizes are looked for."""
_PACKED = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""How workbooks begin, new and old ones."""


@dataclass(frozen=True)
class Opened:
    """A file as it seems to be: its format's own keys, its columns, some rows, and what it says of the test."""

    path: Path
    format: str
    options: Mapping[str, Any]
    columns: tuple[GuessedColumn, ...]
    rows: Sequence[Sequence[Any]] = ()
    facts: Mapping[str, Fact] = field(default_factory=dict)
    about: tuple[str, ...] = ()
    has_own_time: bool = False
    begins: tuple[int, ...] = (0,)
    """First rows of the runs that the file itself tells apart."""
    words: tuple[str, ...] = ()
    """All texts of a sheet, and of a text the lines above and below its table: what its marks mean may stand there."""

    def cells(self, column: GuessedColumn) -> list[Any]:
        """The first cells of a column; none where the rows were not looked at."""
        if not self.rows:
            return self._cells_of_array(column)
        place = column.column if isinstance(column.column, int) else self.columns.index(column)
        return [row[place] for row in self.rows if place < len(row)]

    def _cells_of_array(self, column: GuessedColumn) -> list[Any]:
        mapping = FileMapping(RECORDING, self.format, dict(self.options), None, {}, {}, {})
        try:
            cells = open_columns(self.path, self.format, mapping).cells(column.column, column.index)
            return ["" if cell is None else cell for cell in cells[:_FIRST_CELLS]]
        except DealabError:
            return []


def open_file(path: Path, said: Mapping[str, str]) -> Opened:
    found = _true_format(path)
    if found == "csv":
        guess = guess_text(read_plain_content(path).content, said)
        d = guess.dialect
        options = {
            "delimiter": d.delimiter,
            "decimal": d.decimal,
            "encoding": d.encoding,
            "skip_rows": d.skip_rows,
            "header": d.header,
            "unit_row": d.unit_row,
        }
        about: tuple[str, ...] = ()
        if d.comment:
            options["comment"] = d.comment
            about = (f"lines that hold {d.comment.split()[0]} alone are marks of the machine: left out",)
        columns = _with_time_first(guess.columns)
        return Opened(path, found, options, columns, guess.rows, by_key(guess.facts), about, words=guess.words)
    if found == "excel":
        return open_sheets(path, said)[0]
    if found in _TABBED:
        return _open_tabbed(path, found, said)
    if found == "mcap":
        raise RefusedError("no channel can be guessed", where=path.name, expected="topics mapped by hand in a TOML")
    if found is None:
        raise RefusedError(
            "neither its ending nor its content tells its format",
            where=path.name,
            expected=", ".join(list_formats()),
            remedy='Write format = "..." into a TOML beside it, or export the data as text',
        )
    return _open_arrays(path, found, said)


def _true_format(path: Path) -> str | None:
    """The format by the file's ending, but for workbooks named as text and texts named as workbooks."""
    found = format_of(path)
    if is_compressed(path):
        held = format_of_suffix(find_held_suffix(path))
        held = found or (held if held in TEXTS else None)
        return (_tell_text(read_plain_content(path).content[:_BEGINNING]) or held) if held == "csv" else held
    with path.open("rb") as file:
        start = file.read(_BEGINNING)
    if found is None and start and b"\x00" not in start and not start.startswith(_PACKED):
        found = "csv"  # machines name their texts after themselves: .TRA, .rdat, none at all
    if found == "csv" and (told := _tell_text(start)) is not None:
        return told
    start = start[:4096]
    is_workbook = start.startswith(_PACKED)
    if found in ("csv", None) and is_workbook:
        return "excel"
    if found == "excel" and not is_workbook and start and b"\x00" not in start:
        return "csv"
    return found


def _tell_text(start: bytes) -> str | None:
    """The format of a text by its first lines, where it is one with a reader of its own."""
    text = start.decode(guess_encoding(start), "replace").removeprefix("\ufeff")
    if text.startswith(lvm_reader.BEGINS) and lvm_reader.ENDS in text:
        return "lvm"
    lines = text.splitlines()
    marks = [number for number, line in enumerate(lines) if line.strip() in trios_reader.MARKS]
    # The same export with commas is a table behind a head, as any other.
    return "trios" if marks and any("\t" in line for line in lines[marks[0] :]) else None


def _open_tabbed(path: Path, found: str, said: Mapping[str, str]) -> Opened:
    """A text with heads of its own: the columns by their names and units, and what the heads say."""
    content = read_plain_content(path).content
    encoding = guess_encoding(content)
    options = {} if encoding == "utf-8" else {"encoding": encoding}
    file = open_columns(path, found, FileMapping(RECORDING, found, options, None, {}, {}, {}))
    names = file.names()
    units = [file.unit(i) or "" for i in range(len(names))]
    columns = guess_columns(names, [u if is_any_unit(u) else "" for u in units], len(names), said)
    if found == "lvm":
        columns = tuple(c for c in columns if c.column not in (lvm_reader.X_VALUE, lvm_reader.COMMENT))
        facts = harvest_lines(lvm_reader.find_facts(path, encoding))
        begins = file.begins if isinstance(file, lvm_reader.LvmFile) else (0,)
        return Opened(path, found, options, columns, (), by_key(facts), (), has_own_time=True, begins=begins)
    facts = harvest_lines(trios_reader.find_facts(content.decode(encoding, "replace")))
    return Opened(path, found, options, columns, (), by_key(facts))


def is_workbook(path: Path) -> bool:
    """Whether a file is read as sheets."""
    return _true_format(path) == "excel"


def open_sheets(path: Path, said: Mapping[str, str]) -> list[Opened]:
    """The sheets of a workbook, the longest first. Sheets with the same columns are one, read one below the other."""
    from ingest.excel_reader import sheet_names, sheet_rows

    found: list[Opened] = []
    read = [(name, sheet_rows(path, name)) for name in sheet_names(path)]
    for name, rows in sorted(read, key=lambda pair: -len(pair[1])):
        one = _open_sheet(path, name, rows, said)
        alike = next((i for i, other in enumerate(found) if _are_alike(one, other)), None)
        if alike is None:
            found.append(one)
        else:
            found[alike] = _below(found[alike], one)
    order = [name for name, _ in read]
    paired = [row for _, rows in read for row in rows if sum(bool(str(c).strip()) for c in row) in (2, 3)]
    of_tables = [fact for _, rows in read for fact in harvest_columns(rows[:_FIRST_ROWS])]
    said_anywhere = by_key((*harvest_rows(paired), *of_tables))
    everywhere = tuple(word for one in found for word in one.words)
    joined = [
        replace(
            _in_order(one, order),
            facts=by_key((*one.facts.values(), *said_anywhere.values())),
            words=(*one.words, *everywhere),
        )
        for one in found
    ]
    return sorted(joined, key=lambda one: -len(one.rows))


def only_sheet(path: Path, sheet: str, said: Mapping[str, str]) -> Opened:
    """One sheet by itself."""
    from ingest.excel_reader import sheet_rows

    return _open_sheet(path, sheet, sheet_rows(path, sheet), said)


def name_sheets(opened: Opened) -> list[str]:
    """The sheets that are read."""
    sheets = opened.options.get("sheet")
    return [str(s) for s in sheets] if isinstance(sheets, list) else [str(sheets)]


def _are_alike(one: Opened, other: Opened) -> bool:
    """Whether two sheets have the same columns in the same rows, and not the same numbers."""
    first, second = (tuple((c.column, c.unit, c.written_unit) for c in sheet.columns) for sheet in (one, other))
    options = [{k: v for k, v in sheet.options.items() if k != "sheet"} for sheet in (one, other)]
    named = len(first) > 1 and bool(one.options.get("header"))
    same = [list(row) for row in one.rows] == [list(row) for row in other.rows[: len(one.rows)]]
    return named and first == second and options[0] == options[1] and bool(one.rows) and not same


def _below(upper: Opened, lower: Opened) -> Opened:
    sheets = upper.options["sheet"] if isinstance(upper.options["sheet"], list) else [upper.options["sheet"]]
    options = {**upper.options, "sheet": [*sheets, lower.options["sheet"]]}
    return replace(upper, options=options, rows=[*upper.rows, *lower.rows], facts={**lower.facts, **upper.facts})


def _in_order(opened: Opened, order: Sequence[str]) -> Opened:
    """Sheets that are read together in the order in which they stand in the workbook."""
    sheets = opened.options["sheet"]
    return (
        opened
        if not isinstance(sheets, list)
        else replace(opened, options={**opened.options, "sheet": sorted(sheets, key=order.index)})
    )


def _open_sheet(path: Path, sheet: str, rows: Sequence[Sequence[Any]], said: Mapping[str, str]) -> Opened:
    decimal = (
        "," if any(isinstance(c, str) and _DECIMAL_COMMA.fullmatch(c.strip()) for row in rows for c in row) else "."
    )
    numbers = [sum(_is_number(c, decimal) for c in row) for row in rows]
    usual = max(set(numbers) - {0}, key=numbers.count, default=0)
    start = next((i for i, n in enumerate(numbers) if n and n >= usual), 0)
    above = [i for i in range(start) if any(str(c).strip() for c in rows[i])]
    header = [str(c).strip() for c in rows[above[-1]]] if above else []
    units: list[str] = []
    if len(above) > 1 and (are_units(header) or _is_below(header, rows[above[-2]], above[-1] - above[-2])):
        header, units = [str(c).strip() for c in rows[above[-2]]], header
    fields = len(rows[start]) if rows else 0
    adjacent = len(above) > 1 and not units and above[-1] - above[-2] == 1
    full = join_heads([str(c) for c in rows[above[-2]]], header) if adjacent else []
    guessed = guess_joined(full, fields, said) if full else guess_columns(header, units, fields, said)
    skip = start - (len(header) > 0) - (len(units) > 0)
    options = {"sheet": sheet, "skip_rows": skip, "header": bool(header), "unit_row": bool(units)}
    options |= {} if decimal == "." else {"decimal": decimal}
    facts = (*harvest_rows(rows[:skip]), *harvest_columns(rows[:skip]))
    texts = [[cell.strip() for cell in row if isinstance(cell, str) and cell.strip()] for row in rows]
    filled = [sum(bool(str(cell).strip()) for cell in row) for row in rows]
    pairs = [f"{row[0]} = {row[1]}" for row, count in zip(texts, filled, strict=True) if len(row) == count == 2]
    words = (*pairs, *(text for row in texts for text in row))  # a legend may stand in two columns
    return Opened(path, "excel", options, _with_time_first(guessed), rows[start:], by_key(facts), words=words)


def _is_below(lower: Sequence[str], upper: Sequence[Any], distance: int) -> bool:
    """Whether a row only adds to the names right above it, such as `[Tsd.]` under one of them."""
    filled = [i for i, text in enumerate(lower) if text]
    names = [i for i, cell in enumerate(upper) if str(cell).strip()]
    return distance == 1 and bool(filled) and 2 * len(filled) <= len(names) and set(filled) <= set(names)


def _is_number(cell: Any, decimal: str) -> bool:
    if isinstance(cell, bool) or cell is None:
        return False
    if isinstance(cell, str):
        return is_number(cell.strip(), decimal)
    return True


def _open_arrays(path: Path, found: str, said: Mapping[str, str]) -> Opened:
    mapping = FileMapping(RECORDING, found, {}, None, {}, {}, {})
    file = open_columns(path, found, mapping)
    names = file.names()
    separator = {"matlab": ".", "arrow": None}.get(found, "/")
    short = [n if separator is None else n.rsplit(separator, 1)[-1] for n in names]
    guessed = guess_columns(
        [s if short.count(s) == 1 else n for s, n in zip(short, names, strict=True)],
        [file.unit(n) or "" for n in names],
        len(names),
        said,
    )
    columns: list[GuessedColumn] = []
    for number, (name, guess) in enumerate(zip(names, guessed, strict=False)):
        shape = file.shape(name) if isinstance(file, ArrayFile) else ()
        matrix = len(shape) == 2 and 1 < min(shape) <= _MOST_MATRIX_COLUMNS
        if matrix and guess.meaning is None:
            columns += [GuessedColumn(name, guess.unit, None, index=i) for i in range(min(shape))]
        else:
            columns.append(replace(guess, column=name if name and names.count(name) == 1 else number))
    about = ["the arrays of the file; a column of a matrix is index = 0, 1, …"] if isinstance(file, ArrayFile) else []
    about += [f'"{name}": {" × ".join(map(str, file.shape(name)))}' for name in names if isinstance(file, ArrayFile)]
    is_hdf5 = found == "hdf5" or (found == "matlab" and path.read_bytes()[:4] == b"\x89HDF")
    facts = by_key(harvest_hdf5(path)) if is_hdf5 else {}
    own_time = found in ("tdms", "uff", "mdf")
    return Opened(path, found, {}, tuple(columns), (), facts, tuple(about), own_time)


def _with_time_first(columns: Sequence[GuessedColumn]) -> tuple[GuessedColumn, ...]:
    """Columns of a file without any names: the first is taken for the time, as nearly every recorder writes it."""
    if columns and all(isinstance(c.column, int) for c in columns) and not any(c.meaning for c in columns):
        return (replace(columns[0], meaning=TIME), *columns[1:])
    return tuple(columns)


def map_each_column(mapping: FileMapping, columns: Sequence[GuessedColumn]) -> FileMapping:
    """The mapping with every column as one that is wanted, by its number."""
    from ingest.mapping import ColumnMapping

    return replace(mapping, columns={str(i): ColumnMapping(c.column, index=c.index) for i, c in enumerate(columns)})


def read_numbers(file: ColumnFile, column: GuessedColumn) -> Any:
    try:
        return file.numbers(column.column, column.index).values
    except DealabError:
        return None


def make_format_keys(opened: Opened) -> dict[str, Any]:
    """The format's table, and its name where the file's ending says another one."""
    named = {} if format_of(opened.path) == opened.format else {"format": opened.format}
    return {**named, opened.format: dict(opened.options)}
