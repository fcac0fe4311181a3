"""What machines write above their samples: when a test began, in the words of their language, and sizes as a small table of results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ingest.answers import as_suggested
from ingest.draft import Draft, make_draft
from ingest.harvest import STARTED_AT, harvest_columns, harvest_lines


@pytest.mark.parametrize(
    ("line", "moment"),
    [
        ('"Prüfbeginn";"06.06.2024 13:08:55"', "2024-06-06T13:08:55"),
        ("Messbeginn: 06.06.2024 13:08", "2024-06-06T13:08:00"),
        ("Test start date\t2024-06-06 13:08:55", "2024-06-06T13:08:55"),
        ("Measurement date: 06-Jun-2024 13:08:55", "2024-06-06T13:08:55"),
        ("Date d'essai;06.06.2024 13:08:55", "2024-06-06T13:08:55"),
    ],
)
def test_the_start_of_a_test_is_read_in_its_own_words(line: str, moment: str) -> None:
    (fact,) = harvest_lines([line])
    assert (fact.key, fact.value) == (STARTED_AT, moment)


@pytest.mark.parametrize(
    ("stamped", "moment"), [("18.03.2025", "2025-03-18T10:12:09"), ("19.03.2025", "2025-03-18T12:00:00")]
)
def test_a_day_has_the_hour_of_the_block_that_began_on_it(stamped: str, moment: str) -> None:
    """It was noon although the line of the block says when that began."""
    facts = harvest_lines(["Datum : \t18.03.2025", f"Datenerfassung\t\tZeit:\t41,02\ts\t{stamped} 10:12:09"])
    assert [fact.value for fact in facts if fact.key == STARTED_AT] == [moment]


def sizes(rows: list[list[str]]) -> dict[str, float]:
    return {fact.key: fact.value for fact in harvest_columns(rows) if not fact.lacks_unit}


def test_sizes_are_read_from_a_small_table() -> None:
    with_units = [
        ["Results"],
        ["", "Width", "Thickness", "Gauge length"],
        ["", "(mm)", "(µm)", "(cm)"],
        ["1", "30,0", "203", "5"],
    ]
    assert sizes(with_units) == {"film_width_mm": 30.0, "film_thickness_mm": 0.203, "film_length_mm": 50.0}
    in_heads = [["Breite [mm]", "Dicke [mm]"], ["30,00", "0,203"]]
    assert sizes(in_heads) == {"film_width_mm": 30.0, "film_thickness_mm": 0.203}


@pytest.mark.parametrize(
    "rows",
    [
        [["Width", "Thickness"], ["(mm)", "(mm)"], ["30", "0.2"], ["31", "0.2"]],  # of two specimens
        [["Width", "Thickness"], ["30", "0.2"]],  # without units
        [["Width", "Thickness"]],
        [["Width of the band", "is not measured"], ["a", "b"]],
    ],
)
def test_sizes_that_nothing_tells_are_not_taken(rows: list[list[str]]) -> None:
    assert sizes(rows) == {}


@pytest.mark.parametrize("unit", ["mm", "in"])
def test_sizes_without_a_unit_are_asked_beside_a_displacement_in_mm(tmp_path: Path, unit: str) -> None:
    """`Breite : 40,0` may be mm or cm: where the machine moves in mm it is asked, and nothing is taken unasked."""
    time = np.arange(0, 60, 0.1)
    moved = np.clip((time - 5) / 0.4, 0, 1) * 6
    rows = [f"{a:.1f}\t{b:.3f}\t{0.2 * b:.4f}".replace(".", ",") for a, b in zip(time, moved, strict=True)]
    head = ["Breite :\t40,0", "Dicke :\t0,5", "Dicke [mm] :\t0,52", "Zeit\tWeg\tKraft", f"s\t{unit}\tN"]
    path = tmp_path / "strip.txt"
    path.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")
    draft = make_draft(path)
    asked = {q.key: q.suggestion for q in draft.questions if q.key.startswith("recording.film")}
    assert asked == ({"recording.film_width_mm": 40.0} if unit == "mm" else {})
    assert draft.content["recording"]["film_thickness_mm"] == 0.52
    assert "film_width_mm" not in draft.content["recording"]


RESPONSE = "Frequency (Hz);Storage modulus (kPa);Loss modulus (kPa)\n" + "".join(
    f"{f};{200 * f**0.2:.1f};{40 * f**0.2:.1f}\n" for f in (0.1, 0.3, 1.0, 3.0, 10.0, 30.0)
)


def draft_of(folder: Path, *above: str) -> Draft:
    path = folder / "dma.csv"
    path.write_text("".join(f"{line}\n" for line in ("Sample: VHB-7", *above)) + RESPONSE, encoding="utf-8")
    return make_draft(path)


def test_sizes_above_a_table_of_responses_are_taken_and_those_without_a_unit_asked(tmp_path: Path) -> None:
    """They were dropped without a word where one of them had no unit."""
    draft = draft_of(tmp_path, "Length: 20.5", "Width (mm): 6.1", "Thickness: 0.5")
    assert draft.content["recording"]["film_width_mm"] == 6.1
    asked = {q.key: q.suggestion for q in draft.questions}
    assert asked == {"recording.film_length_mm": 20.5, "recording.film_thickness_mm": 0.5}


def test_what_is_assumed_of_a_size_is_what_is_written(tmp_path: Path) -> None:
    """`add --yes` said that a size was assumed, and wrote none."""
    draft, taken = as_suggested(draft_of(tmp_path, "Length: 20.5", "Width: 6.1", "Thickness: 0.5"))
    assert {q.key.removeprefix("recording."): q.suggestion for q in taken} == {
        name: draft.content["recording"][name] for name in ("film_length_mm", "film_width_mm", "film_thickness_mm")
    }


def test_two_sizes_of_three_make_no_stiffness_and_the_draft_says_so(tmp_path: Path) -> None:
    draft = draft_of(tmp_path, "Length: 20.5", "Width (mm): 6.1")
    assert not {"film_length_mm", "film_width_mm"} & draft.content["recording"].keys()
    assert not draft.questions
    remark = draft.remarks["recording.specimen_id"]
    for word in ("film_thickness_mm", "Length: 20.5", "Width (mm): 6.1"):
        assert word in remark
