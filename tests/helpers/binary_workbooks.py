"""Workbooks of Excel's binary formats (.xls, .xlsb), written record by record, without a library."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Mapping

Cells = Mapping[tuple[int, int], float | str]
"""Row and column, both from 0, to what stands there."""
_SECTOR = 512
_FREE, _END, _TABLE = 0xFFFFFFFF, 0xFFFFFFFE, 0xFFFFFFFD
_RELATION = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"


def write_xls(sheets: Mapping[str, Cells]) -> bytes:
    """A workbook of Excel 97 to 2003: BIFF8 in a compound file."""
    bodies = [_biff_sheet(cells) for cells in sheets.values()]
    names = [name.encode("latin-1") for name in sheets]
    heads = [struct.pack("<BBBB", 0, 0, len(name), 0) + name for name in names]
    begin = _biff(0x809, struct.pack("<HHHHII", 0x600, 5, 0, 0, 0, 0)) + _biff(0x42, struct.pack("<H", 1200))
    at = len(begin) + sum(4 + 4 + len(head) for head in heads) + 4
    book = begin
    for head, body in zip(heads, bodies, strict=True):
        book += _biff(0x85, struct.pack("<I", at) + head)
        at += len(body)
    return _compound(book + _biff(0x0A, b"") + b"".join(bodies))


def _biff(kind: int, content: bytes) -> bytes:
    return struct.pack("<HH", kind, len(content)) + content


def _biff_sheet(cells: Cells) -> bytes:
    last_row = max((row for row, _ in cells), default=0)
    last_column = max((column for _, column in cells), default=0)
    records = [_biff(0x809, struct.pack("<HHHHII", 0x600, 0x10, 0, 0, 0, 0))]
    records.append(_biff(0x200, struct.pack("<IIHHH", 0, last_row + 1, 0, min(last_column + 1, 0xFFFF), 0)))
    for (row, column), value in sorted(cells.items()):
        if isinstance(value, str):
            text = value.encode("latin-1")
            records.append(_biff(0x204, struct.pack("<HHHHB", row, column, 0, len(text), 0) + text))
        else:
            records.append(_biff(0x203, struct.pack("<HHHd", row, column, 0, value)))
    return b"".join(records) + _biff(0x0A, b"")


def _compound(stream: bytes) -> bytes:
    """A compound file of one stream: head, the stream's sectors, the directory, the table of sectors."""
    stream = stream.ljust(4096, b"\x00")  # shorter ones would stand in another stream
    sectors = -(-len(stream) // _SECTOR)
    tables = 1
    while tables * _SECTOR // 4 < sectors + 1 + tables:
        tables += 1
    chain = [*range(1, sectors), _END, _END, *[_TABLE] * tables]
    chain += [_FREE] * (tables * _SECTOR // 4 - len(chain))
    places = [sectors + 1 + i for i in range(tables)]
    head = struct.pack(
        "<8s16xHHHHH6xIIIIIIIIII",
        b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", 0x3E, 3, 0xFFFE, 9, 6, 0, tables, sectors, 0, 4096, _END, 0, _END, 0, places[0],
    )  # fmt: skip
    head += struct.pack(f"<{len(places) - 1}I", *places[1:])
    head = head.ljust(_SECTOR, b"\xff")
    root = _entry("Root Entry", 5, 1, _END, 0)
    directory = root + _entry("Workbook", 2, _FREE, 0, len(stream)) + bytes(256)
    return head + stream.ljust(sectors * _SECTOR, b"\x00") + directory + struct.pack(f"<{len(chain)}I", *chain)


def _entry(name: str, kind: int, child: int, start: int, size: int) -> bytes:
    letters = (name + "\x00").encode("utf-16-le")
    place = struct.pack("<HBBIII36xIQ", len(letters), kind, 1, _FREE, _FREE, child, start, size)
    return letters.ljust(64, b"\x00") + place


def write_xlsb(sheets: Mapping[str, Cells]) -> bytes:
    """A binary workbook of Excel 2007 and later: an archive of records."""
    listed = b"".join(
        _record(0x9C, struct.pack("<II", 0, i + 1) + _wide(f"r{i}") + _wide(name)) for i, name in enumerate(sheets)
    )
    book = _record(0x83) + _record(0x99, bytes(12)) + _record(0x8F) + listed + _record(0x90) + _record(0x84)
    relations = "".join(
        f'<Relationship Id="r{i}" Type="{_RELATION}/worksheet" Target="worksheets/sheet{i + 1}.bin"/>'
        for i in range(len(sheets))
    )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("xl/workbook.bin", book)
        archive.writestr("xl/_rels/workbook.bin.rels", f"<Relationships>{relations}</Relationships>")
        for i, cells in enumerate(sheets.values()):
            archive.writestr(f"xl/worksheets/sheet{i + 1}.bin", _binary_sheet(cells))
    return file.getvalue()


def _binary_sheet(cells: Cells) -> bytes:
    last_row = max((row for row, _ in cells), default=0)
    last_column = max((column for _, column in cells), default=0)
    records = [_record(0x81), _record(0x94, struct.pack("<IIII", 0, last_row, 0, last_column)), _record(0x91)]
    before = None
    for (row, column), value in sorted(cells.items()):
        if row != before:
            records.append(_record(0x00, struct.pack("<IIHHBI", row, 0, 300, 0, 0, 0)))
            before = row
        place = struct.pack("<II", column, 0)
        records.append(
            _record(0x06, place + _wide(value))
            if isinstance(value, str)
            else _record(0x05, place + struct.pack("<d", value))
        )
    return b"".join(records) + _record(0x92) + _record(0x82)


def _record(kind: int, content: bytes = b"") -> bytes:
    """The number of the kind in one byte or two, the length in sevens of bits."""
    number = bytes([kind]) if kind < 0x80 else bytes([kind & 0x7F | 0x80, kind >> 7])
    length, left = b"", len(content)
    while left > 0x7F:
        length, left = length + bytes([left & 0x7F | 0x80]), left >> 7
    return number + length + bytes([left]) + content


def _wide(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode("utf-16-le")
