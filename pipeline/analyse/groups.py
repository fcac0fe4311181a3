"""Analyses over many specimens: survival of configurations, force maps, weak regions. Glue between fits and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import RecordingInput, measured, results_of_kind
from pipeline.analyse.rows.force_maps import force_map_tables
from pipeline.analyse.rows.survival import survival_tables
from pipeline.analyse.weak_regions import analyse_weak_regions
from pipeline.fit.force.comparisons import compare_forces
from pipeline.fit.force.force_map import fit_force_maps
from pipeline.fit.survival.groups import survival_group
from pipeline.transform.force_map import ForceMapReadings
from schemas.lifetimes import LifetimeRow


def analyse_survival(lives: Sequence[LifetimeRow]) -> Analysis:
    """Survival per configuration and voltage, and comparisons, from all lives."""
    analysis = Analysis()
    results = analysis.attempt("survival", survival_group, lives)
    if results is not None:
        analysis.add(survival_tables(results))
    return analysis


def analyse_force_maps(readings: Sequence[ForceMapReadings]) -> Analysis:
    """Static force per pre-stretch, permittivity per point and per map, and differences between configurations."""
    analysis = Analysis()
    fitted = analysis.attempt("force maps", fit_force_maps, readings)
    if fitted is not None:
        points, fits = fitted
        analysis.add(force_map_tables(points, fits, compare_forces(points)))
    return analysis


ANALYSES: Mapping[str, Callable[[Sequence[RecordingInput]], Analysis]] = {
    "survival": lambda given: analyse_survival(results_of_kind(LifetimeRow, given)),
    "force_maps": lambda given: analyse_force_maps(results_of_kind(ForceMapReadings, given)),
    "weak_regions": lambda given: analyse_weak_regions([measured(one) for one in given]),
}
"""The analysis of each group of recordings, by its name."""
