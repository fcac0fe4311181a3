"""Where a film over rods fails: thickness, electrodes, expected and found places."""

from __future__ import annotations

from schemas.tables.table import CAMPAIGN, CONFIGURATION, MadeBy, Table, real, text, truth, whole

TABLES: tuple[Table, ...] = (
    Table(
        "weak_regions",
        "where the film fails: expected and found",
        (
            CONFIGURATION,
            text("region", "left, centre or right third along the rods"),
            real("predicted_share", "", "share of the failures expected here, from the film's thickness"),
            real("predicted_share_lower", "", "least expected share over the plausible exponents of the power law"),
            real("predicted_share_upper", "", "largest expected share over these exponents"),
            real("observed_share", "", "share of the failures found here"),
            real("observed_share_lower", "", "lower 95 % limit of observed_share, exact binomial"),
            real("observed_share_upper", "", "upper 95 % limit of observed_share, exact binomial"),
            whole("failures", "failures in the film found here; those at the lead are not in the film"),
            whole("unknown_site", "of these, failures whose site nobody noted"),
            whole("other_failures", "failures of the whole configuration that are not in the film and do not count"),
            CAMPAIGN,
        ),
        key=("campaign", "configuration", "region"),
        made_by=(MadeBy("group", group="weak_regions"),),
        pages=("campaign",),
    ),
    Table(
        "electrode_layouts",
        "electrodes on the film over its rods: how much of them lies on thin film",
        (
            CONFIGURATION,
            text("scheme", "continuous (hyperelastic) or incremental (the thesis' steps, corrected)"),
            real("thickness_limit", "", "film thinner than this share of the median thickness counts as thin"),
            real("thin_share", "", "share of the active area on thin film"),
            real("thinnest", "", "smallest thickness under an electrode over the median thickness"),
            real("predicted_rod_share", "", "share of the failures expected within 1 mm of a rod"),
            real("observed_rod_share", "", "share of the failures in the film found at a rod"),
            real("peak_field_mv_per_m", "MV/m", "field at the thinnest place under an electrode"),
            CAMPAIGN,
        ),
        key=("campaign", "configuration", "scheme"),
        made_by=(MadeBy("group", group="weak_regions"),),
        pages=("campaign",),
    ),
    Table(
        "film_maps",
        "thickness of the film over its rods on a grid",
        (
            CONFIGURATION,
            text("scheme", "continuous or incremental"),
            real("x_mm", "mm", "along the rods, the middle of the film at 0"),
            real("y_mm", "mm", "across the rods"),
            real("thickness", "", "thickness over undeformed thickness"),
            real("relative_thickness", "", "thickness over the median of the film"),
            truth("active", "under an electrode"),
            CAMPAIGN,
        ),
        key=("campaign", "configuration", "scheme", "y_mm", "x_mm"),
        made_by=(MadeBy("group", group="weak_regions"),),
        pages=("campaign",),
    ),
)
