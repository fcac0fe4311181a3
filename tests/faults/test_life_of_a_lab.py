"""What a lab lives through: retention, backup and restore, and software newer than the lab."""

from __future__ import annotations

import shutil
import subprocess
import tarfile
from datetime import UTC, datetime, timedelta
from pathlib import Path

import duckdb
import pytest

import pipeline.nightly.night
from pipeline import Lab
from pipeline.cli import main
from pipeline.lab.retention import Rule, plan_removal, prune
from pipeline.nightly.night import nightly
from schemas.tables import TABLES
from tests.conftest import ROOT
from tests.faults.lab_state import content, healthy, select
from tests.helpers.small_lab import START, copy_night, life, small_campaign

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")
LABS = ROOT / "tests" / "faults" / "labs"


@pytest.fixture(autouse=True)
def without_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A raw folder and the lab of a first night over it."""
    folder = tmp_path_factory.mktemp("life")
    raw = small_campaign(folder / "raw", lives=2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
        nightly([raw], Lab(folder / "lab"), jobs=0)
    return raw, folder / "lab"


@pytest.fixture
def night(made: tuple[Path, Path], tmp_path: Path) -> tuple[Path, Lab]:
    """The same in folders of its own."""
    return copy_night(*made, tmp_path)


@pytest.fixture
def refused(night: tuple[Path, Lab]) -> tuple[Path, Lab]:
    """The same after another night, which refused a file."""
    raw, lab = night
    (raw / "broken.mcap").write_bytes(b"no recording")
    assert nightly([raw], lab, jobs=0).exit_status == 3
    return raw, lab


def files(lab: Lab) -> set[str]:
    return {path.relative_to(lab.folder).as_posix() for path in lab.folder.rglob("*") if path.is_file()}


# --- retention ----------------------------------------------------------------------------------------------------------


def test_a_dry_run_says_what_would_go_and_removes_nothing(
    refused: tuple[Path, Lab], capsys: pytest.CaptureFixture[str]
) -> None:
    raw, lab = refused
    before, held = content(lab), files(lab)
    (raw / "L-0.mcap").unlink()
    options = ["--samples-days", "0", "--quarantine-days", "0", "--gone", "--lab", str(lab.folder)]
    assert main(["prune", "--dry-run", *options]) == 0
    said = capsys.readouterr().out
    assert "samples: 4 files" in said
    assert "copies of refused files: 1 files" in said
    assert "Nothing was removed." in said
    assert (content(lab), files(lab)) == (before, held)


def test_old_samples_go_and_their_results_stay(night: tuple[Path, Lab]) -> None:
    raw, lab = night
    before = content(lab)
    now = START + timedelta(days=10, minutes=1.5)
    found = prune(lab, Rule(samples_days=10), now)
    pruned = [row["recording_id"] for row in found.bare]
    assert 0 < len(pruned) < 4
    after = content(lab)
    assert {name for name in after if after[name] != before[name]} == {"recordings"}
    rows = select(lab, "SELECT recording_id FROM recordings WHERE samples_path IS NULL AND status = 'ok'")
    assert sorted(name for (name,) in rows) == sorted(pruned)
    assert len(list(lab.samples_folder.rglob("*.parquet"))) == 4 - len(pruned)
    assert healthy(lab) == []
    assert nightly([raw], lab, jobs=0).analysed == 0, "samples are no reason to read anything again"
    assert prune(lab, Rule(samples_days=10), now).paths == []


@pytest.mark.long
def test_recordings_that_have_gone_are_forgotten(night: tuple[Path, Lab]) -> None:
    raw, lab = night
    (raw / "P-1-chirp-1.mcap").unlink()
    nightly([raw], lab, jobs=0)
    assert select(lab, "SELECT recording_id FROM recordings WHERE NOT source_present") == [("P-1-chirp-1",)]
    found = prune(lab, Rule(gone=True))
    assert [row["recording_id"] for row in found.forgotten] == ["P-1-chirp-1"]
    assert nightly([raw], lab, jobs=0).analysed > 0
    assert healthy(lab) == []
    fresh = Lab(lab.folder.with_name("fresh"))
    nightly([raw], fresh, jobs=0)
    assert content(lab) == content(fresh), "as if it had never been there"


def test_a_specimen_goes_with_the_last_of_its_recordings(night: tuple[Path, Lab]) -> None:
    raw, lab = night
    for path in raw.glob("P-1-*.mcap"):
        path.unlink()
    nightly([raw], lab, jobs=0)
    assert select(lab, "SELECT 1 FROM model_fits WHERE specimen_id = 'P-1'")
    prune(lab, Rule(gone=True))
    for table in ("model_fits", "diagnoses", "diagnosis_candidates", "diagnosis_parameters"):
        assert select(lab, f"SELECT 1 FROM {table} WHERE specimen_id = 'P-1'") == []
    assert healthy(lab) == []
    nightly([raw], lab, jobs=0)
    fresh = Lab(lab.folder.with_name("fresh"))
    nightly([raw], fresh, jobs=0)
    assert content(lab) == content(fresh), "as if it had never been there"


def test_copies_of_refused_files_go_and_their_reasons_stay(refused: tuple[Path, Lab]) -> None:
    raw, lab = refused
    assert plan_removal(lab, Rule(quarantine_days=1)).paths == []
    later = datetime.now(UTC) + timedelta(days=2)
    (copy,) = prune(lab, Rule(quarantine_days=1), later).paths
    assert not copy.exists()
    assert (copy.parent / "reason.json").exists()
    assert healthy(lab) == []
    assert nightly([raw], lab, jobs=0).exit_status == 3


def test_samples_that_no_row_speaks_of_go(night: tuple[Path, Lab]) -> None:
    _, lab = night
    stray = lab.samples_folder / "protocol=chirp" / "month=2020-01" / "nobody.parquet"
    stray.parent.mkdir(parents=True)
    stray.write_bytes(b"x")
    assert healthy(lab) != []
    prune(lab, Rule())
    assert healthy(lab) == []


# --- backup -------------------------------------------------------------------------------------------------------------


def test_backup_and_restore_as_the_readme_says(night: tuple[Path, Lab], tmp_path: Path) -> None:
    raw, lab = night
    text = (ROOT / "pipeline" / "nightly" / "README.md").read_text(encoding="utf-8")
    commands = [line.strip() for line in text.splitlines() if "backup.tar" in line and "tar -C" in line]
    assert len(commands) == 2, "one to keep, one to bring back"
    if shutil.which("flock") is None:
        pytest.skip("flock is not on this machine")
    before = content(lab)
    subprocess.run(commands[0].split("#")[0], shell=True, cwd=tmp_path, check=True)
    shutil.rmtree(lab.folder)
    subprocess.run(commands[1].split("#")[0], shell=True, cwd=tmp_path, check=True)
    assert content(lab) == before
    assert healthy(lab) == []
    assert nightly([raw], lab, jobs=0).analysed == 0


# --- newer software -----------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("kept", sorted(LABS.glob("*.tar.xz")), ids=lambda path: path.name.removesuffix(".tar.xz"))
def test_labs_of_earlier_software_are_taken_over(kept: Path, tmp_path: Path) -> None:
    with tarfile.open(kept) as archive:
        # The filter's argument is newer than Python 3.11.0, the attribute is asked by all.
        archive.extraction_filter = getattr(tarfile, "data_filter", lambda member, _: member)
        archive.extractall(tmp_path)
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    with duckdb.connect(str(lab.database), read_only=True) as connection:
        runs = connection.execute("SELECT run_id, started_at FROM runs ORDER BY run_id").fetchall()
        lives = connection.execute("SELECT specimen_id, lifetime_s, failed FROM lifetimes ORDER BY ALL").fetchall()
        models = connection.execute("SELECT specimen_id, k0_n_per_mm FROM best_models ORDER BY ALL").fetchall()
    (tmp_path / "new").mkdir()
    life(tmp_path / "new" / "L-9.mcap", 9)
    assert nightly([tmp_path / "new"], lab, jobs=0).exit_status == 0, "the old raw folder is not needed for it"
    for name, table in TABLES.items():
        assert {c for (c,) in select(lab, f"SELECT column_name FROM duckdb_columns() WHERE table_name = '{name}'")} == {
            column.name for column in table.columns
        }
    assert select(lab, "SELECT run_id, started_at FROM runs ORDER BY run_id")[: len(runs)] == runs
    after = select(
        lab, "SELECT specimen_id, lifetime_s, failed FROM lifetimes WHERE recording_id <> 'L-9' ORDER BY ALL"
    )
    assert after == lives
    again = dict(select(lab, "SELECT specimen_id, k0_n_per_mm FROM best_models"))
    assert again == pytest.approx(dict(models), rel=0.01)
    assert select(lab, "SELECT recording_id FROM exclusions") == [("L-1",)]
    nightly([raw], lab, jobs=0)
    fresh = Lab(tmp_path / "fresh")
    shutil.copyfile(lab.annotations, (fresh.create(), fresh.annotations)[1])
    nightly([tmp_path / "new", raw], fresh, jobs=0)
    old, new = content(lab), content(fresh)
    different = {name for name in new if len(old[name]) != len(new[name])}
    assert different <= {"recordings"}, "the old raw folder was elsewhere, so its rows of then are duplicates' homes"
    assert healthy(lab) == []
