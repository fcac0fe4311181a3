"""Load-unload cycles on the page of a specimen that was also tested otherwise."""

from __future__ import annotations

import re
from pathlib import Path

from reports.build import build_reports
from tests.helpers import synthetic_lab


def test_cycles_stand_beside_the_relaxation_of_the_same_film(tmp_path: Path) -> None:
    """They were left out wherever the film had a model from another test."""
    story = synthetic_lab.Story()
    story.recording("R-1_step", "R-1", "step", "mechanical", duration_s=40.0)
    story.recording("R-1_cycle", "R-1", "cycle", "mechanical", duration_s=200.0)
    story.fits("R-1", (0.03, (0.04,), (0.08,)))
    for cycle in range(1, 15):
        row = {
            "recording_id": "R-1_cycle",
            "specimen_id": "R-1",
            "cycle": cycle,
            "start_s": 8.0 * cycle,
            "end_s": 8.0 * cycle + 8,
        }
        row |= {"displacement_low_mm": 14.0, "displacement_high_mm": 26.0, "force_low_n": 0.17, "force_high_n": 1.01}
        row |= {"loss_mj": 0.695, "steady_loss_mj": 0.6642, "loss_kj_per_m3": 1.703, "steady_loss_kj_per_m3": 1.628}
        row |= {"loss_share": 0.09, "secant_n_per_mm": 0.068}
        story.rows["cycle_loops"].append(row)
    story.run()
    lab = story.write(tmp_path / "lab")
    build_reports(lab)
    page = (lab / "reports" / "specimens" / "R-1.html").read_text(encoding="utf-8")
    assert "A cycle takes 0.664" in page
    for number in ("0.6642", "0.6950", "1.628", "14.00", "26.00"):
        assert f">{number}<" in page, number
    assert page.count(">0.6642<") == 10, "of fourteen the first and the last five"


def test_of_several_recordings_the_one_that_goes_farthest_is_told(tmp_path: Path) -> None:
    """The median over cycles of all amplitudes would be nobody's loss."""
    story = synthetic_lab.Story()
    for number, high in enumerate((1.0, 2.0, 4.0, 8.0)):
        name = f"R-1_cyclic{number}"
        story.recording(name, "R-1", "cyclic", "mechanical", duration_s=40.0)
        for cycle in range(1, 7):
            row = {
                "recording_id": name,
                "specimen_id": "R-1",
                "cycle": cycle,
                "start_s": 2.0 * cycle,
                "end_s": 2.0 * cycle + 2,
            }
            row |= {
                "displacement_low_mm": 0.0,
                "displacement_high_mm": high,
                "force_low_n": 0.0,
                "force_high_n": 0.06 * high,
            }
            row |= {
                "loss_mj": 0.03 * high**2,
                "steady_loss_mj": 0.031 * high**2,
                "loss_share": 0.09,
                "secant_n_per_mm": 0.06,
            }
            story.rows["cycle_loops"].append(row)
    story.fits("R-1", (0.03, (0.04,), (0.08,)))
    story.run()
    lab = story.write(tmp_path / "lab")
    build_reports(lab)
    page = (lab / "reports" / "specimens" / "R-1.html").read_text(encoding="utf-8")
    assert re.search(r"A cycle over 8\.00.mm in 2\.00.s takes", page)
    assert "takes 1.98" in page
    assert page.count(">0.03100<") == 2, "the first and the last of six"
