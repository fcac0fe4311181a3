"""Tests between two groups of right-censored lifetimes: log-rank and its weighted relatives, permutation, Fisher, Holm.

The exact permutation distribution of the log-rank statistic is used wherever it can be had: in small groups the
asymptotic p-value is several times too small. Hazard ratios are in `hazard_ratio`, curves in `survival`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pipeline.fit.survival.kaplan_meier import check_lifetimes
from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError

LOG_RANK, GEHAN, TARONE_WARE, PETO = "log-rank", "gehan", "tarone-ware", "peto"
EXACT_PERMUTATION, SIMULATED_PERMUTATION = "log-rank, exact permutation", "log-rank, simulated permutation"
FISHER = "fisher exact"
_LARGEST_EXACT = 44
"""Specimens in both groups together up to which every relabelling is counted (half the sample has 2²² subsets)."""
_SIMULATIONS = 200_000
_CHUNK = 2_000_000
_SEED = 20_240_229
_TIE = 1e-9
"""Two statistics closer than this share of the largest are equal but for rounding."""


@dataclass(frozen=True)
class TestResult:
    """A named test between groups: `statistic`, `degrees_of_freedom`, two-sided `p_value`, and what limits it."""

    __test__ = False

    test: str
    statistic: float
    p_value: float
    degrees_of_freedom: int = 1
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class RankTest(TestResult):
    """A (weighted) log-rank test with the `observed` and `expected` failures of each group under equal hazards."""

    __test__ = False

    observed: tuple[float, ...] = ()
    expected: tuple[float, ...] = ()


@dataclass(frozen=True)
class _Pooled:
    """Counts at the m distinct failure times of all g groups together."""

    time: Float
    at_risk: Float
    failures: Float
    group_at_risk: Float
    group_failures: Float


def _pooled(groups: Sequence[tuple[ArrayLike, ArrayLike]]) -> _Pooled:
    checked = [check_lifetimes(*group) for group in groups]
    times = np.unique(np.concatenate([t[d] for t, d in checked]))
    if times.size == 0:
        raise NotIdentifiableError("nobody failed in any of the groups: there is nothing to compare")
    at_risk = np.array([t.size - np.searchsorted(np.sort(t), times, side="left") for t, _ in checked], dtype=float)
    failures = np.array([_count(np.sort(t[d]), times) for t, d in checked], dtype=float)
    return _Pooled(times, at_risk.sum(axis=0), failures.sum(axis=0), at_risk, failures)


def _count(ascending: Float, times: Float) -> Int:
    found = np.searchsorted(ascending, times, side="right") - np.searchsorted(ascending, times, side="left")
    return np.asarray(found, dtype=np.int64)


def _weights(test: str, pooled: _Pooled) -> Float:
    if test == LOG_RANK:
        return np.ones_like(pooled.time)
    if test == GEHAN:
        return pooled.at_risk
    if test == TARONE_WARE:
        return np.asarray(np.sqrt(pooled.at_risk))
    if test == PETO:
        return np.asarray(np.cumprod(1 - pooled.failures / (pooled.at_risk + 1)))
    raise ValueError(f"test {test!r} is not one of {LOG_RANK}, {GEHAN}, {TARONE_WARE}, {PETO}")


def rank_test(groups: Sequence[tuple[ArrayLike, ArrayLike]], test: str = LOG_RANK) -> RankTest:
    """Weighted log-rank test between two or more groups, each (times in s, failure flags).

    U = Σ w (d_g − d n_g/n) over the failure times with its hypergeometric variance; χ² with one degree of freedom less
    than groups. Weights w: 1 (log-rank), n (Gehan), √n (Tarone–Ware), Π (1 − d/(n + 1)) (Peto).

    Raises `NotIdentifiableError` when nobody failed, or no two groups were ever at risk together at a failure.
    """
    pooled = _pooled(groups)
    w, n, d = _weights(test, pooled), pooled.at_risk, pooled.failures
    expected = pooled.group_at_risk * d / n
    difference = ((pooled.group_failures - expected) * w).sum(axis=1)
    spread = np.divide(d * (n - d), n - 1, out=np.zeros_like(n), where=n > 1) * w**2
    share = pooled.group_at_risk / n
    covariance = np.diag((share * spread).sum(axis=1)) - (share * spread) @ share.T
    freedom = len(groups) - 1
    kept = covariance[:freedom, :freedom]
    if np.linalg.matrix_rank(kept) < freedom:
        raise NotIdentifiableError("the groups were never under observation together at a failure time")
    statistic = float(difference[:freedom] @ np.linalg.solve(kept, difference[:freedom]))
    return RankTest(
        test,
        statistic,
        float(special.chdtrc(freedom, statistic)),
        freedom,
        observed=tuple(pooled.group_failures.sum(axis=1).tolist()),
        expected=tuple(expected.sum(axis=1).tolist()),
    )


def log_rank_scores(time: ArrayLike, failed: ArrayLike) -> Float:
    """(n,) score of each specimen, failure flag − Σ d/n over the failure times up to its own.

    The scores add up to 0, and the observed less the expected failures of a group are the sum of its members' scores.
    """
    t, flags = check_lifetimes(time, failed)
    pooled = _pooled([(t, flags)])
    hazard = np.concatenate(([0.0], np.cumsum(pooled.failures / pooled.at_risk)))
    return flags - hazard[np.searchsorted(pooled.time, t, side="right")]


def permutation_test(a: tuple[ArrayLike, ArrayLike], b: tuple[ArrayLike, ArrayLike]) -> TestResult:
    """Permutation test of the log-rank difference |O − E| between two groups, each (times in s, failure flags).

    Up to 44 specimens together every relabelling is counted: the subsets of both halves of the pooled sample are listed
    by size, and pairs of subsets whose scores add up to at least the observed difference are counted by sorting. Above
    that, 2·10⁵ random relabellings with a fixed seed, p = (1 + hits)/(1 + relabellings). `statistic` is O − E of the
    first group. The censoring must come from the same test plan in both groups; when it does not, a warning says so.

    Raises `NotIdentifiableError` when nobody failed.
    """
    (t_a, d_a), (t_b, d_b) = check_lifetimes(*a), check_lifetimes(*b)
    scores = log_rank_scores(np.concatenate((t_a, t_b)), np.concatenate((d_a, d_b)))
    observed = float(scores[: t_a.size].sum())
    limit = abs(observed) - _TIE * float(np.abs(scores).sum())
    warnings = _censoring_warning(t_a, d_a, t_b, d_b)
    if scores.size <= _LARGEST_EXACT:
        hits = _subsets_beyond(scores, t_a.size, limit)
        return TestResult(
            EXACT_PERMUTATION,
            observed,
            hits / float(special.comb(scores.size, t_a.size, exact=True)),
            warnings=warnings,
        )
    hits = _relabellings_beyond(scores, min(t_a.size, t_b.size), limit)
    return TestResult(SIMULATED_PERMUTATION, observed, (1 + hits) / (1 + _SIMULATIONS), warnings=warnings)


def _relabellings_beyond(scores: Float, size: int, limit: float) -> int:
    """Random subsets of `size` scores, of 2·10⁵, whose sum is at least `limit` in magnitude.

    Specimens with one score are alike, so only their numbers are drawn where that is less work.
    """
    rng = np.random.default_rng(_SEED)
    values, counts = np.unique(scores, return_counts=True)
    hits, rows = 0, max(1, _CHUNK // scores.size)
    for begin in range(0, _SIMULATIONS, rows):
        batch = min(rows, _SIMULATIONS - begin)
        if values.size < scores.size / 10:
            sums = rng.multivariate_hypergeometric(counts, size, size=batch, method="marginals") @ values
        else:
            sums = rng.permuted(np.broadcast_to(scores, (batch, scores.size)), axis=1)[:, :size].sum(axis=1)
        hits += int(np.count_nonzero(np.abs(sums) >= limit))
    return hits


def _subsets_beyond(scores: Float, size: int, limit: float) -> int:
    """Number of subsets of `size` scores whose sum is at least `limit` in magnitude."""
    if limit <= 0:
        return int(special.comb(scores.size, size, exact=True))
    half = scores.size // 2
    left, right = _sums_by_size(scores[:half]), _sums_by_size(scores[half:])
    hits = 0
    for taken, sums in left.items():
        others = right.get(size - taken)
        if others is not None:
            hits += int((others.size - np.searchsorted(others, limit - sums, side="left")).sum())
            hits += int(np.searchsorted(others, -limit - sums, side="right").sum())
    return hits


def _sums_by_size(scores: Float) -> dict[int, Float]:
    """All subset sums, ascending, by the size of the subset."""
    sums, sizes = np.zeros(1), np.zeros(1, dtype=np.int8)
    for score in scores:
        sums, sizes = np.concatenate((sums, sums + score)), np.concatenate((sizes, sizes + np.int8(1)))
    return {k: np.sort(sums[sizes == k]) for k in range(scores.size + 1)}


def _censoring_warning(t_a: Float, d_a: Bool, t_b: Float, d_b: Bool) -> tuple[str, ...]:
    ends = [float(t[~d].max()) for t, d in ((t_a, d_a), (t_b, d_b)) if (~d).any()]
    if len(ends) == 2 and abs(ends[0] - ends[1]) > 0.01 * max(ends) + 0.5:
        return (
            f"the groups were watched for {ends[0]:g} and {ends[1]:g} s: a permutation test takes equal watching for granted",
        )
    return ()


def fisher_test(a: tuple[ArrayLike, ArrayLike], b: tuple[ArrayLike, ArrayLike], within_s: float) -> TestResult:
    """Fisher's exact test on "failed within `within_s`" for two groups. `statistic` is the sample odds ratio.

    Specimens censored before `within_s` cannot be counted: they are left out, and a warning says how many. Raises
    `NotIdentifiableError` when a group has nobody left or nobody failed within the time.
    """
    table, lost = [], 0
    for group in (a, b):
        t, d = check_lifetimes(*group)
        dead, known = d & (t <= within_s), (d & (t <= within_s)) | (t >= within_s)
        lost += int((~known).sum())
        table.append((int(dead.sum()), int(known.sum() - dead.sum())))
    if min(sum(row) for row in table) == 0 or table[0][0] + table[1][0] == 0:
        raise NotIdentifiableError(f"no counts to compare of failures within {within_s:g} s")
    p_value = _as_rare(table)
    (failed_a, alive_a), (failed_b, alive_b) = table
    below = alive_a * failed_b
    odds = failed_a * alive_b / below if below else (float("inf") if failed_a * alive_b else float("nan"))
    warnings = (f"{lost} censored before {within_s:g} s left out",) if lost else ()
    return TestResult(FISHER, odds, p_value, warnings=warnings)


def _as_rare(table: Sequence[tuple[int, int]]) -> float:
    """Probability of the tables with the sums of this one that are no more probable than it (Fisher 1935, two-sided)."""
    (a, b), (c, d) = table
    first, second, failed = a + b, c + d, a + c
    k = np.arange(max(0, failed - second), min(failed, first) + 1, dtype=np.float64)

    def log_choose(n: int, of: Float) -> Float:
        return np.asarray(special.gammaln(n + 1) - special.gammaln(of + 1) - special.gammaln(n - of + 1))

    log_probability = log_choose(first, k) + log_choose(second, failed - k)
    log_probability = log_probability - special.logsumexp(log_probability)
    as_rare = log_probability <= log_probability[a - int(k[0])] + _TIE
    return float(min(np.exp(log_probability[as_rare]).sum(), 1.0))


def holm(p_values: ArrayLike) -> Float:
    """(n,) p-values corrected for n tests by Holm's step-down method; NaN stays NaN and does not count."""
    p = np.asarray(p_values, dtype=np.float64)
    corrected = np.full(p.shape, np.nan)
    known = np.flatnonzero(~np.isnan(p))
    order = known[np.argsort(p[known], kind="stable")]
    factors = order.size - np.arange(order.size)
    corrected[order] = np.minimum(np.maximum.accumulate(p[order] * factors), 1.0)
    return corrected
