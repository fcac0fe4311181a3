"""Analyses over many specimens by name: survival of configurations, force maps, weak regions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.force_maps import analyse_force_maps
from pipeline.analyse.inputs import RecordingInput, measured, results_of_kind
from pipeline.analyse.survival import analyse_survival
from pipeline.analyse.weak_regions import analyse_weak_regions
from pipeline.transform.force_map import ForceMapReadings
from schemas.lifetimes import LifetimeRow

ANALYSES: Mapping[str, Callable[[Sequence[RecordingInput]], Analysis]] = {
    "survival": lambda given: analyse_survival(results_of_kind(LifetimeRow, given)),
    "force_maps": lambda given: analyse_force_maps(results_of_kind(ForceMapReadings, given)),
    "weak_regions": lambda given: analyse_weak_regions([measured(one) for one in given]),
}
"""The analysis of each group of recordings, by its name."""
