"""Tables that are typed by hand or written point by point: they have no times, so no test over time is sure; no column is lost."""

from __future__ import annotations

import tomllib
from pathlib import Path

import duckdb
import numpy as np
import pytest

from ingest.draft import make_draft
from ingest.heads import join_heads
from pipeline.cli import main
from tests.helpers.xlsx_files import write_xlsx
from tests.strangers.nights import run_night


def test_a_running_number_is_no_time_and_specimens_are_kept_apart(tmp_path: Path) -> None:
    """Its even steps were the time, and two strips in one file a cycle that was sure."""
    ways = [*range(0, 20, 2), *range(20, -1, -2)]
    rows = [
        f"{1 + i + 21 * k},{name},{way}.0,{(100 + 10 * k) * (1 + way / 40):.3f}"
        for k, name in enumerate(("K-1", "K-2"))
        for i, way in enumerate(ways)
    ]
    path = tmp_path / "lcr.csv"
    path.write_text("\n".join(["No.,Sample,Stage (mm),Cp (pF)", *rows]) + "\n")
    draft = make_draft(path)
    asked = [q.key for q in draft.questions]
    assert "time.sample_rate_hz" in asked
    assert "recording.protocol" in asked
    content = tomllib.loads(draft.as_toml())
    assert content["select"] == [{"column": "Sample", "each": True}]
    assert content["recording"]["specimen_id"] == "{each}"
    assert "No." in [c.column for c in draft.unmapped]


@pytest.mark.long
def test_specimens_of_one_file_become_recordings_on_pages(tmp_path: Path) -> None:
    """Two films pulled and held one after the other in a file of a Spanish machine; the relaxed stiffness by its formula."""
    times = np.arange(0.0, 60.0, 0.1)
    folder = tmp_path / "files"
    folder.mkdir()
    rows = []
    for name, k in (("muestra A", 0.5), ("muestra B", 0.2)):
        moved = 2.0 * np.clip(times - 3.0, 0.0, 0.5) * 2.0
        force = k * moved * (1 + 0.4 * np.exp(-np.clip(times - 3.4, 0.0, None) / 5.0))
        rows += [f"{name};{t:.1f};{x:.4f};{f:.6f}" for t, x, f in zip(times, moved, force, strict=True)]
    (folder / "todo.csv").write_text(
        "\n".join(["Probeta;Tiempo (s);Posición (mm);Fuerza (N)", *(r.replace(".", ",") for r in rows)]) + "\n",
        encoding="cp1252",
    )
    assert main(["add", str(folder / "todo.csv"), "--yes", "started_at=2026-05-04T09:00:00+02:00"]) == 0
    made = run_night(folder, tmp_path / "night")
    with duckdb.connect(str(made.lab / "results.duckdb"), read_only=True) as connection:
        asked = "SELECT specimen_id, last(value ORDER BY time_s) FROM relaxation_curves GROUP BY 1 ORDER BY 1"
        last = connection.sql(asked).fetchall()
    assert [name for name, _ in last] == ["muestra A", "muestra B"]
    assert [value for _, value in last] == pytest.approx([0.5, 0.2], rel=2e-3)


def test_groups_over_columns_lose_none_of_them(tmp_path: Path) -> None:
    """The first column has its name in the upper row alone: it was lost, and a force was the time."""
    table = [
        ["Voltage (kV)", "Run 1 - force (N)", "", "Run 2 - force (N)", ""],
        ["", "up", "down", "up", "down"],
        *[[0.5 * i, 1.5 - 0.01 * i * i, 1.49 - 0.01 * i * i, 1.48 - 0.01 * i * i, 1.47] for i in range(11)],
    ]
    draft = make_draft(write_xlsx(tmp_path / "typed.xlsx", {"data": table}))
    assert draft.content["columns"]["voltage"] == {"column": 0, "unit": "kV"}
    assert draft.content["columns"]["force"] == {"column": 1, "unit": "N"}
    assert [c.column for c in draft.unmapped] == [2, 3, 4]
    assert {"time.sample_rate_hz", "recording.protocol"} <= {q.key for q in draft.questions}


@pytest.mark.parametrize(
    ("upper", "lower", "names"),
    [
        (["U", "F", ""], ["", "up", "down"], ["U", "up F", "down F"]),
        (["Machine 5", "", ""], ["t", "x", "F"], []),
        (["t", "x", "F"], ["s", "mm", "N"], []),
        (["t", "x", "F"], ["", "", "[mN]"], []),
    ],
)
def test_heads_in_two_rows(upper: list[str], lower: list[str], names: list[str]) -> None:
    assert join_heads(upper, lower) == names
