"""The forward fit: the local optimum over the logarithms of the material's parameters and the nuisance parameters.

Works on the raw responses with the rig inside the model, so nothing is divided by a resonance. Positivity comes with
the logarithms. Does not belong here: the solver (`physics.least_squares`), starts, orders, intervals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.fit.relaxation.observations import Observations
from pipeline.physics.film import Shape
from pipeline.physics.least_squares import Options, minimise_each, tie, with_prior
from schemas.arrays import Float, Int

STEPS = 200
"""Trial steps of one search at most."""
TOLERANCE = 1e-5
"""Fall of χ², in units of χ² per row where that exceeds 1, that is not worth another step."""


@dataclass(frozen=True)
class Tied:
    """Restricts θ to θ = origin + directions u, for profiles along one parameter."""

    origin: Float
    directions: Float


@dataclass(frozen=True)
class GaussianPrior:
    """Prior knowledge of θ itself: residual rows root @ (θ − mean)."""

    mean: Float
    root: Float


@dataclass(frozen=True)
class Solution:
    """Optimum: θ (P,), χ² with priors, residual rows (R,), Jacobian (R, P) by θ, or by u where θ was tied."""

    theta: Float
    shape: Shape
    chi2: float
    residual: Float
    jacobian: Float

    @property
    def q(self) -> Float:
        """Nuisance parameters."""
        return self.theta[self.shape.size :]


def polish(
    observations: Observations,
    theta: Float,
    shape: Shape,
    log_tau_bounds: tuple[float, float],
    *,
    prior: GaussianPrior | None = None,
    tied: Tied | None = None,
    tolerance: float = TOLERANCE,
) -> Solution:
    """The local optimum near θ.

    Parameters
    ----------
    theta : (P,) = (material, q) to begin with; with `tied` its origin
    log_tau_bounds : least and largest logarithm of a relaxation time in s; not kept where θ is tied
    tolerance : fall of χ² that ends the search, in units of χ² per row where that exceeds 1
    """

    def evaluate(points: Float, _: Int) -> tuple[Float, Float]:
        with np.errstate(over="ignore", invalid="ignore"):
            found = [observations.evaluate(point, shape) for point in points]
        return np.array([residual for residual, _ in found]), np.array([jacobian for _, jacobian in found])

    known = evaluate if prior is None else with_prior(evaluate, prior.mean, prior.root)
    rows = observations.rows + observations.nuisance.target.size + (0 if prior is None else len(prior.root))
    options = Options(fall=tolerance, share=tolerance / rows, most=STEPS)
    if tied is not None:
        free = np.full(tied.directions.shape[1], np.inf)
        (found,) = minimise_each(tie(known, tied.origin, tied.directions), [np.zeros(free.size)], -free, free, options)
        theta = tied.origin + tied.directions @ found.x
    else:
        (found,) = minimise_each(
            known, [np.array(theta, dtype=float)], *_bounds(shape, theta.size, log_tau_bounds), options
        )
        theta = found.x
    return Solution(theta, shape, found.chi2, found.residual, found.jacobian)


def _bounds(shape: Shape, size: int, log_tau_bounds: tuple[float, float]) -> tuple[Float, Float]:
    """(P,) least and largest θ: those of log τ, and none."""
    low, high = np.full(size, -np.inf), np.full(size, np.inf)
    first = int(shape.spring) + shape.arms
    low[first : first + shape.arms], high[first : first + shape.arms] = log_tau_bounds
    return low, high
