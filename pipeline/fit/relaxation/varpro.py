"""Variable projection: search over the relaxation times with the springs found by NNLS inside.

The columns of the linear problem are smooth functions of log τ. They are tabulated once, compressed to the few directions that
the data can tell apart, and interpolated by a cubic spline, so that a step costs microseconds whatever the number of data.
The result starts the forward fit (`forward`), which is exact. Does not belong here: where to start (`starts`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import nnls

from schemas.arrays import Bool, Float, Int

FAST, SLOW = 300.0, 30.0
"""Relaxation times are searched from 1/(300 ω_max) to 30/ω_min. A narrower box would hold the optimum at its bound."""
COMPRESSION = 1e-9
MERGE = 0.1
"""Arms closer than this in log τ cannot be told apart."""
ITERATIONS = 40
ENOUGH = 1e-2
"""Fall of the sum of squares that is not worth another step: the forward fit goes on from here."""
RACE = {5: 4, 12: 2}
"""After so many steps only so many of the starts go on."""
LARGEST_STEP = 1.5
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
        """Levenberg-Marquardt over log τ within the bounds from several starts (log τ, with dashpot) at once.

        Kaufman's Jacobian: the derivative of the columns, less what the active columns can take up.
        """
        if not starts:
            return []
        count, arms = len(starts), max(max(t.size for t, _ in starts), 1)
        t = np.full((count, arms), self.low)
        present = np.zeros((count, arms + 2), dtype=bool)
        present[:, 0] = True
        for i, (start, dashpot) in enumerate(starts):
            t[i, : start.size] = np.minimum(np.maximum(start, self.low), self.high)
            present[i, 1 : 1 + start.size], present[i, -1] = True, dashpot
        state = _State(self, t, present)
        damping = np.full(count, 1e-3)
        running = np.asarray(present[:, 1:-1].any(axis=1))
        for iteration in range(ITERATIONS):
            if iteration in RACE:
                behind = np.argsort(state.cost)[RACE[iteration] :]
                running[behind] = False
            rows = np.flatnonzero(running)
            if not rows.size:
                break
            step = state.step(rows, damping[rows])
            trial_t = np.minimum(np.maximum(state.t[rows] + step, self.low), self.high)
            trial = _State(self, trial_t, present[rows])
            fall = state.cost[rows] - trial.cost
            better = fall > 0
            state.take(rows[better], trial, better)
            damping[rows] = np.where(better, np.maximum(damping[rows] / 5, 1e-9), damping[rows] * 6)
            done = better & (fall < ENOUGH + 1e-7 * trial.cost) | (damping[rows] > 1e5)
            running[rows[done]] = False
        found = []
        for i in range(count):
            used = present[i, 1:-1]
            order = np.argsort(-state.t[i, used])
            k = state.x[i, 1:-1][used][order]
            cost = float(state.cost[i] + self.rest)
            found.append(Candidate(state.t[i, used][order], k, float(state.x[i, 0]), float(state.x[i, -1]), cost))
        return found


class _State:
    """Several points of the search at once: log τ (S, n), coefficients (S, n + 2), residuals (S, r), costs (S,)."""

    def __init__(self, problem: LinearProblem, t: Float, present: Bool) -> None:
        self.t, self.present, self.target = t, present, problem.target
        arms, self.slopes = problem.columns(t)
        count = t.shape[0]
        self.matrix = np.empty((count, t.shape[1] + 2, problem.target.size))
        self.matrix[:, 0], self.matrix[:, 1:-1], self.matrix[:, -1] = problem.ends[0], arms, problem.ends[1]
        self.matrix *= present[:, :, None]
        self.x = _non_negative(self.matrix, problem.target)
        self.residual = np.einsum("spr,sp->sr", self.matrix, self.x) - problem.target
        self.cost = np.einsum("sr,sr->s", self.residual, self.residual)

    def step(self, rows: Int, damping: Float) -> Float:
        """Steps (rows, n) of log τ."""
        slope = self.slopes[rows] * self.x[rows, 1:-1, None]
        active = self.matrix[rows] * (self.x[rows] > 0)[:, :, None]
        gradient = np.einsum("snr,sr->sn", slope, self.residual[rows])
        cross = slope @ active.transpose(0, 2, 1)
        gram = active @ active.transpose(0, 2, 1)
        size = np.einsum("spp->sp", gram)
        scale = np.where(size > 0, 1 / np.sqrt(np.where(size > 0, size, 1)), 1.0)
        gram = gram * scale[:, :, None] * scale[:, None, :] + np.eye(gram.shape[1]) * np.where(
            size > 0, RIDGE, 1.0
        ).reshape(*size.shape, 1)
        cross = cross * scale[:, None, :]
        hessian = slope @ slope.transpose(0, 2, 1) - cross @ np.linalg.solve(gram, cross.transpose(0, 2, 1))
        fixed = (self.x[rows, 1:-1] == 0) | ~self.present[rows, 1:-1]
        gradient[fixed] = 0.0
        diagonal = np.maximum(np.einsum("snn->sn", slope @ slope.transpose(0, 2, 1)), 1e-300)
        own = np.maximum(np.einsum("snn->sn", hessian), 1e-9 * diagonal)
        hessian = hessian * ~(fixed[:, :, None] | fixed[:, None, :])
        hessian += np.eye(own.shape[1]) * (damping[:, None] * own + np.where(fixed, 1.0, 1e-9 * diagonal))[:, :, None]
        step = -np.linalg.solve(hessian, gradient[:, :, None])[:, :, 0]
        return np.asarray(np.minimum(np.maximum(step, -LARGEST_STEP), LARGEST_STEP))

    def take(self, rows: Int, other: _State, chosen: Bool) -> None:
        """Replaces the rows by the chosen rows of another state."""
        for name in ("t", "x", "residual", "cost", "matrix", "slopes"):
            getattr(self, name)[rows] = getattr(other, name)[chosen]


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
