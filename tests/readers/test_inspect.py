"""`inspect`: verdicts, what is shown, drafts that work, nothing written, nothing raised."""

from __future__ import annotations

import os
import signal
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ingest.csv_reader import read_csv
from ingest.draft_text import toml_string
from ingest.encodings import guess_encoding
from ingest.inspect import DAMAGED, FITS, REFUSED, UNMAPPED, inspect
from ingest.mapping import FileMapping
from ingest.meanings import guess_meaning
from ingest.sniff import guess_text
from pipeline.cli import main
from tests.helpers.small_lab import chirp
from tests.helpers.xlsx_files import write_xlsx

N = 50


def table(delimiter: str, decimal: str) -> str:
    rows = [(i / 100, np.sin(i / 5), np.cos(i / 5)) for i in range(N)]
    return "".join(delimiter.join(f"{v:.6f}" for v in row).replace(".", decimal) + "\n" for row in rows)


@pytest.mark.parametrize(
    ("head", "delimiter", "decimal", "encoding"),
    [
        ("Prüfung 12\nBediener: Müller\n\nZeit;Kraft;Weg\ns;N;mm\n", ";", ",", "cp1252"),
        ("Time [s],Force [mN],Displacement (µm)\n", ",", ".", "utf-8-sig"),
        ("时间\t力值\t位移\ns\tN\tmm\n", "\t", ".", "gbk"),
        ("time force disp\n", " ", ".", "utf-16"),
        ("t|F|x\n", "|", ",", "utf-8"),
    ],
)
def test_a_draft_reads_the_file_it_was_made_for(
    tmp_path: Path, head: str, delimiter: str, decimal: str, encoding: str
) -> None:
    path = tmp_path / "run 7.csv"
    path.write_bytes((head + table(delimiter, decimal)).encode(encoding))
    path = path.rename(tmp_path / "run-7.csv")
    found = inspect(path)
    assert found.verdict == UNMAPPED
    assert found.draft is not None
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run-7.csv"]
    (tmp_path / "run-7.csv.toml").write_text(found.draft, encoding="utf-8")
    again = inspect(path)
    assert again.verdict == FITS, again.as_text()
    channels = {c.name: c for c in again.channels}
    assert channels["force"].samples == N
    assert channels["force"].rate_hz == pytest.approx(100)
    assert set(channels) == {"force", "displacement"}


@pytest.mark.parametrize(
    ("text", "kind"),
    [
        ("f,E_stor,E_loss,T\nrad/s,MPa,MPa,C\n1,2,0.5,20\n2,3,0.5,20\n", "frequency_response"),
        ("volt,time,cens\n5,70,1\n5,80,0\n", "lifetimes"),
    ],
)
def test_tables_are_drafted_as_tables(tmp_path: Path, text: str, kind: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text(text)
    draft = inspect(path).draft
    assert draft is not None
    (tmp_path / "table.csv.toml").write_text(draft)
    found = inspect(path)
    assert (found.verdict, found.kind) == (FITS, kind), found.as_text()
    assert found.channels[0].samples == 2


def test_file_name_that_is_no_utf8(tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b"/run\xff.csv"))
    path.write_text("t,F,x\n" + table(",", "."))
    draft = inspect(path).draft
    assert draft is not None
    Path(f"{path}.toml").write_text(draft, encoding="utf-8")
    assert inspect(path).fits
    named = draft.replace('recording_id = "run"', 'recording_id = "{stem}"')
    Path(f"{path}.toml").write_text(named, encoding="utf-8")
    refused = inspect(path)
    assert refused.error is not None
    refused.as_text().encode()
    str(refused.error).encode()


def test_damaged_and_refused_files_say_why(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("t,F,x\n" + table(",", "."))
    draft = inspect(path).draft
    assert draft is not None
    (tmp_path / "run.csv.toml").write_text(draft)
    path.write_text(("t,F,x\n" + table(",", "."))[:-4])
    damaged = inspect(path)
    assert damaged.verdict == DAMAGED
    assert damaged.fits
    assert damaged.channels[0].samples == N - 1
    (tmp_path / "run.csv.toml").write_text(draft.replace("started_at", "begun_at"))
    refused = inspect(path)
    assert refused.verdict == REFUSED
    assert "started_at" in refused.as_text()
    (tmp_path / "run.csv.toml").write_text("speed = 3\n")
    assert '"speed" is unknown' in inspect(path).as_text()


def test_terminal_gets_no_control_characters(tmp_path: Path) -> None:
    path = tmp_path / "a\x1b[2J\u202e.csv"
    path.write_text("\x1b]0;x\x07,t,\u202eforce\n1,2,3\n2,3,4\n")
    text = inspect(path).as_text()
    assert all(c.isprintable() or c == "\n" for c in text.split("draft of a mapping")[0])
    draft = inspect(path).draft
    assert draft is not None
    assert "\x1b" not in draft
    FileMapping.parse(tomllib.loads(draft), stem="a", suffix=".csv")


def test_files_without_numbers_and_odd_content(tmp_path: Path) -> None:
    for name, content in {
        "a.csv": b"",
        "b.csv": b"only words\nand more\n",
        "c.xlsx": b"PK\x03\x04",
        "d.mat": b"\x00" * 600,
        "e.txt": os.urandom(5000),
        "f.csv": b"\xff\xfe",
    }.items():
        path = tmp_path / name
        path.write_bytes(content)
        found = inspect(path)
        assert not found.fits
        assert found.as_text()


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=400))
def test_any_bytes_are_inspected_without_a_traceback(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(content)
    assert inspect(path).verdict == UNMAPPED


@given(st.text())
def test_toml_strings_read_back(text: str) -> None:
    plain = text.encode("utf-8", "replace").decode()
    assert tomllib.loads(f"x = {toml_string(text)}")["x"] == plain


def test_guesses_of_encodings_and_meanings() -> None:
    assert guess_encoding("Prüfung".encode("cp1252")) == "cp1252"
    assert guess_encoding("时间,力值".encode("gbk")) == "gbk"
    assert guess_encoding("时间,力值".encode()) == "utf-8"
    assert guess_meaning("Load cell", "N") == "force"
    assert guess_meaning("Load cell", "V") is None
    assert guess_meaning("Kanal 3", "pF") == "capacitance"
    assert guess_meaning("xyz", "") is None


def test_decimal_comma_is_not_split() -> None:
    guess = guess_text(b"0,5\t1,25\n0,6\t1,50\n0,7\t1,75\n")
    assert (guess.dialect.delimiter, guess.dialect.decimal) == ("\t", ",")
    assert len(guess.columns) == 2


def test_logger_with_stamps_and_words_is_drafted(tmp_path: Path) -> None:
    rows = [f"2026-03-01 12:00:00.{i:03d},{0.01 * i:.4f},{0.02 * i:.4f},RUN" for i in range(20)]
    path = tmp_path / "run.csv"
    path.write_text("\n".join(["timestamp,displacement (mm),force (N),state", *rows, ""]))
    draft = inspect(path).draft
    assert draft is not None
    found = tomllib.loads(draft)
    assert found["time"] == {"column": "timestamp", "format": "iso", "zone": "UTC"}
    assert found["columns"]["force"]["column"] == "force (N)"
    started = "started_at = " + '"2026-03-01T12:00:00+00:00"'
    lines = [started if line.startswith("started_at") else line for line in draft.splitlines()]
    (tmp_path / "run.csv.toml").write_text("\n".join(lines))
    assert inspect(path).verdict == FITS, inspect(path).as_text()


def test_words_are_no_table(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text(
        "Mounted film 3, 5 mm wide.\nIt slipped at 2.5 N, tried again\nand again, twice\nThen 7 kV, held.\n"
    )
    assert inspect(path).draft is None


def test_lists_of_lives_are_drafted_as_such(tmp_path: Path) -> None:
    rows = [["Specimen", "Electrode", "Voltage [kV]", "Time to breakdown [s]", "Remark"]]
    rows += [[f"A{i}", "grease", 6.0, 100.0 * i, "edge"] for i in range(1, 6)] + [["A6", "grease", 6.0, "> 3600", ""]]
    write_xlsx(tmp_path / "lives.xlsx", {"Lives": rows})
    draft = inspect(tmp_path / "lives.xlsx").draft
    assert draft is not None
    found = tomllib.loads(draft)
    assert found["kind"] == "lifetimes"
    assert {name: c["column"] for name, c in found["columns"].items()} == {
        "lifetime": "Time to breakdown [s]",
        "voltage": "Voltage [kV]",
        "configuration": "Electrode",
        "specimen_id": "Specimen",
    }
    (tmp_path / "lives.xlsx.toml").write_text(draft)
    read = inspect(tmp_path / "lives.xlsx")
    assert read.verdict == FITS
    assert "6 rows" in read.notes
    path = tmp_path / "list.csv"
    path.write_text(
        "sample,life (min),broke\n" + "".join(f"S{i},{i}.5,{'yes' if i % 3 else 'no'}\n" for i in range(1, 9))
    )
    failed = tomllib.loads(inspect(path).draft or "")["columns"]["failed"]
    assert failed == {"column": "broke", "failed_values": ["yes"], "censored_values": ["no"]}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs processes that can be forked")
def test_a_reader_that_crashes_costs_its_own_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("first", "second"):
        (tmp_path / f"{name}.csv").write_text("t,F,x\n" + "".join(f"{i / 100},{i},{-i}\n" for i in range(20)))
        (tmp_path / f"{name}.csv.toml").write_text(_MAPPING)

    def crash_once(path: Path, mapping: FileMapping) -> Any:
        if path.stem == "first":
            os.kill(os.getpid(), signal.SIGSEGV)
        return read_csv(path, mapping)

    monkeypatch.setattr("ingest.read.find_reader", lambda _: crash_once)
    assert main(["inspect", str(tmp_path / "first.csv"), str(tmp_path / "second.csv")]) == 3
    first, second = capsys.readouterr().out.split("\n\n")
    assert "first.csv: refused" in first
    assert "its parser crashed (SIGSEGV)" in first
    assert "second.csv: fits" in second


_MAPPING = """
recording = {recording_id = "{stem}", protocol = "chirp", loading = "mechanical", specimen_id = "S", started_at = "2026-03-01T14:00:00Z"}
time = {column = "t", unit = "s"}
columns.force = {column = "F", unit = "N"}
columns.displacement = {column = "x", unit = "mm"}
"""


@pytest.mark.parametrize(("place", "start"), [("P-7", ""), ("P-7", "P-7"), ("rigs", ""), ("rigs", "rigs")])
def test_the_rig_file_around_a_recording_is_joined(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str, start: str
) -> None:
    """Only one beside the recording was: not that of a calibration among the rig files, nor one further up."""
    (tmp_path / place).mkdir()
    (tmp_path / "rigs").mkdir(exist_ok=True)
    (tmp_path / "rigs" / "rig-a.toml").write_text("load_cell_stiffness_n_per_mm = 40.0\n")
    chirp(tmp_path / place / "run.mcap", 1)
    monkeypatch.chdir(tmp_path / start)
    found = inspect(Path(os.path.relpath(tmp_path / place / "run.mcap")))
    assert ("load_cell_stiffness_n_per_mm", "40.0") in found.rig
    assert not any("is not there" in note for note in found.notes), found.notes
