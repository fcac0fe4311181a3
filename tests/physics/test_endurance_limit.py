"""An endurance limit: found where it is, not found where a power law holds, its interval and its refusals."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.fit.survival.covariates import Covariate
from pipeline.fit.survival.endurance_limit import EnduranceLimit, find_endurance_limit
from pipeline.fit.survival.lifetime_distributions import Lives
from schemas.errors import DealabError
from schemas.life_covariates import INVERSE_POWER
from tests.helpers.published_lives import INSULATING_FLUID

pytestmark = pytest.mark.quick

LIMIT_KV, VOLTAGES_KV, END_S = 3.0, (2.0, 3.2, 3.6, 4.0, 5.0, 6.0), 1e5


def find(voltage: np.ndarray, lives: Lives, family: str = "weibull") -> EnduranceLimit:
    return find_endurance_limit(lives, [Covariate("voltage", INVERSE_POWER, voltage, "kV")], family)


def draw(limit: float, rng: np.random.Generator, each: int = 10) -> tuple[np.ndarray, Lives]:
    """Lives over (V − limit)^−3 with the scatter 0.4, cut off by the end of the test; nobody fails below the limit."""
    voltage = np.repeat(VOLTAGES_KV, each)
    above = np.maximum(voltage - limit, 1e-12)
    life = np.exp(9 - 3 * np.log(above) + 0.4 * np.log(rng.exponential(size=voltage.size)))
    return voltage, Lives(np.minimum(life, END_S), np.where(life <= END_S, life, np.inf))


@pytest.mark.long
@pytest.mark.slow
def test_interval_holds_the_limit_and_the_test_its_level() -> None:
    rng = np.random.default_rng(3)
    found = [find(*draw(LIMIT_KV, rng)) for _ in range(40)]
    held = np.mean([one.limit.lower <= LIMIT_KV <= one.limit.upper for one in found])
    assert held >= 0.85
    assert np.mean([one.p_value < 0.01 for one in found]) > 0.95
    without = [find(*draw(0.0, rng)) for _ in range(40)]
    assert np.mean([one.p_value < 0.05 for one in without]) <= 0.15
    assert np.mean([one.limit.lower == 0.0 for one in without]) >= 0.85


def test_insulating_fluid_has_no_limit() -> None:
    """The power law of Nelson, Accelerated Testing (1990), exponent 17.73, is the best of all limits."""
    voltage, limits = INSULATING_FLUID
    found = find(voltage, Lives(*limits))
    assert (found.limit.value, found.limit.lower, found.p_value) == (0.0, 0.0, 1.0)
    assert f"{found.exponent:.2f}" == "-17.73"
    assert 0 < found.limit.upper < 26


def test_likelihood_at_the_limit_is_that_of_its_definition() -> None:
    """Of a power law of V − limit on the specimens above it, by a search of its own."""
    from scipy import optimize

    voltage, lives = draw(LIMIT_KV, np.random.default_rng(8))
    found = find(voltage, lives)

    def loss(limit: float) -> float:
        above = voltage > limit
        x, t, failed = np.log(voltage[above] - limit), np.log(lives.lower[above]), lives.exact[above]

        def inner(p: np.ndarray) -> float:
            z = (t - p[0] - p[1] * x) * np.exp(-p[2])
            return float(np.exp(np.minimum(z, 50)).sum() - (z - p[2])[failed].sum())

        return float(optimize.minimize(inner, [9.0, -3.0, -0.9], method="BFGS").fun)

    best = optimize.minimize_scalar(loss, bounds=(2.5, 3.19), method="bounded")
    assert found.limit.value == pytest.approx(best.x, abs=2e-3)
    assert found.statistic == pytest.approx(2 * (loss(0.0) - best.fun), rel=1e-4)


def test_two_voltages_with_failures_are_refused_with_the_reason() -> None:
    voltage = np.repeat([2.0, 4.0, 5.0], 4)
    life = np.arange(1.0, 13.0)
    lives = Lives(life, np.where(voltage > 3, life, np.inf))
    with pytest.raises(DealabError, match="failures at 2 values of voltage tell no limit from a power law"):
        find(voltage, lives)
