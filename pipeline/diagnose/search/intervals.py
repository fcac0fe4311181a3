"""How far severities may be from where they were found: where χ² has risen, not where its curvature says that it would
have.

Entries that can change places (a mass and a stiffness whose ratio is known) lie along a bent valley, of which the
curvature at one point says too little. Ends are those of profile likelihood (Venzon and Moolgavkar 1988), never nearer
than the curvature says.
"""

from __future__ import annotations

import numpy as np

from pipeline.diagnose.mechanisms import SEVERITY
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.physics.least_squares import minimise
from schemas.arrays import Float

NORMAL_90 = 1.645
"""Half width of a 90 % interval of the normal distribution, in standard deviations."""
_ROUNDS, _STEPS = 4, 6
"""Rounds in which an end is looked for, and steps of a fit in each."""
_LEAST_RISE, _MOST_FACTOR = 0.25, 3.0
"""Least rise of χ² that is taken at its word (root of its share), and most by which a step grows in a round."""
_NEAR = 0.7
"""Share of the rise of χ² that an end of an interval stands for from which it is far enough."""


def make_linear_ends(spread: Float) -> tuple[Float, Float]:
    """Steps down and up to the ends of 90 % intervals by standard deviations alone, (Q,) each.

    Parameters
    ----------
    spread : (Q,) standard deviations of the mechanisms' entries
    """
    return -NORMAL_90 * spread, NORMAL_90 * spread


def find_interval_ends(fit: ExtendedFit, spread: Float) -> tuple[Float, Float]:
    """Steps of the mechanisms' entries down and up to the ends of their 90 % intervals, (Q,) each.

    The ends of severities are where χ² has risen by 2.7 with everything else at its best, never nearer than the
    curvature says.

    Parameters
    ----------
    fit : the model at its optimum
    spread : (Q,) standard deviations of the mechanisms' entries
    """
    down, up = make_linear_ends(spread)
    for i, coordinate in enumerate(fit.of.coordinates):
        if coordinate.parameter.role == SEVERITY and not coordinate.fixed and spread[i] > 0:
            down[i], up[i] = (_find_end(fit, fit.of.model.size + i, step) for step in (down[i], up[i]))
    return down, up


def _find_end(fit: ExtendedFit, entry: int, step: float) -> float:
    """The step to one end of one entry's interval, from that which the curvature says."""
    low, high = (float(bound[entry]) for bound in fit.of.limits)
    x = float(fit.x[entry])
    for _ in range(_ROUNDS):
        if not low < x + step < high:
            break
        rise = _measure_rise(fit, entry, step) / NORMAL_90**2
        if rise > _NEAR:
            break
        step *= min(1 / np.sqrt(max(rise, _LEAST_RISE**2)), _MOST_FACTOR)
    return float(np.clip(x + step, low, high) - x)


def _measure_rise(fit: ExtendedFit, entry: int, step: float) -> float:
    """Rise of χ² where one entry is held a step away and the others are at their best."""
    low, high = (bound.copy() for bound in fit.of.limits)
    start = np.clip(fit.x + step * fit.covariance[:, entry] / fit.covariance[entry, entry], low, high)
    low[entry] = high[entry] = start[entry] = fit.x[entry] + step
    held = minimise(
        fit.of.residuals, start, low, high, most=_STEPS, jacobian=fit.solution.jacobian, moving=fit.of.model.size,
        thorough=False,
    )  # fmt: skip
    return held.chi2 - fit.chi2
