"""Lifetime distributions against published fits, scipy's optimiser, and simulation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, stats

from pipeline.fit.survival import lifetime_distributions
from pipeline.fit.survival.lifetime_distributions import (
    DISTRIBUTIONS,
    EXPONENTIAL,
    LOG_NORMAL,
    WEIBULL,
    Lives,
    fit_distribution,
)
from pipeline.fit.survival.log_location_scale import NORMAL, SMALLEST_EXTREME_VALUE, maximise
from schemas.errors import NotIdentifiableError, RefusedError
from tests.helpers.drawn_lives import KINDS, draw_samples
from tests.helpers.survival_data import TREATED


def test_published_weibull() -> None:
    fit = fit_distribution(Lives.right_censored(*TREATED), WEIBULL)
    assert fit.parameters["scale_s"].value == pytest.approx(33.7652, abs=5e-5)
    assert fit.parameters["shape"].value == pytest.approx(1.35373, abs=5e-6)
    assert fit.log_likelihood == pytest.approx(-41.6587, abs=5e-5)
    for estimate in fit.parameters.values():
        assert estimate.lower < estimate.value < estimate.upper
    assert fit.goodness is not None
    assert fit.goodness.p_value > 0.2
    assert fit.goodness.statement.startswith("the Weibull law fits")


def test_published_interval_censored_weibull() -> None:
    lives = Lives(np.array([10.0, 15, 20, 5, 1]), np.array([20.0, 30, 40, 12, 8]))
    fit = fit_distribution(lives, WEIBULL)
    assert fit.parameters["shape"].value == pytest.approx(1.9198, abs=5e-5)
    assert fit.parameters["scale_s"].value == pytest.approx(16.944, abs=5e-4)
    assert fit.goodness is None


def test_exponential_is_time_over_failures() -> None:
    fit = fit_distribution(Lives.right_censored(*TREATED), EXPONENTIAL)
    assert fit.parameters["mean_s"].value == pytest.approx(TREATED[0].sum() / 9, rel=1e-9)
    with pytest.raises(NotIdentifiableError, match=r"nobody failed \(0 of 10 failed\)"):
        fit_distribution(Lives.right_censored(np.full(10, 240.0), np.zeros(10)), EXPONENTIAL)


def _log_likelihood(distribution: str, lower: np.ndarray, upper: np.ndarray, x: np.ndarray) -> float:
    """By scipy's distributions, in (log scale, log shape)."""
    frozen = {
        WEIBULL: lambda: stats.weibull_min(np.exp(x[1]), scale=np.exp(x[0])),
        LOG_NORMAL: lambda: stats.lognorm(np.exp(-x[1]), scale=np.exp(x[0])),
    }[distribution]()
    exact, right = lower == upper, np.isinf(upper)
    total = frozen.logpdf(lower[exact]).sum() + frozen.logsf(lower[right]).sum()
    between = ~(exact | right)
    return float(total + np.log(frozen.cdf(upper[between]) - frozen.cdf(lower[between])).sum())


@pytest.mark.long_after(7)
@pytest.mark.parametrize("distribution", [WEIBULL, LOG_NORMAL])
@pytest.mark.parametrize("seed", range(6))
def test_mixed_censoring_against_a_general_optimiser(distribution: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    life = 100 * rng.weibull(2.0, 25)
    lower, upper = life.copy(), life.copy()
    upper[:5], lower[:5] = np.inf, np.minimum(life[:5], 60)
    lower[5:8] = 0.0
    lower[8:14], upper[8:14] = np.floor(life[8:14] / 20) * 20, np.ceil(life[8:14] / 20) * 20
    fit = fit_distribution(Lives(lower, upper), distribution)
    best = optimize.minimize(
        lambda x: -_log_likelihood(distribution, lower, upper, x),
        [np.log(80), 0.5],
        method="Nelder-Mead",
        options={"xatol": 1e-9, "fatol": 1e-11, "maxiter": 4000},
    )
    assert fit.log_likelihood == pytest.approx(-best.fun, abs=1e-7)
    names = {WEIBULL: ("scale_s", "shape"), LOG_NORMAL: ("median_s", "log_sd")}[distribution]
    found = np.array([fit.parameters[name].value for name in names])
    np.testing.assert_allclose(found[0], np.exp(best.x[0]), rtol=1e-5)
    np.testing.assert_allclose(found[1], np.exp(best.x[1] * (1 if distribution == WEIBULL else -1)), rtol=1e-5)


def test_profile_limits_are_where_the_likelihood_drops() -> None:
    fit = fit_distribution(Lives.right_censored(*TREATED), WEIBULL, goodness=False)
    lower, upper = TREATED[0], np.where(TREATED[1], TREATED[0], np.inf)
    failures = 9
    drop = failures * np.log1p(stats.t.ppf(0.975, failures - 1) ** 2 / (failures - 1)) / 2
    for limit in (fit.parameters["shape"].lower, fit.parameters["shape"].upper):
        profile = optimize.minimize_scalar(
            lambda scale, limit=limit: -_log_likelihood(WEIBULL, lower, upper, np.array([scale, np.log(limit)])),
            bounds=(1, 7),
            method="bounded",
            options={"xatol": 1e-10},
        )
        assert fit.log_likelihood + profile.fun == pytest.approx(drop, abs=1e-6)


@pytest.mark.long_after(7)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("distribution", [WEIBULL, LOG_NORMAL])
def test_limits_by_newton_are_those_of_the_walk_along_the_profile(
    distribution: str, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten lives, of which the intervals of some are open on a side."""
    samples = [Lives(*limits) for limits in draw_samples(kind, samples=4, lives=10, family=distribution)]
    quick = [fit_distribution(lives, distribution, goodness=False).parameters for lives in samples]
    nowhere = (float("nan"), float("nan"))
    monkeypatch.setattr(lifetime_distributions, "limits_at_drop", lambda *_: (nowhere, nowhere))
    for lives, found in zip(samples, quick, strict=True):
        walked = fit_distribution(lives, distribution, goodness=False).parameters
        for name, estimate in walked.items():
            assert [found[name].lower, found[name].upper] == pytest.approx(
                [estimate.lower, estimate.upper], rel=1e-6, nan_ok=True
            )


def test_refusals_say_why() -> None:
    for time, failed, reason in (
        (np.full(10, 240.0), np.zeros(10), "nobody failed"),
        (np.array([5.0, 5.0, 9.0]), np.array([1, 1, 0]), "all failures at one time"),
    ):
        with pytest.raises(NotIdentifiableError, match=reason):
            fit_distribution(Lives.right_censored(time, failed), WEIBULL)
    with pytest.raises(RefusedError, match="row 1"):
        Lives(np.array([1.0, 5.0]), np.array([2.0, 3.0]))
    with pytest.raises(NotIdentifiableError):
        Lives.right_censored([0.0, 0.0], [1, 0])


def test_failures_at_zero_enter_as_failures_before_the_shortest_life() -> None:
    lives = Lives.right_censored([0.0, 10.0, 20.0, 35.0, 0.0], [1, 1, 1, 1, 0])
    np.testing.assert_array_equal(lives.upper, [10, 10, 20, 35])
    assert np.isfinite(fit_distribution(lives, WEIBULL).parameters["shape"].value)


@pytest.mark.study
def test_goodness_rejects_the_wrong_distribution_and_keeps_its_level() -> None:
    rng = np.random.default_rng(seed=12)
    wear = Lives.right_censored(200 * rng.weibull(8.0, 30), np.ones(30))
    exponential = fit_distribution(wear, EXPONENTIAL).goodness
    assert exponential is not None
    assert exponential.p_value < 0.01
    assert exponential.statement.startswith("the exponential law does not fit")
    p_values = []
    for _ in range(40):
        life = 100 * rng.weibull(1.7, 15)
        goodness = fit_distribution(Lives.right_censored(np.minimum(life, 150), life <= 150), WEIBULL).goodness
        assert goodness is not None
        p_values.append(goodness.p_value)
    assert stats.kstest(p_values, "uniform").pvalue > 0.01


def test_survival_of_the_fit() -> None:
    for distribution in DISTRIBUTIONS:
        fit = fit_distribution(Lives.right_censored(*TREATED), distribution, goodness=False)
        frozen = {
            WEIBULL: lambda p: stats.weibull_min(p["shape"].value, scale=p["scale_s"].value),
            EXPONENTIAL: lambda p: stats.expon(scale=p["mean_s"].value),
            LOG_NORMAL: lambda p: stats.lognorm(p["log_sd"].value, scale=p["median_s"].value),
        }[distribution](fit.parameters)
        np.testing.assert_allclose(fit.survival([1.0, 10.0, 50.0]), frozen.sf([1.0, 10.0, 50.0]), rtol=1e-9)


@pytest.mark.parametrize("distribution", DISTRIBUTIONS)
def test_equal_lives_taken_once_count_as_often_as_they_are(distribution: str) -> None:
    """Exact, right-censored, left-censored and inspected lives, each several times, against the same taken one by one."""
    lower = np.repeat([3.0, 7.0, 11.0, 16.0, 20.0, 0.0, 5.0], [4, 1, 3, 2, 9, 2, 3])
    upper = np.repeat([3.0, 7.0, 11.0, 16.0, np.inf, 2.0, 9.0], [4, 1, 3, 2, 9, 2, 3])
    order = np.random.default_rng(seed=3).permutation(lower.size)
    lives = Lives(lower[order], upper[order])
    once, singly = lives.distinct(), lives.logarithms()
    assert once.lower.shape == (1, 7)
    assert once.specimens == lower.size
    error = NORMAL if distribution == LOG_NORMAL else SMALLEST_EXTREME_VALUE
    sigma = 1.0 if distribution == EXPONENTIAL else None
    a, b = (maximise(y, np.ones((y.lower.shape[1], 1)), error, sigma=sigma) for y in (once, singly))
    assert a.converged.all()
    assert b.converged.all()
    for name in ("alpha", "gamma", "log_likelihood"):
        assert getattr(a, name) == pytest.approx(getattr(b, name), rel=1e-9)
