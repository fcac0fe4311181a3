"""Films under a load that is held: creep and its recovery."""

from __future__ import annotations

from schemas.tables.table import (
    RECORDING_ID,
    SPECIMEN_ID,
    MadeBy,
    Table,
    real,
    text,
    truth,
    whole,
    with_bounds,
    with_sd,
)

TABLES = (
    Table(
        "creep_tests",
        "what a film does under a load that is put on, held and taken off",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            *with_sd("load_n", "N", "change of the load"),
            real("hold_s", "s", "how long the load was on"),
            real("recovery_s", "s", "how long it was off afterwards; NULL where it was not taken off"),
            *with_bounds("elastic_mm", "mm", "displacement at once, by the selected order"),
            *with_bounds("end_mm", "mm", "displacement at the end of the load"),
            *with_bounds("left_mm", "mm", "displacement left at the end of the record; NULL without recovery"),
            *with_bounds(
                "recovered_share",
                "",
                "share of end_mm that had come back at the end of the record; the interval holds both readings of a drift",
            ),
            *with_bounds("compliance_mm_per_n", "mm/N", "end_mm over the load, load cell in series left out"),
            real("strain_at_end", "", "end_mm over the length of the film; NULL where that is not known"),
            *with_bounds("drift_mm_per_h", "mm/h", "constant drift of the displacement; NULL where it counts as creep"),
            real("walk_mm_per_sqrt_h", "mm/√h", "wander of the displacement: its standard deviation after an hour"),
            real(
                "load_cell_mm_per_n", "mm/N", "compliance of the load cell that was taken off; 0 where no rig is known"
            ),
            whole("model_order", "retardation times that the record asks for"),
            text("warnings", "what limits the numbers"),
        ),
        key=("recording_id",),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "creep_fits",
        "retardation of a film under a held load and the Maxwell-Wiechert model that is the same, a row per recording and order",
        (
            RECORDING_ID,
            SPECIMEN_ID,
            whole("model_order", "number of retardation times, a flow counting as one"),
            truth("selected", "the order that the record asks for"),
            real("p_value", "", "of no further retardation time being needed; NULL for the highest order"),
            real("reduced_chi2", "", "against noise and wander of the displacement"),
            *with_sd("instant_mm_per_n", "mm/N", "compliance at once, load cell left out"),
            *with_sd("flow_mm_per_n_s", "mm/(N s)", "compliance by flow; NULL where the film does not flow"),
            text(
                "retardations",
                "JSON: compliance in mm/N and retardation time in s of each, longest first, each with _sd",
            ),
            *with_sd("k0_n_per_mm", "N/mm", "main spring of the same film"),
            text("arms", "JSON: spring in N/mm and relaxation time in s of each arm of the same film, each with _sd"),
            text("warnings", "what limits the numbers"),
        ),
        key=("recording_id", "model_order"),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
    Table(
        "creep_curves",
        "displacement under a held load, means over windows in log time, beside the selected order",
        (
            RECORDING_ID,
            whole("hold", "number of the level of the load, from 0"),
            real("time_s", "s", "since the recording's first sample"),
            real("since_s", "s", "since the load changed to this level"),
            real("load_n", "N", "change of the load from its first level"),
            real("displacement_mm", "mm", "as recorded"),
            real("modelled_mm", "mm", "by the selected order, offset and drift included"),
            truth("usable", "false where the window rings"),
        ),
        key=("recording_id", "time_s"),
        made_by=(MadeBy("recording"),),
        pages=("specimen",),
    ),
)
