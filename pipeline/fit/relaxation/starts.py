"""Where the search over the relaxation times starts: exhaustively on a coarse grid, so that no luck is needed.

Up to three arms every subset of the coarse grid is tried: the non-negative optimum of a subset is the ordinary least-squares
optimum of those of its columns that stay positive, and that smaller subset is tried as well, so plain batched solves suffice.
More arms start from the next lower order with one arm added where it helps most, and from the reference's spectrum merged.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from pipeline.fit.relaxation.linear import solve
from pipeline.fit.relaxation.varpro import Candidate, LinearProblem, merged
from schemas.arrays import Float

PER_DECADE = 3
MOST = 24
"""Most points of the coarse grid."""
KEEP = 3


def candidates(
    problem: LinearProblem, order: int, lower: Candidate | None, spectrum: tuple[Float, Float]
) -> list[Candidate]:
    """Distinct local optima of that order, best first; `lower` the optimum of the next lower order.

    `spectrum` (log τ, weight) of the reference. Models with a pure dashpot in place of an arm are among them.
    """
    starts: list[tuple[Float, bool]] = []
    if order <= 3:
        starts += _subsets(problem, order)
    if lower is not None:
        starts += _one_more(problem, lower, order)
    inside = (spectrum[0] >= problem.low) & (spectrum[0] <= problem.high)
    t, weight = spectrum[0][inside], spectrum[1][inside]
    if t.size >= order and order > 1:
        starts.append((merged(t, weight, order), False))
        if order > 3:
            starts.append((merged(t, weight, order - 1), True))
    if order > 3:
        span = problem.high - problem.low
        starts.append((problem.low + span * (np.arange(order) + 0.5) / order, False))
    return distinct(problem.search(starts))


def distinct(found: list[Candidate]) -> list[Candidate]:
    """Best first, without repetitions."""
    kept: list[Candidate] = []
    for candidate in sorted(found, key=lambda c: c.cost):
        if not any(_same(candidate, other) for other in kept):
            kept.append(candidate)
    return kept


def _same(a: Candidate, b: Candidate) -> bool:
    if (a.c > 0) != (b.c > 0):
        return False
    ta, tb = a.log_tau[a.k > 0], b.log_tau[b.k > 0]
    return ta.size == tb.size and bool(np.all(np.abs(ta - tb) < 0.02))


def _subsets(problem: LinearProblem, order: int) -> list[tuple[Float, bool]]:
    decades = (problem.high - problem.low) / np.log(10)
    count = int(min(max(np.ceil(PER_DECADE * decades), 6), MOST))
    grid = np.linspace(problem.low, problem.high, count)
    columns = np.vstack([problem.ends[:1], problem.columns(grid)[0], problem.ends[1:]])
    scale = np.sqrt(np.einsum("ij,ij->i", columns, columns))
    scale[scale == 0] = 1.0
    columns = columns / scale[:, None]
    gram = columns @ columns.T
    gram[np.diag_indices_from(gram)] += 1e-13
    right = columns @ problem.target
    chosen = np.array(list(combinations(range(1, columns.shape[0]), order)))
    best: list[tuple[float, tuple[int, ...]]] = []
    for with_spring in (True, False):
        index = np.hstack([np.zeros((len(chosen), 1), dtype=int), chosen]) if with_spring else chosen
        x = np.linalg.solve(gram[index[:, :, None], index[:, None, :]], right[index][:, :, None])[:, :, 0]
        cost = np.where((x >= 0).all(axis=1), -(x * right[index]).sum(axis=1), np.inf)
        for i in np.argsort(cost)[: 8 * KEEP]:
            if np.isfinite(cost[i]):
                best.append((float(cost[i]), tuple(int(j) for j in chosen[i])))
    best.sort()
    kept: list[tuple[int, ...]] = []
    for _, subset in best:
        if len(kept) < KEEP and not any(max(abs(a - b) for a, b in zip(subset, k, strict=True)) <= 1 for k in kept):
            kept.append(subset)
    last = columns.shape[0] - 1
    return [(grid[[i - 1 for i in subset if i != last]], last in subset) for subset in kept]


def _one_more(problem: LinearProblem, lower: Candidate, order: int) -> list[tuple[Float, bool]]:
    """The lower order's arms and one more at each grid point: the best two places, and a dashpot if there is none."""
    kept = lower.log_tau[lower.k > 0]
    dashpot = lower.c > 0
    if kept.size + dashpot >= order:
        return []
    fixed = np.vstack([problem.ends[:1], problem.columns(kept)[0], *([problem.ends[1:]] if dashpot else [])])
    grid = problem.grid[:: max(1, problem.grid.size // 30)]
    cost = np.array([solve(np.vstack([fixed, c]).T, problem.target)[1] for c in problem.columns(grid)[0]])
    first = int(np.argmin(cost))
    far = np.where(np.abs(np.arange(grid.size) - first) > 3, cost, np.inf)
    starts = [(np.append(kept, grid[first]), dashpot), (np.append(kept, grid[int(np.argmin(far))]), dashpot)]
    if not dashpot:
        starts.append((kept, True))
    return starts
