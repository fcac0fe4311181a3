"""Constants of rigs from their calibrations."""

from __future__ import annotations

from schemas.tables.table import RECORDING_ID, MadeBy, Table, real, text, whole

TABLES: tuple[Table, ...] = (
    Table(
        "calibrations",
        "what the calibrations of a rig gave",
        (
            RECORDING_ID,
            text(
                "quantity",
                "clamp_frequency_hz, damping_ratio, force_gain or force_offset_n; with a further mass on the clamp"
                " loaded_clamp_frequency_hz, loaded_damping_ratio",
            ),
            text("unit", "unit of value"),
            real(
                "value",
                "see unit",
                "the clamp alone: undamped frequency, damping; recorded = gain x true force + offset",
            ),
            real("sd", "see unit", "standard deviation of value"),
            whole("repeats", "taps or plateaus"),
            text("warnings", "what limits these numbers"),
        ),
        key=("recording_id", "quantity"),
        made_by=(MadeBy("recording"),),
        pages=("index", "control", "specimen", "recording"),
    ),
)
