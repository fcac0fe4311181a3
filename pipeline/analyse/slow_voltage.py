"""The force under a slow voltage as rows: the test, and the curve of its force over the voltage."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pipeline.transform.slow_voltage import measure_slow_voltage
from schemas.numbers import finite_or_none
from schemas.recording import Recording
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

NOT_ASKED = "the diagnosis does not simulate the force under a slow voltage: it does not ask this recording"
MOST_POINTS = 400
"""Points of the curve that are kept for the pages."""


def analyse_slow_voltage(recording: Recording) -> tuple[tuple[str, ...], dict[str, pa.Table]]:
    """What limits the test, and its rows: tables `voltage_cycles` and `voltage_cycle_curves`."""
    found, about = measure_slow_voltage(recording), recording.metadata
    shown = np.unique(np.linspace(0, found.time_s.size - 1, min(found.time_s.size, MOST_POINTS)).astype(int))
    bounded = math.isfinite(found.lower)
    tests, curves = TABLES["voltage_cycles"], TABLES["voltage_cycle_curves"]
    row = {
        "recording_id": about.recording_id,
        "specimen_id": about.specimen_id,
        "cycles": found.cycles,
        "peak_kv": found.peak_kv,
        "drop_n_per_kv2": found.drop_n_per_kv2,
        "drop_n_per_kv2_lower": found.lower if bounded else None,
        "drop_n_per_kv2_upper": found.upper if bounded else None,
        "drop_rising_n_per_kv2": finite_or_none(found.rising),
        "drop_falling_n_per_kv2": finite_or_none(found.falling),
        "drop_positive_n_per_kv2": finite_or_none(found.positive),
        "drop_negative_n_per_kv2": finite_or_none(found.negative),
        "exponent": finite_or_none(found.exponent),
        "rest_n": found.rest_n,
        "drift_n_per_min": found.drift_n_per_min,
        "misfit_n": found.misfit_n,
        "warnings": "; ".join(found.warnings) or None,
    }
    drift = found.rest_n + found.drift_n_per_min / 60 * found.time_s
    curve = curves.arrays(
        shown.size,
        recording_id=about.recording_id,
        point=np.arange(shown.size),
        time_s=found.time_s[shown],
        voltage_kv=found.voltage_kv[shown],
        drop_n=(drift - found.force_n)[shown],
        modelled_n=(drift - found.modelled_n)[shown],
    )
    return found.warnings, {"voltage_cycles": tests.rows([row]), "voltage_cycle_curves": curve}
