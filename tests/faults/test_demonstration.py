"""The demonstration: the first night finds what is wrong with its films, rigs and files, and the second one decides what it left open."""

from __future__ import annotations

import json
from pathlib import Path

import duckdb
import pytest

from pipeline.cli import main
from pipeline.simulate.plan import load_campaign

pytestmark = [pytest.mark.long, pytest.mark.slow]


def run_night(night: int, folder: Path) -> duckdb.DuckDBPyConnection:
    """The database after a night of the demonstration; of its files some are damaged, which the exit status says."""
    raw, lab = folder / "raw", folder / "lab"
    assert main(["simulate", "demo", "--night", str(night), "--out", str(raw)]) == 0
    assert main(["nightly", str(raw), "--lab", str(lab)]) == 3
    return duckdb.connect(str(lab / "results.duckdb"), read_only=True)


def test_two_nights_find_what_is_hidden(tmp_path: Path) -> None:
    first = run_night(1, tmp_path)
    verdicts = {
        row[0]: row[1:] for row in first.sql("SELECT specimen_id, verdict, mechanism FROM diagnoses").fetchall()
    }
    assert verdicts.pop("PA-1")[0] == "ambiguous"
    assert verdicts == {
        "SI-1": ("none", None),
        "SI-2": ("named", "foreign_recording"),
        "ST-1": ("named", "amplitude_softening"),
        "ST-2": ("named", "amplitude_softening"),
        "ST-3": ("named", "clamp_slip"),
        "WR-1": ("named", "wrinkling"),
    }
    [(design,)] = first.sql("SELECT next_design FROM diagnoses WHERE specimen_id = 'PA-1'").fetchall()
    proposed = sorted(test.get("extra_clamp_mass_kg", 0.0) for test in json.loads(design))
    made = [p.procedure for p in load_campaign("demo").planned if p.night == 2]
    assert sorted(tap.extra_clamp_mass_kg for tap in made) == proposed
    statuses = dict(first.sql("SELECT recording_id, status FROM recordings WHERE status <> 'ok'").fetchall())
    assert statuses == {"PA-1-chirp-aborted": "damaged"}
    first.close()
    second = run_night(2, tmp_path)
    decided = second.sql("SELECT verdict, mechanism FROM diagnoses WHERE specimen_id = 'PA-1'").fetchall()
    assert decided == [("named", "rig_constants")]
    again = {row[0]: row[1:] for row in second.sql("SELECT specimen_id, verdict, mechanism FROM diagnoses").fetchall()}
    assert {name: found for name, found in again.items() if name != "PA-1"} == verdicts
