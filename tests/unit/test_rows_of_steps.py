"""Steps and what is fitted to them keep everything on their way into their tables, and are told with their errors."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.analyse.self_sensing import sensing_table
from pipeline.fit.sensing.self_sensing import SensingFit
from pipeline.fit.weighted import Estimate
from pipeline.transform.step import StepResponse
from reports.pages.specimen import stepping
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


def test_a_slope_of_steps_has_its_error_and_a_single_voltage_its_scatter() -> None:
    volts = np.repeat([2.0, 3.0, 4.0], 40)
    step = 2.5 * volts**2 + np.random.default_rng(seed=5).normal(0, 0.8, volts.size)
    kept = np.ones(volts.size, dtype=bool)
    slope = stepping._slope(volts, step, kept)
    sd = stepping._slope_sd(volts, step, kept, slope)
    assert sd == pytest.approx(0.8 / np.sqrt(np.sum(volts**4)), rel=0.2)
    assert abs(slope - 2.5) < 4 * sd
    assert stepping._slope_sd(volts[:2], step[:2], kept[:2], slope) is None
    cycles = {
        "voltage_kv": np.full(3, 7.0), "wrinkled": np.zeros(3), "force_step_n": np.array([0.0531, 0.0538, 0.0542]), "force_step_sd_n": np.full(3, np.nan),
        "capacitance_step_pf": np.full(3, np.nan), "capacitance_step_sd_pf": np.full(3, np.nan),
    }  # fmt: skip
    assert stepping.finding(cycles).replace("\u00a0", " ") == "force changes by 53.7 ± 0.6 mN at 7 kV"
