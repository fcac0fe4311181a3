r"""Nonlinear least squares within bounds: the one search behind relaxation fits, static forces, diagnoses and oscillators.

*Problem.* Find x (P,) that makes

    χ²(x) = Σ r_m(x)²,   low ≤ x ≤ high

least, for residuals r (M,) that are smooth in x and best counted in standard deviations. Entries with equal bounds
stay where they are. What is known of x beforehand is more rows of the residual (`with_prior`), an equation between
entries a linear change of variables (`tie`).

*Step.* With the Jacobian J (M, P), the gradient g = Jᵀr and D the diagonal of JᵀJ, Levenberg's and Marquardt's step
solves

    (JᵀJ + μ D) δ = −g

over the entries that are free. D is the scale of Marquardt [2] and Moré [3]: the step does not depend on the entries'
units. No entry goes further than `Options.longest`, for entries are logarithms or are scaled to their range, and no
quadratic form describes anything that far away; nor beyond its bound. The entry that would go furthest beyond is put
onto its limit and the others are solved for again beside it, until none is beyond: an entry that hardly matters, whose
step is long because nothing is known of it, does not shorten the steps of the others. A step that these limits turn
uphill is damped until it is none: in the end each entry goes down its own slope.

*Damping.* A step that lowers χ² is taken and multiplies μ by 1 − (2ρ − 1)³, between 1/`ease` and 2, ρ the fall over
what the quadratic model had expected (Nielsen [4]); one that does not is forgotten and multiplies μ by `stiffen`, so
that the next success does not lead straight back to a step that failed [5]. A search that goes on keeps its μ.

*Bounds.* An entry that lies at a bound which the gradient pushes it against is held; the others step without it. For a
small enough step, which damping ends in, that is a descent (Bertsekas' projection [6], for least squares [7]); no
residual is ever asked for outside.

*Jacobian.* Either the problem gives it with each residual, or it is taken by forward differences of all entries in
one evaluation (backward at an upper bound). A search that begins with a Jacobian from nearby lets Broyden's secants
[8] bring it up to date, and takes differences anew where a step falls by less or more than that Jacobian had expected,
or where a second, shorter step fails as well.

*Stop.* A fall of χ² below `fall`, or below `share` of χ², ends a search (`converged`); so does a step that fails
while it promises no more, or that is `still`. Where the problem gives the Jacobian, such a step is not even tried
unless it is damped more than the first one was. −g·δ, what a step promises, is the fall of the quadratic model but for
a term of μ that vanishes at the end. A search also ends, not converged, after `most` steps and at a damping of
`hopeless`. χ² never rises, and nothing is raised: what does not converge says so.

*Side by side.* Searches of one kind go step by step together, so that one evaluation serves all of them; each takes
the steps that it would take alone. In a race, those that are behind after so many rounds are dropped where they are.

*scipy.* `tests/benchmarks/bench_least_squares.py` has this search and `scipy.optimize.least_squares` on every use, in
one run. scipy's has no secants, no evaluation of several problems in one call and no race, which are what refits,
oscillators and relaxation times live on. Fits of relaxation models take it between less time and twice as much: its
trust region needs fewer steps where a problem is badly determined or starts far away, a step of this search costs less.
A bent valley, in which damped steps fall by little, makes this search stop where scipy's goes on.

References
----------
1. K. Levenberg, "A method for the solution of certain non-linear problems in least squares", Quart. Appl. Math. 2
   (1944) 164.
2. D. W. Marquardt, "An algorithm for least-squares estimation of nonlinear parameters", J. SIAM 11 (1963) 431.
3. J. J. Moré, "The Levenberg–Marquardt algorithm: implementation and theory", Lecture Notes in Math. 630 (1978) 105.
4. H. B. Nielsen, "Damping parameter in Marquardt's method", report IMM-REP-1999-05, Technical University of Denmark
   (1999).
5. M. K. Transtrum, J. P. Sethna, "Improvements to the Levenberg–Marquardt algorithm for nonlinear least-squares
   minimization", arXiv:1201.5885 (2012).
6. D. P. Bertsekas, "Projected Newton methods for optimization problems with simple constraints", SIAM J. Control
   Optim. 20 (1982) 221.
7. C. Kanzow, N. Yamashita, M. Fukushima, "Levenberg–Marquardt methods with strong local convergence properties for
   solving nonlinear equations with convex constraints", J. Comput. Appl. Math. 172 (2004) 375.
8. C. G. Broyden, "A class of methods for solving nonlinear simultaneous equations", Math. Comp. 19 (1965) 577.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from schemas.arrays import Bool, Float, Int

Residuals: TypeAlias = Callable[[Float], Float]
"""Residuals (B, M) of several x (B, P)."""
Evaluate: TypeAlias = Callable[[Float, Int], tuple[Float, Float | None]]
"""Residuals (K, M) and Jacobians (K, M, P) of points (K, P) of the problems (K,); None: Jacobians are to be taken by
differences."""

DAMPING, LEAST_DAMPING = 1e-3, 1e-9
_RIDGE = 1e-10
"""Relative to the diagonal of JᵀJ: what a direction without information counts for in a covariance."""
_TINY = 1e-300
"""What a fall that is expected counts for at least, so that it divides."""
_FORWARD, _CENTRAL = 1e-4, 3e-4


@dataclass(frozen=True)
class Options:
    """When a search ends, and how far it steps.

    Parameters
    ----------
    fall, share : fall of χ² that is not worth another step, and the same as a share of χ². The default is far
        below what statistics can tell: residuals are in standard deviations
    most : trial steps
    still : longest entry of a failing step at which a search ends
    damping : μ to begin with, relative to what the data say of each entry alone
    ease, stiffen : what μ is divided by at most after a step that is taken, and multiplied by after one that is not
    least, hopeless : μ below which it does not fall, and above which a search ends
    longest : most that a step changes an entry by
    curvature : least diagonal of JᵀJ that damping is relative to: an entry without any influence stays
    difference : step of the forward differences
    race : pairs of rounds and how many searches, those of least χ², go on after that
    kept, straight : fall over expected fall within which columns are good enough, and within which a secant says well
        enough what has changed of the columns that are renewed as a search goes
    thorough : whether the end is confirmed with a Jacobian of its own where secants were used
    """

    fall: float = 0.02
    share: float = 0.0
    most: int = 25
    still: float = 1e-7
    damping: float = DAMPING
    ease: float = 5.0
    stiffen: float = 10.0
    least: float = LEAST_DAMPING
    hopeless: float = 1e7
    longest: float = 1.5
    curvature: float = 1e-9
    difference: float = _FORWARD
    race: tuple[tuple[int, int], ...] = ()
    kept: tuple[float, float] = (0.4, 1.6)
    straight: tuple[float, float] = (0.8, 1.25)
    thorough: bool = True


@dataclass(frozen=True)
class Solution:
    """Where a search ended.

    x : (P,) entries; residual (M,); jacobian (M, P) of the residual there, or where the last step began
    chi2 : sum of squares; converged: whether the last fall was below the tolerance
    fresh : whether the Jacobian is that at x, by differences and with no secant in it
    damping : μ with which a search goes on
    """

    x: Float
    residual: Float
    jacobian: Float
    chi2: float
    converged: bool
    fresh: bool = False
    damping: float = DAMPING

    @property
    def covariance(self) -> Float:
        """(P, P), by a scaled pseudo-inverse: directions without information have huge variances, not infinite ones."""
        inner, scale = self._scaled_information
        return np.asarray(np.linalg.inv(inner) / np.outer(scale, scale))

    @property
    def information(self) -> Float:
        """(P, P) whose inverse the covariance is, without the rounding of two inversions: with entries that hardly anything is known of
        beside others known to many digits, the inverse of the covariance need not even be positive."""
        inner, scale = self._scaled_information
        return np.asarray(inner * np.outer(scale, scale))

    @property
    def _scaled_information(self) -> tuple[Float, Float]:
        normal = self.jacobian.T @ self.jacobian
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-12))
        return normal / np.outer(scale, scale) + _RIDGE * np.eye(scale.size), scale


def find_marginal_root(information: Float, kept: Bool) -> Float:
    """(K, K) R with Rᵀ R = what is known of the entries `kept` (P,) where the others may be anything: the Schur complement of those.

    Parameters
    ----------
    information : (P, P) inverse of a covariance, positive definite but for rounding
    """
    scale = np.sqrt(np.diag(information))
    inner = information / np.outer(scale, scale)
    other = ~kept
    across = inner[np.ix_(kept, other)]
    left = inner[np.ix_(kept, kept)] - across @ np.linalg.solve(inner[np.ix_(other, other)], across.T)
    values, vectors = np.linalg.eigh((left + left.T) / 2)
    return np.asarray(np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T * scale[kept])


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
    damping: float | None = None,
) -> Solution:
    """The least sum of squares of one problem, with Jacobians by differences and secants.

    Parameters
    ----------
    residuals : (B, M) of several x (B, P)
    start : entries (P,), or where an earlier search of the same residuals ended, to go on from
    low, high : bounds (P,); entries with equal bounds stay
    most, thorough, damping : as in `Options`; without a damping it is the usual one, or that of a search that goes on before its end
    jacobian : (M, P) one from nearby to begin with; its columns from `moving` on are renewed as the search goes, all of
        them where a step fails. Without, all are renewed at every step

    Returns
    -------
    Where the search ended. It never fails: one that does not converge says so.
    """
    if damping is None:
        damping = start.damping if isinstance(start, Solution) and not start.converged else DAMPING
    options = Options(most=most, thorough=thorough, damping=damping)
    search = _Search(start, low, high, options, jacobian, moving)
    _go_together([search], lambda points, _: (residuals(points), None), ())
    return search.solution


def minimise_each(
    evaluate: Evaluate, starts: Sequence[Float], low: Float, high: Float, options: Options | None = None
) -> list[Solution]:
    """The least sums of squares of several problems side by side, or of one from several starts.

    Parameters
    ----------
    evaluate : residuals (K, M), and Jacobians (K, M, P) or None, of points (K, P) that belong to the problems
        (K,), numbers into `starts`
    starts : B starts (P,)
    low, high : bounds (P,) of all problems, or (B, P) of each
    options : see there

    Returns
    -------
    Where each search ended, in the order of the starts.
    """
    options = options or Options()
    shape = len(starts), len(starts[0]) if len(starts) else 0
    lows, highs = np.broadcast_to(low, shape), np.broadcast_to(high, shape)
    searches = [_Search(x, a, b, options) for x, a, b in zip(starts, lows, highs, strict=True)]
    _go_together(searches, evaluate, options.race)
    return [search.solution for search in searches]


def with_prior(evaluate: Evaluate, mean: Float, root: Float) -> Evaluate:
    """The same problem with what is known of x: rows root (Q, P) @ (x − mean), in standard deviations."""

    def known(points: Float, problems: Int) -> tuple[Float, Float | None]:
        residual, jacobian = evaluate(points, problems)
        residual = np.concatenate([residual, (points - mean) @ root.T], axis=1)
        if jacobian is not None:
            jacobian = np.concatenate([jacobian, np.broadcast_to(root, (len(points), *root.shape))], axis=1)
        return residual, jacobian

    return known


def differ_at_once(residuals: Residuals) -> Callable[[object, Iterable[Float]], Iterable[Float]]:
    """`workers` of scipy's `least_squares`: all differences of a Jacobian by one evaluation of residuals (B, M) of several x (B, P)."""
    return lambda _, points: residuals(np.array(list(points)))


def tie(evaluate: Evaluate, origin: Float, directions: Float) -> Evaluate:
    """The problem over u (Q,) for x = origin (P,) + directions (P, Q) @ u."""

    def tied(points: Float, problems: Int) -> tuple[Float, Float | None]:
        residual, jacobian = evaluate(origin + points @ directions.T, problems)
        return residual, None if jacobian is None else jacobian @ directions

    return tied


def central(residuals: Residuals, x: Float, low: Float, high: Float) -> Float:
    """(M, P) Jacobian by central differences of residuals (B, M) of several x (B, P): what is projected off must not leave
    its own error behind."""
    step = _CENTRAL * np.eye(x.size)[:, low < high].T
    up, down = np.minimum(x + step, high), np.maximum(x - step, low)
    seen = residuals(np.concatenate([up, down]))
    width = np.sum(up - down, axis=1)
    columns = np.zeros((seen.shape[1], x.size))
    columns[:, low < high] = ((seen[: len(up)] - seen[len(up) :]) / np.maximum(width, _TINY)[:, None]).T
    return columns


_Answer: TypeAlias = tuple[Float, Float | None]
_Asking: TypeAlias = Generator[Float, _Answer, None]
"""A search, or a part of one, that asks for residuals: it yields points (K, P) and is sent their residuals and
Jacobians."""


def _go_together(searches: Sequence[_Search], evaluate: Evaluate, race: Sequence[tuple[int, int]]) -> None:
    """All searches to their ends, with one evaluation a round of what they ask for."""
    running = {number: search.run() for number, search in enumerate(searches)}
    asked = {number: points for number, run in running.items() if (points := next(run, None)) is not None}
    places = dict(race)
    rounds = 0
    while asked:
        numbers, counts = list(asked), [len(points) for points in asked.values()]
        residual, jacobian = evaluate(np.concatenate(list(asked.values())), np.repeat(numbers, counts))
        asked, first = {}, 0
        for number, count in zip(numbers, counts, strict=True):
            mine = slice(first, first + count)
            first += count
            try:
                asked[number] = running[number].send((residual[mine], None if jacobian is None else jacobian[mine]))
            except StopIteration:
                continue
        rounds += 1
        if rounds in places:
            ahead = sorted(range(len(searches)), key=lambda number: searches[number].chi2)[: places[rounds]]
            asked = {number: points for number, points in asked.items() if number in ahead}


class _Search:
    """One search: where it is, how it steps, and what it asks for."""

    def __init__(
        self,
        start: Float | Solution,
        low: Float,
        high: Float,
        options: Options,
        lent: Float | None = None,
        moving: int = 0,
    ) -> None:
        self.low, self.high, self.options = low, high, options
        self.everything = np.flatnonzero(low < high)
        self.moving = self.everything[self.everything >= moving]
        self.damping = options.damping
        self.converged = False
        self.begun = isinstance(start, Solution)
        if isinstance(start, Solution):
            self.x, self.residual, self.chi2, self.jacobian = start.x, start.residual, start.chi2, start.jacobian.copy()
        else:
            self.x, self.residual, self.chi2 = np.clip(start, low, high), np.zeros(0), np.inf
            self.jacobian = np.zeros((0, self.x.size)) if lent is None else lent.copy()
        self.lent = self.begun or lent is not None
        self.fresh = start.fresh if isinstance(start, Solution) else not self.lent
        """Whether no secant and no lent column is in the Jacobian."""
        self.exact = False
        """Whether the problem itself gives the Jacobian."""
        self.behind = False
        """Whether the columns that are renewed as the search goes are not those of where it is."""
        self.refused = False
        """Whether the last step was refused, with these columns."""

    @property
    def solution(self) -> Solution:
        """Where the search is."""
        return Solution(self.x, self.residual, self.jacobian, self.chi2, self.converged, self.fresh, self.damping)

    @property
    def enough(self) -> float:
        """Fall of χ² that is not worth another step."""
        return max(self.options.fall, self.options.share * self.chi2)

    def run(self) -> _Asking:
        """The search from its start to its end."""
        if not self.begun:
            yield from self._begin()
        if not np.isfinite(self.chi2):
            return
        for _ in range(self.options.most):
            gradient = self.jacobian.T @ self.residual
            free = self._free(gradient)
            if free.size == 0:
                self.converged = True
                break
            move = self._step(gradient, free)
            while (expected := self._expect(gradient, move)) < -np.finfo(np.float64).eps * self.chi2:
                # Several limits at once may turn a step uphill; with more damping it goes down each entry's own slope.
                self.damping *= self.options.stiffen
                move = self._step(gradient, free)
            promised = -float(move @ gradient)
            if self.exact and promised < self.enough and self.damping <= self.options.damping:
                self.converged = True
                break
            trial = np.clip(self.x + move, self.low, self.high)
            residual, jacobian = yield trial[None]
            chi2 = float(residual[0] @ residual[0])
            if np.isfinite(chi2) and chi2 < self.chi2:
                yield from self._take(trial, residual[0], chi2, expected, None if jacobian is None else jacobian[0])
            else:
                yield from self._refuse(move, promised)
            if self.converged or self.damping > self.options.hopeless:
                break
        if self.behind:
            yield from self._renew(self.moving)

    def _begin(self) -> _Asking:
        residual, jacobian = yield self.x[None]
        with np.errstate(over="ignore"):  # a start as far off as that is taken for hopeless below
            self.residual, self.chi2 = residual[0], float(residual[0] @ residual[0])
        if not self.lent:
            self.jacobian = np.zeros((self.residual.size, self.x.size))
        if not np.isfinite(self.chi2):
            self.jacobian, self.chi2 = np.zeros_like(self.jacobian), np.inf
        elif jacobian is not None:
            self.jacobian, self.exact = jacobian[0], True
        else:
            yield from self._renew(self.moving if self.lent else self.everything)

    def _free(self, gradient: Float) -> Int:
        """Entries that no bound holds."""
        held = ((self.x <= self.low) & (gradient > 0)) | ((self.x >= self.high) & (gradient < 0))
        return self.everything[~held[self.everything]]

    def _step(self, gradient: Float, free: Int) -> Float:
        """(P,) the damped step within the bounds, no entry of which is longer than the longest.

        What an entry would do beyond its limit, those that are left make up for: one of next to no influence, whose step is long
        because nothing is known of it, does not shorten the steps of all others.
        """
        normal = self.jacobian.T @ self.jacobian
        damped = normal + self.damping * np.diag(np.maximum(np.diag(normal), self.options.curvature))
        low = np.maximum(self.low - self.x, -self.options.longest)
        high = np.minimum(self.high - self.x, self.options.longest)
        move = np.zeros(gradient.size)
        while free.size:
            move[free] = 0.0
            pull = gradient[free] + normal[free] @ move
            move[free] = -np.linalg.solve(damped[np.ix_(free, free)], pull)
            beyond = np.maximum(move[free] - high[free], low[free] - move[free])
            worst = int(np.argmax(beyond))
            if beyond[worst] <= 0:
                break
            move[free[worst]] = np.clip(move[free[worst]], low[free[worst]], high[free[worst]])
            free = np.delete(free, worst)
        return move

    def _expect(self, gradient: Float, move: Float) -> float:
        """Fall of χ² for a step (P,), in the quadratic model −2 g·δ − |J δ|²."""
        along = self.jacobian @ move
        return float(-2 * (move @ gradient) - along @ along)

    def _take(self, trial: Float, residual: Float, chi2: float, expected: float, jacobian: Float | None) -> _Asking:
        """On to a point of lower χ², and the Jacobian there."""
        fall, enough = self.chi2 - chi2, self.enough
        if jacobian is not None:
            self.jacobian = jacobian
        elif self.lent and self.moving.size:
            self.jacobian += _secant(self.jacobian, trial - self.x, residual - self.residual)
        self.x, self.residual, self.chi2 = trial, residual, chi2
        self.damping = max(self.damping * self._ease(fall / max(expected, _TINY)), self.options.least)
        self.behind, self.refused = self.lent, False
        if fall < enough and (self.fresh or not self.options.thorough):
            self.converged, self.fresh = True, False
        elif jacobian is None:
            self.fresh = not self.lent or fall < enough or not _within(fall, expected, self.options.kept)
            if self.fresh or not _within(fall, expected, self.options.straight):
                yield from self._renew(self.everything if self.fresh else self.moving)

    def _refuse(self, move: Float, promised: float) -> _Asking:
        """A step that did not lower χ²: the end, or old columns are to blame, or it was too long."""
        little = promised < self.enough
        stale = not self.fresh and not (little and not self.options.thorough)
        if stale and (little or self.refused):
            # A shorter step failed as well: it is the columns.
            self.fresh, self.refused = True, False
            yield from self._renew(self.everything)
        elif little or float(np.abs(move).max()) < self.options.still:
            # What is promised that little and does not come is the end as well.
            self.converged = True
        else:
            self.damping *= self.options.stiffen
            self.refused = True

    def _ease(self, ratio: float) -> float:
        """What damping is multiplied by after a step that fell by `ratio` times what the quadratic model has expected (Nielsen 1999)."""
        return float(np.clip(1 - (2 * ratio - 1) ** 3, 1 / self.options.ease, 2.0))

    def _renew(self, places: Int) -> _Asking:
        """Columns of the Jacobian taken anew by differences, backward at an upper bound."""
        self.behind = False
        if places.size:
            step = _forward(self.x[places], self.high[places], self.options.difference)
            moved = np.tile(self.x, (places.size, 1))
            moved[np.arange(places.size), places] += step
            seen, _ = yield moved
            self.jacobian[:, places] = ((seen - self.residual) / step[:, None]).T


def _forward(x: Float, high: Float, size: float) -> Float:
    """Steps of forward differences, backward at an upper bound."""
    return np.where(x + size <= high, size, -size)


def _within(fall: float, promised: float, limits: tuple[float, float]) -> bool:
    return limits[0] * promised < fall < limits[1] * promised


def _secant(jacobian: Float, move: Float, change: Float) -> Float:
    """(M, P) least change of a Jacobian with which a step (P,) changes the residual as it did."""
    return np.outer(change - jacobian @ move, move / (move @ move))
