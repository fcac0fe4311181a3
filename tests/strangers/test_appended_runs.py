"""Runs that a machine writes one behind the other into the same file: each is a recording of its own."""

from __future__ import annotations

import tomllib
from pathlib import Path

import duckdb
import numpy as np
import pytest

from ingest.columns import ColumnFile
from ingest.draft import make_draft
from ingest.lvm_reader import read_lvm
from ingest.mapping import FileMapping
from pipeline.cli import main
from tests.strangers.nights import run_night

ALL = FileMapping.parse({"kind": "recording", "recording": {"recording_id": "r", "protocol": "step", "loading": "mechanical"},
                         "columns": {"force": {"column": "F", "unit": "N"}}}, stem="r", suffix=".lvm")  # fmt: skip
LBF, INCH = 4.4482216152605, 25.4


def relaxation(times: np.ndarray, k: float) -> np.ndarray:
    """Force in N of a film that is pulled by 2 mm within a second: k (1 + 0.5 e^{-t/8}) per mm, by superposition."""
    moved = np.clip(times - 2.0, 0.0, 1.0) * 2.0
    arm = np.zeros(times.size)
    for i in range(1, times.size):  # exact for a ramp of each step
        h = times[i] - times[i - 1]
        gone = np.exp(-h / 8.0)
        arm[i] = arm[i - 1] * gone + (moved[i] - moved[i - 1]) / h * 8.0 * (1 - gone)
    return k * (moved + 0.5 * arm)


def write_appended(path: Path, heads_again: bool = False) -> None:
    """Two relaxations of a British machine in inches and pounds-force, the second below the first with times from zero."""
    times = np.arange(0.0, 80.0, 0.05)
    head = "Elapsed time (s),Crosshead (in),Load (lbf)"
    lines = [head]
    for run, k in enumerate((0.40, 0.30)):
        if run and heads_again:
            lines += ["", head]
        noise = np.random.default_rng(run).normal(0.0, 2e-4, times.size)
        force = relaxation(times, k) + noise
        moved = np.clip(times - 2.0, 0.0, 1.0) * 2.0
        lines += [f"{t:.2f},{x / INCH:.6f},{f / LBF:.7f}" for t, x, f in zip(times, moved, force, strict=True)]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.long
@pytest.mark.parametrize("heads_again", [False, True])
def test_times_that_begin_anew_make_two_recordings(tmp_path: Path, heads_again: bool) -> None:
    """They were refused: time runs backwards."""
    folder = tmp_path / "files"
    folder.mkdir()
    write_appended(folder / "pulls.csv", heads_again)
    answers = ["specimen_id=P-1", "started_at=2026-04-01T10:00:00+01:00"]
    assert main(["add", str(folder / "pulls.csv"), "--yes", *answers]) == 0
    made = run_night(folder, tmp_path / "night")
    with duckdb.connect(str(made.lab / "results.duckdb"), read_only=True) as connection:
        rows = connection.sql("SELECT recording_id, protocol, status, duration_s FROM recordings ORDER BY 1").fetchall()
        last = connection.sql(
            "SELECT recording_id, last(value ORDER BY time_s), last(time_s ORDER BY time_s) FROM relaxation_curves GROUP BY 1 ORDER BY 1"
        ).fetchall()
    assert [row[:3] for row in rows] == [("pulls-run", "step", "ok"), ("pulls-run-2", "step", "ok")]
    assert [row[3] for row in rows] == pytest.approx([79.95, 79.95])
    for (_, value, at), k in zip(last, (0.40, 0.30), strict=True):
        expected = relaxation(np.arange(0.0, 2.0 + at, 0.05), k)[-1] / 2.0
        assert value == pytest.approx(expected, rel=2e-3)
    assert (made.lab / "reports" / "recordings" / "pulls-run-2.html").is_file()


def test_a_clock_that_was_set_is_no_second_run(tmp_path: Path) -> None:
    times = np.arange(0.0, 80.0, 0.05)
    times[5:] -= 0.1
    rows = [f"{t:.2f},{x:.6f},{x / 10:.7f}" for t, x in zip(times, np.sin(times / 5), strict=True)]
    path = tmp_path / "set.csv"
    path.write_text("\n".join(["Time (s),Crosshead (mm),Load (N)", *rows]) + "\n")
    assert "select" not in tomllib.loads(make_draft(path).as_toml())


HEAD = """LabVIEW Measurement
Writer_Version\t2
Separator\tTab
Decimal_Separator\t.
X_Columns\t{x}
Date\t2026/06/01
Time\t08:00:00.0
***End_of_Header***
"""


def write_segments(path: Path, x: str, restart: bool) -> ColumnFile:
    """Two segments of a channel whose times begin anew with each, or go on."""
    parts = [HEAD.format(x=x)]
    for run in range(2):
        parts.append(
            "\nChannels\t1\nSamples\t5\nDate\t2026/06/01\n"
            f"Time\t08:0{run}:30.5\nX_Dimension\tTime\nX0\t0\nDelta_X\t0.1\n***End_of_Header***\nX_Value\tF\tComment\n"
        )
        parts += [f"{0.1 * i + (0 if restart else 60.0 * run):.1f}\t{i}\n" for i in range(5 - run)]
    path.write_text("".join(parts))
    return read_lvm(path, ALL)


@pytest.mark.parametrize("restart", [True, False])
def test_segments_of_columns_of_times_follow_by_their_clocks(tmp_path: Path, restart: bool) -> None:
    file = write_segments(tmp_path / "r.lvm", "One", restart)
    own = file.own_time("F")
    assert own is not None
    np.testing.assert_allclose(own.elapsed_s, [0, 0.1, 0.2, 0.3, 0.4, 60, 60.1, 60.2, 60.3], atol=1e-12)
    assert "there are 4 of 5 samples of segment 1: the file is cut" in file.problems
