"""The first page: what bounds the use of a film, unless a diagnosis tells it, and what to do in short."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from reports.build import build_reports
from schemas.mechanisms import ACTIONS
from tests.helpers.synthetic_lab import Story


def tell(story: Story, specimen: str, mechanism: str) -> None:
    """A specimen with steps, and a cause that its diagnosis names."""
    story.recording(f"{specimen}_step", specimen, "step", "electrical", duration_s=124.0)
    story.steps(specimen, f"{specimen}_step", wrinkles_from=7.0)
    story.rows["diagnoses"].append(
        {
            "specimen_id": specimen, "verdict": "named", "mechanism": mechanism, "mechanisms": [mechanism], "also_possible": [],
            "p_value": 0.001, "smallest_detectable": "{}",
        }
    )  # fmt: skip


def build_index(story: Story, folder: Path) -> str:
    story.run()
    lab = story.write(folder / "lab")
    build_reports(lab)
    return (lab / "reports" / "index.html").read_text(encoding="utf-8").replace("\xa0", " ")


@pytest.mark.parametrize(("mechanism", "told_apart"), [("rig_constants", True), ("wrinkling", False)])
def test_only_its_own_cause_hides_a_limit(mechanism: str, told_apart: bool, tmp_path: Path) -> None:
    story = Story()
    tell(story, "W-1", mechanism)
    story.rows["sensing_fits"].append(
        {"specimen_id": "W-1", "wrinkling_onset_kv": 6.7, "wrinkling_onset_kv_lower": 6.4, "wrinkling_onset_kv_upper": 7.0}
    )  # fmt: skip
    page = build_index(story, tmp_path)
    assert ("the film wrinkles from" in page) == told_apart
    assert (re.search(r"<h1>[^<]*one film wrinkles", page) is not None) == told_apart
    # One thing to do stands with its finding.
    assert "In short, what was found" not in page


def test_several_things_to_do_are_told_in_short(tmp_path: Path) -> None:
    story = Story()
    causes = {"W-1": "wrinkling", "W-2": "leakage"}
    for specimen, mechanism in causes.items():
        tell(story, specimen, mechanism)
    page = build_index(story, tmp_path)
    table = page[page.index("In short, what was found") :].partition("</table>")[0]
    assert all(specimen in table and ACTIONS[cause] in table for specimen, cause in causes.items())
