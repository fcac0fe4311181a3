"""Nonlinear least squares within bounds: Levenberg's and Marquardt's method, made for cheap, smooth, redundant simulations.

The residual's Jacobian is taken by forward differences and brought up to date by secants while steps go well. Belongs here: the search
alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from schemas.arrays import Bool, Float, Int

Residuals = Callable[[Float], Float]
"""Residuals (B, M) of several x (B, P)."""

_DIFFERENCE, _CENTRAL = 1e-4, 3e-4
_ENOUGH = 0.02
"""Fall of χ² that ends a search: far below what statistics can tell."""
_RIDGE = 1e-10
_STILL, _HOPELESS = 1e-7, 1e7
_KEPT = (0.4, 1.6)
"""Fall over promised fall within which old columns are good enough."""
_STRAIGHT = (0.8, 1.25)
"""Fall over promised fall within which a step says well enough what has changed of the columns that are renewed as a search goes."""
DAMPING, LEAST_DAMPING = 1e-3, 1e-9
_MOST_STEP = 1.5
"""Longest step of one entry: entries are logarithms or scaled to their range."""


@dataclass(frozen=True)
class Solution:
    """Where a search ended.

    x : (P,) entries; residual (M,); jacobian (M, P) of the residual there
    chi2 : sum of squares; converged: whether the last fall was below the tolerance
    """

    x: Float
    residual: Float
    jacobian: Float
    chi2: float
    converged: bool

    @property
    def covariance(self) -> Float:
        """(P, P), by a scaled pseudo-inverse: directions without information have huge variances, not infinite ones."""
        normal = self.jacobian.T @ self.jacobian
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
        inner = normal / np.outer(scale, scale) + _RIDGE * np.eye(scale.size)
        return np.asarray(np.linalg.inv(inner) / np.outer(scale, scale))


def minimise(
    residuals: Residuals,
    start: Float | Solution,
    low: Float,
    high: Float,
    *,
    most: int = 25,
    jacobian: Float | None = None,
    moving: int = 0,
    thorough: bool = True,
    damping: float = DAMPING,
) -> Solution:
    """Least sum of squares of the residuals (M,) from `start` within `low` … `high` (P,); entries with equal bounds stay.

    start : entries (P,), or where an earlier search of the same residuals ended, to go on from
    jacobian : (M, P) one from nearby to begin with; its columns from `moving` on are renewed as the search goes, all of them where a
        step fails. Without, all are renewed at every step. `thorough`: the end is confirmed with a Jacobian of its own.
    damping : to begin with, relative to what the data say of each entry alone
    Never fails: a search that does not converge says so.
    """
    columns = _Columns(residuals, high)
    everything = np.flatnonzero(low < high)
    moves = everything[everything >= moving]
    lent = isinstance(start, Solution) or jacobian is not None
    if isinstance(start, Solution):
        if not np.isfinite(start.chi2):
            return start
        x, r, chi2, own = start.x, start.residual, start.chi2, start.jacobian.copy()
    else:
        x = np.clip(start, low, high)
        r = residuals(x[None])[0]
        chi2 = float(r @ r)
        own = np.zeros((r.size, x.size)) if jacobian is None else jacobian.copy()
        if not np.isfinite(chi2):
            return Solution(x, r, np.zeros_like(own), np.inf, False)
        own = columns.renewed(own, x, r, moves if lent else everything)
    fresh, behind, converged = not lent, False, False
    for _ in range(most):
        gradient = own.T @ r
        free = everything[~_held(x, gradient, low, high)[everything]]
        if free.size == 0:
            converged = True
            break
        move = _step(own, gradient, free, damping)
        promised = -float(move @ gradient)
        trial = np.clip(x + move, low, high)
        new = residuals(trial[None])[0]
        value = float(new @ new)
        if np.isfinite(value) and value < chi2:
            fall = chi2 - value
            if lent and moves.size:
                own += _secant(own, trial - x, new - r)
            x, r, chi2 = trial, new, value
            damping = max(damping / 5, LEAST_DAMPING)
            behind = lent
            if fall < _ENOUGH and (fresh or not thorough):
                converged = True
                break
            fresh = not lent or fall < _ENOUGH or not _KEPT[0] * promised < fall < _KEPT[1] * promised
            if fresh or not _STRAIGHT[0] * promised < fall < _STRAIGHT[1] * promised:
                own, behind = columns.renewed(own, x, r, everything if fresh else moves), False
        elif not fresh:
            if promised < _ENOUGH and not thorough:
                converged = True
                break
            own, fresh, behind = columns.renewed(own, x, r, everything), True, False
        elif promised < _ENOUGH or float(np.abs(move).max()) < _STILL:
            # What is promised that little and does not come is the end as well.
            converged = True
            break
        else:
            damping *= 10
            if damping > _HOPELESS:
                break
    if behind:
        own = columns.renewed(own, x, r, moves)
    return Solution(x, r, own, chi2, converged)


def _secant(jacobian: Float, move: Float, change: Float) -> Float:
    """(M, P) least change of a Jacobian with which a step (P,) changes the residual as it did (Broyden 1965)."""
    return np.outer(change - jacobian @ move, move / (move @ move))


def _held(x: Float, gradient: Float, low: Float, high: Float) -> Bool:
    return np.asarray(((x <= low) & (gradient > 0)) | ((x >= high) & (gradient < 0)))


def _step(jacobian: Float, gradient: Float, free: Int, damping: float) -> Float:
    part = jacobian[:, free]
    normal = part.T @ part
    diagonal = np.maximum(np.diag(normal), 1e-9)
    move = np.zeros(gradient.size)
    move[free] = -np.linalg.solve(normal + damping * np.diag(diagonal), gradient[free])
    longest = float(np.abs(move).max())
    return move * (_MOST_STEP / longest) if longest > _MOST_STEP else move


@dataclass(frozen=True)
class _Columns:
    """Forward differences of residuals, backward at an upper bound."""

    residuals: Residuals
    high: Float

    def renewed(self, jacobian: Float, x: Float, at: Float, places: Int) -> Float:
        """The Jacobian (M, P) with some columns taken anew, in place."""
        if places.size:
            step = np.where(x[places] + _DIFFERENCE <= self.high[places], _DIFFERENCE, -_DIFFERENCE)
            moved = np.tile(x, (places.size, 1))
            moved[np.arange(places.size), places] += step
            jacobian[:, places] = ((self.residuals(moved) - at) / step[:, None]).T
        return jacobian


def central(residuals: Residuals, x: Float, low: Float, high: Float) -> Float:
    """(M, P) Jacobian by central differences of residuals (B, M) of several x (B, P): what is projected off must not leave its own
    error behind."""
    step = _CENTRAL * np.eye(x.size)[:, low < high].T
    up, down = np.minimum(x + step, high), np.maximum(x - step, low)
    seen = residuals(np.concatenate([up, down]))
    width = np.sum(up - down, axis=1)
    columns = np.zeros((seen.shape[1], x.size))
    columns[:, low < high] = ((seen[: len(up)] - seen[len(up) :]) / np.maximum(width, 1e-300)[:, None]).T
    return columns
