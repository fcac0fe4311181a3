"""Kaplan–Meier against published numbers, scipy, lifelines and simulation."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from pipeline.fit.survival.kaplan_meier import exact_lower_survival, exact_upper_survival, kaplan_meier
from schemas.errors import NotIdentifiableError, RefusedError
from tests.helpers.survival_data import PLACEBO, TREATED, random_sample
from tests.studies.study_survival import DESIGNS, Design, coverage


def test_published_curve() -> None:
    curve = kaplan_meier(*TREATED)
    published = [0.8571, 0.8067, 0.7529, 0.6902, 0.6275, 0.5378, 0.4482]
    np.testing.assert_allclose(curve.survival_at([6, 7, 10, 13, 16, 22, 23]), published, atol=5e-5)
    errors = dict(zip(curve.time.tolist(), curve.standard_error.tolist(), strict=True))
    assert errors[6] == pytest.approx(0.0764, abs=5e-5)
    assert errors[23] == pytest.approx(0.1346, abs=5e-5)
    for time, lower, upper in ((6, 0.6197, 0.9516), (10, 0.5032, 0.8894)):
        estimate = curve.at(time)
        assert estimate.lower == pytest.approx(lower, abs=5e-5)
        assert estimate.upper == pytest.approx(upper, abs=5e-5)
    median = curve.median()
    assert (median.value, median.lower) == (23, 13)
    assert np.isnan(median.upper)
    assert kaplan_meier(*PLACEBO).median().value == 8


def test_published_restricted_means() -> None:
    treated, placebo = kaplan_meier(*TREATED), kaplan_meier(*PLACEBO)
    assert treated.restricted_mean(23).value == pytest.approx(17.9092, abs=5e-5)
    assert placebo.restricted_mean(23).value == pytest.approx(8.6667, abs=5e-5)
    assert treated.restricted_mean(35).value == pytest.approx(23.2874, abs=5e-5)


def test_survivors_only_give_exact_limits_and_nothing_else() -> None:
    curve = kaplan_meier(np.full(10, 240.0), np.zeros(10))
    end = curve.at(240)
    assert end.value == 1
    assert end.lower == pytest.approx(0.692, abs=5e-4)
    assert end.lower == pytest.approx(stats.binomtest(10, 10).proportion_ci(method="exact").low, rel=1e-12)
    assert end.upper == 1
    assert np.isnan(curve.lower).all()
    assert np.isnan(curve.upper).all()
    assert np.isnan(curve.median().value)
    mean = curve.restricted_mean(240)
    assert (mean.value, mean.upper) == (240, 240)
    assert mean.lower == pytest.approx(240 * 0.6915, rel=1e-4)


def test_all_failed_ends_with_an_exact_upper_limit() -> None:
    curve = kaplan_meier([3.0, 5.0, 9.0], [1, 1, 1])
    assert curve.at(20).value == 0
    assert curve.at(20).upper == pytest.approx(stats.binomtest(0, 3).proportion_ci(method="exact").high, rel=1e-12)
    assert np.isnan(curve.lower[-1])
    assert np.isnan(curve.upper[-1])
    assert exact_upper_survival(3) == 1 - exact_lower_survival(3)


def test_agrees_with_scipy_on_a_thousand_samples() -> None:
    rng = np.random.default_rng(seed=20)
    worst = 0.0
    for _ in range(1000):
        time, failed = random_sample(rng)
        if not failed.any():
            continue
        curve = kaplan_meier(time, failed)
        data = stats.CensoredData(uncensored=time[failed], right=time[~failed])
        theirs = stats.ecdf(data).sf
        worst = max(worst, float(np.abs(curve.survival_at(theirs.quantiles) - theirs.probabilities).max()))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # where S is 0 or 1 scipy's band is undefined as well
            band = theirs.confidence_interval(method="log-log")
        inside = (theirs.probabilities > 0) & (theirs.probabilities < 1)
        rows = np.searchsorted(curve.time, theirs.quantiles[inside])
        if inside.any():
            worst = max(worst, float(np.abs(curve.lower[rows] - band.low.probabilities[inside]).max()))
            worst = max(worst, float(np.abs(curve.upper[rows] - band.high.probabilities[inside]).max()))
    assert worst < 1e-10


def test_agrees_with_lifelines_on_a_thousand_samples() -> None:
    lifelines = pytest.importorskip("lifelines", reason="lifelines is in the environment of peers only")
    rng = np.random.default_rng(seed=21)
    worst = 0.0
    for _ in range(1000):
        time, failed = random_sample(rng)
        curve = kaplan_meier(time, failed)
        theirs = lifelines.KaplanMeierFitter().fit(time, failed)
        own = curve.survival_at(theirs.survival_function_.index.to_numpy()[1:])
        worst = max(worst, float(np.abs(own - theirs.survival_function_.to_numpy()[1:, 0]).max()))
        band = theirs.confidence_interval_.loc[curve.time].to_numpy()
        inside = (curve.survival > 0) & (curve.survival < 1)
        if inside.any():
            worst = max(worst, float(np.abs(band[inside, 0] - curve.lower[inside]).max()))
            worst = max(worst, float(np.abs(band[inside, 1] - curve.upper[inside]).max()))
        last = float(time.max())
        mean = lifelines.utils.restricted_mean_survival_time(theirs, t=last)
        worst = max(worst, abs(mean - curve.restricted_mean(last).value) / last)
    assert worst < 1e-10


@given(
    st.lists(st.tuples(st.integers(0, 30), st.booleans()), min_size=1, max_size=60),
    st.floats(0.001, 1000),
)
def test_properties(rows: list[tuple[int, bool]], factor: float) -> None:
    time = np.array([float(t) for t, _ in rows])
    failed = np.array([d for _, d in rows])
    curve = kaplan_meier(time, failed)
    assert curve.at_risk[0] == len(rows)
    assert curve.failures.sum() == failed.sum()
    assert (curve.failures + curve.censored).sum() == len(rows)
    assert np.all(np.diff(curve.survival) <= 1e-15)
    assert np.all(np.diff(curve.time) > 0)
    inside = ~np.isnan(curve.lower)
    assert np.array_equal(inside, (curve.survival > 0) & (curve.survival < 1))
    assert np.all((curve.lower[inside] <= curve.survival[inside]) & (curve.survival[inside] <= curve.upper[inside]))
    scaled = kaplan_meier(time * factor, failed)
    np.testing.assert_array_equal(scaled.survival, curve.survival)
    for moment in (0.0, 7.5, 30.0):
        assert curve.number_at_risk(moment) == np.count_nonzero(time >= moment)
    order = np.random.default_rng(seed=0).permutation(time.size)
    np.testing.assert_array_equal(kaplan_meier(time[order], failed[order]).survival, curve.survival)


def test_at_risk_and_survival_beyond_the_observation() -> None:
    curve = kaplan_meier([5.0, 10.0, 10.0, 20.0], [1, 1, 0, 0])
    np.testing.assert_array_equal(curve.number_at_risk([0, 5, 5.1, 10, 20, 21]), [4, 4, 3, 3, 1, 0])
    np.testing.assert_allclose(curve.survival_at([0, 4.9, 5, 10, 20]), [1, 1, 0.75, 0.5, 0.5])
    assert np.isnan(curve.survival_at(21))
    with pytest.raises(NotIdentifiableError, match="observation ends at 20 s with survivors"):
        curve.restricted_mean(25)


def test_minus_zero_sorts_as_zero() -> None:
    curve = kaplan_meier([1.0, -0.0, 0.0], [True, True, False])
    np.testing.assert_array_equal(curve.time, [0.0, 1.0])
    np.testing.assert_array_equal(curve.failures, [1, 1])


@pytest.mark.parametrize(
    ("time", "failed", "message"),
    [
        ([1.0, -2.0], [1, 1], r"row 1: lifetime -2 s"),
        ([np.nan], [1], "lifetime nan s"),
        ([np.inf], [0], "lifetime inf s"),
        ([1.0], [2], "failure flag"),
        ([1.0, 2.0], [1], "shape"),
        ([], [], "no lifetimes"),
    ],
)
def test_bad_input_is_named(time: list[float], failed: list[int], message: str) -> None:
    with pytest.raises(RefusedError, match=message):
        kaplan_meier(time, failed)


@pytest.mark.slow
@pytest.mark.study
@pytest.mark.parametrize("design", [DESIGNS[1], DESIGNS[3]], ids=str)
def test_intervals_hold_their_level(design: Design) -> None:
    """95 % intervals contain the truth of simulated groups about as often as they say (study_survival runs them all)."""
    shares = coverage(design, groups=120, seed=5)
    assert all(0.90 <= share <= 1.0 for share in shares.values()), shares
    assert min(shares.values()) < 1.0, "intervals that never fail are too wide"
