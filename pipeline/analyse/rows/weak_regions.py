"""Rows of `weak_regions`, `electrode_layouts` and `film_maps`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from pipeline.fit.survival.weak_regions import THIN, FilmGrid, LayoutCheck, RegionShare
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def weak_region_tables(
    configuration: str, shares: Sequence[RegionShare], checks: Sequence[LayoutCheck], grids: Sequence[FilmGrid]
) -> dict[str, pa.Table]:
    """Arrow tables of one configuration."""
    import pyarrow as pa

    regions = [
        {
            "configuration": configuration,
            "region": s.region,
            "predicted_share": s.predicted,
            "predicted_share_lower": s.predicted_range[0],
            "predicted_share_upper": s.predicted_range[1],
            "observed_share": s.observed,
            "observed_share_lower": s.observed_interval[0] if s.observed_interval else None,
            "observed_share_upper": s.observed_interval[1] if s.observed_interval else None,
            "failures": s.failures,
        }
        for s in shares
    ]
    layouts = [
        {
            "configuration": configuration,
            "scheme": c.scheme,
            "thickness_limit": THIN,
            "thin_share": c.thin_share,
            "thinnest": c.thinnest,
            "predicted_rod_share": c.predicted_rod_share,
            "observed_rod_share": c.observed_rod_share,
            "peak_field_mv_per_m": c.peak_field_mv_per_m,
        }
        for c in checks
    ]
    maps = [
        TABLES["film_maps"].arrays(
            grid.x_mm.size,
            configuration=configuration,
            scheme=grid.scheme,
            x_mm=grid.x_mm,
            y_mm=grid.y_mm,
            thickness=grid.thickness,
            relative_thickness=grid.relative_thickness,
            active=grid.active,
        )
        for grid in grids
    ]
    return {
        "weak_regions": TABLES["weak_regions"].rows(regions),
        "electrode_layouts": TABLES["electrode_layouts"].rows(layouts),
        "film_maps": pa.concat_tables(maps) if maps else TABLES["film_maps"].empty(),
    }
