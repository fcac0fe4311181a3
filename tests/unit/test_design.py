"""`dealab design`: the sheet and the front that it prints for a film of a lab, and what it answers to slips."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import duckdb
import pytest

from pipeline.cli import main
from pipeline.commands.show.designs import parse_requirement
from schemas.errors import UsageError
from tests.helpers.synthetic_lab import STACK, Story

SIZES = {
    "film_length_mm": "50.0", "film_width_mm": "50.0", "film_thickness_mm": "1.0", "stretch_1": "1.4", "active_length_mm": "40.0",
    "active_width_mm": "40.0", "active_drawn": "stretched", "drive_kv": "7.0", "relative_permittivity": "4.7",
}  # fmt: skip


def record(story: Story, name: str, specimen: str, protocol: str, loading: str) -> None:
    identity = {"recording_id": name, "specimen_id": specimen, "protocol": protocol, "loading": loading}
    story.recording(
        name, specimen, protocol, loading, keys=SIZES | identity | {"started_at": "2026-11-20T08:00:00+00:00"}
    )


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A stack whose film is known to 0.1 to 2 %, and its permittivity to 1 %; three others of its material that bore a test
    at 7.5 kV and broke down when their voltage was raised, and three that failed while it was held."""
    story = Story()
    record(story, "S-1_chirp", "S-1", "chirp", "mechanical")
    record(story, "S-1_sphs", "S-1", "sphs", "electrical")
    story.fits("S-1", STACK)
    for i, volts in enumerate((10.0, 11.0, 12.1)):
        record(story, f"L-{i}", f"L-{i}", "lifetime", "electrical")
        story.rows["lifetimes"].append(
            {
                "recording_id": f"L-{i}", "specimen_id": f"L-{i}", "voltage_kv": 7.5, "breakdown_voltage_kv": volts,
                "failed": False, "lifetime_s": 240.0,
            }
        )  # fmt: skip
        record(story, f"H-{i}", f"H-{i}", "lifetime", "electrical")
        story.rows["lifetimes"].append(
            {
                "recording_id": f"H-{i}",
                "specimen_id": f"H-{i}",
                "voltage_kv": 7.5,
                "failed": True,
                "lifetime_s": 5.0 + i,
            }
        )
    story.rows["permittivities"].append(
        {
            "specimen_id": "S-1", "method": "sphs", "relative_permittivity": 4.5, "relative_permittivity_lower": 4.5 - 0.0882,
            "relative_permittivity_upper": 4.5 + 0.0882, "force_per_voltage_squared_n_per_kv2": 1e-3,
        }
    )  # fmt: skip
    story.run()
    return story.write(tmp_path_factory.mktemp("design") / "lab")


def ask(lab: Path, *words: str) -> int:
    return main(["design", "S-1", *words, "--lab", str(lab)])


def test_sheet_of_the_specimen_itself(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert ask(lab, "--format", "json") == 0
    found = json.loads(capsys.readouterr().out)
    sheet = {row["quantity"]: row for row in found["sheet"]}
    # 0.0965 N of 4.7 at 40 mm and 7 kV (thesis' film), of which 40 of 70 mm are active; permittivity 4.5 ± 1 %
    assert sheet["force"]["value"] == pytest.approx(0.0965 * 4.5 / 4.7 * 40 / 70, rel=5e-3)
    assert sheet["force"]["value_upper"] / sheet["force"]["value"] == pytest.approx(1.0198, abs=1e-3)
    # median of fields at breakdown 11 kV, whatever failed at 7.5 kV after some seconds × √1.4 over 1 mm against 7 kV
    assert sheet["breakdown margin"]["value"] == pytest.approx(11 / 7, rel=1e-3)
    assert sheet["breakdown margin"]["value_lower"] < 1.3
    assert found["force_stroke"][0]["force_n"] == pytest.approx(sheet["force"]["value"])
    assert any("4.5 (4.41 to 4.59) from its harmonic sequences" in line for line in found["assumptions"])


def test_text_and_table_say_the_same_and_what_is_assumed(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--length-mm", "60", "--width-mm", "30", "--layers", "4", "--voltage-kv", "6", "--stretch", "1.2")
    assert ask(lab, *words) == 0
    text = capsys.readouterr().out
    assert "S-1: 4 layers side by side, 1 strip behind each other, each 60 × 30 mm stretched" in text
    assert "another pre-stretch than the 1.4" in text
    assert "the electrodes cover the whole length and width" in text
    assert ask(lab, *words, "--format", "csv") == 0
    both = capsys.readouterr()
    assert "another pre-stretch than the 1.4" in both.err
    rows = {row["quantity"]: row for row in csv.DictReader(io.StringIO(both.out))}
    assert f"{float(rows['force']['value']):.3f}" in text


def test_front_for_a_requirement_and_its_sheet(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ("--require", "force=200mN,stroke=0.5mm,bandwidth=5Hz", "--thickness-mm", "0.25,1", "--most-layers", "60")
    assert ask(lab, *words, "--most-strips", "60", "--format", "json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["asked"] == {"force_n": 0.2, "stroke_mm": 0.5, "frequency_hz": 5.0}
    assert found["unsafe"] > 0  # 0.25 mm at 7 kV is beyond breakdown
    best = min(found["front"], key=lambda d: d["films"])
    assert best["force_n_lower"] >= 0.2
    assert best["margin_lower"] >= 1
    built = [
        "--thickness-mm", repr(best["thickness_mm"]), "--voltage-kv", repr(best["voltage_kv"]), "--layers", str(best["layers"]),
        "--strips", str(best["strips"]), "--active-length-mm", "40", "--active-width-mm", "40",
    ]  # fmt: skip
    assert ask(lab, *built, "--format", "json") == 0
    sheet = {row["quantity"]: row for row in json.loads(capsys.readouterr().out)["sheet"]}
    assert sheet["force"]["value"] > best["force_n"] > 0.2  # blocked, against what is left at the stroke
    assert ask(lab, *words, "--voltage-kv", "0.2") == 0
    assert "no design of those searched meets it" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--require", "force=4kV"), "a number with a unit of N"),
        (("--require", "speed=4"), "each of force, stroke, bandwidth once"),
        (("--require", "force=-1N"), "above 0"),
        (("--require", "force=1N", "--layers", "3"), "they are what is searched"),
        (("--active-length-mm", "900"), "electrodes within the film"),
        (("--thickness-mm", "0.1,0.2"), "one thickness"),
    ],
)
def test_slips_get_one_line(lab: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...], said: str) -> None:
    assert ask(lab, *words) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_specimen_without_model_or_covariance_is_named(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["design", "nobody", "--lab", str(lab)]) == 2
    assert 'there is no model of "nobody"' in capsys.readouterr().err
    with duckdb.connect(str(lab / "results.duckdb")) as connection:
        kept = connection.execute("SELECT covariance FROM model_fits WHERE selected").fetchone()
        assert kept is not None
        connection.execute("UPDATE model_fits SET covariance = NULL WHERE selected")
    try:
        assert ask(lab) == 2
        assert "keeps no covariance" in capsys.readouterr().err
    finally:
        with duckdb.connect(str(lab / "results.duckdb")) as connection:
            connection.execute("UPDATE model_fits SET covariance = ? WHERE selected", kept)


def test_units_of_a_requirement() -> None:
    asked, left = parse_requirement("stroke = 200 µm, force=0.5")
    assert (asked.force_n, asked.stroke_mm, asked.frequency_hz) == (0.5, pytest.approx(0.2), 10.0)
    assert left == ("bandwidth 10 Hz",)
    with pytest.raises(UsageError, match="once"):
        parse_requirement("force=1,force=2")
