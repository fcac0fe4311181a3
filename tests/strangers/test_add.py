"""`dealab add`: what is harvested, inferred, asked and written; and that all that is wrong is said at once."""

from __future__ import annotations

import io
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from ingest.answers import _split_sizes, answered, as_suggested, draft_with, read_value, split_answers
from ingest.draft import make_draft
from ingest.encodings import guess_encoding
from ingest.faults import find_faults
from ingest.harvest import harvest_lines
from ingest.inspect import FITS, inspect
from ingest.repeats import find_repeated_heads
from ingest.shapes import Trace, find_shape
from pipeline.cli import main
from pipeline.commands import add
from schemas.errors import UsageError
from tests.strangers import drafts

GERMAN = [
    '"Prüfer";"Müller"',
    '"Probe";"EL-03"',
    '"Datum / Uhrzeit";"12.03.2026 14:05:10"',
    '"L0";"50,00";"mm"',
    '"b0";"20,00";"mm"',
    '"a0";"0,20";"mm"',
    '"Prüfzeit";"Traversenweg";"Standardkraft"',
    '"s";"mm";"N"',
]


def write_relaxation(path: Path) -> Path:
    t = np.arange(0, 60, 0.1)
    x = np.minimum(t * 5, 10.0)
    f = 0.03 * x * (1 + 0.5 * np.exp(-t / 10))
    rows = [f"{a:.1f};{b:.3f};{c:.5f}".replace(".", ",") for a, b, c in zip(t, x, f, strict=True)]
    path.write_bytes("\n".join([*GERMAN, *rows, ""]).encode("cp1252"))
    return path


def test_what_a_german_machine_says_is_harvested_and_its_test_recognised(tmp_path: Path) -> None:
    draft = make_draft(write_relaxation(tmp_path / "run.csv"))
    about = draft.content["recording"]
    assert {k: about[k] for k in ("protocol", "loading", "specimen_id", "operator")} == {
        "protocol": "step",
        "loading": "mechanical",
        "specimen_id": "EL-03",
        "operator": "Müller",
    }
    assert (about["film_length_mm"], about["film_width_mm"], about["film_thickness_mm"]) == (50.0, 20.0, 0.2)
    assert about["started_at"] == "2026-03-12T14:05:10"
    assert draft.content["csv"]["encoding"] == "cp1252"
    assert [q.key for q in draft.questions] == ["time.zone"]


def test_add_writes_what_the_night_reads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_relaxation(tmp_path / "run.csv")
    assert main(["add", str(path), "--yes", "zone=Europe/Berlin"]) == 0
    assert "a relaxation fit of order 1 to 3" in capsys.readouterr().out
    assert inspect(path).verdict == FITS, inspect(path).as_text()
    with pytest.raises(UsageError, match="mapping already"):
        add.add_file(path, _arguments())
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.csv", "run.csv.toml"]


class _arguments:
    yes: list[str] | None = None
    replace = False
    rigs = None
    file: tuple[Path, ...] = ()


def test_questions_are_all_told_where_nobody_can_be_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    path = tmp_path / "volts.csv"
    rows = [f"{i / 10},{min(i / 10, 5.0)},{min(i / 10, 5.0) * 0.4:.4f}" for i in range(300)]
    path.write_text("\n".join(["t,way,cell_V", *rows, ""]))
    assert main(["add", str(path)]) == 1
    said = capsys.readouterr().err
    asked = ("time.unit", "columns.displacement.unit", "columns.force.scale", "recording.specimen_id")
    assert all(f"asks       {key}" in said for key in asked)
    assert "lacks      no modulus: film_length_mm, film_width_mm, film_thickness_mm missing" in said
    assert not (tmp_path / "volts.csv.toml").exists()
    assert main(["add", str(path), "--yes", "specimen_id=X"]) == 1
    assert "force.scale" in capsys.readouterr().err
    assert main(["add", str(path), "--yes", "force.scale=0.4", "film_sizes_mm=50x20x1", "specimen_id=X"]) == 0
    written = tomllib.loads((tmp_path / "volts.csv.toml").read_text(encoding="utf-8"))
    assert written["columns"]["force"] == {"column": "cell_V", "unit": "N", "scale": 0.4}
    assert written["recording"]["film_width_mm"] == 20


def test_answers_in_a_terminal_and_suggestions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_relaxation(tmp_path / "run.csv")

    monkeypatch.setattr("sys.stdin", Terminal())
    asked: list[str] = []

    def ask(text: str) -> str:
        asked.append(text)
        return "Europe/Zurich" if "zone" in text else ""

    assert add.add_file(path, _arguments(), ask) == 0
    assert "time zone" in asked[0]
    assert [text.split(":")[0].strip() for text in asked[1:]] == ["rig_id", "stretch_1"]
    assert 'zone = "Europe/Zurich"' in (tmp_path / "run.csv.toml").read_text(encoding="utf-8")
    draft, taken = as_suggested(make_draft(path))
    assert not draft.questions
    assert [q.key for q in taken] == ["time.zone"]
    assert "assumed" in draft.as_toml()


def test_keys_that_do_not_exist_are_told_together(tmp_path: Path) -> None:
    path = write_relaxation(tmp_path / "run.csv")
    with pytest.raises(UsageError) as wrong:
        draft_with(path, {"specimen": "X", "protocl": "step", "Traversenweg": "displacment"})
    assert str(wrong.value).count("did you mean") == 3
    with pytest.raises(UsageError, match="no answer"):
        split_answers(["force"])
    assert [read_value(t) for t in ("3", "0.4", "true", "[1, b]", "P-07")] == [3, 0.4, True, [1, "b"], "P-07"]


def test_a_person_says_what_channels_of_a_scope_are(tmp_path: Path) -> None:
    t = np.arange(0, 10, 0.01)
    levels = np.where((t % 2) > 1, 1.0, 0.0)
    rows = [f"{a:.2f},{b:.1f},{0.5 - 0.1 * b:.3f}" for a, b in zip(t, levels, strict=True)]
    path = tmp_path / "scope.csv"
    path.write_text("\n".join(["x-axis,CH1,CH2", "second,Volt,Volt", *rows, ""]))
    draft, _ = draft_with(path, {"CH1": "voltage", "CH2": "force"})
    columns = draft.content["columns"]
    assert columns["voltage"] == {"column": "CH1", "unit": "kV", "scale": None, "overrule_unit": True}
    assert {"columns.voltage.scale", "columns.force.scale"} <= {q.key for q in draft.questions}
    done = answered(draft, {"columns.voltage.scale": 6.0, "columns.force.scale": 2.0})
    assert (done.content["recording"]["protocol"], done.content["recording"]["loading"]) == ("step", "electrical")


def test_all_that_is_wrong_is_said_at_once(tmp_path: Path) -> None:
    path = write_relaxation(tmp_path / "run.csv")
    content = dict(make_draft(path).content)
    content["recording"] = {**content["recording"], "film_width_mm": -1, "stretch_1": "wide", "protocol": "stepp"}
    content["columns"] = {**content["columns"], "forse": {"column": "x"}}
    content["csv"] = {**content["csv"], "delimitr": ";"}
    said = " | ".join(str(fault) for fault in find_faults(path, content, source="run.csv.toml"))
    for word in ("film_width_mm", "stretch_1", "protocol", "columns.forse", "csv.delimitr"):
        assert word in said
    assert find_faults(path, {**make_draft(path).content, "time": {"column": "nowhere", "zone": "UTC"}})


def test_the_draft_sent_to_its_own_file_is_a_mapping(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_relaxation(tmp_path / "run.csv")
    with (tmp_path / "run.csv.toml").open("w", encoding="utf-8") as output:
        monkeypatch.setattr("sys.stdout", output)
        main(["inspect", str(path)])
    monkeypatch.undo()
    assert tomllib.loads((tmp_path / "run.csv.toml").read_text(encoding="utf-8"))["kind"] == "recording"
    assert inspect(path).verdict == FITS, inspect(path).as_text()


def _trace(values: np.ndarray, rate: float = 100.0) -> Trace:
    return Trace(np.arange(values.size) / rate, values + 1e-4 * np.random.default_rng(1).standard_normal(values.size))


T = np.arange(0, 20, 0.01)
SHAPES = {
    "step": np.minimum(T * 10, 5.0),
    "cycle": 10 - np.abs(T - 10),
    "cyclic": np.sin(2 * np.pi * 1.3 * T),
    "chirp": np.sin(2 * np.pi * (0.5 * T + 0.3 * T**2)),
}


@pytest.mark.parametrize("protocol", SHAPES)
def test_tests_are_recognised_by_their_shape(protocol: str) -> None:
    found = find_shape({"displacement": _trace(SHAPES[protocol]), "force": _trace(0.1 * SHAPES[protocol])})
    assert (found.protocol, found.loading) == (protocol, "mechanical"), found
    assert found.seen


def test_electrical_tests_are_recognised() -> None:
    on_off = np.where((T % 4) > 2, 6.0, 0.0)
    steps = find_shape({"voltage": _trace(on_off), "force": _trace(1 - 0.01 * on_off)})
    assert (steps.protocol, steps.constants["drive_kv"], steps.constants["on_s"]) == (
        "step",
        6.0,
        pytest.approx(2.0, abs=0.02),
    )
    life = find_shape({"voltage": _trace(np.minimum(T * 5, 7.0)), "leakage_current": _trace(0 * T)})
    assert (life.protocol, life.constants["voltage_setpoint_kv"]) == ("lifetime", 7.0)


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("Prüfzeit;Weg;Kraft", "cp1252"),
        ("时间(s),位移(mm),力(N)", "gbk"),
        ("荷重(N),変位(mm)", "cp932"),
        ("Weg [µm]", "cp1252"),
    ],
)
def test_encodings(text: str, encoding: str) -> None:
    assert guess_encoding(text.encode(encoding)) == encoding


def test_lines_above_a_table() -> None:
    lines = ["Sample Interval,5.0E-03,s", "Width: 1 in", "Date,03/04/2026", "Einspannlänge;50;mm", "Comment: 7 mm long"]
    found = {fact.key: fact.value for fact in harvest_lines(lines)}
    assert found == {"sample_rate_hz": 200.0, "film_width_mm": 25.4, "film_length_mm": 50.0}


@pytest.mark.long
@pytest.mark.slow
def test_drafts_of_our_own_files_of_strangers() -> None:
    """What is asked of drafts: protocols right of nine in ten files, no unit wrong, no column lost."""
    judged = [found for folder in drafts.OWN for case in sorted(folder.iterdir()) for found in drafts.judge(case)]
    assert len(judged) >= 40
    assert not [(j.name, j.wrong_units, j.lost) for j in judged if j.wrong_units or j.lost]
    wrong = [(j.name, j.wrong) for j in judged if not j.protocol]
    assert len(wrong) <= 1, wrong


def test_a_text_with_the_ending_of_its_machine_is_read_as_text(tmp_path: Path) -> None:
    path = write_relaxation(tmp_path / "EL-03 Relaxation.TRA")
    draft = make_draft(path)
    assert draft.content["format"] == "csv"
    assert draft.content["recording"]["protocol"] == "step"
    assert main(["add", str(path), "--yes", "zone=Europe/Berlin"]) == 0
    assert inspect(path).verdict == FITS, inspect(path).as_text()


def test_a_file_that_nothing_tells_is_refused_with_the_formats(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "run.zzz"
    path.write_bytes(b"\x01\x02\x00\x03" * 100)
    assert main(["add", str(path)]) == 1
    said = capsys.readouterr().err
    assert "neither its ending nor its content tells its format" in said
    assert "csv" in said


@pytest.mark.parametrize(("unit", "per", "offset"), [("%", 1.0, 100.0), ("mm/mm", 0.01, 1.0)])
def test_a_strain_is_a_stretch_that_counts_from_0(tmp_path: Path, unit: str, per: float, offset: float) -> None:
    t = np.arange(0, 60, 0.1)
    strain = np.minimum(t * 10, 20.0)
    rows = [f"{a:.1f};{b * per:.5f};{3 + b * np.exp(-a / 9):.4f}" for a, b in zip(t, strain, strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["Zeit;Dehnung;Spannung", f"s;{unit};kPa", *rows, ""]), encoding="utf-8")
    columns = make_draft(path).content["columns"]
    assert columns["stretch"] == {"column": "Dehnung", "unit": unit, "offset": offset}
    assert columns["stress"] == {
        "column": "Spannung",
        "unit": "kPa",
    }  # called as a voltage is, and no voltage by its unit


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("EL-03 Relaxation.csv", "EL-03-Relaxation"),
        ("Prüfung №7 (neu).csv", "Prufung-No7-neu"),
        ("run_7.csv", "{stem}"),
    ],
)
def test_a_recording_has_a_name_that_it_may_have(tmp_path: Path, name: str, expected: str) -> None:
    assert make_draft(write_relaxation(tmp_path / name)).content["recording"]["recording_id"] == expected


def write_scope(path: Path, volts: float = 6.0) -> Path:
    """A sweep on the voltage monitor of an amplifier and on a load cell, both in volts, under the labels of a scope."""
    t = np.arange(0, 40, 0.002)
    v = volts / 2 * (1 - np.cos(2 * np.pi * 0.5 * 10 * (10 ** (t / 40) - 1)))
    rows = [f"{a:.4E},{b:.5f},{0.84 - 0.004 * (6 * b / volts) ** 2:.6f}" for a, b in zip(t, v, strict=True)]
    head = [
        "Model,MSX",
        "Horizontal Units,S",
        "Vertical Units,V,V",
        "Label,HV MON,LOAD",
        "",
        "x-axis,CH1,CH2",
        "Second,Volt,Volt",
    ]
    path.write_text("\n".join([*head, *rows, ""]))
    return path


def test_a_few_volts_are_those_of_a_monitor(tmp_path: Path) -> None:
    """No film is driven by six volts: how many kilovolts one of them stands for is asked, and 1 is an answer."""
    path = write_scope(tmp_path / "T0001.CSV")
    draft = make_draft(path)
    asked = {q.key: q.text for q in draft.questions}
    assert asked["columns.voltage.scale"].startswith("how many kV are 1 Volt of CH1")
    given = ["voltage.scale=1", "force.scale=0.5", "specimen_id=S", "film_sizes_mm=50x40x1"]
    assert main(["add", str(path), "--yes", *given]) == 0
    found = {c.name: (c.low, c.high) for c in inspect(path).channels}
    assert found["voltage"][1] == pytest.approx(6.0, abs=0.01)
    assert found["force"][0] == pytest.approx(0.348, abs=0.001)


def test_volts_that_can_drive_a_film_are_its_voltage(tmp_path: Path) -> None:
    draft = make_draft(write_scope(tmp_path / "T0002.CSV", volts=3000.0))
    assert draft.content["columns"]["voltage"] == {"column": "CH1", "unit": "Volt"}


def test_day_and_hour_in_lines_of_their_own_are_one_start(tmp_path: Path) -> None:
    def start(*lines: str) -> str | None:
        return next((f.value for f in harvest_lines(lines) if f.key == "started_at"), None)

    assert start("Datum;11.03.2024;", "Uhrzeit;09:42:17;") == "2024-03-11T09:42:17"
    assert start("Uhrzeit;09:42;", "Datum;11.03.2024;") == "2024-03-11T09:42:00"
    assert start("Datum;11.03.2024;") == "2024-03-11T12:00:00", "the day stays the same in other zones"
    assert start("Datum;11.03.2024 08:00:00", "Uhrzeit;09:42:17;") == "2024-03-11T08:00:00"
    assert start("Run date\t4/22/2024 1:37:08 PM") == "2024-04-22T13:37:08"
    assert start("Date\t4/22/2024") is None, "the order of day and month is not known"


def test_an_answer_against_the_samples_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_relaxation(tmp_path / "run.csv")
    assert main(["add", str(path), "--yes", "zone=Europe/Berlin", "protocol=cycle"]) == 0
    assert "cycle, mechanical, as you say; its samples show step, mechanical (sure:" in capsys.readouterr().out


def test_files_with_times_of_their_own_say_when_they_began(tmp_path: Path) -> None:
    """The file's last change stood there, and the night told the two apart as damage."""
    nptdms = pytest.importorskip("nptdms")
    t = np.arange(800) / 100
    start = np.datetime64("2026-03-01T13:05:00")
    about = {"wf_increment": 0.01, "wf_start_offset": 0.0, "wf_start_time": start}
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as writer:
        for name, unit, values in (("Weg", "mm", np.sin(3 * t)), ("Kraft", "N", 0.2 * np.sin(3 * t))):
            channel = nptdms.ChannelObject("rig", name, values, properties={**about, "unit_string": unit})
            writer.write_segment([channel])
    draft = make_draft(tmp_path / "run.tdms")
    assert draft.content["recording"]["started_at"] == "2026-03-01T13:05:00+00:00"
    assert [q.key for q in draft.questions] == ["recording.specimen_id"]


@pytest.mark.parametrize(
    ("line", "started_at"),
    [("Date: 22.04.2026 00:00:00", "2026-04-22T00:00:00"), ("Date: 22.04.2026", "2026-04-22T12:00:00")],
)
def test_midnight_that_is_stated_stays_midnight(line: str, started_at: str) -> None:
    (fact,) = harvest_lines([line])
    assert (fact.key, fact.value) == ("started_at", started_at)


# Tables and traces as machines of new users write them


def test_a_head_said_again_above_each_interval_is_no_row(tmp_path: Path) -> None:
    head = [
        "Interval and data points:\t{n}\t3",
        "Interval data:\tPoint No.\tTemperature\tAngular Frequency\tStorage Modulus",
    ]
    head[1] += "\tLoss Modulus\tStatus"
    blocks = []
    for number, degrees in enumerate((-20, 0, 20), 1):
        rows = [f"\t{i}\t{degrees + 0.01 * i:.2f}\t{10**i}\t{1000 * i}\t{100 * i}\tok" for i in range(1, 7)]
        blocks += ["", head[0].format(n=number), head[1], "\t\t\t\t\t\t", "\t\t[°C]\t[rad/s]\t[Pa]\t[Pa]\t", *rows]
    path = tmp_path / "sweep.csv"
    path.write_bytes("\r\n".join(["Project:\tx", *blocks, ""]).encode("utf-16"))
    assert main(["add", str(path), "--yes", "specimen_id=V-1"]) == 0
    assert inspect(path).verdict == FITS, inspect(path).as_text()
    assert len(tomllib.loads(path.with_name("sweep.csv.toml").read_text())["select"]) == 1


def test_heads_are_found_again_in_sheets_as_in_texts() -> None:
    header = ("w", "G1", "state")
    rows = [
        ["1", "2", "a"],
        ["", "", ""],
        ["Interval", "2", ""],
        ["w", "G1", "state"],
        ["rad/s", "Pa", ""],
        [3.0, 4.0, "a"],
    ]
    assert find_repeated_heads(rows, header) == {1, 2, 3, 4}
    assert find_repeated_heads(rows[:1], header) == set()


@pytest.mark.parametrize(
    ("name", "failed", "alive"),
    [
        ("Ausfall (ja/nein)", "ja", "nein"),
        ("Defekt", "x", ""),
        ("lebt noch", "nein", "ja"),
        ("Zensiert", "0", "1"),
        ("Bemerkung 1", "nein", "ja"),
        ("Survived?", "no", "yes"),
    ],
)
def test_outcomes_of_lives_are_found_by_name_or_by_what_they_say(
    tmp_path: Path, name: str, failed: str, alive: str
) -> None:
    cells = [failed, failed, alive, failed]
    lives = [f"P-{i};4,0;{10 * i},5;{cell};{'Rand' if cell == failed else ''}" for i, cell in enumerate(cells, 1)]
    path = tmp_path / "lives.csv"
    path.write_text("\n".join([f"Probe;Spannung [kV];Standzeit [h];{name};Ort", *lives, ""]))
    columns = make_draft(path).content["columns"]
    assert columns["failed"]["column"] == name
    if name != "Bemerkung 1":  # nothing tells there which is which: it is asked
        assert [str(v) for v in columns["failed"]["failed_values"]] == [failed]
        assert [str(v) for v in columns["failed"]["censored_values"]] == [alive]


@pytest.mark.parametrize(("shape", "protocol"), [("triangle", "cycle"), ("sinusoid", "cyclic"), ("rounded", "cycle")])
def test_triangles_are_large_cycles_and_sinusoids_are_not(shape: str, protocol: str) -> None:
    t = np.arange(0, 33, 0.02)
    phase = t / 6.6
    x = 20 * np.abs((2 * phase) % 2 - 1) if shape != "sinusoid" else 10 - 10 * np.cos(2 * np.pi * phase)
    if shape == "rounded":
        x = np.convolve(np.pad(x, 10, "edge"), np.ones(21) / 21, "valid")
    x = x + np.random.default_rng(3).normal(0, 0.01, t.size)
    found = find_shape({"displacement": Trace(t, x), "force": Trace(t, 0.1 * x)})
    assert (found.protocol, found.certainty) == (protocol, "sure")


def test_an_answer_about_a_channel_goes_to_the_files_that_have_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(0, 100, 0.1)
    v = 5 * (1 - np.abs((t / 10) % 2 - 1))
    trace, lives = tmp_path / "scope.csv", tmp_path / "lives.csv"
    rows = [f"{a:.1f},{b:.3f},{0.6 - 0.004 * b * b:.4f}" for a, b in zip(t, v, strict=True)]
    trace.write_text("\n".join(["Time (s),Voltage (V),Force (V)", *rows, ""]))
    lives.write_text("Probe;Spannung [kV];Standzeit [h];Ausfall\nA;4;10;ja\nB;4;20;nein\nC;5;2;ja\n")
    scales = ["columns.voltage.scale=1.1", "force.scale=0.2"]
    assert main(["add", str(trace), str(lives), "--yes", "specimen_id=A-1", *scales]) == 0
    assert tomllib.loads((tmp_path / "scope.csv.toml").read_text())["columns"]["force"]["scale"] == 0.2
    assert "scale" not in tomllib.loads((tmp_path / "lives.csv.toml").read_text())["columns"]["voltage"]
    assert "2 failed, 1 still alive" in capsys.readouterr().out
    assert main(["add", str(trace), str(lives), "--replace", "--yes", "forse.scale=1", *scales]) == 2
    assert "forse.scale" in capsys.readouterr().err


def test_samples_that_a_scope_counts_are_no_displacement(tmp_path: Path) -> None:
    rows = [f"{i},{2 * (i // 100 % 2)}.0,{0.1 * (i // 100 % 2):.2f}," for i in range(1200)]
    path = tmp_path / "scope.csv"
    path.write_text("\n".join(["X,CH1,CH2,Start,Increment,", "Sequence,Volt,Volt,-8.0,1.0e-02", *rows, ""]))
    content = make_draft(path, {"CH1": "voltage", "CH2": "force"}).content
    assert set(content["columns"]) == {"voltage", "force"}
    assert content["time"] == {"sample_rate_hz": 100.0}


def test_triangles_of_both_signs_on_a_scope_are_slow_cycles_of_a_voltage(tmp_path: Path) -> None:
    """Two nameless channels were taken for a multisine, and still were when they had become voltage and force."""
    t = np.arange(-5, 125, 0.05)
    volts = 10 * (2 / np.pi) * np.arcsin(np.sin(2 * np.pi * np.clip(t, 0, 120) / 40))
    noise = np.random.default_rng(0).normal(0, [[0.02], [0.4]], (2, t.size))
    rows = [
        f"{a:.2f};{b:.5f};{c:.5f}".replace(".", ",")
        for a, b, c in zip(t, volts + noise[0], 209 - 0.55 * volts**2 + noise[1], strict=True)
    ]
    path = tmp_path / "scope.csv"
    path.write_text("\n".join(["Zeit;Kanal A;Kanal B", "(s);(V);(mV)", "", *rows, ""]))
    about = make_draft(path).content["recording"]
    assert (about["protocol"], about["loading"]) == ("cycle", "electrical")


def test_what_follows_a_hold_in_the_same_file_is_told_before_it_is_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    t = np.arange(0, 360, 0.1)
    x = 10 * np.clip((t - 2) / 0.5, 0, 1) - 4 * np.abs((np.maximum(t - 300, 0) / 10 + 1) % 2 - 1)
    x = np.where(t < 300, 10 * np.clip((t - 2) / 0.5, 0, 1), x + 4)
    force = 0.2 * x * (1 + 0.3 * np.exp(-np.maximum(t - 2.5, 0) / 20))
    noise = np.random.default_rng(1).normal(0, 1e-3, (2, t.size))
    rows = [f"{a:.1f};{b:.4f};{c:.4f}" for a, b, c in zip(t, x + noise[0], force + noise[1], strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["Time [s];Displacement [mm];Force [N]", *rows, ""]))
    assert main(["add", str(path), "--yes", "specimen_id=A-1", "protocol=step"]) == 0
    said = capsys.readouterr().out
    assert "note       the film is moved again" in said


@pytest.mark.parametrize("names", [("M00", "M01"), ("a", "b")])
def test_a_test_seen_in_columns_that_no_name_tells_is_asked_and_not_called_sure(
    tmp_path: Path, names: tuple[str, str]
) -> None:
    """A warming room beside a supply's monitor was surely a step and hold of a displacement."""
    t = np.arange(0, 60, 0.1)
    held = np.minimum(t * 5, 10.0)
    answer = 0.03 * held * (1 + 0.5 * np.exp(-t / 10)) + np.random.default_rng(2).normal(0, 1e-3, t.size)
    rows = [f"{a:.1f};{b:.4f};{c:.5f}" for a, b, c in zip(t, held, answer, strict=True)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join([";".join(["Time [s]", *names]), *rows, ""]))
    guessed = make_draft(path)
    assert guessed.shape is not None
    assert guessed.shape.certainty == "a guess"
    assert "recording.protocol" in {q.key for q in guessed.questions}
    told = make_draft(path, {names[0]: "displacement", names[1]: "force"})
    assert told.shape is not None
    assert told.shape.certainty == "sure"
    assert "recording.protocol" not in {q.key for q in told.questions}


def write_sweep(path: Path) -> Path:
    """A sweep from 1 to 20 Hz on a spring; nothing in the file says its frequencies."""
    t = np.arange(0, 10, 0.005)
    x = 0.5 * np.sin(2 * np.pi * 10 / np.log(20) * (20 ** (t / 10) - 1))
    rows = [f"{a:.3f},{b:.5f},{c:.5f}" for a, b, c in zip(t, x, 0.3 * x, strict=True)]
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(["time (s),displacement (mm),force (N)", *rows, ""]))
    return path


SWEPT = ["specimen_id=P-07", "started_at=2026-03-01T14:05:00+01:00"]
SIZED = ["film_sizes_mm=50x20x0.5", "stretch_1=1.2"]


def test_the_preview_says_which_results_will_not_come(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It promised models of a sweep, and the night had no diagnosis for want of the sweep's frequencies."""
    path = write_sweep(tmp_path / "run7.csv")
    assert main(["add", str(path), "--yes", *SWEPT]) == 0
    told = capsys.readouterr().out
    assert "no diagnosis: frequency_start_hz and frequency_stop_hz missing" in told
    assert "no modulus: film_length_mm, film_width_mm, film_thickness_mm missing" in told
    frequencies = ["frequency_start_hz=1", "frequency_stop_hz=20"]
    assert main(["add", str(path), "--replace", "--yes", *SWEPT, *frequencies]) == 0
    assert "no diagnosis" not in capsys.readouterr().out


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_what_a_test_needs_is_asked_and_may_be_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither rig nor sizes nor frequencies were asked for, and a night later the sweep had no diagnosis."""
    path = write_sweep(tmp_path / "first" / "P-07" / "run7.csv")
    (tmp_path / "first" / "rigs").mkdir()
    (tmp_path / "first" / "rigs" / "rig-a.toml").write_text("load_cell_stiffness_n_per_mm = 40\n")
    monkeypatch.setattr("sys.stdin", Terminal())
    said = {"rig_id": ["rig-a"], "film_length_mm": ["fifty", "-1", "50"], "frequency_start_hz": ["1"]}
    asked: list[str] = []

    def ask(text: str) -> str:
        asked.append(text)
        return said.get(text.split(":")[0].strip(), [""]).pop(0)

    assert add.add_file(path, _arguments(), ask) == 0
    assert any("rig-a" in text for text in asked), asked
    written = tomllib.loads((path.parent / "run7.csv.toml").read_text(encoding="utf-8"))["recording"]
    assert (written["rig_id"], written["film_length_mm"], written["frequency_start_hz"]) == ("rig-a", 50, 1)
    assert not {"film_width_mm", "film_thickness_mm", "frequency_stop_hz"} & written.keys()


def test_answers_that_end_too_early_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The end of the input (Ctrl-D) ended in a traceback."""
    path = write_sweep(tmp_path / "run7.csv")
    monkeypatch.setattr("sys.stdin", Terminal())
    assert main(["add", str(path)]) == 2
    assert "nothing is written" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["run7.csv"]


def test_what_is_missing_is_told_in_the_last_lines(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_sweep(tmp_path / "run7.csv")
    assert main(["add", str(path), "--yes", *SWEPT, "frequency_start_hz=1", *SIZED]) == 0
    head, *lines = capsys.readouterr().out.split("Still missing")[1].splitlines()
    assert "below [recording] in run7.csv.toml" in head
    assert "--yes" in head
    assert [line.split("#")[0].strip() for line in lines] == ['rig_id = "…"', "frequency_stop_hz = …"]
    more = ["frequency_start_hz=1", "rig_id=rig-a", "frequency_stop_hz=20"]
    assert main(["add", str(path), "--replace", "--yes", *SWEPT, *SIZED, *more]) == 0
    assert "Still missing" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("protocol", "missing", "given"),
    [("tap", ["rig_id"], "rig_id=rig-a"), ("weight", ["rig_id", "masses_kg"], "masses_kg=0.1,0.2")],
)
def test_a_calibration_lacks_its_rig_and_what_was_hung(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], protocol: str, missing: list[str], given: str
) -> None:
    """Weights without their masses led to no result, and nobody had asked for them."""
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["time (s),force (N)", *(f"{i / 100},{i // 50}" for i in range(300)), ""]))
    told = [*SWEPT, f"protocol={protocol}", "loading=calibration"]
    assert main(["add", str(path), "--yes", *told]) == 0
    lines = capsys.readouterr().out.split("Still missing")[1].splitlines()[1:]
    assert [line.split("=")[0].strip() for line in lines] == missing
    assert main(["add", str(path), "--replace", "--yes", *told, given]) == 0
    assert given.split("=")[0] + " = " not in capsys.readouterr().out


def test_a_life_lacks_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "life.csv"
    path.write_text("\n".join(["time (s),HV_kV", *(f"{i},{5.0 if i < 50 else 0.0}" for i in range(60)), ""]))
    assert main(["add", str(path), "--yes", "specimen_id=L-1"]) == 0
    told = capsys.readouterr().out
    assert "lifetime" in told
    assert "Still missing" not in told


def test_the_next_night_is_given_the_folder_that_holds_the_rigs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The suggested folder was the file's own, and a night over it found no rig file."""
    path = write_sweep(tmp_path / "first" / "P-07" / "run7.csv")
    (tmp_path / "first" / "rigs").mkdir()
    (tmp_path / "first" / "rigs" / "rig-a.toml").write_text("load_cell_stiffness_n_per_mm = 40\n")
    monkeypatch.chdir(tmp_path)
    assert main(["add", "first/P-07/run7.csv", "--yes", *SWEPT, "rig_id=rig-a"]) == 0
    told = capsys.readouterr().out
    assert "The next `dealab nightly first` takes the file" in told
    assert "is not there" not in told
    assert main(["add", str(path), "--replace", "--yes", *SWEPT, "rig_id=rig-b"]) == 0
    told = capsys.readouterr().out
    assert f"`dealab nightly {tmp_path / 'first'}`" in told
    absent = "rig file rigs/rig-b.toml is not there: no constants of the rig, no resonance correction"
    assert absent in told
    assert absent in inspect(path).notes
    (tmp_path / "first" / "rigs" / "rig-a.toml").unlink()
    (tmp_path / "first" / "rigs").rmdir()
    assert main(["add", str(path), "--replace", "--yes", *SWEPT]) == 0
    assert f"`dealab nightly {path.parent}`" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("given", "sizes"),
    [
        ("50x20x0.5", ["50", "20", "0.5"]),
        ("50x50x0,6", ["50", "50", "0.6"]),
        ("50; 20; 0,5", ["50", "20", "0.5"]),
        ("50 20 0,5", ["50", "20", "0.5"]),
        ("50, 20, 0.5", ["50", "20", "0.5"]),
        ("50,20,0.5", ["50", "20", "0.5"]),
    ],
)
def test_sizes_have_the_decimal_comma_of_their_file(given: str, sizes: list[str]) -> None:
    """`50x50x0,6` was four numbers, of which the third was a thickness of 0."""
    assert _split_sizes(given) == sizes


def test_a_step_is_told_with_its_unit_and_from_where_it_begins() -> None:
    time_s = np.arange(0, 20, 0.01)
    moved = np.clip((time_s - 2) / 0.05, 0, 1)
    shape = find_shape({"displacement": Trace(time_s, moved), "force": Trace(time_s, 0.4 * moved)})
    assert shape is not None
    assert re.match(r"displacement goes to 1 mm within 0\.0\d* s and is held", shape.seen)
