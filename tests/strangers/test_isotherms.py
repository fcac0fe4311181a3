"""Tables of several temperatures that are not clean: repeated sweeps, temperatures that come back, rows while the chamber heats."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ingest.draft import make_draft
from ingest.faults import find_faults, list_static_faults
from ingest.isotherms import find_isotherms, has_repeats, has_returns
from ingest.mapping import FileMapping
from ingest.parts import count_left_out, list_parts, part_of
from ingest.read import read_raw
from ingest.tables import ResponseTable
from pipeline.cli import main
from schemas.arrays import Float
from tests.strangers.nights import run_night

FREQUENCIES = np.logspace(-1, 2, 13)
CLEAN = (-20.0, -10.0, 0.0, 10.0, 20.0, 35.0, 50.0)
BACK = (60.0, 45.0, 30.0, 20.0, 10.0, 0.0, -10.0, 20.0)


def sweep(
    temperatures: tuple[float, ...], *, heating: int = 0, overshoot: int = 0, scatter: float = 0.05, times: int = 1
) -> tuple[Float, Float]:
    """Temperatures and frequencies of the rows; `heating` rows at 1 Hz between two temperatures."""
    rng = np.random.default_rng(5)
    warm: list[Float] = []
    at: list[Float] = []
    for i, meant in enumerate(temperatures):
        if heating and i:
            warm.append(np.linspace(temperatures[i - 1], meant, heating + 2)[1:-1])
            at.append(np.full(heating, 1.0))
        for time in range(times):
            over = np.linspace(1.5, 0.0, overshoot) if time == 0 else np.zeros(overshoot)
            warm.append(meant + rng.normal(0, scatter, FREQUENCIES.size))
            warm[-1][:overshoot] += over
            at.append(FREQUENCIES)
    return np.concatenate(warm), np.concatenate(at)


@pytest.mark.parametrize("temperatures", [CLEAN, BACK])
@pytest.mark.parametrize(
    "how",
    [{}, {"heating": 6}, {"overshoot": 2}, {"times": 2, "heating": 5}, {"scatter": 0.3, "heating": 4}],
    ids=lambda how: "-".join(how) or "clean",
)
def test_isotherms_are_found_between_what_belongs_to_none(temperatures: tuple[float, ...], how: dict[str, Any]) -> None:
    warm, at = sweep(temperatures, **how)
    found = find_isotherms(warm, at)
    assert found is not None
    assert sorted(set(temperatures)) == pytest.approx(list(found.values), abs=0.2)
    loose = how.get("heating", 0) * (len(temperatures) - 1)
    assert 0.5 * loose <= found.loose <= loose + 0.2 * at.size
    assert has_returns(warm, found) is (temperatures == BACK)
    assert has_repeats(warm, at, found) is (how.get("times", 1) == 2)


@pytest.mark.parametrize(
    "warm", [np.linspace(-50, 50, 500), np.full(500, 23.0) + np.random.default_rng(6).normal(0, 0.1, 500)]
)
def test_a_ramp_and_a_single_temperature_have_no_isotherms(warm: Float) -> None:
    assert find_isotherms(warm, np.resize(FREQUENCIES, 500)) is None
    assert has_repeats(warm, np.resize(FREQUENCIES, 500), None)


def write_table(path: Path, temperatures: tuple[float, ...], **how: Any) -> Path:
    warm, at = sweep(temperatures, **how)
    a_t = 10 ** (-8.0 * (warm - 20) / (120 + warm - 20))
    z = (1j * 2 * np.pi * at * a_t * 1e-3) ** 0.5
    value = 1.0 + 100.0 * z / (1 + z)
    rows = [
        f"{t:.3f};{f:.4f};{v.real:.6f};{v.imag:.6f}".replace(".", ",") for t, f, v in zip(warm, at, value, strict=True)
    ]
    path.write_text("\n".join(["Temp./C;f/Hz;E'/MPa;E\"/MPa", *rows, ""]), encoding="utf-8")
    return path


def test_repeated_sweeps_are_drafted_and_their_mean_is_read(tmp_path: Path) -> None:
    path = write_table(tmp_path / "dma.csv", CLEAN, times=2)
    draft = make_draft(path)
    assert draft.content["repeated"] == "mean"
    content = tomllib.loads(draft.as_toml())
    assert find_faults(path, content) == ()
    mapping = FileMapping.parse(content, stem="dma", suffix=".csv")
    assert list_parts(path, mapping) == ("-20", "-10", "0", "10", "20", "35", "50")
    table = read_raw(path, part_of(mapping, "20"))
    assert isinstance(table, ResponseTable)
    assert table.frequency_hz == pytest.approx(FREQUENCIES, rel=1e-3)
    assert any("26 rows stand at 13 values" in note for note in table.notes)
    assert table.problems == ()
    del content["repeated"]
    assert any('repeated = "mean"' in str(fault) for fault in find_faults(path, content))


def test_repeats_that_are_not_alike_are_a_problem(tmp_path: Path) -> None:
    path = tmp_path / "dma.csv"
    rows = [f"{f},{k * f},{0.1 * k}" for k in (1.0, 1.5) for f in (1.0, 2.0, 3.0)]
    path.write_text("\n".join(["f,E1,E2", *rows, ""]))
    content: dict[str, Any] = {
        "kind": "frequency_response",
        "repeated": "mean",
        "columns": {
            "frequency": {"column": "f", "unit": "Hz"},
            "storage": {"column": "E1", "unit": "MPa"},
            "loss": {"column": "E2", "unit": "MPa"},
        },
        "recording": {"recording_id": "dma", "specimen_id": "s"},
    }
    table = read_raw(path, FileMapping.parse(content, stem="dma", suffix=".csv"))
    assert isinstance(table, ResponseTable)
    assert table.value.real == pytest.approx([1.25, 2.5, 3.75])
    assert "differ by 0.2" in "".join(table.problems)


def test_a_temperature_that_comes_back_is_a_recording_of_its_own(tmp_path: Path) -> None:
    path = write_table(tmp_path / "dma.csv", BACK, heating=6)
    draft = make_draft(path)
    assert "at no isotherm" in draft.as_toml()
    mapping = FileMapping.parse(tomllib.loads(draft.as_toml()), stem="dma", suffix=".csv")
    labels = list_parts(path, mapping)
    assert set(labels) == {"-10", "0", "10", "20", "20-run2", "30", "45", "60"}
    first, second = (read_raw(path, part_of(mapping, label)) for label in ("20", "20-run2"))
    assert isinstance(first, ResponseTable)
    assert isinstance(second, ResponseTable)
    assert second.metadata.recording_id == "dma-20-run2"
    assert not np.array_equal(first.value, second.value)
    lost, count = count_left_out(path, mapping)
    assert 30 <= lost <= 60
    assert count == 8 * 13 + 7 * 6


@pytest.mark.long
@pytest.mark.slow
def test_a_night_makes_one_master_curve_of_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "files"
    folder.mkdir()
    path = write_table(folder / "dma.csv", BACK, heating=6, times=2)
    assert main(["add", str(path), "--yes", "specimen_id=S"]) == 0
    assert "belong to none of them" in capsys.readouterr().out
    night = run_night(folder, tmp_path)
    [(c1, c2)] = night.rows("SELECT c1, c2_k FROM shift_laws WHERE law = 'WLF'")
    assert c1 * c2 == pytest.approx(8 * 120, rel=0.03)
    again = night.rows("SELECT log10_a FROM shift_factors WHERE recording_id LIKE '%20%'")
    assert [abs(shift) for (shift,) in again] == pytest.approx([0, 0], abs=0.03)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ({"column": "T", "equals": 1, "runs": "apart"}, "runs"),
        ({"column": "T", "each": True, "runs": "together"}, "together"),
        ({"column": "T", "each": True, "run": 1}, "run"),
        ({"column": "T", "equals": 1, "run": 0}, "run"),
    ],
)
def test_runs_that_cannot_be_are_named(entry: dict[str, object], said: str) -> None:
    content = {"kind": "frequency_response", "recording": {"recording_id": "r-{each}"}, "select": [entry]}
    assert said in "; ".join(map(str, list_static_faults(content, stem="r", suffix=".csv")))


def write_side_by_side(path: Path, labels: tuple[str, ...], *, line: str = "Temperature (°C)") -> Path:
    """Three columns for each temperature, which stands above them; of the last one two frequencies are missing."""
    blocks = []
    for number, label in enumerate(labels):
        z = (1j * 2 * np.pi * FREQUENCIES * 10 ** (-0.4 * number) * 1e-3) ** 0.5
        value = 1.0 + 100.0 * z / (1 + z)
        cells = [
            [f"{f:.4f}", f"{v.real:.6f}", f"{v.imag / v.real:.6f}"] for f, v in zip(FREQUENCIES, value, strict=True)
        ]
        blocks.append(cells if label != labels[-1] else [*cells[:-2], *[["", "", ""]] * 2])
    above = "\t\t\t".join(f"{line}\t{label}" if line else label for label in labels)
    heads = [above, "\t\t".join(["Frequency\tE'\tTan delta"] * len(labels)), "\t\t".join(["Hz\tMPa\t"] * len(labels))]
    rows = ["\t\t".join("\t".join(one[i]) for one in blocks) for i in range(FREQUENCIES.size)]
    path.write_text("\n".join(["Film F-1", *heads, *rows, ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("labels", "line", "celsius"),
    [
        (("0.2", "20.0", "40.0"), "Temperature (°C)", [0.2, 20.0, 40.0]),
        (("-10", "25", "60"), "T in °C", [-10.0, 25.0, 60.0]),
        (("273.15", "293.15", "313.15"), "Temperature (K)", [0.0, 20.0, 40.0]),
    ],
)
def test_temperatures_side_by_side_are_recordings_of_their_own(
    tmp_path: Path, labels: tuple[str, ...], line: str, celsius: list[float]
) -> None:
    path = write_side_by_side(tmp_path / "film.txt", labels, line=line)
    draft = make_draft(path)
    assert [column.column for column in draft.unmapped] == []
    content = tomllib.loads(draft.as_toml())
    assert find_faults(path, content) == ()
    mapping = FileMapping.parse(content, stem="film", suffix=".txt")
    assert list_parts(path, mapping) == labels
    tables = [read_raw(path, part_of(mapping, label)) for label in labels]
    assert all(isinstance(table, ResponseTable) for table in tables)
    assert [table.metadata.temperature_c for table in tables] == celsius
    assert [table.frequency_hz.size for table in tables if isinstance(table, ResponseTable)] == [13, 13, 11]
    assert not any(table.problems for table in tables if isinstance(table, ResponseTable))


def test_columns_side_by_side_without_temperatures_are_listed_and_not_taken_for_some(tmp_path: Path) -> None:
    path = write_side_by_side(tmp_path / "film.txt", ("A", "B", "C"), line="")
    draft = make_draft(path)
    assert "select" not in draft.content
    assert [column.name for column in draft.unmapped] == ["Frequency", "E'", "Tan delta"] * 2
