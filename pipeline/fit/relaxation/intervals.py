"""How sure the parameters are: covariance of the logarithms, and profile likelihood where that is no description.

The covariance is (JᵀJ)⁻¹ at the optimum, the data's noise widened by max(1, χ²/ν). Where a logarithm's standard deviation
exceeds 0.1 the 95 % limits come from the profile: the parameter is held, everything else fitted again, until χ² has risen by
3.84. A side on which it never does is open. Beyond 0.3 the likelihood is not parabolic at all, and a standard deviation is
given only where both sides have a limit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.fit.relaxation.forward import GaussianPrior, Solution, Tied, polish
from pipeline.fit.relaxation.observations import Observations
from pipeline.fit.relaxation.results import Estimate
from pipeline.physics.film import Shape
from schemas.arrays import Float

PARABOLIC = 0.3
"""Largest standard deviation of a logarithm for which the curvature describes the likelihood."""
QUANTILE = 1.959964
LIMIT = np.log(1e3)
FASTER = 1e-3
LARGEST_MOVE = 1.0
PROFILE_TOLERANCE = 1e-3
"""A profile that is still inside at this distance (of the logarithm) is open."""


def covariance(solution: Solution, factor: float, rows: int, further: Float | None = None) -> Float:
    """(P, P) covariance of θ; the noise of the first `rows` rows, the data, is widened by `factor`, that of priors is not.

    `further` (R, m): derivatives by parameters that were held; the covariance is then (P + m, P + m). Directions that the data
    leave open get a very large variance.
    """
    jacobian = solution.jacobian.copy() if further is None else np.column_stack([solution.jacobian, further])
    jacobian[:rows] /= np.sqrt(factor)
    scale = np.linalg.norm(jacobian, axis=0)
    scale = np.where(scale > 0, scale, 1e-12)
    _, s, vt = np.linalg.svd(jacobian / scale, full_matrices=False)
    s = np.maximum(s, 1e-9 * s[0])
    root = (vt.T / s) / scale[:, None]
    return np.asarray(root @ root.T)


def with_spring(observations: Observations, solution: Solution) -> Solution:
    """The same model with the pure dashpot as an arm a thousand times faster than the data.

    A dashpot is an arm whose spring was not resolved, not one that is known to be rigid: what a spring would change belongs to the
    uncertainty of everything else.
    """
    k0, k, tau, c = solution.shape.split(solution.theta)
    fast = FASTER / observations.omega_range[1]
    shape = Shape(solution.shape.arms + 1, solution.shape.spring)
    theta = np.concatenate([shape.join(k0, np.append(k, c / fast), np.append(tau, fast), 0.0), solution.q])
    residual, jacobian = observations.evaluate(theta, shape)
    return Solution(theta, shape, float(residual @ residual), residual, jacobian)


def spring_of_dashpot(observations: Observations, solution: Solution) -> Float:
    """(R, 1) derivative of the residual by 1/k of the arm that was taken for a pure dashpot, at 1/k = 0."""
    changed = with_spring(observations, solution).residual
    column = np.zeros((solution.residual.size, 1))
    c = float(np.exp(solution.theta[solution.shape.size - 1]))
    column[: changed.size, 0] = (changed - solution.residual[: changed.size]) * c * observations.omega_range[1] / FASTER
    return column


def profile_limits(
    observations: Observations,
    solution: Solution,
    direction: Float,
    sd: float,
    factor: float,
    log_tau_bounds: tuple[float, float],
    prior: GaussianPrior | None = None,
) -> tuple[float | None, float | None]:
    """95 % limits of direction·θ relative to the optimum (below, above); None where open.

    `direction` (P,) has one or two entries 1 (log k, or log c = log k + log τ); `sd` is the curvature's standard deviation,
    `factor` the dispersion.
    """
    chosen = int(np.flatnonzero(direction)[0])
    others = [i for i in range(direction.size) if i != chosen]
    directions = np.zeros((direction.size, len(others)))
    directions[others, np.arange(len(others))] = 1.0
    directions[chosen] = -direction[others]

    # along the ridge of the likelihood, where the others follow the one that is moved
    c = covariance(solution, factor, observations.rows)
    ridge = c @ direction / float(direction @ c @ direction)

    def rise(shift: float, theta: Float) -> tuple[float, Float]:
        move = shift - float(direction @ (theta - solution.theta))
        origin = theta + np.clip(move * ridge, -LARGEST_MOVE, LARGEST_MOVE)
        origin[chosen] += shift - float(direction @ (origin - solution.theta))
        found = polish(
            observations,
            origin,
            solution.shape,
            log_tau_bounds,
            prior=prior,
            tied=Tied(origin, directions),
            tolerance=PROFILE_TOLERANCE,
        )
        return float(np.sqrt(max(found.chi2 - solution.chi2, 0.0) / factor)), found.theta

    return _limit(rise, solution.theta, -min(sd, 1.0)), _limit(rise, solution.theta, min(sd, 1.0))


def _limit(rise: Callable[[float, Float], tuple[float, Float]], theta: Float, first: float) -> float | None:
    """Where the root of the rise of χ² reaches 1.96, on the side of `first`."""
    inside, inside_rise = 0.0, 0.0
    shift = QUANTILE * first
    outside: float | None = None
    outside_rise = 0.0
    for _ in range(14):
        height, found = rise(shift, theta)
        if abs(height - QUANTILE) < 0.04:
            return shift
        if height < QUANTILE:
            inside, inside_rise, theta = shift, height, found
            if abs(shift) >= LIMIT:
                return None
        else:
            outside, outside_rise = shift, height
        if outside is None:
            grown = shift * min(3.0, max(1.3, QUANTILE / max(height, 0.1)))
            shift = float(np.clip(grown, -LIMIT, LIMIT))
        else:
            share = (QUANTILE - inside_rise) / max(outside_rise - inside_rise, 1e-9)
            shift = inside + float(np.clip(share, 0.05, 0.95)) * (outside - inside)
    return shift


def estimate(value: float, sd_log: float, limits: tuple[float | None, float | None] | None) -> Estimate:
    """A positive parameter from its logarithm's standard deviation, or from its profile limits where given."""
    if limits is None:
        if sd_log > PARABOLIC:
            return Estimate(value)
        spread = float(np.exp(QUANTILE * sd_log))
        return Estimate(value, value * sd_log, value / spread, value * spread, "wald")
    below, above = limits
    lower = None if below is None else value * float(np.exp(below))
    upper = None if above is None else value * float(np.exp(above))
    sd = (upper - lower) / (2 * QUANTILE) if lower is not None and upper is not None else None
    return Estimate(value, sd, lower, upper, "profile")
