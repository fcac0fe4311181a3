"""`dealab control` and the page's part about controllers, for a film of a lab, and what the command answers to slips."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest

from pipeline.cli import main
from reports.build import build_reports
from tests.helpers.synthetic_lab import STACK, Story

SIZES = {"film_length_mm": "50.0", "stretch_1": "1.5", "total_length_mm": "75.0", "drive_kv": "8.0"}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film with a model and steps from 3 to 8 kV; the designs of a night as rows."""
    story = Story()
    story.recording("C-1_relaxation", "C-1", "step", "mechanical", keys=SIZES)
    story.recording("C-1_levels", "C-1", "step", "electrical", keys=SIZES)
    story.fits("C-1", STACK)
    story.steps("C-1", "C-1_levels", wrinkles_from=7.5)
    for row in story.rows["step_responses"]:
        row |= {"specimen_id": "C-1", "force_step_sd_n": 1e-4, "capacitance_step_sd_pf": 4e-4}
    story.fits("C-2", STACK)
    for goal, controller, settled, over in (
        ("printed", "PI, thesis", None, 0.0),
        ("gentle", "film inverse and PI", 6.2, 9.1),
        ("quick", "predictive", 0.7, 61.0),
    ):
        row = {
            "specimen_id": "C-1", "goal": goal, "controller": controller, "demand_step_pf": -0.06, "settled_share": 1.0,
            "proportional_gain": None if controller == "predictive" else 20.0, "integral_gain": 6.0, "note": "as assumed",
            "phase_margin_deg": 72.0, "gain_margin": 2.4,
        }  # fmt: skip
        for name, value in (
            ("rise_time_s", settled), ("settling_time_s", settled), ("overshoot_percent", 0.0),
            ("force_overshoot_percent", over), ("peak_kv", 5.5),
        ):  # fmt: skip
            row |= {name: value, f"{name}_lower": value and 0.9 * value, f"{name}_upper": value and 1.1 * value}
        story.rows["controller_designs"].append(row)
        for time in (0.0, 0.1, 1.0, 10.0):
            story.rows["controller_courses"].append(
                {
                    "specimen_id": "C-1", "goal": goal, "controller": controller, "time_s": time, "voltage_kv": 4.0,
                    "capacitance_change_pf": -0.05, "capacitance_change_pf_lower": -0.06, "capacitance_change_pf_upper": -0.04,
                    "force_drop_n": 0.01, "force_drop_n_lower": 0.009, "force_drop_n_upper": 0.011,
                }
            )  # fmt: skip
    story.run()
    return story.write(tmp_path_factory.mktemp("control") / "lab")


def ask(lab: Path, *words: str) -> int:
    return main(["control", *words, "--lab", str(lab)])


@pytest.mark.long
@pytest.mark.slow
def test_text_and_table_have_all_controllers(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ask(lab, "C-1") == 0
    text = capsys.readouterr().out
    assert "gentle   film inverse and PI" in text
    assert "gains of 5 steps" in text  # that at 8 kV wrinkled
    assert ask(lab, "C-1", "--force-overshoot", "25", "--demand-pf", "-0.05", "--format", "csv") == 0
    both = capsys.readouterr()
    rows = {(r["goal"], r["controller"]): r for r in csv.DictReader(io.StringIO(both.out))}
    assert len(rows) == 7
    assert float(rows["gentle", "film inverse and PI"]["force_limit_percent"]) == pytest.approx(25)
    assert float(rows["gentle", "film inverse and PI"]["demand_step_pf"]) == -0.05
    assert "amplifier 1.5 kV/V, lag 20 ms" in both.err


@pytest.mark.long
@pytest.mark.slow
def test_json_holds_the_courses(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ask(lab, "C-1", "--format", "json") == 0
    found = json.loads(capsys.readouterr().out)
    course = next(c for c in found["courses"] if c["goal"] == "gentle" and c["controller"] == "predictive")
    assert course["capacitance_pf"][-1] == pytest.approx(found["designs"][0]["demand_step_pf"], rel=0.02)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("nobody",), 'there is no mechanical model of "nobody"'),
        (("C-2",), "C-2: 0 steps with a capacitance and open loop"),
        (("C-1", "--demand-pf", "0.1"), "a change that up to 7 kV can hold"),
        (("C-1", "--demand-pf", "-9"), "a change that up to 7 kV can hold"),
    ],
)
def test_slips_get_one_line(lab: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str) -> None:
    assert ask(lab, *words) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.strip().count("\n") <= 1


def test_the_page_says_what_was_designed(lab: Path) -> None:
    build_reports(lab)
    text = (lab / "reports" / "specimens" / "C-1.html").read_text(encoding="utf-8")
    assert "a controller settles in 6.2" in text
    assert "the printed gains do not settle" in text
    assert "never" in text
    assert "C-1_controllers.csv" in text
