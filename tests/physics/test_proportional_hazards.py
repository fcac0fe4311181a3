"""Cox's model and its assumption against R's survival package, and hazards that cross."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.fit.survival.covariates import Covariate, make_design
from pipeline.fit.survival.cox_regression import fit_cox
from pipeline.fit.survival.lifetime_distributions import Lives
from pipeline.fit.survival.proportional_hazards import ALL_COVARIATES, ProportionalityTest, check_proportional_hazards
from schemas.life_covariates import CATEGORY, EXPONENTIAL_LAW
from tests.helpers.published_lives import OVARIAN

pytestmark = pytest.mark.quick

DAYS, DIED, AGE, TREATMENT, PERFORMANCE = OVARIAN.T


def limits(time: np.ndarray, failed: np.ndarray) -> Lives:
    return Lives(time, np.where(failed, time, np.inf))


def check(lives: Lives, *covariates: Covariate) -> tuple[ProportionalityTest, ...]:
    design = make_design(covariates, lives.exact)
    return check_proportional_hazards(lives, design, fit_cox(lives, design))


def test_ovarian_cancer_by_cox() -> None:
    """R 4.6.1, survival 3.8.9: coxph(Surv(futime, fustat) ~ age + rx), printed with 17 digits."""
    lives = limits(DAYS, DIED > 0)
    covariates = [Covariate("age", EXPONENTIAL_LAW, AGE), Covariate("rx", EXPONENTIAL_LAW, TREATMENT)]
    fit = fit_cox(lives, make_design(covariates, lives.exact))
    assert [e.value.value for e in fit.effects] == pytest.approx([0.147326595469114, -0.80397301266511445], rel=1e-9)
    assert [e.standard_error for e in fit.effects] == pytest.approx(
        [0.046147047740802638, 0.63204937187945009], rel=1e-9
    )
    assert fit.log_likelihood == pytest.approx(-27.041898863008388, rel=1e-12)


def test_ovarian_cancer_proportionality() -> None:
    """The example of R's cox.zph (survival 3): age 0.698, p 0.40; ecog.ps 2.371, p 0.12; GLOBAL 3.633, p 0.16."""
    found = check(
        limits(DAYS, DIED > 0),
        Covariate("age", EXPONENTIAL_LAW, AGE),
        Covariate("ecog.ps", EXPONENTIAL_LAW, PERFORMANCE),
    )
    assert [(t.covariate, f"{t.statistic:.3f}", t.degrees_of_freedom, f"{t.p_value:.2f}") for t in found] == [
        ("age", "0.698", 1, "0.40"),
        ("ecog.ps", "2.371", 1, "0.12"),
        (ALL_COVARIATES, "3.633", 2, "0.16"),
    ]


def test_hazards_that_cross_are_seen_and_those_of_a_weibull_law_are_not() -> None:
    rng = np.random.default_rng(5)
    kind = np.repeat([0.0, 1.0], 150)
    same = np.exp(0.5 * kind) * rng.weibull(2.0, 300)
    crossing = np.where(kind > 0, rng.weibull(4.0, 300), rng.weibull(0.8, 300))
    first, second = (
        check(limits(life, life > 0), Covariate("kind", CATEGORY, np.where(kind > 0, "b", "a").tolist()))[0]
        for life in (same, crossing)
    )
    assert first.p_value > 0.05
    assert second.p_value < 1e-6
    assert second.trend > 0  # the hazard of the steeper law is lower first and higher later


def test_ties_and_late_entries_leave_the_test_near_its_level() -> None:
    rng = np.random.default_rng(6)
    p_values = []
    for _ in range(200):
        x, entered = rng.normal(size=120), rng.uniform(0, 0.6, 120)
        life = rng.exponential(size=120) * np.exp(-0.5 * x)
        seen = life > entered
        coarse = np.ceil(8 * life[seen]) / 8
        lives = Lives(coarse, coarse, np.minimum(entered[seen], coarse - 1e-3))
        p_values.append(check(lives, Covariate("x", EXPONENTIAL_LAW, x[seen]))[0].p_value)
    assert 0.01 <= np.mean(np.array(p_values) < 0.05) <= 0.1
