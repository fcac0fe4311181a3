"""The first page: what bounds the use of a film, unless a diagnosis tells it, and what to do in short."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from pathlib import Path

import pytest

from reports.build import build_reports
from reports.pages.index import control
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


def test_a_refused_file_stands_in_the_table_with_its_reason_and_remedy(tmp_path: Path) -> None:
    """The table had the files without a mapping and the damaged ones; of those that were refused one had to scroll to the end."""
    story = Story()
    tell(story, "W-1", "wrinkling")
    problem = 'pull.csv: the unit row says "N", the mapping "mN"; expected the same unit in both. Correct unit in the mapping TOML'
    story.recording("W-2_pull", "W-2", "chirp", "mechanical", status="quarantined", problem=problem)
    page = build_index(story, tmp_path)
    table = page[page.index("In short, what was found") :].partition("</table>")[0]
    assert "Refused: pull.csv: the unit row says" in table
    assert "Correct unit in the mapping TOML." in table


@pytest.mark.parametrize("stage", ["record", "film"])
def test_an_alarm_of_a_rig_says_where_its_point_rests_on_faulty_recordings(
    stage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A force that was late had made the clamp seem lighter, and the alarm sent its reader to the rig."""
    alarm = {
        "grouped_by": "rig", "name": "shaker", "quantity": "clamp_mass_kg", "unit": "kg", "point_kind": "specimen", "point": "W-1",
        "at": datetime(2026, 3, 9, tzinfo=UTC), "value": 0.152, "sd": 0.001, "expected": 0.188, "lower": 0.18, "upper": 0.198,
        "alarm": "beyond its limits",
    }  # fmt: skip
    monkeypatch.setattr(control, "alarms", lambda site: [alarm])
    story = Story()
    tell(story, "W-1", "channel_skew")
    story.rows["diagnoses"][-1]["stage"] = stage
    page = build_index(story, tmp_path)
    assert "beyond its limits (expected 0.180 to 0.198 kg)" in page
    assert ("Fitted to recordings with a fault: a recording has one channel" in page) == (stage == "record")


def test_an_unknown_cause_stands_in_the_table_with_where_it_acts(tmp_path: Path) -> None:
    """Its line said "." and what to do."""
    story = Story()
    tell(story, "W-1", "wrinkling")
    tell(story, "W-2", "wrinkling")
    story.rows["diagnoses"][-1] |= {
        "verdict": "unknown", "mechanism": None, "mechanisms": [], "stage": "sensor", "depends_on": ["voltage"],
    }  # fmt: skip
    page = build_index(story, tmp_path)
    table = page[page.index("In short, what was found") :].partition("</table>")[0]
    assert "An effect without a name acts in the sensor and depends on the voltage." in table


@pytest.mark.parametrize(
    ("mechanism", "begins"), [("wrinkling", "the loss is negative, as of no film"), ("sign_flipped", "")]
)
def test_the_page_of_a_specimen_with_negative_losses_says_so_first(mechanism: str, begins: str, tmp_path: Path) -> None:
    """Unless its diagnosis says which channel counts the other way: that says more, and what else is wrong beside it."""
    story = Story()
    tell(story, "W-1", mechanism)
    statement = "the loss is negative: displacement and force may have opposite signs"
    story.rows["discrepancies"].append(
        {"specimen_id": "W-1", "recording_id": "W-1_step", "where_found": SIGN, "chi2": 90.0, "statement": statement}
    )
    story.run()
    lab = story.write(tmp_path / "lab")
    build_reports(lab)
    page = (lab / "reports" / "specimens" / "W-1.html").read_text(encoding="utf-8").replace("\xa0", " ")
    heading = page[page.index("<h1>") :].partition("</h1>")[0]
    assert (begins or "a recording has a channel with the opposite sign") in heading
    assert ("negative" in heading) == bool(begins)
