"""Excel sheets: written here part by part, so that each oddity is known."""

from __future__ import annotations

import os
import signal
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ingest import excel_reader
from ingest.inspect import inspect
from ingest.mapping import FileMapping
from ingest.read import read_raw
from schemas.errors import RefusedError
from schemas.recording import RawRecording
from tests.helpers.xlsx_files import write_xlsx


def mapping(**options: Any) -> FileMapping:
    content = {
        "excel": options,
        "time": {"column": "t", "unit": "s"},
        "columns": {"force": {"column": "F"}},
        "recording": {"started_at": "2026-03-01T14:00:00+00:00"},
    }
    return FileMapping.parse(content, stem="run", suffix=".xlsx", source="run.xlsx.toml")


def read(path: Path, found: FileMapping) -> RawRecording:
    raw = read_raw(path, found)
    assert isinstance(raw, RawRecording)
    return raw


ROWS: list[list[Any]] = [["Prüfstand 3"], [None], ["t", "F"], ["s", "mN"], [0.0, 1.5], [0.1, 2], [0.2, -3.25]]


def test_preamble_header_units(tmp_path: Path) -> None:
    path = write_xlsx(tmp_path / "run.xlsx", {"Daten": ROWS})
    raw = read(path, mapping(skip_rows=2, unit_row=True))
    assert raw.channels[0].unit == "mN"
    assert raw.channels[0].values.tolist() == [1.5, 2.0, -3.25]
    assert np.diff(raw.channels[0].time_ns).tolist() == [100_000_000] * 2


def test_empty_first_column_and_rows_keep_their_place(tmp_path: Path) -> None:
    rows: list[list[Any]] = [
        [None],
        [None],
        [None, "t", "F"],
        [None, "s", "N"],
        [None, 0, 1],
        [None],
        [None, 1, 2],
        [None],
    ]
    raw = read(write_xlsx(tmp_path / "run.xlsx", {"A": rows}), mapping(skip_rows=2, unit_row=True))
    assert raw.channels[0].values.tolist() == [1, 2]


def test_sheets_by_name_number_or_not_at_all(tmp_path: Path) -> None:
    other = [["t", "F"], ["s", "N"], [0, 9], [1, 8]]
    path = write_xlsx(tmp_path / "run.xlsx", {"Info": [["x"]], "Data & more": other})
    for sheet in ("Data & more", 1):
        assert read(path, mapping(sheet=sheet, unit_row=True)).channels[0].values.tolist() == [9, 8]
    with pytest.raises(RefusedError, match="2 sheets") as refused:
        read(path, mapping(unit_row=True))
    assert '"Info", "Data & more"' in refused.value.expected
    for sheet in ("Nope", 2):
        with pytest.raises(RefusedError, match="there is no sheet"):
            read(path, mapping(sheet=sheet))


def test_text_and_error_cells_are_lost_samples(tmp_path: Path) -> None:
    rows = [*ROWS[2:5], [0.1, "over"], [0.2, "#N/A"], [0.3, None], [0.4, 4]]
    raw = read(write_xlsx(tmp_path / "run.xlsx", {"A": rows}), mapping(unit_row=True))
    assert np.isnan(raw.channels[0].values).tolist() == [False, True, True, True, False]
    assert '"over"' in raw.problems[0]


def test_numbers_kept_as_text_are_refused(tmp_path: Path) -> None:
    for cells in (("1,5", "2,5"), ("abc", "def")):
        rows = [*ROWS[2:4], [0.0, cells[0]], [0.1, cells[1]]]
        with pytest.raises(RefusedError):
            read(write_xlsx(tmp_path / "run.xlsx", {"A": rows}), mapping(unit_row=True))


@pytest.mark.parametrize("cut", [10, 200, 600])
def test_damaged_workbook_is_refused(tmp_path: Path, cut: int) -> None:
    path = write_xlsx(tmp_path / "run.xlsx", {"A": ROWS})
    path.write_bytes(path.read_bytes()[:cut])
    with pytest.raises(RefusedError, match="cannot be read"):
        read(path, mapping())


@pytest.mark.long
def test_flipped_bytes_never_escape(tmp_path: Path) -> None:
    path = write_xlsx(tmp_path / "run.xlsx", {"A": ROWS})
    whole = path.read_bytes()
    rng = np.random.default_rng(5)
    refused = 0
    for _ in range(150):
        changed = bytearray(whole)
        for place in rng.integers(0, len(whole), 4):
            changed[place] = rng.integers(256)
        path.write_bytes(changed)
        try:
            read(path, mapping(skip_rows=2, unit_row=True))
        except RefusedError:
            refused += 1
    assert refused > 10


def test_bomb_is_refused_before_it_inflates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ingest.excel_reader._INFLATED_LIMIT", 2 << 20)
    path = write_xlsx(tmp_path / "run.xlsx", {"A": ROWS})
    assert read(path, mapping(skip_rows=2, unit_row=True)).channels
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as book:
        book.writestr("xl/media.bin", bytes(3 << 20))
    assert path.stat().st_size < 1 << 20
    with pytest.raises(RefusedError, match="inflates to 3 MiB"):
        read(path, mapping())


def put_cell(path: Path, place: str, sheet: int = 0) -> None:
    """Adds a cell to a sheet, far from all others."""
    with zipfile.ZipFile(path) as book:
        parts = {name: book.read(name) for name in book.namelist()}
    row = place.lstrip("ABCDEFGHIJKLMNOPQRSTUVWXYZ")
    cell = f'<row r="{row}"><c r="{place}"><v>5</v></c></row></sheetData>'
    name = f"xl/worksheets/s{sheet}.xml"
    parts[name] = parts[name].replace(b"</sheetData>", cell.encode())
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as book:
        for part, content in parts.items():
            book.writestr(part, content)


@pytest.mark.parametrize(("place", "size"), [("XFD1048576", "1048576 × 16384"), ("IV900000", "900000 × 256")])
def test_cells_far_out_are_refused_before_what_is_between_them_is_made(tmp_path: Path, place: str, size: str) -> None:
    """The library asks for half a terabyte, and ends the process."""
    path = write_xlsx(tmp_path / "run.xlsx", {"A": ROWS})
    put_cell(path, place)
    with pytest.raises(RefusedError, match=f"the sheet has {size} cells"):
        read(path, mapping())
    assert size in inspect(path).as_text()


def test_cells_far_out_in_another_sheet_are_no_hindrance(tmp_path: Path) -> None:
    path = write_xlsx(tmp_path / "run.xlsx", {"A": ROWS, "B": ROWS})
    put_cell(path, "XFD1048576", sheet=1)
    options = {"skip_rows": 2, "unit_row": True}
    assert read(path, mapping(sheet="A", **options)).channels
    with pytest.raises(RefusedError, match="1048576 × 16384"):
        read(path, mapping(sheet="B", **options))


def test_texts_of_two_byte_letters_are_without_zero_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the library gives the texts of some workbooks of Excel 5."""

    class Sheet:
        total_height, total_width = 2, 2

        def to_python(self, *, skip_empty_area: bool) -> list[list[Any]]:
            return [["t\x00", "F\x00o\x00r\x00c\x00e"], [0.0, 1.5]]

    class Book:
        sheet_names = ("A",)

        def get_sheet_by_name(self, name: str) -> Sheet:
            return Sheet()

    monkeypatch.setattr(excel_reader, "_workbook", lambda path: Book())
    (tmp_path / "old.xls").touch()
    assert excel_reader.sheet_rows(tmp_path / "old.xls", None) == [["t", "Force"], [0.0, 1.5]]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that can be forked")
def test_a_workbook_that_crashes_the_library_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_xlsx(tmp_path / "run.xlsx", {"run": [["t", "F"], [0.0, 1.5]]})
    monkeypatch.setattr("python_calamine.load_workbook", lambda _: os.kill(os.getpid(), signal.SIGSEGV))
    for read in (lambda: excel_reader.sheet_rows(path, None), lambda: excel_reader.sheet_names(path)):
        with pytest.raises(RefusedError, match=r"crashed \(SIGSEGV\)"):
            read()
