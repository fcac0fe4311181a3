"""A stress below which nothing ever fails, in place of the inverse power law that lets everything fail in time.

Belongs here: the limit, its interval and the test whether there is one. The regressions are in `life_regression`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from pipeline.fit.survival.covariates import Covariate, make_design
from pipeline.fit.survival.kaplan_meier import Estimate
from pipeline.fit.survival.life_regression import GENERALISED_GAMMA, limit_drop, log_likelihood_of
from pipeline.fit.survival.lifetime_distributions import EXPONENTIAL, Lives
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.life_covariates import INVERSE_POWER

_FEWEST_STRESSES = 3
_POINTS = 33
_NEAREST = 1e-3
"""The limit is searched up to this share below the lowest stress at which anything failed: at it ln(stress − limit) has no end."""


@dataclass(frozen=True)
class EnduranceLimit:
    """The limit in the unit of the stress, 0 where a plain power law fits as well.

    The lower end of its 95 % interval is 0 where no limit is as likely, the upper end the lowest stress with a failure where
    the lives do not say how near to it the limit may be. `exponent` is that of (stress − limit); `p_value` that of no limit
    against one, where `statistic` is 0 in half of all cases without a limit.
    """

    stress: str
    family: str
    limit: Estimate
    exponent: float
    statistic: float
    p_value: float


def find_endurance_limit(lives: Lives, covariates: Sequence[Covariate], family: str) -> EnduranceLimit:
    """The limit of the first covariate, in ln t = c₀ + c₁ ln(stress − limit) + others + σ w.

    Parameters
    ----------
    lives : n lives in s, censored in any way
    covariates : each with n values; the first one is a stress with the inverse power law
    family : of `life_regression.FAMILIES`, but not the generalised gamma

    Raises
    ------
    NotIdentifiableError
        Failures at fewer than three stresses, which a power law with a limit meets exactly, or too few of them.

    Notes
    -----
    W. Nelson, Accelerated Testing (1990), section 2.11. Specimens at or below the limit never fail: their survival has
    probability one, so the likelihood goes on as the limit passes the stresses of survivors. Limits of the interval are
    those of the profile likelihood (`profile_likelihood.critical_drop`). No limit lies at the edge of what is possible, so
    that the statistic has half its weight at 0: S. Self, K.-Y. Liang, J. Am. Stat. Assoc. 82 (1987) 605.
    """
    stress = covariates[0]
    if stress.law != INVERSE_POWER or family == GENERALISED_GAMMA:
        raise ValueError("an endurance limit is that of an inverse power law with a family without a shape")
    values = np.asarray(stress.values, dtype=np.float64)
    failed = np.isfinite(lives.upper)
    tested = np.unique(values[failed])
    if tested.size < _FEWEST_STRESSES:
        raise NotIdentifiableError(
            f"failures at {tested.size} {'value' if tested.size == 1 else 'values'} of {stress.name} tell no limit from a power law",
            expected=f"failures at {_FEWEST_STRESSES} or more values",
        )
    columns = make_design(covariates, failed).x
    needed = columns.shape[1] + 2 + (family != EXPONENTIAL)
    if lives.distinct_failures < needed:
        raise NotIdentifiableError(f"{lives.distinct_failures} distinct failure times for {needed} parameters")
    end = float(tested[0]) * (1 - _NEAREST)

    # The likelihood has one maximum at each limit: that of the last one is near.
    near: Float | None = None

    def profile(limit: float) -> tuple[float, float]:
        nonlocal near
        above = values > limit
        x = np.column_stack((np.log(values[above] - limit), columns[above, 1:]))
        kept = lives if above.all() else lives.keep(above)
        value, coefficients, near = log_likelihood_of(kept, x, family, near)
        return value, float(coefficients[1])

    grid = _grid(end, values)
    heights = np.array([profile(limit)[0] for limit in grid])
    best, top = _top(grid, heights, profile)
    drop = limit_drop(family, lives.failures, columns.shape[1] + 1)
    statistic = max(2 * (top - float(heights[0])), 0.0)

    def excess(limit: float) -> float:
        return profile(limit)[0] - (top - drop)

    lower, upper = 0.0, float(tested[0])
    if heights[0] < top - drop:
        below = float(grid[(grid < best) & (heights < top - drop)].max())
        lower = float(optimize.brentq(excess, below, best, xtol=1e-6 * end))
    if (fallen := grid[(grid > best) & (heights < top - drop)]).size:
        upper = float(optimize.brentq(excess, best, float(fallen.min()), xtol=1e-6 * end))
    p_value = float(special.chdtrc(1, statistic)) / 2 if statistic > 0 else 1.0
    return EnduranceLimit(stress.name, family, Estimate(best, lower, upper), profile(best)[1], statistic, p_value)


def _grid(end: float, values: Float) -> Float:
    """Limits from 0 to `end`, closer towards it, and both sides of the stresses of survivors in between."""
    even = end * (1 - np.geomspace(1, _NEAREST, _POINTS))
    passed = np.unique(values[values < end])
    return np.unique(np.concatenate((even, [end], passed * (1 - _NEAREST), passed)))


def _top(grid: Float, heights: Float, profile: Callable[[float], tuple[float, float]]) -> tuple[float, float]:
    """Where the profile is highest, and how high: refined between the neighbours of the best limit of the grid."""
    middle = int(np.argmax(heights))
    if middle in (0, grid.size - 1):
        return float(grid[middle]), float(heights[middle])
    found = optimize.minimize_scalar(
        lambda limit: -profile(float(limit))[0],
        bounds=(float(grid[middle - 1]), float(grid[middle + 1])),
        method="bounded",
        options={"xatol": 1e-7 * float(grid[-1])},
    )
    if -found.fun < heights[middle]:
        return float(grid[middle]), float(heights[middle])
    return float(found.x), float(-found.fun)
