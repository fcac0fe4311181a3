"""Plans of life tests: information against its definition, budgets kept, bounds and sizes against published numbers."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from pipeline.analyse.life_plans import life_plan_table
from pipeline.cli import main
from pipeline.fit.life_plan.assumptions import ERRORS, LifeAssumptions, Scenario, assume_life
from pipeline.fit.life_plan.designs import EVEN_GRID, NEXT_TEST, ROBUST, Known, Planner, Rig
from pipeline.fit.life_plan.information import expect
from pipeline.fit.life_plan.known_lives import know_lives, plan_campaigns
from pipeline.fit.life_plan.stopping import plan_stopping
from pipeline.fit.life_plan.two_designs import log_rank, simulate_power, size_comparison
from pipeline.fit.survival.log_location_scale import LogLives, differentiate
from pipeline.fit.survival.tests import LOG_RANK, rank_test
from schemas.errors import NotIdentifiableError, UsageError
from schemas.lifetimes import LifetimeRow

pytestmark = pytest.mark.quick

RIG = Rig(use_kv=3.0, lowest_kv=3.0, highest_kv=8.0, longest_h=200.0, setup_h=1.0)


def assumed(**more: float) -> LifeAssumptions:
    plain = {"reference_kv": 6.0, "median_h": 10.0, "exponent": -10.0, "shape": 2.0}
    return assume_life(**(plain | more))  # type: ignore[arg-type]


@pytest.mark.parametrize("family", ERRORS)
def test_expected_information_is_the_mean_of_the_observed_one(family: str) -> None:
    """Drawn lives and the second derivatives of the fit, which the plan does not use."""
    truth = Scenario(6.0, float(np.log(36000)), -10.0, 0.5, family)
    voltage, duration = np.array([5.0, 7.0]), np.array([40.0, 4.0]) * 3600
    expected = expect((truth,), voltage, duration)
    rng = np.random.default_rng(3)
    for i in range(2):
        w = truth.error.quantile_of_survival(rng.uniform(size=(1, 200_000)))
        life = truth.location(voltage[i]) + truth.sigma * w
        end = np.minimum(life, np.log(duration[i]))
        x = np.full(200_000, np.log(voltage[i] / 6.0))
        at = np.array([1.0, truth.location(np.array(6.0)), truth.exponent])[None, :] / truth.sigma
        lives = LogLives(end, np.where(life <= end, end, np.inf))
        hessian = differentiate(lives, np.column_stack((np.ones(x.size), x)), truth.error, at)[2][0] / x.size
        change = np.zeros((3, 3))
        change[0] = [0.0, 0.0, -1 / truth.sigma]
        change[1:, :2] = np.eye(2) / truth.sigma
        change[1:, 2] = -at[0, 1:]
        np.testing.assert_allclose(expected.information[0, i], -change.T @ hessian @ change, rtol=0.02, atol=0.02)
        assert expected.failures[0, i] == pytest.approx((life <= end).mean(), abs=0.005)
        assert expected.hours[0, i] == pytest.approx(np.exp(end).mean() / 3600, rel=0.01)


def test_plans_keep_their_budget_and_beat_the_even_grid() -> None:
    planner = Planner(assumed(median_factor=1.5, exponent_sd=1.0, shape_factor=1.5), RIG)
    grid = planner.even_grid(3000)
    for plan in (planner.optimal(3000), planner.robust(3000)):
        assert plan.hours <= 3000 * 1.02
        assert np.log(plan.factor_for(grid.hours)) < 0.7 * np.log(grid.factor)
    few = planner.robust(3000, 30)
    assert few.specimens <= 30
    assert few.hours <= 3000 * 1.02
    assert len({test.voltage_kv for test in planner.robust(3000).tests}) >= 3, "two voltages cannot test the law"
    assert planner.optimal(3000).factor <= planner.robust(3000).factor * 1.01
    assert planner.optimal(3000).worst_factor > planner.optimal(3000).factor


def test_no_other_single_test_would_have_told_more_at_its_price() -> None:
    """The optimum of the real-numbered problem: no candidate gains more per hour than those that are used."""
    planner = Planner(assumed(), RIG)
    plan = planner.optimal(3000)
    more = planner.optimal(6000)
    assert np.log(more.factor) / np.log(plan.factor) == pytest.approx(1 / np.sqrt(2), rel=0.01)
    number = np.zeros(planner.voltage_kv.size)
    for test in more.tests:
        at = np.isclose(planner.voltage_kv, test.voltage_kv) & np.isclose(planner.duration_s, 3600 * test.duration_h)
        number[at] = test.specimens
    gain = planner._believed.gain_per_hour(number)
    assert gain.max() <= 1.15 * gain[number > 0].min()


def test_hours_for_a_wanted_interval_give_it() -> None:
    planner = Planner(assumed(exponent_sd=1.0), RIG)
    assert np.log(planner.robust(planner.hours_for(3.0)).factor) == pytest.approx(np.log(3.0), rel=0.02)
    with pytest.raises(UsageError, match="interval of ratio"):
        planner.hours_for(0.5)


def test_what_is_known_narrows_the_plan_and_chooses_the_next_test() -> None:
    fresh = Planner(assumed(), RIG)
    tests = fresh.robust(1000).tests
    voltage, duration = np.array([t.voltage_kv for t in tests]), np.array([3600 * t.duration_h for t in tests])
    number = np.array([t.specimens for t in tests])
    information = np.tensordot(number, expect(assumed().scenarios(), voltage, duration).information[0], axes=1)
    later = Planner(assumed(), RIG, Known(information, int(number.sum())))
    assert later.robust(1000).factor < fresh.robust(1000).factor
    one = later.next_test()
    assert (one.name, one.specimens) == (NEXT_TEST, 1)


def test_budgets_that_carry_no_plan_are_named() -> None:
    planner = Planner(assumed(), RIG)
    with pytest.raises(NotIdentifiableError, match="do not carry a plan"):
        planner.optimal(1.0)
    with pytest.raises(NotIdentifiableError, match="give no interval"):
        planner.optimal(6.0)
    for wrong in ({"exponent": 2.0}, {"shape": 0.0}, {"median_h": -1.0}, {"shape_factor": 0.5}, {"exponent_sd": -1.0}):
        with pytest.raises(UsageError):
            assumed(**wrong)
    with pytest.raises(UsageError, match="lowest voltage"):
        Rig(3.0, 8.0, 8.0, 10.0)


@pytest.mark.parametrize(
    ("looks", "bounds"),
    [
        (2, (2.9626, 1.9686)),
        (4, (4.3326, 2.9631, 2.3590, 2.0141)),
        (5, (4.8769, 3.3569, 2.6803, 2.2898, 2.0310)),
    ],
)
def test_bounds_are_those_that_are_published(looks: int, bounds: tuple[float, ...]) -> None:
    """Lan and DeMets' bounds as D. Reboussin's tables have them: two-sided 5 %, equal steps."""
    found = plan_stopping([(i + 1) / looks for i in range(looks)])
    np.testing.assert_allclose([look.bound for look in found.looks], bounds, atol=2e-4)
    assert found.looks[-1].false_alarm == pytest.approx(0.05, abs=1e-6)
    assert found.looks[-1].power == pytest.approx(0.8, abs=1e-6)
    assert 1 < found.inflation < 1.03


def test_early_stopping_keeps_its_error_rates_in_simulation() -> None:
    found = plan_stopping([0.5, 1.0], power=0.9)
    rng = np.random.default_rng(5)
    for drift, at in ((0.0, "false_alarm"), (1.0, "power")):
        mean = drift * 3.2415 * np.sqrt(found.inflation)
        first = rng.normal(mean * 0.5, np.sqrt(0.5), 200_000)
        last = first + rng.normal(mean * 0.5, np.sqrt(0.5), 200_000)
        stopped = np.abs(first) / np.sqrt(0.5) >= found.looks[0].bound
        assert stopped.mean() == pytest.approx(getattr(found.looks[0], at), abs=0.004)
        assert (stopped | (np.abs(last) >= found.looks[1].bound)).mean() == pytest.approx(
            getattr(found.looks[1], at), abs=0.004
        )
    for wrong in ([1.0, 0.5], [], [0.5]):
        with pytest.raises(UsageError):
            plan_stopping(wrong)


def test_many_log_rank_tests_at_once_are_the_single_ones() -> None:
    rng = np.random.default_rng(6)
    time, failed = rng.uniform(1, 9, (3, 14)), rng.uniform(size=(3, 14)) < 0.7
    first = np.arange(14) < 7
    for i, z in enumerate(log_rank(time, failed, first)):
        groups = [(time[i, first], failed[i, first]), (time[i, ~first], failed[i, ~first])]
        assert z**2 == pytest.approx(rank_test(groups, LOG_RANK).statistic, rel=1e-9)


def test_a_comparison_has_the_power_that_it_says() -> None:
    """Schoenfeld's formula for two exponential designs of hazards 2 to 1: 65.3 failures for 80 %."""
    lives = assume_life(reference_kv=6.0, median_h=10.0, exponent=-10.0, shape=1.0).scenarios()[0]
    sized = size_comparison(lives, 2.0, 6.0, 1e4)
    assert sized.failures == pytest.approx(65.3, rel=0.12)
    assert sized.power >= 0.8
    assert simulate_power(lives, sized.specimens_each - 4, 2.0, np.inf) < 0.8
    assert 0.03 < sized.false_alarm < 0.07
    looked = size_comparison(lives, 2.0, 6.0, 1e4, looks=3)
    assert looked.stopping is not None
    assert sized.specimens_each <= looked.specimens_each <= 1.03 * sized.specimens_each + 1
    with pytest.raises(UsageError, match="factor of 1"):
        size_comparison(lives, 1.0, 6.0, 10.0)
    with pytest.raises(NotIdentifiableError, match="nearly nobody fails"):
        size_comparison(lives, 2.0, 1.0, 10.0)


def rows(levels: tuple[float, ...] = (4.0, 5.0, 6.0), exponent: float = -8.0) -> list[LifetimeRow]:
    rng = np.random.default_rng(8)
    lives = [
        (v, float(72000 * (v / 5) ** exponent * rng.weibull(2.0))) for v in levels for _ in range(8)
    ]  # fmt: skip
    return [
        LifetimeRow(specimen_id=f"S{i}", lifetime_s=min(t, 2e5), failed=t < 2e5, campaign="ageing", voltage_kv=v)
        for i, (v, t) in enumerate(lives)
    ]


def tabulate(lives: list[LifetimeRow]) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = life_plan_table(plan_campaigns(lives)).to_pylist()
    return found


def test_a_campaign_gets_its_plans_as_rows() -> None:
    found = tabulate(rows())
    assert {row["plan"] for row in found} == {NEXT_TEST, ROBUST, EVEN_GRID}
    for row in found:
        assert row["use_kv"] == pytest.approx(2.4)
        assert row["life_at_use_s_lower"] < row["life_at_use_s"] < row["life_at_use_s_upper"]
        assert 1 < row["limits_ratio"] < row["life_at_use_s_upper"] / row["life_at_use_s_lower"]
    robust = [row for row in found if row["plan"] == ROBUST]
    assert sum(row["specimens"] for row in robust) <= 24
    spent = know_lives(rows())
    assert sum(row["rig_hours"] for row in robust) <= 1.02 * (spent.hours + 24 * 0.25)


def test_lives_that_carry_no_plan_say_why() -> None:
    assert tabulate(rows((5.0,))) == [], "one voltage: nothing to plan"
    (row,) = tabulate(rows(exponent=3.0))
    assert row["plan"] == "none"
    assert "does not fall with voltage" in row["warnings"]


ASSUMED = ("--at-kv", "6", "--median-h", "10", "--exponent", "-10", "--longest-h", "200")


def test_the_command_plans_and_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "lifetimes", *ASSUMED, "--use-kv", "3", "--to-kv", "8", "--hours", "1000"]) == 0
    out = capsys.readouterr().out
    assert "Robust:" in out
    assert "narrower than the even grid's" in out
    json_ = ["plan", "lifetimes", *ASSUMED, "--use-kv", "3", "--to-kv", "8", "--hours", "1000", "--format", "json"]
    assert main(json_) == 0
    assert [plan["name"] for plan in json.loads(capsys.readouterr().out)["plans"]] == ["robust", "optimal", "even grid"]
    assert main(["plan", "lifetimes", *ASSUMED, "--ratio", "2", "--looks", "2"]) == 0
    assert "of each design" in capsys.readouterr().out
    assert main(["plan", "lifetimes", *ASSUMED, "--use-kv", "3", "--hours", "1000"]) == 2
    assert "--to-kv is missing" in capsys.readouterr().err
    assert main(["plan", "lifetimes", *ASSUMED, "--campaign", "x"]) == 2
    assert "lives that are known, or lives that are assumed" in capsys.readouterr().err
