"""What the stages after the first share: an analysis of recordings' results, run, timed and kept."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import Measured, measured
from pipeline.lab.journal import FAILED, OK, Outcome, write_entry
from pipeline.nightly.stages import DerivedTask
from schemas.errors import DealabError, LabError


def decoded(task: DerivedTask) -> tuple[tuple[Measured, ...], tuple[Measured, ...]]:
    """The task's recordings and calibrations for an analysis."""
    return tuple(measured(r) for r in task.recordings), tuple(measured(r) for r in task.calibrations)


def run(task: DerivedTask, analyse: Callable[[DerivedTask], Analysis]) -> Outcome:
    """Runs an analysis and keeps what it gives. Raises `LabError` when the lab cannot be read or written."""
    started = time.monotonic()
    try:
        analysis = analyse(task)
    except (LabError, MemoryError):
        raise
    except DealabError as error:
        analysis = Analysis(failures=[str(error)])
    except Exception as error:
        analysis = Analysis(failures=[f"{type(error).__name__}: {error}\n{traceback.format_exc()}"])
    return _kept(task, analysis, time.monotonic() - started)


def _kept(task: DerivedTask, analysis: Analysis, seconds: float) -> Outcome:
    outcome = Outcome(
        task.item_id,
        task.stage,
        task.freshness,
        FAILED if analysis.failures else OK,
        round(seconds, 3),
        "\n".join(analysis.failures) or None,
        {"notes": analysis.notes},
    )
    write_entry(task.journal, outcome, analysis.joined())
    return outcome
