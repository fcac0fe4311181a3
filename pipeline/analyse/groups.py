"""Analyses over many specimens: survival of configurations, force maps. Pure glue between fits and tables."""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.rows.force_maps import force_map_tables
from pipeline.analyse.rows.survival import survival_tables
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
