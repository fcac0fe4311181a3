"""The nightly, whatever happens: again, changed, copied, in conflict, half written, killed, twice at once."""

from __future__ import annotations

import gc
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from filelock import FileLock

import ingest.intake
import pipeline.analyse.recording as analyse
import pipeline.nightly.look
import pipeline.nightly.night
import pipeline.nightly.stages
from pipeline import Lab
from pipeline.commands.show.status import describe_lab
from pipeline.lab.annotations import annotate
from pipeline.lab.lock import hold_lab
from pipeline.nightly.look import has_newer_folder
from pipeline.nightly.night import Summary, nightly
from reports.build import build_reports
from schemas.errors import LabError, UsageError
from schemas.numbers import NBSP, seconds
from schemas.tables import TABLES
from tests.conftest import ROOT
from tests.faults.harness import STAGES, finished
from tests.faults.lab_state import content, healthy, select
from tests.helpers import mcap_files
from tests.helpers.small_lab import RIG, chirp, copy_night, life, small_campaign

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

LIVES = {"group:survival", "group:weak_regions"}
"""What is made from the lives of all specimens."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A raw folder and the lab of a first night over it, pages included."""
    folder = tmp_path_factory.mktemp("night")
    raw = small_campaign(folder / "raw")
    summary = nightly([raw], Lab(folder / "lab"), jobs=0)
    assert summary.report_problem is None
    assert summary.attention == ()
    assert summary.exit_status == 0
    return raw, folder / "lab"


@pytest.fixture
def without_pages(monkeypatch: pytest.MonkeyPatch) -> None:
    """The pages have tests of their own."""
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)


@pytest.fixture
def night(made: tuple[Path, Path], tmp_path: Path, without_pages: None) -> Callable[..., Summary]:
    """Runs the nightly over a copy of that folder, in a copy of that lab; `raw` and `lab` are its attributes."""
    raw, lab = copy_night(*made, tmp_path)

    def run(*paths: Path, jobs: int = 0, **options: Any) -> Summary:
        return nightly(list(paths) or [raw], lab, jobs=jobs, **options)

    run.raw, run.lab = raw, lab  # type: ignore[attr-defined]
    return run


def statuses(lab: Lab) -> dict[str, str]:
    rows = select(lab, "SELECT source_path, status FROM recordings")
    return {Path(path).name: status for path, status in rows}


def redone(lab: Lab) -> set[str]:
    """Stages and recordings that the last run made again."""
    rows = select(
        lab,
        "SELECT coalesce(r.recording_id, i.item_id) FROM items i "
        "LEFT JOIN recordings r ON i.item_id = 'recording:' || r.source_sha256 AND r.status <> 'duplicate' "
        "WHERE i.run_id = (SELECT max(run_id) FROM runs)",
    )
    return {name for (name,) in rows}


def test_a_first_night_fills_the_lab(made: tuple[Path, Path]) -> None:
    lab = Lab(made[1])
    assert healthy(lab) == []
    assert set(statuses(lab).values()) == {"ok"}
    assert len(statuses(lab)) == 6
    assert select(lab, "SELECT specimen_id FROM best_models") == [("P-1",)]
    (k0,) = select(lab, "SELECT k0_n_per_mm FROM best_models")[0]
    assert k0 == pytest.approx(40 / 39, rel=0.02), "1 N/mm at the cell is 40/39 N/mm of film behind a cell of 40 N/mm"
    lives = dict(select(lab, "SELECT specimen_id, lifetime_s FROM lifetimes WHERE failed"))
    assert lives == {"L-1": pytest.approx(1.3, abs=0.02), "L-3": pytest.approx(1.9, abs=0.02)}
    at_3_s = dict(select(lab, "SELECT configuration, survival FROM survival_at(3)"))
    assert at_3_s == {"A": pytest.approx(0.5), "B": pytest.approx(0.5)}
    assert (lab.reports / "index.html").is_file()
    assert {p.name for p in lab.folder.iterdir()} == {".lock", "results.duckdb", "samples", "reports"}
    paths = [path for (path,) in select(lab, "SELECT samples_path FROM recordings")]
    assert all((lab.folder / path).is_file() for path in paths)


def test_terminal_and_pages_say_one_time_of_a_night(made: tuple[Path, Path], tmp_path: Path) -> None:
    """The pages were written before the night ended, and had said less than the terminal did: 642 s of 761 s."""
    raw, lab = copy_night(*made, tmp_path)
    said = re.search(r"; took (.+), its pages .+ more[.]$", nightly([raw], lab, jobs=0).paragraph())
    assert said is not None
    page = (lab.reports / "index.html").read_text(encoding="utf-8").replace(NBSP, " ")
    assert re.findall(r"took ([^<·]+?) *·", page) == [said[1]]
    (took_s,) = select(lab, "SELECT seconds FROM nights ORDER BY run_id DESC LIMIT 1")[0]
    assert seconds(took_s).replace(NBSP, " ") == said[1]


def test_nothing_new_does_nothing_and_says_so(night: Any) -> None:
    before = content(night.lab)
    summary = night()
    assert (summary.counts.reused, summary.counts.ingested, summary.analysed) == (6, 0, 0)
    assert "Nothing had to be done again" in summary.paragraph()
    assert content(night.lab) == before
    assert select(night.lab, "SELECT reused, ingested FROM runs ORDER BY run_id DESC LIMIT 1") == [(6, 0)]
    assert redone(night.lab) == set()


@pytest.mark.long
def test_a_night_with_nothing_new_imports_nothing_heavy(made: tuple[Path, Path], tmp_path: Path) -> None:
    """Importing takes longer than such a night's work."""
    lab = shutil.copytree(made[1], tmp_path / "lab")
    program = (
        "import sys\nfrom pathlib import Path\nfrom pipeline import Lab\nfrom pipeline.nightly.night import nightly\n"
        f"nightly([{os.fspath(made[0])!r}], Lab(Path({os.fspath(lab)!r})), jobs=1)\n"
        f"summary = nightly([{os.fspath(made[0])!r}], Lab(Path({os.fspath(lab)!r})), jobs=1)\n"
        "print(summary.analysed, summary.report_problem)\n"
        "heavy = ('pandas', 'scipy', 'pint', 'pyarrow.compute', 'matplotlib')\n"
        "print([name for name in heavy if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    assert found.stdout.splitlines() == ["0 None", "[]"]


def run_with_workers(raw: Path, lab: Path, jobs: int) -> list[str]:
    """What a process tells of its night: how many were new and whether the report failed; its heavy imports."""
    program = (
        "import sys\nfrom pathlib import Path\nfrom pipeline import Lab\nfrom pipeline.nightly.night import nightly\n"
        f"summary = nightly([{os.fspath(raw)!r}], Lab(Path({os.fspath(lab)!r})), jobs={jobs})\n"
        "print(summary.counts.ingested, summary.report_problem)\n"
        "print([name for name in ('pandas', 'scipy') if name in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    return found.stdout.splitlines()


@pytest.mark.long
def test_workers_give_the_same_as_this_process_and_spare_it_the_heavy_imports(night: Any, tmp_path: Path) -> None:
    fresh = Lab(tmp_path / "fresh")
    assert run_with_workers(night.raw, fresh.folder, jobs=2) == ["6 None", "[]"]
    parallel, serial = content(fresh), content(night.lab)
    for name in TABLES:
        assert parallel.get(name) == serial.get(name), name
    life(night.raw / "L-8.mcap", 8)
    assert run_with_workers(night.raw, fresh.folder, jobs=1) == ["1 None", "[]"]
    assert redone(fresh) == {"L-8"} | LIVES


def test_folders_tell_that_something_is_new(made: tuple[Path, Path], tmp_path: Path) -> None:
    raw, lab = shutil.copytree(made[0], tmp_path / "raw"), Lab(tmp_path / "lab")
    deep = raw / "a" / "b"
    deep.mkdir(parents=True)
    assert has_newer_folder([raw], lab), "nothing is published yet"
    shutil.copytree(made[1], lab.folder)
    lab.database.touch()
    time.sleep(0.05)
    assert not has_newer_folder([raw, raw / "L-1.mcap", "s3://bucket/raw", tmp_path / "gone"], lab)
    life(deep / "L-9.mcap", 9)
    assert has_newer_folder([raw], lab)


@pytest.mark.long
def test_one_new_recording_redoes_what_it_touches(night: Any) -> None:
    life(night.raw / "L-9.mcap", 9)
    night()
    assert redone(night.lab) == {"L-9"} | LIVES
    chirp(night.raw / "P-1-chirp-9.mcap", 9)
    night()
    assert redone(night.lab) == {"P-1-chirp-9", "specimen:P-1", "diagnosis:P-1"}


@pytest.mark.long
def test_a_changed_rig_file_redoes_what_depends_on_it_and_a_remark_does_not(night: Any) -> None:
    rig = night.raw / "rigs" / "rig-a.toml"
    rig.write_text("# weighed on the first of March\n" + RIG)
    assert night().analysed == 0
    rig.write_text(RIG.replace("0.05\n", "0.06\n"))
    night()
    assert "specimen:P-1" in redone(night.lab)
    rows = select(night.lab, "SELECT metadata FROM recordings WHERE recording_id = 'P-1-chirp-0'")
    assert json.loads(rows[0][0])["rig"]["clamp_mass_kg"] == "0.06"
    other = night.raw / "rigs" / "rig-b.toml"
    other.write_text(RIG)
    assert night().analysed == 0


def test_changed_settings_redo_the_fits_only(night: Any) -> None:
    night.lab.settings.write_text("orders = [1, 2]\n")
    assert "1 specimen result: made with other settings" in describe_lab(night.lab)
    night()
    assert redone(night.lab) == {"specimen:P-1"}
    assert select(night.lab, "SELECT max(model_order) FROM model_fits") == [(2,)]
    night.lab.settings.write_text("ordres = [1]\n")
    with pytest.raises(LabError, match="ordres"):
        night()


def test_changed_code_redoes_what_it_made(night: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    original = pipeline.nightly.stages.hash_code
    monkeypatch.setattr(
        pipeline.nightly.stages,
        "hash_code",
        lambda modules: "other" if "pipeline.analyse.groups" in modules else original(modules),
    )
    night()
    assert redone(night.lab) == LIVES


def test_a_copy_is_a_duplicate_and_changes_nothing_else(night: Any) -> None:
    before = content(night.lab)["frequency_responses"]
    shutil.copy(night.raw / "P-1-chirp-0.mcap", night.raw / "P-1-chirp-0 (copy).mcap")
    summary = night()
    assert summary.exit_status == 0
    assert statuses(night.lab)["P-1-chirp-0 (copy).mcap"] == "duplicate"
    assert content(night.lab)["frequency_responses"] == before
    (night.raw / "P-1-chirp-0.mcap").unlink()
    night()
    assert statuses(night.lab) | {"P-1-chirp-0 (copy).mcap": "ok"} == statuses(night.lab), "the copy takes its place"
    assert healthy(night.lab) == []


TWO_GROUPS = "group,t,f\nA,1.0,1\nA,2.0,0\nB,3.0,1\nB,4.0,1\nB,9.0,0\n"


def select_group(path: Path, group: str, **more: str) -> None:
    """A copy of the table of two groups, of which the mapping reads one."""
    path.write_text(TWO_GROUPS)
    path.with_name(path.name + ".toml").write_text(
        f'kind = "lifetimes"\n[[select]]\ncolumn = "group"\nequals = "{group}"\n'
        '[columns.lifetime]\ncolumn = "t"\nunit = "s"\n'
        '[columns.failed]\ncolumn = "f"\nfailed_values = [1]\ncensored_values = [0]\n'
        f'[recording]\nrecording_id = "{path.stem}"\nconfiguration = "{more.get("configuration", group)}"\n'
    )


@pytest.mark.long
def test_the_same_content_mapped_in_two_ways_is_two_recordings(tmp_path: Path, without_pages: None) -> None:
    """A recording is content and mapping: what is read, not which bytes it stands in."""
    raw, lab = tmp_path / "raw", Lab(tmp_path / "lab")
    raw.mkdir()
    for name, group in (("a.csv", "A"), ("b.csv", "B"), ("b again.csv", "B")):
        select_group(raw / name, group)
    assert nightly([raw], lab, jobs=0).exit_status == 0
    assert statuses(lab) == {"a.csv": "ok", "b.csv": "ok", "b again.csv": "duplicate"}
    lives = "SELECT recording_id, count(*), any_value(configuration) FROM lifetimes GROUP BY ALL ORDER BY ALL"
    assert select(lab, lives) == [("a", 2, "A"), ("b", 3, "B")]
    assert nightly([raw], lab, jobs=0).analysed == 0, "nothing has changed"
    assert healthy(lab) == []
    select_group(raw / "b.csv", "B", configuration="later")
    (raw / "b again.csv").unlink()
    (raw / "b again.csv.toml").unlink()
    assert nightly([raw], lab, jobs=0).exit_status == 0
    assert select(lab, lives) == [("a", 2, "A"), ("b", 3, "later")], "metadata alone make no other recording"
    select_group(raw / "b.csv", "A", configuration="A")
    nightly([raw], lab, jobs=0)
    assert statuses(lab)["b.csv"] == "duplicate", "it reads now what a.csv reads"
    select_group(raw / "b.csv", "B")
    nightly([raw], lab, jobs=0)
    assert statuses(lab) == {"a.csv": "ok", "b.csv": "ok"}
    assert select(lab, lives) == [("a", 2, "A"), ("b", 3, "B")]
    assert healthy(lab) == []


def test_same_id_with_other_content_is_a_conflict_and_the_first_stays(night: Any) -> None:
    before = content(night.lab)["carried"]
    chirp(night.raw / "A-other.mcap", 5, name="P-1-chirp-0")
    summary = night()
    assert summary.exit_status == 3
    assert statuses(night.lab)["A-other.mcap"] == "quarantined"
    assert any("A-other.mcap" in line and "belongs to other content" in line for line in summary.attention)
    assert content(night.lab)["carried"] == before
    entries = list(night.lab.quarantine.iterdir())
    assert [sorted(p.name for p in entry.iterdir()) for entry in entries] == [["A-other.mcap", "reason.json"]]
    assert night().analysed == 0, "a known conflict is not read again"
    assert night().exit_status == 3


@pytest.mark.long
def test_ids_that_differ_by_case_are_one_where_the_file_system_keeps_one_file(night: Any) -> None:
    """Elsewhere the samples of the second would have been those of the first, without a word."""
    life(night.raw / "other.mcap", 7, name="l-0")
    assert night().exit_status == 0, "this system tells them apart"
    life(night.raw / "another.mcap", 8, name="p-1-CHIRP-0")
    (night.lab.folder / night.lab.work.name.upper()).symlink_to(night.lab.work.name)  # as if it did not
    summary = night()
    assert statuses(night.lab)["another.mcap"] == "quarantined"
    (told,) = (line for line in summary.attention if "another.mcap" in line)
    assert '"p-1-CHIRP-0" differs by case only from "P-1-chirp-0"' in told
    assert "keep the lab where upper and lower case are told apart" in told
    assert statuses(night.lab)["P-1-chirp-0.mcap"] == "ok", "the first keeps its name"
    (night.lab.folder / night.lab.work.name.upper()).unlink()
    assert night().exit_status == 0


@pytest.mark.long
def test_a_conflict_is_resolved_when_the_first_gets_another_id(night: Any) -> None:
    """The mapping of a table is changed, so that its id is free for the file that was refused for it."""
    table = night.raw / "lives.csv"
    table.write_text("t,f\n1.0,1\n2.0,0\n")
    mapping = (
        'kind = "lifetimes"\n[csv]\ndelimiter = ","\n[columns.lifetime]\ncolumn = "t"\nunit = "s"\n'
        '[columns.failed]\ncolumn = "f"\nfailed_values = [1]\ncensored_values = [0]\n'
        '[recording]\nrecording_id = "X"\nconfiguration = "C"\nvoltage_setpoint_kv = 5.0\n'
    )
    (night.raw / "lives.csv.toml").write_text(mapping)
    night()
    life(night.raw / "L-X.mcap", 7, name="X")
    assert night().exit_status == 3
    assert statuses(night.lab)["L-X.mcap"] == "quarantined"
    (night.raw / "lives.csv.toml").write_text(mapping.replace('"X"', '"Y"'))
    assert night().exit_status == 0
    assert statuses(night.lab) | {"L-X.mcap": "ok", "lives.csv": "ok"} == statuses(night.lab)
    assert select(night.lab, "SELECT DISTINCT recording_id FROM lifetimes WHERE configuration = 'C'") == [("Y",)]
    assert list(night.lab.quarantine.iterdir()) == [], "released"
    assert healthy(night.lab) == []


def test_a_file_that_has_gone_leaves_its_results(night: Any) -> None:
    (night.raw / "L-0.mcap").unlink()
    summary = night()
    assert summary.missing == 1
    assert summary.exit_status == 0
    assert select(night.lab, "SELECT count(*) FROM lifetimes") == [(4,)]
    assert "L-0" in describe_lab(night.lab).partition("The file has gone")[2]


def test_an_excluded_recording_leaves_the_analysis_and_comes_back(night: Any) -> None:
    before = content(night.lab)
    annotate(night.lab, "L-1", "exclude", "'; DROP TABLE lifetimes; --")
    assert "L-1" in describe_lab(night.lab).partition("Out of the analysis")[2]
    assert "1 excluded" in describe_lab(night.lab)
    assert night().exit_status == 0
    assert redone(night.lab) == LIVES
    assert statuses(night.lab)["L-1.mcap"] == "excluded"
    assert select(night.lab, "SELECT survival FROM survival_at(3) WHERE configuration = 'A'") == [(1.0,)]
    assert select(night.lab, "SELECT recording_id, why FROM exclusions") == [("L-1", "'; DROP TABLE lifetimes; --")]
    annotate(night.lab, "L-1", "include", "it was the wrong one")
    night()
    after = content(night.lab)
    assert len(after.pop("annotations")) == 2
    assert after == {name: rows for name, rows in before.items() if name != "annotations"}
    with pytest.raises(UsageError, match="recording id"):
        annotate(night.lab, "../x", "exclude", "because")


def test_a_growing_file_waits(night: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        pipeline.nightly.look, "growing", lambda files: [f for f in files if f.path.name == "P-1-chirp-0.mcap"]
    )
    os.utime(night.raw / "P-1-chirp-0.mcap")
    summary = night()
    assert summary.counts.pending == 1
    assert summary.exit_status == 0
    assert select(night.lab, "SELECT count(*) FROM recordings WHERE status = 'pending'") == [(1,)]
    assert select(night.lab, "SELECT count(*) FROM recordings WHERE recording_id = 'P-1-chirp-0'") == [(1,)]
    monkeypatch.undo()
    assert night().counts.pending == 0
    assert select(night.lab, "SELECT count(*) FROM recordings WHERE status = 'pending'") == [(0,)]


def test_a_file_that_changes_while_it_is_read_waits(night: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    path = life(night.raw / "L-8.mcap", 8)
    original = ingest.intake.read_raw

    def touched(file: Path, mapping: Any) -> Any:
        if file == path:
            os.utime(path, ns=(1, 1))
        return original(file, mapping)

    monkeypatch.setattr(ingest.intake, "read_raw", touched)
    assert night().counts.pending == 1
    monkeypatch.undo()
    assert night().counts.ingested == 1


def test_an_analysis_that_fails_is_told_and_stops_nothing(night: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_recording: Any) -> None:
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(analyse, "detect_breakdown", fail)
    life(night.raw / "L-8.mcap", 8)
    summary = night()
    assert summary.exit_status == 3
    assert summary.counts.failed == 1
    assert "ZeroDivisionError: a defect" in "\n".join(summary.attention)
    assert statuses(night.lab)["L-8.mcap"] == "ok", "the recording itself is fine"
    assert "Traceback" in select(night.lab, "SELECT error FROM items WHERE outcome = 'failed'")[0][0]
    assert "a defect" in describe_lab(night.lab)


def test_the_garbage_collector_is_left_as_it_was(night: Any, tmp_path: Path) -> None:
    before = gc.get_threshold()
    night()
    assert gc.get_threshold() == before
    with pytest.raises(UsageError):
        night(tmp_path / "nowhere")
    assert gc.get_threshold() == before


@pytest.mark.long
def test_every_file_that_is_not_read_has_an_item_and_a_line(night: Any) -> None:
    """Licences, unknown endings and R data went without a word: neither the page nor the database knew of them."""
    for name in ("LICENSE", "lives.rda", "fit.MPL", "table.csv"):
        (night.raw / name).write_text("a;b\n1;2\n")
    summary = night()
    items = "SELECT item_id, outcome, error FROM items WHERE stage = 'file' ORDER BY item_id"
    told = {item.rpartition("/")[2]: (outcome, error) for item, outcome, error in select(night.lab, items)}
    assert set(told) == {night.raw.name, "lives.rda", "fit.MPL", "table.csv"}
    assert told["lives.rda"][0] == "passed over"
    assert "R data" in told["lives.rda"][1]
    assert told["table.csv"][0] == "unmapped"
    assert "documents 1 (LICENSE)" in told[night.raw.name][1]
    assert {error for _, error in told.values()} == set(summary.notes)
    build_reports(night.lab.folder)
    assert "lives.rda" in (night.lab.reports / "index.html").read_text(encoding="utf-8")
    assert healthy(night.lab) == []
    night()
    again = "SELECT DISTINCT run_id FROM items WHERE stage = 'file'"
    assert len(select(night.lab, again)) == 1
    assert redone(night.lab) == set(), "what is passed over as before is not booked again"
    (night.raw / "lives.rda").unlink()
    (night.raw / "b.rds").write_text("x")
    night()
    left = {item.rpartition("/")[2] for item, *_ in select(night.lab, items)}
    assert left == {night.raw.name, "b.rds", "fit.MPL", "table.csv"}


def test_only_folders_without_recordings_are_a_failure(night: Any, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "data.csv").write_text("a;b\n1;2\n")
    with pytest.raises(LabError, match="1 data files have no mapping"):
        night(tmp_path / "empty")
    with pytest.raises(UsageError, match="no such file"):
        night(tmp_path / "nowhere")
    with pytest.raises(UsageError, match="no such folder"):
        night(rigs=tmp_path / "nowhere")


def test_the_lab_among_the_raw_files_is_not_read(night: Any) -> None:
    chirp(night.raw / "A-other.mcap", 5, name="P-1-chirp-0")
    night()
    inside = night.raw / "lab"
    shutil.copytree(night.lab.folder, inside)
    summary = nightly([night.raw], Lab(inside), jobs=0)
    assert summary.counts.found == 7


HOSTILE = [
    "../../../../tmp/x",
    "<script>alert(1)</script>",
    "'; DROP TABLE recordings; --",
    "x\x1b[2J",
    "\u202egnp.exe",
]


@pytest.mark.long
def test_hostile_metadata_does_no_harm(night: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for number, text in enumerate(HOSTILE):
        more = {"specimen_id": text, "operator": text, "notes": text, "configuration": text, "campaign": text}
        life(night.raw / f"hostile-{number}.mcap", 20 + number, **more)
    bad = mcap_files.METADATA | {"recording_id": "../../evil", "operator": HOSTILE[1]}
    (night.raw / "bad-id.mcap").write_bytes(mcap_files.whole(mcap_files.metadata(bad), mcap_files.DEFINITIONS))
    before = {p for p in tmp_path.rglob("*") if night.lab.folder not in p.parents}
    monkeypatch.undo()
    summary = night()
    assert summary.report_problem is None
    assert summary.counts.ingested == len(HOSTILE)
    assert statuses(night.lab)["bad-id.mcap"] == "quarantined"
    assert {p for p in tmp_path.rglob("*") if night.lab.folder not in p.parents} == before
    found = {
        text for (text,) in select(night.lab, "SELECT DISTINCT operator FROM recordings WHERE operator IS NOT NULL")
    }
    assert found == set(HOSTILE)
    pages = "".join(p.read_text() for p in night.lab.reports.rglob("*.html"))
    assert "<script>alert" not in pages
    assert "\x1b" not in describe_lab(night.lab)
    assert healthy(night.lab) == []


def test_the_second_nightly_ends_at_once_and_names_the_first(night: Any) -> None:
    with hold_lab(night.lab):
        started = time.monotonic()
        with pytest.raises(LabError, match=f"process {os.getpid()} on ") as caught:
            night()
        assert time.monotonic() - started < 1
        assert "a nightly is at work" in str(caught.value)
        assert "A nightly is at work" in describe_lab(night.lab)
    assert night().exit_status == 0
    night.lab.folder.joinpath(".lock-holder.json").write_text('{"pid": 1, "host": "x", "since": "never"}')
    assert night().exit_status == 0, "a note of a dead process holds nothing"


def run_nightly(raw: Path, lab: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "pipeline.cli", "nightly", str(raw), "--lab", str(lab), "--jobs", "1"]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True
    )


def test_an_interrupted_and_killed_night_is_taken_up_where_it_ended(made: tuple[Path, Path], tmp_path: Path) -> None:
    """Interrupted, killed at two stages (`make faults` has them all), left alone: as undisturbed, nothing left over."""
    raw, undisturbed = made
    lab = Lab(tmp_path / "lab")
    process = end_at(STAGES["an item is finished"], raw, lab, signal.SIGTERM)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert errors.decode() == "dealab: interrupted; what was finished is kept for the next run\n"
    assert finished(lab)
    assert not lab.database.exists()
    for stage in ("the next database is being built", "the database is published"):
        end_at(STAGES[stage], raw, lab, signal.SIGKILL).communicate()
        if lab.database.exists():
            assert [finding for finding in healthy(lab) if "temporary" not in finding] == []
    process = run_nightly(raw, lab.folder)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 0, errors.decode()
    assert content(lab) == content(Lab(undisturbed))
    assert healthy(lab) == []
    assert {p.name for p in lab.folder.iterdir()} == {p.name for p in undisturbed.iterdir()}
    samples = {p.relative_to(lab.folder): p.read_bytes() for p in lab.samples_folder.rglob("*.parquet")}
    expected = {p.relative_to(undisturbed): p.read_bytes() for p in (undisturbed / "samples").rglob("*.parquet")}
    assert samples == expected
    assert not [p for p in lab.folder.rglob("*") if p.suffix in (".tmp", ".wal") or ".partial" in p.name]


def end_at(reached: Callable[[Lab], bool], raw: Path, lab: Lab, how: signal.Signals) -> subprocess.Popen[bytes]:
    """A night that is ended as soon as it has come so far."""
    process = run_nightly(raw, lab.folder)
    while process.poll() is None and not reached(lab):
        time.sleep(0.002)
    process.send_signal(how)
    return process


def test_whatever_a_killed_night_was_at_goes(night: Any) -> None:
    for name in (
        "members-x/survival",
        "samples/deeper/x",
        "journal/half.entry",
        "ledger.sqlite",
        "building.duckdb.tmp/x",
    ):
        path = night.lab.work / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("half")
    night()
    assert not night.lab.work.exists()
    assert healthy(night.lab) == []


def test_the_second_names_the_first_though_it_asks_before_that_has_said_who_it_is(tmp_path: Path) -> None:
    """The note is written once the lock is held: a moment that two nightlies started together meet."""
    lab = Lab(tmp_path / "lab")
    lab.create()
    note = {"pid": 4711, "host": "elsewhere", "since": "now"}
    write = threading.Timer(0.15, lambda: (lab.folder / ".lock-holder.json").write_text(json.dumps(note)))
    with FileLock(lab.lock):
        write.start()
        with pytest.raises(LabError, match="process 4711 on elsewhere"), hold_lab(lab):
            pass
    write.join()
