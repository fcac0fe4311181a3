"""Weibull, exponential and log-normal lifetimes by censored likelihood, with profile intervals and goodness of fit.

Rows may be exact, right-censored, left-censored or known to an inspection interval. A group that cannot carry a fit (no
failures, fewer than two distinct failure times) is refused with the reason. Curves without a distribution are in
`survival`, several voltages in `voltage_life`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pipeline.fit.survival.kaplan_meier import Estimate, check_lifetimes, kaplan_meier
from pipeline.fit.survival.log_location_scale import (
    NORMAL,
    SMALLEST_EXTREME_VALUE,
    ErrorDistribution,
    LogLives,
    converged_single,
    limits_at_drop,
    maximise,
)
from pipeline.fit.survival.profile_likelihood import critical_drop, profile_limits
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError, RefusedError
from schemas.numbers import p_equals, significant

WEIBULL, EXPONENTIAL, LOG_NORMAL = "weibull", "exponential", "log-normal"
DISTRIBUTIONS = (WEIBULL, EXPONENTIAL, LOG_NORMAL)
_NAMES = {WEIBULL: "Weibull", EXPONENTIAL: "exponential", LOG_NORMAL: "log-normal"}
PLOTTED_SHARES = (0.015, 0.1, 0.3, 0.6, 0.9, 0.985)
"""Shares failed at which probability plots know the time."""
_SIMULATIONS = 999
_LARGEST_SIMULATED = 300
"""Above this number of specimens the goodness of fit is stated without simulated p-value."""
_SEED = 20_240_229


@dataclass(frozen=True)
class Lives:
    """Lifetimes of n specimens, each between `lower` and `upper` in s.

    Equal: exact. `upper` infinite: right-censored. `lower` 0 with finite `upper`: left-censored. Else an inspection
    interval. `entered` in s, 0 for none, is the age at which a specimen came under watch: one that had failed before would
    not be here (left truncation); None: all were watched from their start.
    """

    lower: Float
    upper: Float
    entered: Float | None = None

    def __post_init__(self) -> None:
        if self.lower.shape != self.upper.shape or self.lower.ndim != 1 or self.lower.size == 0:
            raise RefusedError(
                f"limits of shapes {self.lower.shape} and {self.upper.shape}", expected="two equal lists"
            )
        wrong = ~((self.lower >= 0) & (self.upper >= self.lower) & (self.upper > 0) & np.isfinite(self.lower))
        if wrong.any():
            row = int(np.argmax(wrong))
            raise RefusedError(
                f"lifetime between {self.lower[row]:g} and {self.upper[row]:g} s",
                where=f"row {row}",
                expected="0 ≤ lower ≤ upper with upper above 0",
            )
        if self.entered is not None:
            late = ~((self.entered >= 0) & (self.entered <= self.lower) & (self.entered < self.upper))
            if self.entered.shape != self.lower.shape or late.any():
                row = int(np.argmax(late))
                raise RefusedError(
                    f"came under watch at {self.entered[row]:g} s, its life is between {self.lower[row]:g} and"
                    f" {self.upper[row]:g} s",
                    where=f"row {row}",
                    expected="an age not below 0 and before the end of the life",
                )

    @classmethod
    def right_censored(cls, time: ArrayLike, failed: ArrayLike) -> Lives:
        """From times in s and failure flags.

        A failure at 0 s (broke down while the voltage rose) has no place on a logarithmic axis: it enters as a failure
        before the shortest positive time. A survivor of 0 s says nothing and is left out.
        """
        t, flags = check_lifetimes(time, failed)
        keep = flags | (t > 0)
        t, flags = t[keep], flags[keep]
        positive = t[t > 0]
        if positive.size == 0:
            raise NotIdentifiableError("no lifetime above 0 s")
        upper = np.where(flags, np.where(t > 0, t, positive.min()), np.inf)
        return cls(t, upper)

    @property
    def exact(self) -> Bool:
        return np.asarray((self.lower == self.upper) & (self.lower > 0))

    @property
    def failures(self) -> int:
        return int(np.isfinite(self.upper).sum())

    @property
    def distinct_failures(self) -> int:
        """Number of different failure times or intervals."""
        known = np.isfinite(self.upper)
        return int(np.unique(self.lower[known] + 1j * self.upper[known]).size)

    @property
    def simple(self) -> bool:
        """All are exact or right-censored, and were watched from their start."""
        return self.entered is None and bool(np.all(self.exact | np.isposinf(self.upper)))

    def keep(self, rows: Bool) -> Lives:
        """Those of the rows that are true."""
        entered = None if self.entered is None else self.entered[rows]
        return Lives(self.lower[rows], self.upper[rows], entered)

    def logarithms(self) -> LogLives:
        with np.errstate(divide="ignore"):
            entered = None if self.entered is None else np.log(self.entered)[None, :]
            return LogLives(np.log(self.lower)[None, :], np.log(self.upper)[None, :], None, entered)

    def distinct(self) -> LogLives:
        """Logarithms with equal lives taken once: most specimens survive to the planned end of their test."""
        known = (self.lower, self.upper) if self.entered is None else (self.lower, self.upper, self.entered)
        limits, count = np.unique(np.stack(known), axis=1, return_counts=True)
        with np.errstate(divide="ignore"):
            lower, upper, *entered = np.log(limits)[:, None, :]
        return LogLives(lower, upper, count.astype(np.float64), entered[0] if entered else None)

    @property
    def log_jacobian(self) -> float:
        """Σ ln t of the exact lives: the log-likelihood of ln t less this is that of t."""
        return float(np.log(self.lower[self.exact]).sum())


@dataclass(frozen=True)
class Goodness:
    """How well a distribution fits: largest distance between its curve and Kaplan–Meier over the observed time.

    `p_value` from data sets simulated from the fit and fitted again; NaN where it was not simulated.
    """

    distance: float
    p_value: float
    statement: str


@dataclass(frozen=True)
class DistributionFit:
    """A fitted lifetime distribution.

    `parameters` by name with 95 % profile-likelihood limits: Weibull `shape`, `scale_s`; exponential `mean_s`;
    log-normal `median_s`, `log_sd`. `log_likelihood` is that of the times in s. `location`, `sigma`: ln t = location +
    σ w. `goodness` is None for inspection intervals and late entries.
    """

    distribution: str
    parameters: Mapping[str, Estimate]
    log_likelihood: float
    location: float
    sigma: float
    specimens: int
    failures: int
    goodness: Goodness | None

    @property
    def aic(self) -> float:
        """Akaike's criterion 2 p − 2 ln L."""
        return 2 * len(self.parameters) - 2 * self.log_likelihood

    def survival(self, time: ArrayLike) -> Float:
        """S at times in s above 0; shape of the input."""
        z = (np.log(np.asarray(time, dtype=np.float64)) - self.location) / self.sigma
        return _error(self.distribution).survival(np.asarray(z))


@dataclass(frozen=True)
class LifeQuantile:
    """Time in s by which a share has failed by a fitted distribution, with 95 % profile-likelihood limits."""

    distribution: str
    failed_share: float
    time_s: Estimate


def _error(distribution: str) -> ErrorDistribution:
    return NORMAL if distribution == LOG_NORMAL else SMALLEST_EXTREME_VALUE


def fit_distribution(lives: Lives, distribution: str, *, goodness: bool = True) -> DistributionFit:
    """Maximum-likelihood fit with profile intervals.

    ln L = Σ failed [ln β − β ln η + (β − 1) ln t] − Σ (t/η)^β for Weibull; an inspection interval contributes
    ln[S(a) − S(b)]. Intervals use the critical value of `profile_likelihood.critical_drop`.

    Raises `NotIdentifiableError` without failures (exponential) or with fewer than two distinct failure times (others).
    """
    if distribution not in DISTRIBUTIONS:
        raise ValueError(f"distribution {distribution!r} is not one of {DISTRIBUTIONS}")
    needed = 1 if distribution == EXPONENTIAL else 2
    found = lives.distinct_failures
    if found < needed:
        held = "nobody failed" if found == 0 else "all failures at one time"
        raise NotIdentifiableError(
            f"no {_NAMES[distribution]} law: {held} ({lives.failures} of {lives.lower.size} failed)",
            expected=f"at least {needed} distinct failure time{'s' if needed > 1 else ''}",
        )
    data, error = lives.distinct(), _error(distribution)
    fixed = 1.0 if distribution == EXPONENTIAL else None
    ones = np.ones((data.lower.shape[1], 1))
    best = converged_single(maximise(data, ones, error, sigma=fixed), f"{distribution} fit")
    top, location, sigma = float(best.log_likelihood[0]), float(best.coefficients[0, 0]), float(best.sigma[0])

    def with_location(values: Float) -> Float:
        # Lives about another place scatter more about it: near where σ will be.
        start = 1 / np.hypot(sigma, values - location)[:, None]
        return maximise(data.shifted(values[:, None]), ones[:, :0], error, sigma=fixed, start=start).log_likelihood

    def with_log_sigma(values: Float) -> Float:
        start = np.column_stack((np.ones(values.size), np.full(values.size, location))) / np.exp(values)[:, None]
        held = data.shifted(0 * values[:, None])
        return maximise(held, ones, error, sigma=np.exp(values), start=start).log_likelihood

    drop = critical_drop(lives.failures)
    step = sigma / np.sqrt(lives.failures)
    quick = ((np.nan, np.nan), (np.nan, np.nan))
    if distribution != EXPONENTIAL:
        quick = limits_at_drop(data, error, location, sigma, drop)

    def find(
        quickly: tuple[float, float], profile: Callable[[Float], Float], centre: float, near: float
    ) -> tuple[float, float]:
        return quickly if np.isfinite(quickly).all() else profile_limits(profile, centre, top, drop, near)

    low, high = find(quick[0], with_location, location, step)
    central = Estimate(*(float(v) for v in np.exp([location, low, high])))
    if distribution == EXPONENTIAL:
        parameters = {"mean_s": central}
    else:
        narrow, wide = find(quick[1], with_log_sigma, float(np.log(sigma)), 1 / float(np.sqrt(lives.failures)))
        if distribution == WEIBULL:
            shape = Estimate(1 / sigma, float(np.exp(-wide)), float(np.exp(-narrow)))
            parameters = {"shape": shape, "scale_s": central}
        else:
            parameters = {"median_s": central, "log_sd": Estimate(sigma, float(np.exp(narrow)), float(np.exp(wide)))}
    fit = DistributionFit(
        distribution, parameters, top - lives.log_jacobian, location, sigma, lives.lower.size, lives.failures, None
    )
    if not goodness or not lives.simple:
        return fit
    return DistributionFit(**{**fit.__dict__, "goodness": goodness_of_fit(lives, fit)})


def estimate_quantiles(
    lives: Lives, fit: DistributionFit, failed_shares: ArrayLike = PLOTTED_SHARES
) -> tuple[LifeQuantile, ...]:
    """Quantiles of a fitted distribution of two parameters: the line of a probability plot and its band.

    Parameters
    ----------
    lives : those that were fitted
    fit : a Weibull or log-normal fit
    failed_shares : (m,) between 0 and 1

    Notes
    -----
    With w moved by its own quantile the location is the quantile of ln t, so that its profile is that of a location.
    """
    data, error = lives.distinct(), _error(fit.distribution)
    nothing = np.empty((data.lower.shape[1], 0))
    drop, step = critical_drop(lives.failures), fit.sigma / np.sqrt(lives.failures)
    top = fit.log_likelihood + lives.log_jacobian
    found = []
    for share in np.asarray(failed_shares, dtype=np.float64).tolist():
        w = float(error.quantile_of_survival(np.array(1 - share)))
        moved = error.moved(w)

        def profile(values: Float, moved: ErrorDistribution = moved) -> Float:
            return maximise(data.shifted(values[:, None]), nothing, moved).log_likelihood

        centre = fit.location + fit.sigma * w
        limits = profile_limits(profile, centre, top, drop, step * float(np.sqrt(1 + w**2)))
        found.append(LifeQuantile(fit.distribution, share, Estimate(*np.exp([centre, *limits]).tolist())))
    return tuple(found)


def goodness_of_fit(lives: Lives, fit: DistributionFit) -> Goodness:
    """Kaplan–Meier against the fitted curve, with a p-value from simulated groups (fixed seed) for up to 300 specimens.

    Each simulated group has the censoring times of the data; a specimen that failed would have been censored at the
    largest censoring time, or never when nobody was censored.
    """
    failed = lives.exact
    time = lives.lower
    curve = kaplan_meier(time, failed)
    rows = curve.failures > 0
    expected = fit.survival(curve.time[rows])
    distance = float(
        _distances(time[None, :], failed[None, :], np.array([fit.location]), np.array([fit.sigma]), fit)[0]
    )
    lower, upper = np.nan_to_num(curve.lower[rows], nan=0.0), np.nan_to_num(curve.upper[rows], nan=1.0)
    outside = float(np.mean((expected < lower) | (expected > upper)))
    p_value = _simulated_p_value(time, failed, fit, distance) if time.size <= _LARGEST_SIMULATED else float("nan")
    agrees = p_value >= 0.05 if np.isfinite(p_value) else outside <= 0.05
    verdict = "fits" if agrees else "does not fit"
    shown = f", {p_equals(p_value)} among {_SIMULATIONS} simulated groups" if np.isfinite(p_value) else ""
    statement = (
        f"the {_NAMES[fit.distribution]} law {verdict}: largest distance from Kaplan–Meier {significant(distance, 2)}{shown}, "
        f"{100 * outside:.0f} % of the failure times outside the 95 % band"
    )
    return Goodness(distance, p_value, statement)


def _distances(time: Float, failed: Bool, location: Float, sigma: Float, fit: DistributionFit) -> Float:
    """(batch,) largest |Kaplan–Meier − fitted| just before and at the observed times of (batch, n) groups."""
    order = np.argsort(np.where(failed, time, np.nextafter(time, np.inf)), axis=1, kind="stable")
    t, d = np.take_along_axis(time, order, 1), np.take_along_axis(failed, order, 1)
    n = np.arange(t.shape[1], 0, -1)
    after = np.cumprod(1 - d / n, axis=1)
    before = np.concatenate((np.ones((t.shape[0], 1)), after[:, :-1]), axis=1)
    ended = np.concatenate((t[:, 1:] != t[:, :-1], np.ones((t.shape[0], 1), bool)), axis=1)
    begun = np.concatenate((np.ones((t.shape[0], 1), bool), t[:, 1:] != t[:, :-1]), axis=1)
    expected = _error(fit.distribution).survival((np.log(t) - location[:, None]) / sigma[:, None])
    gaps = np.maximum(
        np.where(ended & d, np.abs(after - expected), 0), np.where(begun & d, np.abs(before - expected), 0)
    )
    return np.asarray(gaps.max(axis=1))


def _simulated_p_value(time: Float, failed: Bool, fit: DistributionFit, distance: float) -> float:
    rng = np.random.default_rng(_SEED)
    last = float(time[~failed].max()) if (~failed).any() else np.inf
    ends = np.where(failed, np.maximum(last, time), time)
    error = _error(fit.distribution)
    w = error.quantile_of_survival(rng.uniform(size=(_SIMULATIONS, time.size)))
    life = np.exp(fit.location + fit.sigma * w)
    dead = life <= ends
    observed = np.minimum(life, ends)
    carried = (dead & (np.diff(np.sort(np.where(dead, observed, np.nan), axis=1), axis=1, prepend=np.nan) != 0)).sum(
        axis=1
    )
    usable = carried >= (1 if fit.distribution == EXPONENTIAL else 2)
    observed, dead = observed[usable], dead[usable]
    y = np.log(observed)
    again = maximise(
        LogLives(y, np.where(dead, y, np.inf)),
        np.ones((time.size, 1)),
        error,
        sigma=1.0 if fit.distribution == EXPONENTIAL else None,
    )
    simulated = _distances(observed, dead, again.coefficients[:, 0], again.sigma, fit)[again.converged]
    return float((1 + np.sum(simulated >= distance * (1 - 1e-9))) / (1 + simulated.size))
