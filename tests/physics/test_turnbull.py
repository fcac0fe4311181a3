"""Turnbull's curve against published tables, closed solutions and Kaplan–Meier; what no curve can be had from."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.analyse.survival import analyse_survival
from pipeline.fit.survival.groups import survival_group
from pipeline.fit.survival.kaplan_meier import kaplan_meier
from pipeline.fit.survival.lifetime_distributions import Lives, fit_distribution
from pipeline.fit.survival.turnbull import Turnbull, estimate_turnbull
from schemas.errors import NotIdentifiableError, RefusedError
from schemas.lifetimes import LifetimeRow
from tests.helpers.published_lives import BREAST_COSMESIS, TURBINE_WHEELS

pytestmark = pytest.mark.quick


def test_breast_cosmesis() -> None:
    """The maximum by Turnbull's own iteration written out, J. R. Stat. Soc. B 38 (1976) 290; no printed table was at hand."""
    lower, upper = BREAST_COSMESIS
    curve = estimate_turnbull(Lives(lower, upper))
    assert curve.ends.tolist() == [5, 7, 8, 12, 25, 34, 40, 48]
    begins = np.array([4, 6, 7, 11, 24, 33, 38, 46])
    within = (lower[:, None] <= begins) & (curve.ends <= upper[:, None])
    mass = np.full(8, 1 / 8)
    for _ in range(500):
        mass = (within * mass / (within @ mass)[:, None]).mean(axis=0)
    assert curve.survival == pytest.approx(1 - np.cumsum(mass), abs=1e-8)
    assert [f"{s:.3f}" for s in curve.survival[:-1]] == ["0.954", "0.920", "0.832", "0.761", "0.668", "0.586", "0.466"]


def test_turbine_wheels() -> None:
    """Each wheel was looked at once: the curve is that of pooled neighbours (Nelson, Applied Life Data Analysis, 1982)."""
    curve = estimate_turnbull(Lives(*TURBINE_WHEELS))
    exact = [6 / 86, 7 / 73, 5 / 30, 18 / 81, 6 / 13, 43 / 74, 21 / 36]
    assert 1 - curve.survival == pytest.approx(exact, abs=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_right_censored_lives_give_kaplan_meier(seed: int) -> None:
    rng = np.random.default_rng(seed)
    life, end = 10 * rng.weibull(1.5, 40), rng.uniform(0, 20, 40)
    time, failed = np.round(np.minimum(life, end), 1) + 0.1, life <= end
    expected, curve = kaplan_meier(time, failed), estimate_turnbull(Lives(time, np.where(failed, time, np.inf)))
    at = expected.failures > 0
    assert curve.ends.tolist() == expected.time[at].tolist()
    assert curve.survival == pytest.approx(expected.survival[at], abs=1e-9)
    assert curve.standard_error == pytest.approx(expected.standard_error[at], abs=1e-8)
    assert curve.at_risk.tolist() == expected.at_risk[at].tolist()


def test_late_entry_gives_the_product_limit_of_those_under_watch() -> None:
    rng = np.random.default_rng(1)
    entered, life = rng.uniform(0, 8, 200), 10 * rng.weibull(1.5, 200)
    seen = life > entered
    entered, life = entered[seen], life[seen]
    end = entered + rng.uniform(2, 10, life.size)
    time, failed = np.minimum(life, end), life <= end
    curve = estimate_turnbull(Lives(time, np.where(failed, time, np.inf), entered))
    expected = np.cumprod([1 - 1 / ((entered < t) & (time >= t)).sum() for t in np.sort(time[failed])])
    assert curve.survival == pytest.approx(expected, abs=1e-8)


def test_weibull_of_late_entries_is_unbiased_where_plain_lives_are_not() -> None:
    rng = np.random.default_rng(2)
    entered, life = rng.uniform(0, 12, 4000), 10 * rng.weibull(2.0, 4000)
    seen = life > entered
    late = fit_distribution(Lives(life[seen], life[seen], entered[seen]), "weibull").parameters
    plain = fit_distribution(Lives(life[seen], life[seen]), "weibull", goodness=False).parameters
    assert late["shape"].lower < 2.0 < late["shape"].upper
    assert late["scale_s"].lower < 10.0 < late["scale_s"].upper
    assert plain["scale_s"].lower > 11.0


@pytest.mark.parametrize(
    ("limits", "error", "problem"),
    [
        (([1.0, 2.0], [np.inf, np.inf], None), NotIdentifiableError, "nobody failed"),
        (([5.0], [4.0], None), RefusedError, "lifetime between 5 and 4 s"),
        (([-1.0], [4.0], None), RefusedError, "lifetime between -1 and 4 s"),
        (([3.0], [4.0], [3.5]), RefusedError, "came under watch at 3.5 s"),
    ],
)
def test_lives_without_a_curve(limits: tuple[list[float], ...], error: type[Exception], problem: str) -> None:
    lower, upper, entered = limits
    with pytest.raises(error, match=problem):
        estimate_turnbull(Lives(np.array(lower), np.array(upper), None if entered is None else np.array(entered)))


def test_groups_of_inspected_lives_say_what_they_cannot_have() -> None:
    inspected = [
        LifetimeRow(
            specimen_id=f"i{k}", lifetime_s=t, failed=True, alive_at_s=t - 1, configuration="daily", voltage_kv=5.0
        )
        for k, t in enumerate((2.0, 3.0, 3.0, 5.0))
    ]
    exact = [
        LifetimeRow(specimen_id=f"e{k}", lifetime_s=t, failed=True, configuration="watched", voltage_kv=5.0)
        for k, t in enumerate((1.0, 4.0, 6.0))
    ]
    results = survival_group([*inspected, *exact])
    daily = next(group for group in results.groups if group.configuration == "daily")
    assert isinstance(daily.curve, Turnbull)
    assert daily.curve.survival == pytest.approx([0.75, 0.25, 0.0])
    assert any("Turnbull's curve" in text for text in daily.summary.warnings)
    (comparison,) = results.comparisons
    assert "no test by ranks" in comparison.warnings[0]
    rows = analyse_survival([*inspected, *exact]).joined()["survival_curves"].to_pylist()
    assert [(r["from_s"], r["time_s"]) for r in rows if r["method"] == "turnbull"] == [(0, 0), (1, 2), (2, 3), (4, 5)]
