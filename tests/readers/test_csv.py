"""Delimited text under the dialect of a mapping: decimal comma, encodings, preamble, unit rows, odd exports, cut files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ingest.csv_dialect import Dialect
from ingest.csv_reader import parse_csv
from ingest.mapping import FileMapping
from ingest.read import read_raw
from schemas.errors import RefusedError
from schemas.recording import RawRecording

METADATA = {
    "recording_id": "{stem}",
    "protocol": "cyclic",
    "loading": "mechanical",
    "specimen_id": "s1",
    "started_at": "2026-03-01T14:00:00+00:00",
}


def mapped(csv: dict[str, Any], time: dict[str, Any], **columns: dict[str, Any]) -> FileMapping:
    content = {"csv": csv, "time": time, "columns": columns, "recording": METADATA}
    return FileMapping.parse(content, stem="run", source="run.csv.toml")


def read(path: Path, content: bytes, mapping: FileMapping) -> RawRecording:
    path.write_bytes(content)
    raw = read_raw(path, mapping)
    assert isinstance(raw, RawRecording)
    return raw


GERMAN = """Messung 7
Prüfer;Müller

Zeit;Kraft (µN);Weg;
s;N;mm;
0,00;1,25;-0,50;
0,01;1,50;0,00;
0,02;-1,75;0,50;
"""


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_german_export(tmp_path: Path, encoding: str, newline: str) -> None:
    mapping = mapped(
        {"delimiter": ";", "decimal": ",", "encoding": encoding, "skip_rows": 3, "unit_row": True},
        {"column": "Zeit"},
        force={"column": "Kraft (µN)"},
        displacement={"column": "Weg", "unit": "mm"},
    )
    raw = read(tmp_path / "run.csv", GERMAN.replace("\n", newline).encode(encoding), mapping)
    force, displacement = raw.channels
    assert force.unit == "N"
    assert force.values.tolist() == [1.25, 1.5, -1.75]
    assert displacement.values.tolist() == [-0.5, 0.0, 0.5]
    assert np.diff(force.time_ns).tolist() == [10_000_000, 10_000_000]
    assert not raw.problems


def test_chinese_export(tmp_path: Path) -> None:
    text = "时间,力值,位移\ns,N,mm\n0.0,1.5,0.1\n0.1,1.6,0.2\n"
    mapping = mapped(
        {"encoding": "gbk", "unit_row": True},
        {"column": "时间"},
        force={"column": "力值"},
        displacement={"column": "位移"},
    )
    raw = read(tmp_path / "run.csv", text.encode("gbk"), mapping)
    assert raw.channels[0].values.tolist() == [1.5, 1.6]


def test_wrong_encoding_is_named(tmp_path: Path) -> None:
    mapping = mapped({"encoding": "ascii"}, {"column": "t", "unit": "s"}, force={"column": "Kräfte", "unit": "N"})
    with pytest.raises(RefusedError):
        read(tmp_path / "run.csv", "t,Kräfte\n0,1\n1,2\n".encode("cp1252"), mapping)
    mapping = mapped({"encoding": "gbk"}, {"column": "t", "unit": "s"}, force={"column": "F", "unit": "N"})
    with pytest.raises(RefusedError, match="not gbk"):
        read(tmp_path / "run.csv", b"t,F,note\n0,1,\xff\xff\n1,2,\xff\n", mapping)


def test_a_flipped_byte_is_a_lost_sample_and_not_a_wrong_encoding(tmp_path: Path) -> None:
    mapping = mapped({}, {"column": "t", "unit": "s"}, force={"column": "F", "unit": "N"})
    rows = (
        b"".join(b"%d,%d.5\n" % (i, i) for i in range(100))
        .replace(b"50,50.5", b"50,5\xb0.5")
        .replace(b"7,7.5", b"7\xb07.5")
    )
    raw = read(tmp_path / "run.csv", b"t,F\n" + rows, mapping)
    assert raw.channels[0].values.size == 99
    assert np.isnan(raw.channels[0].values).sum() == 1
    assert len(raw.problems) == 2
    assert any("not utf-8" in note for note in raw.notes)


def test_utf16_without_saying_so_is_named(tmp_path: Path) -> None:
    mapping = mapped({}, {"column": "t", "unit": "s"}, force={"column": "F", "unit": "N"})
    with pytest.raises(RefusedError, match="UTF-16"):
        read(tmp_path / "run.csv", "t,F\n0,1\n1,2\n".encode("utf-16"), mapping)


def test_no_header_and_comments_and_blanks(tmp_path: Path) -> None:
    text = b"# made by rig\n  0.0   1.5\n# paused\n  0.5   1.75\n\n  1.0   2.0\n"
    mapping = mapped(
        {"delimiter": "whitespace", "header": False, "comment": "#"},
        {"column": 0, "unit": "s"},
        force={"column": 1, "unit": "N"},
    )
    raw = read(tmp_path / "run.txt", text, mapping)
    assert raw.channels[0].values.tolist() == [1.5, 1.75, 2.0]


def test_quoted_header_with_line_end_and_delimiter(tmp_path: Path) -> None:
    text = b'"t","Load\ncell, 1"\n0,"1.5"\n1,"2.5"\n'
    mapping = mapped({}, {"column": "t", "unit": "s"}, force={"column": "Load cell, 1", "unit": "N"})
    assert read(tmp_path / "run.csv", text, mapping).channels[0].values.tolist() == [1.5, 2.5]


def test_scale_offset_and_channel_keys(tmp_path: Path) -> None:
    mapping = mapped(
        {},
        {"sample_rate_hz": 100.0},
        force={"column": "U", "unit": "N", "scale": 2.0, "offset": -1.0, "sensor": "cell 3", "delay_s": 0.002},
    )
    channel = read(tmp_path / "run.csv", b"U\n0.5\n1.0\n1.5\n", mapping).channels[0]
    assert channel.values.tolist() == [0.0, 1.0, 2.0]
    assert channel.metadata == {"sensor": "cell 3", "delay_s": "0.002"}
    assert np.diff(channel.time_ns).tolist() == [10_000_000] * 2


def test_text_cells_become_lost_samples_with_an_example(tmp_path: Path) -> None:
    mapping = mapped({"missing": ["--"]}, {"column": "t", "unit": "s"}, force={"column": "F", "unit": "N"})
    raw = read(tmp_path / "run.csv", b"t,F\n0,1\n1,OVLD\n2,\n3,--\n4, 2.5 \n5,nan\n", mapping)
    assert np.isnan(raw.channels[0].values).tolist() == [False, True, True, True, False, True]
    assert raw.channels[0].values[4] == 2.5
    assert raw.problems == ('force: 1 cells hold no number, such as "OVLD"',)


def test_slow_channel_in_the_same_table(tmp_path: Path) -> None:
    mapping = mapped(
        {},
        {"column": "t", "unit": "s"},
        force={"column": "F", "unit": "N"},
        temperature={"column": "T", "unit": "degC", "sparse": True},
    )
    force, temperature = read(tmp_path / "run.csv", b"t,F,T\n0,1,20\n1,2,\n2,3,\n3,4,21\n", mapping).channels
    assert force.values.size == 4
    assert temperature.values.tolist() == [20, 21]
    assert np.diff(temperature.time_ns).tolist() == [3_000_000_000]


@pytest.mark.parametrize(
    ("cell", "csv"),
    [
        ("1,5", {"delimiter": ";"}),
        ("1.5", {"delimiter": ";", "decimal": ","}),
        ("1,234", {"delimiter": ";"}),
        ("1.234", {"delimiter": ";", "decimal": ","}),
    ],
)
def test_number_with_two_meanings_is_refused_even_in_one_cell(tmp_path: Path, cell: str, csv: dict[str, Any]) -> None:
    mapping = mapped(csv, {"column": "t", "unit": "s"}, force={"column": "F", "unit": "N"})
    with pytest.raises(RefusedError, match="thousands separators"):
        read(tmp_path / "run.csv", f"t;F\n0;1\n1;{cell}\n2;3\n".encode(), mapping)


@pytest.mark.parametrize(
    ("cell", "csv"),
    [
        ("1,234.5", {"delimiter": ";"}),
        ("1.234,5", {"delimiter": ";", "decimal": ","}),
        ("1 234,5", {"delimiter": ";", "decimal": ","}),
        ("1\u202f234,5", {"delimiter": ";", "decimal": ","}),
        ("1'234.5", {"delimiter": ";"}),
        ("1,234,500e-3", {"delimiter": ";"}),
        ("1,234.5", {"delimiter": ";", "thousands": ","}),
    ],
)
def test_thousands_separators_are_read_where_they_have_one_meaning(
    tmp_path: Path, cell: str, csv: dict[str, Any]
) -> None:
    mapping = mapped(csv, {"column": "t", "unit": "s"}, force={"column": "F", "unit": "N"})
    raw = read(tmp_path / "run.csv", f"t;F\n0;1\n1;{cell}\n2;3\n".encode(), mapping)
    assert raw.channels[0].values.tolist() == [1, 1234.5, 3]
    assert any("thousands separators" in note for note in raw.notes)


def test_column_of_text_is_refused(tmp_path: Path) -> None:
    mapping = mapped({}, {"column": "t", "unit": "s"}, force={"column": "F", "unit": "N"})
    with pytest.raises(RefusedError, match='holds no numbers, such as "abc"'):
        read(tmp_path / "run.csv", b"t,F\n0,abc\n1,def\n", mapping)


def test_missing_and_double_columns_are_named(tmp_path: Path) -> None:
    mapping = mapped({}, {"column": "t", "unit": "s"}, force={"column": "Load", "unit": "N"})
    with pytest.raises(RefusedError) as refused:
        read(tmp_path / "run.csv", b"t,Kraft\n0,1\n1,2\n", mapping)
    assert '"Load"' in refused.value.problem
    assert '"t", "Kraft"' in refused.value.expected
    with pytest.raises(RefusedError, match="2 columns are named"):
        read(tmp_path / "run.csv", b"t,Load,Load\n0,1,2\n1,2,3\n", mapping)


def test_unit_row_against_mapping(tmp_path: Path) -> None:
    text = b"t,F\ns,[mN]\n0,1\n1,2\n"
    csv = {"unit_row": True}
    right = mapped(csv, {"column": "t"}, force={"column": "F", "unit": "mN"})
    assert read(tmp_path / "run.csv", text, right).channels[0].unit == "mN"
    own = mapped(csv, {"column": "t"}, force={"column": "F"})
    assert read(tmp_path / "run.csv", text, own).channels[0].unit == "mN"
    wrong = mapped(csv, {"column": "t"}, force={"column": "F", "unit": "N"})
    with pytest.raises(RefusedError, match='unit row says "mN"'):
        read(tmp_path / "run.csv", text, wrong)
    scaled = mapped(csv, {"column": "t"}, force={"column": "F", "unit": "N", "scale": 0.001})
    assert read(tmp_path / "run.csv", text, scaled).channels[0].values.tolist() == [0.001, 0.002]


# --- files that were cut -------------------------------------------------------------------------------------------


def parse(text: str, *, wanted: list[str] | None = None, **dialect: Any) -> tuple[list[float], int, int]:
    file = parse_csv(text.encode(), Dialect(**dialect), where="run.csv", wanted=wanted)
    return list(file.numbers("F").values), len(file.problems), len(file.notes)


@pytest.mark.parametrize(
    ("text", "values", "problems", "notes"),
    [
        ("t,F\n0,1.25\n1,2.5\n", [1.25, 2.5], 0, 0),
        ("t,F\n0,1.25\n1,2.50\n2,", [1.25, 2.5], 1, 0),
        ("t,F\n0,1.25\n1,2.50\n2", [1.25, 2.5], 1, 0),
        ("t,F\n0,1.25\n1,2.50\n2,3.2", [1.25, 2.5], 1, 0),
        ("t,F\n0,1.25\n1,2.50\n2,3.25", [1.25, 2.5, 3.25], 0, 1),
        ("t,F\n0,1.25\n1,2.5\n2,3.25", [1.25, 2.5], 1, 0),
        ("t,F\n0,12\n1,13\n2,1", [12, 13], 1, 0),
        ("t,F\n0,12\n1,13\n2,14", [12, 13, 14], 0, 1),
        ("t,F\n0,1.0e-05\n1,2.0e-05\n2,3.0e-0", [1e-5, 2e-5], 1, 0),
        ("t,F\n0,1.0e-05\n1,2.0e-05\n2,3.0e-05", [1e-5, 2e-5, 3e-5], 0, 1),
        ("t,F,\n0,1.25,\n1,2.5,\n2,3.125,", [1.25, 2.5, 3.125], 0, 1),
        ('t,F\n0,"1.25"\n1,"2.5"\n2,"3"', [1.25, 2.5, 3], 0, 1),
    ],
)
def test_end_of_file(text: str, values: list[float], problems: int, notes: int) -> None:
    assert parse(text) == (values, problems, notes)


def test_end_in_a_column_that_is_not_mapped() -> None:
    assert parse("t,F,note\n0,1.5,a\n1,2,b", wanted=["t", "F"]) == ([1.5, 2], 0, 1)


def test_exporter_without_final_line_end() -> None:
    assert parse("t,F\n0,1.25\n1,2", final_newline=False) == ([1.25, 2], 0, 0)


@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=20), st.integers(1, 60), st.booleans())
def test_a_cut_file_never_yields_a_number_that_was_not_written(values: list[float], cut: int, fixed: bool) -> None:
    written = [f"{v:.3f}" if fixed else repr(v) for v in values]
    text = "t,F\n" + "".join(f"{i},{w}\n" for i, w in enumerate(written))
    try:
        found, problems, notes = parse(text[: -min(cut, len(text) - 5)])
    except RefusedError:
        return
    expected = [float(w) for w in written[: len(found)]]
    if found == expected:
        return
    # Only a number that is written like all before it can pass for whole, and then a note says so.
    assert found[:-1] == expected[:-1]
    assert notes == 1
    assert not problems


def test_rows_of_another_length_are_left_out() -> None:
    values, problems, _ = parse("t,F\n0,1\n1\n2,3\n3,4,5\n4,6\n")
    assert values == [1, 3, 6]
    assert problems == 1


def test_tail_of_nulls_after_a_crash() -> None:
    values, problems, _ = parse("t,F\n0,1.5\n1,2.5\n2,3" + "\x00" * 512)
    assert values == [1.5, 2.5]
    assert problems == 1


@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False, width=64), min_size=1, max_size=30),
    st.sampled_from([(";", ","), ("\t", "."), (",", "."), ("|", ",")]),
    st.sampled_from(["utf-8", "utf-16", "cp1252"]),
)
def test_every_double_survives(values: list[float], marks: tuple[str, str], encoding: str) -> None:
    delimiter, decimal = marks
    text = f"t{delimiter}F\n" + "".join(f"{i}{delimiter}{v!r}\n".replace(".", decimal) for i, v in enumerate(values))
    dialect = Dialect(delimiter=delimiter, decimal=decimal, encoding=encoding)
    file = parse_csv(text.encode(encoding), dialect, where="run.csv")
    assert file.numbers("F").values.tolist() == values


RATE = {"sample_rate_hz": 10.0}
REMARKED = {
    "a word": ("# pump off", [0.0, 0.1, 0.2], [10, 20, 30], "1 line is a remark and no samples"),
    "a word in a whole row": ("# pump off,", [0.0, 0.1, 0.2], [10, 20, 30], "1 line is a remark and no samples"),
    "of MATLAB": ("% pump off 3", [0.0, 0.1, 0.2], [10, 20, 30], "1 line is a remark and no samples"),
    "overload": ("5,****", [0.0, 0.1, 0.2, 0.3], [10, np.nan, 20, 30], ""),
    "an error of a spreadsheet": ("#N/A,#N/A", [0.0, 0.1, 0.2, 0.3], [10, np.nan, 20, 30], ""),
    "a name": ("#4,15", [0.0, 0.1, 0.2, 0.3], [10, 15, 20, 30], ""),
}


@pytest.mark.parametrize(("line", "times", "values", "note"), REMARKED.values(), ids=REMARKED.keys())
def test_remarks_between_rows_that_are_time_are_no_samples(
    tmp_path: Path, line: str, times: list[float], values: list[float], note: str
) -> None:
    """A remark in the middle made everything behind it late by a sample."""
    text = f"x,F\n1,10\n{line}\n2,20\n3,30\n"
    raw = read(tmp_path / "run.csv", text.encode(), mapped({}, RATE, force={"column": "F", "unit": "N"}))
    (force,) = raw.channels
    np.testing.assert_allclose((force.time_ns - force.time_ns[0]) / 1e9, times)
    np.testing.assert_array_equal(force.values, values)
    assert not note or any(note in told for told in raw.notes)


@pytest.mark.parametrize(
    ("line", "times", "values", "note"),
    [
        ("# pump off", [0.0, 0.1, 0.2], [10, 20, 30], ""),
        ("# 7", [0.0, 0.1, 0.2], [10, 20, 30], ""),
        ("#7,15", [0.0, 0.1, 0.2, 0.3], [10, np.nan, 20, 30], '1 sample stands behind "#" ("#7,15")'),
    ],
)
@pytest.mark.parametrize("delimiter", [",", "whitespace"])
def test_a_sample_that_is_a_comment_takes_its_time(
    tmp_path: Path, line: str, times: list[float], values: list[float], note: str, delimiter: str
) -> None:
    """A sample behind the mark of remarks made everything after it early by a sample."""
    text = f"# made by a logger\nx,F\n1,10\n{line}\n2,20\n3,30\n# 3\n"
    if delimiter == "whitespace":
        text, note = text.replace(",", "  "), note.replace(",", "\t")
    found = mapped({"comment": "#", "delimiter": delimiter}, RATE, force={"column": "F", "unit": "N"})
    raw = read(tmp_path / "run.csv", text.encode(), found)
    (force,) = raw.channels
    np.testing.assert_allclose((force.time_ns - force.time_ns[0]) / 1e9, times)
    np.testing.assert_array_equal(force.values, values)
    assert not note or any(note in told for told in raw.notes)
    assert raw.problems == ()
