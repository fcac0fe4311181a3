"""A night over many recordings without their numerical work: `python -m tests.faults.many RAW LAB NUMBER` makes them and runs
a first night, one with nothing new and one with one new, asks for the status, and tells their memory and how long two of them took.

What a worker gives for a recording is made up in this process, so that the rest of the night shows.
"""

from __future__ import annotations

import json
import os
import sys
import time
import tracemalloc
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pipeline.nightly.night
import pipeline.nightly.workers
from pipeline import Lab
from pipeline.analyse.description import recordings_table
from pipeline.commands.show.status import describe_lab
from pipeline.lab.journal import OK, Freshness, Outcome, write_entry
from pipeline.nightly.derive import DerivedTask
from pipeline.nightly.freshness import hash_input, hash_mapping
from pipeline.nightly.read import RecordingTask
from pipeline.nightly.stages import RECORDING
from schemas.tables import TABLES
from tests.helpers.machine import peak_mb

_START = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)


def perform(task: RecordingTask | DerivedTask) -> Outcome:
    """Stands in for `pipeline.nightly.workers.perform`: a life for each recording, nothing for what is made from them."""
    if isinstance(task, DerivedTask):
        outcome = Outcome(task.item_id, task.stage, task.freshness, OK, 0.001, None, {"notes": []})
        write_entry(task.journal, outcome, {})
        return outcome
    name = task.source.path.stem
    made_from = hash_input(hash_mapping(task.source), task.sha256, "")
    about = {"recording_id": name, "specimen_id": f"S-{name}", "protocol": "lifetime", "status": "ok", "problem": None}
    facts = {**about, "rig_id": None, "samples_path": None, "refusal": None, "carried": ["Lifetime", "SessionFeatures"]}
    freshness = Freshness(made_from, task.code_version, task.settings_hash)
    outcome = Outcome(task.item_id, RECORDING, freshness, OK, 0.001, None, facts)
    row = about | {
        "configuration": "A",
        "started_at": _START + timedelta(minutes=int(name)),
        "kind": "recording",
        "metadata": json.dumps({"recording": about, "rig": {}}),
        "source_path": os.fspath(task.source.path),
        "source_sha256": task.sha256,
        "source_present": True,
    }
    carried: list[dict[str, Any]] = [
        {"recording_id": name, "kind": kind, "position": place, "payload": "x" * 1000}
        for place, kind in enumerate(facts["carried"])
    ]
    tables = {"recordings": recordings_table([row]), "carried": TABLES["carried"].rows(carried)}
    write_entry(task.journal, outcome, tables)
    return outcome


def file(raw: Path, number: int) -> None:
    """A raw file with a content of its own, of yesterday."""
    path = raw / f"{number // 1000:03d}" / f"{number:06d}.mcap"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(str(number))
    yesterday = time.time() - 86_400
    os.utime(path, (yesterday, yesterday))


def main(raw: Path, lab: Lab, number: int) -> dict[str, float]:
    """Memory in MB: the most that the first night had, and what Python's objects took in each of the others.

    Times in s: that night, and one with nothing new whose memory nobody traces.
    """
    pipeline.nightly.workers.perform = perform  # type: ignore[assignment]
    pipeline.nightly.night._write_report = lambda *_: None  # type: ignore[assignment]
    for one in range(number):
        file(raw, one)
    told = {}
    for what, new in (("first, s", number), ("quiet, s", 0)):
        begin = time.monotonic()
        assert pipeline.nightly.night.nightly([raw], lab, jobs=0).counts.ingested == new
        told[what] = time.monotonic() - begin
    told["first"] = peak_mb()
    for what, new in (("quiet", 0), ("one new", 1)):
        for one in range(new):
            file(raw, number + one)
        tracemalloc.start()
        assert pipeline.nightly.night.nightly([raw], lab, jobs=0).counts.ingested == new
        told[what] = tracemalloc.get_traced_memory()[1] / (1 << 20)
        tracemalloc.stop()
    tracemalloc.start()
    assert f"{number + 1} ok" in describe_lab(lab)
    told["status"] = tracemalloc.get_traced_memory()[1] / (1 << 20)
    tracemalloc.stop()
    return told


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]), Lab(sys.argv[2]), int(sys.argv[3]))))
