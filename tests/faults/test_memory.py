"""The memory of a night does not grow with the number of recordings: what is known of them lies on disk."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT

FEW, MANY = 400, 1600
LIMITS = {"first": 10.0, "quiet": 1.0, "one new": 1.0}
"""How much more `MANY` may take than `FEW`, MB. An object for each of them in Python's memory is above all of these."""


def memory(folder: Path, number: int) -> dict[str, float]:
    command = [sys.executable, "-m", "tests.faults.many", str(folder / "raw"), str(folder / "lab"), str(number)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="the peak of memory is Linux's")
def test_four_times_the_recordings_take_no_more_memory(tmp_path: Path) -> None:
    few, many = (memory(tmp_path / str(number), number) for number in (FEW, MANY))
    grown = {night: round(many[night] - few[night], 1) for night in LIMITS}
    assert all(grown[night] < limit for night, limit in LIMITS.items()), f"grown by {grown} MB: {few}, {many}"
