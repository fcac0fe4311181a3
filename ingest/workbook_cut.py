"""Workbooks (.xlsx, .ods) without their end: what is left of them, as a workbook that a parser reads.

An .xlsx keeps rows, texts, formats and the names of its sheets in separate parts; those that are lost take something of the
rows with them: a cell whose text or format is lost is empty, for a number without its format may be a date. Does not belong here:
parsing of sheets (`ingest.excel_reader`), and .xls and .xlsb, which are not archives of XML.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path

from ingest.zip_cut import list_members
from schemas.errors import RefusedError

_LIMIT = 1 << 29
"""Most bytes that a part may inflate to."""
_BOOK, _RELATIONS = "xl/workbook.xml", "xl/_rels/workbook.xml.rels"
_ROOT = "_rels/.rels"
_TEXTS, _STYLES = "xl/sharedStrings.xml", "xl/styles.xml"
_SHEET = re.compile(r"xl/worksheets/[^/]*?(\d*)\.xml")
_BINARY_SHEET = re.compile(r"xl/worksheets/[^/]*\.bin")
_CONTENT, _KIND = "content.xml", "application/vnd.oasis.opendocument.spreadsheet"
_TAG = re.compile(rb"""<(/?)([A-Za-z][\w:.-]*)(?:[^<>"']|"[^"]*"|'[^']*')*?(/?)>""")
_CELL = re.compile(rb"<(?P<tag>(?:\w+:)?c)\b(?P<about>[^>]*?)(?:/>|>(?P<held>.*?)</(?:\w+:)?c>)", re.S)
_PLACE = re.compile(rb"""\sr=["'][A-Z]+[0-9]+["']""")
_TYPE = re.compile(rb"""\st=["'](\w+)["']""")
_FORMAT = re.compile(rb"""\ss=["']([0-9]+)["']""")
_NUMBER = re.compile(rb"<(?:\w+:)?v>\s*([0-9]+)")
_ROW = re.compile(rb"""<(?:\w+:)?row\s[^>]*?\br=["']([0-9]+)["']""")
_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006/relationships"
_MANIFEST = (
    '<manifest:manifest xmlns:manifest="urn:oasis:names:tc:opendocument:xmlns:manifest:1.0"><manifest:file-entry'
    f' manifest:full-path="/" manifest:media-type="{_KIND}"/></manifest:manifest>'
)


@dataclass
class _Left:
    """What is left of a workbook: its whole parts, the one that it ends in, and what is lost."""

    whole: dict[str, bytes] = field(default_factory=dict)
    begun: dict[str, bytes] = field(default_factory=dict)
    problems: list[str] = field(default_factory=lambda: ["the file ends too early"])


def mend_workbook(path: Path) -> tuple[bytes, tuple[str, ...]]:
    """A workbook of what is left of one without its end, and what is lost. Raises `RefusedError` where no row is left."""
    left = _Left()
    size = 0
    for member in list_members(path.read_bytes()):
        try:
            content = member.begin(_LIMIT + 1 - size)
        except zlib.error:
            continue
        size += len(content)
        if size > _LIMIT:
            raise RefusedError(
                f"the workbook inflates to more than {_LIMIT >> 20} MiB",
                where=path.name,
                expected=f"at most {_LIMIT >> 20} MiB",
            )
        if member.is_whole:
            left.whole[member.name] = content
        elif not member.is_there:
            left.begun[member.name] = content
    if any(_BINARY_SHEET.fullmatch(name) for name in (*left.whole, *left.begun)):
        raise RefusedError(
            "the workbook cannot be read: its end is missing, and sheets of .xlsb are not read without it",
            where=path.name,
            expected="a whole Excel or OpenDocument file",
            remedy="Copy the file again, or save it anew",
        )
    is_open_document = _CONTENT in left.whole or _CONTENT in left.begun
    parts = _mend_open_document(left) if is_open_document else _mend_excel(left)
    if not parts:
        raise RefusedError(
            "the workbook cannot be read: it ends before the first row of a sheet does",
            where=path.name,
            expected="a whole Excel or OpenDocument file",
            remedy="Copy the file again, or save it anew",
        )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return file.getvalue(), tuple(left.problems)


def _mend_open_document(left: _Left) -> dict[str, bytes]:
    """The parts of an .ods: all sheets are in one, each cell with its text."""
    content = left.whole.get(_CONTENT) or _end_behind(left.begun[_CONTENT], b"table-row")
    if _CONTENT in left.begun:
        left.problems.append("the sheet that it ends in has its whole rows, sheets behind it are lost")
    if not content:
        return {}
    return {"mimetype": _KIND.encode(), _CONTENT: content, "META-INF/manifest.xml": _MANIFEST.encode()}


def _mend_excel(left: _Left) -> dict[str, bytes]:
    """The parts of an .xlsx that matter for its rows."""
    sheets = {name: xml for name, xml in left.whole.items() if _SHEET.fullmatch(name)}
    for name, cut in left.begun.items():
        if _SHEET.fullmatch(name):
            ended = _end_behind(cut, b"row")
            if ended:
                sheets[name] = ended
            rows = _ROW.findall(ended)
            told = (
                f"has its rows up to {int(rows[-1])}" if rows else "has its whole rows" if ended else "has no whole row"
            )
            left.problems.append(f"{Path(name).stem}, in which it ends, {told}")
    if not sheets:
        return {}
    texts = left.whole.get(_TEXTS) or _end_behind(left.begun.get(_TEXTS, b""), b"si")
    known = len(re.findall(rb"</(?:\w+:)?si>|<(?:\w+:)?si\s*/>", texts))
    lost = _Lost(known if _TEXTS not in left.whole else None, _STYLES not in left.whole)
    parts = {name: _CELL.sub(lost.empty_cell, xml) if lost.is_any else xml for name, xml in sheets.items()}
    parts[_ROOT] = _relate(("book", "officeDocument", _BOOK))
    left.problems += lost.describe()
    parts |= {_TEXTS: texts} if texts else {}
    parts |= {_STYLES: left.whole[_STYLES]} if _STYLES in left.whole else {}
    if {_BOOK, _RELATIONS} <= set(left.whole):
        return parts | {name: left.whole[name] for name in (_BOOK, _RELATIONS)}
    left.problems.append("the names of its sheets are lost: they are called as its parts")
    return parts | _list_sheets(sorted(sheets, key=_number_of), with_texts=bool(texts), with_styles=not lost.formats)


@dataclass
class _Lost:
    """Which cells lose something: those with texts from number `texts` on (None: no text is lost), those with a format."""

    texts: int | None
    formats: bool
    emptied: dict[str, int] = field(default_factory=lambda: {"text": 0, "format": 0})

    @property
    def is_any(self) -> bool:
        return self.texts is not None or self.formats

    def empty_cell(self, found: re.Match[bytes]) -> bytes:
        """The cell as it is, or empty where its text or its format is lost."""
        kind = _TYPE.search(found["about"])
        number = _NUMBER.search(found["held"] or b"")
        if number is None:
            return found[0]
        if kind is not None and kind[1] == b"s":
            what = "text" if self.texts is not None and int(number[1]) >= self.texts else ""
        else:
            style = _FORMAT.search(found["about"])
            plain = kind is not None and kind[1] != b"n"
            what = "format" if self.formats and not plain and style is not None and int(style[1]) else ""
        if not what:
            return found[0]
        self.emptied[what] += 1
        place = _PLACE.search(found["about"])
        return b"<" + found["tag"] + (place[0] if place else b"") + b"/>"

    def describe(self) -> list[str]:
        """What is lost, in words."""
        texts, formats = self.emptied["text"], self.emptied["format"]
        told = (
            [f"the list of its texts is lost: {texts} cells of text are empty; columns can be mapped by number"]
            if texts
            else []
        )
        return told + (
            [f"the list of its formats is lost: {formats} numbers that may be dates are empty"] if formats else []
        )


def _list_sheets(names: list[str], *, with_texts: bool, with_styles: bool) -> dict[str, bytes]:
    """The parts that say which sheets there are."""
    listed = "".join(f'<sheet name="{Path(name).stem}" sheetId="{i + 1}" r:id="r{i}"/>' for i, name in enumerate(names))
    targets = [(f"r{i}", "worksheet", name.removeprefix("xl/")) for i, name in enumerate(names)]
    targets += [("texts", "sharedStrings", "sharedStrings.xml")] * with_texts
    targets += [("styles", "styles", "styles.xml")] * with_styles
    book = f'<workbook xmlns="{_MAIN}" xmlns:r="{_OFFICE}"><sheets>{listed}</sheets></workbook>'
    return {_BOOK: book.encode(), _RELATIONS: _relate(*targets)}


def _relate(*targets: tuple[str, str, str]) -> bytes:
    """The part that says which other parts belong to one: name, kind and place of each."""
    listed = "".join(
        f'<Relationship Id="{one}" Type="{_OFFICE}/{kind}" Target="{place}"/>' for one, kind, place in targets
    )
    return f'<Relationships xmlns="{_PACKAGE}">{listed}</Relationships>'.encode()


def _number_of(name: str) -> int:
    """The number in the name of a sheet's part: programs number them in their order."""
    found = _SHEET.fullmatch(name)
    return int(found[1] or 0) if found else 0


def _end_behind(xml: bytes, tag: bytes) -> bytes:
    """XML up to the last end of an element of that name, with all that is open there closed; nothing where there is none."""
    ends = [found.end() for found in re.finditer(rb"</(?:[\w-]+:)?" + re.escape(tag) + rb">", xml)]
    if not ends:
        return b""
    content = xml[: ends[-1]]
    still_open: list[bytes] = []
    for found in _TAG.finditer(content):
        closing, name, empty = found.groups()
        if closing:
            if name in still_open:
                del still_open[len(still_open) - 1 - still_open[::-1].index(name) :]
        elif not empty:
            still_open.append(name)
    return content + b"".join(b"</" + name + b">" for name in reversed(still_open))
