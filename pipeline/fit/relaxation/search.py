"""One order at a time: from candidates to the optimum of the forward model, and what the optimum's arms are.

An optimum may have fewer arms than were asked for (a spring at 0, two arms at one place, a relaxation time at its bound), or
an arm whose spring the data cannot tell from a rigid one: a pure dashpot. Both are made explicit here, so that no number is
ever printed for what is not determined. Does not belong here: intervals and the choice between orders.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pipeline.fit.relaxation.forward import GaussianPrior, Solution, polish
from pipeline.fit.relaxation.intervals import PARABOLIC, covariance
from pipeline.fit.relaxation.linear import Linearisation
from pipeline.fit.relaxation.observations import Observations
from pipeline.fit.relaxation.order import expansion_at
from pipeline.fit.relaxation.reference import Reference
from pipeline.fit.relaxation.results import LUMPED
from pipeline.fit.relaxation.starts import candidates
from pipeline.fit.relaxation.varpro import MERGE, Candidate, LinearProblem, bounds
from pipeline.physics.film import Shape
from schemas.arrays import Float

DASHPOT_GAIN = 0.3
"""χ² that a finite spring must gain over a rigid one. Small: whether a spring is resolved is for its interval to say; a model that
has lost it wrongly biases all other parameters."""
MERGE_GAIN = 1.0
GONE = 1e-7
"""Share of the total stiffness below which a spring counts as gone."""
POLISHED = 2


@dataclass(frozen=True)
class OrderFit:
    """The optimum of one order. `notes` says what became of arms that the data do not carry.

    `chi2` is that of the optimum itself, for the order test; `solution` is what is reported, with arms that cannot be told from
    something simpler replaced by that.
    """

    order: int
    solution: Solution
    candidate: Candidate
    chi2: float
    notes: tuple[str, ...]


class Search:
    """Fits one order after the other to the same observations."""

    def __init__(self, reference: Reference) -> None:
        self.reference = reference
        self.observations = reference.observations
        self.bounds = bounds(*self.observations.omega_range)
        self.problem = LinearProblem(Linearisation(self.observations, reference.expansion()), *self.bounds)
        active = reference.x[1:-1] > 0
        weight = reference.x[1:-1][active]
        self.spectrum = np.log(reference.tau[active]), weight

    def spring_only(self) -> Solution:
        """Order 0: no relaxation at all."""
        x = max(float(np.abs(self.reference.x[:-1]).sum()), 1e-9)
        start = np.append(np.log(x), self.reference.q)
        return polish(self.observations, start, Shape(0), self.bounds, tolerance=1e-2)

    def order(self, order: int, lower: OrderFit | None) -> OrderFit:
        """The best model with at most `order` arms, a pure dashpot counting as one."""
        dispersion = self.reference.dispersion
        found = self._polished(self.problem, order, lower, self.reference.q)
        best_candidate, best = found
        if best.chi2 > 1.02 * best_candidate.cost + 2 * dispersion:
            # the expansion about the best relaxation of any order is too far from this order's optimum: expand there
            problem = LinearProblem(
                Linearisation(self.observations, expansion_at(self.observations, best)), *self.bounds
            )
            again = self._polished(problem, order, lower, best.q)
            if again[1].chi2 < best.chi2:
                best_candidate, best = again
        chi2 = best.chi2
        best, notes = self._tidy(best, order)
        if lower is not None and lower.chi2 <= chi2 + 1e-6:
            # nothing gained by the additional arm
            chi2, best, best_candidate = lower.chi2, lower.solution, lower.candidate
            notes = tuple(n for n in lower.notes if not n.startswith("only")) + _fewer(best.shape, order)
        return OrderFit(order, best, best_candidate, min(chi2, best.chi2), notes)

    def _polished(
        self, problem: LinearProblem, order: int, lower: OrderFit | None, q: Float
    ) -> tuple[Candidate, Solution]:
        found = candidates(problem, order, lower.candidate if lower else None, self.spectrum)
        kept = [c for c in found if c.cost <= found[0].cost + 20 * self.reference.dispersion][:POLISHED]
        solutions = [(c, self._polish(c, q)) for c in kept]
        return min(solutions, key=lambda pair: pair[1].chi2)

    def _polish(self, candidate: Candidate, q: Float) -> Solution:
        used = candidate.k > 0
        shape = Shape(int(used.sum()), candidate.k0 > 0, candidate.c > 0)
        if shape.size == 0:
            shape, theta = Shape(0), np.array([-20.0])
        else:
            theta = shape.join(candidate.k0, candidate.k[used], np.exp(candidate.log_tau[used]), candidate.c)
        return polish(self.observations, np.concatenate([theta, q]), shape, self.bounds)

    def _tidy(self, solution: Solution, order: int) -> tuple[Solution, tuple[str, ...]]:
        solution, notes = tidy(self.observations, solution, self.bounds, self.reference.dispersion)
        return solution, notes + _fewer(solution.shape, order)


def _fewer(shape: Shape, order: int) -> tuple[str, ...]:
    if shape.order >= order:
        return ()
    if shape.order == 0:
        return (f"none of {order} arms resolved" if order > 1 else "its one arm is not resolved",)
    return (f"only {shape.order} of {order} arms resolved",)


def tidy(
    observations: Observations,
    solution: Solution,
    log_tau_bounds: tuple[float, float],
    dispersion: float,
    prior: GaussianPrior | None = None,
) -> tuple[Solution, tuple[str, ...]]:
    """Drops arms that are gone, merges arms at one place, turns arms at a bound into what they are there.

    Arms come out ordered by relaxation time, longest first. The notes name what was done.
    """
    notes: list[str] = []
    for _ in range(2 * solution.shape.order + 2):
        changed = _smaller(solution, log_tau_bounds)
        if changed is None:
            break
        theta, shape, note, price = changed
        trial = polish(observations, np.concatenate([theta, solution.q]), shape, log_tau_bounds, prior=prior)
        if trial.chi2 - solution.chi2 > price * dispersion:
            break
        solution = trial
        if note:
            notes.append(note)
    rigid = _rigid_fastest(solution, dispersion, observations.rows)
    if rigid is not None:
        theta, shape = rigid
        trial = polish(observations, np.concatenate([theta, solution.q]), shape, log_tau_bounds, prior=prior)
        if trial.chi2 - solution.chi2 < DASHPOT_GAIN * dispersion:
            solution = trial
    if solution.shape.dashpot:
        notes.append(f"arm {solution.shape.order} is a pure dashpot: its spring cannot be told from a rigid one")
    if not solution.shape.spring:
        notes.append("k0 at its bound 0")
    return _sorted(solution), tuple(dict.fromkeys(notes))


def _smaller(solution: Solution, log_tau_bounds: tuple[float, float]) -> tuple[Float, Shape, str, float] | None:
    """A start for a smaller model where this one has something that is not determined; None where all is well."""
    shape = solution.shape
    k0, k, tau, c = shape.split(solution.theta)
    total = k0 + k.sum()
    if shape.arms and k.min() < GONE * total:
        keep = np.arange(k.size) != k.argmin()
        return _built(k0, k[keep], tau[keep], c, "", 1.0)
    if shape.arms:
        i = int(tau.argmin())
        rest = np.arange(k.size) != i
        if np.log(tau[i]) <= log_tau_bounds[0] + 1e-3:
            return _built(k0, k[rest], tau[rest], c + float(k[i] * tau[i]), "", 1.0)
        i = int(tau.argmax())
        rest = np.arange(k.size) != i
        if np.log(tau[i]) >= log_tau_bounds[1] - 1e-3:
            return _built(k0 + float(k[i]), k[rest], tau[rest], c, LUMPED, np.inf)
    if shape.arms > 1:
        order = np.argsort(tau)
        gaps = np.diff(np.log(tau[order]))
        i = int(gaps.argmin())
        if gaps[i] < MERGE:
            a, b = order[i], order[i + 1]
            kept = [j for j in range(k.size) if j not in (a, b)]
            both = k[a] + k[b]
            place = np.exp((k[a] * np.log(tau[a]) + k[b] * np.log(tau[b])) / both)
            return _built(k0, np.append(k[kept], both), np.append(tau[kept], place), c, "", MERGE_GAIN)
    if shape.spring and shape.order and k0 < GONE * total:
        return _built(0.0, k, tau, c, "", 1.0)
    return None


def _built(k0: float, k: Float, tau: Float, c: float, note: str, price: float) -> tuple[Float, Shape, str, float]:
    shape = Shape(k.size, k0 > 0, c > 0)
    return shape.join(k0, k, tau, c), shape, note, price


def _rigid_fastest(solution: Solution, dispersion: float, rows: int) -> tuple[Float, Shape] | None:
    """The same model with the fastest arm's spring rigid; None where its curvature says that it is well resolved."""
    if solution.shape.dashpot or not solution.shape.arms:
        return None
    k0, k, tau, _ = solution.shape.split(solution.theta)
    i = int(tau.argmin())
    place = int(solution.shape.spring) + i
    if np.sqrt(covariance(solution, dispersion, rows)[place, place]) < PARABOLIC:
        return None
    rest = np.arange(k.size) != i
    theta, shape, _, _ = _built(k0, k[rest], tau[rest], float(k[i] * tau[i]), "", 0.0)
    return theta, shape


def _sorted(solution: Solution) -> Solution:
    shape = solution.shape
    a, n = int(shape.spring), shape.arms
    order = np.argsort(-solution.theta[a + n : a + 2 * n])
    index = np.arange(solution.theta.size)
    index[a : a + n], index[a + n : a + 2 * n] = a + order, a + n + order
    return Solution(solution.theta[index], shape, solution.chi2, solution.residual, solution.jacobian[:, index])
