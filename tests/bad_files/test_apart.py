"""Parsers in a child process: what kills or holds them up becomes a reason."""

from __future__ import annotations

import contextlib
import copyreg
import gc
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ingest.apart import Apart, apart
from schemas.errors import PendingError, RefusedError

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "x.mat").write_bytes(b"x" * 100)
    return tmp_path / "x.mat"


def test_large_values_and_errors_come_back(path: Path) -> None:
    values = np.arange(300_000.0)
    found = apart(path, lambda scale: {"values": scale * values}, 2.0)
    assert np.array_equal(found["values"], 2 * values)

    def fail(error: Exception) -> Any:
        raise error

    with pytest.raises(PendingError, match="gone"):
        apart(path, fail, PendingError("it has gone"))
    with pytest.raises(KeyError, match="force"):
        apart(path, fail, KeyError("force"))

    class Local(Exception):
        """Cannot be imported elsewhere, so it cannot be pickled."""

    with pytest.raises(ValueError, match="Local: here only"):
        apart(path, fail, Local("here only"))


def _pickle_whole(error: RefusedError) -> tuple[Any, ...]:
    """As `tblib` has it, which distributed installs for the errors it carries: with what was handled when it was raised."""
    return RefusedError, (error.problem,), {"__context__": error.__context__}


def test_an_error_comes_back_without_what_was_handled_when_it_was_raised(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A panic of a library in compiled code cannot be pickled, and made a refusal a ValueError with a traceback."""
    monkeypatch.setitem(copyreg.dispatch_table, RefusedError, _pickle_whole)

    class Panic(BaseException):
        """Cannot be imported elsewhere, so it cannot be pickled."""

    def refuse() -> None:
        try:
            raise Panic
        except Panic:
            raise RefusedError("cannot be read") from None

    with pytest.raises(RefusedError, match="cannot be read"):
        apart(path, refuse)


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGBUS, signal.SIGABRT])
def test_a_crash_is_a_refusal(path: Path, number: signal.Signals) -> None:
    with pytest.raises(RefusedError, match=rf"its parser crashed \({number.name}\)"):
        apart(path, lambda: os.kill(os.getpid(), number))
    with pytest.raises(RefusedError, match="was ended"):
        apart(path, lambda: os._exit(3))


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGABRT, signal.SIGFPE])
def test_what_the_parent_does_about_crashes_is_not_done_by_the_child(path: Path, number: signal.Signals) -> None:
    """A program that handles crashes, such as a fuzzer, would take that of a child for its own."""
    seen: list[int] = []
    before = signal.signal(number, lambda got, _: seen.append(got))
    try:
        with pytest.raises(RefusedError, match=rf"crashed \({number.name}\)"):
            apart(path, lambda: os.kill(os.getpid(), number))
        assert signal.getsignal(number) is not signal.SIG_DFL
    finally:
        signal.signal(number, before)
    assert seen == []


def test_what_a_library_prints_before_it_dies_is_for_nobody(path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A library in Rust prints a page of its own functions, and goes on or not."""

    def panic() -> None:
        os.write(2, b"thread panicked at cfb.rs:305:41\nstack backtrace: ...")
        os.abort()

    with pytest.raises(RefusedError, match="SIGABRT"):
        apart(path, panic)
    assert capfd.readouterr() == ("", "")
    os.write(2, b"ours")
    assert capfd.readouterr().err == "ours", "the parent can still speak"


def test_going_round_for_ever_ends_within_a_second_of_work(path: Path) -> None:
    def forever() -> None:
        while True:
            pass

    before = time.process_time()
    with pytest.raises(RefusedError, match="does not come to an end"):
        apart(path, forever)
    assert time.process_time() - before < 0.5, "the parent only waits"


def test_what_the_parent_holds_costs_a_child_no_time(path: Path) -> None:
    """A sound workbook was refused in a process of many objects: a collection went through them all, on the file's time."""
    held = [[i] for i in range(10_000)]

    def count_collected() -> tuple[int, bool]:
        return len(gc.get_objects()), any(o is held for o in gc.get_objects())

    counted, is_seen = apart(path, count_collected)
    assert counted < len(held)
    assert not is_seen


def test_the_calls_for_one_file_share_its_time(path: Path) -> None:
    def work(seconds: float) -> str:
        end = time.process_time() + seconds
        while time.process_time() < end:
            pass
        return "done"

    parsed = Apart(path)
    assert parsed(work, 0.4) == "done"
    with pytest.raises(RefusedError, match="does not come to an end"):
        parsed(work, 0.4)
    many = Apart(path)
    assert [many(work, 0.0) for _ in range(60)] == ["done"] * 60, "what is quick may come as often as it likes"


def test_to_begin_a_child_is_no_work_of_the_file(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A process with much memory takes tens of milliseconds to fork; sound files of many parts were refused for it."""

    def begin_slowly() -> None:
        end = time.process_time() + 0.1
        while time.process_time() < end:
            pass

    monkeypatch.setattr("ingest.apart.end_with_parent", begin_slowly)
    many = Apart(path)
    assert [many(lambda: "done") for _ in range(12)] == ["done"] * 12


def test_waiting_is_no_work(path: Path) -> None:
    """A loaded machine or a slow disk makes no file bad."""
    assert apart(path, lambda: time.sleep(1.0) or "read") == "read"


def find_children() -> set[str]:
    """Process ids of the children of this process, whatever other tests have started; empty where the system does not list them."""
    found = set()
    for status in Path("/proc").glob("[0-9]*/status"):
        with contextlib.suppress(OSError):
            if f"\nPPid:\t{os.getpid()}\n" in status.read_text():
                found.add(status.parent.name)
    return found


def test_nothing_of_the_parent_is_lost_or_left(path: Path) -> None:
    handles = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
    before = find_children()
    for _ in range(5):
        apart(path, os.getpid)
    if handles:
        assert len(os.listdir("/proc/self/fd")) == handles
    assert find_children() <= before


_TELL_IMPORTS = """
import sys
from pathlib import Path

import ingest.apart
from ingest.mapping import FileMapping

inner, libraries = [], ("asammdf", "h5py", "python_calamine", "pyarrow", "scipy", "pandas")


def in_place(path, seconds, call):
    before = set(sys.modules)
    value = call()
    inner.extend(sorted(m for m in set(sys.modules) - before if m.split(".")[0] in libraries))
    return True, value, 0.0


ingest.apart._in_child = in_place
from ingest.read import open_columns
for name in sys.argv[1:]:
    path = Path(name)
    form = {".mf4": "mdf", ".h5": "hdf5", ".parquet": "arrow", ".mat": "matlab"}[path.suffix]
    file = open_columns(path, form, FileMapping("recording", form, {}, None, {}, {}, {}))
    file.cells(file.names()[0])
print(*inner)
"""


@pytest.mark.parametrize(
    "name", ["vehicle_mf4/run.mf4", "hdf5_attributes/run.h5", "table_parquet/run.parquet", "matlab_hold/hold.mat"]
)
def test_no_library_is_imported_on_a_childs_time(name: str) -> None:
    """On a busy machine the import of asammdf alone took longer than a small file may: a sound file was refused."""
    path = Path(__file__).resolve().parents[1] / "strangers" / "drafted" / name
    command = [sys.executable, "-c", _TELL_IMPORTS, str(path)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    found = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == []
