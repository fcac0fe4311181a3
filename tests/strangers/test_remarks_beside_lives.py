"""What a list of lives says beside its numbers: how specimens failed, which failures do not count, and which rows were no test."""

from __future__ import annotations

import tomllib
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from ingest.draft import make_draft
from ingest.mapping import FileMapping
from ingest.outcomes import FAILED
from ingest.read import read_raw
from ingest.tables import LifetimeTable
from pipeline.cli import main
from schemas.errors import RefusedError
from schemas.lifetimes import EDGE, FILM, LEAD, OTHER, classify_failure_mode
from tests.helpers.xlsx_files import write_xlsx

HEADS = [
    ["Specimen", None, "Voltage", "Test", None, "State", "Remarks"],
    ["No.", "Foil", "[kV]", "Begun", "Duration [min]", None, None],
]
ROWS: list[list[Any]] = [
    [1, "x", 6.0, datetime(2026, 3, 2, 9), 12.5, "failed", "at the edge"],
    [2, "x", None, datetime(2026, 3, 2, 9), 40.0, "failed", "wire contact burnt"],
    [3, "y", None, datetime(2026, 3, 2, 9), 33.0, "failed", "pinhole"],
    [4, "y", None, datetime(2026, 3, 2, 9), 60.0, "running", "looks fine"],
    [5, "x", 7.0, datetime(2026, 3, 3, 9), 4.0, "failed", None],
    [6, "y", None, None, None, "rejected", "torn when mounted"],
    [7, "y", None, datetime(2026, 3, 3, 9), 6.5, "failed", "contact lost"],
]  # fmt: skip


def write_list(folder: Path, *legend: str) -> Path:
    below: list[list[Any]] = [[None] * 7, *([line, *[None] * 6] for line in legend)]
    title = [["Lives of foils", *[None] * 6], [None] * 7]
    return write_xlsx(folder / "lives.xlsx", {"Lives": [*title, *HEADS, *ROWS, *below]})


def read_drafted(path: Path, changed: dict[str, Any] | None = None) -> LifetimeTable:
    content = tomllib.loads(make_draft(path).as_toml())
    content["columns"]["failure_mode"] |= changed or {}
    found = read_raw(path, FileMapping.parse(content, stem=path.stem, suffix=path.suffix))
    assert isinstance(found, LifetimeTable)
    return found


def test_a_unit_in_the_lower_of_two_rows_of_heads_is_read(tmp_path: Path) -> None:
    """The name was joined behind the unit, which then stood nowhere: the unit of the lives was asked for."""
    draft = make_draft(write_list(tmp_path))
    assert draft.content["columns"]["lifetime"]["unit"] == "min"
    assert not [q for q in draft.questions if q.key.endswith("unit")]


def test_a_mark_that_stands_beside_no_life_is_no_test(tmp_path: Path) -> None:
    """It was proposed as one of failures, and the row then refused the table."""
    columns = make_draft(write_list(tmp_path)).content["columns"]
    assert columns["failed"]["failed_values"] == [FAILED]
    assert columns["failed"]["no_test_values"] == ["rejected"]
    table = read_drafted(write_list(tmp_path))
    assert len(table.rows) == 6
    assert any("no test" in note for note in table.notes)


def test_remarks_say_how_specimens_failed(tmp_path: Path) -> None:
    table = read_drafted(write_list(tmp_path))
    assert [row.failure_mode for row in table.rows] == [EDGE, LEAD, FILM, None, None, LEAD]
    # what is remarked of a survivor is no failure mode that nothing tells
    assert not any("count as other" in note for note in table.notes)


@pytest.mark.parametrize(
    ("legend", "suggested"),
    [
        ((), []),
        (("contact failures are not counted as failures of the foil",), ["lead"]),
        (("Kontaktfehler zählen nicht als Folienausfall",), ["lead"]),
    ],
)
def test_which_failures_count_is_asked(tmp_path: Path, legend: tuple[str, ...], suggested: list[str]) -> None:
    draft = make_draft(write_list(tmp_path, *legend))
    (asked,) = [q for q in draft.questions if q.key == "columns.failure_mode.censored_modes"]
    assert asked.suggestion == suggested
    assert "film, lead, edge" in asked.text


def test_failures_of_modes_that_do_not_count_end_the_watch(tmp_path: Path) -> None:
    table = read_drafted(write_list(tmp_path), {"censored_modes": ["lead"]})
    assert [(row.lifetime_s, row.failed) for row in table.rows] == [
        (750.0, True), (2400.0, False), (1980.0, True), (3600.0, False), (240.0, True), (390.0, False),
    ]  # fmt: skip
    assert [row.censored_because for row in table.rows] == [
        None, "failed: lead", None, "censored in the table", None, "failed: lead",
    ]  # fmt: skip
    assert any(note.startswith("2 failures (lead) count as survivors until then") for note in table.notes)


def test_a_mode_that_there_is_not_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RefusedError, match='censored_modes is "leed"'):
        read_drafted(write_list(tmp_path), {"censored_modes": ["leed"]})


@pytest.mark.parametrize(
    ("written", "mode"),
    [("Anschlussfehler", LEAD), ("connectors loose", LEAD), ("Folienriss", FILM), ("leading", OTHER), ("rim", EDGE)],
)
def test_compound_words_name_failure_modes(written: str, mode: str) -> None:
    assert classify_failure_mode(written) == mode


def test_columns_that_a_person_names_are_taken(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A column of words that was said to be a batch ended in a traceback."""
    path = write_list(tmp_path)
    assert main(["add", str(path), "--yes", "1=batch", "6=failure_mode"]) == 0
    content = tomllib.loads((tmp_path / "lives.xlsx.toml").read_text(encoding="utf-8"))
    assert content["columns"]["batch"] == {"column": 1}
    assert '"Begun Test"' in capsys.readouterr().out
    with pytest.raises(RefusedError, match="a column of dates"):
        make_draft(path, wanted=_wanted({"1": "started", "3": "ended"}))


def _wanted(roles: dict[str, str]) -> Any:
    from ingest.draft import Wanted

    return Wanted(roles=roles)


def test_lines_above_a_list_that_have_its_width_are_none_of_it(tmp_path: Path) -> None:
    """A spreadsheet pads them with delimiters: the first with a number was taken for the first row, and the title for the header."""
    path = tmp_path / "essais.csv"
    above = ["Essais de fatigue, film 80 µm;;;", "Fréquence d'essai;20;Hz;", ";;;"]
    rows = [f"E{i};{3 + i % 2},0;{100 + i},5;{'non rompue' if i == 4 else 'claquage'}" for i in range(8)]
    path.write_text("\n".join([*above, "Repère;U (kV);Durée de vie (milliers de cycles);État final", *rows]) + "\n")
    content = tomllib.loads(make_draft(path).as_toml())
    columns = content["columns"]
    assert columns["lifetime"] == {"column": "Durée de vie (milliers de cycles)", "unit": "kcycles"}
    assert columns["frequency"] == {"value": 20.0, "unit": "Hz"}
    assert columns["specimen_id"] == {"column": "Repère"}
    assert (columns["failed"]["failed_values"], columns["failed"]["censored_values"]) == (["claquage"], ["non rompue"])
    found = read_raw(path, FileMapping.parse(content, stem=path.stem, suffix=path.suffix))
    assert isinstance(found, LifetimeTable)
    assert [row.lifetime_s for row in found.rows] == pytest.approx([(100 + i + 0.5) * 1000 / 20 for i in range(8)])


@pytest.mark.parametrize(
    ("title", "cells", "format"),
    [
        ("Time under voltage", ["2:05:00", "0:07:00", "4:11"], "hh:mm"),
        ("Time under voltage", ["2:05:07", "0:07:00", "4:11"], None),
        ("Time under voltage hours:minutes", ["2:05", "0:07", "4:11"], "hh:mm"),
        ("Time under voltage (minutes:seconds)", ["2:05", "0:07", "4:11"], "mm:ss"),
    ],
)
def test_what_two_parts_of_a_duration_are_is_told_or_asked(
    tmp_path: Path, title: str, cells: list[str], format: str | None
) -> None:
    """Seconds were proposed for hours and minutes."""
    path = tmp_path / "lives.csv"
    rows = [f"S{i},{cell},{'failed' if i else 'running'}" for i, cell in enumerate(cells)]
    path.write_text("\n".join([f"Specimen,{title},Status", *rows]) + "\n")
    draft = make_draft(path)
    assert draft.content["columns"]["lifetime"]["format"] == format
    asked = [q for q in draft.questions if q.key == "columns.lifetime.format"]
    assert [q.suggestion for q in asked] == ([] if format else [None])


def test_groups_whose_names_differ_by_case_are_one(tmp_path: Path) -> None:
    path = tmp_path / "lives.csv"
    names = ["Carbon grease", "carbon grease", "Carbon  grease", "Carbon grease", "SWCNT"]
    rows = [f"S{i},{name},{10 + i},failed" for i, name in enumerate(names)]
    path.write_text("\n".join(["Specimen,Electrode design,Lifetime [s],Status", *rows]) + "\n")
    content = tomllib.loads(make_draft(path).as_toml())
    found = read_raw(path, FileMapping.parse(content, stem=path.stem, suffix=path.suffix))
    assert isinstance(found, LifetimeTable)
    assert [row.configuration for row in found.rows] == ["Carbon grease"] * 4 + ["SWCNT"]
    assert any('configuration: "carbon grease" is read as "Carbon grease"' in note for note in found.notes)


def write_dated(path: Path, *below: str) -> Path:
    head = ["Sample,Voltage [kV],switched on,failed / switched off,Result"]
    rows = [
        "A1,4.0,2024-06-03 09:00,2024-06-05 09:00,breakdown of the film",
        "A2,4.0,2024-06-03 09:00,2024-06-04 21:00,flashover at the contact",
        "A3,4.0,2024-06-03 10:00,,running",
        *(f"A{i},5.0,2024-06-04 09:00,2024-06-04 {9 + i}:00,breakdown of the film" for i in range(4, 12)),
    ]
    path.write_text("\n".join([*head, *rows, *below]) + "\n")
    return path


def test_specimens_without_an_end_run_until_the_state_of_the_list(tmp_path: Path) -> None:
    path = write_dated(tmp_path / "dated.csv", ",,,,", "As of 2024-06-10 12:00,,,,")
    content = tomllib.loads(make_draft(path).as_toml())
    assert content["columns"]["ended"]["open_until"] == "2024-06-10T12:00:00"
    found = read_raw(path, FileMapping.parse(content, stem=path.stem, suffix=path.suffix))
    assert isinstance(found, LifetimeTable)
    lives = {row.specimen_id: (row.lifetime_s / 3600, row.failed) for row in found.rows}
    later = {f"A{i}": (i, True) for i in range(4, 12)}
    assert lives == {"A1": (48, True), "A2": (36, True), "A3": (170, False), **later}
    said = "without an end: under test until 2024-06-10T12:00:00, the state of the list"
    assert [note for note in found.notes if said in note], found.notes


def test_a_state_of_the_list_that_is_no_date_is_refused(tmp_path: Path) -> None:
    path = write_dated(tmp_path / "dated.csv")
    content = tomllib.loads(make_draft(path).as_toml())
    assert "open_until" not in content["columns"]["ended"]
    content["columns"]["ended"]["open_until"] = "last Monday"
    with pytest.raises(RefusedError, match='open_until is "last Monday"'):
        FileMapping.parse(content, stem=path.stem, suffix=path.suffix)


def test_a_force_in_grams_is_asked_as_a_weight(tmp_path: Path) -> None:
    """Newtons were proposed."""
    path = tmp_path / "pull.csv"
    rows = [f"{100 * i / (3 + i):.4f},{0.1 * i:.3f},{0.05 * i:.3f}" for i in range(200)]
    path.write_text("\n".join(["Force,Distance,Time", "g,mm,s", *rows]) + "\n")
    draft = make_draft(path)
    (asked,) = [q for q in draft.questions if q.key == "columns.force.unit"]
    assert asked.suggestion == "gf"
    assert draft.content["columns"]["force"]["unit"] == "gf"


def test_failures_with_one_text_end_the_watch_and_others_of_the_mode_do_not(tmp_path: Path) -> None:
    """A film torn at its clamp and a breakdown at the edge of its electrode are both failures at an edge."""
    path = tmp_path / "lives.csv"
    ways = ["breakdown", "breakdown at electrode edge", "torn at clamp", "torn at clamp"]
    rows = [f"S{i},4,{10 + i},failed,{way}" for i, way in enumerate(ways)]
    path.write_text("\n".join(["Specimen,Voltage [kV],Life [h],Status,Failure mode", *rows, "S9,4,99,stopped,-", ""]))
    (asked,) = [q for q in make_draft(path).questions if q.key == "columns.failure_mode.censored_modes"]
    assert asked.text.endswith("breakdown, breakdown at electrode edge, torn at clamp")
    table = read_drafted(path, {"censored_modes": ["torn at clamp"]})
    assert [row.failed for row in table.rows] == [True, True, False, False, False]
    assert [row.censored_because for row in table.rows][2] == "failed: torn at clamp"
