"""Hazard ratio of two groups of right-censored lifetimes by Cox's partial likelihood (Efron's ties).

One covariate, the group, so the likelihood has one parameter and is concave. When all failures that tell anything are
in one group the ratio is 0 or infinite; the likelihood then still gives the one finite limit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pipeline.fit.survival.kaplan_meier import Estimate, check_lifetimes
from pipeline.fit.survival.profile_likelihood import LARGE_SAMPLE_DROP, profile_limits
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError

_FAR = 40.0
"""|ln ratio| that stands for infinity."""


@dataclass(frozen=True)
class HazardRatio:
    """Hazard of the second group over that of the first, with its 95 % profile-likelihood limits.

    `likelihood_ratio` is twice the gain in log partial likelihood against equal hazards, `p_value` its χ² probability.
    The ratio is NaN when it is 0 or infinite; `warnings` says which, and the finite limit is kept.
    """

    ratio: Estimate
    likelihood_ratio: float
    p_value: float
    warnings: tuple[str, ...]


def hazard_ratio(a: tuple[ArrayLike, ArrayLike], b: tuple[ArrayLike, ArrayLike]) -> HazardRatio:
    """Hazard ratio of group `b` to group `a`, each (times in s, failure flags), assumed constant in time.

    Raises `NotIdentifiableError` when nobody failed while both groups were under observation.
    """
    (t_a, d_a), (t_b, d_b) = check_lifetimes(*a), check_lifetimes(*b)
    times = np.unique(np.concatenate((t_a[d_a], t_b[d_b])))
    risk = [t.size - np.searchsorted(np.sort(t), times, side="left") for t in (t_a, t_b)]
    dead = [_ties(t[d], times) for t, d in ((t_a, d_a), (t_b, d_b))]
    both = (risk[0] > 0) & (risk[1] > 0)
    if not both.any():
        raise NotIdentifiableError("no failure while both groups were under observation: no hazard ratio")
    n_a, n_b, m_a, m_b = (values[both].astype(np.float64) for values in (*risk, *dead))
    ties = (m_a + m_b).astype(np.int64)
    step = np.concatenate([np.arange(k) / k for k in ties])
    rows = np.repeat(np.arange(ties.size), ties)
    base, other = n_a[rows] - step * m_a[rows], n_b[rows] - step * m_b[rows]
    failures_b = float(m_b.sum())

    with np.errstate(divide="ignore"):
        log_base, log_other = np.log(base), np.log(other)

    def log_likelihood(beta: Float) -> Float:
        risk = np.logaddexp(log_base, log_other + beta[:, None])
        return np.asarray(beta * failures_b - risk.sum(axis=1))

    def at(beta: float) -> float:
        return float(log_likelihood(np.array([beta]))[0])

    warnings: tuple[str, ...] = ()
    if m_a.sum() == 0 or m_b.sum() == 0:
        best = -_FAR if m_b.sum() == 0 else _FAR
        size = "0" if m_b.sum() == 0 else "infinite"
        warnings = (f"while both groups were watched only one failed: the ratio is {size}, one limit is finite",)
        inner = profile_limits(log_likelihood, best, at(best), LARGE_SAMPLE_DROP, _FAR / 10)
        limits = (float("nan"), inner[1]) if best < 0 else (inner[0], float("nan"))
        ratio = Estimate(float("nan"), *(float(np.exp(x)) for x in limits))
    else:
        best = _newton(base, other, failures_b)
        limits = profile_limits(log_likelihood, best, at(best), LARGE_SAMPLE_DROP, 0.5)
        ratio = Estimate(*(float(np.exp(x)) for x in (best, *limits)))
    gain = max(2 * (at(best) - at(0.0)), 0.0)
    return HazardRatio(ratio, gain, float(special.chdtrc(1, gain)), warnings)


def _ties(times: Float, at: Float) -> Float:
    ascending = np.sort(times)
    return np.asarray(np.searchsorted(ascending, at, "right") - np.searchsorted(ascending, at, "left"), dtype=float)


def _newton(base: Float, other: Float, failures: float) -> float:
    """Root of the score failures − Σ p, p = other e^β/(base + other e^β), which falls monotonically in β."""
    beta, low, high = 0.0, -_FAR, _FAR
    for _ in range(200):
        p = other * np.exp(beta) / (base + other * np.exp(beta))
        score = failures - float(p.sum())
        low, high = (beta, high) if score > 0 else (low, beta)
        information = float((p * (1 - p)).sum())
        proposed = beta + score / information if information > 0 else low - 1
        following = proposed if low < proposed < high else (low + high) / 2
        if abs(following - beta) <= 1e-13 * (1 + abs(beta)):
            return following
        beta = following
    return beta
