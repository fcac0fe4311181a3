"""The first page: what bounds the use of a film, unless a diagnosis tells it, and what to do in short."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from reports.build import build_reports
from schemas.mechanisms import ACTIONS
from schemas.places import SIGN
from tests.helpers.synthetic_lab import LAST, Story


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


def test_a_file_without_a_mapping_stands_among_what_is_to_be_done(tmp_path: Path) -> None:
    story = Story()
    tell(story, "W-1", "wrinkling")
    for name in ("old one.csv", "run-7.csv"):
        story.rows["items"].append(
            {"item_id": f"file:/raw/{name}", "stage": "file", "outcome": "unmapped", "run_id": LAST}
        )
    page = build_index(story, tmp_path)
    table = page[page.index("In short, what was found") :].partition("</table>")[0]
    assert "Have no mapping: they were not read." in table
    assert "dealab add &#39;/raw/old one.csv&#39;" in table
    assert "run-7.csv" in table


def test_a_night_of_one_file_without_a_mapping_says_what_to_do(tmp_path: Path) -> None:
    story = Story()
    story.rows["items"].append(
        {"item_id": "file:/raw/run-7.csv", "stage": "file", "outcome": "unmapped", "run_id": LAST}
    )
    page = build_index(story, tmp_path)
    assert "dealab add /raw/run-7.csv" in page[page.index("In short, what was found") :].partition("</table>")[0]


def test_a_recording_that_was_read_in_part_stands_among_what_is_to_be_done(tmp_path: Path) -> None:
    """The file without a mapping did, and the truncated one beside it did not."""
    story = Story()
    story.recording("W-2_chirp", "W-2", "chirp", "mechanical", status="damaged", problem="the file ends after 3.2 s")
    page = build_index(story, tmp_path)
    table = page[page.index("In short, what was found") :].partition("</table>")[0]
    assert "W-2_chirp" in table
    assert "The file ends after 3.2 s." in table
    assert "Copy it again from the rig" in table


def test_the_page_of_a_specimen_with_negative_losses_says_so_first(tmp_path: Path) -> None:
    story = Story()
    tell(story, "W-1", "wrinkling")
    statement = "the loss is negative: displacement and force may have opposite signs"
    story.rows["discrepancies"].append(
        {"specimen_id": "W-1", "recording_id": "W-1_step", "where_found": SIGN, "chi2": 90.0, "statement": statement}
    )
    story.run()
    lab = story.write(tmp_path / "lab")
    build_reports(lab)
    page = (lab / "reports" / "specimens" / "W-1.html").read_text(encoding="utf-8").replace("\xa0", " ")
    assert re.search(r"<h1>[^\n]*the loss is negative, as of no film", page)
