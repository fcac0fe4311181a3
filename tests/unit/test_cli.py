"""The command line: exit statuses, messages, help, and that it starts at once."""

from __future__ import annotations

import io
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import pipeline.nightly.night
from pipeline import Lab
from pipeline.cli import COMMANDS, main
from pipeline.commands import command
from tests.conftest import ROOT
from tests.helpers.small_lab import life

DEALAB = [sys.executable, "-m", "pipeline.cli"]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """A lab after a night over one good and one bad file, without pages."""
    folder = tmp_path_factory.mktemp("cli")
    raw = folder / "raw"
    raw.mkdir()
    life(raw / "L-1.mcap", 1)
    (raw / "bad.mcap").write_bytes(b"no recording")
    (raw / "table.csv").write_text("a,b\n1,2\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
        assert main(["nightly", str(raw), "--lab", str(folder / "lab"), "--jobs", "0"]) == 3
        yield Lab(folder / "lab")


def said(capsys: pytest.CaptureFixture[str]) -> tuple[str, str]:
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err
    return out, err


def test_what_was_refused_is_named_on_stderr_and_the_rest_on_stdout(
    lab: Lab, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    raw = lab.folder.parent / "raw"
    assert main(["nightly", str(raw), "--lab", str(lab.folder), "--jobs", "0"]) == 3
    out, err = said(capsys)
    assert "bad.mcap" in err
    assert "table.csv: no mapping" in err
    assert "2 files found, 0 taken in, 2 unchanged" in out
    assert "Nothing had to be done again" in out
    assert "bad.mcap" not in out


def test_the_report_that_fails_is_told_and_the_database_is_published(
    lab: Lab, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: "no ink")
    assert main(["nightly", str(lab.folder.parent / "raw"), "--lab", str(lab.folder), "--jobs", "0"]) == 1
    assert "the report is not whole: no ink" in said(capsys)[1]


@pytest.mark.parametrize(
    ("arguments", "status", "says"),
    [
        (["sql", "SELECT 1"], 1, "no published database"),
        (["status"], 1, "no published database"),
        (["report"], 1, "no published database"),
        (["diagnose"], 1, "no published database"),
        (["nightly", "nowhere"], 2, "no such file or folder"),
        (["nightly", "."], 1, "no recordings were found"),
        (["sql"], 2, "no query"),
        (["inspect", "nowhere"], 1, "not a file"),
        (["exclude", "../x", "--why", "y"], 2, "cannot be a recording id"),
        (["exclude", "x", "--why", " "], 2, "--why is empty"),
        (["simulate", "nothing", "--out", "raw"], 2, "nothing"),
    ],
)
def test_errors_are_one_line_with_a_status(
    arguments: list[str],
    status: int,
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == status
    out, err = said(capsys)
    assert out == ""
    assert err.startswith("dealab: ")
    assert says in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["nonsense"],
        ["nightly"],
        ["nightly", "x", "--jobs", "-1"],
        ["sql", "x", "--format", "xml"],
        ["exclude", "x"],
    ],
)
def test_wrong_usage_is_status_2(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    assert "usage: dealab" in said(capsys)[1]


@pytest.mark.parametrize("command", [*COMMANDS, None])
def test_help_has_examples_that_parse(command: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--help"] if command is None else [command, "--help"])
    assert caught.value.code == 0
    out, _ = said(capsys)
    assert "examples:\n  dealab" in out
    for name in COMMANDS if command is None else ():
        assert name in out


def test_sql_formats(lab: Lab, capsysbinary: pytest.CaptureFixture[bytes]) -> None:
    query = "SELECT recording_id, status FROM recordings ORDER BY status"
    expected = [{"recording_id": "L-1", "status": "ok"}, {"recording_id": None, "status": "quarantined"}]
    for form in ("json", "csv", "table", "parquet"):
        assert main(["sql", query, "--lab", str(lab.folder), "--format", form]) == 0
        out = capsysbinary.readouterr().out
        if form == "json":
            assert json.loads(out) == expected
        elif form == "csv":
            assert out == b"recording_id,status\nL-1,ok\n,quarantined\n"
        elif form == "table":
            assert out.decode().splitlines()[2:] == ["L-1           ok", "              quarantined", "(2 rows)"]
        else:
            assert out.startswith(b"PAR1")


def test_sql_that_is_wrong_points_at_the_place(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sql", "SELECT recording FROM recordings", "--lab", str(lab.folder)]) == 1
    _, err = said(capsys)
    assert '"recording_id"' in err
    assert "LINE 1: SELECT recording FROM" in err
    assert main(["sql", "DELETE FROM recordings", "--lab", str(lab.folder)]) == 2
    assert "a DELETE statement; expected a SELECT statement" in said(capsys)[1]


def test_examples_need_no_lab(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sql", "--examples", "--lab", "/nonexistent"]) == 0
    assert 'dealab sql "SELECT * FROM survival_at(60)" --lab /nonexistent' in said(capsys)[0]
    assert main(["sql", "--examples"]) == 0
    assert 'dealab sql "SELECT * FROM survival_at(60)"' in said(capsys)[0]


def test_exclusion_is_seen_at_once(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["exclude", "L-1", "--why", "loose\x1b[2J clamp", "--lab", str(lab.folder)]) == 0
    assert main(["status", "--lab", str(lab.folder)]) == 0
    out, _ = said(capsys)
    assert "1 excluded" in out
    assert "L-1: loose\\x1b[2J clamp" in out
    assert main(["include", "L-1", "--why", "not loose", "--lab", str(lab.folder)]) == 0
    assert main(["exclude", "nobody", "--why", "x", "--lab", str(lab.folder)]) == 2
    assert "no recording" in said(capsys)[1]


def test_doctor_and_schema_and_diagnose(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--lab", str(lab.folder)]) == 0, said(capsys)[0]
    orphan = lab.samples_folder / "protocol=chirp" / "orphan.parquet"
    orphan.parent.mkdir(parents=True)
    orphan.write_bytes(b"PAR1")
    assert main(["doctor", "--lab", str(lab.folder)]) == 1
    orphan.unlink()
    assert "no samples without a recording: samples/protocol=chirp/orphan.parquet" in said(capsys)[0]
    assert main(["schema"]) == 0
    assert "### `recordings`" in said(capsys)[0]
    assert main(["diagnose", "--lab", str(lab.folder)]) == 0
    assert "No diagnoses" in said(capsys)[0]
    assert main(["diagnose", "--lab", str(lab.folder), "--format", "json"]) == 0
    assert json.loads(said(capsys)[0]) == []
    assert main(["diagnose", "nobody", "--lab", str(lab.folder)]) == 2


def test_inspect_says_what_is_wrong(lab: Lab, capsys: pytest.CaptureFixture[str]) -> None:
    raw = lab.folder.parent / "raw"
    assert main(["inspect", str(raw / "L-1.mcap")]) == 0
    assert "fits the contract" in said(capsys)[0]
    assert main(["inspect", str(raw / "L-1.mcap"), str(raw / "bad.mcap"), str(raw / "table.csv")]) == 3
    assert "refused" in said(capsys)[0]


@pytest.mark.slow
def test_a_closed_pipe_is_no_error(lab: Lab) -> None:
    command = [*DEALAB, "sql", "SELECT repeat('x', 1000) FROM range(10000)", "--lab", str(lab.folder)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr.read() == b""
    process.stderr.close()
    assert process.wait(timeout=30) == 141


def test_help_imports_nothing_heavy() -> None:
    heavy = (
        "numpy",
        "pandas",
        "pyarrow",
        "duckdb",
        "scipy",
        "matplotlib",
        "pint",
        "dataclasses",
        "json",
        "pathlib",
        "importlib.metadata",
        "pipeline.commands.nightly",
        "shtab",
        "ingest",
        "reports",
        "schemas.units",
        "logging",
        "inspect",
        "subprocess",
        "tempfile",
        "asyncio",
        "urllib.request",
        "email",
    )
    program = (
        "import sys, contextlib, io\nsys.argv = ['dealab', '--help']\nfrom dealab import main\n"
        "with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):\n    main()\n"
        f"print([name for name in {heavy!r} if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


def test_a_night_over_formats_that_are_not_read_names_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / "run.wfm").write_bytes(b"x")
    assert main(["nightly", str(tmp_path / "raw"), "--lab", str(tmp_path / "lab")]) == 1
    assert "run.wfm: a format that is not read: passed over; export it as CSV, MAT or HDF5" in capsys.readouterr().err


class Terminal(io.StringIO):
    """A stream that says that somebody is watching."""

    def isatty(self) -> bool:
        return True


def test_progress_names_what_came_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = tmp_path / "raw"
    raw.mkdir()
    life(raw / "first-life.mcap", 1)
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    assert main(["nightly", str(raw), "--lab", str(tmp_path / "lab"), "--jobs", "0"]) in (0, 3)
    assert "first-life.mcap" in terminal.getvalue()


def test_a_night_that_nobody_watches_says_what_it_is_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A night whose output goes to a file said nothing for minutes."""
    (tmp_path / "raw").mkdir()
    for number in range(3):
        life(tmp_path / "raw" / f"L-{number}.mcap", number)
    night = ["nightly", str(tmp_path / "raw"), "--jobs", "0", "--lab"]
    assert main([*night, str(tmp_path / "quick")]) == 0
    quick = capsys.readouterr()
    assert "dealab: after" not in quick.err, "a short night is not worth a line"
    monkeypatch.setattr(command, "PROGRESS_S", 0.01)
    assert main([*night, str(tmp_path / "slow")]) == 0
    slow = capsys.readouterr()
    told = [line for line in slow.err.splitlines() if line.startswith("dealab: after ")]
    steps = [line.split(" s: ")[1] for line in told]
    assert any(re.fullmatch(r"recordings: \d of 3(, last L-\d\.mcap)?", step) for step in steps), told
    assert {"database", "pages"} & set(steps)
    assert [line.split()[0] for line in slow.out.splitlines()] == [line.split()[0] for line in quick.out.splitlines()]
    assert "dealab: after" not in slow.out


@pytest.mark.parametrize(
    "arguments",
    [["nightly", "{raw}", "--lab", ""], ["report", "--lab", ""], ["simulate", "first", "--out", ""], ["inspect", ""]],
)
def test_an_empty_path_is_not_the_working_folder(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--lab "$LAB"` where the variable is not set made a lab wherever one happened to be."""
    (tmp_path / "raw").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main([given.format(raw="raw") for given in arguments])
    assert ended.value.code == 2
    assert "the path is empty" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["raw"]
