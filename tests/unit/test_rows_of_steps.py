"""Steps and what is fitted to them keep everything on their way into their tables."""

from __future__ import annotations

import math

from pipeline.analyse.self_sensing import sensing_table
from pipeline.fit.sensing.self_sensing import SensingFit
from pipeline.fit.weighted import Estimate
from pipeline.transform.step import StepResponse
from schemas.tables import TABLES


def test_steps() -> None:
    full = StepResponse(
        1, 5.0, 15.0, 8.0, 0.5, 0.044, 1e-4, 0.9, 0.01, 0.0, 1.2, 0.8, 28.6, -0.25, 1e-3, 0.5, 0.8, 2, False, ("a", "b")
    )
    bare = StepResponse(2, 5.0, 15.0, 8.0, math.nan, math.nan, math.nan, None, None, None, None, None)
    table = TABLES["step_responses"].from_objects([full, bare], recording_id="r-1", specimen_id="s-1")
    first, second = table.to_pylist()
    assert (first.pop("recording_id"), first.pop("specimen_id"), first.pop("warnings")) == ("r-1", "s-1", "a; b")
    assert first.pop("capacitive_strain") == 0.25 / 28.6
    assert first == {name: value for name, value in vars(full).items() if name != "warnings"}
    assert (second["cycle"], second["force_step_n"], second["warnings"]) == (2, None, None)
    assert second["capacitive_strain"] is None


def test_a_sensing_fit() -> None:
    fit = SensingFit(Estimate(5.0, 0.1), 0.99, None, None, -0.36, Estimate(-3.6, 0.2), None, None, 9)
    (row,) = sensing_table("D-1", fit).to_pylist()
    assert row["force_per_capacitive_strain_n_sd"] == 0.1
    assert row["force_per_capacitive_strain_n_lower"] == 5.0 - 1.959963984540054 * 0.1
    assert row["modulus_mpa"] is None
    assert row["drift_pf_per_hour"] == -3.6
