"""Rows of model_fits."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pipeline.analyse.model_fits import model_fits_table
from pipeline.fit.relaxation.identify import fit_corrected, fit_specimen
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.transform.correction import correct_mechanical
from tests.helpers.fit_truth import ACRYLATE, BAND, SLOW_BAND, STACK, film, mechanical, response, rig


def test_rows_of_all_orders() -> None:
    data = response(BAND, mechanical(BAND, film(BAND, ACRYLATE)), np.random.default_rng(seed=0))
    forward = fit_specimen([data], rig(1.03), geometry=Geometry(70.0, 35.7))
    corrected = fit_corrected(correct_mechanical(data, rig(1.03)))
    rows = model_fits_table([forward, corrected]).to_pylist()
    assert [(r["method"], r["model_order"]) for r in rows] == [
        (m, n) for m in ("forward", "corrected") for n in (1, 2, 3)
    ]
    third = rows[2]
    assert [r["selected"] for r in rows[:3]] == [False, False, True]
    assert third["k3_n_per_mm"] == pytest.approx(30, rel=0.05)
    assert third["c1_n_s_per_mm"] == pytest.approx(0.05, rel=0.1)
    assert third["k4_n_per_mm"] is None
    assert 0 < third["k1_n_per_mm_sd"] < 0.5
    assert third["clamp_mass_kg_sd"] > 0
    assert third["force_per_voltage_squared_n_per_kv2"] is None
    assert third["modulus_mpa"] == pytest.approx(third["k0_n_per_mm"] * 70 / 35.7)
    assert third["frequency_low_hz"] == pytest.approx(1.0)
    assert third["frequency_lines"] == 100
    assert third["magnitude_error_n_per_mm"] > 0
    names = json.loads(third["covariance"])
    assert len(names["matrix"]) == len(names["names"]) >= 10
    assert json.loads(third["choices"])["test"] == 3
    assert set(json.loads(third["intervals"])["k1"]) == {"lower", "upper", "method"}
    assert third["spread"] is None
    assert third["specimen_id"] == "film-1"


def test_pure_dashpot_has_no_spring_and_its_damper() -> None:
    value = film(SLOW_BAND, (STACK[0], STACK[1][:2], STACK[2][:2])) + 2j * np.pi * SLOW_BAND * 0.05
    fits = fit_specimen([response(SLOW_BAND, value, np.random.default_rng(seed=1), relative=0.01)])
    row = model_fits_table([fits]).to_pylist()[2]
    if fits.of_order(3).model.c_inf == 0:
        assert row["k3_n_per_mm_sd"] is None
    else:
        assert row["k3_n_per_mm"] is None
        assert "pure dashpot" in row["warnings"]
    assert row["c3_n_s_per_mm"] == pytest.approx(0.05, rel=0.05)
    assert row["c3_n_s_per_mm_sd"] > 0
