"""Raw folders behind URLs: an S3-compatible server on this machine, objects that change, vanish, lie or do not answer."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import ingest.remote
import pipeline.nightly.look
import pipeline.nightly.night
from ingest.remote import RemoteFile, fetch, mirror
from pipeline import Lab
from pipeline.nightly.night import Summary, nightly
from schemas.errors import LabError, PendingError, UsageError
from tests.faults.lab_state import content, healthy, select
from tests.helpers.small_lab import RIG, life, small_campaign

pytest.importorskip("s3fs", reason="the extra `remote` is not installed")
pytest.importorskip("moto", reason="the server for tests is not installed")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    """Address of an S3-compatible server that keeps its objects in memory."""
    from moto.server import ThreadedMotoServer

    running = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield f"http://{host}:{port}"
    running.stop()


@pytest.fixture
def bucket(server: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[Any]:
    """An empty bucket, as a client's object; its address is `s3://<name>`."""
    import boto3

    for name, value in (
        ("AWS_ACCESS_KEY_ID", "test"),
        ("AWS_SECRET_ACCESS_KEY", "test"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
        ("AWS_ENDPOINT_URL", server),
    ):
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
    name = f"raw-{abs(hash(request.node.name))}"
    made = boto3.resource("s3").create_bucket(Bucket=name)
    yield made
    made.objects.all().delete()
    made.delete()


def fill(bucket: Any, folder: Path) -> None:
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            bucket.upload_file(str(path), f"rig-1/{path.relative_to(folder).as_posix()}")


def run(bucket: Any, lab: Lab, **options: Any) -> Summary:
    return nightly([f"s3://{bucket.name}/rig-1"], lab, **{"jobs": 0, **options})


def fetched_files(lab: Lab) -> list[str]:
    return sorted(path.name for path in lab.remote.rglob("*") if path.is_file())


def no_fetching(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(file: RemoteFile, _path: Path) -> None:
        raise AssertionError(f"{file.url} is fetched")

    monkeypatch.setattr(ingest.remote, "fetch", fail)
    monkeypatch.setattr(pipeline.nightly.look, "fetch", fail)


@pytest.mark.long
def test_a_bucket_gives_what_the_folder_gives(bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = small_campaign(tmp_path / "raw", chirps=1, lives=2)
    fill(bucket, raw)
    near, far = Lab(tmp_path / "near"), Lab(tmp_path / "far")
    assert nightly([raw], near, jobs=0).attention == ()
    first = run(bucket, far, jobs=2)
    assert (first.counts.ingested, first.attention) == (3, ())
    here, there = content(near), content(far)
    assert here.keys() == there.keys()
    assert {name: len(rows) for name, rows in here.items()} == {name: len(rows) for name, rows in there.items()}
    same = [name for name in here if name not in ("recordings", "items")]
    assert {name: here[name] for name in same} == {name: there[name] for name in same}
    paths = {path for (path,) in select(far, "SELECT source_path FROM recordings")}
    assert f"s3://{bucket.name}/rig-1/L-0.mcap" in paths
    assert fetched_files(far) == ["rig-a.toml"]
    assert healthy(far) == []
    no_fetching(monkeypatch)
    again = run(bucket, far)
    assert (again.counts.reused, again.analysed) == (3, 0)


def test_an_object_put_a_moment_ago_is_known_the_next_time(
    bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pipeline.nightly.look, "_SETTLED_NS", 3_600_000_000_000)
    fill(bucket, small_campaign(tmp_path / "raw", chirps=0, lives=3))
    lab = Lab(tmp_path / "lab")
    run(bucket, lab)
    no_fetching(monkeypatch)
    assert run(bucket, lab).counts.reused == 3


@pytest.mark.long
def test_only_what_has_changed_is_fetched(bucket: Any, tmp_path: Path) -> None:
    raw = small_campaign(tmp_path / "raw", chirps=0, lives=5)
    fill(bucket, raw)
    lab = Lab(tmp_path / "lab")
    run(bucket, lab)
    life(raw / "L-7.mcap", 7)
    bucket.upload_file(str(raw / "L-7.mcap"), "rig-1/deeper/L-7.mcap")
    bucket.Object("rig-1/L-1.mcap").delete()
    summary = run(bucket, lab)
    assert (summary.counts.found, summary.counts.ingested, summary.missing) == (5, 1, 1)
    assert select(lab, "SELECT recording_id FROM recordings WHERE NOT source_present") == [("L-1",)]
    bucket.put_object(Key="rig-1/rigs/rig-a.toml", Body=RIG.replace("0.05", "0.06").encode())
    assert run(bucket, lab).counts.ingested == 5, "all that name the rig are read again"


def test_a_refused_object_is_kept_with_its_reason_and_released(bucket: Any, tmp_path: Path) -> None:
    raw = small_campaign(tmp_path / "raw", chirps=0, lives=3)
    fill(bucket, raw)
    bucket.put_object(Key="rig-1/L-8.mcap", Body=b"no recording at all")
    lab = Lab(tmp_path / "lab")
    assert run(bucket, lab).exit_status == 3
    (entry,) = lab.quarantine.iterdir()
    reason = json.loads((entry / "reason.json").read_text())
    assert reason["source_path"] == f"s3://{bucket.name}/rig-1/L-8.mcap"
    assert (entry / "L-8.mcap").read_bytes() == b"no recording at all"
    assert healthy(lab) == []
    life(raw / "L-8.mcap", 8)
    bucket.upload_file(str(raw / "L-8.mcap"), "rig-1/L-8.mcap")
    assert run(bucket, lab).exit_status == 0
    assert not list(lab.quarantine.iterdir())


def test_an_object_that_changes_meanwhile_waits(bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    raw = small_campaign(tmp_path / "raw", chirps=0, lives=3)
    fill(bucket, raw)
    lab = Lab(tmp_path / "lab")
    good, done = fetch, []

    def changing(file: RemoteFile, path: Path) -> None:
        if file.name == "L-0.mcap" and not done:
            done.append(file)
            bucket.put_object(Key="rig-1/L-0.mcap", Body=(raw / "L-2.mcap").read_bytes()[:1000])
        good(file, path)

    monkeypatch.setattr(pipeline.nightly.look, "fetch", changing)
    first = run(bucket, lab)
    assert (first.counts.pending, first.counts.ingested) == (1, 2)
    assert fetched_files(lab) == ["rig-a.toml"]
    bucket.upload_file(str(raw / "L-0.mcap"), "rig-1/L-0.mcap")
    assert run(bucket, lab).counts.ingested == 1


def test_without_room_files_are_fetched_twice(bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fill(bucket, small_campaign(tmp_path / "raw", chirps=0, lives=3))
    monkeypatch.setattr(shutil, "disk_usage", lambda _place: shutil._ntuple_diskusage(1000, 1000, 0))
    assert run(bucket, Lab(tmp_path / "lab")).counts.ingested == 3


def test_a_single_object_with_what_lies_beside_it(bucket: Any, tmp_path: Path) -> None:
    fill(bucket, small_campaign(tmp_path / "raw", chirps=0, lives=3))
    lab = Lab(tmp_path / "lab")
    summary = nightly([f"s3://{bucket.name}/rig-1/L-2.mcap"], lab, jobs=0)
    assert (summary.counts.found, summary.counts.ingested) == (1, 1)
    assert fetched_files(lab) == ["rig-a.toml"]


@pytest.mark.long_after(1)
@pytest.mark.parametrize("key", ["rig-1/../../escape.mcap", "rig-1//twice.mcap", "rig-1/" + "n" * 230 + ".mcap"])
def test_names_that_are_no_local_names_are_passed_over(bucket: Any, tmp_path: Path, key: str) -> None:
    fill(bucket, small_campaign(tmp_path / "raw", chirps=0, lives=3))
    bucket.put_object(Key=key, Body=b"x")
    summary = run(bucket, Lab(tmp_path / "lab"))
    assert summary.counts.ingested == 3
    assert any("its name cannot be that of a local file" in note for note in summary.notes)
    assert not list(tmp_path.rglob("escape*"))


def test_what_cannot_be_reached_is_said_and_the_lab_stays(
    bucket: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(bucket, small_campaign(tmp_path / "raw", chirps=0, lives=3))
    lab = Lab(tmp_path / "lab")
    run(bucket, lab)
    before = content(lab)
    with pytest.raises(UsageError, match="nothing at this address"):
        nightly([f"s3://{bucket.name}/nobody"], lab, jobs=0)
    with pytest.raises(UsageError, match="cannot be read"):
        nightly(["nosuch://a/b"], lab, jobs=0)
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(LabError, match="cannot be listed"):
        run(bucket, lab)
    assert content(lab) == before


@pytest.fixture
def folder_url(tmp_path: Path) -> Callable[[Path], str]:
    return lambda path: f"file://{path}"


def test_any_store_of_fsspec(tmp_path: Path, folder_url: Callable[[Path], str], bucket: Any) -> None:
    """A folder by its URL: listed and fetched like a remote one."""
    raw = small_campaign(tmp_path / "raw", chirps=0, lives=3)
    lab = Lab(tmp_path / "lab")
    assert nightly([folder_url(raw)], lab, jobs=0).counts.ingested == 3
    found = mirror(folder_url(raw), tmp_path / "mirror")
    path, file = next((p, f) for p, f in found.files if f.name == "L-0.mcap")
    (raw / "L-0.mcap").unlink()
    with pytest.raises(PendingError, match="gone"):
        fetch(file, path)
