"""What machines write above their samples: when a test began, in the words of their language, and sizes as a small table of results."""

from __future__ import annotations

import pytest

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


def sizes(rows: list[list[str]]) -> dict[str, float]:
    return {fact.key: fact.value for fact in harvest_columns(rows)}


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
