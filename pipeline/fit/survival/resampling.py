"""Limits of a life regression by simulation: lives drawn from the fit, censored as the tests were, and fitted again.

Belongs here: the drawing and the limits. With few failures the limits of the likelihood are approximations, of the generalised gamma
rough ones; these cost a second or more and so are made when they are asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.fit.survival.covariates import Covariate, make_design
from pipeline.fit.survival.kaplan_meier import LEVEL, Estimate
from pipeline.fit.survival.life_regression import FAMILIES, LifeRegression, fit_life_regression, refit
from pipeline.fit.survival.lifetime_distributions import Lives
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError, RefusedError

PIVOTS, CORRECTED = "simulated pivots", "bias-corrected bootstrap"
_SEED = 20_260_611
_LEAST_SHARE = 0.5
"""Of the simulated tests that have to be fitted: with fewer the limits are those of lucky draws."""


@dataclass(frozen=True)
class SimulatedLimits:
    """A fit with limits by simulation: `coefficients`, σ, the shape q, and the median life in s at the conditions asked for.

    `method` is how limits come from the draws, `fitted` of `draws` simulated tests could be fitted.
    """

    regression: LifeRegression
    coefficients: Mapping[str, Estimate]
    sigma: Estimate
    shape: Estimate | None
    median_s: Estimate | None
    method: str
    fitted: int
    draws: int


def simulate_limits(
    lives: Lives,
    covariates: Sequence[Covariate],
    family: str,
    *,
    at: Float | None = None,
    draws: int = 1000,
    seed: int = _SEED,
) -> SimulatedLimits:
    """95 % limits from `draws` simulated tests.

    Parameters
    ----------
    lives : exact or right-censored, under watch from their start
    covariates, family : as of `life_regression.fit_life_regression`
    at : (p,) conditions of the design whose median life is asked for

    Raises
    ------
    RefusedError
        Lives that were found at inspections or entered late: how these came about is not known.
    NotIdentifiableError
        There is no fit, or fewer than half of the simulated tests have one.

    Notes
    -----
    The end of each simulated test is that of the specimen where it survived, else the longest test of a survivor under the same
    conditions; where nobody survived there is none. Of location–scale families the distributions of (c* − c)/σ* and σ*/σ depend on
    the ends alone, not on the parameters: limits from them are exact where all failed or tests end with a failure (J. Lawless,
    Statistical Models and Methods for Lifetime Data (1982), sections 4.1 and 6.3). The shape of a generalised gamma has no
    such pivot: its limits are quantiles of the draws, moved by their bias (B. Efron, Can. J. Stat. 9 (1981) 139).
    """
    if not lives.simple:
        raise RefusedError(
            "lives found at inspections, or that came under watch late",
            expected="lives that are exact or right-censored, for limits by simulation",
        )
    fit = fit_life_regression(lives, covariates, family)
    design = make_design(covariates, np.isfinite(lives.upper))
    drawn = _simulate(lives, design.x, fit, draws, np.random.default_rng((seed, FAMILIES.index(family))))
    found = refit(drawn, design.x, family)
    good = np.isfinite(found).all(axis=1)
    if good.mean() < _LEAST_SHARE:
        raise NotIdentifiableError(
            f"{int(good.sum())} of {draws} simulated tests have a fit: no limits by simulation",
            expected="at least half of them; more failures, or a family of fewer parameters",
        )
    c, log_sigma, shape = found[good, :-2], found[good, -2], found[good, -1]
    best = np.array([one.value.value for one in fit.coefficients])
    own = np.log(fit.sigma.value)
    is_pivotal = fit.shape is None
    of_place = _Limits(fit.sigma.value, np.exp(log_sigma), is_pivotal)
    names = [one.name for one in fit.coefficients]
    coefficients = {name: of_place.find(best[i], c[:, i]) for i, name in enumerate(names)}
    spread = _Limits(1.0, np.ones(log_sigma.size), is_pivotal).find(own, log_sigma)
    median = None
    if at is not None:
        row = np.concatenate(([1.0], at))
        w = np.array([_median(fit, q) for q in (shape if fit.shape else shape[:1])])
        centre = float(np.log(fit.life_at(at).value))
        median = _exp(of_place.find(centre, c @ row + np.exp(log_sigma) * w))
    return SimulatedLimits(
        fit,
        coefficients,
        fit.sigma if np.ptp(log_sigma) == 0 else _exp(spread),
        None if fit.shape is None else _Limits(1.0, np.ones(shape.size), False).find(fit.shape.value, shape),
        median,
        PIVOTS if is_pivotal else CORRECTED,
        int(good.sum()),
        draws,
    )


def _median(fit: LifeRegression, shape: float) -> float:
    return float(fit.error_of(shape).quantile_of_survival(np.array(0.5)))


def _exp(estimate: Estimate) -> Estimate:
    return Estimate(*(float(np.exp(v)) for v in (estimate.value, estimate.lower, estimate.upper)))


@dataclass(frozen=True)
class _Limits:
    """How limits come from draws: `scale` of the fit, (draws,) `scales` of the draws."""

    scale: float
    scales: Float
    is_pivotal: bool

    def find(self, value: float, drawn: Float) -> Estimate:
        tails = np.array([(1 - LEVEL) / 2, (1 + LEVEL) / 2])
        if self.is_pivotal:
            low, high = value - self.scale * np.quantile((drawn - value) / self.scales, tails[::-1])
            return Estimate(value, float(low), float(high))
        below = np.clip(np.mean(drawn < value), 1 / drawn.size, 1 - 1 / drawn.size)
        moved = special.ndtr(2 * special.ndtri(below) + special.ndtri(tails))
        return Estimate(value, *np.quantile(drawn, moved).tolist())


def _simulate(lives: Lives, x: Float, fit: LifeRegression, draws: int, rng: np.random.Generator) -> tuple[Float, Float]:
    """(draws, n) lower and upper limits of ln t."""
    failed = np.isfinite(lives.upper)
    conditions = (
        np.unique(x, axis=0, return_inverse=True)[1].ravel() if x.shape[1] else np.zeros(failed.size, dtype=int)
    )
    last = np.full(conditions.max() + 1, -np.inf)
    np.maximum.at(last, conditions[~failed], lives.lower[~failed])
    own = last[conditions]
    end = np.log(np.where(~failed, lives.lower, np.where(own > 0, np.maximum(own, lives.lower), np.inf)))
    location = np.column_stack((np.ones(failed.size), x)) @ [one.value.value for one in fit.coefficients]
    w = fit.error.quantile_of_survival(rng.uniform(size=(draws, failed.size)))
    log_life = location + fit.sigma.value * w
    return np.minimum(log_life, end), np.where(log_life <= end, log_life, np.inf)
