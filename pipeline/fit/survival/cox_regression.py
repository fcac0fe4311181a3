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
    parts = _exact(lives.lower, failed, entered, x) if ties == EXACT else _efron(lives.lower, failed, entered, x)
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


def _efron(time: Float, failed: Bool, entered: Float, x: Float) -> Callable[[Float], _Parts]:
    """Sums over those at risk by differences of cumulative sums: of who has not ended, less who has not begun."""
    times, place = np.unique(time[failed], return_inverse=True)
    ending, beginning = np.argsort(time), np.argsort(entered)
    # At risk at t: entered < t ≤ end.
    gone = np.searchsorted(time[ending], times, side="left")
    waiting = np.searchsorted(entered[beginning], times, side="left")
    deaths = np.bincount(place, minlength=times.size)
    rows = np.repeat(np.arange(times.size), deaths)
    share = np.concatenate([np.arange(d) / d for d in deaths])
    p = x.shape[1]
    i, j = np.triu_indices(p)
    products = x[:, i] * x[:, j]
    failed_sum = x[failed].sum(axis=0)
    late = bool(np.isfinite(entered).any())

    def sums(values: Float) -> Float:
        """(times, columns) sums over those at risk."""
        after = np.concatenate((np.cumsum(values[ending][::-1], axis=0)[::-1], np.zeros((1, values.shape[1]))))
        found = after[gone]
        if late:
            begun = np.concatenate((np.cumsum(values[beginning][::-1], axis=0)[::-1], np.zeros((1, values.shape[1]))))
            found = found - begun[waiting]
        return np.asarray(found)

    def parts(beta: Float) -> _Parts:
        eta = x @ beta
        risk = np.exp(eta)
        columns = risk[:, None] * np.column_stack((np.ones(risk.size), x, products))
        everyone = sums(columns)
        own = np.zeros_like(everyone)
        np.add.at(own, place, columns[failed])
        left = everyone[rows] - share[:, None] * own[rows]
        total, first, second = left[:, 0], left[:, 1 : 1 + p], left[:, 1 + p :]
        mean = first / total[:, None]
        value = float(eta[failed].sum() - np.log(total).sum())
        information = np.zeros((p, p))
        information[i, j] = (second / total[:, None] - mean[:, i] * mean[:, j]).sum(axis=0)
        information[j, i] = information[i, j]
        return value, failed_sum - mean.sum(axis=0), information

    return parts


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
