"""Groups of lifetimes: the thesis' campaign, bad rows, tables and the questions asked of them in SQL."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import duckdb
import numpy as np
import pytest
from scipy import integrate

from pipeline.analyse.survival import survival_tables
from pipeline.fit.survival.groups import SurvivalGroup, SurvivalResults, survival_group
from pipeline.fit.survival.tests import EXACT_PERMUTATION, FISHER, LOG_RANK
from schemas.lifetimes import END_OF_TEST, LifetimeRow
from schemas.tables import TABLES
from schemas.views import VIEWS

SHAPE_1, MEAN_1 = 1.2, 39.0
SHAPE_2, SCALE_2 = 5.0, 224.0
END = 240.0


def row(
    name: str, life: float, *, failed: bool = True, configuration: str | None = "single", **keys: object
) -> LifetimeRow:
    given: dict[str, object] = {"voltage_kv": 7.5, "censored_because": None if failed else END_OF_TEST}
    return LifetimeRow(
        specimen_id=name,
        lifetime_s=life,
        failed=failed,
        configuration=configuration,
        **(given | keys),  # type: ignore[arg-type]
    )


def campaign(seed: int) -> list[LifetimeRow]:
    """The thesis' three cases: single electrode, divided, divided with the contact outside (20, 20 and 10 specimens)."""
    rng = np.random.default_rng(seed)
    from scipy.special import gamma

    draws: dict[str, tuple[int, Callable[[], float], tuple[str, ...]]] = {
        "single": (20, lambda: MEAN_1 / gamma(1 + 1 / SHAPE_1) * rng.weibull(SHAPE_1), ("rod",) * 19 + ("lead",)),
        "divided": (20, lambda: SCALE_2 * rng.weibull(SHAPE_2), ("lead",)),
        "outside": (10, lambda: np.inf, ("rod",)),
    }
    rows = []
    for configuration, (n, draw, sites) in draws.items():
        for i in range(n):
            life = float(draw())
            failed = life < END
            rows.append(
                row(
                    f"{configuration}-{i}",
                    life if failed else END + float(rng.uniform(-0.3, 0.3)),
                    failed=failed,
                    configuration=configuration,
                    failure_site=str(rng.choice(sites)) if failed else "none",
                    test_duration_s=END,
                    campaign="RP-DEA",
                )
            )
    return rows


@pytest.fixture(scope="module")
def results() -> SurvivalResults:
    return survival_group(campaign(3))


def of(results: SurvivalResults, configuration: str) -> SurvivalGroup:
    return next(group for group in results.groups if group.configuration == configuration)


def test_nobody_failed_is_reported_with_exact_limits(results: SurvivalResults) -> None:
    summary = of(results, "outside").summary
    assert (summary.specimens, summary.failures, summary.restricted_to_s) == (10, 0, END)
    assert summary.survival_at_end.value == 1
    assert summary.survival_at_end.lower == pytest.approx(0.692, abs=5e-4)
    text = " ".join(summary.warnings)
    assert "survival to 240\u00a0s is at least 0.692 (two-sided 95 %, exact, 10 specimens), 0.741 one-sided" in text
    assert "at least 801" in text
    assert "no Weibull law, no exponential law and no log-normal law: nobody failed (0 of 10 failed)" in text
    for estimate in (summary.median_s, summary.weibull_shape, summary.weibull_scale_s):
        assert np.isnan([estimate.value, estimate.lower, estimate.upper]).all()


def test_comparisons_come_with_exact_p(results: SurvivalResults) -> None:
    pairs = {(c.configuration_a, c.configuration_b, c.test): c for c in results.comparisons}
    exact = pairs["divided", "outside", EXACT_PERMUTATION]
    asymptotic = pairs["divided", "outside", LOG_RANK]
    assert 0 < exact.p_value < 0.05
    assert exact.p_value <= exact.p_value_holm <= 3 * exact.p_value
    assert ("outside", "single", FISHER) in pairs
    assert asymptotic.p_value > 0
    assert len({(a, b) for a, b, _ in pairs}) == 3


@pytest.mark.slow
@pytest.mark.study
def test_intervals_contain_the_truth_of_the_campaign() -> None:
    """Over many campaigns, so that a lucky seed proves nothing."""

    def survival_2(t: float) -> float:
        return float(np.exp(-((t / SCALE_2) ** SHAPE_2)))

    true_mean = integrate.quad(survival_2, 0, END)[0]
    held = np.zeros(4)
    runs = 25
    for seed in range(runs):
        results = survival_group([r for r in campaign(seed) if r.configuration != "single"])
        summary = of(results, "divided").summary
        shape, scale = summary.weibull_shape, summary.weibull_scale_s
        held += [
            summary.restricted_mean_s.lower <= true_mean <= summary.restricted_mean_s.upper,
            summary.survival_at_end.lower <= survival_2(END) <= summary.survival_at_end.upper,
            shape.lower <= SHAPE_2 <= shape.upper,
            scale.lower <= SCALE_2 <= scale.upper,
        ]
    assert np.all(held >= 0.84 * runs), held


def test_planned_end_is_common(results: SurvivalResults) -> None:
    for group in results.groups:
        assert group.summary.restricted_to_s == END
        assert group.campaign == "RP-DEA"
    assert of(results, "outside").curve.number_at_risk(END) == 10


def test_causes(results: SurvivalResults) -> None:
    assert [c.cause for c in of(results, "divided").causes.causes] == ["lead"]
    assert of(results, "outside").causes.causes == ()


GOOD = [row(f"S{i}", 10.0 * (i + 1)) for i in range(5)]


def test_negative_and_missing_lives_are_named_and_left_out() -> None:
    results = survival_group([*GOOD, row("N", -4.0), row("M", float("nan"))])
    assert results.groups[0].summary.specimens == 5
    assert "N: negative lifetime -4 s; left out" in results.warnings
    assert "M: no lifetime; left out" in results.groups[0].summary.warnings


def test_contradicting_flags_are_named() -> None:
    both = row("B", 30.0, censored_because="end of test")
    results = survival_group([*GOOD, both])
    assert results.groups[0].summary.specimens == 5
    assert "B: failed and censored at once (end of test); left out" in results.warnings
    site = survival_group([*GOOD, row("C", 30.0, failure_site="none")])
    assert site.groups[0].summary.specimens == 6
    assert any("failure_site is none" in text for text in site.warnings)
    alive = survival_group([*GOOD, row("D", 30.0, failed=False, failure_site="rod")])
    assert any("failure_site is rod; counted as censored" in text for text in alive.warnings)
    late = survival_group([*GOOD, row("E", 300.0, test_duration_s=240.0)])
    assert any("after the test of 240 s" in text for text in late.warnings)


def test_failure_at_a_raised_voltage_is_no_failure_of_the_fixed_test() -> None:
    raised = row("R", 290.0, breakdown_voltage_kv=9.5, test_duration_s=240.0)
    results = survival_group([*GOOD, raised])
    kept = next(r for r in results.groups[0].rows if r.specimen_id == "R")
    assert (kept.failed, kept.lifetime_s) == (False, 240.0)
    assert any("counted as surviving 240 s" in text for text in results.warnings)
    unknown = survival_group([*GOOD, replace(raised, test_duration_s=None)])
    assert any("failed at 9.5 kV, above the 7.5 kV of the test; left out" in text for text in unknown.warnings)


def test_staircase_tests_are_left_out_and_named() -> None:
    results = survival_group([*GOOD, row("T", 40.0, staircase=True, breakdown_voltage_kv=8.0)])
    assert results.groups[0].summary.specimens == 5
    assert "T: staircase test, broke down at 8 kV: no life at one voltage; left out" in results.warnings


def test_mixed_voltages_are_never_averaged() -> None:
    results = survival_group([*GOOD, row("H1", 3.0, voltage_kv=9.0), row("H2", 5.0, voltage_kv=9.0)])
    assert [(g.voltage_kv, g.summary.specimens) for g in results.groups] == [(7.5, 5), (9.0, 2)]
    for group in results.groups:
        assert "single was tested at 7.5 kV, 9 kV: one group per voltage" in group.summary.warnings
    near = survival_group([*GOOD, row("H3", 3.0, voltage_kv=7.52)])
    assert len(near.groups) == 1
    assert any("7.5 kV, 7.52 kV taken as one" in text for text in near.groups[0].summary.warnings)


def test_one_specimen_all_censored_no_configuration() -> None:
    one = survival_group([row("only", 30.0, configuration=None, voltage_kv=None)])
    text = " ".join(one.groups[0].summary.warnings)
    assert "one specimen" in text
    assert "without a configuration" in text
    assert survival_group([]).groups == ()
    assert survival_group([row("gone", -1.0)]).groups == ()


def test_same_specimen_twice_is_named() -> None:
    results = survival_group([*GOOD, row("S1", 70.0)])
    assert any("the same specimen as S1: not independent" in text for text in results.warnings)


def test_undecided_specimens_are_named_in_the_summary() -> None:
    results = survival_group([*GOOD, row("U", 44.0, decided=False)])
    assert any("cannot be decided: U" in text for text in results.groups[0].summary.warnings)


def test_failures_at_zero_and_only_zero() -> None:
    results = survival_group([row("Z1", 0.0), row("Z2", 0.0)])
    assert results.groups[0].summary.survival_at_end.value == 0
    mixed = survival_group([*GOOD, row("Z", 0.0)])
    assert any("failed at 0 s" in text for text in mixed.groups[0].summary.warnings)


def test_voltage_law_of_a_configuration() -> None:
    rng = np.random.default_rng(seed=8)
    rows = [
        row(f"{v}-{i}", 100 * (v / 7) ** -10 * float(rng.weibull(2.0)), voltage_kv=v)
        for v in (6.0, 7.0, 8.0)
        for i in range(10)
    ]
    results = survival_group(rows)
    ((_, configuration, law),) = results.voltage_life
    assert configuration == "single"
    assert law.exponent.lower < -10 < law.exponent.upper
    tables = survival_tables(results)
    assert tables["voltage_residuals"].num_rows == 3


def test_tables_and_sql(results: SurvivalResults) -> None:
    rows = campaign(3)
    tables = {"lifetimes": TABLES["lifetimes"].from_objects(rows)} | survival_tables(results)
    database = duckdb.connect()
    for name, table in tables.items():
        assert table.schema == TABLES[name].arrow_schema
        database.register(name, table)
    answer = dict(
        database.sql(
            "SELECT configuration, arg_max(survival, time_s) FROM survival_curves WHERE time_s <= 60 GROUP BY ALL"
        ).fetchall()
    )
    for configuration in ("single", "divided", "outside"):
        alive = sum(r.lifetime_s > 60 for r in rows if r.configuration == configuration)
        total = sum(r.configuration == configuration for r in rows)
        assert answer[configuration] == pytest.approx(alive / total)
    first = database.sql(
        "SELECT at_risk, survival, lower_95, upper_95 FROM survival_curves WHERE time_s = 0 AND configuration = 'single'"
    ).fetchall()
    assert first == [(20, 1.0, None, None)]
    certain = "SELECT count(*) FROM survival_curves WHERE survival IN (0, 1) AND (lower_95 = 1 OR upper_95 = 0)"
    assert database.sql(certain).fetchall() == [(0,)]
    undefined = "SELECT count(*) FROM survival_curves WHERE isnan(lower_95) OR isnan(upper_95)"
    assert database.sql(undefined).fetchall() == [(0,)]
    columns = "median_s, weibull_shape, survival_at_end, round(survival_at_end_lower, 3)"
    query = f"SELECT {columns} FROM survival_summaries WHERE configuration = 'outside'"
    assert database.sql(query).fetchall() == [(None, None, 1.0, 0.692)]
    assert tables["lifetimes"].num_rows == 50
    empty = survival_tables(survival_group([]))
    assert all(table.num_rows == 0 for table in empty.values())


def test_survival_at_a_time_is_said_up_to_the_end_of_the_follow_up(results: SurvivalResults) -> None:
    database = duckdb.connect()
    curves = survival_tables(results)["survival_curves"]
    database.register("survival_curves", curves)
    (view,) = (view for view in VIEWS if view.name == "survival_at")
    database.execute(view.ddl())
    ends: dict[str, float] = {}
    for curve in curves.to_pylist():
        ends[curve["configuration"]] = max(ends.get(curve["configuration"], 0.0), curve["time_s"])
    for time in (60, 1e6):
        found = {row[0]: row[3] for row in database.sql(f"SELECT * FROM survival_at({time})").fetchall()}
        assert len(found) == 3
        for configuration, survival in found.items():
            before = [c for c in curves.to_pylist() if c["configuration"] == configuration and c["time_s"] <= time]
            last = before[-1]["survival"]
            assert survival == (None if time > ends[configuration] and last > 0 else last)


def test_campaigns_are_experiments_of_their_own() -> None:
    """Groups of one name in two campaigns are two, and Holm's correction counts the pairs of one campaign alone."""
    rng = np.random.default_rng(4)

    def lives(campaign: str | None, configuration: str, scale: float) -> list[LifetimeRow]:
        draws = scale * rng.weibull(2.0, 12)
        return [
            row(f"{configuration}-{i}", x, configuration=configuration, campaign=campaign) for i, x in enumerate(draws)
        ]

    first = [*lives("one", "A", 50), *lives("one", "B", 70)]
    second = [*lives("two", "A", 500), *lives("two", "B", 900), *lives("two", "C", 500)]
    alone, both = survival_group(first), survival_group([*first, *second])
    assert [(g.campaign, g.configuration, g.summary.specimens) for g in both.groups] == [
        ("one", "A", 12), ("one", "B", 12), ("two", "A", 12), ("two", "B", 12), ("two", "C", 12),
    ]  # fmt: skip
    assert {(c.campaign, c.configuration_a, c.configuration_b) for c in both.comparisons} == {
        ("one", "A", "B"), ("two", "A", "B"), ("two", "A", "C"), ("two", "B", "C"),
    }  # fmt: skip
    own = [c for c in both.comparisons if c.campaign == "one"]
    assert repr(own) == repr(list(alone.comparisons)), "NaN is not equal to itself"
    assert both.groups[0].summary.restricted_to_s == alone.groups[0].summary.restricted_to_s
    assert not any("not independent" in text for text in both.warnings), "names of specimens may occur in both"
    tables = survival_tables(both)
    assert all("campaign" in tables[name].column_names for name in tables)
    database = duckdb.connect()
    database.register("survival_curves", tables["survival_curves"])
    (view,) = (view for view in VIEWS if view.name == "survival_at")
    database.execute(view.ddl())
    found = database.sql("SELECT campaign, configuration, survival FROM survival_at(100)").fetchall()
    assert len(found) == 5
    assert all(survival < 0.3 for campaign, _, survival in found if campaign == "one")
    assert all(survival > 0.7 for campaign, _, survival in found if campaign == "two")
