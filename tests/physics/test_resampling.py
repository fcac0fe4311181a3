"""Limits of life regressions by simulation: exact ones of complete lives, refusals, and the command that prints them."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.cli import main
from pipeline.fit.survival.covariates import Covariate
from pipeline.fit.survival.lifetime_distributions import Lives
from pipeline.fit.survival.resampling import CORRECTED, PIVOTS, simulate_limits
from schemas.errors import DealabError
from schemas.life_covariates import INVERSE_POWER
from schemas.lifetimes import LifetimeRow

pytestmark = pytest.mark.quick


def test_limits_of_complete_log_normal_lives_are_those_of_student_and_chi_squared() -> None:
    logs = np.random.default_rng(9).normal(3.0, 0.7, 8)
    found = simulate_limits(Lives(np.exp(logs), np.exp(logs)), [], "log-normal", at=np.empty(0), draws=20000)
    assert found.method == PIVOTS
    assert found.median_s is not None
    s = logs.std(ddof=1)
    half = 2.3646242510103 * s / np.sqrt(8)  # t of 7 degrees of freedom
    expected = [logs.mean() - half, logs.mean() + half]
    assert np.log([found.median_s.lower, found.median_s.upper]) == pytest.approx(expected, abs=0.03 * s)
    squares = np.array([16.01276, 1.68987])  # χ² of 7 degrees of freedom
    assert [found.sigma.lower, found.sigma.upper] == pytest.approx((s * np.sqrt(7 / squares)).tolist(), rel=0.03)


def test_limits_of_exponential_lives_that_all_failed_are_those_of_chi_squared() -> None:
    life = np.random.default_rng(3).exponential(100.0, 10)
    found = simulate_limits(Lives(life, life), [], "exponential", draws=20000)
    mean = found.coefficients["intercept"]
    total = 2 * life.sum()
    expected = np.log(total / np.array([34.1696, 9.59078]))  # χ² of 20 degrees of freedom
    assert [mean.lower, mean.upper] == pytest.approx(expected.tolist(), abs=0.02)
    assert (found.sigma.lower, found.sigma.upper) == (1.0, 1.0)


def drawn(n: int = 30) -> tuple[Lives, list[Covariate]]:
    rng = np.random.default_rng(1)
    voltage = np.repeat([4.0, 5.0, 6.0], n // 3)
    life = np.exp(18 - 6 * np.log(voltage) + 0.6 * np.log(rng.exponential(size=n)))
    end = np.exp(18 - 6 * np.log(voltage) + 0.1)
    return Lives(np.minimum(life, end), np.where(life <= end, life, np.inf)), [
        Covariate("voltage", INVERSE_POWER, voltage, "kV")
    ]


def test_limits_are_near_those_of_the_likelihood_and_the_same_again() -> None:
    lives, covariates = drawn(90)
    first, again = (simulate_limits(lives, covariates, "weibull", draws=2000) for _ in range(2))
    slope, own = first.coefficients["voltage"], first.regression.coefficients[1].value
    assert again.coefficients == first.coefficients
    assert [slope.lower, slope.upper] == pytest.approx([own.lower, own.upper], abs=0.2 * (own.upper - own.lower) / 2)


def test_a_generalised_gamma_has_limits_moved_by_their_bias() -> None:
    lives, covariates = drawn()
    found = simulate_limits(lives, covariates, "generalised gamma", draws=30)
    assert found.method == CORRECTED
    assert found.shape is not None
    assert found.shape.lower < found.shape.upper
    assert 15 <= found.fitted <= 30


@pytest.mark.parametrize("kind", ["inspected", "late"])
def test_lives_whose_tests_cannot_be_simulated_are_refused(kind: str) -> None:
    life = np.arange(1.0, 9.0)
    lives = Lives(life, life + 1) if kind == "inspected" else Lives(life, life, life / 2)
    with pytest.raises(DealabError, match="found at inspections, or that came under watch late"):
        simulate_limits(lives, [], "weibull")


def rows_of_a_campaign(campaign: str) -> list[LifetimeRow]:
    lives, (covariate,) = drawn()
    return [
        LifetimeRow(
            specimen_id=f"s{k}", lifetime_s=float(life), failed=bool(np.isfinite(end)), campaign=campaign, voltage_kv=float(kv)
        )
        for k, (life, end, kv) in enumerate(zip(lives.lower, lives.upper, covariate.values, strict=True))
    ]  # fmt: skip


def test_command_prints_both_limits_and_names_campaigns_that_have_them(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("pipeline.commands.show.lives.read_lives", lambda lab: rows_of_a_campaign("ageing"))
    assert main(["lives", "ageing", "--draws", "40"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("ageing: 30 lives, ")
    assert "95 % limits of the profile likelihood, then of the simulated pivots (" in said
    assert {"intercept", "voltage_kv", "scatter"} <= {line.split()[0] for line in said.splitlines()[2:]}
    assert main(["lives", "other"]) == 2
    assert 'no regression of lives in campaign "other"' in capsys.readouterr().err
