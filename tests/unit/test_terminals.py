"""Odd terminals and odd paths of a lab: each is told as what it is, without a traceback."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pipeline.nightly.night
from pipeline import Lab
from pipeline.cli import main
from tests.conftest import ROOT
from tests.helpers.small_lab import life


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with raw files and a lab after a night, without pages."""
    folder = tmp_path_factory.mktemp("terminals")
    (folder / "raw").mkdir()
    for number in range(2):
        life(folder / "raw" / f"L-{number}.mcap", number, operator="Zoë")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
        assert main(["nightly", str(folder / "raw"), "--lab", str(folder / "lab"), "--jobs", "0"]) == 0
    return folder


@pytest.fixture
def lab(made: Path, tmp_path: Path) -> Lab:
    """A copy of that lab."""
    return Lab(shutil.copytree(made / "lab", tmp_path / "lab"))


def type_in_shell(line: str, lab: Lab, **environment: str) -> tuple[int, bytes, bytes]:
    line, _, behind = line.partition(" @ ")
    command = f'"{sys.executable}" -m dealab {line} --lab "{lab.folder}" {behind}'
    done = subprocess.run(
        ["sh", "-c", command],
        capture_output=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )
    assert b"Traceback" not in done.stderr, done.stderr.decode()
    assert b"Exception ignored" not in done.stderr, done.stderr.decode()
    return done.returncode, done.stdout, done.stderr


@pytest.mark.long_after(1)
@pytest.mark.parametrize(
    ("line", "status"),
    [
        ("status @ >&-", 0),
        ("status @ 2>&-", 0),
        ("sql 'SELECT nothing' @ 2>&- <&-", 1),
        ("sql 'SELECT 1' @ > /dev/full", 1),
    ],
)
def test_closed_and_full_streams(line: str, status: int, lab: Lab) -> None:
    assert type_in_shell(line, lab)[0] == status


def test_a_terminal_without_the_signs_gets_escapes_and_a_file_gets_utf_8(lab: Lab) -> None:
    found = type_in_shell(
        "sql 'SELECT operator, chr(937) AS o FROM recordings LIMIT 1' --format csv", lab, PYTHONIOENCODING="latin-1"
    )
    assert found == (0, "operator,o\nZoë,Ω\n".encode(), b"")


_NIGHTS = ("md:x", "s3:x")
"""Names of labs that a night makes; the others are copies."""


@pytest.mark.long_after(1)
@pytest.mark.parametrize("name", ["md:x", ":memory:", "s3:x", "http:x", "a?b", "it's"])
def test_a_lab_is_a_folder_whatever_its_name(
    name: str, made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    if name not in _NIGHTS:
        shutil.copytree(made / "lab", name)
    night = [["nightly", str(made / "raw"), "--jobs", "0"]] if name in _NIGHTS else []
    for words in [*night, ["status"], ["sql", "SELECT count(*) FROM samples('L-1')"]]:
        assert main([*words, "--lab", name]) == 0, capsys.readouterr()
    assert len(Lab(name).samples("L-1"))


def test_a_backslash_is_refused_at_once(made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["nightly", str(made / "raw"), "--lab", str(tmp_path / "a\\b")]) == 1
    assert "there is a backslash in the path" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_lab_below_a_backslash_is_told_by_every_command(
    lab: Lab, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    moved = lab.folder.rename(tmp_path / "a\\b")
    for words in (["status"], ["sql", "SELECT 1"], ["doctor"], ["report"]):
        assert main([*words, "--lab", str(moved)]) == 1, words
        told = capsys.readouterr()
        assert "there is a backslash in the path" in told.out + told.err, words
