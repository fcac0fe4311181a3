"""The solver against scipy's on problems drawn at random: optima, bounds, descent, problems side by side, priors, ties."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from pipeline.physics.least_squares import (
    Evaluate,
    Options,
    Solution,
    find_marginal_root,
    minimise,
    minimise_each,
    tie,
    with_prior,
)
from schemas.arrays import Float, Int

SEEDS = st.integers(0, 2**32 - 1)
THOROUGH = Options(fall=1e-9, most=200)
FAR = np.full(3, 50.0)


@dataclass(frozen=True)
class Bent:
    """Residuals design @ x + bend · tanh(x) − target: monotonous in each entry, so that there is one optimum."""

    design: Float
    bend: float
    target: Float
    low: Float
    high: Float

    @staticmethod
    def drawn(seed: int) -> Bent:
        """Well posed, with bounds that hold some of the entries."""
        rng = np.random.default_rng(seed)
        q, _ = np.linalg.qr(rng.normal(size=(12, 3)))
        design = q * rng.uniform(0.5, 20.0, 3)
        low, high = -rng.uniform(0.2, 3.0, 3), rng.uniform(0.2, 3.0, 3)
        return Bent(design, rng.uniform(0.0, 0.8), design @ rng.normal(size=3) * 2 + rng.normal(size=12), low, high)

    def residuals(self, several: Float) -> Float:
        return np.asarray((several + self.bend * np.tanh(several)) @ self.design.T - self.target)

    def jacobians(self, several: Float) -> Float:
        return np.asarray(self.design * (1 + self.bend / np.cosh(several[:, None, :]) ** 2))

    def evaluate(self, points: Float, _: Int) -> tuple[Float, Float]:
        return self.residuals(points), self.jacobians(points)

    def by_differences(self, points: Float, _: Int) -> tuple[Float, None]:
        return self.residuals(points), None

    def best(self, start: Float) -> float:
        found = least_squares(
            lambda x: self.residuals(x[None])[0],
            start,
            bounds=(self.low, self.high),
            xtol=1e-12,
            ftol=1e-12,
            gtol=1e-12,
        )
        return 2 * float(found.cost)


def starts(problem: Bent, seed: int, count: int) -> list[Float]:
    return list(np.random.default_rng(seed).uniform(problem.low, problem.high, (count, 3)))


@settings(max_examples=80, deadline=None)
@given(SEEDS)
def test_bounded_optima_are_scipys_with_jacobians_of_any_kind(seed: int) -> None:
    problem = Bent.drawn(seed)
    (start,) = starts(problem, seed, 1)
    best = problem.best(start)
    analytic, differences = (
        minimise_each(e, [start], problem.low, problem.high, THOROUGH)[0]
        for e in (problem.evaluate, problem.by_differences)
    )
    secants = minimise(problem.residuals, start, problem.low, problem.high, most=200, jacobian=problem.design, moving=1)
    assert all(found.converged for found in (analytic, differences, secants))
    assert analytic.chi2 == pytest.approx(best, rel=1e-6, abs=1e-6)
    assert differences.chi2 == pytest.approx(best, rel=1e-6, abs=1e-5)
    assert best - 1e-6 < secants.chi2 < best + 0.05


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.booleans())
def test_no_residual_is_asked_for_outside_the_bounds_but_for_differences(seed: int, analytic: bool) -> None:
    problem = Bent.drawn(seed)
    room = 0.0 if analytic else 1e-4

    def evaluate(points: Float, numbers: Int) -> tuple[Float, Float | None]:
        assert np.all(points >= problem.low - room)
        assert np.all(points <= problem.high)
        return problem.evaluate(points, numbers) if analytic else problem.by_differences(points, numbers)

    outside = [s * 5 for s in starts(problem, seed, 3)]
    for found in minimise_each(evaluate, outside, problem.low, problem.high, THOROUGH):
        assert np.all((found.x >= problem.low) & (found.x <= problem.high))


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.booleans())
def test_the_sum_of_squares_never_rises_with_more_steps(seed: int, lent: bool) -> None:
    problem = Bent.drawn(seed)
    (start,) = starts(problem, seed, 1)
    rough = np.random.default_rng(seed).normal(1.0, 0.5, problem.design.shape) * problem.design if lent else None
    reached = [
        minimise(problem.residuals, start, problem.low, problem.high, most=most, jacobian=rough).chi2
        for most in range(20)
    ]
    assert np.all(np.diff(reached) <= 0)


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.booleans())
def test_several_problems_side_by_side_end_where_each_ends_alone(seed: int, analytic: bool) -> None:
    problems = [Bent.drawn(seed + i) for i in range(4)]
    begins = [starts(p, seed, 1)[0] for p in problems]

    def side_by_side(chosen: list[Bent]) -> Evaluate:
        def evaluate(points: Float, numbers: Int) -> tuple[Float, Float | None]:
            own = [(chosen[n], x[None]) for n, x in zip(numbers, points, strict=True)]
            residual = np.concatenate([p.residuals(x) for p, x in own])
            return residual, np.concatenate([p.jacobians(x) for p, x in own]) if analytic else None

        return evaluate

    bounds = np.array([p.low for p in problems]), np.array([p.high for p in problems])
    together = minimise_each(side_by_side(problems), begins, *bounds, THOROUGH)
    for problem, start, found in zip(problems, begins, together, strict=True):
        (alone,) = minimise_each(side_by_side([problem]), [start], problem.low, problem.high, THOROUGH)
        assert_same(found, alone)


def assert_same(one: Solution, other: Solution) -> None:
    assert np.array_equal(one.x, other.x)
    assert np.array_equal(one.jacobian, other.jacobian)
    assert (one.chi2, one.converged) == (other.chi2, other.converged)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_a_race_goes_on_with_those_ahead_alone(seed: int) -> None:
    problem = Bent.drawn(seed)
    begins = starts(problem, seed, 5)
    asked: list[set[int]] = []

    def evaluate(points: Float, numbers: Int) -> tuple[Float, Float]:
        asked.append(set(numbers.tolist()))
        return problem.evaluate(points, numbers)

    options = Options(fall=1e-12, most=30, race=((2, 2),))
    found = minimise_each(evaluate, begins, problem.low, problem.high, options)
    after_a_step = np.array(
        [
            minimise_each(problem.evaluate, [start], problem.low, problem.high, Options(fall=1e-12, most=1))[0].chi2
            for start in begins
        ]
    )
    went_on = set().union(*asked[2:])
    assert asked[0] == set(range(5))
    assert len(went_on) <= 2
    assert all(after_a_step[number] <= np.sort(after_a_step)[1] * (1 + 1e-9) for number in went_on)
    for number in set(range(5)) - went_on:
        assert found[number].chi2 == pytest.approx(after_a_step[number], rel=1e-9)


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_priors_are_rows_and_ties_are_a_change_of_variables(seed: int) -> None:
    problem = Bent.drawn(seed)
    rng = np.random.default_rng(seed)
    mean, root = rng.normal(size=3), rng.normal(size=(2, 3))
    origin, directions = rng.normal(size=3), rng.normal(size=(3, 2))

    def residual(u: Float) -> Float:
        x = origin + directions @ u
        return np.concatenate([problem.residuals(x[None])[0], root @ (x - mean)])

    best = 2 * float(least_squares(residual, np.zeros(2), xtol=1e-12, ftol=1e-12, gtol=1e-12).cost)
    for evaluate in (problem.evaluate, problem.by_differences):
        known = tie(with_prior(evaluate, mean, root), origin, directions)
        (found,) = minimise_each(known, [np.zeros(2)], -FAR[:2], FAR[:2], THOROUGH)
        assert found.residual == pytest.approx(residual(found.x))
        assert found.chi2 == pytest.approx(best, rel=1e-6, abs=1e-5)


def test_entries_with_equal_bounds_stay_and_cost_no_differences() -> None:
    problem = Bent.drawn(3)
    low, high = problem.low.copy(), problem.high.copy()
    low[1] = high[1] = 0.1
    seen: list[Float] = []

    def residuals(several: Float) -> Float:
        seen.extend(several)
        return problem.residuals(several)

    found = minimise(residuals, np.full(3, 0.1), low, high)
    assert found.x[1] == 0.1
    assert found.jacobian.shape == (12, 3)
    assert all(x[1] == 0.1 for x in seen)


def test_a_start_without_a_finite_residual_ends_at_an_infinite_sum() -> None:
    def residuals(several: Float) -> Float:
        return np.where(several > 0.5, several, np.nan)

    far = np.full(1, 2.0)
    found = minimise(residuals, np.zeros(1), -far, far)
    assert found.chi2 == np.inf
    assert not found.converged


@settings(deadline=None, max_examples=50)
@given(SEEDS)
def test_a_linear_problem_keeps_the_columns_that_it_is_lent(seed: int) -> None:
    """A step that is damped or shortened falls by what the quadratic model promises: no column is taken anew for it."""
    rng = np.random.default_rng(seed)
    design, target = rng.normal(size=(9, 3)), rng.normal(size=9)
    far, asked = rng.uniform(-30, 30, 3), []

    def residuals(several: Float) -> Float:
        asked.append(len(several))
        return several @ design.T - target

    found = minimise(residuals, far, -FAR, FAR, most=100, jacobian=design, moving=3, thorough=False)
    assert found.chi2 <= np.linalg.lstsq(design, target, rcond=None)[1][0] + 0.02
    assert set(asked) == {1}


def test_a_search_that_goes_on_does_not_take_the_same_columns_twice() -> None:
    """Where a round ended right after its columns were taken, a step that fails in the next one asks for no others."""
    asked: list[int] = []

    def residuals(several: Float) -> Float:
        asked.append(len(several))
        return np.stack([10 * (several[:, 1] - several[:, 0] ** 2), 1 - several[:, 0]], axis=1)

    begun = minimise(residuals, np.array([-1.2, 1.0]), -FAR[:2], FAR[:2], most=2)
    assert begun.fresh
    asked.clear()
    refused = minimise(residuals, begun, -FAR[:2], FAR[:2], most=1, thorough=False)
    assert refused.chi2 == begun.chi2
    assert asked == [1]


def test_an_entry_that_hardly_matters_does_not_hold_up_the_others() -> None:
    """Nothing is known of the last entry, so its step is as long as it may be at every step; the others go on as without it."""
    asked: dict[float, int] = {}

    def count(influence: float) -> Callable[[Float], Float]:
        def residuals(several: Float) -> Float:
            asked[influence] = asked.get(influence, 0) + 1
            x, y, z = several.T
            return 1e3 * np.stack([10 * (y - x**2), 1 - x, 0.1 + influence * np.exp(z)], axis=1)

        return residuals

    for influence in (0.0, 1e-3):
        found = minimise(count(influence), np.array([-1.2, 1.0, 0.0]), -FAR[:3], FAR[:3], most=100)
        assert found.x[:2] == pytest.approx([1.0, 1.0], abs=1e-3)
    assert asked[1e-3] <= asked[0.0] + 2


@settings(deadline=None, max_examples=100)
@given(SEEDS, st.floats(1e-9, 1e3))
def test_a_step_stays_within_its_limits_and_leads_downhill(seed: int, damping: float) -> None:
    rng = np.random.default_rng(seed)
    size = int(rng.integers(2, 8))
    design = rng.normal(size=(size + 3, size)) * 10.0 ** rng.uniform(-4, 4, size)
    low, high = -rng.uniform(0, 3, size), rng.uniform(0, 3, size)
    target, asked = 10.0 ** rng.uniform(-2, 4) * rng.normal(size=size + 3), []

    def residuals(several: Float) -> Float:
        asked.append(several.copy())
        return several @ design.T - target

    start = np.zeros(size)
    found = minimise(residuals, start, low, high, most=1, jacobian=design, damping=damping)
    trial = next(x[0] for x in asked[1:] if len(x) == 1)
    assert np.all((low <= trial) & (trial <= high) & (np.abs(trial) <= 1.5))
    assert found.chi2 <= float(target @ target) * (1 + 1e-9)
    assert np.sum((design @ trial - target) ** 2) <= float(target @ target) * (1 + 1e-9)


@given(seed=SEEDS, decades=st.floats(0, 14))
@settings(max_examples=60)
def test_information_is_positive_however_little_is_known_of_some_entries(seed: int, decades: float) -> None:
    """The inverse of the covariance had negative entries on its diagonal: probabilities that rest on it were no numbers."""
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(12, 6)) * np.geomspace(1, 10**-decades, 6)
    jacobian[:, 5] = jacobian[:, 4] * (1 + 10**-decades) + 10 ** -(decades + 4) * rng.normal(size=12)
    solution = Solution(np.zeros(6), np.zeros(12), jacobian, 0.0, converged=True)
    known = solution.information
    assert (np.diag(known) > 0).all()
    assert np.linalg.eigvalsh(known / np.sqrt(np.outer(np.diag(known), np.diag(known)))).min() > 0
    kept = np.array([True, True, False, True, False, True])
    root = find_marginal_root(known, kept)
    assert np.isfinite(root).all()
    if decades < 2:
        inverse = np.linalg.inv(solution.covariance[np.ix_(kept, kept)])
        np.testing.assert_allclose(root.T @ root, inverse, rtol=1e-5, atol=1e-5 * np.abs(inverse).max())
