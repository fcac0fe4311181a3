"""Workbooks in the order in which programs write their parts, which decides what is left when one is cut."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from xml.sax.saxutils import escape

_MAIN = "http://schemas.openxmlformats.org/spreadsheetml/2006/main"
_OFFICE = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006/relationships"
_KIND = "application/vnd.oasis.opendocument.spreadsheet"
_ODF = "urn:oasis:names:tc:opendocument:xmlns"

Rows = Sequence[Sequence[float]]


def write_excel(header: Sequence[str], rows: Rows, *, book_first: bool, format_of_first: bool = False) -> bytes:
    """An .xlsx of one sheet `run`, its names of columns in the list of texts.

    `book_first` is the order of Excel, else that of openpyxl, which writes the sheets before everything else. With
    `format_of_first` the first column has a format of its own.
    """
    texts = "".join(f"<si><t>{escape(name)}</t></si>" for name in header)
    first = "".join(f'<c r="{_letter(c)}1" t="s"><v>{c}</v></c>' for c in range(len(header)))
    body = "".join(
        f'<row r="{r}">'
        + "".join(
            f'<c r="{_letter(c)}{r}"{" s=" + chr(34) + "1" + chr(34) if format_of_first and c == 0 else ""}><v>{v!r}</v></c>'
            for c, v in enumerate(row)
        )
        + "</row>"
        for r, row in enumerate(rows, start=2)
    )
    root = f'<Relationships xmlns="{_PACKAGE}"><Relationship Id="r" Type="{_OFFICE}/officeDocument" Target="xl/workbook.xml"/></Relationships>'
    book = {
        "_rels/.rels": root,
        "xl/workbook.xml": f'<workbook xmlns="{_MAIN}" xmlns:r="{_OFFICE}"><sheets><sheet name="run" sheetId="1" r:id="a"/>'
        "</sheets></workbook>",
        "xl/_rels/workbook.xml.rels": f'<Relationships xmlns="{_PACKAGE}">'
        + "".join(
            f'<Relationship Id="{i}" Type="{_OFFICE}/{kind}" Target="{target}"/>'
            for i, kind, target in (
                ("a", "worksheet", "worksheets/sheet1.xml"), ("b", "styles", "styles.xml"), ("c", "sharedStrings", "sharedStrings.xml")
            )
        )
        + "</Relationships>",
    }  # fmt: skip
    sheet = {
        "xl/worksheets/sheet1.xml": f'<worksheet xmlns="{_MAIN}"><sheetData><row r="1">{first}</row>{body}</sheetData></worksheet>'
    }
    styles = {
        "xl/styles.xml": f'<styleSheet xmlns="{_MAIN}"><fonts count="1"><font/></fonts><fills count="1"><fill/></fills><borders '
        'count="1"><border/></borders><cellStyleXfs count="1"><xf numFmtId="0"/></cellStyleXfs><cellXfs count="2">'
        '<xf numFmtId="0" xfId="0"/><xf numFmtId="2" xfId="0"/></cellXfs></styleSheet>'
    }
    shared = {"xl/sharedStrings.xml": f'<sst xmlns="{_MAIN}">{texts}</sst>'}
    parts = book | sheet | styles | shared if book_first else sheet | shared | styles | book
    return _zip({"docProps/core.xml": "<a/>", **parts, "docProps/app.xml": "<a/>"})


def write_open_document(header: Sequence[str], rows: Rows) -> bytes:
    """An .ods of two sheets, `run` and `notes`."""
    lines = [[f'office:value-type="string"><text:p>{escape(n)}</text:p>' for n in header]]
    lines += [[f'office:value-type="float" office:value="{v!r}"><text:p>{v:.2f}</text:p>' for v in row] for row in rows]
    body = "".join(
        "<table:table-row>" + "".join(f"<table:table-cell {c}</table:table-cell>" for c in line) + "</table:table-row>"
        for line in lines
    )
    content = (
        f'<office:document-content xmlns:office="{_ODF}:office:1.0" xmlns:table="{_ODF}:table:1.0" xmlns:text="{_ODF}:text:1.0">'
        f'<office:body><office:spreadsheet><table:table table:name="run"><table:table-column/>{body}</table:table>'
        '<table:table table:name="notes"><table:table-row><table:table-cell office:value-type="string"><text:p>slow</text:p>'
        "</table:table-cell></table:table-row></table:table></office:spreadsheet></office:body></office:document-content>"
    )
    manifest = (
        f'<manifest:manifest xmlns:manifest="{_ODF}:manifest:1.0"><manifest:file-entry manifest:full-path="/" '
        f'manifest:media-type="{_KIND}"/></manifest:manifest>'
    )
    return _zip({"mimetype": _KIND, "content.xml": content, "styles.xml": "<a/>", "META-INF/manifest.xml": manifest})


def _letter(column: int) -> str:
    return chr(65 + column)


def _zip(parts: dict[str, str]) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
    return file.getvalue()
