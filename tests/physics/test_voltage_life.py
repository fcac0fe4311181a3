"""The inverse power law against scipy's optimiser and on simulated lives that obey it or not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, stats

from pipeline.fit.survival.lifetime_distributions import Lives
from pipeline.fit.survival.voltage_life import fit_inverse_power_law
from schemas.errors import NotIdentifiableError, RefusedError


def lives_of(
    rng: np.random.Generator,
    volts: tuple[float, ...],
    n: int,
    *,
    end: float = np.inf,
    shape: float = 2.0,
    power: float = -10,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weibull lives with scale 100 s at 7 kV, by the inverse of the distribution function."""
    v = np.repeat(volts, n)
    life = 100 * (v / 7.0) ** power * (-np.log(rng.uniform(size=v.size))) ** (1 / shape)
    return np.minimum(life, end), life <= end, v


def test_against_a_general_optimiser() -> None:
    time, failed, v = lives_of(np.random.default_rng(seed=1), (6.0, 7.0, 8.0), 12, end=240.0)
    found = fit_inverse_power_law(Lives.right_censored(time, failed), v)

    def minus(x: np.ndarray) -> float:
        frozen = stats.weibull_min(np.exp(-x[2]), scale=np.exp(x[0] + x[1] * np.log(v / 7)))
        return -float(np.where(failed, frozen.logpdf(time), frozen.logsf(time)).sum())

    best = optimize.minimize(
        minus, [4.5, -8, -0.5], method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-12, "maxiter": 6000}
    )
    assert found.log_likelihood == pytest.approx(-best.fun, abs=1e-7)
    assert found.exponent.value == pytest.approx(best.x[1], rel=1e-5)
    assert found.intercept.value == pytest.approx(best.x[0] - best.x[1] * np.log(7), rel=1e-5)
    assert found.sigma.value == pytest.approx(np.exp(best.x[2]), rel=1e-5)


@pytest.mark.slow
@pytest.mark.study
def test_intervals_and_lack_of_fit_hold_their_level() -> None:
    rng = np.random.default_rng(seed=2)
    held, rejected, runs = np.zeros(3), 0, 40
    for _ in range(runs):
        time, failed, v = lives_of(rng, (6.0, 7.0, 8.0), 8, end=300.0)
        law = fit_inverse_power_law(Lives.right_censored(time, failed), v)
        held[:2] += [law.exponent.lower <= -10 <= law.exponent.upper, law.sigma.lower <= 0.5 <= law.sigma.upper]
        scale, _ = law.scale(7.0)
        held[2] += scale.lower <= 100 <= scale.upper
        rejected += law.holds is False
    assert np.all(held / runs > 0.85), held / runs
    assert rejected / runs <= 0.12


def test_a_voltage_off_the_law_is_located() -> None:
    time, failed, v = lives_of(np.random.default_rng(seed=3), (6.0, 7.0, 8.0, 9.0), 15)
    time = np.where(v == 6.0, 30 * time, time)
    law = fit_inverse_power_law(Lives.right_censored(time, failed), v)
    assert law.holds is False
    assert "fails at 6 kV" in law.statement
    assert "specimens live" in law.statement
    assert any("does not hold" in text for text in law.warnings)


def test_extrapolation_is_warned_of() -> None:
    time, failed, v = lives_of(np.random.default_rng(seed=4), (6.0, 7.0, 8.0), 15)
    law = fit_inverse_power_law(Lives.right_censored(time, failed), v)
    inside, quiet = law.scale(7.0)
    assert quiet == law.warnings
    outside, warned = law.scale(4.0)
    assert any("below the lowest tested voltage (6 kV)" in text for text in warned)
    assert outside.upper / outside.lower > inside.upper / inside.lower


def test_voltage_without_failures_takes_part() -> None:
    rng = np.random.default_rng(seed=5)
    time, failed, v = lives_of(rng, (5.0, 7.0, 8.0), 10, end=240.0, power=-14)
    assert not failed[v == 5.0].any()
    law = fit_inverse_power_law(Lives.right_censored(time, failed), v)
    silent = law.residuals[0]
    assert (silent.voltage_kv, silent.failures) == (5.0, 0)
    assert np.isnan(silent.scale_s)
    assert law.holds is not False


def test_two_voltages_cannot_test_the_law() -> None:
    time, failed, v = lives_of(np.random.default_rng(seed=6), (6.0, 8.0), 10)
    law = fit_inverse_power_law(Lives.right_censored(time, failed), v)
    assert [t.against for t in law.tests] == ["free shapes"]
    assert law.holds is None
    assert law.statement.endswith("two voltages cannot test the law")
    assert "two voltages: the law cannot be tested" in law.warnings


def test_refusals_say_why() -> None:
    with pytest.raises(NotIdentifiableError, match=r"failures at 1 voltage"):
        fit_inverse_power_law(Lives.right_censored([1.0, 2, 3, 9], [1, 1, 1, 0]), [7.0, 7, 7, 5])
    with pytest.raises(RefusedError, match="not above 0 kV"):
        fit_inverse_power_law(Lives.right_censored([1.0, 2, 3], [1, 1, 1]), [7.0, 0.0, 5])
