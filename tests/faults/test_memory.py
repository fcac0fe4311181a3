"""The memory of a night and of its report does not grow with the number of recordings: what is known of them lies on disk."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.faults.many_pages import lab

FEW, MANY = 400, 1600
LIMITS = {"first": 10.0, "quiet": 1.0, "one new": 1.0, "status": 1.0}
"""How much more `MANY` may take than `FEW`, MB. An object for each of them in Python's memory is above all of these."""

REPORT_LIMITS = {"first": 8.0, "nothing new": 1.0}


def memory(folder: Path, number: int) -> dict[str, float]:
    return told("tests.faults.many", str(folder / "raw"), str(folder / "lab"), str(number))


def report_memory(folder: Path, number: int) -> dict[str, float]:
    return told("tests.faults.many_pages", str(lab(folder, number)))


def told(module: str, *arguments: str) -> dict[str, float]:
    command = [sys.executable, "-m", module, *arguments]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is Linux's")
@pytest.mark.parametrize(("measure", "limits"), [(memory, LIMITS), (report_memory, REPORT_LIMITS)])
def test_four_times_the_recordings_take_no_more_memory(
    tmp_path: Path, measure: Callable[[Path, int], dict[str, float]], limits: dict[str, float]
) -> None:
    few, many = (measure(tmp_path / str(number), number) for number in (FEW, MANY))
    grown = {what: round(many[what] - few[what], 1) for what in limits}
    assert all(grown[what] < limit for what, limit in limits.items()), f"grown by {grown} MB: {few}, {many}"
