"""The walk over raw folders, growing and changing files, the lab's quarantine."""

from __future__ import annotations

import json
import os
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NoReturn

import pytest
from hypothesis import given
from hypothesis import strategies as st

import ingest.discover
from ingest.discover import (
    MAPPED,
    NATIVE,
    UNMAPPED,
    check_unchanged,
    file_sha256,
    growing,
    lacks_end,
    with_mapping,
)
from ingest.quarantine import entries, entry_name, quarantine, release, safe_name
from schemas.errors import PendingError, RefusedError, UsageError
from tests.helpers.found_files import discover

TOML = """[[files]]
match = "*.csv"
[files.time]
sample_rate_hz = 10.0
[files.columns.force]
column = "F"
unit = "N"
"""


def test_walk_is_sorted_and_classified(tmp_path: Path) -> None:
    (tmp_path / "b" / "c").mkdir(parents=True)
    for name in (
        "b/z.mcap",
        "b/c/y.csv",
        "a.xlsx",
        "b/README.txt",
        "b/.hidden.csv",
        "b/x.csv.part",
        "b/~$a.xlsx",
        "b/p.png",
    ):
        (tmp_path / name).write_bytes(b"x")
    (tmp_path / "b" / "c" / "recordings.toml").write_text(TOML)
    found = discover([tmp_path])
    assert [(f.path.relative_to(tmp_path).as_posix(), f.state, f.format) for f in found.files] == [
        ("a.xlsx", UNMAPPED, "excel"),
        ("b/c/y.csv", MAPPED, "csv"),
        ("b/z.mcap", NATIVE, "mcap"),
    ]
    assert all(f.size == 1 and f.root == tmp_path for f in found.files)
    assert len(found.notes) == 2
    assert "x.csv.part" in found.notes[0]
    for part in ("documents 1 (README.txt)", "hidden or temporary 2 (.hidden.csv, ~$a.xlsx)", "pictures 1 (p.png)"):
        assert part in found.notes[1]


def test_links_pipes_and_circles_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "a.mcap").write_bytes(b"x")
    (tmp_path / "deep" / "up").symlink_to(tmp_path)
    (tmp_path / "again.mcap").symlink_to(tmp_path / "deep" / "a.mcap")
    (tmp_path / "nowhere.mcap").symlink_to(tmp_path / "gone")
    (tmp_path / "self.mcap").symlink_to(tmp_path / "self.mcap")
    (tmp_path / "folder.mcap").mkdir()
    os.mkfifo(tmp_path / "pipe.mcap")
    found = discover([tmp_path, tmp_path / "deep", tmp_path / "deep" / "a.mcap"])
    assert len(found.files) == 1
    text = "\n".join(found.notes)
    for name in ("nowhere.mcap", "self.mcap", "pipe.mcap", "folder.mcap"):
        assert name in text


def test_copies_and_hard_links_are_files_of_their_own(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"x")
    os.link(tmp_path / "a.mcap", tmp_path / "b.mcap")
    assert len(discover([tmp_path]).files) == 2


def test_another_lab_among_the_raw_files_is_passed_over_in_one_line(tmp_path: Path) -> None:
    """The tables of its pages were files without a mapping, each with a line of its own."""
    lab = tmp_path / "old-lab"
    for name in (
        "results.duckdb",
        "samples/protocol=chirp/a.parquet",
        "reports/data/a_survival.csv",
        "reports/index.html",
    ):
        (lab / name).parent.mkdir(parents=True, exist_ok=True)
        (lab / name).write_bytes(b"x")
    (tmp_path / "a.csv").write_text("t,F\n0,1\n")
    found = discover([tmp_path])
    assert [file.path.name for file in found.files] == ["a.csv"]
    assert found.notes == (f"{lab}: another lab: what dealab made is no raw data: passed over",)
    (lab / "samples" / "protocol=chirp" / "a.parquet").unlink()
    (lab / "samples" / "protocol=chirp").rmdir()
    (lab / "samples").rmdir()
    assert len(discover([tmp_path]).files) > 1, "a folder of results that is none"


def test_the_lab_inside_the_raw_folder_is_skipped(tmp_path: Path) -> None:
    (tmp_path / "lab" / "quarantine" / "x").mkdir(parents=True)
    (tmp_path / "lab" / "quarantine" / "x" / "bad.mcap").write_bytes(b"x")
    assert discover([tmp_path], skip=[tmp_path / "lab"]).files == ()


def test_missing_path_is_wrong_usage(tmp_path: Path) -> None:
    with pytest.raises(UsageError):
        discover([tmp_path / "nope"])


def test_broken_mapping_comes_with_the_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("F\n1\n")
    (tmp_path / "LICENSE").write_text("x")
    (tmp_path / "recordings.toml").write_text("[[files]]\nmatch = 3\n")
    (file,) = discover([tmp_path]).files
    assert isinstance(file.error, RefusedError)
    assert file.mapping is None


def test_ignored_and_odd_endings(tmp_path: Path) -> None:
    (tmp_path / "recordings.toml").write_text('[[files]]\nmatch = "cal*"\nkind = "ignore"\n' + TOML)
    for name in ("cal1.csv", "run.csv", "run.lvm"):
        (tmp_path / name).write_text("F\n1\n2\n")
    own = TOML.replace('[[files]]\nmatch = "*.csv"\n', 'format = "csv"\n').replace("files.", "")
    (tmp_path / "run.lvm.toml").write_text(own)
    found = discover([tmp_path])
    assert [(f.path.name, f.format) for f in found.files] == [("run.csv", "csv"), ("run.lvm", "csv")]
    assert any("cal1.csv" in note for note in found.notes)


def test_a_file_in_a_folder_that_cannot_be_listed_has_its_mapping(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "recordings.toml").write_text(TOML)
    (tmp_path / "a.csv").write_text("1\n")
    whole = discover([tmp_path / "a.csv"])

    def closed(path: Path) -> NoReturn:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("ingest.discover.os.scandir", closed)
    assert whole.files[0].mapping is not None
    assert discover([tmp_path / "a.csv"]) == whole


def test_a_mapping_is_found_again_and_one_that_came_or_went_meanwhile_waits(tmp_path: Path) -> None:
    (tmp_path / "recordings.toml").write_text(TOML)
    (tmp_path / "a.csv").write_text("1\n")
    (tmp_path / "b.mcap").write_bytes(b"x")
    mapped, native = discover([tmp_path]).files
    bare = replace(mapped, mapping=None)
    assert with_mapping(bare) == mapped
    assert with_mapping(native) == native
    (tmp_path / "recordings.toml").write_text("[[files]]\nmatch = 3\n")
    assert isinstance(with_mapping(bare).error, RefusedError)
    (tmp_path / "recordings.toml").unlink()
    assert isinstance(with_mapping(bare).error, PendingError)
    (tmp_path / "b.mcap.toml").write_text('kind = "ignore"\n')
    assert isinstance(with_mapping(native).error, PendingError)


def test_hostile_names_in_notes_are_escaped(tmp_path: Path) -> None:
    (tmp_path / "a\n\x1b[2J\u202e.part").write_bytes(b"")
    os.close(os.open(os.fsencode(tmp_path) + b"/\xff\xfe.part", os.O_CREAT | os.O_WRONLY))
    notes = discover([tmp_path]).notes
    assert len(notes) == 2
    assert all(note.isprintable() for note in notes)


# --- files that change -------------------------------------------------------------------------------------------


def test_growing_file_is_pending_only_when_it_grows(tmp_path: Path) -> None:
    names = {"grows.mcap": b"x", "rests.mcap": b"x", "whole.csv": b"1\n", "old.mcap": b"x"}
    for name, content in names.items():
        (tmp_path / name).write_bytes(content)
    os.utime(tmp_path / "old.mcap", (1, 1))
    slept = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        for name in ("grows.mcap", "whole.csv", "old.mcap"):
            with (tmp_path / name).open("ab") as file:
                file.write(b"more")

    found = growing(discover([tmp_path]).files, sleep=sleep)
    assert [f.path.name for f in found] == ["grows.mcap"]
    assert slept == [1.0]


def test_nothing_to_ask_means_no_waiting(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"\x89MCAP0\r\n" * 2)
    (tmp_path / "b.mcap").write_bytes(b"x")
    os.utime(tmp_path / "b.mcap", (time.time() - 61,) * 2)
    assert growing(discover([tmp_path]).files, sleep=lambda _: pytest.fail("slept")) == ()


def test_ends_of_formats(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    for content, expected in ((b"1\n", False), (b"1\r\n", False), (b"1", True), ("1\n".encode("utf-16-le"), False)):
        path.write_bytes(content)
        assert lacks_end(path, "csv") is expected


def test_hash_notices_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"x" * 4096)
    whole = file_sha256(path)
    assert whole == file_sha256(path, chunk=7)
    info = path.stat()
    check_unchanged(path, size=info.st_size, mtime_ns=info.st_mtime_ns)
    real = os.fstat
    looks = []

    def fstat(handle: int) -> os.stat_result:
        looks.append(handle)
        if len(looks) == 2:
            with path.open("ab") as file:
                file.write(b"more")
        return real(handle)

    monkeypatch.setattr(os, "fstat", fstat)
    with pytest.raises(PendingError, match="4096 to 4100 bytes"):
        file_sha256(path)
    with pytest.raises(PendingError):
        check_unchanged(path, size=info.st_size, mtime_ns=info.st_mtime_ns)
    with pytest.raises(PendingError):
        file_sha256(tmp_path / "gone")


# --- quarantine --------------------------------------------------------------------------------------------------

WHEN = datetime(2026, 3, 1, 2, tzinfo=UTC)
ERROR = RefusedError('unit "furlongs" is unknown', where="a.csv", expected="a unit of force", remedy="Correct it")


def test_quarantine_copies_and_tells_why(tmp_path: Path) -> None:
    raw, lab = tmp_path / "a.csv", tmp_path / "lab"
    raw.write_bytes(b"1,2\n")
    folder = quarantine(raw, lab, ERROR, sha256="abc", when=WHEN)
    assert folder.parent == lab / "quarantine"
    assert (folder / "a.csv").read_bytes() == b"1,2\n"
    reason = json.loads((folder / "reason.json").read_text())
    assert reason["problem"] == ERROR.problem
    assert reason["expected"] == "a unit of force"
    assert reason["sha256"] == "abc"
    assert reason["source_path"] == str(raw)
    assert reason["when"] == "2026-03-01T02:00:00+00:00"
    assert raw.exists()
    assert [e.folder for e in entries(lab)] == [folder]


def test_quarantine_again_replaces_and_release_removes(tmp_path: Path) -> None:
    raw, lab = tmp_path / "a.csv", tmp_path / "lab"
    raw.write_bytes(b"1\n")
    quarantine(raw, lab, ERROR, sha256="1", when=WHEN)
    same = quarantine(raw, lab, ERROR, sha256="1", when=datetime(2027, 1, 1, tzinfo=UTC))
    assert json.loads((same / "reason.json").read_text())["when"].startswith("2026")
    raw.write_bytes(b"2\n")
    folder = quarantine(raw, lab, RefusedError("still wrong"), sha256="2")
    assert (folder / "a.csv").read_bytes() == b"2\n"
    assert [e.reason["problem"] for e in entries(lab)] == ["still wrong"]
    assert release(raw, lab)
    assert not release(raw, lab)
    assert list((lab / "quarantine").iterdir()) == []


def test_files_of_the_same_name_do_not_meet(tmp_path: Path) -> None:
    folders = set()
    for day in ("mon", "tue"):
        (tmp_path / day).mkdir()
        (tmp_path / day / "a.csv").write_text(day)
        folders.add(quarantine(tmp_path / day / "a.csv", tmp_path / "lab", ERROR))
    assert len(folders) == 2


def test_large_and_unreadable_files_keep_their_reason(tmp_path: Path) -> None:
    raw, lab = tmp_path / "a.csv", tmp_path / "lab"
    raw.write_bytes(b"x" * 100)
    reason = json.loads((quarantine(raw, lab, ERROR, copy_limit=99) / "reason.json").read_text())
    assert (reason["copied"], reason["size"]) == (False, 100)
    gone = json.loads((quarantine(tmp_path / "gone.csv", lab, ERROR) / "reason.json").read_text())
    assert gone["copied"] is False
    assert "No such file" in gone["copy_error"]


def test_a_file_named_like_the_reason(tmp_path: Path) -> None:
    raw = tmp_path / "reason.json"
    raw.write_text("{}")
    folder = quarantine(raw, tmp_path / "lab", ERROR)
    assert sorted(p.name for p in folder.iterdir()) == ["file.json", "reason.json"]
    assert json.loads((folder / "reason.json").read_text())["problem"] == ERROR.problem


def test_hostile_names_stay_inside_the_lab(tmp_path: Path) -> None:
    lab = tmp_path / "lab"
    for name in (
        "..%2f..csv",
        "a'; DROP TABLE x;--.csv",
        "<script>.csv",
        "\u202egpj.csv",
        "-rf.csv",
        "x" * 250 + ".csv",
        "..csv",
        ". .csv",
    ):
        raw = tmp_path / name
        raw.write_bytes(b"1")
        folder = quarantine(raw, lab, RefusedError(f"bad {name}\x00\x1b"))
        assert folder.parent == lab / "quarantine"
        assert len(folder.name) <= 80
        assert folder.name[0].isalnum()
        assert json.loads((folder / "reason.json").read_text())["source_path"].endswith(name)
    odd = Path(os.fsdecode(os.fsencode(tmp_path) + b"/\xff\xfe.csv"))
    odd.write_bytes(b"1")
    quarantine(odd, lab, ERROR)
    assert len(entries(lab)) == 9


@given(st.text(max_size=300))
def test_safe_names(name: str) -> None:
    safe = safe_name(name)
    assert 1 <= len(safe) <= 60
    assert safe[0].isalnum()
    assert set(safe) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-")
    assert entry_name(Path("/x") / "a") == entry_name(Path("/x") / "a")


@pytest.mark.parametrize("name", ["run.mat.gz", "run.nc", "run.PRN", "run.wfm"])
def test_a_format_that_is_not_read_is_named(name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(b"1,2\n")
    (tmp_path / "photo.jpg").write_bytes(b"x")
    found = discover([tmp_path])
    assert found.files == ()
    assert len(found.notes) == 2
    assert f"{name}: a format that is not read: passed over; " in found.notes[0]
    assert "pictures 1 (photo.jpg)" in found.notes[1]


NAMES = [
    "LICENSE", "README.md", "notes.txt", "photo.PNG", "film.mp4", "fit.py", "SHA256SUMS", ".DS_Store", "~$list.xlsx", "run.tdms_index",
    "lives.rda", "lives.rds", "prony_terms.MPL", "survey.sav", "survey.xpt", "run.zst", "run.bin", "run.QQQ", "DESCRIPTION",
    "run.log", "run.part", "run7.toml", "notes_of_forces.csv", "license.dat",
]  # fmt: skip


def test_every_file_is_found_or_has_a_line(tmp_path: Path) -> None:
    """Files of unknown endings (`.rda`, `.MPL`, no ending), documents and misnamed mappings went without a word."""
    for name in NAMES:
        (tmp_path / name).write_bytes(b"x")
    found = discover([tmp_path])
    assert [file.path.name for file in found.files] == ["license.dat", "notes_of_forces.csv"]
    text = "\n".join(found.notes)
    for name in (
        "lives.rda",
        "lives.rds",
        "prony_terms.MPL",
        "survey.sav",
        "survey.xpt",
        "run.zst",
        "run.bin",
        "run.QQQ",
    ):
        assert f"{tmp_path / name}: a" in text
    for said in (
        "DESCRIPTION: an unknown format (its name has no ending)",
        "run7.toml: a TOML that belongs to nothing",
    ):
        assert said in text
    assert "R data: export it as CSV" in text
    (plain,) = [note for note in found.notes if "files that are no data" in note]
    for kind in (
        "documents 3",
        "hidden or temporary 2",
        "pictures 1",
        "films 1",
        "programs 1",
        "checksums 1",
        "indexes of TDMS files 1",
    ):
        assert kind in plain
    single = [name for name in NAMES if any(f"{tmp_path / name}: " in note for note in found.notes)]
    assert len(single) + 10 + len(found.files) == len(NAMES)


def test_many_files_that_are_passed_over_alike_do_not_drown_a_lab(tmp_path: Path) -> None:
    for number in range(300):
        (tmp_path / f"run{number:03}.wav").write_bytes(b"x")
        (tmp_path / f"picture{number:03}.png").write_bytes(b"x")
        (tmp_path / f"run{number:03}.json").write_bytes(b"{}")
    notes = discover([tmp_path]).notes
    assert len(notes) == 2 * 21 + 1
    assert any("run020.wav and 279 more: a format that is not read" in note for note in notes)
    assert "pictures 300 (picture000.png, picture001.png, picture002.png, …)" in notes[-1]


def test_a_file_given_twice_has_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.rda").write_bytes(b"x")
    assert len(discover([tmp_path, tmp_path / "a.rda"]).notes) == 1


def test_mappings_and_rig_files_have_a_use(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    (tmp_path / "given").mkdir()
    for name in ("recordings.toml", "a.csv.toml", "rigs/rig-a.toml", "given/rig-b.toml"):
        (tmp_path / name).write_text("")
    (tmp_path / "a.csv").write_text("1\n")
    passed: list[object] = []
    list(ingest.discover.discover([tmp_path], passed.append, rigs=tmp_path / "given"))
    assert passed == []
    assert [note.partition(": ")[0] for note in discover([tmp_path]).notes] == [str(tmp_path / "given" / "rig-b.toml")]
