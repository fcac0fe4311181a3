"""The search: inner least squares against scipy, exhaustive starts, forward Jacobians, merging."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares, nnls

from pipeline.fit.relaxation.assemble import assemble
from pipeline.fit.relaxation.linear import Linearisation, first_expansion
from pipeline.fit.relaxation.reference import find_reference
from pipeline.fit.relaxation.search import Search
from pipeline.fit.relaxation.varpro import LinearProblem, _non_negative, bounds, merged
from pipeline.physics.film import Shape
from tests.helpers.fit_truth import (
    ACRYLATE,
    BAND,
    STACK,
    electrical,
    electrical_response,
    film,
    mechanical,
    relaxation_curve,
    response,
    rig,
)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(8, 30), st.floats(0, 1))
def test_batched_non_negative_solution_is_scipys(seed: int, columns: int, rows: int, positive: float) -> None:
    rng = np.random.default_rng(seed)
    matrix = rng.normal(size=(4, columns, rows)) + 3 * positive
    target = rng.normal(size=rows) + positive
    found = _non_negative(matrix, target)
    for a, x in zip(matrix, found, strict=True):
        expected, norm = nnls(a.T, target)
        assert np.all(x >= 0)
        assert np.linalg.norm(a.T @ x - target) == pytest.approx(norm, rel=1e-6, abs=1e-9)
        assert np.allclose(x, expected, atol=1e-5 * (1 + np.abs(expected).max()))


def test_batched_solution_leaves_empty_columns_out() -> None:
    matrix = np.zeros((1, 2, 3))
    matrix[0, 1] = [1.0, 2.0, 2.0]
    assert np.allclose(_non_negative(matrix, np.array([1.0, 2.0, 2.0])), [[0.0, 1.0]])


def test_merging_keeps_the_barycentre() -> None:
    found = merged(np.array([0.0, 0.1, 3.0, 5.0]), np.array([1.0, 3.0, 1.0, 1.0]), 3)
    assert np.allclose(found, [0.075, 3.0, 5.0])


def test_mixed_jacobian_is_the_derivative() -> None:
    """Chirp and electrical lines on a rig, a film's own response, a relaxation curve, gains: all rows, all parameters."""
    rng = np.random.default_rng(seed=2)
    k = film(BAND[::7], STACK)
    responses = [
        response(BAND[::7], mechanical(BAND[::7], k), rng, recording_id="a"),
        response(BAND[::9], film(BAND[::9], STACK), rng, recording_id="b"),
        electrical_response(BAND[::7], electrical(BAND[::7], k, 0.002), rng, recording_id="c"),
    ]
    gain = rig(force_gain=1.0, force_gain_sd=0.01)
    curve = relaxation_curve(STACK, rng, cell=20.0)
    observations, _, _ = assemble(responses, [gain, None, gain], [curve], [gain])
    observations = observations.with_gains(0.1)
    shape = Shape(2, True, True)
    theta = np.concatenate([np.log([0.4, 0.4, 1.0, 2.5, 0.1, 0.05]), 0.1 * rng.normal(size=observations.nuisance.size)])
    theta[6 + (observations.nuisance.amplitude or 0)] = np.log(0.002)
    residual, jacobian = observations.evaluate(theta, shape)
    assert residual.shape == (observations.rows + observations.nuisance.target.size,)
    for i in range(theta.size):
        step = 1e-6 * np.eye(theta.size)[i]
        up, down = observations.evaluate(theta + step, shape)[0], observations.evaluate(theta - step, shape)[0]
        difference = (up - down) / 2e-6
        assert np.allclose(jacobian[:, i], difference, atol=2e-6 * np.abs(difference).max() + 1e-7), (
            observations.nuisance.names
        )


def test_compressed_problem_has_the_cost_of_the_whole_one() -> None:
    rng = np.random.default_rng(seed=5)
    observations, _, _ = assemble([response(BAND, mechanical(BAND, film(BAND, ACRYLATE)), rng)], [rig()])
    whole = Linearisation(observations, first_expansion(observations))
    problem = LinearProblem(whole, *bounds(*observations.omega_range))
    tau = np.array([0.04, 0.009, 0.0007])
    (found,) = problem.search([(np.log(tau), False)])
    columns = np.hstack([whole.ends()[:, :1], whole.columns(np.exp(found.log_tau))])
    _, norm = nnls(columns, whole.target)
    assert found.cost == pytest.approx(norm**2, rel=1e-4)


def test_search_finds_the_optimum_that_many_random_starts_find() -> None:
    """Third order at 5 % noise: no start of an independent optimiser (scipy, moduli and times, 30 starts) does better."""
    rng = np.random.default_rng(seed=11)
    data = response(BAND, film(BAND, ACRYLATE), rng, relative=0.05)
    observations, _, _ = assemble([data], [None])
    search = Search(find_reference(observations))
    lower = None
    for n in (1, 2, 3):
        lower = search.order(n, lower)
    assert lower is not None
    sd = np.sqrt(data.variance / 2)

    def residual(x: np.ndarray) -> np.ndarray:
        k0, k, tau = np.exp(x[0]), np.exp(x[1:4]), np.exp(x[4:])
        d = (film(BAND, (k0, tuple(k), tuple(k * tau))) - data.value) / sd
        return np.concatenate([d.real, d.imag])

    best = np.inf
    for _ in range(30):
        start = np.concatenate([[0.0], rng.uniform(-1, 4, 3), rng.uniform(-8, -1, 3)])
        best = min(best, 2 * least_squares(residual, start, max_nfev=200).cost)
    assert lower.chi2 <= best + 1e-2


def test_orders_are_nested() -> None:
    rng = np.random.default_rng(seed=3)
    observations, _, _ = assemble([response(BAND, mechanical(BAND, film(BAND, ACRYLATE)), rng)], [rig(1.03)])
    search = Search(find_reference(observations))
    chi2 = [search.spring_only().chi2]
    lower = None
    for n in range(1, 6):
        lower = search.order(n, lower)
        chi2.append(lower.chi2)
    assert np.all(np.diff(chi2) <= 1e-6)
    assert find_reference(observations).chi2 <= chi2[-1] + 1.0
