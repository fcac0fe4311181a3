"""Workers that die, clocks that run back, files that cannot be read, labs that move; the harness in short."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NoReturn

import pytest

import ingest.intake
import pipeline.nightly.night
import pipeline.nightly.workers
from pipeline import Lab
from pipeline.lab.journal import DIAGNOSIS, GROUP, SPECIMEN
from pipeline.nightly import derive
from pipeline.nightly.night import nightly
from pipeline.nightly.stages import GROUPS
from schemas.tables import StageName, find_rows_made_by
from tests.conftest import ROOT
from tests.faults import sabotage
from tests.faults.harness import Bench, full_disk, kills, readers, two_at_once
from tests.faults.lab_state import content, healthy, left_over, samples, select
from tests.helpers.small_lab import RIG, copy_night, life, small_campaign

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Lab]:
    """A raw folder and the lab of a night over it."""
    folder = tmp_path_factory.mktemp("faults")
    raw = small_campaign(folder / "raw", lives=2)
    lab = Lab(folder / "lab")
    assert nightly([raw], lab, jobs=0).exit_status == 0
    return raw, lab


@pytest.fixture
def without_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)


def statuses(lab: Lab) -> dict[str, tuple[str, str]]:
    rows = select(lab, "SELECT source_path, status, problem FROM recordings")
    return {Path(path).stem: (status, problem or "") for path, status, problem in rows}


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
def test_a_lost_worker_costs_its_recording_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without_pages: None
) -> None:
    """Killed, out of memory, stuck: each tried once more alone, and told as an accident. Lost once: read after all."""
    monkeypatch.setattr(pipeline.nightly.workers, "perform", sabotage.perform)
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    for number, name in enumerate(("kill-1", "memory-1", "stuck-1", "killonce-1", "good-1", "good-2")):
        life(raw / f"{name}.mcap", number)
    lab.create()
    lab.settings.write_text("deadline_s = 6\nmemory_mb = 700\n")
    summary = nightly([raw], lab, jobs=2)
    found = statuses(lab)
    assert summary.exit_status == 3
    assert {name: status for name, (status, _) in found.items()} == {
        "kill-1": "pending",
        "memory-1": "pending",
        "stuck-1": "pending",
        "killonce-1": "ok",
        "good-1": "ok",
        "good-2": "ok",
    }
    assert "SIGKILL" in found["kill-1"][1] or "did not come back" in found["kill-1"][1]
    assert "more memory than a worker may have" in found["memory-1"][1]
    assert "longer than deadline_s allows" in found["stuck-1"][1]
    assert all("twice" in found[name][1] for name in ("kill-1", "memory-1", "stuck-1"))
    assert all("no verdict" in found[name][1] for name in ("kill-1", "memory-1", "stuck-1"))
    assert sum("an accident of the night" in line for line in summary.attention) == 3
    assert not lab.quarantine.exists()
    assert select(lab, "SELECT count(*) FROM lifetimes") == [(3,)]
    assert left_over(lab) == []
    assert healthy(lab) == []
    for name in ("memory-1", "stuck-1"):
        (raw / f"{name}.mcap").unlink()
    again = nightly([raw], lab, jobs=2)
    assert again.analysed == 0
    assert "2 nights in a row" in statuses(lab)["kill-1"][1], "accidents are tried again every night, and counted"
    assert select(lab, "SELECT nights, first_run_id, run_id FROM accidents") == [(2, "000001", "000002")]
    monkeypatch.undo()
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    assert nightly([raw], lab, jobs=2).exit_status == 0
    assert statuses(lab)["kill-1"] == ("ok", "")
    assert select(lab, "SELECT count(*) FROM accidents") == [(0,)]


@pytest.mark.long
def test_an_accident_takes_no_earlier_result_away(
    made: tuple[Path, Lab], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without_pages: None
) -> None:
    """A folder of rig files without rights, a broken library, a failing disk: earlier results stay, all of it is told."""
    raw, lab = copy_night(made[0], made[1].folder, tmp_path)
    before = content(lab)
    is_file = Path.is_file

    def refuse(path: Path) -> bool:
        if path.parent.name == "rigs":
            raise PermissionError(13, "Permission denied", str(path))
        return is_file(path)

    def fail(_error: Exception) -> Callable[..., Any]:
        def read(*_: Any) -> Any:
            raise _error

        return read

    for number, (where, name, trouble) in enumerate(
        (
            (Path, "is_file", refuse),
            (ingest.intake, "read_raw", fail(ModuleNotFoundError("No module named 'numpy.x'"))),
            (ingest.intake, "read_raw", fail(OSError(5, "Input/output error"))),
        ),
        start=2,
    ):
        with monkeypatch.context() as broken:
            broken.setattr(where, name, trouble)
            (raw / "rigs" / "rig-a.toml").write_text(RIG + f"# {number}\nload_cell_damping_n_s_per_mm = 0.{number}\n")
            summary = nightly([raw], lab, jobs=0)
        assert summary.exit_status == 3
        assert sum("an accident of the night" in line for line in summary.attention) == 4, summary.attention
        now = content(lab)
        assert all(now[table] == before[table] for table in ("model_fits", "lifetimes", "carried"))
        assert select(lab, "SELECT count(*) FROM recordings WHERE status = 'ok'") == [(4,)]
    (raw / "rigs" / "rig-a.toml").write_text(RIG)
    assert nightly([raw], lab, jobs=0).exit_status == 0
    assert content(lab) == before


@pytest.mark.long
@pytest.mark.parametrize("stage", [SPECIMEN, DIAGNOSIS, GROUP])
def test_an_accident_of_an_analysis_takes_no_earlier_result_away(
    made: tuple[Path, Lab], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without_pages: None, stage: StageName
) -> None:
    """A worker that was killed twice, a failing disk: what the night before found stands until it is made again."""
    raw, lab = copy_night(made[0], made[1].folder, tmp_path)
    before = content(lab)
    (raw / "rigs" / "rig-a.toml").write_text(RIG + "load_cell_damping_n_s_per_mm = 0.2\n")
    with monkeypatch.context() as broken:
        broken.setitem(derive._ANALYSES, stage, _break_disk)
        summary = nightly([raw], lab, jobs=0)
    assert summary.exit_status == 3
    assert any("an accident of the night" in line for line in summary.attention), summary.attention
    now = content(lab)
    kept = {name for group in (GROUPS if stage == GROUP else ("",)) for name in find_rows_made_by(stage, group)}
    kept -= {"model_fits", "assumptions"} if stage == DIAGNOSIS else set()  # those of specimens are made again
    assert any(before[name] for name in kept), "there is something to lose"
    assert {name for name in kept if now[name] != before[name]} == set()
    assert healthy(lab) == []
    (raw / "rigs" / "rig-a.toml").write_text(RIG)
    assert nightly([raw], lab, jobs=0).exit_status == 0
    assert content(lab) == before


def _break_disk(_task: object) -> NoReturn:
    raise OSError(5, "Input/output error")


def test_what_fails_unexpectedly_is_tried_again(
    made: tuple[Path, Lab], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without_pages: None
) -> None:
    """A defect, or a foreign module in a library's place, is no verdict on the content."""
    lab, lives = Lab(tmp_path / "lab"), sorted(made[0].glob("L-*.mcap"))
    with monkeypatch.context() as broken:
        broken.setattr(ingest.intake, "read_raw", lambda *_: json.of_somebody_else)  # type: ignore[attr-defined]
        assert nightly(lives, lab, jobs=0).exit_status == 3
    assert {status for status, _ in statuses(lab).values()} == {"quarantined"}
    assert nightly(lives, lab, jobs=0).exit_status == 0
    assert {status for status, _ in statuses(lab).values()} == {"ok"}


def test_a_clock_set_back_changes_nothing(
    made: tuple[Path, Lab], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, without_pages: None
) -> None:
    raw, lab = made[0], Lab(tmp_path / "lab")
    shutil.copytree(made[1].folder, lab.folder)
    before = content(lab)
    back = 400 * 86_400

    class Earlier(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> datetime:
            return datetime.fromtimestamp(time.time() - back, tz or UTC)

    clock, clock_ns = time.time, time.time_ns
    monkeypatch.setattr(pipeline.nightly.night, "datetime", Earlier)
    monkeypatch.setattr(time, "time", lambda: clock() - back)
    monkeypatch.setattr(time, "time_ns", lambda: clock_ns() - back * 10**9)
    summary = nightly([raw], lab, jobs=0)
    assert (summary.exit_status, summary.analysed, summary.counts.pending) == (0, 0, 0)
    assert content(lab) == before
    monkeypatch.undo()
    runs = select(lab, "SELECT run_id, started_at FROM runs ORDER BY run_id")
    assert [run for run, _ in runs] == ["000001", "000002"], "runs are in order by their number"
    assert runs[1][1] < runs[0][1]


@pytest.mark.long
def test_unreadable_files_and_folders(made: tuple[Path, Lab], tmp_path: Path) -> None:
    """A file without rights is refused, a folder without rights passed over with a note; both are taken up later."""
    command = [sys.executable, "-m", "pipeline.cli"]
    if os.geteuid() == 0:  # root may read everything unless that right is taken away
        if shutil.which("setpriv") is None:
            pytest.skip("root needs setpriv to do without the rights of root")
        command = ["setpriv", "--bounding-set=-dac_override,-dac_read_search", *command]
    raw, lab = small_campaign(tmp_path / "raw", chirps=0, lives=2), Lab(tmp_path / "lab")
    (raw / "closed").mkdir()
    life(raw / "closed" / "L-7.mcap", 7)
    os.chmod(raw / "L-1.mcap", 0)
    os.chmod(raw / "closed", 0)

    def night() -> subprocess.CompletedProcess[str]:
        options = ["nightly", str(raw), "--lab", str(lab.folder), "--jobs", "0"]
        return subprocess.run([*command, *options], cwd=ROOT, capture_output=True, text=True, check=False)

    try:
        first = night()
    finally:
        os.chmod(raw / "L-1.mcap", 0o600)
        os.chmod(raw / "closed", 0o700)
    assert first.returncode == 3, first.stderr
    assert "Traceback" not in first.stderr
    assert statuses(lab)["L-1"][0] == "quarantined"
    assert "cannot be read" in statuses(lab)["L-1"][1]
    (notes,) = select(lab, "SELECT notes FROM runs")[0]
    assert any("closed" in note and "passed over" in note for note in json.loads(notes))
    assert night().returncode == 0
    assert {name for name, (status, _) in statuses(lab).items() if status == "ok"} >= {"L-1", "L-7"}
    assert healthy(lab) == []


def test_a_lab_works_in_another_place(made: tuple[Path, Lab], tmp_path: Path) -> None:
    moved = Lab(tmp_path / "somewhere else" / "lab ü")
    moved.folder.parent.mkdir()
    shutil.copytree(made[1].folder, moved.folder)
    assert healthy(moved) == []
    before = content(moved), samples(moved)
    summary = nightly([made[0]], moved, jobs=0)
    assert (summary.exit_status, summary.analysed) == (0, 0)
    assert (content(moved), samples(moved)) == before
    absolute = str(made[1].folder)
    assert not [p for p in moved.reports.rglob("*.html") if absolute in p.read_text()]
    for path in moved.samples_folder.rglob("*.parquet"):
        assert absolute.encode() not in path.read_bytes()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(tmp_path_factory.mktemp("bench"), chirps=0, lives=2)


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")
def test_the_harness_in_short(bench: Bench) -> None:
    """`make faults` does the same with more recordings, 50 times, with 20 publishes and a dozen sizes of disk."""
    for result in (
        kills(bench, 1, seed=11),
        two_at_once(bench, 1),
        readers(bench, 2),
        full_disk(bench, (1 << 12, 1 << 19)),
    ):
        assert result.wrong == (), result.done
        assert result.times
