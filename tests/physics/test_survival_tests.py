"""Tests between groups against published numbers, enumeration by brute force, scipy and lifelines."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from pipeline.fit.survival.comparisons import NO_TEST, compare, corrected, restricted_mean_difference
from pipeline.fit.survival.hazard_ratio import hazard_ratio
from pipeline.fit.survival.tests import (
    EXACT_PERMUTATION,
    GEHAN,
    LOG_RANK,
    PETO,
    SIMULATED_PERMUTATION,
    TARONE_WARE,
    fisher_test,
    holm,
    log_rank_scores,
    permutation_test,
    rank_test,
)
from schemas.errors import NotIdentifiableError
from tests.helpers.survival_data import PLACEBO, TREATED, random_sample

DEAD = (np.arange(1, 11) * 20.0, np.ones(10, dtype=bool))
ALIVE = (np.full(10, 240.0), np.zeros(10, dtype=bool))


def test_published_rank_tests() -> None:
    log_rank = rank_test([TREATED, PLACEBO])
    assert log_rank.statistic == pytest.approx(16.79294, abs=5e-6)
    assert log_rank.p_value == pytest.approx(4.1688e-5, abs=5e-10)
    assert log_rank.observed[0] == 9
    assert log_rank.expected[0] == pytest.approx(19.25, abs=5e-3)
    for test, value in ((GEHAN, 13.4579), (TARONE_WARE, 15.1236), (PETO, 14.0841)):
        assert rank_test([TREATED, PLACEBO], test).statistic == pytest.approx(value, abs=5e-5)


def test_all_against_none() -> None:
    assert rank_test([DEAD, ALIVE]).p_value == pytest.approx(2.97e-6, abs=5e-9)
    exact = permutation_test(DEAD, ALIVE)
    assert exact.test == EXACT_PERMUTATION
    assert exact.p_value == pytest.approx(2 / 184756, rel=1e-12)


@given(st.tuples(*[st.integers(0, 200)] * 4).filter(lambda t: t[0] + t[1] and t[2] + t[3] and t[0] + t[2]))
def test_fisher_of_any_table_is_that_of_scipy(counts: tuple[int, int, int, int]) -> None:
    dead_a, alive_a, dead_b, alive_b = counts
    groups = [
        (np.repeat([10.0, 240.0], [dead, alive]), np.repeat([True, False], [dead, alive]))
        for dead, alive in ((dead_a, alive_a), (dead_b, alive_b))
    ]
    found = fisher_test(groups[0], groups[1], 240)
    expected = stats.fisher_exact([[dead_a, alive_a], [dead_b, alive_b]])
    assert found.p_value == pytest.approx(expected.pvalue, rel=1e-7, abs=1e-200)


def test_fisher() -> None:
    half = (np.r_[np.full(5, 100.0), np.full(5, 240.0)], np.r_[np.ones(5), np.zeros(5)])
    assert fisher_test(ALIVE, half, 240).p_value == pytest.approx(0.0325, abs=5e-5)
    early = (np.r_[50.0, np.full(9, 240.0)], np.zeros(10))
    assert fisher_test(early, half, 240).warnings == ("1 censored before 240 s left out",)
    with pytest.raises(NotIdentifiableError):
        fisher_test(ALIVE, ALIVE, 240)


@given(st.integers(2, 5), st.integers(2, 5), st.integers(0, 10_000))
def test_exact_permutation_against_brute_force(n_a: int, n_b: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    time = rng.integers(1, 8, n_a + n_b).astype(float)
    failed = rng.random(n_a + n_b) < 0.7
    failed[0] = True
    scores = log_rank_scores(time, failed)
    assert scores.sum() == pytest.approx(0, abs=1e-12)
    sums = np.array([scores[list(chosen)].sum() for chosen in combinations(range(n_a + n_b), n_a)])
    observed = abs(scores[:n_a].sum())
    p_value = np.mean(np.abs(sums) >= observed - 1e-9)
    found = permutation_test((time[:n_a], failed[:n_a]), (time[n_a:], failed[n_a:]))
    assert found.p_value == pytest.approx(p_value, abs=1e-12)


def test_scores_are_observed_less_expected() -> None:
    scores = log_rank_scores(np.r_[TREATED[0], PLACEBO[0]], np.r_[TREATED[1], PLACEBO[1]])
    result = rank_test([TREATED, PLACEBO])
    assert scores[:21].sum() == pytest.approx(result.observed[0] - result.expected[0], abs=1e-12)


@pytest.mark.slow
def test_simulated_permutation_agrees_with_the_exact_one() -> None:
    rng = np.random.default_rng(seed=4)
    a = (rng.exponential(1.0, 22), np.ones(22, dtype=bool))
    b = (rng.exponential(1.6, 22), np.ones(22, dtype=bool))
    exact = permutation_test(a, b)
    assert exact.test == EXACT_PERMUTATION
    extra = (np.r_[b[0], 50.0, 50.0], np.r_[b[1], False, False])
    simulated = permutation_test(a, extra)
    assert simulated.test == SIMULATED_PERMUTATION
    assert simulated == permutation_test(a, extra)
    assert simulated.p_value == pytest.approx(rank_test([a, extra]).p_value, rel=0.5)
    many = (np.full(3000, 100.0), np.arange(3000) < 6)
    few = (np.full(3000, 100.0), np.arange(3000) < 20)
    tied = permutation_test(many, few)
    assert tied.p_value == pytest.approx(stats.fisher_exact([[6, 2994], [20, 2980]]).pvalue, rel=0.1)


def test_unequal_watching_is_named() -> None:
    shorter = (np.full(10, 120.0), np.zeros(10, dtype=bool))
    assert permutation_test(DEAD, shorter).warnings == ()
    mixed = (np.r_[30.0, np.full(9, 240.0)], np.r_[True, np.zeros(9, dtype=bool)])
    assert "watched for 240 and 120 s" in permutation_test(mixed, shorter).warnings[0]


def test_nobody_failed_is_no_test() -> None:
    with pytest.raises(NotIdentifiableError, match="nobody failed"):
        rank_test([ALIVE, ALIVE])
    rows = compare("a", ALIVE, "b", ALIVE, 7.5, 240)
    assert [row.test for row in rows] == [NO_TEST]
    assert np.isnan(rows[0].p_value)
    assert rows[0].warnings == ("nobody failed in either group: no test",)


def test_log_rank_against_scipy() -> None:
    rng = np.random.default_rng(seed=6)
    worst = 0.0
    for _ in range(1000):
        a, b = random_sample(rng), random_sample(rng)
        if not (a[1].any() and b[1].any()):
            continue
        theirs = stats.logrank(*(stats.CensoredData(uncensored=t[d], right=t[~d]) for t, d in (a, b)))
        if not np.isfinite(theirs.statistic):
            continue
        worst = max(worst, abs(rank_test([a, b]).p_value - theirs.pvalue))
    assert worst < 1e-10


def test_against_lifelines() -> None:
    pytest.importorskip("lifelines", reason="lifelines is in the environment of peers only")
    import pandas as pd
    from lifelines import CoxPHFitter
    from lifelines.statistics import logrank_test, multivariate_logrank_test

    rng = np.random.default_rng(seed=7)
    names = {LOG_RANK: None, GEHAN: "wilcoxon", TARONE_WARE: "tarone-ware", PETO: "peto"}
    for _ in range(100):
        a, b, c = (random_sample(rng) for _ in range(3))
        if not all(group[1].sum() > 1 for group in (a, b, c)):
            continue
        for test, weighting in names.items():
            theirs = logrank_test(a[0], b[0], a[1], b[1], weightings=weighting).test_statistic
            assert rank_test([a, b], test).statistic == pytest.approx(theirs, rel=1e-9, abs=1e-10)
        labels = np.repeat([0, 1, 2], [a[0].size, b[0].size, c[0].size])
        time, failed = np.concatenate([a[0], b[0], c[0]]), np.concatenate([a[1], b[1], c[1]])
        theirs = multivariate_logrank_test(time, labels, failed).test_statistic
        assert rank_test([a, b, c]).statistic == pytest.approx(theirs, rel=1e-9)
    frame = pd.DataFrame(
        {
            "t": np.r_[TREATED[0], PLACEBO[0]],
            "d": np.r_[TREATED[1], PLACEBO[1]].astype(int),
            "x": np.repeat([0, 1], 21),
        }
    )
    theirs = CoxPHFitter().fit(frame, "t", "d")
    own = hazard_ratio(TREATED, PLACEBO)
    assert own.ratio.value == pytest.approx(float(np.exp(theirs.params_["x"])), rel=1e-6)
    assert own.likelihood_ratio == pytest.approx(theirs.log_likelihood_ratio_test().test_statistic, rel=1e-9)


def test_hazard_ratio() -> None:
    found = hazard_ratio(TREATED, PLACEBO)
    assert found.ratio.value == pytest.approx(4.817, abs=5e-4)  # Efron's ties, exp(1.5721)
    assert found.ratio.lower < found.ratio.value < found.ratio.upper
    swapped = hazard_ratio(PLACEBO, TREATED)
    assert swapped.ratio.value == pytest.approx(1 / found.ratio.value, rel=1e-9)
    assert swapped.ratio.upper == pytest.approx(1 / found.ratio.lower, rel=1e-6)
    one_sided = hazard_ratio(DEAD, ALIVE)
    assert np.isnan(one_sided.ratio.value)
    assert np.isnan(one_sided.ratio.lower)
    assert 0 < one_sided.ratio.upper < 0.2
    assert "the ratio is 0" in one_sided.warnings[0]
    with pytest.raises(NotIdentifiableError):
        hazard_ratio(ALIVE, ALIVE)


@pytest.mark.study
def test_hazard_ratio_interval_holds_its_level() -> None:
    rng = np.random.default_rng(seed=8)
    held = 0
    for _ in range(400):
        a, b = rng.exponential(1.0, 15), rng.exponential(1 / 2.5, 15)
        found = hazard_ratio((np.minimum(a, 1.5), a <= 1.5), (np.minimum(b, 1.5), b <= 1.5))
        held += not found.ratio.lower > 2.5 and not found.ratio.upper < 2.5
    assert 0.92 <= held / 400 <= 0.985


def test_restricted_mean_difference() -> None:
    gain, p_value = restricted_mean_difference(PLACEBO, TREATED, 23)
    assert gain.value == pytest.approx(17.9092 - 8.6667, abs=1e-4)
    assert gain.lower < gain.value < gain.upper
    assert p_value < 0.001
    uncensored = (np.array([1.0, 2, 3, 4, 9]), np.ones(5)), (np.array([2.0, 5, 6, 7, 11]), np.ones(5))
    gain, p_value = restricted_mean_difference(*uncensored, 20.0)
    welch = stats.ttest_ind(uncensored[1][0], uncensored[0][0], equal_var=False)
    assert p_value == pytest.approx(welch.pvalue, rel=1e-9)
    assert gain.lower == pytest.approx(welch.confidence_interval().low, rel=1e-9)
    gain, p_value = restricted_mean_difference(DEAD, ALIVE, 240)
    assert gain.value == pytest.approx(240 - 110)
    assert gain.lower < gain.value
    assert np.isnan(p_value)


def test_holm() -> None:
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03]), [0.03, 0.06, 0.06])
    np.testing.assert_allclose(holm([0.5, np.nan, 0.9]), [1.0, np.nan, 1.0])


def test_holm_counts_pairs_at_one_voltage_only() -> None:
    pairs = [
        *compare("a", DEAD, "b", ALIVE, 7.5, 240),
        *compare("a", DEAD, "c", ALIVE, 7.5, 240),
        *compare("a", DEAD, "b", ALIVE, 9.0, 240),
    ]
    rows = [row for row in corrected(pairs) if row.test == LOG_RANK]
    assert [row.p_value_holm / row.p_value for row in rows] == pytest.approx([2, 2, 1])


def test_few_expected_failures_point_to_the_permutation_test() -> None:
    rows = {row.test: row for row in compare("a", DEAD, "b", ALIVE, 7.5, 240)}
    assert any("use the permutation test" in text for text in rows[LOG_RANK].warnings)
    assert rows[EXACT_PERMUTATION].p_value > 3.5 * rows[LOG_RANK].p_value
