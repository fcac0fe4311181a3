"""Files that hold more than one test, or a test and other channels: what each is told, and what is asked."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ingest.answers import answered, draft_with
from ingest.canonical import canonical
from ingest.draft import make_draft
from ingest.mapping import FileMapping
from ingest.parts import list_parts, part_of
from ingest.read import read_raw
from ingest.shapes import SURE
from schemas.errors import RefusedError


def write_pulls(path: Path, sizes: list[tuple[str, float]]) -> Path:
    """Pulls of several specimens one below the other, each below its own sizes."""
    lines = ['"Raw data export"', '"Test Date","2024-04-29 10:00:00"', ""]
    for name, thickness in sizes:
        lines += [
            f'"Specimen","{name}"',
            '"Width","12.7","mm"',
            f'"Thickness","{thickness}","mm"',
            '"Gage Length","25","mm"',
        ]
        lines += ['"Time","Crosshead","Load"', '"(s)","(mm)","(N)"']
        t = np.arange(0, 20, 0.1)
        force = np.where(t < 18, 2 * np.sqrt(t), 0.002)
        lines += [f"{a:.3f},{b:.5f},{c:.5f}" for a, b, c in zip(t, 4 * t, force, strict=True)] + [""]
    path.write_text("\n".join(lines))
    return path


def test_each_of_several_runs_has_the_sizes_above_it(tmp_path: Path) -> None:
    """All had those of the first, and one specimen's name, without a word."""
    path = write_pulls(tmp_path / "lot.txt", [("1", 1.0), ("2", 1.1), ("3", 0.9)])
    content = tomllib.loads(make_draft(path).as_toml())
    assert content["recording"]["film_width_mm"] == 12.7
    own = [entry["recording"] for entry in content["select"]]
    assert [o["film_thickness_mm"] for o in own] == [1.0, 1.1, 0.9]
    # a bare number is in every file: the file's own name stands before it
    assert [o["specimen_id"] for o in own] == ["{stem}-1", "{stem}-2", "{stem}-3"]
    assert "film_width_mm" not in own[1]


def test_a_table_of_oscillations_is_no_relaxation(tmp_path: Path) -> None:
    """Magnitude and phase of a sweep have times as well, at which they were measured."""
    path = tmp_path / "sweep.csv"
    rows = [f"{10 * i},{20 / 1.4**i:.5g},{1e7 / (1 + i):.5g},{25 + i},5.0" for i in range(12)]
    head = '"Time (s)","Frequency(Hz)","Complex shear modulus(Pa)","Phase angle(°)","Temperature(°C)"'
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    content = make_draft(path).content
    assert content["kind"] == "frequency_response"
    assert set(content["columns"]) >= {"frequency", "magnitude", "phase"}
    only = tmp_path / "odd.csv"
    only.write_text(
        "\n".join(["Time (s),Frequency (Hz),Dyn. modulus x (Pa)", *[f"{i},{9 - i},{1e6 + i}" for i in range(8)]]) + "\n"
    )
    assert make_draft(only).content["kind"] != "relaxation"


def write_logger(path: Path) -> Path:
    t = np.arange(0, 30, 0.02)
    volts = np.where((t % 10) > 5, np.floor(t / 10) + 1.0, 0.0)
    cell = 2.0 - 0.02 * volts**2 + 0.001 * np.sin(37 * t)
    rows = [f"{a:.3f},{b:.4f},{c:.5f}" for a, b, c in zip(t, volts, cell, strict=True)]
    path.write_text("\n".join(["Time (s),Voltage_0 (V),Voltage_1 (V)", *rows]) + "\n")
    return path


def test_other_channels_beside_a_voltage_are_asked(tmp_path: Path) -> None:
    """A load cell's volts were left out, and the test was surely one of lifetime."""
    path = write_logger(tmp_path / "stairs.csv")
    draft = make_draft(path)
    asked = next(q for q in draft.questions if q.key == "Voltage_1 (V)")
    assert asked.suggestion is None
    scale = next(q for q in draft.questions if q.key == "columns.voltage.scale")
    assert scale.text.endswith("(value in kV = scale × value in V + offset)")
    assert asked.choices == ("force", "displacement", "capacitance", "leakage_current", "nothing")
    assert draft.shape is not None
    assert draft.shape.certainty != SURE


@pytest.mark.parametrize(("what", "protocol"), [("force", "step"), ("nothing", "lifetime")])
def test_an_answer_says_what_a_channel_is(tmp_path: Path, what: str, protocol: str) -> None:
    path = write_logger(tmp_path / "stairs.csv")
    scales = {"columns.voltage.scale": "1"} | ({"columns.force.scale": "0.4"} if what == "force" else {})
    draft, placed = draft_with(path, {"Voltage_1 (V)": what, **scales})
    draft = answered(draft, placed)
    assert not [q for q in draft.questions if q.key == "Voltage_1 (V)"]
    assert draft.content["recording"]["protocol"] == protocol


def write_side_by_side(path: Path, lengths: tuple[int, int]) -> Path:
    """Relaxations of two specimens in columns of the same names, the second one shorter."""
    t = np.arange(max(lengths)) * 0.05
    moved = np.clip((t - 1) / 0.5, 0, 1) * 5
    lines = [
        '"Prüfdatum";"05.06.2024 10:11:12"',
        '"1 _ 1";"";"";"1 _ 2";"";""',
        '"Zeit";"Kraft";"Hub";"Zeit";"Kraft";"Hub"',
        '"s";"N";"mm";"s";"N";"mm"',
    ]
    for i in range(t.size):
        cells = []
        for number, length in enumerate(lengths):
            force = (0.1 + 0.05 * number) * moved[i] * (1 + 0.5 * np.exp(-t[i] / 5))
            here = (t[i], force, moved[i]) if i < length else ("", "", "")
            cells += [f"{v:.5f}".replace(".", ",") if v != "" else "" for v in here]
        lines.append(";".join(f'"{cell}"' for cell in cells))
    path.write_text("\r\n".join(lines) + "\r\n", encoding="cp1252")
    return path


def test_specimens_side_by_side_are_recordings_each(tmp_path: Path) -> None:
    """The second one was columns that are not mapped."""
    path = write_side_by_side(tmp_path / "zwei.csv", (400, 300))
    draft = make_draft(path)
    assert not draft.unmapped
    assert "recording.specimen_id" not in [q.key for q in draft.questions]
    content = tomllib.loads(draft.as_toml())
    content["time"]["zone"] = "Europe/Berlin"
    mapping = FileMapping.parse(content, stem=path.stem, suffix=path.suffix)
    assert list_parts(path, mapping) == ("specimen-1", "specimen-2")
    one, two = (
        canonical(read_raw(path, part_of(mapping, label)), where=path.name) for label in list_parts(path, mapping)
    )
    assert (one.metadata.specimen_id, two.metadata.specimen_id) == ("zwei-1", "zwei-2")
    assert (one.channels["force"].values.size, two.channels["force"].values.size) == (400, 300)
    assert two.channels["force"].values[-1] == pytest.approx(1.5 * one.channels["force"].values[299], rel=1e-3)


@pytest.mark.parametrize(
    ("own", "said"),
    [
        ({"columns": {"force": {"column": 4}}}, "columns without part"),
        ({"part": "b", "columns": {"pressure": {"column": 4}}}, "select.columns.pressure"),
        ({"part": "b", "columns": {"force": {"colum": 4}}}, "colum"),
        ({"part": "b", "time": {"colum": 3}}, "colum"),
    ],
)
def test_columns_of_a_part_that_are_none_are_refused(own: dict[str, Any], said: str) -> None:
    content = {
        "time": {"column": 0, "unit": "s"},
        "columns": {"force": {"column": 1, "unit": "N"}, "displacement": {"column": 2, "unit": "mm"}},
        "recording": {
            "recording_id": "a-{each}",
            "protocol": "step",
            "loading": "mechanical",
            "started_at": "2024-06-05T10:00:00Z",
        },
        "select": [{"first_row": 0, **own}],
    }
    with pytest.raises(RefusedError, match=said):
        FileMapping.parse(content, stem="a", suffix=".csv")


def write_graphtec(path: Path) -> Path:
    """A logger that lists its channels, repeats units under their names, and writes times in whole seconds."""
    t = np.arange(0, 120, 0.1)
    kv = 5 * (1 - np.abs(1 - (t % 40) / 20))
    laser = 3.0 - 0.0113 * kv**2 + 2e-4 * np.sin(11 * t)
    head = [
        '"Vendor","GRAPHTEC Corporation"', '"Sampling interval","100ms"', '"Start time","2024/10/08 11:17:05"',
        '"CH","Signal name","Input","Range"', '"CH1","ILD","DC","10V"', '"CH2","HVMON","DC","10V"', '"Data"',
        '"Number","Date&Time","ms","CH1","CH2","AlarmOut"', '"NO.","Time","ms","V","V","A1234"',
    ]  # fmt: skip
    rows = [
        f'{i + 1},"2024/10/08 11:{17 + int(s + 5) // 60:02d}:{int(s + 5) % 60:02d}",{round(10 * s) % 10 * 100:03d},+  {a:.4f},+  {b / 2:.4f},"LLLL"'
        for i, (s, a, b) in enumerate(zip(t, laser, kv, strict=True))
    ]
    path.write_text("\n".join([*head, *rows]) + "\n")
    return path


def test_a_logger_says_its_channels_and_its_rate_above_the_table(tmp_path: Path) -> None:
    """Its row of units was taken for names, the list of channels for samples, and times in whole seconds for instants."""
    path = write_graphtec(tmp_path / "log.csv")
    draft, placed = draft_with(
        path, {"CH1": "displacement", "columns.displacement.scale": "-2", "columns.voltage.scale": "2"}
    )
    content = dict(answered(draft, placed).content)
    assert content["csv"]["unit_row"] is True
    assert content["time"] == {"sample_rate_hz": 10.0, "zone": "UTC"}
    assert content["columns"]["voltage"]["column"] == "CH2"  # by its signal's name
    assert content["columns"]["displacement"]["column"] == "CH1"
    assert content["recording"]["protocol"] == "isotonic"
    raw = read_raw(path, FileMapping.parse(content, stem=path.stem, suffix=path.suffix))
    found = canonical(raw, where=path.name)
    assert found.channels["voltage"].values.size == 1200
    assert found.channels["voltage"].values.max() == pytest.approx(5.0, abs=0.03)
