"""Nothing outside the lab is written or removed, whatever links are in it; what is lost in it comes back."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

import pytest

import pipeline.nightly.night
from ingest.paths import spell_path
from ingest.quarantine import quarantine
from pipeline import Lab
from pipeline.cli import main
from pipeline.lab.annotations import annotate
from pipeline.lab.retention import Rule, prune
from pipeline.nightly.night import nightly
from schemas.errors import LabError, RefusedError
from tests.faults.lab_state import content, healthy, left_over, samples, select
from tests.helpers.small_lab import copy_night, life, make_lab_of_one_life

pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.skipif(os.name == "nt", reason="links of Linux and macOS"),
]
PLACES = (
    ".work",
    ".work/journal",
    ".work/samples",
    ".work/building.duckdb.tmp",
    ".remote",
    "samples",
    "samples/protocol=lifetime",
    "reports",
    "reports/recordings",
    "quarantine",
    "quarantine/x",
)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Lab]:
    return make_lab_of_one_life(tmp_path_factory.mktemp("links"))


@pytest.fixture(autouse=True)
def without_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)


def list_files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_folders_behind_links_stay_as_they_are(made: tuple[Path, Lab], tmp_path: Path) -> None:
    lab, elsewhere = Lab(tmp_path / "lab"), tmp_path / "elsewhere"
    shutil.copytree(made[1].folder, lab.folder)
    (elsewhere / "journal").mkdir(parents=True)
    for name in ("thesis.tex", "journal/half.entry", "precious.parquet", "x.tmp"):
        (elsewhere / name).write_text("precious")
    before = list_files(elsewhere)
    for place in PLACES:
        link, own = lab.folder / place, tmp_path / "own"
        link.parent.mkdir(parents=True, exist_ok=True)
        if link.exists():
            link.rename(own)
        link.symlink_to(elsewhere)
        with pytest.raises(LabError, match="a link in the lab"):
            nightly([made[0]], lab, jobs=0)
        with pytest.raises(LabError, match="a link in the lab"):
            prune(lab, Rule(gone=True))
        assert main(["report", "--lab", str(lab.folder)]) == 1
        assert list_files(elsewhere) == before
        link.unlink()
        if own.exists():
            own.rename(link)
    assert nightly([made[0]], lab, jobs=0).exit_status == 0, "the remedy helps"
    assert healthy(lab) == []


@pytest.mark.parametrize("name", [".lock", ".lock-holder.json", "annotations.jsonl"])
def test_files_behind_links_stay_as_they_are(name: str, made: tuple[Path, Lab], tmp_path: Path) -> None:
    lab, elsewhere = Lab(tmp_path / "lab"), tmp_path / "elsewhere"
    shutil.copytree(made[1].folder, lab.folder)
    elsewhere.write_text("precious")
    (lab.folder / name).unlink(missing_ok=True)
    (lab.folder / name).symlink_to(elsewhere)
    with pytest.raises(LabError):
        nightly([made[0]], lab, jobs=0)
    with pytest.raises(LabError):
        annotate(lab, "L-1", "exclude", "slipped")
    assert elsewhere.read_text() == "precious"


def test_a_lab_may_be_reached_through_a_link(made: tuple[Path, Lab], tmp_path: Path) -> None:
    shutil.copytree(made[1].folder, tmp_path / "there")
    (tmp_path / "lab").symlink_to(tmp_path / "there")
    assert nightly([made[0]], Lab(tmp_path / "lab"), jobs=0).exit_status == 0


@pytest.mark.long
def test_lost_samples_come_back_the_same_night(made: tuple[Path, Lab], tmp_path: Path) -> None:
    """As `doctor` says: what is unreadable is removed, and the next nightly over the raw files makes it again."""
    lab = Lab(tmp_path / "lab")
    shutil.copytree(made[1].folder, lab.folder)
    before, rows = samples(lab), content(lab)
    (file,) = lab.samples_folder.rglob("*.parquet")
    whole = file.read_bytes()
    for damaged in (b"", whole[: len(whole) // 2], whole[:1500] + bytes([whole[1500] ^ 1]) + whole[1501:]):
        file.write_bytes(damaged)
        assert any("unreadable" in finding for finding in healthy(lab)), "checksums of all samples are compared"
        assert any("remove them and run the nightly" in finding for finding in healthy(lab))
    shutil.rmtree(lab.samples_folder)
    assert any("remove them and run the nightly" in finding for finding in healthy(lab))
    assert nightly([made[0]], lab, jobs=0).exit_status == 0
    assert samples(lab) == before
    assert content(lab) == rows
    assert healthy(lab) == []


def test_half_written_files_of_the_killed_go(made: tuple[Path, Lab], tmp_path: Path) -> None:
    """Also as `doctor` says."""
    lab = Lab(tmp_path / "lab")
    shutil.copytree(made[1].folder, lab.folder)
    for name in ("samples/.a.tmp", "reports/.b.tmp", "quarantine/.partial-x/y", "samples/protocol=x/.c.tmp"):
        path = lab.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("half")
    assert any("temporary" in finding for finding in healthy(lab))
    assert nightly([made[0]], lab, jobs=0).exit_status == 0
    assert healthy(lab) == []
    assert left_over(lab) == []


def test_quarantine_is_as_readable_as_the_lab_and_holds_nothing_behind_links(tmp_path: Path) -> None:
    raw, lab, secret = tmp_path / "raw", Lab(tmp_path / "lab"), tmp_path / "secret"
    raw.mkdir()
    life(raw / "L-1.mcap", 1)
    (raw / "bad.mcap").write_bytes(b"no recording")
    (secret / "below").mkdir(parents=True)
    (secret / "key.mcap").write_bytes(b"secret")
    (secret / "below" / "key.mcap").write_bytes(b"secret below")
    (raw / "link.mcap").symlink_to(secret / "key.mcap")
    (raw / "folder").symlink_to(secret / "below")
    assert nightly([raw], lab, jobs=0).exit_status == 3
    assert select(lab, "SELECT count(*) FROM recordings WHERE status = 'quarantined'") == [(3,)]
    copies = list_files(lab.quarantine)
    assert sorted(value for name, value in copies.items() if not name.endswith("reason.json")) == [b"no recording"]
    assert sum(b"a link leads to" in value for value in copies.values()) == 2
    usual = stat.S_IMODE(lab.samples_folder.stat().st_mode)
    assert {stat.S_IMODE(path.stat().st_mode) for path in lab.quarantine.iterdir()} == {usual}
    assert healthy(lab) == []


def test_copies_of_refused_files_that_no_row_speaks_of_go_unless_they_may_be_the_last(
    made: tuple[Path, Lab], tmp_path: Path
) -> None:
    """A night that ended before it published leaves them, and so does a database that was moved away."""
    raw, lab = copy_night(made[0], made[1].folder, tmp_path)
    for name in ("mended.mcap", "gone.mcap", os.fsdecode(b"no-utf8-\xff.mcap")):
        (raw / name).write_bytes(b"half a copy")
        quarantine(raw / name, lab.folder, RefusedError("too short"), sha256="0" * 64, place=spell_path(raw / name))
        (raw / name).unlink()
    life(raw / "mended.mcap", 2)
    life(raw / "L-3.mcap", 3).rename(raw / os.fsdecode(b"no-utf8-\xff.mcap"))
    (raw / "refused.mcap").write_bytes(b"no recording")
    os.utime(raw / "refused.mcap", (0, 0))
    for _ in range(2):
        nightly([raw], lab, jobs=0)
        assert sorted(entry.name.rpartition("-")[0] for entry in lab.quarantine.iterdir()) == ["gone", "refused"]
    (finding,) = healthy(lab)
    assert "gone-" in finding


def test_a_folder_in_the_place_of_samples_is_named(tmp_path: Path) -> None:
    raw, lab = make_lab_of_one_life(tmp_path)
    (samples,) = lab.samples_folder.rglob("*.parquet")
    samples.unlink()
    samples.mkdir()
    with pytest.raises(LabError, match="stands in the place") as told:
        nightly([raw], lab, jobs=0)
    assert str(samples) in str(told.value)
    samples.rmdir()
    assert nightly([raw], lab, jobs=0).exit_status == 0
    assert samples.is_file()
