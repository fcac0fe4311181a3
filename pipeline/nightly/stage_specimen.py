"""The specimen stage: corrections, averages, models and predictions of one specimen, from its recordings' results."""

from __future__ import annotations

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.specimen import analyse_specimen
from pipeline.lab.journal import Outcome
from pipeline.nightly.derived import decoded
from pipeline.nightly.derived import run as run_derived
from pipeline.nightly.stages import DerivedTask


def run(task: DerivedTask) -> Outcome:
    """Analyses a specimen and keeps the results."""
    return run_derived(task, _analysis)


def _analysis(task: DerivedTask) -> Analysis:
    return analyse_specimen(task.name, *decoded(task), orders=tuple(task.settings["orders"]))
