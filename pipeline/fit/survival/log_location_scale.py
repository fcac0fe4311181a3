"""Maximum likelihood for lifetimes whose logarithm is x·c + σ w, with w of a known distribution.

w is the smallest extreme value (Weibull life) or normal (log-normal life). Rows may be exact, right-censored,
left-censored or known to an interval. In the parameters α = 1/σ and γ = c/σ the log-likelihood is concave, so Newton's
method with backtracking finds the one maximum from any start, for many data sets at once.

Belongs here: the solver and the two distributions. Does not belong here: which model to fit, intervals and refusals
(`lifetime_distributions`, `voltage_life`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError

_ITERATIONS = 200
_HALVINGS = 60
_GRADIENT = 1e-10
_LIMIT_STEPS, _LIMIT_TOLERANCE = 20, 1e-8
_LARGEST = 700.0
"""Largest exponent that still is a float."""


@dataclass(frozen=True)
class ErrorDistribution:
    """Distribution of w. `exact`, `right`, `left` give, elementwise over z, the log-likelihood of a life known exactly
    (log density), right-censored (log survival) and left-censored (log distribution), with two derivatives.
    """

    name: str
    exact: Callable[[Float], tuple[Float, Float, Float]]
    right: Callable[[Float], tuple[Float, Float, Float]]
    left: Callable[[Float], tuple[Float, Float, Float]]
    survival: Callable[[Float], Float]
    quantile_of_survival: Callable[[Float], Float]
    """w at a survival probability."""

    def moved(self, by: float) -> ErrorDistribution:
        """The distribution of w less `by`."""
        return ErrorDistribution(
            self.name,
            lambda z: self.exact(z + by),
            lambda z: self.right(z + by),
            lambda z: self.left(z + by),
            lambda z: self.survival(z + by),
            lambda s: self.quantile_of_survival(s) - by,
        )


def _exp(z: Float) -> Float:
    return np.asarray(np.exp(np.minimum(z, _LARGEST)))


def _sev_exact(z: Float) -> tuple[Float, Float, Float]:
    u = _exp(z)
    return z - u, 1 - u, -u


def _sev_right(z: Float) -> tuple[Float, Float, Float]:
    u = _exp(z)
    return -u, -u, -u


def _sev_left(z: Float) -> tuple[Float, Float, Float]:
    u = np.maximum(np.exp(np.minimum(z, 30.0)), 1e-300)
    slope = u / np.expm1(np.minimum(u, _LARGEST))
    return np.log(-np.expm1(-u)), slope, slope * (1 - u - slope)


def _hazard(z: Float) -> Float:
    """φ(z)/Q(z) of the normal distribution."""
    return np.asarray(np.exp(-(z**2) / 2 - special.log_ndtr(-z)) / np.sqrt(2 * np.pi))


def _normal_exact(z: Float) -> tuple[Float, Float, Float]:
    return -(z**2) / 2 - np.log(2 * np.pi) / 2, -z, -np.ones_like(z)


def _normal_right(z: Float) -> tuple[Float, Float, Float]:
    hazard = _hazard(z)
    return special.log_ndtr(-z), -hazard, -hazard * (hazard - z)


def _normal_left(z: Float) -> tuple[Float, Float, Float]:
    value, slope, curvature = _normal_right(-z)
    return value, -slope, curvature


SMALLEST_EXTREME_VALUE = ErrorDistribution(
    "smallest extreme value",
    _sev_exact,
    _sev_right,
    _sev_left,
    lambda z: np.exp(-_exp(z)),
    lambda s: np.log(-np.log(s)),
)
NORMAL = ErrorDistribution(
    "normal",
    _normal_exact,
    _normal_right,
    _normal_left,
    lambda z: np.asarray(special.ndtr(-z)),
    lambda s: np.asarray(-special.ndtri(s)),
)


@dataclass(frozen=True)
class LogLives:
    """Logarithms of lifetimes, (batch, n): the life lies between exp(`lower`) and exp(`upper`).

    Equal limits: exact. `upper` infinite: right-censored. `lower` minus infinite: left-censored. `count` (n,) says how
    many equal lives each stands for, None that all stand for one. `entered` (batch, n) are the logarithms of the ages at
    which specimens came under watch, minus infinity for their start; None: all of them at their start.
    """

    lower: Float
    upper: Float
    count: Float | None = None
    entered: Float | None = None

    @property
    def exact(self) -> Bool:
        return np.asarray(self.lower == self.upper)

    def shifted(self, offset: float | Float) -> LogLives:
        return self.scaled(offset, 1.0)

    def scaled(self, offset: float | Float, scale: float | Float) -> LogLives:
        """The same lives less `offset`, in units of `scale`."""
        entered = None if self.entered is None else (self.entered - offset) / scale
        return LogLives((self.lower - offset) / scale, (self.upper - offset) / scale, self.count, entered)

    @property
    def specimens(self) -> float:
        """Lives of one data set."""
        return float(self.lower.shape[1] if self.count is None else self.count.sum())

    def counted(self, values: Float) -> Float:
        """(batch, n) values, each as often as there are lives like it."""
        return values if self.count is None else values * self.count

    @property
    def exactly_known(self) -> Float:
        """(batch,) number of lives known exactly."""
        return np.asarray(self.counted(self.exact.astype(np.float64)).sum(axis=1))


@dataclass(frozen=True)
class Maximum:
    """Solution for each data set of the batch.

    `alpha` (batch,) = 1/σ, `gamma` (batch, p) = c/σ, `log_likelihood` (batch,) of ln t (of t: less Σ ln t of the exact
    lives), `converged` (batch,).
    """

    alpha: Float
    gamma: Float
    log_likelihood: Float
    converged: Bool

    @property
    def sigma(self) -> Float:
        return 1 / self.alpha

    @property
    def coefficients(self) -> Float:
        """(batch, p) c = γ/α."""
        return self.gamma / self.alpha[:, None]


def maximise(
    lives: LogLives,
    design: Float,
    distribution: ErrorDistribution,
    *,
    sigma: float | Float | None = None,
    start: Float | None = None,
) -> Maximum:
    """Maximum of the likelihood of ln t = design·c + σ w.

    Parameters
    ----------
    lives : (batch, n)
    design : (n, p), p may be 0; its columns should be of order one
    sigma : held at this value, or at these (batch,), instead of fitted
    start : (batch, 1 + p) values of (1/σ, c/σ) to begin with; from far away Newton's method takes long without an intercept

    Data sets that do not converge (no maximum exists: all lives equal, for instance) have `converged` false.
    """
    batch = lives.lower.shape[0]
    p = design.shape[1]
    finite = np.where(np.isfinite(lives.upper), lives.upper, lives.lower)
    finite = np.where(np.isfinite(finite), finite, lives.upper)
    mean = lives.counted(finite).sum(axis=1) / lives.specimens
    has_intercept = p > 0 and bool(np.all(design[:, 0] == 1.0))
    centre = mean if has_intercept else np.zeros(batch)
    spread = (
        np.maximum(np.sqrt(lives.counted((finite - mean[:, None]) ** 2).sum(axis=1) / lives.specimens), 1e-3)
        if sigma is None
        else np.array(np.broadcast_to(sigma, batch), dtype=np.float64)
    )
    scaled = lives.scaled(centre[:, None], spread[:, None])
    parameters = np.zeros((batch, 1 + p))
    parameters[:, 0] = 1.0
    if start is not None:
        parameters[:, 1:] = start[:, 1:]
        if has_intercept:
            parameters[:, 1] -= start[:, 0] * centre
        if sigma is None:
            parameters[:, 0] = start[:, 0] * spread
    free = slice(0 if sigma is None else 1, None)
    parameters, value, converged = _newton(scaled, design, distribution, parameters, free)
    alpha = parameters[:, 0] / spread
    gamma = parameters[:, 1:].copy()
    if has_intercept:
        gamma[:, 0] += alpha * centre
    return Maximum(alpha, gamma, value - lives.exactly_known * np.log(spread), converged)


def _newton(
    lives: LogLives, design: Float, distribution: ErrorDistribution, start: Float, free: slice
) -> tuple[Float, Float, Bool]:
    parameters = start.copy()
    value, gradient, hessian = differentiate(lives, design, distribution, parameters)
    size = parameters[:, free].shape[1]
    converged = np.zeros(parameters.shape[0], dtype=np.bool_)
    if size == 0:
        return parameters, value, ~converged
    stuck = np.zeros_like(converged)
    tolerance = _GRADIENT * lives.specimens
    for _ in range(_ITERATIONS):
        g, h = gradient[:, free], hessian[:, free, free]
        damping = 1e-12 * np.maximum(np.abs(np.trace(h, axis1=1, axis2=2)), 1e-12)[:, None, None] * np.eye(size)
        step = np.linalg.solve(damping - (h if lives.entered is None else _curved_down(h)), g[:, :, None])[:, :, 0]
        gain = np.einsum("bi,bi->b", g, step)
        unseen = gain <= 1e-14 * (1 + np.abs(value))
        converged = (np.abs(g).max(axis=1) <= tolerance) | unseen
        if (converged | stuck).all():
            # The value does not see this step any more; parameters do, by the root of that.
            parameters[:, free] += np.where(unseen[:, None], step, 0.0)
            break
        length = np.where(converged | stuck, 0.0, 1.0)
        if free.start == 0:  # α stays positive
            shrinking = step[:, 0] < 0
            limit = np.divide(-0.9 * parameters[:, 0], step[:, 0], out=np.full(length.size, np.inf), where=shrinking)
            length = np.minimum(length, limit)
        for _ in range(_HALVINGS):
            trial = parameters.copy()
            trial[:, free] += length[:, None] * step
            new_value, new_gradient, new_hessian = differentiate(lives, design, distribution, trial)
            bad = ~(new_value >= value + 1e-4 * length * gain) & (length > 0)
            bad &= length > 1e-15
            if not bad.any():
                break
            length = np.where(bad, length / 2, length)
        stuck |= ~converged & ~(new_value > value)  # no step is short enough: the next would end here again
        improved = (new_value >= value)[:, None]
        parameters = np.where(improved, trial, parameters)
        value = np.where(improved[:, 0], new_value, value)
        gradient = np.where(improved, new_gradient, gradient)
        hessian = np.where(improved[:, :, None], new_hessian, hessian)
    return parameters, value, converged


def _curved_down(hessian: Float) -> Float:
    """The Hessians with all curvatures negative: late entry takes the concavity away far from the maximum."""
    curvature, directions = np.linalg.eigh(hessian)
    least = 1e-8 * np.abs(curvature).max(axis=1, keepdims=True)
    curvature = -np.maximum(np.abs(curvature), least)
    return np.asarray((directions * curvature[:, None, :]) @ np.swapaxes(directions, 1, 2))


def differentiate(
    lives: LogLives, design: Float, distribution: ErrorDistribution, parameters: Float
) -> tuple[Float, Float, Float]:
    """Log-likelihood of ln t and its gradient and Hessian in (α, γ): shapes (batch,), (batch, q), (batch, q, q)."""
    predictor = parameters[:, 1:] @ design.T
    exact = lives.exact
    right = np.isposinf(lives.upper)
    left = np.isneginf(lives.lower)
    inside = ~(exact | right | left)
    value = np.zeros_like(lives.lower)
    low = _End(lives.lower, parameters, predictor)
    for mask, terms in ((exact, distribution.exact), (right, distribution.right)):
        low.fill(mask, terms, value)
    ends = [low]
    cross = None
    if left.any() or inside.any():
        high = _End(lives.upper, parameters, predictor)
        high.fill(left, distribution.left, value)
        ends.append(high)
        if inside.any():
            cross = np.zeros_like(value)
            value[inside], slopes, curves, cross[inside] = differentiate_interval(
                distribution, low.z[inside], high.z[inside]
            )
            low.slope[inside], high.slope[inside] = slopes
            low.curvature[inside], high.curvature[inside] = curves
    if lives.entered is not None and np.isfinite(lives.entered).any():
        begin = _End(lives.entered, parameters, predictor)
        watched = np.zeros_like(value)
        begin.fill(np.isfinite(lives.entered), distribution.right, watched)
        value, begin.slope, begin.curvature = value - watched, -begin.slope, -begin.curvature
        ends.append(begin)
    known = lives.exactly_known
    total = lives.counted(value).sum(axis=1) + known * np.log(parameters[:, 0])
    size = 1 + design.shape[1]
    gradient = np.zeros((parameters.shape[0], size))
    hessian = np.zeros((parameters.shape[0], size, size))
    with np.errstate(over="ignore", invalid="ignore"):  # a step that goes too far is seen by its value and halved
        for end in ends:
            slope = lives.counted(end.slope)
            gradient[:, 0] += (slope * end.y).sum(axis=1)
            gradient[:, 1:] -= slope @ design
            hessian += _products(lives.counted(end.curvature), end.y, end.y, design)
        if cross is not None:
            mixed = _products(lives.counted(cross), ends[0].y, ends[1].y, design)
            hessian += mixed + np.swapaxes(mixed, 1, 2)
    gradient[:, 0] += known / parameters[:, 0]
    hessian[:, 0, 0] -= known / parameters[:, 0] ** 2
    return total, gradient, hessian


class _End:
    """One end of all lives: finite y (0 where it is infinite), z = α y − x·γ, and what the likelihood has in z."""

    def __init__(self, y: Float, parameters: Float, predictor: Float) -> None:
        self.y = np.where(np.isfinite(y), y, 0.0)
        self.z = parameters[:, :1] * self.y - predictor
        self.slope, self.curvature = np.zeros_like(self.z), np.zeros_like(self.z)

    def fill(self, mask: Bool, terms: Callable[[Float], tuple[Float, Float, Float]], value: Float) -> None:
        """Writes the likelihood of the lives of a kind, and its derivatives."""
        if mask.any():
            # Columns, not single places, where all data sets agree on who is of the kind: several times faster.
            where = (slice(None), mask[0]) if bool((mask == mask[0]).all()) else mask
            value[where], self.slope[where], self.curvature[where] = terms(self.z[where])


def _products(weight: Float, y: Float, other: Float, design: Float) -> Float:
    """Σ weight d dᵀ over the lives, with d = ∂z/∂(α, γ) = (y, −x) and (other, −x): (batch, q, q)."""
    size = 1 + design.shape[1]
    found = np.empty((weight.shape[0], size, size))
    found[:, 0, 0] = (weight * y * other).sum(axis=1)
    found[:, 0, 1:] = -(weight * y) @ design
    found[:, 1:, 0] = -(weight * other) @ design
    pairs = (design[:, :, None] * design[:, None, :]).reshape(design.shape[0], -1)
    found[:, 1:, 1:] = (weight @ pairs).reshape(found[:, 1:, 1:].shape)
    return found


def differentiate_interval(
    distribution: ErrorDistribution, low: Float, high: Float
) -> tuple[Float, tuple[Float, Float], tuple[Float, Float], Float]:
    """ln[S(low) − S(high)] with slopes, curvatures and the cross derivative, stable in both tails."""
    log_survival_low = distribution.right(low)[0]
    early = log_survival_low > -np.log(2)  # there differences of S lose digits, those of 1 − S do not
    near = np.where(early, distribution.left(high)[0], log_survival_low)
    far = np.where(early, distribution.left(low)[0], distribution.right(high)[0])
    value = near + np.log(-np.expm1(np.minimum(far - near, -1e-300)))
    slopes, curves = [], []
    for z, sign in ((low, -1.0), (high, 1.0)):
        log_density, slope, _ = distribution.exact(z)
        share = sign * np.exp(np.minimum(log_density - value, _LARGEST / 2))
        slopes.append(share)
        curves.append(share * slope - share**2)
    return value, (slopes[0], slopes[1]), (curves[0], curves[1]), -slopes[0] * slopes[1]


def coefficient_covariance(lives: LogLives, design: Float, distribution: ErrorDistribution, maximum: Maximum) -> Float:
    """(p, p) covariance of the coefficients c from the observed information, σ being estimated as well. Batch of one."""
    parameters = np.concatenate((maximum.alpha[:, None], maximum.gamma), axis=1)
    _, _, hessian = differentiate(lives, design, distribution, parameters)
    jacobian = np.column_stack((-maximum.coefficients[0], np.eye(design.shape[1]))) / maximum.alpha[0]
    return np.asarray(jacobian @ np.linalg.inv(-hessian[0]) @ jacobian.T)


def converged_single(maximum: Maximum, what: str) -> Maximum:
    """The same maximum of a batch of one. Raises `NotIdentifiableError` when there is none."""
    if not (maximum.converged[0] and np.isfinite(maximum.log_likelihood[0]) and 1e-6 < maximum.alpha[0] < 1e6):
        raise NotIdentifiableError(f"{what}: the likelihood has no maximum at finite parameters")
    return maximum


def limits_at_drop(
    lives: LogLives, distribution: ErrorDistribution, location: float, sigma: float, drop: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Where the profiles of the location and of ln σ have fallen by `drop` on either side; NaN where no such place is found.

    Parameters
    ----------
    lives : batch of one, without covariates
    location, sigma : of the maximum

    Notes
    -----
    The four places solve ℓ = top − drop with no slope along what the parameter leaves free, by Newton's method in (1/σ, c/σ), all
    at a time (D. Venzon, S. Moolgavkar, Appl. Stat. 37 (1988) 87). A tenth of the work of walking along the profiles; where it does
    not end at such a place, as with an interval that is open, the walk is left to `profile_likelihood.profile_limits`.
    """
    own = lives.scaled(location, sigma)
    four = LogLives(
        np.repeat(own.lower, 4, axis=0),
        np.repeat(own.upper, 4, axis=0),
        own.count,
        None if own.entered is None else np.repeat(own.entered, 4, axis=0),
    )
    design = np.ones((own.lower.shape[1], 1))
    best = np.array([[1.0, 0.0]])
    top, _, hessian = differentiate(own, design, distribution, best)
    sides = np.array([-1.0, 1.0, -1.0, 1.0])
    of_location = np.array([True, True, False, False])
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        covariance = np.linalg.inv(-hessian[0])
        along = np.where(of_location[:, None], covariance[1], -covariance[0])
        length = np.sqrt(2 * drop / np.where(of_location, covariance[1, 1], covariance[0, 0]))
        moved = (sides * length)[:, None] * along
        at = np.column_stack((np.exp(moved[:, 0]), moved[:, 1]))
        for _ in range(_LIMIT_STEPS):
            value, gradient, hessian = differentiate(four, design, distribution, at)
            # Along what is free: σ at a given location (the direction (1, c)), the location at a given σ.
            free = np.where(of_location[:, None], np.column_stack((np.ones(4), at[:, 1] / at[:, 0])), [0.0, 1.0])
            score = (free * gradient).sum(axis=1)
            missing = np.column_stack((value - (top - drop), score))
            bent = (free[:, None, :] @ hessian)[:, 0, :]
            turning = (
                gradient[:, 1:] * np.column_stack((-at[:, 1] / at[:, 0] ** 2, 1 / at[:, 0])) * of_location[:, None]
            )
            slopes = np.stack((gradient, bent + turning), axis=1)
            (a, b), (c, d) = slopes[:, 0].T, slopes[:, 1].T
            step = -np.column_stack((d * missing[:, 0] - b * missing[:, 1], a * missing[:, 1] - c * missing[:, 0]))
            step /= (a * d - b * c)[:, None]
            at = np.column_stack((np.maximum(at[:, 0] + step[:, 0], 0.2 * at[:, 0]), at[:, 1] + step[:, 1]))
            if not (np.abs(step[np.isfinite(step)]) >= _LIMIT_TOLERANCE).any():  # each is there, or lost
                break
        value, gradient, hessian = differentiate(four, design, distribution, at)
        place = np.where(of_location, at[:, 1] / at[:, 0], -np.log(at[:, 0]))
        free = np.where(of_location[:, None], np.column_stack((np.ones(4), at[:, 1] / at[:, 0])), [0.0, 1.0])
        good = (np.abs(value - (top - drop)) < _LIMIT_TOLERANCE) & (sides * place > 0)
        good &= np.abs((free * gradient).sum(axis=1)) < _LIMIT_TOLERANCE * lives.specimens
        good &= (free[:, None, :] @ hessian @ free[:, :, None])[
            :, 0, 0
        ] < 0  # late entry knows other places of no slope
    low, high, narrow, wide = np.where(good, place, np.nan).tolist()
    return (location + sigma * low, location + sigma * high), (np.log(sigma) + narrow, np.log(sigma) + wide)
