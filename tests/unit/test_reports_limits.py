"""What bounds the use of a film is on the first page, unless the diagnosis named there tells it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from reports.build import build_reports
from tests.helpers.synthetic_lab import Story


@pytest.mark.parametrize(("mechanism", "told_apart"), [("rig_constants", True), ("wrinkling", False)])
def test_only_its_own_cause_hides_a_limit(mechanism: str, told_apart: bool, tmp_path: Path) -> None:
    story = Story()
    story.recording("W-1_step", "W-1", "step", "electrical", duration_s=124.0)
    story.steps("W-1", "W-1_step", wrinkles_from=7.0)
    story.rows["sensing_fits"].append(
        {"specimen_id": "W-1", "wrinkling_onset_kv": 6.7, "wrinkling_onset_kv_lower": 6.4, "wrinkling_onset_kv_upper": 7.0}
    )  # fmt: skip
    story.rows["diagnoses"].append(
        {
            "specimen_id": "W-1", "verdict": "named", "mechanism": mechanism, "mechanisms": [mechanism], "also_possible": [],
            "p_value": 0.001, "smallest_detectable": json.dumps({}),
        }
    )  # fmt: skip
    story.run()
    lab = story.write(tmp_path / "lab")
    build_reports(lab)
    page = (lab / "reports" / "index.html").read_text(encoding="utf-8")
    assert ("the film wrinkles from" in page.replace("\xa0", " ")) == told_apart
