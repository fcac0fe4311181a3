"""Stands in for `pipeline.nightly.workers.perform` in workers: what it does to them is in the name of the raw file.

`kill`, `memory` and `stuck` do it every time; `…once` the first time only, which a file beside the recording remembers.
"""

from __future__ import annotations

import os
import signal
import time
from typing import Any

from pipeline.nightly.read import RecordingTask
from pipeline.nightly.workers import perform as perform_well


def perform(task: Any) -> Any:
    """Kills or holds up the worker, or performs the task."""
    if isinstance(task, RecordingTask):
        fault = task.source.path.stem.partition("-")[0]
        if fault.endswith("once"):
            mark = task.source.path.parent.with_suffix(".seen")  # beside the raw folder, all of whose files are told
            fault = "" if mark.exists() else fault.removesuffix("once")
            mark.touch()
        if fault == "kill":
            os.kill(os.getpid(), signal.SIGKILL)
        if fault == "memory":
            hoard = [bytes(1 << 20)]
            while True:
                hoard.append(bytearray(64 << 20))
        if fault == "stuck":
            time.sleep(3600)
    return perform_well(task)
