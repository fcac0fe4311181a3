"""Numbers as machines and people write them: each with its value, and what must be refused instead of dropped."""

from __future__ import annotations

import math
from datetime import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ingest.canonical import canonical
from ingest.mapping import FileMapping
from ingest.notations import read_cell
from ingest.read import read_raw
from schemas.errors import RefusedError
from schemas.recording import RawRecording, Recording
from tests.helpers.xlsx_files import write_xlsx

METADATA = {
    "recording_id": "{stem}",
    "protocol": "cyclic",
    "loading": "mechanical",
    "specimen_id": "s1",
    "started_at": "2026-03-01T14:00:00+00:00",
}
TIME = {"column": "t", "unit": "s"}


def read(
    path: Path, cells: list[str], *, unit: str = "N", csv: dict[str, Any] | None = None, **more: Any
) -> RawRecording:
    """A file of `t;x;F`, the forces written as given."""
    rows = [f"{i};{i};{cell}" for i, cell in enumerate(cells)]
    path.write_text("\n".join(["t;x;F", *rows, ""]), encoding="utf-8")
    return taken(path, {"csv": {"delimiter": ";", **(csv or {})}, **more}, unit)


def taken(path: Path, content: dict[str, Any], unit: str = "N") -> RawRecording:
    columns = {"displacement": {"column": "x", "unit": "mm"}, "force": {"column": "F", "unit": unit}}
    full = {"time": TIME, "columns": columns, "recording": METADATA, **content}
    raw = read_raw(path, FileMapping.parse(full, stem="run", suffix=path.suffix, source=path.name + ".toml"))
    assert isinstance(raw, RawRecording)
    return raw


def force(raw: RawRecording | Recording) -> np.ndarray:
    channels = raw.channels if isinstance(raw, RawRecording) else tuple(raw.channels.values())
    return next(c.values for c in channels if c.quantity == "force")


@pytest.mark.parametrize(
    ("text", "decimal", "value", "unit"),
    [
        ("\u22120.5", ".", -0.5, ""),
        ("\u20130.5", ".", -0.5, ""),
        ("(0.12)", ".", -0.12, ""),
        ("0,12-", ",", -0.12, ""),
        ("-  0.1234", ".", -0.1234, ""),
        ("+ 1.5", ".", 1.5, ""),
        ("1,234,567.5", ".", 1234567.5, ""),
        ("1.234,5", ",", 1234.5, ""),
        ("1'234.5", ".", 1234.5, ""),
        ("1’234.5", ".", 1234.5, ""),
        ("1\u202f234,5", ",", 1234.5, ""),
        ("5.1234D-01", ".", 0.51234, ""),
        ("1.5-101", ".", 1.5e-101, ""),
        ("512.3 mN", ".", 512.3, "mN"),
        ("53.251m", ".", 53.251, "m"),
        ("0.5 N/mm2", ".", 0.5, "N/mm2"),
        ("26:15:00", ".", 94500.0, "s"),
        ("23:59:58.010", ".", 86398.01, "s"),
        ("00:00:01,5", ",", 1.5, "s"),
    ],
)
def test_what_has_one_meaning_is_read(text: str, decimal: str, value: float, unit: str) -> None:
    found = read_cell(text, decimal)
    assert found is not None
    assert found.value == pytest.approx(value, rel=1e-15)
    assert found.unit == unit


@pytest.mark.parametrize("text", ["OVLD", "----", "+++++++", "-OL", "∞", "-∞", "#DIV/0!", "n/a", "NaN", "--.--"])
def test_marks_stand_for_no_value(text: str) -> None:
    found = read_cell(text)
    assert found is not None
    assert math.isnan(found.value)


@pytest.mark.parametrize(("text", "bound"), [("> 3600", 1), (">3'600 s", 1), ("≥ 3600", 1), ("3600+", 1), ("< 5", -1)])
def test_bounds_are_told(text: str, bound: int) -> None:
    found = read_cell(text)
    assert found is not None
    assert found.bound == bound
    assert found.value == (3600 if bound > 0 else 5)


@pytest.mark.parametrize(
    "text", ["0,5123", "12 34", "1..2", "1-2", "$5", "2026-03-01", "12:30", "abc", "120-180", "5+250"]
)
def test_what_is_not_understood_is_not_guessed(text: str) -> None:
    assert read_cell(text) is None


def wave(write: Any) -> tuple[list[str], np.ndarray]:
    """Forces of a sinusoid, those that are negative, small or large in another notation; and their values."""
    values = np.round(2 * np.sin(np.linspace(0, 12, 60)), 4)
    return [write(float(v)) for v in values], values


@pytest.mark.parametrize(
    "write",
    [
        lambda v: f"\u2212{-v:.4f}" if v < 0 else f"{v:.4f}",
        lambda v: f"({-v:.4f})" if v < 0 else f"{v:.4f}",
        lambda v: f"{-v:.4f}-" if v < 0 else f"{v:.4f}",
        lambda v: f"{1e3 * v:.1f} mN" if abs(v) < 1 else f"{v:.4f} N",
        lambda v: f"{1e3 * v:.1f}m" if abs(v) < 0.5 else f"{v:.4f}",
        lambda v: f"{v:.4e}".replace("e", "D") if abs(v) < 1 else f"{v:.4f}",
    ],
)
def test_no_notation_costs_values_by_their_size(tmp_path: Path, write: Any) -> None:
    cells, values = wave(write)
    raw = read(tmp_path / "run.csv", cells)
    assert force(raw) == pytest.approx(values, abs=1e-12)
    assert not raw.problems
    assert any("force" in note for note in raw.notes)


@pytest.mark.parametrize(
    "write",
    [
        lambda v: f"{v:.4f}*" if v > 1 else f"{v:.4f}",
        lambda v: f"{v:.4f}!5" if v < 0 else f"{v:.4f}",
        lambda v: f"{v:.4f} Nn" if abs(v) < 1 else f"{v:.4f}",
        lambda v: f"< {v:.4f}" if abs(v) < 0.5 else f"{v:.4f}",
        lambda v: f"{v:.4f}".replace(".", ",") if v != 0 else "0",
    ],
)
def test_a_notation_that_is_not_read_refuses_the_column(tmp_path: Path, write: Any) -> None:
    cells, _ = wave(write)
    with pytest.raises(RefusedError, match=r'column "F" holds ".*" in row \d+ of the data'):
        read(tmp_path / "run.csv", cells)


def test_a_number_in_words_refuses_the_column_and_a_code_of_a_fault_does_not(tmp_path: Path) -> None:
    """Only the negative forces were written so, and only they were lost."""
    cells = [f"{v:.3f}" if v >= 0 else f"minus {-v:.3f}" for v in np.linspace(-0.05, 0.4, 100)]
    with pytest.raises(RefusedError, match=r"minus 0\.050"):
        read(tmp_path / "words.csv", cells)
    cells = ["Err 4.2" if i in (7, 8, 40, 41, 90) else f"{i / 100:.3f}" for i in range(100)]
    assert np.isnan(force(read(tmp_path / "codes.csv", cells))).sum() == 5


def test_prefix_on_top_of_a_prefix_has_no_meaning(tmp_path: Path) -> None:
    cells, _ = wave(lambda v: f"{1e3 * v:.1f}m" if abs(v) < 0.5 else f"{v:.4f}")
    with pytest.raises(RefusedError, match=r'holds ".*m" in row'):
        read(tmp_path / "run.csv", cells, unit="mN")


def test_single_odd_cells_are_damage_and_lost(tmp_path: Path) -> None:
    """A random byte makes a minus behind a number as well: it must not turn the sign of one sample."""
    cells = [f"{1 + 0.01 * i:.3f}" for i in range(40)]
    cells[7], cells[20], cells[30] = "1.07-", "1.2x0", "1.30m"
    raw = read(tmp_path / "run.csv", cells)
    lost = np.isnan(force(raw))
    assert np.flatnonzero(lost).tolist() == [7, 20, 30]
    assert any("3 cells hold no number" in problem for problem in raw.problems)


def test_marks_are_lost_and_told_and_their_rows_stay(tmp_path: Path) -> None:
    cells = ["----", "----", "0.5", "OVLD", "0.6"]
    raw = read(tmp_path / "run.csv", cells, time={"sample_rate_hz": 2.0})
    assert np.isnan(force(raw)).tolist() == [True, True, False, True, False]
    assert (np.diff(raw.channels[1].time_ns) == 500_000_000).all()
    assert any('3 cells hold no number, such as "----"' in problem for problem in raw.problems)


def test_numbers_that_are_marks_of_instruments_are_lost(tmp_path: Path) -> None:
    cells = [f"{0.1 * np.sin(i):.4f}" for i in range(40)]
    cells[3], cells[4], cells[5] = "9.9E37", "-9.9E+37", "9.91E37"
    cells[9] = "-9999"
    found = canonical(read(tmp_path / "run.csv", cells), where="run.csv")
    assert np.flatnonzero(np.isnan(force(found))).tolist() == [3, 4, 5, 9]
    assert found.status == "damaged"
    assert any("3 of 40 samples are overload" in p for p in found.problems)
    assert any("1 of 40 samples are the dummy value -9999" in p for p in found.problems)


def test_a_reading_that_is_also_a_dummy_value_stays(tmp_path: Path) -> None:
    cells = [f"{v}" for v in (990, 995, 999, 1003, 999)]
    found = canonical(read(tmp_path / "run.csv", cells, unit="mN"), where="run.csv")
    assert force(found) == pytest.approx([0.99, 0.995, 0.999, 1.003, 0.999])
    assert found.status == "ok"


def test_values_beyond_what_there_can_be_are_questioned(tmp_path: Path) -> None:
    few = canonical(read(tmp_path / "few.csv", ["1", "2", "5e8", "3", "2"]), where="few.csv")
    assert np.isnan(force(few)).tolist() == [False, False, True, False, False]
    with pytest.raises(RefusedError, match='in "PN" are no force there can be'):
        canonical(read(tmp_path / "all.csv", ["1", "2", "3"], unit="PN"), where="all.csv")


def test_thousands_have_to_be_named_where_they_may_be_decimals(tmp_path: Path) -> None:
    cells = ["917", "1,734", "1,001", "2,400"]
    with pytest.raises(RefusedError, match='holds "1,734" in row 2'):
        read(tmp_path / "run.csv", cells)
    named = read(tmp_path / "run.csv", cells, csv={"thousands": ","})
    assert force(named).tolist() == [917, 1734, 1001, 2400]
    shown = read(tmp_path / "run.csv", [*cells, "1,234.5"])  # one number tells what the mark is
    assert force(shown).tolist() == [917, 1734, 1001, 2400, 1234.5]


def test_thousands_that_are_the_delimiter_refuse_the_rows(tmp_path: Path) -> None:
    rows = [f"{i},{i},{900 + i}" if i < 100 else f"{i},{i},1,{i - 100:03d}.5" for i in range(120)]
    (tmp_path / "run.csv").write_text("\n".join(["t,x,F", *rows, ""]))
    with pytest.raises(RefusedError, match=r"20 rows have more than 3 fields, such as row 101"):
        taken(tmp_path / "run.csv", {"csv": {}})


def test_short_rows_by_habit_lack_the_last_column(tmp_path: Path) -> None:
    rows = [f"{i},{i}" if i % 4 else f"{i},{i},{0.5 * i}" for i in range(40)]
    (tmp_path / "run.csv").write_text("\n".join(["t,x,F", *rows, ""]))
    raw = taken(tmp_path / "run.csv", {"csv": {}})
    assert force(raw)[::4].tolist() == [0.5 * i for i in range(0, 40, 4)]
    assert int(np.isnan(force(raw)).sum()) == 30
    assert not raw.problems
    assert any("30 rows have 2 of 3 fields" in note for note in raw.notes)


@pytest.mark.parametrize("lost", ["", "7", "7;8;9;10"])
def test_a_row_that_is_lost_still_counts_as_time(tmp_path: Path, lost: str) -> None:
    rows = [f"{i};{i};{i}" for i in range(40)]
    rows[20] = lost
    (tmp_path / "run.csv").write_text("\n".join(["t;x;F", *rows, ""]))
    raw = taken(tmp_path / "run.csv", {"csv": {"delimiter": ";"}, "time": {"sample_rate_hz": 10.0}})
    assert force(raw)[30] == 30
    assert raw.channels[1].time_ns[30] - raw.channels[1].time_ns[0] == 3_000_000_000
    assert canonical(raw, where="run.csv").status == "damaged"


def test_words_below_the_data_are_no_samples(tmp_path: Path) -> None:
    rows = [f"{i};{i};{i}" for i in range(40)] + ["Mean;;", "Peak;max;none"]
    (tmp_path / "run.csv").write_text("\n".join(["t;x;F", *rows, ""]))
    raw = taken(tmp_path / "run.csv", {"csv": {"delimiter": ";"}, "time": {"sample_rate_hz": 10.0}})
    assert [c.values.size for c in raw.channels] == [40, 40]
    assert any("the last 2 rows hold no number" in problem for problem in raw.problems)


def test_a_spreadsheet_has_numbers_as_text_and_durations(tmp_path: Path) -> None:
    cells = ["0.053251", "\u22120.5", "(0.25)", "1'234.5"]
    rows = [["t", "x", "F"], *([time(0, 0, i, 500_000), float(i), cell] for i, cell in enumerate(cells))]
    write_xlsx(tmp_path / "run.xlsx", {"S": rows})
    raw = taken(tmp_path / "run.xlsx", {"excel": {}})
    assert force(raw).tolist() == [0.053251, -0.5, -0.25, 1234.5]
    assert np.diff(raw.channels[0].time_ns).tolist() == [1_000_000_000] * 3


@pytest.mark.parametrize(
    ("name", "unit", "refused"),
    [
        ("F (mN)", "N", True),
        ("F [mN]", "N", True),
        ("F / mN", "N", True),
        ("F_mN", "N", True),
        ("F mN", "N", True),
        ("Force in mN", "N", True),
        ("Force - mN", "N", True),
        ("F_mN", "mN", False),
        ("F_mN", "uN", True),
        ("F_N", "mN", False),  # a normal force
        ("F_kV", "N", False),
        ("F_min", "N", False),
        ("F (mN)", "mN", False),
        ("F (ch 1)", "N", False),
        ("F (V)", "N", False),
        ("F (Newtons)", "N", False),
    ],
)
def test_the_unit_in_a_name_is_held_against_the_mapping(tmp_path: Path, name: str, unit: str, refused: bool) -> None:
    (tmp_path / "run.csv").write_text(f"t,x,{name}\n0,0,1\n1,1,2\n2,0,3\n")
    columns = {"displacement": {"column": "x", "unit": "mm"}, "force": {"column": name, "unit": unit}}
    if not refused:
        assert force(taken(tmp_path / "run.csv", {"csv": {}, "columns": columns})).tolist() == [1, 2, 3]
        return
    with pytest.raises(RefusedError, match='the name says "mN"'):
        taken(tmp_path / "run.csv", {"csv": {}, "columns": columns})
    columns["force"]["overrule_unit"] = True  # type: ignore[assignment]
    assert force(taken(tmp_path / "run.csv", {"csv": {}, "columns": columns})).tolist() == [1, 2, 3]


def test_a_quotation_mark_in_a_name_opens_nothing(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text('t\tx\tG"\ns\tmm\tN\n0\t0\t1\n1\t1\t2\n')
    columns = {"displacement": {"column": "x", "unit": "mm"}, "force": {"column": 'G"', "unit": "N"}}
    raw = taken(tmp_path / "run.csv", {"csv": {"delimiter": "\t", "unit_row": True}, "columns": columns})
    assert force(raw).tolist() == [1, 2]


def test_names_are_the_same_where_they_look_the_same(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("t,Weg  [\u03bcm],F\n0,1,1\n1,2,2\n")
    columns = {"displacement": {"column": "Weg [\u00b5m]", "unit": "µm"}, "force": {"column": "F", "unit": "N"}}
    raw = taken(tmp_path / "run.csv", {"csv": {}, "columns": columns})
    assert raw.channels[0].values.tolist() == [1, 2]


def test_select_takes_one_run_of_several(tmp_path: Path) -> None:
    rows = [f"{run},{i},{run * i},{i}" for run in (1, 2) for i in range(5)]
    (tmp_path / "run.csv").write_text("\n".join(["run,t,x,F", *rows, ""]))
    select = [{"column": "run", "equals": 2}]
    raw = taken(tmp_path / "run.csv", {"csv": {}, "select": select})
    assert raw.channels[0].values.tolist() == [0, 2, 4, 6, 8]
    assert np.diff(raw.channels[0].time_ns).tolist() == [1_000_000_000] * 4
    by_rate = taken(tmp_path / "run.csv", {"csv": {}, "select": select, "time": {"sample_rate_hz": 10.0}})
    assert by_rate.channels[0].time_ns[0] == raw.channels[0].time_ns[0]
    with pytest.raises(RefusedError, match=r"no row has \[3\]"):
        taken(tmp_path / "run.csv", {"csv": {}, "select": [{"column": "run", "equals": 3}]})


@pytest.mark.parametrize("cell", ["349.90", "349.901"])
def test_one_cell_with_the_other_mark_is_to_be_corrected_itself(tmp_path: Path, cell: str) -> None:
    """Of a thousand cells with a decimal comma one had a point: the advice was to correct the mapping's decimal."""
    cells = [f"{i},5" for i in range(1000)]
    cells[700] = cell
    with pytest.raises(RefusedError) as caught:
        read(tmp_path / "a.csv", cells, csv={"decimal": ","})
    assert '701 of the data; 999 others are fractions with ","' in caught.value.problem
    assert caught.value.remedy.startswith("Correct this cell in the file")
    with pytest.raises(RefusedError) as caught:
        read(tmp_path / "b.csv", [f"{i}.25" for i in range(100)] + ["1,5"], csv={"decimal": ","})
    assert caught.value.remedy.startswith("Correct decimal in the mapping")
