"""What a night changed, from real nights: remembered once, told with its reason, shown on the index."""

from __future__ import annotations

from pathlib import Path

import pytest

from pipeline import Lab
from pipeline.nightly.night import nightly
from tests.helpers.small_lab import chirp, small_campaign


def index_of(lab: Lab) -> str:
    return (lab.reports / "index.html").read_text(encoding="utf-8").replace("\u00a0", " ")


@pytest.mark.long
def test_a_night_tells_what_it_moved_and_why(tmp_path: Path) -> None:
    raw, lab = small_campaign(tmp_path / "raw"), Lab(tmp_path / "lab")
    nightly([raw], lab, jobs=0)
    first = lab.sql("SELECT * FROM history")
    assert set(first["run_id"]) == {"000001"}
    assert {"k0_n_per_mm", "model_order"} <= set(first[first["item"] == "P-1"]["quantity"])
    assert "Nothing to compare with yet" in index_of(lab)

    nightly([raw], lab, jobs=0)
    assert len(lab.sql("SELECT * FROM history")) == len(first), "a night with nothing new remembers nothing"
    assert "No result moved by more than its uncertainty allows" in index_of(lab)

    chirp(raw / "P-1-chirp-2.mcap", 2, stiffness=1.3)
    nightly([raw], lab, jobs=0)
    later = lab.sql("SELECT * FROM history WHERE run_id = '000003'")
    assert set(later["item"]) == {"P-1"}
    moved = lab.sql("SELECT * FROM moved WHERE quantity = 'k0_n_per_mm'")
    (row,) = moved.to_dict("records")
    assert row["before"] == pytest.approx(1.02, rel=0.01)
    assert row["after"] > 1.05
    assert row["after_sd"] > 10 * row["before_sd"], "recordings that disagree make the mean uncertain, and that is news"
    assert row["because"] == "1 chirp"
    assert "moved since the run before: P-1" in index_of(lab)
    charts = lab.sql("SELECT DISTINCT grouped_by, name FROM control_points")
    assert {"night", "rig"} <= set(charts["grouped_by"])
