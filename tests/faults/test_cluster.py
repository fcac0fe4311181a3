"""The nightly on a dask.distributed cluster: a real scheduler and two worker processes on this machine."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

import pipeline.nightly.night
import pipeline.nightly.workers
from ingest.extras import EXTRAS
from pipeline import Lab
from pipeline.nightly import workers
from pipeline.nightly.night import nightly
from pipeline.nightly.workers import refuse_other_software as refuse
from schemas.errors import LabError
from schemas.version import describe_software
from tests.conftest import ROOT
from tests.faults import sabotage
from tests.faults.lab_state import content, healthy, left_over, samples
from tests.helpers.small_lab import life, small_campaign

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A scheduler and two workers of one thread each, which are replaced when they die."""
    folder = tmp_path_factory.mktemp("cluster")
    place = folder / "scheduler.json"
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
    }
    options = ["--scheduler-file", str(place), "--no-dashboard"]
    commands = [
        ["distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *options],
        *(["distributed.cli.dask_worker", "--nthreads", "1", "--local-directory", str(folder), *options],) * 2,
    ]
    processes = []
    try:
        for command in commands:
            processes.append(
                subprocess.Popen(
                    [sys.executable, "-m", *command],
                    cwd=ROOT,
                    env=environment,
                    stderr=subprocess.DEVNULL,
                    start_new_session=True,
                )
            )
            while not place.exists():
                assert processes[0].poll() is None, "the scheduler does not start"
                time.sleep(0.05)
        from distributed import Client

        found: str = json.loads(place.read_text())["address"]
        with Client(found, timeout="60s") as client:
            client.wait_for_workers(2, timeout=120)
        yield found
    finally:
        for process in processes:
            os.killpg(process.pid, signal.SIGKILL)  # with the workers that its nanny has started
            process.wait()


@pytest.mark.long
def test_a_cluster_gives_the_same_and_outlives_its_workers(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    raw = small_campaign(tmp_path / "raw", chirps=0, lives=2)
    life(raw / "killonce-1.mcap", 5)
    local, lab = Lab(tmp_path / "local"), Lab(tmp_path / "lab")
    assert nightly([raw], local, jobs=0).exit_status == 0
    monkeypatch.setattr(pipeline.nightly.workers, "perform", sabotage.perform)
    summary = nightly([raw], lab, jobs=2, cluster=address)
    assert raw.with_suffix(".seen").exists(), "a worker was killed at work"
    assert summary.attention == ()
    assert content(lab) == content(local)
    assert samples(lab) == samples(local)
    assert left_over(lab) == []
    assert healthy(lab) == []
    life(raw / "kill-1.mcap", 6)
    summary = nightly([raw], lab, jobs=2, cluster=address)
    assert (summary.counts.quarantined, summary.counts.pending) == (0, 1), "an accident is no verdict on the content"
    assert "twice" in summary.attention[0]
    assert summary.counts.reused == 3


def test_a_cluster_with_other_software_is_refused_with_both_named(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    raw, lab = small_campaign(tmp_path / "raw", chirps=0, lives=1), Lab(tmp_path / "lab")
    ours = describe_software()
    monkeypatch.setattr(
        pipeline.nightly.workers, "refuse_other_software", lambda here, there: refuse(here | {"numpy": "0.1"}, there)
    )
    with pytest.raises(LabError, match=f"has numpy {ours['numpy']}") as told:
        nightly([raw], lab, jobs=1, cluster=address)
    assert "numpy 0.1" in str(told.value)
    assert not lab.database.exists()


def test_what_a_worker_has_is_held_against_the_nights() -> None:
    here = {"dealab": "0.1.0 (aa)", "numpy": "2.4"}
    refuse(here, {"tcp://a": dict(here)})
    there = {"tcp://a": dict(here), "tcp://b": here | {"numpy": "2.3"}, "tcp://c": ModuleNotFoundError("dealab")}
    with pytest.raises(LabError, match=r"tcp://b has numpy 2\.3; tcp://c cannot say") as refused:
        refuse(here, there)
    assert "dealab 0.1.0 (aa), numpy 2.4" in str(refused.value)
    with pytest.raises(LabError, match=r"has h5py missing.*expected .*h5py 3\.15"):
        refuse(here | {"h5py": "3.15"}, {"tcp://a": here | {"h5py": "missing"}})
    with pytest.raises(
        LabError, match=r"has the reader of ldat from ours 1\.0.*expected .*the reader of ldat from missing"
    ):
        refuse(here, {"tcp://a": here | {"the reader of ldat from": "ours 1.0"}})


def test_libraries_and_readers_that_read_files_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without one a worker refuses the files of its format; with another it may read other numbers."""
    monkeypatch.setattr(workers, "identify_plugins", lambda: ("ldat=our-package 1.2",))
    found = workers.describe_readers_too()
    needed = set(EXTRAS["hdf5"] + EXTRAS["mdf"] + EXTRAS["tdms"] + EXTRAS["uff"]) | {"python-calamine", "mcap"}
    assert needed <= set(found)
    assert found["the reader of ldat from"] == "our-package 1.2"
    known = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: known("no such thing" if name == "h5py" else name))
    assert workers.describe_readers_too()["h5py"] == "missing"


def test_a_worker_that_joins_during_the_night_is_asked_too(monkeypatch: pytest.MonkeyPatch) -> None:
    from distributed import LocalCluster, default_client

    with LocalCluster(n_workers=1, processes=False, dashboard_address=None) as cluster:  # type: ignore[no-untyped-call]
        open_executor, _ = workers.connect_cluster(cluster.scheduler_address)
        other = workers.describe_readers_too() | {"numpy": "0.1"}
        monkeypatch.setattr(workers, "_describe_once", lambda: other)  # the cluster's worker is a thread of ours
        with pytest.raises(LabError, match=r"has numpy 0\.1") as told:
            list(workers.run_all([1], str, open_executor, jobs=1))
        assert describe_software()["numpy"] in str(told.value)
        monkeypatch.undo()
        assert list(workers.run_all([1], str, open_executor, jobs=1)) == [(1, "1")]
        default_client().close()


def test_a_cluster_without_workers_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody could be asked for software, and the night would have begun with whoever came."""
    from distributed import LocalCluster

    monkeypatch.setattr("pipeline.nightly.workers._CONNECT_S", "1s")
    raw, lab = small_campaign(tmp_path / "raw", chirps=0, lives=1), Lab(tmp_path / "lab")
    with (
        LocalCluster(n_workers=0, processes=False, dashboard_address=None) as cluster,  # type: ignore[no-untyped-call]
        pytest.raises(LabError, match="has no worker"),
    ):
        nightly([raw], lab, jobs=1, cluster=cluster.scheduler_address)
    assert not lab.database.exists()


class Client:
    """A dask client of one worker, as far as an executor asks it."""

    def __init__(self, unseen: list[str] | BaseException = [], cores: int = 1) -> None:  # noqa: B006 - is not changed
        self._unseen, self._cores = unseen, cores

    def get_executor(self, **_: Any) -> None:
        """None is asked for work."""

    def run(self, *_: Any, **__: Any) -> dict[str, Any]:
        return {"tcp://b": self._unseen}

    def ncores(self) -> dict[str, int]:
        return {"tcp://b": 1} if self._cores else {}


def test_a_worker_that_does_not_see_the_lab_or_the_raw_folders_is_told(tmp_path: Path) -> None:
    """Its results would have gone into another lab, and what it was to read would have been pending every night."""
    here = [str(tmp_path / name) for name in "abcdefg"]
    for name in here:
        Path(name).touch()
    with pytest.raises(LabError, match=r"tcp://b: a worker of the cluster does not see .*/a, .* and 2 more"):
        workers._ClusterExecutor(Client(here), {}).refuse_blind(here)
    with pytest.raises(LabError, match="cannot look at files: no"):
        workers._ClusterExecutor(Client(RuntimeError("no")), {}).refuse_blind(here)
    workers._ClusterExecutor(Client([str(tmp_path / "renamed meanwhile")]), {}).refuse_blind(here)
    assert workers.list_unseen([*here, str(tmp_path / "x")]) == [str(tmp_path / "x")]


def test_a_cluster_that_loses_its_workers_or_its_scheduler_ends_the_night(monkeypatch: pytest.MonkeyPatch) -> None:
    """It waited for ever, or ended with a page of dask's own functions."""
    executor = workers._ClusterExecutor(Client(cores=0), {})
    executor.refuse_empty()
    monkeypatch.setattr(workers, "_EMPTY_S", 0.0)
    with pytest.raises(LabError, match="has been without a worker"):
        executor.refuse_empty()
    workers._ClusterExecutor(Client(), {}).refuse_empty()
    lost: Future[None] = Future()
    lost.cancel()
    with pytest.raises(LabError, match="the cluster has gone during the night"):
        workers._take_result(lost)


@pytest.mark.parametrize("address", ["tls://127.0.0.1:9", "ucx://x:1", "http://127.0.0.1:1", "nonsense", "tcp://"])
def test_an_address_that_is_none_is_told(address: str) -> None:
    before = threading.active_count()
    with pytest.raises(LabError, match="the cluster does not answer"):
        workers.connect_cluster(address)
    # What dask closes when it is collected as garbage may be collected while dask holds the lock that closing needs.
    assert threading.active_count() == before, "a client that could not connect is left half open"


def test_a_cluster_that_is_not_there_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pipeline.nightly.workers._CONNECT_S", "1s")
    raw = small_campaign(tmp_path / "raw", chirps=0, lives=1)
    with pytest.raises(LabError, match="cluster does not answer"):
        nightly([raw], Lab(tmp_path / "lab"), jobs=1, cluster="tcp://127.0.0.1:9")
