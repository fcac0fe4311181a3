"""Profile-likelihood intervals of one parameter at a time, with a critical value that holds for few failures.

Belongs here: the critical value and the search for the two limits. The likelihoods themselves are elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import special

from pipeline.fit.survival.kaplan_meier import LEVEL, Z
from schemas.arrays import Float

LARGE_SAMPLE_DROP = Z**2 / 2
"""Half the 95 % point of χ² with one degree of freedom."""
_DISTANCES = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 6.0, 9.0, 14.0, 25.0, 50.0, 100.0])
"""In steps from the best value; a profile that has not fallen by then never does."""
_STAGES = (6, 9, 11, 13)
_POINTS = 9
_ROUNDS = 3


def critical_drop(failures: int, coefficients: int = 1) -> float:
    """Drop of the profile log-likelihood at the limits of a 95 % interval for `failures` failures.

    r ln[1 + t²/(r − p)]/2 with r failures, p location `coefficients` and Student's t of r − p degrees of freedom: exact
    for the coefficients of a normal linear model, and half of the χ² point 3.84 in the limit. The plain χ² value is too
    narrow for few failures.
    """
    freedom = failures - coefficients
    if freedom < 1:
        return LARGE_SAMPLE_DROP
    t = float(special.stdtrit(freedom, 0.5 + LEVEL / 2))
    return failures * float(np.log1p(t**2 / freedom)) / 2


def few_failures_p_value(statistic: float, freedom: int, failures: int, coefficients: int) -> float:
    """p-value of a likelihood ratio for `failures` failures, as `critical_drop` for several coefficients at once.

    F = (e^{Λ/r} − 1)(r − p)/ν of ν and r − p degrees of freedom with the ratio Λ, r failures, and p location `coefficients` of the
    larger model of which the smaller lacks ν: exact for a normal linear model, χ² in the limit.
    """
    rest = failures - coefficients
    ratio = float(np.expm1(min(statistic / failures, 600.0))) * rest / freedom
    return float(special.fdtrc(freedom, rest, ratio))


def critical_deviations(failures: int, coefficients: int = 1) -> float:
    """Standard deviations of the observed information on either side of a 95 % interval for `failures` failures.

    t √[r/(r − p)] with r failures, p location `coefficients` and Student's t of r − p degrees of freedom: exact for the
    coefficients of a normal linear model, whose scatter by maximum likelihood is too small by √[(r − p)/r].
    """
    freedom = failures - coefficients
    if freedom < 1:
        return Z
    return float(special.stdtrit(freedom, 0.5 + LEVEL / 2)) * float(np.sqrt(failures / freedom))


def profile_limits(
    profile: Callable[[Float], Float], best: float, top: float, drop: float, step: float
) -> tuple[float, float]:
    """Where the profile log-likelihood has fallen by `drop` on either side of `best`; NaN on a side where it never does.

    `profile` takes (m,) values of the parameter and returns its (m,) log-likelihoods maximised over the others; it has
    one maximum, `top` at `best`. `step` is a rough standard deviation. Both sides are searched together, many values at
    a time: a batch of fits costs little more than one.
    """
    sides = np.array([-1.0, 1.0])
    distances = np.concatenate(([0.0], _DISTANCES)) * step
    fallen = np.zeros((2, 0), dtype=np.bool_)
    for end in _STAGES:
        ahead = distances[fallen.shape[1] + 1 : end + 1]
        values = profile((best + sides[:, None] * ahead).ravel()).reshape(2, -1)
        fallen = np.concatenate((fallen, ~(values >= top - drop)), axis=1)
        if fallen.any(axis=1).all():
            break
    found = fallen.any(axis=1)
    first = np.argmax(fallen, axis=1)
    low, high = distances[first], distances[first + 1]
    share = np.linspace(0, 1, _POINTS + 2)
    rows = np.arange(2)
    for _ in range(_ROUNDS):
        inside = low[:, None] + (high - low)[:, None] * share
        excess = profile((best + sides[:, None] * inside).ravel()).reshape(2, -1) - (top - drop)
        below = ~(excess >= 0)
        below[:, -1] = True
        cell = np.maximum(np.argmax(below, axis=1), 1)
        low, high = inside[rows, cell - 1], inside[rows, cell]
    above, under = excess[rows, cell - 1], excess[rows, cell]
    crossing = low + (high - low) * np.divide(above, above - under, out=np.full(2, 0.5), where=above > under)
    lower, upper = np.where(found, best + sides * crossing, np.nan).tolist()
    return lower, upper
