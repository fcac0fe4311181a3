"""How large the sheets of a workbook are, before a library makes all cells between the first and the last.

Two cells in opposite corners of a sheet of Excel take it 500 GB, for which the whole process ends. Sheets of .xlsx and
.xlsb are made one at a time, those of .xls and .ods all at once when the workbook is opened. Does not belong here: what
stands in the cells (`ingest.excel_reader`).
"""

from __future__ import annotations

import re
import struct
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, TypeAlias

from ingest.compound_file import is_compound, read_stream

_PIECE = 1 << 20
_LONGEST_TAG = 1 << 16
"""Bytes of a tag that goes on in the next piece."""
_SMALL = 1 << 20
"""Cells that are made in any case, in a second and 100 MB."""
_MOST_PER_FILLED = 8
"""Cells that are made for each that holds something."""
_PLACE = re.compile(rb"""\sr\s*=\s*["']\s*([A-Za-z]{0,8})([0-9]{1,10})""")
"""Where a cell or a row of a sheet's XML says that it stands."""
_UNPLACED = re.compile(rb"""<(?:\w+:)?(c|row)(?=[\s/>])(?![^>]*\sr\s*=)""")
"""A cell or a row that does not say where it stands: it is behind the one before."""
_SHEET = re.compile(rb"""<(?:\w+:)?sheet\s[^>]*?:id\s*=\s*["']([^"']{1,200})["']""")
_RELATION = re.compile(rb"<(?:\w+:)?Relationship\s[^>]*>")
_OPEN_DOCUMENT = "content.xml"
_BINARY_BOOK = "xl/workbook.bin"
_TABLE_TAG = re.compile(
    rb"<(/?)(?:[\w-]+:)?(table|table-row|table-cell|covered-table-cell)(?=[\s/>])((?:[^<>\"']|\"[^\"]*\"|'[^']*')*?)(/?)>(?=(</)?)"
)
_REPEATED = re.compile(rb"""number-(?:rows|columns)-repeated\s*=\s*["']\s*([0-9]{1,18})""")
_BUNDLE = 0x9C
"""The record of .xlsb that names a sheet and where it is."""
_LAST_CELL_RECORD = 11
"""In .xlsb a row is record 0, the cells of all kinds are 1 to this."""
_NAMES_OF_STREAMS = ("Workbook", "Book")
_BEGIN, _END = (0x09, 0x209, 0x409, 0x809), 0x0A
_SHEET_PLACE, _DIMENSIONS, _MANY_NUMBERS = 0x85, 0x200, 0xBD
_CELLS = frozenset((0x02, 0x03, 0x04, 0x05, 0x06, 0x07, 0xD6, 0xFD, 0x203, 0x204, 0x205, 0x206, 0x406, 0x27E))
"""Records of .xls that are one cell and begin with its row and column."""


@dataclass(frozen=True)
class Size:
    """Rows and columns of a sheet up to its last cell, and how many cells hold something.

    Of several that are made at once `height` and `width` are those of the largest, `cells` and `filled` of all together.
    """

    height: int
    width: int
    cells: int
    filled: int
    stated: int = 0
    """Cells that a sheet says to have, of which more are made room for than are made."""

    @property
    def is_sparse(self) -> bool:
        """Next to nothing stands in the cells that would be made: a few of them lie far away from the others."""
        return self.cells > _SMALL and self.cells > _MOST_PER_FILLED * self.filled


_Measured: TypeAlias = tuple[int, int, int]
"""Rows, columns, and cells that hold something."""


def measure_workbook(path: Path) -> Size:
    """What opening a workbook makes: all sheets of .xls and .ods, none of other formats."""
    sizes: list[_Measured] = []
    stated = 0
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            if _OPEN_DOCUMENT in archive.namelist():
                with archive.open(_OPEN_DOCUMENT) as file:
                    sizes = list(_measure_tables(file))
    elif is_compound(path):
        sizes, stated = _measure_streams(path.read_bytes())
    height, width, _ = max(sizes, key=lambda size: size[0] * size[1], default=(0, 0, 0))
    return Size(height, width, sum(rows * columns for rows, columns, _ in sizes), sum(n for _, _, n in sizes), stated)


def measure_sheet(path: Path, number: int) -> Size:
    """What making a sheet of .xlsx or .xlsb makes; nothing for other formats."""
    height = width = filled = 0
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            is_binary = _BINARY_BOOK in (name.lower() for name in archive.namelist())
            for member in _find_binary_members(archive) if is_binary else _find_members(archive, number):
                with archive.open(member) as file:
                    rows, columns, held = _measure_records(file.read()) if is_binary else _measure_xml(file)
                height, width, filled = max(height, rows), max(width, columns), filled + held
    return Size(height, width, height * width, filled)


def _find_members(archive: zipfile.ZipFile, number: int) -> list[str]:
    """The members that hold a sheet of .xlsx; all that may be one where the workbook does not say which."""
    names = archive.namelist()
    sheets = [name for name in names if name.startswith("xl/worksheets/") and name.endswith(".xml")]
    others = [name for name in names if name.lower().endswith(".xml")]
    try:
        wanted = _SHEET.findall(archive.read("xl/workbook.xml"))[number]
        relations = _RELATION.findall(archive.read("xl/_rels/workbook.xml.rels"))
    except (KeyError, IndexError):
        return others
    for relation in relations:
        values = dict(re.findall(rb"""\s(Id|Target)\s*=\s*["']([^"']*)["']""", relation))
        if values.get(b"Id") == wanted:
            target = PurePosixPath("/xl", values.get(b"Target", b"").decode("utf-8", "replace")).as_posix()[1:]
            return [target] if target in sheets else others
    return others


def _find_binary_members(archive: zipfile.ZipFile) -> list[str]:
    """The members that hold sheets of .xlsb."""
    return [name for name in archive.namelist() if name.lower().endswith(".bin") and "worksheets/" in name.lower()]


def _in_pieces(file: IO[bytes]) -> Iterator[bytes]:
    """The XML of a member in pieces that no tag lies across, but for one that is longer than any sound one."""
    rest = b""
    while piece := file.read(_PIECE):
        piece = rest + piece
        cut = piece.rfind(b"<", 1)
        if cut > 0 and len(piece) - cut <= _LONGEST_TAG:
            piece, rest = piece[:cut], piece[cut:]
        else:
            rest = b""
        yield piece
    yield rest


def _measure_xml(file: IO[bytes]) -> _Measured:
    """The size of a sheet of .xlsx. What does not say where it stands follows what stands before it."""
    height, letters, filled, unplaced_rows, unplaced, most = 0, {b""}, 0, 0, 0, 0
    for piece in _in_pieces(file):
        found = _PLACE.findall(piece)
        height = max(height, max((int(row) for _, row in found), default=0))
        columns = [column for column, _ in found if column]
        letters |= set(columns)
        filled += len(columns)
        for kind in _UNPLACED.findall(piece) if _UNPLACED.search(piece) else ():
            if kind == b"c":
                unplaced += 1
                filled += 1
                most = max(most, unplaced)
            else:
                unplaced_rows += 1
                unplaced = 0
    return height + unplaced_rows, max(_number_column(column) for column in letters) + most, filled


def _number_column(letters: bytes) -> int:
    """A = 1, Z = 26, AA = 27; 0 for none."""
    number = 0
    for letter in letters.upper():
        number = 26 * number + letter - ord("A") + 1
    return number


def _measure_records(content: bytes) -> _Measured:
    """The size of a sheet of .xlsb."""
    at, height, width, filled = 0, 0, 0, 0
    end = len(content)
    while at + 2 < end:
        kind = content[at]
        at += 1
        if kind & 0x80:
            kind = kind & 0x7F | (content[at] & 0x7F) << 7
            at += 1
        length = 0
        for place in range(0, 28, 7):
            piece = content[at] if at < end else 0
            at += 1
            length |= (piece & 0x7F) << place
            if not piece & 0x80:
                break
        if kind <= _LAST_CELL_RECORD and at + 4 <= end:
            number = int.from_bytes(content[at : at + 4], "little")
            if kind:
                width = max(width, number + 1)
                filled += 1
            else:
                height = max(height, number + 1)
        at += length
    return height, width, filled


def _measure_tables(file: IO[bytes]) -> Iterator[_Measured]:
    """The size of each sheet of an .ods, up to the last cell that holds something."""
    row = column = last_row = last_column = row_end = filled = 0
    repeated = 1
    for piece in _in_pieces(file):
        for closing, name, about, is_empty, ends_at_once in _TABLE_TAG.findall(piece):
            times = max(1, int(told[1])) if (told := _REPEATED.search(about)) else 1
            if name == b"table":
                if last_row:
                    yield last_row, last_column, filled
                row = last_row = last_column = filled = 0
            elif name == b"table-row":
                if not closing:
                    column = row_end = 0
                    repeated = times
                if closing or is_empty:
                    row += repeated
                    if row_end:
                        last_row, last_column = row, max(last_column, row_end)
            elif not closing:
                column += times
                if b"value-type" in about or not (is_empty or ends_at_once):
                    row_end = column
                    filled += 1
    if last_row:
        yield last_row, last_column, filled


def _measure_streams(content: bytes) -> tuple[list[_Measured], int]:
    """The size of each sheet of an .xls, and how many cells they say to have."""
    sizes: list[_Measured] = []
    total = 0
    for name in _NAMES_OF_STREAMS:
        book = read_stream(content, name)
        known: dict[int, tuple[_Measured, int]] = {}
        for kind, start, length in _list_records(book, 0):
            if kind == _SHEET_PLACE and length >= 4:
                (place,) = struct.unpack_from("<I", book, start)
                if place not in known:
                    known[place] = _measure_stream(book, place)
                size, stated = known[place]
                sizes.append(size)
                total += stated
    return sizes, total


def _list_records(book: bytes, at: int) -> Iterator[tuple[int, int, int]]:
    """(kind, place, length) of the records of an .xls from a place on, up to the end of what begins there."""
    open_parts = 0
    while at + 4 <= len(book):
        kind, length = struct.unpack_from("<HH", book, at)
        yield kind, at + 4, min(length, len(book) - at - 4)
        at += 4 + length
        open_parts += (kind in _BEGIN) - (kind == _END)
        if kind == _END and open_parts <= 0:
            return


def _measure_stream(book: bytes, at: int) -> tuple[_Measured, int]:
    """The size of a sheet of an .xls, and how many cells it says to have."""
    height = width = filled = stated = 0
    for kind, start, length in _list_records(book, at):
        if kind in _CELLS and length >= 4:
            row, column = struct.unpack_from("<HH", book, start)
            filled += 1
        elif kind == _MANY_NUMBERS and length >= 6:
            row, first = struct.unpack_from("<HH", book, start)
            (column,) = struct.unpack_from("<H", book, start + length - 2)
            filled += max(1, column - first + 1)
        elif kind == _DIMENSIONS and length >= 10:
            rows, columns = struct.unpack_from("<4xI2xH" if length >= 14 else "<2xH2xH", book, start)
            stated = max(stated, rows * columns)
            continue
        else:
            continue
        height, width = max(height, row + 1), max(width, column + 1)
    return (height, width, filled), stated
