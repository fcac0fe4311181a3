"""The group stage: what is said about many specimens at once. Each group's tables are replaced as a whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.groups import analyse_force_maps, analyse_survival
from pipeline.analyse.inputs import Measured
from pipeline.analyse.weak_regions import analyse_weak_regions
from pipeline.stages.derived import Decoded
from pipeline.stages.derived import run as run_derived
from pipeline.stages.tasks import DerivedTask
from pipeline.store.journal import Outcome

ANALYSES: Mapping[str, Callable[[Sequence[Measured]], Analysis]] = {
    "survival": analyse_survival,
    "force_maps": analyse_force_maps,
    "weak_regions": analyse_weak_regions,
}
"""The analysis of each group of `pipeline.stages.tasks.GROUPS`."""


def run(task: DerivedTask) -> Outcome:
    """Analyses a group and keeps the results."""
    return run_derived(task, _analysis)


def _analysis(task: DerivedTask, given: Decoded) -> Analysis:
    return ANALYSES[task.name](given.recordings)
