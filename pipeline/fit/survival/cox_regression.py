"""Cox's proportional hazards with covariates: the check of a life regression that assumes no distribution.

Ties by Efron's approximation or exactly (the discrete model); specimens may come under watch late, and may have weights that
change with time, as the model of Fine and Gray needs (`cause_regression`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.fit.survival.covariates import Design
from pipeline.fit.survival.kaplan_meier import Estimate, Z
from pipeline.fit.survival.lifetime_distributions import Lives
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError

EFRON, EXACT = "efron", "exact"
_ITERATIONS = 50
_FAR = 25.0
"""|coefficient · standard deviation of its column| beyond which a hazard ratio is on its way to infinity."""

_Parts = tuple[float, Float, Float]
"""Log partial likelihood, its gradient (p,) and the information (p, p)."""


@dataclass(frozen=True)
class HazardEffect:
    """Change of ln hazard per unit of a column, with 95 % limits from the information, and Wald's p-value."""

    name: str
    value: Estimate
    standard_error: float
    p_value: float


@dataclass(frozen=True)
class CoxRegression:
    """A fitted Cox model. `likelihood_ratio` is twice the gain over no effect at all, `p_value` its χ² probability."""

    effects: tuple[HazardEffect, ...]
    ties: str
    log_likelihood: float
    likelihood_ratio: float
    p_value: float
    specimens: int
    failures: int
    covariance: Float


def fit_cox(lives: Lives, design: Design, ties: str = EFRON) -> CoxRegression:
    """Cox regression of lives on a design.

    Parameters
    ----------
    lives : n lives, exact or right-censored, in any unit; they may have come under watch late
    design : n rows
    ties : `EFRON` or `EXACT`

    Raises
    ------
    NotIdentifiableError
        A life is only known to lie between inspections, nobody failed, or the covariates tell the order of the failures
        completely (separation).

    Notes
    -----
    B. Efron, J. Am. Stat. Assoc. 72 (1977) 557; exact ties are those of D. R. Cox, J. R. Stat. Soc. B 34 (1972) 187, by the
    recursion of M. Gail and others, Biometrika 68 (1981) 703.
    """
    failed = lives.exact
    if not (failed | np.isposinf(lives.upper)).all():
        raise NotIdentifiableError(
            "Cox's model has no order of failures that are only known to lie between inspections",
            expected="exact and right-censored lives",
            remedy="The regression with a distribution takes them",
        )
    entered = np.full(failed.size, -np.inf) if lives.entered is None else lives.entered
    scale = np.where(design.x.std(axis=0) > 0, design.x.std(axis=0), 1.0)
    x = (design.x - design.x.mean(axis=0)) / scale
    sums = (lives.lower, failed, entered, x)
    parts = _exact(*sums) if ties == EXACT else RiskSums(*sums).parts
    return solve_partial_likelihood(parts, design.names, scale, ties, failed)


def solve_partial_likelihood(
    parts: Callable[[Float], _Parts], names: tuple[str, ...], scale: Float, ties: str, failed: Bool
) -> CoxRegression:
    """The maximum of a concave partial likelihood of columns that were divided by `scale` (p,). Raises as `fit_cox`."""
    if not failed.any():
        raise NotIdentifiableError("nobody failed: no hazard", expected="at least one failure")
    beta = np.zeros(len(names))
    start, gradient, information = parts(beta)
    value = start
    for _ in range(_ITERATIONS):
        step = np.linalg.lstsq(information, gradient, rcond=1e-12)[0]
        for _ in range(40):
            trial = parts(beta + step)
            if trial[0] >= value - 1e-12 * abs(value):
                break
            step = step / 2
        beta, gain = beta + step, trial[0] - value
        value, gradient, information = trial
        if (np.abs(beta) > _FAR).any():
            worst = names[int(np.argmax(np.abs(beta)))]
            raise NotIdentifiableError(
                f"{worst} tells the order of the failures completely (separation): its hazard ratio has no finite estimate"
            )
        if np.abs(step).max(initial=0.0) < 1e-10 or (gain < 1e-13 * abs(value) and np.abs(gradient).max() < 1e-9):
            break
    eigenvalues = np.linalg.eigvalsh(information)
    if eigenvalues.size and eigenvalues[0] <= 1e-9 * max(float(eigenvalues[-1]), 1e-9):
        raise NotIdentifiableError(
            "the failures tell nothing about a covariate (separation, or nobody left to compare with)"
        )
    covariance = np.linalg.inv(information) / np.outer(scale, scale)
    errors = np.sqrt(np.diag(covariance))
    effects = tuple(
        HazardEffect(
            name,
            Estimate(float(b), float(b - Z * se), float(b + Z * se)),
            float(se),
            float(special.chdtrc(1, (b / se) ** 2)),
        )
        for name, b, se in zip(names, beta / scale, errors, strict=True)
    )
    ratio = max(2 * (value - start), 0.0)
    return CoxRegression(
        effects,
        ties,
        value,
        ratio,
        float(special.chdtrc(len(names), ratio)) if names else float("nan"),
        failed.size,
        int(failed.sum()),
        covariance,
    )


class RiskSums:
    """Efron's sums over those at risk by differences of cumulative sums: of who has not ended, less who has not begun.

    At risk at t: entered < t ≤ end. `times` (d,) is when each of the d failures came, in order.
    """

    def __init__(self, time: Float, failed: Bool, entered: Float, x: Float) -> None:
        self.x, self.failed, self.entered = x, failed, entered
        times, self.place = np.unique(time[failed], return_inverse=True)
        self.ending, self.beginning = np.argsort(time), np.argsort(entered)
        self.gone = np.searchsorted(time[self.ending], times, side="left")
        self.waiting = np.searchsorted(entered[self.beginning], times, side="left")
        deaths = np.bincount(self.place, minlength=times.size)
        self.rows = np.repeat(np.arange(times.size), deaths)
        self.times = times[self.rows]
        self.share = np.concatenate([np.arange(d) / d for d in deaths])
        self.pairs = np.triu_indices(x.shape[1])
        self.products = x[:, self.pairs[0]] * x[:, self.pairs[1]]

    def _sum(self, values: Float) -> Float:
        """(times, columns) sums over those at risk."""
        nobody = np.zeros((1, values.shape[1]))
        found = np.concatenate((np.cumsum(values[self.ending][::-1], axis=0)[::-1], nobody))[self.gone]
        if np.isfinite(self.entered).any():
            begun = np.concatenate((np.cumsum(values[self.beginning][::-1], axis=0)[::-1], nobody))
            found = found - begun[self.waiting]
        return np.asarray(found)

    def moments(self, beta: Float) -> tuple[Float, Float, Float]:
        """At each failure: the sum (d,) of the risks, the mean (d, p) of the columns and their covariance (d, p (p + 1)/2)."""
        p = self.x.shape[1]
        risk = np.exp(self.x @ beta)
        columns = risk[:, None] * np.column_stack((np.ones(risk.size), self.x, self.products))
        everyone = self._sum(columns)
        own = np.zeros_like(everyone)
        np.add.at(own, self.place, columns[self.failed])
        left = everyone[self.rows] - self.share[:, None] * own[self.rows]
        total, mean = left[:, 0], left[:, 1 : 1 + p] / left[:, :1]
        return total, mean, left[:, 1 + p :] / total[:, None] - mean[:, self.pairs[0]] * mean[:, self.pairs[1]]

    def square(self, packed: Float) -> Float:
        """(p, p) from (p (p + 1)/2,)."""
        p = self.x.shape[1]
        found = np.zeros((p, p))
        found[self.pairs] = packed
        found.T[self.pairs] = packed
        return found

    def parts(self, beta: Float) -> _Parts:
        total, mean, covariance = self.moments(beta)
        value = float((self.x[self.failed] @ beta).sum() - np.log(total).sum())
        gradient = self.x[self.failed].sum(axis=0) - mean.sum(axis=0)
        return value, gradient, self.square(covariance.sum(axis=0))


def _exact(time: Float, failed: Bool, entered: Float, x: Float) -> Callable[[Float], _Parts]:
    """The sum over all choices of d among those at risk by recursion over them, with two derivatives."""
    sets = []
    for t in np.unique(time[failed]):
        sets.append((x[(entered < t) & (time >= t)], int((failed & (time == t)).sum())))
    failed_sum = x[failed].sum(axis=0)
    p = x.shape[1]

    def parts(beta: Float) -> _Parts:
        value, gradient, information = float(failed_sum @ beta), failed_sum.copy(), np.zeros((p, p))
        for members, d in sets:
            total, first, second = _choices(members, np.exp(members @ beta), d)
            mean = first / total
            value -= float(np.log(total))
            gradient -= mean
            information += second / total - np.outer(mean, mean)
        return value, gradient, information

    return parts


def _choices(x: Float, risk: Float, d: int) -> tuple[float, Float, Float]:
    """Σ over choices of d rows of Π risk, with its first and second derivative in the coefficients."""
    p = x.shape[1]
    total, first, second = np.zeros(d + 1), np.zeros((d + 1, p)), np.zeros((d + 1, p, p))
    total[0] = 1.0
    for row, r in zip(x, risk, strict=True):
        outer = first[:-1, :, None] * row
        second[1:] += r * (second[:-1] + outer + np.swapaxes(outer, 1, 2) + total[:-1, None, None] * np.outer(row, row))
        first[1:] += r * (first[:-1] + total[:-1, None] * row)
        total[1:] += r * total[:-1]
    return float(total[d]), first[d], second[d]
