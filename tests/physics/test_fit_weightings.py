"""Models with weights that do not follow the noise: against least squares written out here."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from pipeline.analyse.model_fits import model_fits_table
from pipeline.fit.relaxation.identify import fit_corrected
from pipeline.fit.relaxation.results import NOISE, RELATIVE, UNIFORM
from pipeline.fit.relaxation.weightings import fit_weighted
from pipeline.transform.response import FrequencyResponse
from tests.helpers.fit_truth import ACRYLATE, BAND, film, response

STARTS = {1: [(1.0, 10.0, 0.05)], 2: [(1.0, 3.0, 0.05, 20.0, 0.02), (1.0, 1.5, 0.05, 10.0, 0.04)]}


def measured() -> FrequencyResponse:
    """A third-order film, of which the slow lines are measured a hundred times better than the fast ones."""
    rng = np.random.default_rng(33)
    k = film(BAND, ACRYLATE)
    sd = np.geomspace(1e-4, 1e-2, BAND.size) * np.abs(k)
    noise = sd / np.sqrt(2) * (rng.normal(size=k.size) + 1j * rng.normal(size=k.size))
    return replace(response(BAND, k + noise, None), variance=sd**2, specimen_id="S")


def least(found: FrequencyResponse, weighting: str, order: int) -> np.ndarray:
    """k0 and springs and dampers in turn that make Σ|k_model − k|², or Σ|k_model/k − 1|², least."""
    weight = 1 / np.abs(found.value) if weighting == RELATIVE else np.ones(found.value.size)

    def off(logs: np.ndarray) -> np.ndarray:
        p = np.exp(logs)
        z = (film(BAND, (p[0], tuple(p[1::2]), tuple(p[2::2]))) - found.value) * weight
        return np.concatenate([z.real, z.imag])

    tries = [least_squares(off, np.log(s), xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=4000) for s in STARTS[order]]
    return np.exp(min(tries, key=lambda t: float(t.cost)).x)


@pytest.mark.parametrize("weighting", [UNIFORM, RELATIVE])
@pytest.mark.parametrize("order", [1, 2])
def test_parameters_are_those_of_plain_least_squares(weighting: str, order: int) -> None:
    found = measured()
    fit = fit_weighted(found, weighting, specimen_id="S").of_order(order)
    expected = least(found, weighting, order)
    springs, dampers = expected[1::2], expected[2::2]
    longest_first = np.argsort(-dampers / springs)
    assert fit.model.k0 == pytest.approx(expected[0], rel=1e-4)
    for i, arm in enumerate(longest_first, 1):
        assert fit.estimates[f"k{i}"].value == pytest.approx(springs[arm], rel=2e-3)
        assert fit.estimates[f"c{i}"].value == pytest.approx(dampers[arm], rel=2e-3)


def test_a_low_order_serves_the_fast_lines_where_noise_would_not_let_it() -> None:
    """Weighted by its noise the first order follows the slow lines alone; uniform weights halve what it misses by in N/mm."""
    found = measured()
    by_noise, uniform = fit_corrected(found).of_order(1), fit_weighted(found, UNIFORM).of_order(1)
    fast = BAND > 20

    def missed(fit: object) -> float:
        return float(np.mean(np.abs(fit.model.stiffness(BAND[fast]) - found.value[fast])))  # type: ignore[attr-defined]

    assert missed(uniform) < 0.5 * missed(by_noise)


def test_rows_say_their_weighting_and_only_noise_chooses_an_order() -> None:
    found = measured()
    groups = [
        fit_corrected(found, specimen_id="S"),
        *(fit_weighted(found, w, specimen_id="S") for w in (UNIFORM, RELATIVE)),
    ]
    rows = model_fits_table(groups).to_pylist()
    assert [row["weighting"] for row in rows[::3]] == [NOISE, UNIFORM, RELATIVE]
    assert {row["weighting"] for row in rows if row["selected"]} == {NOISE}
    for row in rows:
        about_noise = ("reduced_chi2", "bic", "order_p_value", "held_out_error", "positivity_chi2")
        told = [row[name] is not None for name in about_noise]
        assert all(told[:2]) if row["weighting"] == NOISE else not any(told)
        assert row["magnitude_error_n_per_mm"] > 0
