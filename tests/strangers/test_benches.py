"""What stands on benches: oscilloscopes with their own heads, and lists of lives as people keep them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from ingest.draft import make_draft
from ingest.inspect import FITS, inspect
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
    assert rows[0]["median_s"] == 812  # 1, 3/4, 1/2: of four with one survivor


def test_the_answers_that_are_proposed_can_be_typed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "lives.csv"
    path.write_text(LIVES, encoding="utf-8")
    assert main(["add", str(path)]) == 1
    assert "'columns.failed.failed_values=[clamp, edge, middle]'" in capsys.readouterr().err
