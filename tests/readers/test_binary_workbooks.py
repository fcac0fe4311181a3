"""Workbooks of the binary formats and of OpenDocument: cells far away from the data, files that are cut, records that lie."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from ingest.excel_reader import sheet_names, sheet_rows
from ingest.inspect import inspect
from schemas.errors import RefusedError
from tests.helpers.binary_workbooks import Cells, write_xls, write_xlsb
from tests.helpers.cut_workbooks import write_excel, write_open_document

ROWS = 60
DATA: Cells = {
    (0, 0): "t", (0, 1): "F", **{(r, 0): r / 100 for r in range(1, ROWS)}, **{(r, 1): 1.5 * r for r in range(1, ROWS)}
}  # fmt: skip
LINES = [[r / 100, 1.5 * r] for r in range(1, ROWS)]
WRITERS = {".xls": write_xls, ".xlsb": write_xlsb}


def changed(content: bytes, member: str, change: Callable[[str], str], *, name: str | None = None) -> bytes:
    """An archive of which one member is another, and has another name."""
    made = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as new:
        for part in old.namelist():
            text = old.read(part).decode()
            new.writestr(name or part if part == member else part, change(text) if part == member else text)
    return made.getvalue()


def put_rows(rows: str) -> bytes:
    """An .ods with more rows behind those of its first sheet."""
    end = '</table:table><table:table table:name="notes">'
    content = write_open_document(["t", "F"], LINES)
    return changed(content, "content.xml", lambda text: text.replace(end, rows + end))


def put_xml(xml: str, **options: str) -> bytes:
    """An .xlsx with more rows behind those of its sheet."""
    content = write_excel(["t", "F"], LINES, book_first=True)
    return changed(
        content, "xl/worksheets/sheet1.xml", lambda text: text.replace("</sheetData>", xml + "</sheetData>"), **options
    )


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_sound_one_is_read(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"run{suffix}"
    path.write_bytes(WRITERS[suffix]({"run": DATA, "notes": {(0, 0): "slow"}}))
    assert sheet_names(path) == ("run", "notes")
    assert sheet_rows(path, "run") == [["t", "F"], *LINES]
    large = {(r, c): float(r) for r in range(9000) for c in range(4)}
    path.write_bytes(WRITERS[suffix]({"run": large}))
    assert len(sheet_rows(path, 0)) == 9000


FILLED = 'office:value-type="float" office:value="5"'
FAR: dict[str, tuple[str, bytes]] = {
    "xlsb, opposite corners": (".xlsb", write_xlsb({"run": {**DATA, (1_048_575, 16_383): 5.0}})),
    "xlsb, one column": (".xlsb", write_xlsb({"run": {**DATA, (1_048_575, 20): 5.0}})),
    "xls, opposite corners": (".xls", write_xls({"run": {**DATA, (65_535, 255): 5.0}})),
    "xls, more columns than there are": (".xls", write_xls({"run": {**DATA, (65_535, 65_535): 5.0}})),
    "xls, many sheets": (".xls", write_xls({f"s{i}": {**DATA, (65_535, 15): 5.0} for i in range(30)})),
    "ods, rows": (".ods", put_rows(f'<table:table-row table:number-rows-repeated="1000000000"><table:table-cell/></table:table-row>'
                                   f"<table:table-row><table:table-cell {FILLED}/></table:table-row>")),
    "ods, columns": (".ods", put_rows(f'<table:table-row><table:table-cell table:number-columns-repeated="1000000000"/>'
                                      f"<table:table-cell {FILLED}/></table:table-row>")),
    "ods, a row repeated": (".ods", put_rows(f'<table:table-row table:number-rows-repeated="1000000000"><table:table-cell {FILLED}/>'
                                             "</table:table-row>")),
    "ods, a cell repeated": (".ods", put_rows(f'<table:table-row><table:table-cell table:number-columns-repeated="1000000000" {FILLED}/>'
                                              "</table:table-row>")),
    "xlsx, blanks about the sign": (".xlsx", put_xml('<row r = "1048576"><c r = "XFD1048576"><v>5</v></c></row>')),
    "xlsx, small letters": (".xlsx", put_xml('<row r="1048576"><c r="xfd1048576"><v>5</v></c></row>')),
    "xlsx, a row of nine digits": (".xlsx", put_xml('<row r="999999999"><c r="A999999999"><v>5</v></c></row>')),
    "xlsx, a column of six letters": (".xlsx", put_xml('<row r="99"><c r="AAAAAA99"><v>5</v></c></row>')),
    "xlsx, a cell that does not say where": (".xlsx", put_xml('<row r="1048576"><c><v>5</v></c></row>')),
    "xlsx, sixteen columns": (".xlsx", put_xml('<row r="1048576"><c r="P1048576"><v>5</v></c></row>')),
    "xlsx, a part in another case": (".xlsx", put_xml('<row r="1048576"><c r="XFD1048576"><v>5</v></c></row>',
                                                      name="xl/Worksheets/sheet1.XML")),
}  # fmt: skip


@pytest.mark.long_after(5)
@pytest.mark.parametrize("kind", FAR)
def test_cells_far_out_are_refused_before_what_is_between_them_is_made(kind: str, tmp_path: Path) -> None:
    suffix, content = FAR[kind]
    path = tmp_path / f"run{suffix}"
    path.write_bytes(content)
    with pytest.raises(RefusedError, match=r"× \d+.*something stands in \d+ of them.*Delete what stands far away"):
        sheet_rows(path, 0)
    assert "something stands in" in inspect(path).as_text()


def test_an_xls_that_says_to_be_larger_than_it_is(tmp_path: Path) -> None:
    """The library makes room for what the sheet says."""
    content = write_xls({"run": DATA})
    at = content.index(struct.pack("<IIHHH", 0, ROWS, 0, 2, 0))
    path = tmp_path / "run.xls"
    path.write_bytes(content[:at] + struct.pack("<IIHHH", 0, 65_536, 0, 256, 0) + content[at + 14 :])
    assert len(sheet_rows(path, 0)) == ROWS, "formats down to the last cell are no data"
    path.write_bytes(content[:at] + struct.pack("<IIHHH", 0, 0xFFFFFFFF, 0, 0xFFFF, 0) + content[at + 14 :])
    with pytest.raises(RefusedError, match=r"says that it has 281470681677825 cells"):
        sheet_rows(path, 0)


def test_blank_rows_and_columns_that_only_have_a_format_are_no_data(tmp_path: Path) -> None:
    """As LibreOffice writes them, down to the last row and out to the last column."""
    path = tmp_path / "run.ods"
    blank = '<table:table-row table:number-rows-repeated="1048000"><table:table-cell table:number-columns-repeated="16384"/></table:table-row>'
    path.write_bytes(put_rows(blank))
    assert len(sheet_rows(path, "run")) == ROWS


@pytest.mark.long
@pytest.mark.parametrize("suffix", WRITERS)
def test_cut_anywhere_it_is_refused_with_a_reason_and_nothing_is_made_up(
    suffix: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    content = WRITERS[suffix]({"run": {(r, c): float(r) for r in range(900) for c in range(3)}})
    path = tmp_path / f"run{suffix}"
    for place in range(1, 40):
        path.write_bytes(content[: len(content) * place // 40])
        with pytest.raises(RefusedError, match="cannot be read") as told:
            sheet_rows(path, 0)
        assert "\n" not in str(told.value)
    assert capfd.readouterr().err == "", "what the library has to say of itself is for nobody"


def test_a_chain_of_sectors_that_bites_its_tail_comes_to_an_end(tmp_path: Path) -> None:
    content = bytearray(write_xls({"run": {(r, 0): float(r) for r in range(900)}}))
    table = len(content) - 512
    struct.pack_into("<I", content, table + 4 * 20, 3)
    path = tmp_path / "run.xls"
    path.write_bytes(content)
    with pytest.raises(RefusedError):
        sheet_rows(path, 0)
