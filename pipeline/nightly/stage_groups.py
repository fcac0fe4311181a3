"""The group stage: what is said about many specimens at once. Each group's tables are replaced as a whole."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.groups import analyse_force_maps, analyse_survival
from pipeline.analyse.inputs import RecordingInput, measured, results_of_kind
from pipeline.analyse.weak_regions import analyse_weak_regions
from pipeline.lab.inputs import fetch_results, read_members
from pipeline.lab.journal import Outcome
from pipeline.lab.reader import Reader
from pipeline.nightly.derived import run as run_derived
from pipeline.nightly.stages import GROUPS, DerivedTask
from pipeline.transform.force_map import ForceMapReadings
from schemas.lifetimes import LifetimeRow

ANALYSES: Mapping[str, Callable[[Sequence[RecordingInput]], Analysis]] = {
    "survival": lambda given: analyse_survival(results_of_kind(LifetimeRow, given)),
    "force_maps": lambda given: analyse_force_maps(results_of_kind(ForceMapReadings, given)),
    "weak_regions": lambda given: analyse_weak_regions([measured(one) for one in given]),
}
"""The analysis of each group of `pipeline.nightly.stages.GROUPS`."""


def run(task: DerivedTask) -> Outcome:
    """Analyses a group and keeps the results."""
    return run_derived(task, _analysis)


def _analysis(task: DerivedTask) -> Analysis:
    return ANALYSES[task.name](_fetched(task))


def _fetched(task: DerivedTask) -> Sequence[RecordingInput]:
    group = GROUPS[task.name]
    members = () if task.members is None else read_members(task.members, task.journal)
    with contextlib.nullcontext() if task.snapshot is None else Reader(task.snapshot) as reader:
        return fetch_results(members, reader, group.kinds, mention=group.mention)
