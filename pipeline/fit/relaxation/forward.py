"""The forward fit: Levenberg-Marquardt over the logarithms of the material's parameters and the nuisance parameters.

Works on the raw responses with the rig inside the model, so nothing is divided by a resonance. Positivity comes with the
logarithms; bounds on log τ are kept by projection. Does not belong here: starts, orders, intervals.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.fit.relaxation.observations import Observations
from pipeline.physics.film import Shape
from schemas.arrays import Float

ITERATIONS = 80
TOLERANCE = 1e-5
"""Fall of χ², in units of χ² per row where that exceeds 1, that is not worth another step."""
LARGEST_STEP = 1.5


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
    """Optimum: θ (P,), χ² with priors, residual rows (R,), Jacobian (R, P)."""

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
    """The local optimum from θ (P,) = (material, q)."""
    a = int(shape.spring) + shape.arms
    times = slice(a, a + shape.arms)
    low, high = log_tau_bounds
    theta = np.array(theta, dtype=float)
    theta[times] = np.clip(theta[times], low, high)
    residual, jacobian = _evaluate(observations, theta, shape, prior)
    chi2 = float(residual @ residual)
    damping = 1e-4
    at_bound = np.zeros(theta.size, dtype=bool)
    for _ in range(ITERATIONS):
        gradient = jacobian.T @ residual
        if tied is None:
            at_bound[times] = ((theta[times] <= low) & (gradient[times] > 0)) | (
                (theta[times] >= high) & (gradient[times] < 0)
            )
            hessian = jacobian.T @ jacobian
        else:
            reduced = jacobian @ tied.directions
            gradient, hessian = reduced.T @ residual, reduced.T @ reduced
        fixed = at_bound if tied is None else np.zeros(gradient.size, dtype=bool)
        if fixed.any():
            hessian[fixed, :] = hessian[:, fixed] = 0.0
            hessian[fixed, fixed] = 1.0
            gradient = np.where(fixed, 0.0, gradient)
        diagonal = np.diag(hessian)
        diagonal = np.maximum(diagonal, 1e-14 * diagonal.max() + 1e-300)
        improved = False
        enough = tolerance * max(1.0, chi2 / residual.size)
        while damping < 1e10:
            step = -_solve(hessian, diagonal, damping, gradient)
            step *= min(1.0, LARGEST_STEP / max(float(np.abs(step).max()), 1e-300))
            expected = -float(step @ (2 * gradient + hessian @ step))
            trial = theta + (step if tied is None else tied.directions @ step)
            if tied is None:
                trial[times] = np.clip(trial[times], low, high)
            new_residual, new_jacobian = _evaluate(observations, trial, shape, prior)
            new = float(new_residual @ new_residual)
            if new < chi2:
                improved = True
                break
            if expected < enough:
                break
            damping = max(damping, 1e-6) * 8
        if not improved:
            break
        fall = chi2 - new
        good = fall > 0.5 * expected
        theta, residual, jacobian, chi2 = trial, new_residual, new_jacobian, new
        damping = damping / 8 if good else damping * 2
        damping = max(damping, 1e-12)
        if fall < enough and expected < 10 * enough:
            break
    return Solution(theta, shape, chi2, residual, jacobian)


def _solve(hessian: Float, diagonal: Float, damping: float, gradient: Float) -> Float:
    try:
        return np.asarray(np.linalg.solve(hessian + np.diag(damping * diagonal), gradient))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(hessian + np.diag(damping * diagonal), gradient, rcond=1e-14)[0])


def _evaluate(
    observations: Observations, theta: Float, shape: Shape, prior: GaussianPrior | None
) -> tuple[Float, Float]:
    with np.errstate(over="ignore", invalid="ignore"):
        residual, jacobian = observations.evaluate(theta, shape)
    if prior is not None:
        residual = np.concatenate([residual, prior.root @ (theta - prior.mean)])
        jacobian = np.vstack([jacobian, prior.root])
    if not np.isfinite(residual).all():
        return np.full(residual.shape, 1e150), jacobian
    return residual, jacobian
