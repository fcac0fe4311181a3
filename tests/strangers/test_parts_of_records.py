"""One record of a testing machine that holds a relaxation and cycles: where it is cut, its mapping, and the night over it."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from ingest.draft import make_draft
from ingest.faults import find_faults, list_static_faults
from ingest.mapping import FileMapping
from ingest.parts import list_parts, part_of
from ingest.read import read_raw
from ingest.segments import find_segments
from ingest.validate import validate
from pipeline.cli import main
from schemas.arrays import Float
from schemas.recording import RawRecording

STEP_S = 0.1
REST, HOLD, BACK = np.zeros(50), np.full(6000, 8.0), np.linspace(8, 0, 30)
RAMP = np.linspace(0, 8, 30)


def triangles(low: float, high: float, count: int, period_s: float = 20.0) -> Float:
    phase = np.arange(0, count * period_s + STEP_S / 2, STEP_S) / period_s % 1
    return low + (high - low) * (1 - np.abs(2 * phase - 1))


def record(*pieces: Float) -> tuple[Float, Float]:
    moved = np.concatenate(pieces)
    return np.arange(moved.size) * STEP_S, moved + np.random.default_rng(3).normal(0, 1e-3, moved.size)


@pytest.mark.parametrize(
    ("pieces", "expected"),
    [
        ((REST, RAMP, HOLD, BACK, triangles(0, 10, 3)), [(0, 6080, True), (6110, 6710, False)]),
        ((REST, RAMP, HOLD, BACK, np.zeros(3000), triangles(0, 10, 3)), [(0, 6080, True), (9110, 9710, False)]),
        ((RAMP, HOLD, triangles(8, 12, 4)), [(0, 6030, True), (6030, 6830, False)]),
        ((triangles(0, 10, 3), RAMP, HOLD), [(0, 601, False), (601, 6630, True)]),
        ((triangles(0, 10, 3), np.zeros(3000), RAMP, HOLD), [(0, 600, False), (600, 9630, True)]),
        ((-REST, -RAMP, -HOLD, -BACK, -triangles(0, 10, 3)), [(0, 6080, True), (6110, 6710, False)]),
        ((RAMP, HOLD, BACK, np.zeros(3000), triangles(0, 10, 1, 200.0)), [(0, 6030, True), (9060, 11060, False)]),
        ((RAMP, HOLD, BACK, np.zeros(3000), np.linspace(0, 16, 60), 2 * HOLD), [(0, 6030, True), (6060, 15120, True)]),
    ],
)
def test_a_record_is_cut_between_its_tests(pieces: Sequence[Float], expected: list[tuple[int, int, bool]]) -> None:
    found = find_segments(*record(*pieces))
    assert [s.is_hold for s in found] == [is_hold for *_, is_hold in expected]
    for segment, (first, last, _) in zip(found, expected, strict=True):
        assert abs(segment.first - first) <= 3
        assert abs(segment.last - last) <= 3


@pytest.mark.parametrize(
    "pieces",
    [
        (REST, RAMP, HOLD, BACK),
        (triangles(0, 10, 5),),
        (triangles(0, 10, 1, 400.0),),
        (REST, RAMP, HOLD, np.linspace(8, 16, 30), np.full(6000, 16.0)),
        (8 + 2 * np.sin(np.arange(9000) * 0.01),),
        (np.random.default_rng(4).normal(size=9000),),
    ],
)
def test_a_record_of_one_test_stays_whole(pieces: Sequence[Float]) -> None:
    assert find_segments(*record(*pieces)) == ()


def test_long_records_are_cut_at_the_same_places() -> None:
    time_s, moved = record(REST, RAMP, HOLD, BACK, triangles(0, 10, 3))
    fine = np.linspace(0, time_s[-1], 150_001)
    found = find_segments(fine, np.interp(fine, time_s, moved))
    assert [(round(fine[s.first]), round(fine[s.last])) for s in found] == [(0, 608), (611, 671)]
    assert found[-1].last == fine.size - 1


def write_record(path: Path, *, restarts: bool = False) -> Path:
    """A strip of 0.1 N/mm that relaxes by half, and loses a tenth in each cycle; German numbers, two blocks 900 s apart."""
    hold = np.concatenate([REST[:20], RAMP, HOLD])
    cycles = triangles(0, 5, 3)
    t = np.concatenate([np.arange(hold.size), (0 if restarts else hold.size + 9000) + np.arange(cycles.size)]) * STEP_S
    since = np.maximum(t[: hold.size] - 2.0, 0)
    force = np.concatenate(
        [0.05 * hold * (1 + np.exp(-since / 60)), 0.1 * cycles + 0.02 * np.sign(np.gradient(cycles))]
    )
    rows = [
        f"{a:.1f};{b:.4f};{c:.5f}".replace(".", ",")
        for a, b, c in zip(t, np.concatenate([hold, cycles]), force, strict=True)
    ]
    head = ["Probe: S-1", "12.03.2026 14:05:10", "Zeit;Weg;Kraft", "s;mm;N"]
    path.write_text("\n".join([*head, *rows, "Ende der Daten", ""]), encoding="utf-8")
    return path


@pytest.mark.parametrize("restarts", [False, True])
def test_a_relaxation_and_cycles_in_one_file_become_two_recordings(tmp_path: Path, restarts: bool) -> None:
    path = write_record(tmp_path / "strip.csv", restarts=restarts)
    draft = make_draft(path)
    assert [entry["part"] for entry in draft.content["select"]] == ["relaxation", "cycles"]
    ranges = [set(entry) - {"part", "recording", "column"} for entry in draft.content["select"]]
    assert ranges == ([{"last_row"}, {"first_row"}] if restarts else [{"at_most"}, {"at_least"}])
    assert draft.content["recording"]["started_at"] == "2026-03-12T14:05:10"
    content = tomllib.loads(draft.as_toml())
    assert find_faults(path, content) == ()
    mapping = FileMapping.parse(content, stem="strip", suffix=".csv")
    assert list_parts(path, mapping) == ("relaxation", "cycles")
    read = [read_raw(path, part_of(mapping, label)) for label in ("relaxation", "cycles")]
    for raw, name, protocol, rows in zip(read, ("relaxation", "cycles"), ("step", "cycle"), (6050, 601), strict=True):
        assert isinstance(raw, RawRecording)
        assert (raw.metadata["recording_id"], raw.metadata["protocol"]) == (f"strip-{name}", protocol)
        assert {channel.values.size for channel in raw.channels} == {rows}
        assert raw.problems == ()
        assert any("Ende der Daten" in note for note in raw.notes)
    if not restarts:
        assert isinstance(read[1], RawRecording)
        assert read[1].metadata["started_at"] == "2026-03-12T14:30:15.000000Z"


def test_add_shows_both_and_a_protocol_that_is_said_makes_one_of_them(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_record(tmp_path / "strip.csv")
    assert main(["add", str(path), "--yes", "zone=UTC"]) == 0
    told = capsys.readouterr().out
    assert "2 tests in one record" in told
    assert "relaxation: strip-relaxation" in told
    assert "cycles: strip-cycles" in told
    assert "a relaxation fit" in told
    assert "hysteresis" in told
    mapping = path.with_name("strip.csv.toml")
    assert validate(mapping).faults == ()
    assert validate(path).faults == ()
    assert main(["add", str(path), "--replace", "--yes", "zone=UTC", "protocol=step"]) == 0
    content = tomllib.loads(mapping.read_text(encoding="utf-8"))
    assert "select" not in content
    assert content["recording"]["recording_id"] == "{stem}"


@pytest.mark.parametrize(
    ("select", "said"),
    [
        ([{"part": "a", "column": "t"}], "lacks column or equals"),
        ([{"part": "a", "column": "t", "each": True}], "part and each"),
        ([{"column": "t", "equals": 1, "recording": {"protocol": "cycle"}}], "recording without part"),
        ([{"part": "a", "column": "t", "first_row": 1}], "column and first_row"),
        ([{"part": "a", "first_row": 1, "at_most": 2}], "first_row"),
        ([{"part": "a", "first_row": 1}, {"column": "t", "each": True}], "each and part"),
        ([{"part": "a", "first_row": 1, "recording": {"protocol": "nonsense"}}], "nonsense"),
    ],
)
def test_parts_that_cannot_be_are_named(select: list[dict[str, object]], said: str) -> None:
    content = {
        "time": {"column": "t", "unit": "s"},
        "columns": {"displacement": {"column": "x", "unit": "mm"}, "force": {"column": "F", "unit": "N"}},
        "recording": {"recording_id": "r-{each}", "protocol": "step", "loading": "mechanical", "specimen_id": "s"},
        "select": select,
    }
    assert said in "; ".join(map(str, list_static_faults(content, stem="r", suffix=".csv")))


def test_rows_beyond_the_file_are_refused(tmp_path: Path) -> None:
    path = write_record(tmp_path / "strip.csv")
    content = tomllib.loads(make_draft(path).as_toml())
    content["select"] = [{"part": "late", "first_row": 90_000}]
    assert any("90000" in str(fault) for fault in find_faults(path, content))


def test_what_stands_below_a_table_is_no_damage_and_the_way_comes_before_the_machines_position(tmp_path: Path) -> None:
    rows = [f"{0.1 * i:.1f};{212.5 + i % 40};{i % 40};{0.1 * (i % 40):.2f}".replace(".", ",") for i in range(200)]
    head = ["Einspannlänge;50,0;mm", "Probenbreite b0;20,0;mm", "Probendicke a0;1,0;mm", "Datum;12.03.2026"]
    head += ["Prüfzeit;Traverse absolut;Standardweg;Standardkraft", "s;mm;mm;N"]
    foot = ["", "Statistik;n = 1", "Fmax;3,9;N", "Anzahl Messwerte;200", ""]
    path = tmp_path / "strip.TRA"
    path.write_text("\n".join([*head, *rows, *foot]), encoding="utf-8")
    draft = make_draft(path)
    assert draft.content["columns"]["displacement"]["column"] == "Standardweg"
    content = tomllib.loads(draft.as_toml().replace('= "?"', "= 1.0"))
    content.setdefault("time", {})["zone"] = "UTC"
    raw = read_raw(path, FileMapping.parse(content, stem="strip", suffix=".TRA"))
    assert isinstance(raw, RawRecording)
    assert raw.problems == ()
    assert {channel.values.size for channel in raw.channels} == {200}
    assert any("Statistik" in note for note in raw.notes)
    path.write_text("\n".join([*head, *rows, rows[0][:6]]), encoding="utf-8")
    raw = read_raw(path, FileMapping.parse(content, stem="strip", suffix=".TRA"))
    assert isinstance(raw, RawRecording)
    assert any("left out" in problem for problem in raw.problems)


@pytest.mark.long
def test_a_folder_is_added_with_what_is_new_in_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    deeper = tmp_path / "raw" / "day 1"
    deeper.mkdir(parents=True)
    first, second = write_record(tmp_path / "raw" / "a.csv"), write_record(deeper / "b.TRA")
    (deeper / "scan.png").write_bytes(b"\x89PNG\r\n\x1a\n\x00\x00")
    (deeper / "film.txt").write_text("film 3 slipped once\n", encoding="utf-8")
    assert main(["add", str(tmp_path / "raw"), "--yes", "zone=UTC"]) == 0
    told = capsys.readouterr()
    assert told.out.count("Written:") == 2
    assert "film.txt: passed over" in told.err
    written = [path.with_name(path.name + ".toml").read_bytes() for path in (first, second)]
    assert main(["add", str(tmp_path / "raw"), "--yes", "zone=Europe/Berlin"]) == 0  # what has a mapping stays as it is
    assert written == [path.with_name(path.name + ".toml").read_bytes() for path in (first, second)]
