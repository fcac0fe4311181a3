"""Probability of failing by each cause when several compete: the Aalen–Johansen estimator.

One minus Kaplan–Meier of a single cause overstates its probability, as it lets specimens that failed otherwise go on
failing; it is not offered. An unknown failure site is a cause of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.fit.survival.kaplan_meier import Z, check_lifetimes
from schemas.arrays import Float, Int
from schemas.errors import RefusedError

UNKNOWN_CAUSE = "unknown"


@dataclass(frozen=True)
class CumulativeIncidence:
    """F_c(t), the probability to have failed by cause c up to t, at the m distinct times of the group.

    Parameters
    ----------
    cause : its name
    time : (m,) s
    failures : (m,) failures by this cause
    probability : (m,) F_c = Σ S(t_j−) d_cj/n_j
    standard_error : (m,) delta-method standard error
    lower, upper : (m,) log–log 95 % band, F^{exp(±z se/(F |ln F|))}; NaN where F is 0 or 1
    """

    cause: str
    time: Float
    failures: Int
    probability: Float
    standard_error: Float
    lower: Float
    upper: Float


@dataclass(frozen=True)
class CompetingCauses:
    """Curves of all causes of one group; their probabilities and `survival` (m,) add up to 1 at every time."""

    causes: tuple[CumulativeIncidence, ...]
    survival: Float


def aalen_johansen(time: ArrayLike, failed: ArrayLike, cause: Sequence[str | None]) -> CompetingCauses:
    """Cumulative incidence of each cause of failure.

    Parameters
    ----------
    time : (n,) s, time to failure or time survived
    failed : (n,) true for a failure
    cause : (n,) cause of a failure; None and "" count as `unknown`. Not looked at for survivors

    Causes come in alphabetical order. A group without failures has no causes. Raises `RefusedError` for bad lifetimes.
    """
    t, flags = check_lifetimes(time, failed)
    if len(cause) != t.size:
        raise RefusedError(f"{len(cause)} causes for {t.size} lifetimes", expected="one cause for each lifetime")
    names = np.array([name or UNKNOWN_CAUSE for name in cause], dtype=object)
    distinct, place = np.unique(t, return_inverse=True)
    m = distinct.size
    at_risk = (t.size - np.searchsorted(np.sort(t), distinct, side="left")).astype(np.float64)
    deaths = np.bincount(place, weights=flags, minlength=m).astype(np.float64)
    survival: Float = np.asarray(np.cumprod(1 - deaths / at_risk))
    before = np.concatenate(([1.0], survival[:-1]))
    curves = []
    for name in sorted(set(names[flags])):
        own = np.bincount(place, weights=flags & (names == name), minlength=m).astype(np.float64)
        probability = np.cumsum(before * own / at_risk)
        error = np.sqrt(_variance(probability, before, at_risk, deaths, own))
        lower, upper = _band(probability, error)
        curves.append(CumulativeIncidence(name, distinct, own.astype(np.int64), probability, error, lower, upper))
    return CompetingCauses(tuple(curves), survival)


def _variance(probability: Float, before: Float, at_risk: Float, deaths: Float, own: Float) -> Float:
    """Delta-method variance of F_c(t) (Marubini and Valsecchi).

    Σ (F(t) − F_j)² d/[n (n − d)] + Σ S(t_j−)² d_c (n − d_c)/n³ − 2 Σ (F(t) − F_j) S(t_j−) d_c/n², expanded in powers of
    F(t) so that cumulative sums give all times at once. Where all at risk fail F(t) stays at F_j: no contribution.
    """
    staying = at_risk - deaths
    a = np.divide(deaths, at_risk * staying, out=np.zeros_like(at_risk), where=staying > 0)
    b = before * own / at_risk**2
    first = probability**2 * np.cumsum(a) - 2 * probability * np.cumsum(a * probability) + np.cumsum(a * probability**2)
    second = np.cumsum(before**2 * own * (at_risk - own) / at_risk**3)
    third = probability * np.cumsum(b) - np.cumsum(b * probability)
    return np.asarray(np.maximum(first + second - 2 * third, 0.0))


def _band(probability: Float, error: Float) -> tuple[Float, Float]:
    lower, upper = np.full(probability.shape, np.nan), np.full(probability.shape, np.nan)
    inside = (probability > 0) & (probability < 1 - 1e-12)
    log_probability = np.log(probability[inside])
    half = Z * error[inside] / (probability[inside] * -log_probability)
    lower[inside] = np.exp(log_probability * np.exp(half))
    upper[inside] = np.exp(log_probability * np.exp(-half))
    return lower, upper
