"""How covariates act on competing modes of failure: on the hazard of each mode, and on the probability to fail by it.

The cause-specific hazard takes failures by other modes as censored. The model of Fine and Gray is about the cumulative
incidence (`competing_causes`): who has failed otherwise stays among those at risk, with the weight of not being censored.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.fit.survival.covariates import Covariate, Design, make_design
from pipeline.fit.survival.cox_regression import CoxRegression, fit_cox, solve_partial_likelihood
from pipeline.fit.survival.lifetime_distributions import Lives
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError, RefusedError

FINE_GRAY = "breslow, weighted"


@dataclass(frozen=True)
class CauseRegression:
    """Effects of the covariates on one mode: on its hazard, and on its probability (Fine and Gray)."""

    mode: str
    failures: int
    cause_specific: CoxRegression
    fine_gray: CoxRegression


def fit_cause_regression(
    lives: Lives, modes: Sequence[str | None], covariates: Sequence[Covariate], mode: str
) -> CauseRegression:
    """Both regressions of one mode.

    Parameters
    ----------
    lives : n lives, exact or right-censored
    modes : (n,) mode of each failure, not looked at for survivors
    covariates : each with n values
    mode : the one that is asked about

    Raises
    ------
    NotIdentifiableError
        Nobody failed by the mode, or a covariate tells nothing about it.
    RefusedError
        There is not one mode for each life.
    """
    if len(modes) != lives.lower.size:
        raise RefusedError(f"{len(modes)} modes for {lives.lower.size} lives", expected="one for each")
    failed = lives.exact
    own = failed & np.array([m == mode for m in modes])
    if not own.any():
        raise NotIdentifiableError(f"nobody failed by {mode}: no effect on it", expected="at least one failure by it")
    design = make_design(covariates, own)
    other = Lives(lives.lower, np.where(failed & ~own, np.inf, lives.upper), lives.entered)
    return CauseRegression(mode, int(own.sum()), fit_cox(other, design), fit_fine_gray(lives, own, design))


def fit_fine_gray(lives: Lives, own: Bool, design: Design) -> CoxRegression:
    """Proportional subdistribution hazards of the failures `own` (n,).

    Raises
    ------
    NotIdentifiableError
        A life is not exact or right-censored, came under watch late, or the covariates separate the failures.

    Notes
    -----
    J. Fine, R. Gray, J. Am. Stat. Assoc. 94 (1999) 496. Failures by other modes keep the weight Ĝ(t)/Ĝ(their end), with Ĝ
    the Kaplan–Meier curve of being censored. Standard errors are those of the weighted information.
    """
    if not lives.simple:
        raise NotIdentifiableError(
            "Fine and Gray's model takes exact and right-censored lives that were watched from their start",
            expected="no inspections and no late entries",
        )
    scale = np.where(design.x.std(axis=0) > 0, design.x.std(axis=0), 1.0)
    x = (design.x - design.x.mean(axis=0)) / scale
    parts = _weighted(lives.lower, lives.exact, own, x)
    return solve_partial_likelihood(parts, design.names, scale, FINE_GRAY, own)


def _weighted(time: Float, failed: Bool, own: Bool, x: Float) -> Callable[[Float], tuple[float, Float, Float]]:
    times, place = np.unique(time[own], return_inverse=True)
    weight = _weights(time, failed, own, times)
    deaths = np.bincount(place, minlength=times.size).astype(np.float64)
    own_sum, p = x[own].sum(axis=0), x.shape[1]
    i, j = np.triu_indices(p)
    columns = np.column_stack((np.ones(time.size), x, x[:, i] * x[:, j]))

    def parts(beta: Float) -> tuple[float, Float, Float]:
        eta = x @ beta
        sums = weight @ (np.exp(eta)[:, None] * columns)
        total, mean = sums[:, 0], sums[:, 1 : 1 + p] / sums[:, :1]
        value = float(eta[own].sum() - deaths @ np.log(total))
        information = np.zeros((p, p))
        information[i, j] = deaths @ (sums[:, 1 + p :] / total[:, None] - mean[:, i] * mean[:, j])
        information[j, i] = information[i, j]
        return value, own_sum - deaths @ mean, information

    return parts


def _weights(time: Float, failed: Bool, own: Bool, times: Float) -> Float:
    """(times, n) weight of each specimen among those at risk at the times of the failures that are asked about."""
    ends = np.unique(time)
    at_risk = time.size - np.searchsorted(np.sort(time), ends, side="left")
    # Failures come before censorings at the same time, so they are not at risk of being censored.
    failures = np.bincount(np.searchsorted(ends, time[failed]), minlength=ends.size)
    censored = np.bincount(np.searchsorted(ends, time[~failed]), minlength=ends.size)
    staying = np.maximum(at_risk - failures, 1)
    uncensored = np.concatenate(([1.0], np.cumprod(1 - censored / staying)))
    just_before = uncensored[np.searchsorted(ends, times, side="left")]
    own_end = uncensored[np.searchsorted(ends, time, side="left")]
    at_risk_now = time[None, :] >= times[:, None]
    otherwise = (failed & ~own)[None, :] & ~at_risk_now
    ratio = just_before[:, None] / np.maximum(own_end, 1e-300)[None, :]
    return np.where(at_risk_now, 1.0, np.where(otherwise, ratio, 0.0))
