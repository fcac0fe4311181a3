"""Accelerated-life regression: ln t = design · c + σ w for lives of any censoring, with w of a location–scale family.

Belongs here: the fit, likelihood-ratio tests, intervals, residuals, lack of fit per group and lives at other conditions.
What enters the design is in `covariates`, the solver in `log_location_scale`, Cox's model as the check in `cox_regression`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize, special

from pipeline.fit.survival.covariates import Covariate, Design, make_design
from pipeline.fit.survival.error_distributions import LOGISTIC, log_gamma
from pipeline.fit.survival.kaplan_meier import Estimate, Z
from pipeline.fit.survival.lifetime_distributions import EXPONENTIAL, LOG_NORMAL, WEIBULL, Lives
from pipeline.fit.survival.log_location_scale import (
    NORMAL,
    SMALLEST_EXTREME_VALUE,
    ErrorDistribution,
    LogLives,
    converged_single,
    differentiate,
    maximise,
)
from pipeline.fit.survival.profile_likelihood import (
    LARGE_SAMPLE_DROP,
    critical_deviations,
    critical_drop,
    few_failures_p_value,
    profile_limits,
)
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError

LOG_LOGISTIC, GENERALISED_GAMMA = "log-logistic", "generalised gamma"
FAMILIES = (EXPONENTIAL, WEIBULL, LOG_NORMAL, LOG_LOGISTIC, GENERALISED_GAMMA)
ERRORS = {
    EXPONENTIAL: SMALLEST_EXTREME_VALUE,
    WEIBULL: SMALLEST_EXTREME_VALUE,
    LOG_NORMAL: NORMAL,
    LOG_LOGISTIC: LOGISTIC,
}
_SHAPES = (-6.0, 6.0)
"""Shapes of the generalised gamma that are searched."""
_MOST_PROFILED = 2000
"""Above so many different lives intervals come from the information: there they and profiles are one to three digits."""
_MOST_SEARCHED = 2000
"""Up to so many lives the shape of a generalised gamma is searched with all of them, above with a sample and refined."""
_NEWTON_STEPS, _HALVINGS = 25, 30
_SHAPE_STEP, _SMALL_STEP = 1e-3, 1e-4
"""Differences over the shape, and the step of Newton's after which the next one would not be seen."""
PROFILE, INFORMATION = "profile likelihood", "observed information"
WIDE_INFORMATION = (
    f"{INFORMATION}; of few failures the limits of scatter and shape are wide (they hold the truth in 98 %), those of a"
    " bootstrap too narrow (81 to 91 %)"
)
_FEW = 50
"""Failures below which that was seen: studies/results.md, 30 lives of which 21 failed."""
_PER_GROUP = 2
"""Failures per group of equal conditions below which locations of their own are no test."""
_FAR = 60.0
"""A standardised coefficient beyond this, in units of the scatter, is on its way to infinity."""


@dataclass(frozen=True)
class RatioTest:
    """Likelihood-ratio test of a smaller model (`against` what, in words) within a larger one."""

    against: str
    statistic: float
    degrees_of_freedom: int
    p_value: float


@dataclass(frozen=True)
class Coefficient:
    """A coefficient of ln t with 95 % limits, its standard error, and the test that its whole covariate has no effect."""

    name: str
    value: Estimate
    standard_error: float
    p_value: float


@dataclass(frozen=True)
class GroupFit:
    """A group of specimens against the regression.

    `expected` failures are the sum of the Cox–Snell residuals; `factor` is how many times longer the group lives than the
    regression says, `p_value` that of a location of its own (NaN where nobody failed).
    """

    name: str
    specimens: int
    failures: int
    expected: float
    factor: float
    p_value: float


@dataclass(frozen=True)
class LifeRegression:
    """A fitted regression.

    `coefficients` begin with the intercept (t in s); `sigma` is the scatter of ln t, `shape` Prentice's q of a generalised
    gamma. `log_likelihood` is that of the times in s. `tests`: each covariate without effect, nested families, a location of
    its own for each group. `cox_snell` (n,) are the cumulative hazards −ln S at the ends of the lives, exponential with mean
    1 where the model is right (for a failure between inspections, their mean over the interval); `deviance` (n,) the
    deviance residuals. `covariance` is that of the coefficients, ln σ and the shape where they are fitted; `method` says where the limits come from.
    """

    family: str
    coefficients: tuple[Coefficient, ...]
    sigma: Estimate
    shape: Estimate | None
    log_likelihood: float
    specimens: int
    failures: int
    tests: tuple[RatioTest, ...]
    groups: tuple[GroupFit, ...]
    cox_snell: Float
    deviance: Float
    covariance: Float
    method: str

    @property
    def parameters(self) -> int:
        return len(self.coefficients) + (self.family != EXPONENTIAL) + (self.shape is not None)

    @property
    def aic(self) -> float:
        """Akaike's criterion 2 p − 2 ln L."""
        return 2 * self.parameters - 2 * self.log_likelihood

    @property
    def error(self) -> ErrorDistribution:
        return self.error_of(self.shape.value if self.shape else float("nan"))

    def error_of(self, shape: float) -> ErrorDistribution:
        """Of the family, with this shape where it has one."""
        return ERRORS.get(self.family) or log_gamma(shape)

    def life_at(self, x: Float, failed_share: float = 0.5) -> Estimate:
        """Time in s by which a share has failed at conditions `x` (p,) of the design, with 95 % limits by the delta method.

        With few failures among survivors these are rather wide: below the stresses tested they hold the truth in up to 97 %
        (tests/studies/results.md).
        """
        w = float(self.error.quantile_of_survival(np.array(1 - failed_share)))
        row = np.concatenate(([1.0], x))
        centre = float(row @ [c.value.value for c in self.coefficients]) + self.sigma.value * w
        slope = np.concatenate((row, self.sigma.value * np.array([w, self._quantile_slope(failed_share)])))
        slope = slope[: self.covariance.shape[0]]
        deviations = limit_deviations(self.family, self.failures, len(self.coefficients))
        half = deviations * float(np.sqrt(max(float(slope @ self.covariance @ slope), 0.0)))
        with np.errstate(over="ignore"):  # a limit that few failures leave open is infinite
            return Estimate(*(float(np.exp(centre + side * half)) for side in (0, -1, 1)))

    def _quantile_slope(self, failed_share: float) -> float:
        """Change of w at a share with the shape of a generalised gamma."""
        if self.shape is None:
            return 0.0
        less, more = (
            float(log_gamma(self.shape.value + step).quantile_of_survival(np.array(1 - failed_share)))
            for step in (-_SHAPE_STEP, _SHAPE_STEP)
        )
        return (more - less) / (2 * _SHAPE_STEP)


def fit_life_regression(
    lives: Lives,
    covariates: Sequence[Covariate],
    family: str = WEIBULL,
    *,
    groups: Sequence[str] | None = None,
) -> LifeRegression:
    """Regression of lives on stresses and categories by maximum likelihood.

    Parameters
    ----------
    lives : n lives in s, exact, censored in any way or come under watch late
    covariates : each with n values
    family : one of `FAMILIES`
    groups : (n,) names of groups whose fit is looked at; None: no group is

    Raises
    ------
    NotIdentifiableError
        Nobody failed, too few failed, or the covariates tell nothing (`covariates.make_design`).
    RefusedError
        A covariate has values that its law does not take.

    Notes
    -----
    Limits are those of the profile likelihood with the critical value of `profile_likelihood.critical_drop`, for the
    generalised gamma and more than 2000 different lives those of the observed information with
    `profile_likelihood.critical_deviations`; of exponential lives, whose scatter is known, those of χ² and the normal.
    How often they hold the truth: tests/studies/results.md.
    W. Meeker, L. Escobar, Statistical Methods for Reliability Data (1998), chapters 8, 17, 19.
    """
    if family not in FAMILIES:
        raise ValueError(f"family {family!r} is not one of {FAMILIES}")
    failed = np.isfinite(lives.upper)
    if not failed.any():
        raise NotIdentifiableError("nobody failed: no regression", expected="failures at two or more conditions")
    design = make_design(covariates, failed)
    needed = design.x.shape[1] + (1 if family == EXPONENTIAL else 2)
    if lives.distinct_failures < needed:
        raise NotIdentifiableError(
            f"{lives.distinct_failures} distinct failure times for {needed} parameters",
            expected=f"at least {needed} distinct failure times",
        )
    model = _Model(lives, design.x, family)
    best = model.maximum()
    fitted = _Fitted(model, design, best)
    tests = [fitted.test_without(owner) for owner in dict.fromkeys(design.owners)]
    tests += fitted.test_families()
    found: tuple[GroupFit, ...] = ()
    residuals = fitted.cox_snell()
    if groups is not None:
        found, of_groups = fitted.compare_groups(np.array([str(g) for g in groups]), residuals)
        tests += of_groups
    coefficients, sigma, shape, method = fitted.intervals({t.against: t.p_value for t in tests})
    return LifeRegression(
        family,
        coefficients,
        sigma,
        shape,
        best.log_likelihood - lives.log_jacobian,
        lives.lower.size,
        lives.failures,
        tuple(tests),
        found,
        residuals,
        _deviance(residuals, failed),
        fitted.covariance,
        method,
    )


def log_likelihood_of(lives: Lives, x: Float, family: str, start: Float | None = None) -> tuple[float, Float, Float]:
    """Largest log-likelihood of lives, in s, with columns `x` (n, p) beside the intercept, its (1 + p,) coefficients, and where it was found.

    Parameters
    ----------
    lives, x, family : the model
    start : where that of lives and columns nearby was found

    Raises
    ------
    NotIdentifiableError
        The likelihood has no maximum.
    """
    model = _Model(lives, x, family)
    best = model.maximum(start)
    found = np.append(1.0, np.linalg.solve(model.to_plain, best.coefficients)) / best.sigma
    return best.log_likelihood - lives.log_jacobian, best.coefficients, found


def refit(log_limits: tuple[Float, Float], x: Float, family: str) -> Float:
    """Maxima for many sets of lives under the same conditions: (sets, 1 + p + 2) coefficients, ln σ and shape; NaN: none.

    Parameters
    ----------
    log_limits : (sets, n) lower and upper limits of ln t
    x : (n, p) columns beside the intercept
    """
    lower, upper = log_limits
    found = np.full((lower.shape[0], x.shape[1] + 3), np.nan)
    if family == GENERALISED_GAMMA:
        for i in range(lower.shape[0]):
            try:
                best = _Model(Lives(np.exp(lower[i]), np.exp(upper[i])), x, family).maximum()
            except (NotIdentifiableError, np.linalg.LinAlgError):
                continue
            found[i] = [*best.coefficients, np.log(best.sigma), best.shape]
        return found
    model = _Model(Lives(np.exp(lower[0]), np.exp(upper[0])), x, family)
    many = maximise(LogLives(lower, upper), model.design, ERRORS[family], sigma=model.held_sigma)
    good = many.converged & np.isfinite(many.log_likelihood)
    found[good, :-2] = many.coefficients[good] @ model.to_plain.T
    found[good, -2], found[good, -1] = np.log(many.sigma[good]), 0.0
    return found


@dataclass(frozen=True)
class _Best:
    """The maximum of a model: coefficients (1 + p,) of the plain design, σ, the shape q (NaN but for the generalised gamma)."""

    coefficients: Float
    sigma: float
    shape: float
    log_likelihood: float


class _Model:
    """Lives, columns beside the intercept, a family: its likelihood, with the columns brought to order one."""

    def __init__(self, lives: Lives, x: Float, family: str) -> None:
        self.lives, self.x, self.family = lives, x, family
        self.logs = lives.logarithms()
        self.centre = x.mean(axis=0)
        scale = x.std(axis=0)
        self.scale = np.where(scale > 0, scale, 1.0)
        self.design = np.column_stack((np.ones(x.shape[0]), (x - self.centre) / self.scale))
        self.held_sigma = 1.0 if family == EXPONENTIAL else None

    def maximum(self, begin: Float | None = None) -> _Best:
        """From (1/σ, c/σ) where they are given; the generalised gamma begins where it does."""
        if self.family != GENERALISED_GAMMA:
            return self._best(ERRORS[self.family], float("nan"), begin)
        sample = self._sample()
        shape, start = sample.search_shape()
        if sample is not self:
            start = self._bring(sample, start)
            shape, start = self.refine_shape(shape, start)
        if min(shape - _SHAPES[0], _SHAPES[1] - shape) < 1e-3:
            raise NotIdentifiableError(
                "the likelihood has no maximum at a finite shape",
                expected="more failures, or another family",
            )
        return self._best(log_gamma(shape), shape, start)

    def _sample(self) -> _Model:
        """Every so many-th of the lives where there are too many to search the shape with all of them."""
        every = self.lives.lower.size // _MOST_SEARCHED
        if every < 2:
            return self
        order = np.lexsort((self.lives.lower, np.isfinite(self.lives.upper)))
        rows = np.zeros(order.size, dtype=np.bool_)
        rows[order[every // 2 :: every]] = True
        x = self.x[rows]
        if np.linalg.matrix_rank(np.column_stack((np.ones(x.shape[0]), x))) <= x.shape[1]:
            return self
        return _Model(self.lives.keep(rows), x, self.family)

    def _bring(self, other: _Model, start: Float) -> Float:
        """(1/σ, c/σ) of another model in the columns of this one."""
        return np.concatenate((start[:1], np.linalg.solve(self.to_plain, other.to_plain @ start[1:])))

    def search_shape(self) -> tuple[float, Float]:
        """The best shape, and (1/σ, c/σ) there. The likelihood is concave at each shape, so that only the shape is searched."""
        start: Float | None = None

        def loss(q: float) -> float:
            nonlocal start
            found = maximise(self.logs, self.design, log_gamma(q), start=start)
            if start is not None and not found.converged[0]:
                found = maximise(self.logs, self.design, log_gamma(q))
            if found.converged[0]:
                start = np.concatenate((found.alpha[:, None], found.gamma), axis=1)
            return -float(found.log_likelihood[0]) if found.converged[0] else np.inf

        coarse = np.array([-3.0, -1.5, 0.0, 1.0, 2.0, 4.0])
        losses = [loss(q) for q in coarse]
        middle = int(np.argmin(losses))
        low = coarse[middle - 1] if middle else _SHAPES[0]
        high = coarse[middle + 1] if middle + 1 < coarse.size else _SHAPES[1]
        shape = float(optimize.minimize_scalar(loss, bounds=(low, high), method="bounded", options={"xatol": 1e-6}).x)
        if start is None:
            raise NotIdentifiableError("the likelihood of the generalised gamma has no maximum at finite parameters")
        return shape, start[0]

    def refine_shape(self, shape: float, start: Float) -> tuple[float, Float]:
        """The best shape and its (1/σ, c/σ) from one nearby and its (1/σ, c/σ), by Newton's steps in all of them at once."""
        at = np.append(start, shape)
        value, gradient, hessian = self.around_shape(at)
        for _ in range(_NEWTON_STEPS):
            step = np.linalg.solve(-hessian, gradient)
            for _ in range(_HALVINGS):
                trial = at + step
                if trial[0] > 0 and _SHAPES[0] < trial[-1] < _SHAPES[1]:
                    there = self.around_shape(trial)
                    if there[0] >= value - 1e-12 * abs(value):
                        break
                step = step / 2
            else:
                break
            at, (value, gradient, hessian) = trial, there
            if abs(step[-1]) < _SMALL_STEP:
                break
        return float(at[-1]), at[:-1]

    def around_shape(self, at: Float) -> tuple[float, Float, Float]:
        """Log-likelihood of (1/σ, c/σ, shape), with two derivatives; those by the shape are differences."""
        here, less, more = (
            differentiate(self.logs, self.design, log_gamma(at[-1] + step), at[None, :-1])
            for step in (0.0, -_SHAPE_STEP, _SHAPE_STEP)
        )
        own = (more[0][0] + less[0][0] - 2 * here[0][0]) / _SHAPE_STEP**2
        mixed = (more[1][0] - less[1][0]) / (2 * _SHAPE_STEP)
        slope = (more[0][0] - less[0][0]) / (2 * _SHAPE_STEP)
        hessian = np.block([[here[2][0], mixed[:, None]], [mixed[None, :], np.array([[own]])]])
        return float(here[0][0]), np.append(here[1][0], slope), hessian

    def _best(self, error: ErrorDistribution, shape: float, start: Float | None = None) -> _Best:
        begin = None if start is None else start[None, :]
        found = maximise(self.logs, self.design, error, sigma=self.held_sigma, start=begin)
        found = converged_single(found, f"{self.family} regression")
        c, sigma = found.coefficients[0], float(found.sigma[0])
        if (np.abs(c[1:]) > _FAR * max(sigma, 1e-3)).any() and sigma < 1e-4:
            raise NotIdentifiableError(
                f"{self.family} regression: the covariates tell failures from survivors completely"
            )
        return _Best(self.plain(c), sigma, shape, float(found.log_likelihood[0]))

    def plain(self, c: Float) -> Float:
        """Coefficients of the columns as they are from those of the columns of order one."""
        slopes = c[1:] / self.scale
        return np.concatenate(([c[0] - slopes @ self.centre], slopes))

    @property
    def to_plain(self) -> Float:
        """(1 + p, 1 + p) that makes plain coefficients of those of order one."""
        change = np.diag(np.concatenate(([1.0], 1 / self.scale)))
        change[0, 1:] = -self.centre / self.scale
        return change


class _Fitted:
    """A model at its maximum: everything that is told about it."""

    def __init__(self, model: _Model, design: Design, best: _Best) -> None:
        self.model, self.names, self.best = model, design, best
        self.error = ERRORS.get(model.family) or log_gamma(best.shape)
        self.covariance = self._covariance()

    def _covariance(self) -> Float:
        """Of plain coefficients, ln σ (not where it is held) and the shape (of a generalised gamma)."""
        model, best = self.model, self.best
        scaled = np.linalg.solve(model.to_plain, best.coefficients)
        p = scaled.size
        at = np.concatenate(([1.0], scaled))[None, :] / best.sigma
        _, _, hessian = differentiate(model.logs, model.design, self.error, at)
        information = -hessian[0]
        # From (1/σ, c/σ) to (c, ln σ).
        change = np.zeros((1 + p, 1 + p))
        change[0, p] = -1 / best.sigma
        change[1:, :p] = np.eye(p) / best.sigma
        change[1:, p] = -scaled / best.sigma
        if model.family == EXPONENTIAL:
            information, change = information[1:, 1:], change[1:, :p]
            inverse = np.linalg.inv(change.T @ information @ change)
            return np.asarray(model.to_plain @ inverse @ model.to_plain.T)
        if model.family == GENERALISED_GAMMA:
            information = -model.around_shape(np.append(at[0], best.shape))[2]
            change = np.block([[change, np.zeros((1 + p, 1))], [np.zeros((1, 1 + p)), np.ones((1, 1))]])
        full = change.T @ information @ change
        inverse = np.linalg.inv(full)
        back = np.eye(full.shape[0])
        back[:p, :p] = model.to_plain
        return np.asarray(back @ inverse @ back.T)

    @property
    def coefficients(self) -> int:
        return int(self.model.design.shape[1])

    def test_without(self, owner: str) -> RatioTest:
        smaller = self.names.without(owner)
        lost = self.names.x.shape[1] - smaller.x.shape[1]
        value = _Model(self.model.lives, smaller.x, self.model.family).maximum().log_likelihood
        return self._test_effect(owner, self.best.log_likelihood - value, lost, self.coefficients)

    def _test_effect(self, against: str, gain: float, freedom: int, coefficients: int) -> RatioTest:
        """A test of `freedom` coefficients of the larger model's `coefficients`, with the critical values of the intervals."""
        failures = self.model.lives.failures
        test = _ratio_test(against, gain, freedom)
        if self.model.family == EXPONENTIAL or failures <= coefficients:
            return test
        return replace(test, p_value=few_failures_p_value(test.statistic, freedom, failures, coefficients))

    def test_families(self) -> list[RatioTest]:
        """Of the families within this one, whether they are enough."""
        within = {WEIBULL: (EXPONENTIAL,), GENERALISED_GAMMA: (WEIBULL, LOG_NORMAL)}.get(self.model.family, ())
        return [
            _ratio_test(
                family,
                self.best.log_likelihood - _Model(self.model.lives, self.model.x, family).maximum().log_likelihood,
                1,
            )
            for family in within
        ]

    def standardised(self, limits: Float) -> Float:
        """(n,) ends of lives in s as w."""
        location = np.column_stack((np.ones(limits.size), self.model.x)) @ self.best.coefficients
        with np.errstate(divide="ignore"):
            return np.asarray((np.log(limits) - location) / self.best.sigma)

    def cumulative_hazard(self, limits: Float) -> Float:
        """(n,) −ln S at ends of lives in s; infinite at infinity."""
        w = self.standardised(limits)
        hazard = np.where(np.isposinf(w), np.inf, 0.0)
        finite = np.isfinite(w)
        hazard[finite] = -self.error.right(w[finite])[0]
        return hazard

    def cox_snell(self) -> Float:
        lives = self.model.lives
        low, high = self.cumulative_hazard(lives.lower), self.cumulative_hazard(lives.upper)
        between = np.isfinite(lives.upper) & ~lives.exact
        residual = low.copy()
        width = np.maximum(high[between] - low[between], 1e-12)
        residual[between] = low[between] + 1 - width / np.expm1(np.minimum(width, 700.0))
        if lives.entered is not None:
            residual -= self.cumulative_hazard(lives.entered)
        return residual

    def compare_groups(self, names: np.ndarray, residuals: Float) -> tuple[tuple[GroupFit, ...], list[RatioTest]]:
        """Each group against the fit, and all of them with locations of their own."""
        model = self.model
        failed = np.isfinite(model.lives.upper)
        labels = [str(name) for name in np.unique(names)]
        failing = [name for name in labels if failed[names == name].any()]
        found = []
        for name in labels:
            here = names == name
            factor, p_value = float("nan"), float("nan")
            if name in failing and len(failing) > 1:
                column = here.astype(np.float64)[:, None]
                if np.linalg.matrix_rank(np.column_stack((model.design, column)), tol=1e-8) > self.coefficients:
                    own = _Model(model.lives, np.column_stack((model.x, column)), model.family).maximum()
                    gain = own.log_likelihood - self.best.log_likelihood
                    p_value = self._test_effect(name, gain, 1, self.coefficients + 1).p_value
                    factor = float(np.exp(own.coefficients[-1]))
            found.append(
                GroupFit(name, int(here.sum()), int(failed[here].sum()), float(residuals[here].sum()), factor, p_value)
            )
        return tuple(found), self._test_locations(names, failing)

    def _test_locations(self, names: np.ndarray, failing: Sequence[str]) -> list[RatioTest]:
        """A location for each group in place of the covariates; groups without a failure follow their own survivors.

        There is none where hardly a group has two failures: locations of their own would leave no scatter to judge them by.
        """
        freedom = len(failing) - self.coefficients
        if freedom < 1 or self.model.lives.failures < _PER_GROUP * len(failing):
            return []
        kept = np.isin(names, failing)
        columns = (names[kept, None] == np.array(failing[1:])[None, :]).astype(np.float64)
        free = _Model(self.model.lives.keep(kept), columns, self.model.family).maximum().log_likelihood
        return [self._test_effect("location per group", free - self.best.log_likelihood, freedom, len(failing))]

    def intervals(self, p_values: dict[str, float]) -> tuple[tuple[Coefficient, ...], Estimate, Estimate | None, str]:
        """Coefficients, σ and shape with their limits, and where these come from."""
        model, best = self.model, self.best
        drop = limit_drop(model.family, model.lives.failures, self.coefficients)
        deviations = limit_deviations(model.family, model.lives.failures, self.coefficients)
        errors = np.sqrt(np.diag(self.covariance))
        profiled = model.family != GENERALISED_GAMMA and model.lives.distinct().lower.size <= _MOST_PROFILED
        found = []
        for i, value in enumerate(best.coefficients):
            limits = self._profile(i, drop, errors[i]) if profiled else _around(value, deviations * errors[i])
            owner = self.names.owners[i - 1] if i else ""
            name = self.names.names[i - 1] if i else "intercept"
            found.append(
                Coefficient(name, Estimate(float(value), *limits), float(errors[i]), p_values.get(owner, float("nan")))
            )
        log_sigma = float(np.log(best.sigma))
        if model.family == EXPONENTIAL:
            sigma = Estimate(1.0, 1.0, 1.0)
        else:
            step = errors[best.coefficients.size]
            ends = self._profile_sigma(drop, step) if profiled else _around(log_sigma, deviations * step)
            sigma = Estimate(best.sigma, *(float(np.exp(end)) for end in ends))
        shape = None
        if model.family == GENERALISED_GAMMA:
            shape = Estimate(best.shape, *_around(best.shape, deviations * errors[-1]))
        method = PROFILE if profiled else WIDE_INFORMATION if shape and model.lives.failures < _FEW else INFORMATION
        return tuple(found), sigma, shape, method

    def _profile(self, column: int, drop: float, step: float) -> tuple[float, float]:
        """Limits of a coefficient, of the plain design: only there does the intercept mean what it says."""
        model = self.model
        matrix = np.column_stack((np.ones(model.x.shape[0]), model.x))
        if column:  # slopes do not depend on where the others are centred
            matrix = np.column_stack((np.ones(model.x.shape[0]), model.x - model.centre))
        size = np.sqrt((matrix**2).mean(axis=0))
        rest = np.delete(matrix / size, column, axis=1)

        # Where the others go when this one is moved, to first order: a start from which few steps are left.
        best = self.best.coefficients if not column else _recentre(self.best.coefficients, model.centre)
        covariance = self.covariance if not column else _recentre_covariance(self.covariance, model.centre)
        follow = np.delete(covariance[:, column] / covariance[column, column], column)
        others = np.delete(np.append(best, np.log(self.best.sigma))[: covariance.shape[0]], column)
        size_of_rest = np.delete(size, column)

        def profile(values: Float) -> Float:
            held = model.logs.shifted(values[:, None] * matrix[:, column])
            moved = others + (values - best[column])[:, None] * follow
            count = size_of_rest.size
            sigma = np.exp(moved[:, count]) if moved.shape[1] > count else np.ones(values.size)
            start = np.column_stack((np.ones(values.size), moved[:, :count] * size_of_rest)) / sigma[:, None]
            return maximise(held, rest, self.error, sigma=model.held_sigma, start=start).log_likelihood

        return profile_limits(profile, float(self.best.coefficients[column]), self.best.log_likelihood, drop, step)

    def _profile_sigma(self, drop: float, step: float) -> tuple[float, float]:
        def profile(values: Float) -> Float:
            same = self.model.logs.shifted(0 * values[:, None])
            scaled = np.linalg.solve(self.model.to_plain, self.best.coefficients)
            start = np.concatenate(([1.0], scaled))[None, :] / np.exp(values)[:, None]
            return maximise(same, self.model.design, self.error, sigma=np.exp(values), start=start).log_likelihood

        return profile_limits(profile, float(np.log(self.best.sigma)), self.best.log_likelihood, drop, step)


def _recentre(coefficients: Float, centre: Float) -> Float:
    """(1 + p,) coefficients of columns less their centres from those of the columns themselves."""
    return np.concatenate(([coefficients[0] + coefficients[1:] @ centre], coefficients[1:]))


def _recentre_covariance(covariance: Float, centre: Float) -> Float:
    change = np.eye(covariance.shape[0])
    change[0, 1 : 1 + centre.size] = centre
    return np.asarray(change @ covariance @ change.T)


def _around(value: float, half: float) -> tuple[float, float]:
    return value - half, value + half


def limit_drop(family: str, failures: int, coefficients: int) -> float:
    """Drop of the profile at 95 % limits. Where no scatter is estimated it is that of χ² for few failures, too."""
    return LARGE_SAMPLE_DROP if family == EXPONENTIAL else critical_drop(failures, coefficients)


def limit_deviations(family: str, failures: int, coefficients: int) -> float:
    """Standard deviations of the information on either side of 95 % limits."""
    return Z if family == EXPONENTIAL else critical_deviations(failures, coefficients)


def _ratio_test(against: str, gain: float, freedom: int) -> RatioTest:
    statistic = max(2 * gain, 0.0)
    return RatioTest(against, statistic, freedom, float(special.chdtrc(freedom, statistic)))


def _deviance(cox_snell: Float, failed: Bool) -> Float:
    """(n,) deviance residuals sign(M) √(−2 [M + δ ln(δ − M)]) with the martingale residuals M = δ − H."""
    martingale = failed - cox_snell
    inner = martingale + np.where(failed, np.log(np.maximum(cox_snell, 1e-300)), 0.0)
    return np.asarray(np.sign(martingale) * np.sqrt(np.maximum(-2 * inner, 0.0)))
