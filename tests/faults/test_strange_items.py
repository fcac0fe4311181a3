"""One strange item among the raw files costs itself only: names, depths, numbers, links, and reading without end."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pipeline.nightly.look
import pipeline.nightly.night
from pipeline import Lab
from pipeline.lab.settings import load_settings
from pipeline.nightly.night import nightly
from schemas.errors import LabError
from tests.faults.lab_state import healthy, select
from tests.helpers.small_lab import life

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.skipif(os.name == "nt", reason="Windows has no such names and no such links"),
]
TABLE = "a,b\n1,2\n"


def put_names_that_are_not_utf8(raw: bytes) -> None:
    for folder in (raw, raw + b"/folder \xfd"):
        os.makedirs(folder, exist_ok=True)
        for name in (b"bad \xff.mcap", b"unmapped \xfe.csv", b"mapped \xfc.csv", b"mapped \xfc.csv.toml"):
            with open(folder + b"/" + name, "w") as file:
                file.write(TABLE)
    os.symlink(b"nowhere \xfb", raw + b"/link \xfa.mcap")


def put_long_names(raw: bytes) -> None:
    for name in (b"n" * 251 + b".csv", b"m" * 250 + b".mcap", b"o" * 255):
        with open(raw + b"/" + name, "w") as file:
            file.write(TABLE)


def put_deep_folders(raw: bytes, name: bytes = b"d" * 10) -> None:
    """Deeper than Python recurses, and beyond the length that a path may have."""
    at = os.open(raw, os.O_RDONLY)
    for _ in range(600):
        os.mkdir(name, dir_fd=at)
        below = os.open(name, os.O_RDONLY, dir_fd=at)
        os.close(at)
        at = below
    os.close(os.open(b"x.mcap", os.O_WRONLY | os.O_CREAT, dir_fd=at))
    os.close(at)


def put_very_deep_folders(raw: bytes) -> None:
    put_deep_folders(raw, b"d")


def put_absurd_mappings(raw: bytes) -> None:
    texts = (
        f"kind = 'recording'\nx = {'9' * 400}",
        ".".join("a" * 3000) + " = 1",
        "a = " + "[" * 3000 + "]" * 3000,
        "x = inf",
        "x = " + "1" * 5000,
        "x = 0x" + "f" * 5000,
        "\udcff",
        "time = 9999-99-99",
    )
    for number, text in enumerate(texts):
        for name in (f"{number}.csv.toml", f"folder-{number}/recordings.toml"):
            path = Path(os.fsdecode(raw)) / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, errors="surrogateescape")
            (path.parent / f"{number}.csv").write_text(TABLE)


def put_what_never_ends(raw: bytes) -> None:
    for name in (b"zero.mcap", b"z.csv.toml", b"recordings.toml", b"zero.csv"):
        os.symlink("/dev/zero", raw + b"/" + name)
    os.mkfifo(raw + b"/pipe.mcap")
    if os.path.exists("/proc/self/pagemap"):
        for name in (b"pages.csv", b"p.csv.toml", b"pages.mcap"):
            os.symlink("/proc/self/pagemap", raw + b"/" + name)
    for name in (b"z.csv", b"p.csv"):
        with open(raw + b"/" + name, "w") as file:
            file.write(TABLE)


@pytest.mark.parametrize(
    "put",
    [
        put_names_that_are_not_utf8,
        put_long_names,
        put_deep_folders,
        put_very_deep_folders,
        put_absurd_mappings,
        put_what_never_ends,
    ],
)
def test_one_strange_item_ends_no_night(
    put: Callable[[bytes], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    life(raw / "L-1.mcap", 1)
    put(os.fsencode(raw))
    try:
        summary = nightly([raw], lab, jobs=0)
        assert select(lab, "SELECT recording_id FROM recordings WHERE status = 'ok'") == [("L-1",)]
        told = [*summary.notes, *summary.attention]
        assert told
        for line in told:
            line.encode()
        assert healthy(lab) == []
    finally:
        _remove_deep(raw)


def _remove_deep(folder: Path) -> None:
    """pytest's own removal gives up on paths that are too long."""
    for name in (b"d" * 10, b"d"):
        if os.path.isdir(os.fsencode(folder) + b"/" + name):
            at = os.open(folder, os.O_RDONLY)
            while True:  # turn the chain inside out: each folder goes up beside the first
                os.rename(name, b"top", src_dir_fd=at, dst_dir_fd=at)
                try:
                    os.rename(b"top/" + name, name, src_dir_fd=at, dst_dir_fd=at)
                except FileNotFoundError:
                    os.unlink(b"top/x.mcap", dir_fd=at)
                    os.rmdir(b"top", dir_fd=at)
                    break
                os.rmdir(b"top", dir_fd=at)
            os.close(at)


def test_a_file_system_that_does_not_answer_costs_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    for number in range(3):
        life(raw / f"L-{number}.mcap", number)
    lab.create()
    lab.settings.write_text("deadline_s = 1\n")
    answer, hash_file = threading.Event(), pipeline.nightly.look.file_sha256

    def hang(path: Path) -> str:
        if path.stem == "L-1":
            answer.wait(60)
        return hash_file(path)

    def night() -> Any:
        began = time.monotonic()
        summary = nightly([raw], lab, jobs=0)
        assert time.monotonic() - began < 50
        return summary

    with monkeypatch.context() as hanging:
        hanging.setattr(pipeline.nightly.look, "file_sha256", hang)
        first = night()
    answer.set()
    assert first.exit_status == 3
    assert "longer than deadline_s allows" in "\n".join(first.attention)
    rows = dict(select(lab, "SELECT split_part(source_path, '/', -1), status FROM recordings"))
    assert rows == {"L-0.mcap": "ok", "L-1.mcap": "pending", "L-2.mcap": "ok"}
    assert select(lab, "SELECT nights FROM accidents") == [(1,)]
    assert night().exit_status == 0
    assert select(lab, "SELECT count(*) FROM accidents") == [(0,)]


@pytest.mark.parametrize(
    "text",
    [
        "deadline_s = inf",
        "memory_mb = inf",
        "memory_mb = nan",
        "deadline_s = 1e300",
        f"memory_mb = {'9' * 400}",
        ".".join("a" * 3000) + " = 1",
        "orders = " + "[" * 3000 + "]" * 3000,
        "\udcff",
    ],
)
def test_absurd_settings_are_refused_in_a_line(text: str, tmp_path: Path) -> None:
    lab = Lab(tmp_path)
    lab.settings.write_text(text, errors="surrogateescape")
    with pytest.raises(LabError, match="settings"):
        load_settings(lab)
