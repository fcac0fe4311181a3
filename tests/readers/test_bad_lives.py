"""Tables of lives that tell nothing or contradict themselves: from the file to the words that the night keeps for it."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pytest

from ingest.mapping import FileMapping
from ingest.read import read_raw
from ingest.tables import LifetimeTable
from pipeline.analyse.survival import survival_tables
from pipeline.fit.survival.groups import survival_group
from schemas.errors import RefusedError

MAPPING = {
    "kind": "lifetimes",
    "columns": {
        "lifetime": {"column": "life", "unit": "h"},
        "failed": {"column": "failed", "failed_values": ["yes"], "censored_values": ["no"]},
        "alive_at": {"column": "seen", "unit": "h"},
        "entered": {"column": "entered", "unit": "h"},
        "voltage": {"column": "U", "unit": "kV"},
        "electrode": {"column": "electrode"},
        "failure_mode": {"column": "mode"},
    },
    "recording": {"recording_id": "ageing", "campaign": "ageing"},
}


def write(tmp_path: Path, rows: list[str]) -> Path:
    path = tmp_path / "ageing.csv"
    path.write_text("\n".join(["life,failed,U,electrode,mode,seen,entered", *rows]) + "\n")
    return path


def read(path: Path) -> LifetimeTable:
    found = read_raw(path, FileMapping.parse(MAPPING, stem="ageing", suffix=".csv", source="ageing.csv.toml"))
    assert isinstance(found, LifetimeTable)
    return found


def rows_of(count: int, voltages: tuple[float, ...], failed: str = "yes", electrode: str = "carbon") -> list[str]:
    return [f"{10 + 3 * k},{failed},{voltages[k % len(voltages)]},{electrode},,," for k in range(count)]


def analyse(path: Path) -> dict[str, pa.Table]:
    return survival_tables(survival_group(read(path).rows))


def told(tables: dict[str, pa.Table]) -> str:
    """All that the tables of the campaign say in words about what could not be had."""
    words = [row["warnings"] for row in tables["life_regressions"].to_pylist()]
    words += [
        row["warnings"]
        for name in ("survival_summaries", "voltage_life", "survival_comparisons")
        for row in tables[name].to_pylist()
    ]
    words += [row["statement"] for row in tables["survival_notes"].to_pylist()]
    return "; ".join(word for word in words if word)


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (rows_of(8, (4.0, 5.0), failed="no"), "nobody failed"),
        (rows_of(6, (4.0, 5.0)) + rows_of(6, (4.0, 5.0), "no", "silver"), "none of its 6 specimens failed, so its effect has no finite estimate (separation)"),
        (rows_of(6, (5.0,)) + rows_of(6, (4.0,), "no"), "all failures came at one value of voltage_kv"),
        (rows_of(3, (4.0, 5.0)), "distinct failures do not carry"),
        (rows_of(8, (5.0,)), "all of its campaign under one condition: no comparison, no law of voltage, no regression"),
    ],
    ids=["all censored", "separation", "failures at one stress", "too few", "one group at one stress"],
)  # fmt: skip
def test_what_lives_cannot_tell_is_said(tmp_path: Path, rows: list[str], said: str) -> None:
    assert said in told(analyse(write(tmp_path, rows)))


def test_a_mode_that_nobody_failed_by_is_not_among_the_modes_and_one_of_few_says_why(tmp_path: Path) -> None:
    rows = [f"{10 + 3 * k},yes,{4 + k % 2},carbon,{'pinhole' if k else 'contact'},," for k in range(12)]
    rows.append("70,no,4,carbon,flashover,,")
    tables = analyse(write(tmp_path, rows))
    assert {row["failure_mode"] for row in tables["mode_effects"].to_pylist()} == {"film"}
    assert "effects on the mode lead: " in told(tables)
    assert "edge" not in told(tables)


@pytest.mark.parametrize(
    ("row", "said"),
    [
        ("-4,yes,5,carbon,,,", "-14400 s; expected a life not below 0"),
        ("12,yes,5,carbon,,20,", "seen alive at 72000 s, after that"),
        ("12,yes,5,carbon,,,15", "came under watch at 54000 s"),
        ("soon,yes,5,carbon,,,", "which is no number"),
        ("12,perhaps,5,carbon,,,", '"perhaps" in row 9 of the data means neither failed nor censored'),
    ],
    ids=["negative life", "left after right", "entered after the end", "no number", "no outcome"],
)  # fmt: skip
def test_rows_that_cannot_be_are_refused_with_their_place(tmp_path: Path, row: str, said: str) -> None:
    path = write(tmp_path, [*rows_of(8, (4.0, 5.0)), row])
    with pytest.raises(RefusedError, match=said):
        read(path)


def test_a_voltage_below_zero_is_in_no_law_and_a_survivor_of_no_time_is_left_out(tmp_path: Path) -> None:
    path = write(tmp_path, [*rows_of(8, (4.0, 5.0)), "12,yes,-5,carbon,,,", "0,no,5,carbon,,,"])
    assert read(path).problems == ("1 of 10 rows have no life, or survived 0 s (row 10): left out",)
    tables = analyse(path)
    assert "voltage_kv is not in the regression: voltage_kv of -5 kV" in told(tables)
    assert "inverse power law: voltages that are missing or not above 0 kV" in told(tables)


def test_failures_at_zero_count_and_are_no_obstacle(tmp_path: Path) -> None:
    path = write(tmp_path, ["0,yes,5,carbon,,,", *rows_of(9, (4.0, 5.0))])
    (chosen,) = [r for r in analyse(path)["life_regressions"].to_pylist() if r["chosen"]]
    assert (chosen["specimens"], chosen["failures"]) == (10, 10)


def test_a_remark_below_a_table_without_outcomes_is_a_note(tmp_path: Path) -> None:
    """It made the table damaged: it has neither a life nor a voltage, and was taken for a film without a life."""
    path = tmp_path / "strips.csv"
    rows = ["S-1,5,195.4", "S-2,5,> 500", "S-3,6.5,10", ",,", "* life until the relay tripped,,"]
    path.write_text("\n".join(["specimen,U,life", *rows]) + "\n")
    columns = {
        "lifetime": {"column": "life", "unit": "h"},
        "voltage": {"column": "U", "unit": "kV"},
        "specimen_id": {"column": "specimen"},
    }
    mapping = {
        "kind": "lifetimes",
        "columns": columns,
        "recording": {"recording_id": "strips", "configuration": "strip"},
    }
    found = read_raw(path, FileMapping.parse(mapping, stem="strips", suffix=".csv", source="strips.csv.toml"))
    assert isinstance(found, LifetimeTable)
    assert found.problems == ()
    assert any("without a life and without a voltage" in note for note in found.notes)
    assert [(row.specimen_id, row.failed) for row in found.rows] == [("S-1", True), ("S-2", False), ("S-3", True)]


def in_cycles(tmp_path: Path, rows: list[str]) -> LifetimeTable:
    path = tmp_path / "cycled.csv"
    path.write_text("\n".join(["life,failed,f,seen", *rows]) + "\n")
    columns = {
        "lifetime": {"column": "life", "unit": "kcycles"},
        "failed": {"column": "failed", "failed_values": ["yes"], "censored_values": ["no"]},
        "frequency": {"column": "f", "unit": "Hz"},
        "alive_at": {"column": "seen", "unit": "h"},
    }
    content = {"kind": "lifetimes", "columns": columns, "recording": {"recording_id": "cycled"}}
    found = read_raw(path, FileMapping.parse(content, stem="cycled", suffix=".csv", source="cycled.csv.toml"))
    assert isinstance(found, LifetimeTable)
    return found


def test_lives_in_cycles_are_times_by_the_frequency_of_their_row(tmp_path: Path) -> None:
    found = in_cycles(tmp_path, ["36,yes,10,0.5", "> 20,no,0.5,"])
    assert [(row.lifetime_s, row.failed, row.frequency_hz) for row in found.rows] == [
        (3600.0, True, 10.0),
        (40_000.0, False, 0.5),
    ]
    assert found.rows[0].alive_at_s == 1800.0
    assert "lives in cycles are times by the frequency of their row" in found.notes


@pytest.mark.parametrize("frequency", ["", "0"])
def test_cycles_without_a_frequency_are_refused(tmp_path: Path, frequency: str) -> None:
    with pytest.raises(
        RefusedError, match="row 2 of the data: the lifetime is in cycles, and the row has no frequency"
    ):
        in_cycles(tmp_path, ["36,yes,10,", f"20,no,{frequency},"])
