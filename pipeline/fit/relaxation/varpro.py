"""Variable projection: search over the relaxation times with the springs found by NNLS inside.

The columns of the linear problem are smooth functions of log τ. They are tabulated once, compressed to the few
directions that the data can tell apart, and interpolated by a cubic spline, so that a step costs microseconds whatever
the number of data.
The result starts the forward fit (`forward`), which is exact. Does not belong here: where to start (`starts`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import nnls

from pipeline.physics.least_squares import Options, minimise_each
from schemas.arrays import Bool, Float, Int

FAST, SLOW = 300.0, 30.0
"""Relaxation times are searched from 1/(300 ω_max) to 30/ω_min. A narrower box would hold the optimum at its bound."""
COMPRESSION = 1e-9
MERGE = 0.1
"""Arms closer than this in log τ cannot be told apart."""
SEARCH = Options(fall=1e-3, share=1e-7, most=60, race=((6, 4), (13, 2)))
"""The forward fit goes on from where a search ends: after five steps four of the starts go on, after twelve two."""
RIDGE = 1e-13


def bounds(low: float, high: float) -> tuple[float, float]:
    """Bounds of log τ for angular frequencies from `low` to `high` rad/s."""
    return float(-np.log(FAST * high)), float(np.log(SLOW / low))


@dataclass(frozen=True)
class Candidate:
    """Result of a search: `log_tau` (n,), springs `k` (n,), `k0`, `c`, all ≥ 0, and the sum of squares `cost`."""

    log_tau: Float
    k: Float
    k0: float
    c: float
    cost: float


class Columns(Protocol):
    """A problem that is linear for given relaxation times: `target` (R,), columns of arms (R, n), and of spring and dashpot."""

    @property
    def target(self) -> Float: ...
    def columns(self, tau: Float) -> Float: ...
    def ends(self) -> Float: ...


class LinearProblem:
    """The compressed problem. `grid` (K,) log τ and `table` (K, r) the columns there; `ends` (2, r), `target` (r,)."""

    def __init__(self, problem: Columns, low: float, high: float, per_decade: int = 10) -> None:
        self.low, self.high = low, high
        count = int(np.ceil((high - low) / np.log(10) * per_decade)) + 1
        self.grid = np.linspace(low, high, max(count, 5))
        columns = np.hstack([problem.columns(np.exp(self.grid)), problem.ends()])
        scale = np.linalg.norm(columns, axis=0)
        scale[scale == 0] = 1.0
        u, s, _ = np.linalg.svd(columns / scale, full_matrices=False)
        u = u[:, s > COMPRESSION * s[0]]
        compressed = columns.T @ u
        self.table = compressed[:-2]
        self.ends = compressed[-2:]
        self.target = problem.target @ u
        self.rest = float(problem.target @ problem.target - self.target @ self.target)
        self._coefficients = CubicSpline(self.grid, self.table).c
        self._step = float(self.grid[1] - self.grid[0])

    def columns(self, log_tau: Float) -> tuple[Float, Float]:
        """Columns (..., r) of arms at log τ (...), and their derivatives by log τ."""
        place = np.minimum(((log_tau - self.low) / self._step).astype(np.int64), self.grid.size - 2)
        place = np.maximum(place, 0)
        c = self._coefficients[:, place, :]
        d = (log_tau - self.grid[place])[..., None]
        return ((c[0] * d + c[1]) * d + c[2]) * d + c[3], (3 * c[0] * d + 2 * c[1]) * d + c[2]

    def search(self, starts: list[tuple[Float, bool]]) -> list[Candidate]:
        """The optima over log τ within the bounds from several starts (log τ, with dashpot) side by side."""
        if not starts:
            return []
        count, arms = len(starts), max(max(t.size for t, _ in starts), 1)
        t = np.full((count, arms), self.low)
        present = np.zeros((count, arms + 2), dtype=bool)
        present[:, 0] = True
        for i, (start, dashpot) in enumerate(starts):
            t[i, : start.size] = np.minimum(np.maximum(start, self.low), self.high)
            present[i, 1 : 1 + start.size], present[i, -1] = True, dashpot
        low, high = (np.where(present[:, 1:-1], bound, t) for bound in (self.low, self.high))

        def evaluate(points: Float, problems: Int) -> tuple[Float, Float]:
            found = self.project(points, present[problems])
            return found.residual, found.jacobian

        found = minimise_each(evaluate, list(t), low, high, SEARCH)
        ends = self.project(np.array([one.x for one in found]), present)
        candidates = []
        for i, one in enumerate(found):
            used = present[i, 1:-1]
            order = np.argsort(-one.x[used])
            x = ends.coefficients[i]
            k = x[1:-1][used][order]
            candidates.append(Candidate(one.x[used][order], k, float(x[0]), float(x[-1]), one.chi2 + self.rest))
        return candidates

    def project(self, log_tau: Float, present: Bool) -> Projection:
        """Springs ≥ 0 at their best for relaxation times log τ (S, n), where only some columns are `present`
        (S, n + 2)."""
        arms, slopes = self.columns(log_tau)
        matrix = np.empty((len(log_tau), log_tau.shape[1] + 2, self.target.size))
        matrix[:, 0], matrix[:, 1:-1], matrix[:, -1] = self.ends[0], arms, self.ends[1]
        matrix *= present[:, :, None]
        x = _non_negative(matrix, self.target)
        residual = np.einsum("spr,sp->sr", matrix, x) - self.target
        return Projection(matrix, slopes * x[:, 1:-1, None], x, residual)


@dataclass(frozen=True)
class Projection:
    """Several linear problems solved: columns `matrix` (S, n + 2, r) of spring, arms and dashpot, derivatives
    `slopes` (S, n, r) of their sum by log τ at given springs, coefficients (S, n + 2) ≥ 0, residuals (S, r)."""

    matrix: Float
    slopes: Float
    coefficients: Float
    residual: Float

    @property
    def jacobian(self) -> Float:
        """(S, r, n) of the residual by log τ after Kaufman (1975): the derivative of the columns, less what the active
        columns take up."""
        active = self.matrix * (self.coefficients > 0)[:, :, None]
        size = np.sqrt(np.einsum("spr,spr->sp", active, active))
        active = active / np.where(size > 0, size, 1.0)[:, :, None]
        gram = active @ active.transpose(0, 2, 1) + np.eye(active.shape[1]) * np.where(size > 0, RIDGE, 1.0)[:, :, None]
        taken_up = np.linalg.solve(gram, active @ self.slopes.transpose(0, 2, 1))
        return np.asarray(self.slopes.transpose(0, 2, 1) - active.transpose(0, 2, 1) @ taken_up)


def _non_negative(matrix: Float, target: Float) -> Float:
    """x ≥ 0 (S, p) minimising ‖Σ x_p matrix_p − target‖ for each of the S problems (S, p, r).

    The ordinary solution where it is not negative, which is the common case; the active-set method elsewhere.
    """
    gram = matrix @ matrix.transpose(0, 2, 1)
    size = np.einsum("spp->sp", gram)
    empty = size <= 0
    scale = 1 / np.sqrt(np.where(empty, 1.0, size))
    scaled = gram * scale[:, :, None] * scale[:, None, :]
    scaled += np.eye(gram.shape[1]) * np.where(empty, 1.0, RIDGE)[:, :, None]
    x = np.linalg.solve(scaled, (matrix @ target * scale)[:, :, None])[:, :, 0]
    x[empty] = 0.0
    for i in np.flatnonzero((x < 0).any(axis=1)):
        x[i] = nnls((matrix[i] * scale[i][:, None]).T, target, maxiter=200)[0]
    return np.asarray(x * scale)


def merged(log_tau: Float, weight: Float, count: int) -> Float:
    """(count,) log τ from more of them: the closest pair is replaced by its weighted mean until `count` remain."""
    order = np.argsort(log_tau)
    t, w = log_tau[order].copy(), weight[order].copy()
    while t.size > count:
        i = int(np.argmin(np.diff(t)))
        t[i] = (w[i] * t[i] + w[i + 1] * t[i + 1]) / (w[i] + w[i + 1])
        w[i] += w[i + 1]
        t, w = np.delete(t, i + 1), np.delete(w, i + 1)
    return np.asarray(t)
