"""Electrical responses: actuation force, contradiction between loadings, cross-prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.fit.relaxation.electrical import fit_electrical, fit_joint
from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.fit.relaxation.predict import predict, predict_response
from pipeline.fit.relaxation.results import SpecimenFits
from schemas.errors import NotIdentifiableError
from schemas.tables import TABLES
from tests.helpers.fit_truth import (
    ACRYLATE,
    BAND,
    MASS,
    electrical,
    electrical_response,
    film,
    mechanical,
    response,
    rig,
)

FORCE = 0.00198  # N/kV²: 0.097 N at 7 kV
AMPLITUDE = "force_per_voltage_squared_n_per_kv2"
K = film(BAND, ACRYLATE)


@pytest.fixture(scope="module")
def mechanical_fit() -> SpecimenFits:
    return fit_specimen([response(BAND, mechanical(BAND, K), np.random.default_rng(seed=0))], rig(1.03))


def test_actuation_force_with_the_mechanical_model(mechanical_fit: SpecimenFits) -> None:
    rng = np.random.default_rng(seed=1)
    data = electrical_response(BAND, electrical(BAND, K, FORCE), rng, recording_id="e1")
    fits = fit_electrical([data], rig(1.03), mechanical_fit)
    e = fits.selected.estimates[AMPLITUDE]
    assert e.sd is not None
    assert abs(e.value - FORCE) < 3 * e.sd
    assert e.sd < 0.02 * FORCE
    assert fits.selected_order == 3
    assert not any("does not fit" in w for w in fits.selected.warnings)
    assert fits.selected.phase_error_deg < 0.5


def test_bic_of_a_model_that_was_taken_up_hangs_on_no_last_digit(mechanical_fit: SpecimenFits) -> None:
    """Its yardstick is the best relaxation with the rig as its file says: with a rig of any constants many are as good."""
    rng = np.random.default_rng(3)
    data = electrical_response(BAND, electrical(BAND, K, FORCE), rng, recording_id="e1")
    found = []
    for _ in range(8):
        moved = replace(data, value=data.value * (1 + 1e-14 * rng.normal(size=BAND.size)))
        found.append([f.bic for f in fit_electrical([moved], rig(1.03), mechanical_fit).fits])
    np.testing.assert_allclose(found, np.broadcast_to(found[0], np.shape(found)), rtol=1e-6)
    assert found[0][0] > found[0][2] + 100


def test_voltages_that_differ_by_a_factor_widen_the_force(mechanical_fit: SpecimenFits) -> None:
    rng = np.random.default_rng(seed=2)
    data = [
        electrical_response(BAND, electrical(BAND, K, FORCE * g), rng, recording_id=f"e{i}")
        for i, g in enumerate((1.03, 1.0, 0.97))
    ]
    fits = fit_electrical(data, rig(1.03), mechanical_fit)
    assert fits.spread.gain_sd == pytest.approx(0.03, abs=0.01)
    e = fits.selected.estimates[AMPLITUDE]
    assert e.sd is not None
    assert e.sd > 0.01 * FORCE


def test_contradiction_with_the_mechanical_model_is_said(mechanical_fit: SpecimenFits) -> None:
    """A strip of another relaxation in series: the shape of H is not the one that k predicts."""
    lagging = 1 / (1 + 2j * np.pi * BAND * 0.002)
    data = electrical_response(BAND, electrical(BAND, K, FORCE) * lagging, np.random.default_rng(seed=3))
    fits = fit_electrical([data], rig(1.03), mechanical_fit)
    assert any("does not fit the electrical recordings" in w for w in fits.selected.warnings)


def test_free_stiffness_from_electrical_recordings_alone() -> None:
    data = electrical_response(BAND, electrical(BAND, K, FORCE), np.random.default_rng(seed=5))
    fits = fit_electrical([data], rig())
    e = fits.selected.estimates[AMPLITUDE]
    assert e.sd is not None
    assert abs(e.value - FORCE) < 3.5 * e.sd
    band = fits.selected.band(BAND)
    assert np.mean(np.abs(fits.selected.model.stiffness(BAND) - K) < 3 * band) > 0.9


def test_joint_fit_shares_arms_and_sharpens_the_rig(mechanical_fit: SpecimenFits) -> None:
    rng = np.random.default_rng(seed=6)
    g = response(BAND, mechanical(BAND, K), rng, recording_id="m")
    h = electrical_response(BAND, electrical(BAND, K, FORCE), rng, recording_id="e")
    fits = fit_joint([g], [h], rig(1.03))
    assert fits.loading == "joint"
    assert fits.selected_order == 3
    own, before = fits.selected.estimates["clamp_mass_kg"], mechanical_fit.selected.estimates["clamp_mass_kg"]
    assert own.sd is not None
    assert before.sd is not None
    assert own.sd < before.sd
    assert abs(own.value - 1e3 * MASS) < 3 * own.sd
    assert np.sqrt(np.mean(np.abs(fits.selected.model.stiffness(BAND) / K - 1) ** 2)) < 0.006


def test_prediction_of_the_electrical_response_has_no_shape_parameter(mechanical_fit: SpecimenFits) -> None:
    h = electrical(BAND, K, FORCE)
    data = electrical_response(BAND, h, None, recording_id="e")
    found = predict(mechanical_fit, [data], [rig(1.03)], predicted="electrical")
    assert found is not None
    assert found.fitted_on == "mechanical"
    assert found.relative_error < 0.01
    assert found.phase_error_deg < 0.5
    given = predict(mechanical_fit, [data], [rig(1.03)], predicted="electrical", amplitude=1.1 * FORCE)
    assert given is not None
    assert given.relative_error == pytest.approx(0.1, abs=0.02)
    assert given.magnitude_error == pytest.approx(0.1 * np.mean(np.abs(h)), rel=0.1)
    first = mechanical_fit.of_order(1)
    assert np.allclose(predict_response(first, data, rig(1.03), 1.0).shape, (100,))
    rows = TABLES["predictions"].from_objects([found]).to_pylist()
    assert rows[0]["predicted"] == "electrical"


def test_reverse_prediction_and_refusal() -> None:
    data = electrical_response(BAND, electrical(BAND, K, FORCE), np.random.default_rng(seed=5))
    fits = fit_electrical([data], rig())
    g = response(BAND, mechanical(BAND, K), None)
    found = predict(fits, [g], [rig()], predicted="mechanical")
    assert found is not None
    assert 0.01 < found.relative_error < 0.6
    with pytest.raises(NotIdentifiableError, match="load cell's stiffness"):
        fit_electrical([data], None)
    with pytest.raises(NotIdentifiableError, match="cannot be predicted"):
        predict(fits, [data], [None], predicted="electrical")
