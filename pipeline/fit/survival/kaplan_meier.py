"""Kaplan–Meier survival of one group of right-censored lifetimes, and the numbers read off its curve.

Belongs here: the curve with its log–log band, at-risk counts, median, restricted mean, survival at a time, the exact
limits where nobody or everybody failed. Does not belong here: tests between groups (`survival_tests`), parametric
distributions (`lifetime_distributions`), causes (`competing_causes`), grouping of specimens (`survival_groups`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError, RefusedError

LEVEL = 0.95
"""Confidence of every interval of the survival analysis."""
Z = float(special.ndtri(0.5 + LEVEL / 2))
_ROUNDING = 1e-12
"""Products of fractions that should be exactly 1/2 miss it by rounding; the median must not depend on that."""


@dataclass(frozen=True)
class Estimate:
    """A value with its two-sided 95 % limits; NaN where the data do not give one."""

    value: float
    lower: float = float("nan")
    upper: float = float("nan")


UNKNOWN = Estimate(float("nan"))


def check_lifetimes(time: ArrayLike, failed: ArrayLike) -> tuple[Float, Bool]:
    """(n,) times in s and (n,) flags, checked: finite, not negative, true or false, n ≥ 1.

    Raises `RefusedError` that names the first offending row.
    """
    t = np.asarray(time, dtype=np.float64)
    flags = np.asarray(failed)
    if t.ndim != 1 or t.shape != flags.shape:
        raise RefusedError(
            f"lifetimes have shape {t.shape}, flags {flags.shape}", expected="one flag for each lifetime"
        )
    if t.size == 0:
        raise RefusedError("no lifetimes", expected="at least one specimen")
    wrong = ~(np.isfinite(t) & (t >= 0))
    if wrong.any():
        row = int(np.argmax(wrong))
        raise RefusedError(f"lifetime {t[row]:g} s", where=f"row {row}", expected="a finite time not below 0")
    if flags.dtype != np.bool_:
        odd = np.asarray((flags != 0) & (flags != 1))
        if odd.any():
            row = int(np.argmax(odd))
            raise RefusedError(
                f"failure flag {flags[row]}", where=f"row {row}", expected="1 for a failure, 0 for a survivor"
            )
    return t, flags.astype(np.bool_)


def exact_lower_survival(n: int) -> float:
    """Lower limit of the survival probability when none of `n` specimens failed: two-sided exact, 0.025^{1/n}."""
    return float(((1 - LEVEL) / 2) ** (1 / n))


def exact_upper_survival(n: int) -> float:
    """Upper limit of the survival probability when all of `n` specimens failed: two-sided exact."""
    return 1 - exact_lower_survival(n)


@dataclass(frozen=True)
class KaplanMeier:
    """Kaplan–Meier curve S(t) = Π (1 − d/n) at the m distinct times of a group.

    Parameters
    ----------
    time : (m,) s, ascending, every time at which somebody failed or was censored
    at_risk : (m,) specimens under observation just before
    failures, censored : (m,) at that time; failures come first
    survival : (m,) probability to live longer than `time`
    log_variance : (m,) Greenwood's Σ d/[n (n − d)], the variance of ln S; infinite where S = 0
    lower, upper : (m,) log–log 95 % band, S^{exp(±z √v/|ln S|)}; NaN where S is 1 or 0, it is not defined there
    """

    time: Float
    at_risk: Int
    failures: Int
    censored: Int
    survival: Float
    log_variance: Float
    lower: Float
    upper: Float

    @property
    def specimens(self) -> int:
        return int(self.at_risk[0])

    @property
    def failed(self) -> int:
        return int(self.failures.sum())

    @property
    def standard_error(self) -> Float:
        """(m,) standard error of S, S √v; 0 where S = 0."""
        return self.survival * np.sqrt(np.where(self.survival > 0, self.log_variance, 0.0))

    def number_at_risk(self, times: ArrayLike) -> Int:
        """Specimens still under observation just before each of `times` in s (the at-risk table under a figure)."""
        counts = np.append(self.at_risk, self.at_risk[-1] - self.failures[-1] - self.censored[-1])
        return np.asarray(counts[np.searchsorted(self.time, np.asarray(times, dtype=np.float64), side="left")])

    def survival_at(self, times: ArrayLike) -> Float:
        """S at `times` in s; NaN beyond the last observation when somebody was still alive there."""
        t = np.asarray(times, dtype=np.float64)
        steps = np.concatenate(([1.0], self.survival))
        values = steps[np.searchsorted(self.time, t, side="right")]
        return np.where((t > self.time[-1]) & (self.survival[-1] > 0), np.nan, values)

    def at(self, time: float) -> Estimate:
        """S at one time in s with its 95 % limits.

        Log–log where 0 < S < 1. Where nobody has failed yet the exact limit for the specimens still observed at that
        time, where all have failed the exact limit for the failures: an estimate of 1 or 0 is never given as certain.
        """
        survival = float(self.survival_at(time))
        if np.isnan(survival):
            return UNKNOWN
        if survival == 1.0:
            return Estimate(1.0, exact_lower_survival(max(int(self.number_at_risk(time)), 1)), 1.0)
        if survival == 0.0:
            return Estimate(0.0, 0.0, exact_upper_survival(self.failed))
        row = int(np.searchsorted(self.time, time, side="right")) - 1
        return Estimate(survival, float(self.lower[row]), float(self.upper[row]))

    def median(self) -> Estimate:
        """First time at which S ≤ 1/2, with the band inverted; NaN for what is not reached."""
        return self.quantile(0.5)

    def quantile(self, failed_share: float) -> Estimate:
        """First time at which S ≤ 1 − `failed_share`, with the log–log band inverted; NaN for what is not reached."""
        target = 1 - failed_share + _ROUNDING
        return Estimate(*(self._first(curve <= target) for curve in (self.survival, self.lower, self.upper)))

    def _first(self, reached: Bool) -> float:
        return float(self.time[np.argmax(reached)]) if reached.any() else float("nan")

    def restricted_mean(self, to_s: float) -> Estimate:
        """Restricted mean life ∫₀^τ S dt in s up to τ = `to_s`, with its 95 % interval.

        Variance Σ (∫_{t_j}^τ S)² d_j/[n_j (n_j − d_j)] times m/(m − 1), m the failures up to τ: without censoring that
        is the unbiased variance of a mean. The interval is symmetric in ln[x/(τ − x)] with Student's t of m − 1
        degrees of freedom: it stays inside (0, τ) and holds its level in small groups. With no or one failure by τ there
        is no variance; as S only falls, τ times the lower limit of S(τ) is then a lower limit of the mean.

        Raises `NotIdentifiableError` when the curve is not known up to τ.
        """
        if not to_s > 0 or np.isnan(self.survival_at(to_s)):
            raise NotIdentifiableError(
                f"restricted mean to {to_s:g} s, but the observation ends at {self.time[-1]:g} s with survivors",
                expected=f"a time above 0 and up to {self.time[-1]:g} s",
            )
        mean, variance, failures = self._restricted_moments(to_s)
        if failures < 2 or not mean < to_s:
            return Estimate(mean, to_s * self.at(to_s).lower, to_s)
        half = float(special.stdtrit(failures - 1, 0.5 + LEVEL / 2)) * np.sqrt(variance) * to_s / (mean * (to_s - mean))
        centre = np.log(mean / (to_s - mean))
        lower, upper = (float(to_s * special.expit(centre + side * half)) for side in (-1, 1))
        return Estimate(mean, lower, upper)

    def restricted_variance(self, to_s: float) -> float:
        """Variance in s² of the restricted mean up to `to_s`; NaN with fewer than two failures up to there."""
        return self._restricted_moments(to_s)[1]

    def _restricted_moments(self, to_s: float) -> tuple[float, float, int]:
        inside = self.time <= to_s
        knots = np.concatenate(([0.0], self.time[inside], [to_s]))
        areas = np.concatenate(([1.0], self.survival[inside])) * np.diff(knots)
        mean = float(areas.sum())
        d, n = self.failures[inside].astype(np.float64), self.at_risk[inside].astype(np.float64)
        remaining = np.cumsum(areas[::-1])[::-1][1:]
        counted = (d > 0) & (n > d)
        failures = int(d.sum())
        if failures < 2:
            return mean, float("nan"), failures
        terms = remaining[counted] ** 2 * d[counted] / (n[counted] * (n[counted] - d[counted]))
        return mean, float(terms.sum()) * failures / (failures - 1), failures


def kaplan_meier(time: ArrayLike, failed: ArrayLike) -> KaplanMeier:
    """Kaplan–Meier curve of right-censored lifetimes.

    Parameters
    ----------
    time : (n,) s, time to failure or time survived, not below 0
    failed : (n,) true for a failure, false for a survivor; ties: failures before censorings

    Raises `RefusedError` for negative or non-finite times, flags that are not true or false, and empty groups.
    """
    t, flags = _ascending(*check_lifetimes(time, failed))
    first = np.flatnonzero(np.concatenate(([True], t[1:] != t[:-1])))
    failures = np.add.reduceat(flags.astype(np.int64), first)
    leaving = np.diff(np.append(first, t.size))
    at_risk = t.size - first
    survival: Float = np.asarray(np.cumprod(1 - failures / at_risk), dtype=np.float64)
    staying = at_risk - failures
    terms = np.divide(failures, at_risk * staying, out=np.full(first.size, np.inf), where=staying > 0)
    terms[failures == 0] = 0.0
    log_variance = np.cumsum(terms)
    lower, upper = _log_log_band(survival, log_variance)
    return KaplanMeier(t[first], at_risk, failures, leaving - failures, survival, log_variance, lower, upper)


def _ascending(time: Float, failed: Bool) -> tuple[Float, Bool]:
    """Both sorted by time. Floats not below 0 order like their bit patterns, and the flag takes the place of the sign
    bit: one sort of integers instead of an argsort and two gathers, which is most of the work on large groups.
    """
    keys = ((time + 0.0).view(np.uint64) << np.uint64(1)) | failed
    keys.sort()
    return (keys >> np.uint64(1)).view(np.float64), (keys & np.uint64(1)).astype(np.bool_)


def _log_log_band(survival: Float, log_variance: Float) -> tuple[Float, Float]:
    lower, upper = np.full(survival.shape, np.nan), np.full(survival.shape, np.nan)
    inside = slice(int(np.count_nonzero(survival == 1)), int(np.count_nonzero(survival > 0)))
    log_survival = np.log(survival[inside])
    spread = np.sqrt(log_variance[inside])
    spread *= -Z
    spread /= log_survival
    factor = np.exp(spread, out=spread)
    np.exp(log_survival * factor, out=lower[inside])
    np.exp(np.divide(log_survival, factor, out=log_survival), out=upper[inside])
    return lower, upper
