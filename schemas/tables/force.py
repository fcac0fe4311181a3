"""Static actuation force by pre-stretch, its permittivity, and differences between configurations."""

from __future__ import annotations

from schemas.tables.table import CONFIGURATION, SPECIMEN_ID, MadeBy, Table, real, text, whole, with_bounds, with_sd

TABLES: tuple[Table, ...] = (
    Table(
        "force_maps",
        "static actuation force by pre-stretch",
        (
            SPECIMEN_ID,
            CONFIGURATION,
            real("stretch_1", "", "pre-stretch in direction 1"),
            real("stretch_2", "", "pre-stretch in direction 2"),
            whole("direction", "1 or 2"),
            real("force_n", "N", "mean drop of tension"),
            real("force_sd_n", "N", "standard deviation of the repeats"),
            whole("repeats", "number of repeats"),
            real("predicted_n", "N", "force from thesis, eq 3.7, with the metadata's permittivity"),
            *with_sd("relative_permittivity", "", "permittivity that makes eq 3.7 meet the measurement"),
            real("voltage_kv", "kV", "voltage"),
            real("relative_permittivity_lower", "", "lower 95 % limit of relative_permittivity, from the repeats"),
            real("relative_permittivity_upper", "", "upper 95 % limit of relative_permittivity, from the repeats"),
            text("warnings", "what limits the point"),
        ),
        key=("specimen_id", "direction", "stretch_1", "stretch_2", "voltage_kv"),
        made_by=(MadeBy("group", group="force_maps"),),
        pages=("campaign", "specimen"),
    ),
    Table(
        "force_map_fits",
        "one permittivity for all points of a specimen's force map, and whether it is one",
        (
            SPECIMEN_ID,
            CONFIGURATION,
            whole("points", "points: stretches, directions and voltages"),
            *with_bounds("relative_permittivity", "", "permittivity that meets all points best"),
            real("stated_permittivity", "", "permittivity of the metadata"),
            real("p_value", "", "of one permittivity against one for each point; NULL without repeats"),
            *with_bounds("slope", "1 per area stretch", "change of the permittivity with stretch_1 x stretch_2"),
            real("direction_p_value", "", "of equal permittivity in both directions"),
            text("statement", "in words and numbers"),
            text("warnings", "what limits these numbers"),
        ),
        key=("specimen_id", "configuration"),
        made_by=(MadeBy("group", group="force_maps"),),
        pages=("campaign", "specimen"),
    ),
    Table(
        "force_comparisons",
        "static force of two configurations at one pair of pre-stretches",
        (
            text("configuration_a", "first"),
            text("configuration_b", "second"),
            real("stretch_1", "", "pre-stretch in direction 1"),
            real("stretch_2", "", "pre-stretch in direction 2"),
            whole("direction", "1 or 2"),
            real("voltage_kv", "kV", "voltage"),
            whole("specimens_a", "specimens of the first"),
            whole("specimens_b", "specimens of the second"),
            *with_bounds("difference_n", "N", "force of the second less that of the first"),
            *with_bounds("ratio", "", "force of the second over that of the first"),
            real("p_value", "", "of equal forces (Welch)"),
            text("warnings", "what limits the comparison"),
        ),
        key=("configuration_a", "configuration_b", "direction", "stretch_1", "stretch_2", "voltage_kv"),
        made_by=(MadeBy("group", group="force_maps"),),
        pages=("campaign",),
    ),
)
