"""Batches as a random effect against lme4 and a likelihood integrated by other means; what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import integrate

from pipeline.fit.survival.batch_scatter import BatchScatter, fit_batch_scatter
from pipeline.fit.survival.covariates import Covariate
from pipeline.fit.survival.lifetime_distributions import Lives
from pipeline.fit.survival.profile_likelihood import LARGE_SAMPLE_DROP
from schemas.errors import DealabError
from schemas.life_covariates import CATEGORY, INVERSE_POWER
from tests.helpers.published_lives import DYESTUFF

pytestmark = pytest.mark.quick

KILO = 1000.0


def test_dyestuff_as_logarithms_of_lives() -> None:
    """lme4 by maximum likelihood (D. Bates, lme4: Mixed-effects modeling with R, chapter 1): 37.26 between and 49.51 within
    batches, deviance 327.3271, 95 % profile limits 12.198 and 84.063; the mean 1527.5 with the standard error 17.69."""
    logs = DYESTUFF.ravel() / KILO
    lives, batches = Lives(np.exp(logs), np.exp(logs)), np.repeat(list("ABCDEF"), 5).tolist()
    fit = fit_batch_scatter(lives, [], batches, "log-normal", drop=LARGE_SAMPLE_DROP)
    assert (f"{KILO * fit.tau.value:.2f}", f"{KILO * fit.sigma:.2f}") == ("37.26", "49.51")
    assert (f"{KILO * fit.tau.lower:.2f}", f"{KILO * fit.tau.upper:.2f}") == ("12.20", "84.06")
    mean = fit.coefficients[0]
    assert (f"{KILO * mean.value.value:.1f}", f"{KILO * mean.standard_error:.2f}") == ("1527.5", "17.69")
    deviance = -2 * (fit.log_likelihood + logs.sum()) + 2 * logs.size * np.log(KILO)
    assert f"{deviance:.4f}" == "327.3271"
    share = fit.tau.value**2 / (fit.tau.value**2 + fit.sigma**2 / 5)
    expected = share * (DYESTUFF.mean(axis=1) / KILO - mean.value.value)
    assert np.log([b.factor.value for b in fit.batches]) == pytest.approx(expected, abs=1e-6)


def draw(seed: int, tau: float, batches: int = 7) -> tuple[Lives, list[Covariate], list[str]]:
    """Lives of every censoring and late entry; the electrode is the same within a batch, the voltage is not."""
    rng = np.random.default_rng(seed)
    place = np.repeat(np.arange(batches), 6)
    voltage = np.tile([4.0, 5.0, 6.0], 2 * batches)
    electrode = np.where(place % 2 > 0, "b", "a")
    effect = tau * rng.normal(size=batches)
    ln_t = (
        12
        - 6 * np.log(voltage)
        + 0.5 * (electrode == "b")
        + effect[place]
        + 0.5 * np.log(rng.exponential(size=place.size))
    )
    life, how = np.exp(ln_t), rng.integers(0, 5, place.size)
    lower = np.select([how == 1, how == 2, how == 3], [0.7 * life, 0.8 * life, 0 * life], life)
    upper = np.select([how == 1, how == 2, how == 3], [np.inf, 1.2 * life, 1.5 * life], life)
    entered = np.where(how == 4, 0.4 * life, 0.0)
    covariates = [
        Covariate("voltage", INVERSE_POWER, voltage, "kV"),
        Covariate("electrode", CATEGORY, electrode.tolist()),
    ]
    return Lives(lower, upper, entered), covariates, [f"B{i}" for i in place]


def log_likelihood(lives: Lives, covariates: list[Covariate], batches: list[str], fit: BatchScatter) -> float:
    """Weibull lives with each batch integrated by adaptive quadrature over ±8 standard deviations."""
    c = [one.value.value for one in fit.coefficients]
    x = np.column_stack([np.ones(lives.lower.size), *(one.columns()[1] for one in covariates)])
    location, total = x @ c, 0.0
    names = np.array(batches)
    for name in np.unique(names):
        here = names == name
        assert lives.entered is not None
        ends = (lives.lower[here], lives.upper[here], lives.entered[here])
        reach = 8 * fit.tau.value
        with np.errstate(divide="ignore", over="ignore"):
            found = integrate.quad(
                density, -reach, reach, (ends, location[here], fit), limit=200, epsabs=0, epsrel=1e-10
            )
        total += float(np.log(found[0])) - 50
    return total


def density(b: float, ends: tuple[np.ndarray, ...], location: np.ndarray, fit: BatchScatter) -> float:
    """Of the lives of a batch with the effect `b`, and of that effect, times e^50."""
    rate = [(end / np.exp(location + b)) ** (1 / fit.sigma) for end in ends]
    exact = ends[0] == ends[1]
    alone = np.log(rate[0] / fit.sigma / np.where(ends[0] > 0, ends[0], 1)) - rate[0]
    between = np.log(np.where(exact, 1.0, np.exp(-rate[0]) - np.exp(-rate[1])))
    value = np.where(exact, alone, between).sum() + rate[2].sum()
    return float(np.exp(value - b**2 / (2 * fit.tau.value**2) + 50) / np.sqrt(2 * np.pi) / fit.tau.value)


def test_likelihood_is_that_of_another_quadrature_and_has_its_maximum_there() -> None:
    lives, covariates, batches = draw(3, 0.6)
    fit = fit_batch_scatter(lives, covariates, batches, "weibull")
    assert fit.log_likelihood == pytest.approx(log_likelihood(lives, covariates, batches, fit), abs=1e-6)
    for change in (0.9, 1.1):
        moved = replace(fit, tau=replace(fit.tau, value=change * fit.tau.value))
        assert log_likelihood(lives, covariates, batches, moved) < fit.log_likelihood
        moved = replace(fit, sigma=change * fit.sigma)
        assert log_likelihood(lives, covariates, batches, moved) < fit.log_likelihood


@pytest.mark.parametrize("family", ["exponential", "weibull", "log-normal", "log-logistic"])
def test_scatter_is_found_where_it_is(family: str) -> None:
    fit = fit_batch_scatter(*draw(4, 1.0, 12), family)
    assert fit.tau.lower < 1.0 < fit.tau.upper
    assert fit.p_value < 0.01
    voltage, electrode = fit.coefficients[1:]
    assert voltage.value.lower < -6.0 < voltage.value.upper
    # The electrode is told by twelve batches, the voltage within each of them.
    assert electrode.value.lower < 0.5 < electrode.value.upper
    assert electrode.standard_error > 0.3


def test_batches_that_are_alike_have_no_scatter() -> None:
    found = [fit_batch_scatter(*draw(seed, 0.0), "weibull") for seed in range(5)]
    assert sum(one.tau.value == 0.0 and one.p_value == 1.0 for one in found) >= 1
    assert all(one.tau.lower == 0.0 for one in found)
    assert all(one.tau.upper < 1.0 for one in found)


@pytest.mark.parametrize(
    ("batches", "problem"),
    [
        (["a"] * 6, "1 batch tells nothing of a scatter between batches"),
        (list("aaabbb"), "2 batches tell nothing"),
        (list("abcdef"), "no batch has two specimens"),
        (list("aabb"), "4 batches for 6 lives"),
    ],
)
def test_refusals_have_names(batches: list[str], problem: str) -> None:
    life = np.arange(1.0, 7.0)
    with pytest.raises(DealabError, match=problem):
        fit_batch_scatter(Lives(life, life), [], batches, "weibull")


def test_batches_that_differ_in_all_covariates_are_refused() -> None:
    life = np.arange(1.0, 7.0)
    kind = Covariate("kind", CATEGORY, list("aabbcc"))
    with pytest.raises(DealabError, match="3 batches for 3 coefficients of what is the same within each batch"):
        fit_batch_scatter(Lives(life, life), [kind], list("xxyyzz"), "weibull")
