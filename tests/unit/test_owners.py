"""Whose a foreign recording is: the specimen whose response it has, and nobody where none has it."""

from __future__ import annotations

from pathlib import Path

import duckdb
import pytest

from reports.build import build_reports
from reports.owners import find_owners
from reports.results import Query, Results
from tests.helpers.synthetic_lab import POLYACRYLATE, SILICONE, STACK, Story

SOFTER = (0.25, (0.28,), (1.4e-4,))
"""A silicone like the first, a seventh softer."""
FOREIGN = "SI-2-chirp-3"


def tell(story: Story, model: object, others: dict[str, object]) -> None:
    """A specimen with a recording of `model` among its own, and others by name."""
    for specimen, own in {"SI-2": SOFTER, **others}.items():
        names = [f"{specimen}-chirp-{i}" for i in (1, 2)]
        for name in names:
            story.recording(name, specimen, "chirp", "mechanical", duration_s=60.0)
        story.responses(specimen, own, names)
    story.recording(FOREIGN, "SI-2", "chirp", "mechanical", duration_s=60.0)
    story.responses("SI-2", model, [FOREIGN])
    story.rows["corrections"].append(
        {"specimen_id": "SI-2", "recording_id": FOREIGN, "cause": "foreign_recording", "key": "specimen_id", "value_now": "SI-2", "probability": 0.99}
    )  # fmt: skip
    story.rows["diagnoses"].append(
        {
            "specimen_id": "SI-2", "verdict": "named", "mechanism": "foreign_recording", "mechanisms": ["foreign_recording"],
            "also_possible": [], "p_value": 0.001, "smallest_detectable": "{}", "stage": "record",
        }
    )  # fmt: skip
    story.run()


def owner(lab: Path) -> str:
    with Results(lab) as results:
        return find_owners(results, Query("specimen_id = 'SI-2'")).get("SI-2", "").replace("\xa0", " ")


@pytest.mark.parametrize(
    ("model", "others", "expected"),
    [
        (SILICONE, {"SI-1": SILICONE, "PA-1": POLYACRYLATE, "ST-1": STACK}, "of the 3 other specimens here with such lines no other has it"),
        (SILICONE, {"SI-1": SILICONE, "SI-3": SILICONE}, "its response does not tell of which"),
        (SILICONE, {"PA-1": POLYACRYLATE, "ST-1": STACK}, ""),
        ((0.27, (0.30,), (1.4e-4,)), {"SI-1": SILICONE}, ""),
        (SILICONE, {}, ""),
    ],
    ids=["one", "twins", "others are far", "the nearest is 7 % off", "alone"],
)  # fmt: skip
def test_a_foreign_recording_is_proposed_for_whom_it_matches(
    model: object, others: dict[str, object], expected: str, tmp_path: Path
) -> None:
    story = Story()
    tell(story, model, others)
    said = owner(story.write(tmp_path / "lab"))
    if not expected:
        assert said == ""
    else:
        assert said.startswith(f"{FOREIGN} has the response of SI-1 (within ")
        assert said.endswith(f"{expected}.")


def test_the_page_says_it_and_follows_the_other_specimen(tmp_path: Path) -> None:
    story = Story()
    tell(story, SILICONE, {"SI-1": SILICONE})
    lab = story.write(tmp_path / "lab")
    build_reports(lab)
    page = lab / "reports" / "specimens" / "SI-2.html"
    assert "has the response of SI-1" in page.read_text(encoding="utf-8")
    assert "has the response of SI-1" in (lab / "reports" / "index.html").read_text(encoding="utf-8")
    with duckdb.connect(str(lab / "results.duckdb")) as connection:
        connection.execute(
            'UPDATE frequency_responses SET "real" = 2 * "real", imag = 2 * imag WHERE specimen_id = \'SI-1\''
        )
    build_reports(lab)
    assert "has the response of SI-1" not in page.read_text(encoding="utf-8")
