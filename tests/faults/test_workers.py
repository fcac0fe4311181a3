"""A worker that dies, is overdue or takes too much costs its own item only, and that one is tried once more alone."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pipeline.lab.settings import Settings
from pipeline.nightly import workers
from pipeline.nightly.workers import Casualty, KeptPool, LocalPool, SerialExecutor, run_all
from schemas.errors import LabError


def work(task: tuple[str, str]) -> str:
    """Does what it is told, after leaving a mark that it was tried."""
    what, folder = task
    with Path(folder, what).open("a") as marks:
        marks.write("x")
    if what == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if what == "dies once" and Path(folder, what).stat().st_size == 1:
        os.kill(os.getpid(), signal.SIGSEGV)
    if what == "hangs":
        time.sleep(60)
    if what == "eats":
        return str(len(bytearray(3 << 30)))
    if what == "full disk":
        raise LabError("the lab cannot be written: No space left on device")
    return what


def pool(jobs: int) -> LocalPool:
    return LocalPool(jobs, deadline_s=3, memory_mb=1500)


def test_the_unlucky_are_told_and_the_others_are_done(tmp_path: Path) -> None:
    names = ["a", "dies", "b", "hangs", "c", "eats", "dies once", "d"]
    results = dict(run_all([(name, str(tmp_path)) for name in names], work, pool, jobs=2))
    by_name = {what: result for (what, _folder), result in results.items()}
    reasons = {what: result.reason for what, result in by_name.items() if isinstance(result, Casualty)}
    assert reasons == {
        "dies": "its worker was killed (SIGKILL)",
        "hangs": "it took longer than deadline_s allows",
        "eats": "it needs more memory than a worker may have",
    }
    assert {what: by_name[what] for what in ("a", "b", "c", "d", "dies once")} == {
        what: what for what in ("a", "b", "c", "d", "dies once")
    }
    tried = {path.name: path.stat().st_size for path in tmp_path.iterdir()}
    assert tried == dict.fromkeys(names, 1) | dict.fromkeys(("dies", "hangs", "eats", "dies once"), 2)


@pytest.mark.parametrize("open_executor", [pool, lambda _jobs: SerialExecutor()])
def test_a_lab_that_cannot_be_written_stops_everything(tmp_path: Path, open_executor: Any) -> None:
    with pytest.raises(LabError, match="No space left"):
        list(run_all([("full disk", str(tmp_path))] * 5, work, open_executor, jobs=1))


def test_tasks_are_taken_a_few_at_a_time(tmp_path: Path) -> None:
    taken = 0

    def tasks() -> Iterator[tuple[str, str]]:
        nonlocal taken
        for _ in range(50):
            taken += 1
            yield "a", str(tmp_path)

    for number, _ in enumerate(run_all(tasks(), work, lambda _jobs: SerialExecutor(), jobs=2), start=1):
        assert taken <= number + 4
    assert taken == 50
    assert list(run_all([], work, pool, jobs=2)) == []


def test_a_pool_is_lent_again_until_it_is_closed(tmp_path: Path) -> None:
    """What workers have loaded stays loaded; one that died is replaced, and the others are kept."""
    kept = KeptPool(pool, 2)
    first = dict(run_all(range(8), process, kept, jobs=2))
    unlucky = dict(run_all([("dies once", str(tmp_path)), ("a", str(tmp_path))], work, kept, jobs=2))
    assert sorted(unlucky.values()) == ["a", "dies once"]
    again = dict(run_all(range(8), process, kept, jobs=2))
    assert len({*first.values()}) <= 2
    assert {*first.values()} & {*again.values()}
    kept.close()
    for number in {*first.values(), *again.values()}:
        with pytest.raises(ProcessLookupError):
            os.kill(int(number), 0)
    assert not {*dict(run_all(range(4), process, kept, jobs=2)).values()} & {*first.values(), *again.values()}
    kept.close()


def test_one_worker_is_never_lent_again_for_it_may_be_short_of_memory() -> None:
    kept = KeptPool(pool, 1)
    first, again = (dict(run_all([0], process, kept, jobs=1))[0] for _ in range(2))
    assert first != again


def test_a_pool_left_with_items_undone_is_not_lent_again(tmp_path: Path) -> None:
    kept = KeptPool(pool, 2)
    with pytest.raises(LabError):
        list(run_all([("full disk", str(tmp_path))] * 5, work, kept, jobs=2))
    assert len(dict(run_all(range(4), process, kept, jobs=2))) == 4
    kept.close()


def test_a_pool_that_broke_while_it_was_kept_is_opened_anew(tmp_path: Path) -> None:
    """Nobody waits for what it was to load meanwhile, and the night goes on."""
    opened: list[LocalPool] = []

    def counted(jobs: int) -> LocalPool:
        opened.append(pool(jobs))
        return opened[-1]

    kept = KeptPool(counted, 2)
    assert len(dict(run_all(range(4), process, kept, jobs=2))) == 4
    opened[0].shutdown(cancel_futures=True)
    kept.load("json")
    with kept(2) as lent:
        assert lent.submit(process, 0).result() > 0
    assert len(opened) == 2
    kept.close()


def process(_: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def test_workers_spare_the_import_of_pandas() -> None:
    """pyarrow imports it on its first conversion, which takes longer than a small recording."""
    assert [result for _, result in run_all([0.5], converted, pool, jobs=1)] == [([0.5, None], False)]


def converted(value: float) -> tuple[list[float | None], bool]:
    """An arrow array's values, and whether pandas was imported for it."""
    import pyarrow as pa

    return pa.array([value, None], pa.float64()).to_pylist(), "pandas" in sys.modules


def test_workers_share_the_memory_of_the_machine(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    container = tmp_path / "memory.max"
    monkeypatch.setattr(workers, "_CONTAINER", str(container))
    there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    assert workers.share_memory(1) == max(1024, int(0.75 * there) >> 20)
    container.write_text("max\n")
    assert workers.share_memory(1) == max(1024, int(0.75 * there) >> 20)
    container.write_text(f"{6000 << 20}\n")
    assert [workers.share_memory(number) for number in (1, 2, 100)] == [4500, 2250, 1024]


def test_a_worker_has_a_limit_unless_the_lab_has_another(monkeypatch: pytest.MonkeyPatch) -> None:
    given = []
    monkeypatch.setattr(workers, "LocalPool", lambda _count, **options: given.append(options["memory_mb"]))
    for settings in (Settings(), Settings(memory_mb=0), Settings(memory_mb=300)):
        workers.Workers(settings, 2, None, (), lambda items, _count, _what: items).lend()
    assert given == [workers.share_memory(2), 0, 300]
