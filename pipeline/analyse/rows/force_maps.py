"""Force maps as arrow tables: points, the permittivity of a map, differences between configurations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pipeline.analyse.rows.recordings import joined
from pipeline.analyse.rows.survival import bounded
from pipeline.fit.force.comparisons import ForceComparison
from pipeline.fit.force.force_map import ForceMapFit
from pipeline.fit.force.points import ForcePoint
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def force_map_tables(
    points: Sequence[ForcePoint], fits: Sequence[ForceMapFit], comparisons: Sequence[ForceComparison]
) -> dict[str, pa.Table]:
    """Tables `force_maps`, `force_map_fits` and `force_comparisons`."""
    return {
        "force_maps": TABLES["force_maps"].rows(
            {
                "specimen_id": p.specimen_id,
                "configuration": p.configuration,
                "stretch_1": p.stretch_1,
                "stretch_2": p.stretch_2,
                "direction": p.direction,
                "force_n": p.force_n,
                "force_sd_n": p.force_sd_n,
                "repeats": p.repeats,
                "predicted_n": p.predicted_n,
                "relative_permittivity": p.relative_permittivity.value,
                "relative_permittivity_sd": p.relative_permittivity_sd,
                "relative_permittivity_lower": p.relative_permittivity.lower,
                "relative_permittivity_upper": p.relative_permittivity.upper,
                "voltage_kv": p.voltage_kv,
                "warnings": joined(p.warnings),
            }
            for p in points
        ),
        "force_map_fits": TABLES["force_map_fits"].rows(
            {
                "specimen_id": fit.specimen_id,
                "configuration": fit.configuration,
                "points": fit.points,
                **bounded("relative_permittivity", fit.relative_permittivity),
                "stated_permittivity": fit.stated_permittivity,
                **(
                    {
                        "p_value": fit.constancy.p_value,
                        **bounded("slope", fit.constancy.slope),
                        "direction_p_value": fit.constancy.direction_p_value,
                    }
                    if fit.constancy
                    else {}
                ),
                "statement": fit.statement,
                "warnings": joined(fit.warnings),
            }
            for fit in fits
        ),
        "force_comparisons": TABLES["force_comparisons"].rows(
            {
                "configuration_a": c.configuration_a,
                "configuration_b": c.configuration_b,
                "stretch_1": c.stretch_1,
                "stretch_2": c.stretch_2,
                "direction": c.direction,
                "voltage_kv": c.voltage_kv,
                "specimens_a": c.specimens_a,
                "specimens_b": c.specimens_b,
                **bounded("difference_n", c.difference_n),
                **bounded("ratio", c.ratio),
                "p_value": c.p_value,
                "warnings": joined(c.warnings),
            }
            for c in comparisons
        ),
    }
