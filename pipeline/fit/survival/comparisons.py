"""Two configurations at one voltage, compared in every way that the data carry.

Belongs here: the list of comparisons of a pair, the difference of restricted means, Holm's correction over the pairs.
The tests themselves are in `survival_tests` and `hazard_ratio`.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import special

from pipeline.fit.survival.hazard_ratio import hazard_ratio
from pipeline.fit.survival.kaplan_meier import LEVEL, Estimate, kaplan_meier
from pipeline.fit.survival.tests import (
    EXACT_PERMUTATION,
    FISHER,
    GEHAN,
    LOG_RANK,
    PETO,
    SIMULATED_PERMUTATION,
    TARONE_WARE,
    TestResult,
    fisher_test,
    holm,
    permutation_test,
    rank_test,
)
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError

HAZARD_RATIO = "hazard ratio (cox)"
RESTRICTED_MEAN = "restricted mean difference"
NO_TEST = "none"
_LARGEST_PERMUTED = 2000
_SMALLEST_EXPECTED = 5.0
_PERMUTATIONS = (EXACT_PERMUTATION, SIMULATED_PERMUTATION)

Group = tuple[Float, Bool]
"""(times in s, failure flags) of one group."""


@dataclass(frozen=True)
class Comparison:
    """One test or estimate between two configurations of a campaign at one voltage.

    `statistic` is what `test` says: χ² of the rank tests, O − E of the permutation test, odds ratio of Fisher's test,
    hazard of b over that of a, restricted mean of b less that of a in s; the last two come with 95 % `lower` and `upper`.
    `p_value` is that of this pair, `p_value_holm` corrected for all pairs of the campaign at the same voltage with the same test.
    """

    configuration_a: str | None
    configuration_b: str | None
    voltage_kv: float | None
    test: str
    statistic: float = float("nan")
    lower: float = float("nan")
    upper: float = float("nan")
    p_value: float = float("nan")
    p_value_holm: float = float("nan")
    warnings: tuple[str, ...] = ()
    campaign: str | None = None


def compare(
    configuration_a: str | None,
    a: Group,
    configuration_b: str | None,
    b: Group,
    voltage_kv: float | None,
    within_s: float,
) -> list[Comparison]:
    """All comparisons of two groups, each (times in s, failure flags), up to the common follow-up `within_s`.

    When nobody failed in either group there is no test: one row says so. What single tests cannot do is left out, its
    reason goes with the log-rank row.
    """
    base = Comparison(configuration_a, configuration_b, voltage_kv, NO_TEST)
    if not (a[1].any() or b[1].any()):
        return [replace(base, warnings=("nobody failed in either group: no test",))]
    rows: list[Comparison] = []
    refused: list[str] = []
    for name, outcome in _OUTCOMES:
        try:
            rows.append(replace(base, **outcome(a, b, within_s)))
        except NotIdentifiableError as error:
            refused.append(f"{name}: {error.problem}")
    if refused and rows:
        rows[0] = replace(rows[0], warnings=(*rows[0].warnings, *refused))
    return rows or [replace(base, warnings=tuple(refused))]


def _ranked(test: str, a: Group, b: Group) -> dict[str, Any]:
    result = rank_test([a, b], test)
    warnings = result.warnings
    if min(result.expected) < _SMALLEST_EXPECTED:
        warnings += (
            f"{min(result.expected):.2g} failures expected in one group: the asymptotic p-value is too small, use the "
            "permutation test",
        )
    return _shown(replace(result, warnings=warnings))


def _permuted(a: Group, b: Group, within_s: float) -> dict[str, Any]:
    if a[0].size + b[0].size > _LARGEST_PERMUTED:
        raise NotIdentifiableError(f"more than {_LARGEST_PERMUTED} specimens, the asymptotic test is enough")
    return _shown(permutation_test(a, b))


def _proportional(a: Group, b: Group, within_s: float) -> dict[str, Any]:
    result = hazard_ratio(a, b)
    return _shown(TestResult(HAZARD_RATIO, result.ratio.value, result.p_value, warnings=result.warnings)) | {
        "lower": result.ratio.lower,
        "upper": result.ratio.upper,
    }


def _gained(a: Group, b: Group, within_s: float) -> dict[str, Any]:
    gain, p_value = restricted_mean_difference(a, b, within_s)
    warnings = ("fewer than two failures in a group: a cautious interval, no p-value",) if np.isnan(p_value) else ()
    result = TestResult(RESTRICTED_MEAN, gain.value, p_value, warnings=warnings)
    return _shown(result) | {"lower": gain.lower, "upper": gain.upper}


def _shown(result: TestResult) -> dict[str, Any]:
    return {
        "test": result.test,
        "statistic": result.statistic,
        "p_value": result.p_value,
        "warnings": result.warnings,
    }


_OUTCOMES: tuple[tuple[str, Callable[[Group, Group, float], dict[str, Any]]], ...] = (
    *((test, lambda a, b, _, test=test: _ranked(test, a, b)) for test in (LOG_RANK, GEHAN, TARONE_WARE, PETO)),
    ("permutation", _permuted),
    (FISHER, lambda a, b, within_s: _shown(fisher_test(a, b, within_s))),
    (HAZARD_RATIO, _proportional),
    (RESTRICTED_MEAN, _gained),
)


def restricted_mean_difference(a: Group, b: Group, to_s: float) -> tuple[Estimate, float]:
    """Restricted mean life of `b` less that of `a` up to `to_s`, in s, with 95 % limits and a two-sided p-value.

    Welch's t: the variances of both groups, degrees of freedom by Satterthwaite from the failures of each. A group with
    fewer than two failures has no variance of its own: its interval ends are combined with the other's instead, and
    there is no p-value. Raises `NotIdentifiableError` where a curve is not known up to `to_s`.
    """
    curves = [kaplan_meier(*group) for group in (a, b)]
    means = [curve.restricted_mean(to_s) for curve in curves]
    difference = means[1].value - means[0].value
    variances = np.array([curve.restricted_variance(to_s) for curve in curves])
    failures = np.array([int(curve.failures[curve.time <= to_s].sum()) for curve in curves])
    if np.isnan(variances).any() or variances.sum() == 0:
        below = np.hypot(means[1].value - means[1].lower, means[0].upper - means[0].value)
        above = np.hypot(means[1].upper - means[1].value, means[0].value - means[0].lower)
        return Estimate(difference, float(difference - below), float(difference + above)), float("nan")
    error = float(np.sqrt(variances.sum()))
    freedom = float(variances.sum() ** 2 / (variances**2 / (failures - 1)).sum())
    half = float(special.stdtrit(freedom, 0.5 + LEVEL / 2)) * error
    p_value = 2 * float(special.stdtr(freedom, -abs(difference) / error))
    return Estimate(difference, difference - half, difference + half), p_value


def corrected(comparisons: Sequence[Comparison]) -> tuple[Comparison, ...]:
    """The same comparisons with Holm's correction over the pairs of a campaign at one voltage, test by test.

    Exact and simulated permutation tests are one family.
    """
    families: dict[tuple[str | None, float | None, str], list[int]] = defaultdict(list)
    for i, comparison in enumerate(comparisons):
        family = "permutation" if comparison.test in _PERMUTATIONS else comparison.test
        families[comparison.campaign, comparison.voltage_kv, family].append(i)
    result = list(comparisons)
    for members in families.values():
        for i, p_value in zip(members, holm([comparisons[i].p_value for i in members]), strict=True):
            result[i] = replace(result[i], p_value_holm=float(p_value))
    return tuple(result)
