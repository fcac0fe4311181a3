"""Workers, their server and the children of parsers end with their night, however that ends, at most a second later."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ingest.apart import Apart
from pipeline.lab.interrupts import end_when_told
from tests.conftest import ROOT
from tests.faults.harness import count_session

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="looks processes up in /proc")
NIGHT = """
import signal
import sys
from pathlib import Path
from pipeline.nightly.workers import LocalPool
from tests.faults.test_end_of_a_night import parse_for_ever

if __name__ == "__main__":
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # what a test runs under may have it ignored
    mark = Path(sys.argv[1])
    pool = LocalPool(2, deadline_s=60, preload=("pipeline.nightly.read", "pipeline.nightly.derive"))
    mark.touch()
    [pool.submit(parse_for_ever, mark).result() for _ in range(2)]
"""


def parse_for_ever(mark: Path) -> None:
    """A worker whose parser, in a child of its own, does not end."""
    apart = Apart(mark)
    apart._left_s = 60.0
    apart(_spin, mark.with_suffix(".parsing"))


def _spin(mark: Path) -> None:
    mark.touch()
    while True:
        time.sleep(0.01)


@pytest.mark.long_after(1)
@on_linux
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGHUP])
@pytest.mark.parametrize("moment", ["while its workers load", "while they parse"])
def test_all_end_with_the_night(number: signal.Signals, moment: str, tmp_path: Path) -> None:
    script, mark = tmp_path / "night.py", tmp_path / "mark"
    script.write_text(NIGHT)
    night = subprocess.Popen(
        [sys.executable, script, mark], env={**os.environ, "PYTHONPATH": str(ROOT)}, start_new_session=True
    )
    waited_for = mark if moment == "while its workers load" else mark.with_suffix(".parsing")
    deadline = time.monotonic() + 120
    while not waited_for.exists():
        assert time.monotonic() < deadline
        assert night.poll() is None
        time.sleep(0.02)
    night.send_signal(number)
    night.wait(10)
    deadline = time.monotonic() + 1 + os.getloadavg()[0]  # a second, where others leave us a processor
    while count_session(night.pid) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert count_session(night.pid) == 0


QUERY = """
import os
import signal
import sys
import threading
from pipeline.lab.interrupts import end_when_told
from schemas.database import connect
from schemas.errors import LabError


def query_for_ever():
    connect().execute("SELECT count(*) FROM range(1000000000000) AS t(i) WHERE i % 7 = 3").fetchall()


def query_as_the_snapshot_does():
    try:
        query_for_ever()
    except Exception as error:
        raise LabError("the database could not be built") from error


signal.signal(signal.SIGINT, signal.default_int_handler)  # what runs behind a shell has it ignored
number = int(sys.argv[2])
before = signal.getsignal(number)
for _ in range(4):
    threading.Timer(0.2, os.kill, (os.getpid(), number)).start()
    try:
        with end_when_told():
            globals()[sys.argv[1]]()
    except KeyboardInterrupt:
        assert signal.getsignal(number) is before
        print("interrupted")
"""


@pytest.mark.long_after(2)
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("work", ["query_for_ever", "query_as_the_snapshot_does"])
def test_an_interrupt_during_a_query_is_an_interrupt(work: str, number: signal.Signals) -> None:
    """DuckDB makes a RuntimeError of it, and waits for the thread that has the query, or, one time in four, for ever."""
    script = [sys.executable, "-c", QUERY, work, str(int(number))]
    told = subprocess.run(script, capture_output=True, text=True, timeout=120, check=False, cwd=ROOT)
    assert (told.stdout.split(), told.stderr) == (["interrupted"] * 4, "")


def test_an_error_that_nobody_asked_for_stays_what_it_is() -> None:
    with pytest.raises(RuntimeError, match="by itself"), end_when_told():
        raise RuntimeError("by itself")
