"""Steps keep everything on their way through the table."""

from __future__ import annotations

import math

from pipeline.analyse.rows.self_sensing import sensing_table
from pipeline.analyse.rows.steps import step_table, steps_from_rows
from pipeline.fit.sensing.self_sensing import SensingFit
from pipeline.fit.weighted import Estimate
from pipeline.transform.step import StepResponse


def test_round_trip() -> None:
    full = StepResponse(
        1, 5.0, 15.0, 8.0, 0.5, 0.044, 1e-4, 0.9, 0.01, 0.0, 1.2, 0.8, 28.6, -0.25, 1e-3, 0.5, 0.8, 2, False, ("a",)
    )
    bare = StepResponse(
        2, 5.0, 15.0, 8.0, math.nan, math.nan, math.nan, None, None, None, None, None, warnings=("x", "y")
    )
    first, second = steps_from_rows(step_table("r-1", [full, bare]).to_pylist())
    assert first == full
    assert math.isnan(second.force_step_n)
    assert second.warnings == ("x", "y")
    assert second.capacitive_strain is None


def test_sensing_row() -> None:
    fit = SensingFit(Estimate(5.0, 0.1), 0.99, None, None, -0.36, Estimate(-3.6, 0.2), None, None, 9)
    (row,) = sensing_table("D-1", fit).to_pylist()
    assert row["force_per_capacitive_strain_n_sd"] == 0.1
    assert row["force_per_capacitive_strain_n_lower"] == 5.0 - 1.959963984540054 * 0.1
    assert row["modulus_mpa"] is None
    assert row["drift_pf_per_hour"] == -3.6
