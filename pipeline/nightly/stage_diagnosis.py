"""The diagnosis stage: what the simulation of one specimen's recordings gets wrong, from their features."""

from __future__ import annotations

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.diagnosis import analyse_diagnosis
from pipeline.lab.journal import Outcome
from pipeline.nightly.derived import decoded
from pipeline.nightly.derived import run as run_derived
from pipeline.nightly.stages import DerivedTask


def run(task: DerivedTask) -> Outcome:
    """Diagnoses a specimen and keeps the results."""
    return run_derived(task, _analysis)


def _analysis(task: DerivedTask) -> Analysis:
    return analyse_diagnosis(task.name, *decoded(task))
