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


def ask(lab: duckdb.DuckDBPyConnection) -> dict[str, tuple[str, list[str]]]:
    """Verdict and causes of each specimen."""
    rows = lab.sql("SELECT specimen_id, verdict, mechanisms FROM diagnoses").fetchall()
    return {name: (verdict, causes) for name, verdict, causes in rows}


def test_two_nights_find_what_is_hidden(tmp_path: Path) -> None:
    first = run_night(1, tmp_path)
    said = ask(first)
    assert said.pop("PA-1")[0] == "ambiguous"
    verdict, causes = said.pop("PA-3")
    assert verdict == "ambiguous"
    assert causes[0] in ("gain_error", "rig_constants")
    assert said == {
        "PA-2": ("named", ["channel_skew"]),
        "SI-1": ("none", []),
        "SI-2": ("named", ["foreign_recording"]),
        "SI-3": ("named", ["sign_flipped", "drive_lag"]),
        "SI-4": ("named", ["leakage"]),
        "SI-5": ("unknown", []),
        "SI-6": ("named", ["sensor_saturation"]),
        "ST-1": ("named", ["amplitude_softening"]),
        "ST-2": ("named", ["amplitude_softening"]),
        "ST-3": ("named", ["clamp_slip"]),
        "WR-1": ("named", ["wrinkling"]),
    }
    # What is in no list is placed: the force channel picks up the voltage.
    acts = first.sql("SELECT stage, depends_on FROM diagnoses WHERE specimen_id = 'SI-5'").fetchall()
    assert [(stage, "voltage" in depends) for stage, depends in acts] == [("sensor", True)]
    [(design,)] = first.sql("SELECT next_design FROM diagnoses WHERE specimen_id = 'PA-1'").fetchall()
    proposed = sorted(test.get("extra_clamp_mass_kg", 0.0) for test in json.loads(design))
    made = [p.procedure for p in load_campaign("demo").planned if p.night == 2]
    assert sorted(tap.extra_clamp_mass_kg for tap in made) == proposed
    statuses = first.sql("SELECT source_path, status FROM recordings WHERE status <> 'ok'").fetchall()
    assert {Path(path).name: status for path, status in statuses} == {
        "PA-1-chirp-aborted.mcap": "damaged",
        "SI-3-relaxation.csv": "quarantined",
    }
    first.close()
    second = run_night(2, tmp_path)
    again = ask(second)
    assert again.pop("PA-1") == ("named", ["rig_constants"])
    assert again.pop("PA-3")[0] == "ambiguous"
    assert again == said
    advice = second.sql("SELECT also_possible, next_recording FROM diagnoses WHERE verdict = 'ambiguous'").fetchall()
    assert len(advice) == 1
    also_possible, recording = advice[0]
    assert {*also_possible} <= {"gain_error", "rig_constants"}
    assert "taps" in recording
    verdicts = second.sql("SELECT DISTINCT verdict FROM diagnoses ORDER BY ALL").fetchall()
    assert [v for (v,) in verdicts] == ["ambiguous", "named", "none", "unknown"]
