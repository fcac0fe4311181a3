"""What `dealab diagnose` prints of published diagnoses, for people and for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pipeline import Lab
from pipeline.analyse.diagnosis_tables import diagnosis_tables, undiagnosed_tables
from pipeline.commands.show.diagnoses import describe_diagnoses
from pipeline.lab.snapshot import Changes, publish
from reports.findings import list_next
from reports.results import Results
from reports.standings import of_lab
from schemas.errors import UsageError
from schemas.explanations import tell_no_gain
from schemas.mechanisms import severity
from tests.unit.test_diagnosis_tables import FIRST, NAMED, SECOND


def renamed(name: str, **more: Any) -> Mapping[str, Any]:
    return diagnosis_tables(replace(NAMED, specimen_id=name, **more), (FIRST, SECOND))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """Four specimens, one of each verdict but unknown, and one that could not be asked."""
    folder = tmp_path_factory.mktemp("told")
    names = ("S-1", "S-2", "S-3", "S-4", "S-5", "S-6")
    measured = [(f"{n}-r", n) for n in names] + [("r-1", "S-1"), ("r-2", "S-1")]
    recordings = [
        {"recording_id": r, "specimen_id": n, "status": "ok", "source_path": f"/raw/{r}", "source_sha256": r}
        for r, n in measured
    ]
    close = {"verdict": "ambiguous", "mechanisms": ("slack",), "also_possible": ("strain_stiffening",)}
    quiet = {"verdict": "none", "mechanisms": (), "extension": None, "held_out": None, "next_recording": None}
    rows = [
        {"recordings": recordings},
        renamed("S-1"),
        renamed("S-2", **close),
        renamed("S-3", **quiet, candidates=(), p_value=0.4),
        renamed("S-6", verdict="ambiguous", also_possible=()),
        undiagnosed_tables("S-4", ["one sweep \x1b[2Jalone"]),
    ]
    made = Lab(folder)
    made.create()
    publish(made, Changes(insertions=rows))
    return made


def told(lab: Lab, name: str) -> str:
    return describe_diagnoses(lab, [name], as_json=False)


def test_a_cause_that_may_stand_beside_a_sure_one_is_told_as_such(lab: Lab) -> None:
    first = told(lab, "S-6").splitlines()[0]
    assert first == (
        "◐ S-6: force reads too much, by 10.0 ± 1.0 %, and perhaps the film softens from cycle to cycle; these recordings cannot tell "
        "(ambiguous)."
    )


def test_a_named_cause_is_told_with_size_gain_interval_and_what_moved(lab: Lab) -> None:
    text = told(lab, "S-1")
    first, second, third = text.splitlines()[:3]
    assert first == "● S-1: force reads too much, by 10.0 ± 1.0 %, and the film softens from cycle to cycle (named)."  # fmt: skip
    assert "97 % (95 % interval 94 % to 99 %)" in second
    assert third == "  5.00 → 1.20 times the noise."
    assert "r-1: The response is missed by 3 %." in text
    ranked = next(line for line in text.splitlines() if "● gain_error" in line)
    assert " ".join(ranked.split()) == "● gain_error 880 99 % 98 % 10.0 ± 1.0 %"
    assert "k0: 1.000 ± 0.020 → 0.900 ± 0.010 N/mm, moved by 10 SD" in text
    assert "    Hang 50 g on the cell." in text.split("What to do\n")[1].splitlines()
    assert "leakage: 2.0 % droop" in text
    assert "Cannot be seen in these recordings\n    wrinkling" in text
    assert "What could not be asked\n    no temperature" in text


def test_the_terminal_says_what_to_do_as_the_pages_do(lab: Lab) -> None:
    """The constants to write into a rig's file stood on the page alone."""
    names = ["S-1", "S-2", "S-6"]
    with Results(lab.folder) as results:
        standings = of_lab(results, names)
    assert [s.specimen_id for s in standings] == names
    for standing in standings:
        title, sentences = list_next(standing)
        assert sentences
        lines = told(lab, standing.specimen_id).splitlines()
        first = lines.index(f"  {title}") + 1
        assert " ".join(line.strip() for line in lines[first:]).startswith(" ".join(map(str, sentences)))


def test_a_cause_that_brings_no_gain_is_not_said_to_bring_one() -> None:
    row = {"gain": 0.01, "gain_lower": -0.005, "chi2": 1549.4, "chi2_extended": 1549.3}
    no_better = "What the fit has not seen is predicted no better with it"
    assert tell_no_gain(row).startswith(f"{no_better}: the plain model follows these recordings too")
    assert tell_no_gain(row | {"chi2_extended": 1400.0}) == f"{no_better}."
    assert tell_no_gain(row | {"gain_lower": 0.002}) == ""
    open_words = tell_no_gain(row | {"gain": 0.9999, "gain_lower": -1.0, "gain_upper": 1.0})
    assert open_words.startswith("Whether"), "an interval from −100 to 100 %"
    assert tell_no_gain(row | {"gain": None, "gain_lower": None}) == ""


def test_causes_that_cannot_be_told_apart_are_both_named_without_sizes(lab: Lab) -> None:
    first = told(lab, "S-2").splitlines()[0]
    assert (
        first
        == "◐ S-2: either the film goes slack, or the film stiffens or softens with strain; these recordings cannot tell which (ambiguous)."
    )
    assert "Cannot be told apart: slack; strain_stiffening" in told(lab, "S-2")


def test_nothing_found_says_what_would_have_been(lab: Lab) -> None:
    text = told(lab, "S-3")
    assert text.startswith("○ S-3: the simulation is right within the noise, p = 0.40 (none).")
    assert "Causes" not in text
    assert "leakage: 2.0 % droop" in text


def test_what_could_not_be_asked_is_told_with_the_reason_and_without_control_characters(lab: Lab) -> None:
    text = told(lab, "S-4")
    assert text == "– S-4: could not be asked. One sweep \\x1b[2Jalone."
    assert told(lab, "S-5") == "No diagnoses are published for S-5."
    with pytest.raises(UsageError):
        told(lab, "S-9")


def test_all_specimens_without_names(lab: Lab) -> None:
    text = describe_diagnoses(lab, [], as_json=False)
    assert [line[0] for line in text.splitlines() if not line.startswith(" ") and line] == ["●", "◐", "○", "–", "◐"]


def test_programs_get_everything_as_objects(lab: Lab) -> None:
    first, *others = json.loads(describe_diagnoses(lab, [], as_json=True))
    assert first["severity"]["gain_error"]["gain"] == {"value": 0.1, "sd": 0.01, "lower": 0.08, "upper": 0.12}
    assert first["candidates"][0]["mechanism"] == "gain_error"
    assert first["discrepancies"][0]["recording_id"] == "r-1"
    assert {p["parameter"] for p in first["parameters"]} >= {"k0", "k1", "tau1"}
    assert first["next_design"] == [{"protocol": "weight"}]
    assert [o["verdict"] for o in others] == ["ambiguous", "none", None, "ambiguous"]


def test_a_lab_of_an_earlier_release_without_diagnoses(tmp_path: Path) -> None:
    made = Lab(tmp_path)
    made.create()
    publish(made, Changes())
    assert describe_diagnoses(made, [], as_json=False) == "No diagnoses are published for this lab."
    assert json.loads(describe_diagnoses(made, [], as_json=True)) == []


def test_a_shape_that_is_hardly_known_is_told_by_its_interval() -> None:
    """± more than the value itself would say more than is known."""
    told = severity(
        "drive_lag",
        {
            "rise_time_constant_s": {"value": 3.11e-4, "sd": 9e-6, "lower": 2.96e-4, "upper": 3.27e-4},
            "slew_kv_per_s": {"value": 8770.8, "sd": 17359.5, "lower": 328.7, "upper": 226_710.8},
            "form": "monitored",
        },
    )
    told = told.replace("\N{NARROW NO-BREAK SPACE}", " ").replace("\N{NO-BREAK SPACE}", " ")
    assert told == "rise time constant 0.311 ± 0.009 ms, slew rate 330 to 230 000 kV/s (90 %), form monitored"
