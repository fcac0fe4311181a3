"""The search behind diagnoses: optima, bounds, borrowed Jacobians."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.physics.least_squares import LEAST_DAMPING, central, minimise

Float = NDArray[np.float64]
FAR = np.full(2, 50.0)


def valley(several: Float) -> Float:
    x, y = several.T
    return np.array([10 * (y - x**2), 1 - x]).T


def test_the_bottom_of_a_bent_valley_is_found() -> None:
    """In standard deviations of data that tell where it is: what falls by less than 0.02 is not searched on."""
    found = minimise(lambda several: 100 * valley(several), np.array([-1.2, 1.0]), -FAR, FAR, most=200)
    assert found.converged
    assert found.x == pytest.approx([1.0, 1.0], abs=1e-3)
    assert found.chi2 < 1e-3


def test_a_bound_holds_and_the_rest_is_optimal_on_it() -> None:
    found = minimise(valley, np.array([-1.2, 1.0]), -FAR, np.array([0.5, 50.0]), most=200)
    assert found.x[0] == pytest.approx(0.5, abs=1e-6)
    assert found.x[1] == pytest.approx(0.25, abs=1e-2)


def test_entries_with_equal_bounds_stay() -> None:
    low, high = np.array([-50.0, 2.0]), np.array([50.0, 2.0])
    found = minimise(valley, np.array([1.0, 2.0]), low, high, most=200)
    assert found.x[1] == 2.0
    assert found.x[0] == pytest.approx(np.sqrt(2.0), abs=2e-2)


@settings(max_examples=50)
@given(st.integers(0, 10_000))
def test_linear_problems_end_at_least_squares_whatever_jacobian_is_lent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    design, target = rng.normal(size=(20, 4)), 5 * rng.normal(size=20)
    best, *_ = np.linalg.lstsq(design, target, rcond=None)

    def residuals(several: Float) -> Float:
        return np.asarray(target - several @ design.T)

    lent = -design * (1 + 0.3 * rng.normal(size=design.shape))
    wide = np.full(4, 100.0)
    found = minimise(residuals, np.zeros(4), -wide, wide, most=100, jacobian=lent, moving=2)
    assert found.chi2 <= float(np.sum((target - design @ best) ** 2)) + 0.05


@settings(max_examples=50)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_a_search_that_goes_on_asks_nothing_twice(seed: int, steps: int) -> None:
    start = np.random.default_rng(seed).normal(size=2)
    asked: list[Float] = []

    def counted(several: Float) -> Float:
        asked.extend(several)
        return valley(several)

    first = minimise(counted, start, -FAR, FAR, most=steps, jacobian=-np.eye(2), moving=1, thorough=False)
    asked.clear()
    second = minimise(counted, first, -FAR, FAR, most=1, moving=1, thorough=False)
    assert not any(np.array_equal(x, first.x) for x in asked)
    assert second.chi2 <= first.chi2


@settings(max_examples=50)
@given(st.integers(0, 10_000), st.integers(1, 30))
def test_the_jacobian_at_the_end_is_that_of_the_entries_that_were_to_be_renewed(seed: int, most: int) -> None:
    rng = np.random.default_rng(seed)
    design, bend = rng.normal(size=(2, 9, 3))

    def residuals(several: Float) -> Float:
        return np.asarray(several @ design.T + 0.1 * (several @ bend.T) ** 2)

    wide = np.full(3, 100.0)
    lent = design * (1 + 0.1 * rng.normal(size=design.shape))
    found = minimise(residuals, rng.normal(size=3), -wide, wide, most=most, jacobian=lent, moving=1, thorough=False)
    exact = central(residuals, found.x, -wide, wide)
    assert found.jacobian[:, 1:] == pytest.approx(exact[:, 1:], abs=2e-3)


def test_a_simulation_that_is_not_finite_never_wins() -> None:
    found = minimise(lambda x: np.array([[np.nan, x[0, 0]]]), np.array([1.0]), np.array([-1.0]), np.array([2.0]))
    assert not found.converged
    assert found.chi2 == np.inf


def test_central_differences_are_of_third_order() -> None:
    x = np.array([0.3, -0.2])
    found = central(lambda several: np.exp(3 * several), x, -FAR, FAR)
    assert found == pytest.approx(np.diag(3 * np.exp(3 * x)), rel=1e-6)


def test_entries_that_change_places_are_parted_by_their_prior_in_a_few_steps() -> None:
    """A sum known to 10⁻⁵ and a prior on one part: damping in proportion to the data would hold both where they are."""

    def residuals(several: Float) -> Float:
        x, y = several.T
        return np.array([1e5 * (x + y - 0.5), 30 * x]).T

    found = minimise(residuals, np.array([0.5, 0.0]), -FAR, FAR, most=10, damping=LEAST_DAMPING)
    assert found.converged
    assert found.x == pytest.approx([0.0, 0.5], abs=5e-3)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx([1 / 30, 1 / 30], rel=0.01)
