"""Are the hazards of Cox's model proportional: does the effect of a covariate stay the same over the life?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.fit.survival.covariates import Design
from pipeline.fit.survival.cox_regression import CoxRegression, RiskSums
from pipeline.fit.survival.lifetime_distributions import Lives
from schemas.arrays import Float

ALL_COVARIATES = "all covariates"


@dataclass(frozen=True)
class ProportionalityTest:
    """Test that the effect of a covariate does not change over the life.

    `trend` is the estimated change of the coefficient from the first failures to the last, of a covariate with one column
    (NaN for others), positive where it grows.
    """

    covariate: str
    trend: float
    statistic: float
    degrees_of_freedom: int
    p_value: float


def check_proportional_hazards(lives: Lives, design: Design, fit: CoxRegression) -> tuple[ProportionalityTest, ...]:
    """Score tests of effects that change with the share that has failed.

    Parameters
    ----------
    lives : n lives, exact or right-censored, as in `fit_cox`
    design : n rows
    fit : `fit_cox` of the two with Efron's ties

    Returns
    -------
    tuple of ProportionalityTest
        One for each covariate and, where there are several, one for all of them together.

    Notes
    -----
    P. Grambsch, T. Therneau, Biometrika 81 (1994) 515. A coefficient β + θ g(t), with g one less the Kaplan–Meier curve
    just before t, is tested for θ = 0 by its score and the whole information, without the approximation that the
    covariance of those at risk stays the same.
    """
    entered = np.full(lives.lower.size, -np.inf) if lives.entered is None else lives.entered
    x = design.x - design.x.mean(axis=0)
    failed = lives.exact
    sums = RiskSums(lives.lower, failed, entered, x)
    beta = np.array([effect.value.value for effect in fit.effects])
    _, mean, covariance = sums.moments(beta)
    order = np.argsort(lives.lower[failed], kind="stable")
    g = _failed_share(lives.lower, entered, sums.times)
    residuals = x[failed][order] - mean
    score = g @ residuals
    plain, mixed, curved = (sums.square(weight @ covariance) for weight in (np.ones(g.size), g, g**2))
    information = curved - mixed @ np.linalg.solve(plain, mixed)
    found = []
    owners = list(dict.fromkeys(design.owners))
    for owner in owners:
        found.append(_score_test(owner, score, information, [i for i, o in enumerate(design.owners) if o == owner]))
    if len(owners) > 1:
        found.append(_score_test(ALL_COVARIATES, score, information, list(range(len(design.owners)))))
    return tuple(found)


def _failed_share(time: Float, entered: Float, failures: Float) -> Float:
    """(d,) one less the Kaplan–Meier curve just before each of the failures, which are in order."""
    times, deaths = np.unique(failures, return_counts=True)
    begun = np.searchsorted(np.sort(entered), times, side="left")
    at_risk = begun - np.searchsorted(np.sort(time), times, side="left")
    alive = np.concatenate(([1.0], np.cumprod(1 - deaths / at_risk)))[:-1]
    return np.asarray(np.repeat(1 - alive, deaths))


def _score_test(covariate: str, score: Float, information: Float, columns: list[int]) -> ProportionalityTest:
    own, curvature = score[columns], information[np.ix_(columns, columns)]
    # All failures at one time, or everybody alike at risk: nothing is known of a change.
    known = float(np.linalg.eigvalsh(curvature)[0]) > 0
    statistic = float(own @ np.linalg.solve(curvature, own)) if known else float("nan")
    trend = float(own[0] / curvature[0, 0]) if known and len(columns) == 1 else float("nan")
    return ProportionalityTest(
        covariate, trend, statistic, len(columns), float(special.chdtrc(len(columns), statistic))
    )
