"""Analyses over many specimens by name: survival of configurations, force maps (static force per pre-stretch, permittivity per
point and per map, differences between configurations), weak regions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import RecordingInput, measured, results_of_kind
from pipeline.analyse.survival import analyse_survival
from pipeline.analyse.weak_regions import analyse_weak_regions
from pipeline.fit.force.comparisons import ForceComparison, compare_forces
from pipeline.fit.force.force_map import ForceMapFit, fit_force_maps
from pipeline.fit.force.points import ForcePoint
from pipeline.transform.force_map import ForceMapReadings
from schemas.lifetimes import LifetimeRow
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


ANALYSES: Mapping[str, Callable[[Sequence[RecordingInput]], Analysis]] = {
    "survival": lambda given: analyse_survival(results_of_kind(LifetimeRow, given)),
    "force_maps": lambda given: analyse_force_maps(results_of_kind(ForceMapReadings, given)),
    "weak_regions": lambda given: analyse_weak_regions([measured(one) for one in given]),
}
"""The analysis of each group of recordings, by its name."""


def analyse_force_maps(readings: Sequence[ForceMapReadings]) -> Analysis:
    """Points, permittivities and comparisons from the readings of all force maps."""
    analysis = Analysis()
    fitted = analysis.attempt("force maps", fit_force_maps, readings)
    if fitted is not None:
        points, fits = fitted
        analysis.add(force_map_tables(points, fits, compare_forces(points)))
    return analysis


def force_map_tables(
    points: Sequence[ForcePoint], fits: Sequence[ForceMapFit], comparisons: Sequence[ForceComparison]
) -> dict[str, pa.Table]:
    """Tables `force_maps`, `force_map_fits` and `force_comparisons`."""
    return {
        "force_maps": TABLES["force_maps"].from_objects(points),
        "force_map_fits": TABLES["force_map_fits"].from_objects(
            fits,
            p_value=lambda fit: fit.constancy and fit.constancy.p_value,
            slope=lambda fit: fit.constancy and fit.constancy.slope,
            direction_p_value=lambda fit: fit.constancy and fit.constancy.direction_p_value,
        ),
        "force_comparisons": TABLES["force_comparisons"].from_objects(comparisons),
    }
