"""Rows of `calibrations`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pipeline.transform.calibration import Calibration, TapCalibration
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def calibration_table(recording_id: str, found: Calibration) -> pa.Table:
    """Two rows: frequency and damping of a tapped clamp, or gain and offset of a weighed force channel."""
    if isinstance(found, TapCalibration):
        repeats, prefix = found.taps, "loaded_" if found.extra_mass_kg else ""
        rows = (
            (f"{prefix}clamp_frequency_hz", "Hz", found.frequency_hz, found.frequency_sd),
            (f"{prefix}damping_ratio", "", found.damping_ratio, found.damping_ratio_sd),
        )
    else:
        repeats = found.plateaus
        rows = (
            ("force_gain", "", found.gain, found.gain_sd),
            ("force_offset_n", "N", found.offset_n, found.offset_sd),
        )
    warnings = "; ".join(found.warnings) or None
    return TABLES["calibrations"].rows(
        {
            "recording_id": recording_id, "quantity": quantity, "unit": unit, "value": value, "sd": sd,
            "repeats": repeats, "warnings": warnings,
        }
        for quantity, unit, value, sd in rows
    )  # fmt: skip
