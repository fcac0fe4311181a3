"""Tables without a header whose columns are listed above them by number, and lines of marks between their blocks."""

from __future__ import annotations

import tomllib
from pathlib import Path

import duckdb
import numpy as np
import pytest

from ingest.draft import make_draft
from ingest.sniff import list_columns
from pipeline.cli import main
from tests.strangers.nights import run_night


def write_hold(path: Path) -> float:
    """A German machine's pull to 3 mm within 1 s, held for 100 s, in blocks that end with -999; returns N/mm at its end, by hand."""
    times = np.arange(0.0, 105.0, 0.1)
    moved = 3.0 * np.clip(times - 4.0, 0.0, 1.0)
    force = 0.25 * moved * (1.0 + 0.6 * np.exp(-np.clip(times - 4.5, 0.0, None) / 9.0))  # nearly a step
    rows = [f"{t:.1f};{x:.4f};{f:.6f}".replace(".", ",") for t, x, f in zip(times, moved, force, strict=True)]
    rows[600:600] = ["-999,0;-999,0;-999,0"]
    rows += ["-999,0;-999,0;-999,0"]
    head = [
        "Prüfmaschine Z2.5;Probe H-3",
        "Spalte 1: Zeit [s]",
        "Spalte 2: Traversenweg [mm]",
        "Spalte 3: Kraft [N]",
        "Daten",
    ]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="cp1252")
    return float(force[-1] / 3.0)


@pytest.mark.long
def test_listed_columns_become_a_recording_on_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They were guessed from their numbers: time, then what seemed to drive; marks of -999 were samples."""
    folder = tmp_path / "files"
    folder.mkdir()
    expected = write_hold(folder / "halten.csv")
    answers = ["specimen_id=H-3", "started_at=2026-04-01T10:00:00+02:00"]
    assert main(["add", str(folder / "halten.csv"), "--yes", *answers]) == 0
    told = capsys.readouterr().out
    assert "step, mechanical (sure" in told
    content = tomllib.loads((folder / "halten.csv.toml").read_text(encoding="utf-8"))
    assert content["columns"] == {
        "displacement": {"column": 1, "unit": "mm"},
        "force": {"column": 2, "unit": "N"},
    }
    made = run_night(folder, tmp_path / "night")
    with duckdb.connect(str(made.lab / "results.duckdb"), read_only=True) as connection:
        (last,) = connection.sql("SELECT last(value ORDER BY time_s) FROM relaxation_curves").fetchall()
        (row,) = connection.sql("SELECT status, sample_count FROM recordings").fetchall()
    assert row[0] == "ok"
    assert last[0] == pytest.approx(expected, rel=2e-3)
    assert (made.lab / "reports" / "recordings" / "halten.html").is_file()


def test_signals_of_a_dma_are_a_table_of_temperatures(tmp_path: Path) -> None:
    names = ["Time (min)", "Temperature (°C)", "Frequency (Hz)", "Storage Modulus (MPa)", "Loss Modulus (MPa)"]
    head = ["Instrument\tDMA", "Nsig\t5", *[f"Sig{i}\t{name}" for i, name in enumerate(names, start=1)], "StartOfData"]
    rows: list[str] = []
    for warm in (-10.0, 30.0, 70.0):
        for i, hertz in enumerate((50.0, 20.0, 10.0, 5.0, 1.0)):
            rows.append(f"{len(rows)}.5\t{warm + 0.1 * (i % 3)}\t{hertz}\t{1.0 + hertz / 50 - warm / 200}\t0.1")
        rows.append("\t".join(["-2.000000"] * 5))
    path = tmp_path / "run.001.txt"
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-16")
    content = tomllib.loads(make_draft(path).as_toml())
    assert content["kind"] == "frequency_response"
    assert {name: c["column"] for name, c in content["columns"].items()} == {
        "frequency": 2,
        "storage": 3,
        "loss": 4,
        "temperature": 1,
    }
    assert content["csv"]["comment"].startswith("-2.000000\t-2.000000")


@pytest.mark.parametrize(
    ("lines", "names"),
    [
        (["Sig1\tTime (min)", "Sig2\tForce (N)"], ["Time (min)", "Force (N)"]),
        (["# 0: time [s]", "# 1: F [N]"], ["time [s]", "F [N]"]),
        (["Column 1 = Time", "Column 2 = Load", "Column 3 = more"], []),
        (["Kanal 1; Weg (mm)", "Kanal 1; Kraft (N)"], []),
        (["2026-03-01 Versuch", "1 mm/s"], []),
    ],
)
def test_lists_of_columns(lines: list[str], names: list[str]) -> None:
    assert list_columns(lines, 2) == names
