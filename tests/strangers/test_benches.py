"""What stands on benches: oscilloscopes with their own heads, and lists of lives as people keep them."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from ingest.answers import answered, draft_with, read_value, write_value
from ingest.draft import make_draft
from ingest.inspect import FITS, inspect
from ingest.mapping import FileMapping
from ingest.read import open_columns
from ingest.tables import LifetimeTable, lifetime_table
from pipeline import Lab
from pipeline.cli import main
from schemas.arrays import Float


def sweep(samples: int = 20_000, rate_hz: float = 1000.0) -> tuple[Float, Float, Float]:
    """Time, a swept voltage in V and the signal of a load cell in V."""
    time = np.arange(samples) / rate_hz - 1
    since = np.maximum(time, 0)
    phase = 2 * np.pi * 2 * (since + since**2)
    voltage = 2000 + 800 * np.sin(np.where(time > 0, phase, 0))
    return time, voltage, 1.2 - 2e-8 * voltage**2


def write_labelled(path: Path, labels: str = "HV monitor,Force amp") -> Path:
    head = [
        "Model,MSO24", "Waveform Type,ANALOG", "Horizontal Units,s", "Sample Interval,1.0E-3", "Probe Attenuation,1000,1",
        "Vertical Units,V,V", f"Label,{labels}", "", "TIME,CH1,CH2",
    ]  # fmt: skip
    rows = [f"{t:.4E},{v:.2f},{f:.5f}" for t, v, f in zip(*sweep(), strict=True)]
    path.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")
    return path


def test_the_labels_of_an_oscilloscope_say_what_its_channels_are(tmp_path: Path) -> None:
    draft = make_draft(write_labelled(tmp_path / "scope.csv"))
    assert draft.content["columns"]["voltage"] == {"column": "CH1", "unit": "V"}
    assert draft.content["columns"]["force"] == {"column": "CH2", "unit": "N", "scale": None}
    assert draft.content["time"] == {"column": "TIME", "unit": "s"}
    about = draft.content["recording"]
    assert (about["protocol"], about["loading"]) == ("chirp", "electrical")
    assert draft.questions[0].key == "columns.force.scale"


def test_other_labels_name_other_channels(tmp_path: Path) -> None:
    draft = make_draft(write_labelled(tmp_path / "scope.csv", "Force,Voltage out"))
    assert draft.content["columns"]["voltage"]["column"] == "CH2"
    assert draft.content["columns"]["force"]["column"] == "CH1"


def test_rows_that_end_with_a_delimiter_have_no_further_column(tmp_path: Path) -> None:
    time, voltage, force = sweep()
    names = ["CH1", "CH2"]
    head = [
        ",".join(["X", *names, "Start", "Increment", ""]),
        ",".join(["Second", "Volt", "Volt", "-1.0e+00", "1.0e-03"]),
    ]
    rows = [",".join(f"{x:.4e}" for x in row) + "," for row in zip(time, voltage / 1000, force, strict=True)]
    path = tmp_path / "New3.csv"
    path.write_text("\n".join([*head, *rows, ""]), encoding="utf-8")
    draft = make_draft(path)
    assert not draft.unread
    assert {c["column"] for c in draft.content["columns"].values()} == set(names)
    assert draft.content["recording"]["protocol"] == "chirp"


def test_of_a_date_an_hour_and_the_time_that_has_elapsed_the_last_is_the_time(tmp_path: Path) -> None:
    rows = [
        f"03/02/2026;14:{i // 60:02d}:{i % 60:02d};{i},5;{0.01 * i:.3f};{0.2 * i:.3f}".replace(".", ",")
        for i in range(60)
    ]
    path = tmp_path / "essai.csv"
    path.write_text(
        "\n".join(["Date;Heure;Temps écoulé;Déplacement;Charge", ";;s;mm;N", *rows, ""]), encoding="latin-1"
    )
    draft = make_draft(path)
    assert draft.content["time"] == {"column": "Temps écoulé", "unit": "s"}
    assert {c.column for c in draft.unmapped} == {"Date", "Heure"}


def test_a_text_that_only_begins_as_labview_does_is_a_table(tmp_path: Path) -> None:
    rows = [f"{i / 50:.3f},{2000 * (i % 400 > 200):.1f},{0.5 * (i % 400 > 200):.4f}" for i in range(2000)]
    path = tmp_path / "steps.csv"
    path.write_text(
        "\n".join(["LabVIEW Measurement", "Date,10/22/2026", "", "Time [s],Voltage [V],Stroke [mm]", *rows, ""])
    )
    draft = make_draft(path)
    assert draft.content["recording"]["protocol"] == "isotonic"
    assert set(draft.content["columns"]) == {"voltage", "displacement"}


LIVES = """Lives of batch 3;;;;;
No;Voltage [kV];Specimen;Time to breakdown [s];Failure site;Comment
1;4;A1;> 3600;-;ended
2;4;A2;357;clamp;
3;4;A3;3095;edge;
4;4;A4;812;middle;
;;;;;
5;5;A5;94;edge;
6;5;A6;260;-;stopped by hand
7;5;A7;119;middle;
8;5;A8;;;torn when mounted
;;max;3600;;
"""


@pytest.mark.long
def test_a_list_of_lives_with_rows_that_are_none_gives_the_right_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lives of batch 3.csv"
    path.write_text(LIVES, encoding="utf-8")
    assert main(["add", str(path), "--yes", "recording.configuration=batch 3"]) == 0
    assert "7 lives from 94 to 3600 s: 5 failed" in capsys.readouterr().out
    seen = inspect(path)
    assert seen.verdict == FITS, seen.as_text()
    assert main(["nightly", str(path), "--lab", str(tmp_path / "lab"), "--jobs", "0"]) == 0
    lab = Lab(tmp_path / "lab")
    (notes,) = lab.sql("SELECT notes FROM recordings")["notes"]
    assert "row without a life and without an outcome: left out as no tests (row 9)" in notes
    assert "row without a voltage and without an outcome: left out as no tests (row 10)" in notes
    rows = lab.sql("SELECT * FROM survival_summaries ORDER BY voltage_kv").to_dict("records")
    assert [(r["voltage_kv"], r["specimens"], r["failures"]) for r in rows] == [(4, 4, 3), (5, 3, 2)]
    (page,) = (tmp_path / "lab" / "reports" / "campaigns").glob("*.html")  # which Cox's model without limits broke
    assert "Survival" in page.read_text(encoding="utf-8")
    assert rows[0]["median_s"] == 812  # 1, 3/4, 1/2: of four with one survivor


def test_the_answers_that_are_proposed_can_be_typed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "lives.csv"
    path.write_text(LIVES, encoding="utf-8")
    assert main(["add", str(path)]) == 1
    assert "'columns.failed.failed_values=[clamp, edge, middle]'" in capsys.readouterr().err


def test_a_row_of_units_may_end_with_columns_that_have_none(tmp_path: Path) -> None:
    rows = [f"{20 * i};{0.001 * i:.4f};{0.02 * i:.3f};{i // 50};0" for i in range(200)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["Time;Load;Position;Cycle;Flag", "ms;kN;mm;;", *rows, ""]), encoding="utf-8")
    content = make_draft(path).content
    assert content["csv"]["unit_row"] is True
    assert content["time"]["unit"] == "ms"
    assert {name: c["unit"] for name, c in content["columns"].items()} == {"force": "kN", "displacement": "mm"}


MERGED = """Specimen;Voltage [kV];Time to breakdown [s];Outcome
A1;4;357;failed
;;450;failed
A3;4;3095;failed
;;3600;survived
A5;5;94;failed
A6;5;260;failed
;;781;
"""


def read_merged(path: Path, text: str, columns: str, constants: str = "") -> LifetimeTable:
    """Lives of a text with a mapping of its specimens, voltages and lives, and of more columns."""
    path.write_text(text, encoding="utf-8")
    toml = f"""
        kind = "lifetimes"
        [csv]
        delimiter = ";"
        [columns]
        specimen_id = {{column = "Specimen"}}
        voltage = {{column = "Voltage [kV]", unit = "kV"}}
        lifetime = {{column = "Time to breakdown [s]", unit = "s"}}
        {columns}
        [recording]
        recording_id = "lives"
        {constants}
    """
    mapping = FileMapping.parse(tomllib.loads(toml), stem=path.stem, suffix=path.suffix, source="lives.csv.toml")
    return lifetime_table(open_columns(path, "csv", mapping), mapping, stem=path.stem, where=path.name)


def test_rows_with_a_life_and_an_outcome_are_tests_whatever_else_is_empty(tmp_path: Path) -> None:
    outcome = 'failed = {column = "Outcome", failed_values = ["failed"], censored_values = ["survived"]}'
    table = read_merged(tmp_path / "lives.csv", MERGED, outcome)
    assert sorted(row.lifetime_s for row in table.rows) == [94, 260, 357, 450, 3095, 3600]
    assert any("left out as no tests (row 7)" in note for note in table.notes)


def test_a_survivor_without_a_specimen_lived_as_long_as_its_test_was_planned(tmp_path: Path) -> None:
    outcome = 'failed = {column = "Outcome", failed_values = ["failed"], censored_values = ["survived"]}'
    text = MERGED.replace(";;3600;survived", ";;;survived")
    table = read_merged(tmp_path / "lives.csv", text, outcome, "test_duration_s = 7200")
    assert sorted(row.lifetime_s for row in table.rows if not row.failed) == [7200]


def test_a_blank_that_means_survived_and_a_bound_are_outcomes(tmp_path: Path) -> None:
    blank = 'failed = {column = "Outcome", failed_values = ["failed"], censored_values = ["survived", ""]}'
    table = read_merged(tmp_path / "blank.csv", MERGED + ";;;\n", blank)
    assert sorted(row.lifetime_s for row in table.rows if not row.failed) == [781, 3600]
    bounds = "\n".join(line.rsplit(";", 1)[0] for line in MERGED.replace(";3600", ";> 3600").splitlines())
    table = read_merged(tmp_path / "bounds.csv", bounds, "")
    assert [row.lifetime_s for row in table.rows if not row.failed] == [3600]


PLACES = [f"place {i}" for i in range(10)]


def write_places(path: Path, places: list[str]) -> Path:
    rows = [f"S{i};{100 + 7 * i};{place}" for i, place in enumerate(places)]
    path.write_text("\n".join(["Specimen;Life [s];Failure site", *rows, ""]), encoding="utf-8")
    return path


def test_a_dash_after_many_places_of_failure_is_a_survivor(tmp_path: Path) -> None:
    failed = make_draft(write_places(tmp_path / "lives.csv", [*PLACES, "-"])).content["columns"]["failed"]
    assert (failed["failed_values"], failed["censored_values"]) == (PLACES, ["-"])


@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        ({"failed.failed_values": "[edge, rod]"}, (["edge", "rod"], ["-", "middle"])),
        ({"failed.censored_values": "[rod, -]"}, (["edge", "middle"], ["rod", "-"])),
        ({"failed.left_censored_values": "[rod]"}, (["edge", "middle"], ["-"])),
        ({"failed.failed_values": "[rod]", "failed.censored_values": "[-]"}, (["rod"], ["-"])),
    ],
)
def test_an_answer_about_outcomes_leaves_each_value_in_one_list(
    tmp_path: Path, answer: dict[str, str], expected: tuple[list[str], list[str]]
) -> None:
    draft = answered(*draft_with(write_places(tmp_path / "lives.csv", ["edge", "rod", "middle", "-"]), answer))
    failed = draft.content["columns"]["failed"]
    assert (failed["failed_values"], failed["censored_values"]) == expected


def test_what_is_proposed_is_read_back_as_it_was() -> None:
    values = ["edge, left", "rod", 'a "b", c', "1", 2, "it's", "[x]", "true"]
    assert read_value(write_value(values)) == values
    assert write_value(["clamp", "edge, left"]) == '[clamp, "edge, left"]'


@pytest.mark.parametrize(("header", "offset"), [("Strain", 1.0), ("Strain [µε]", 1e6), ("Strain [%]", 100.0)])
def test_strain_in_any_unit_or_none_counts_from_0(tmp_path: Path, header: str, offset: float) -> None:
    rows = [f"{i / 10};{min(i / 100, 0.2) * offset:.5f};{3 + np.exp(-i / 90):.4f}" for i in range(300)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join([f"Time [s];{header};Stress [kPa]", *rows, ""]), encoding="utf-8")
    assert make_draft(path).content["columns"]["stretch"]["offset"] == offset
    draft = answered(*draft_with(path, {"stretch.unit": "%"}))
    assert (draft.content["columns"]["stretch"]["unit"], draft.content["columns"]["stretch"]["offset"]) == ("%", 100.0)
