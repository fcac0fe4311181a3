"""Batches as a random effect: ln t = design · c + b + σ w, with one b for all specimens of a batch, normal with the scatter τ.

Belongs here: the likelihood with the batches integrated out, its maximum, intervals and what is known of each batch. A batch as
a category, with an effect of its own for each, is a covariate like any other (`life_regression`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from pipeline.fit.survival.covariates import Covariate, make_design
from pipeline.fit.survival.kaplan_meier import Estimate, Z
from pipeline.fit.survival.life_regression import ERRORS, log_likelihood_of
from pipeline.fit.survival.lifetime_distributions import EXPONENTIAL, Lives
from pipeline.fit.survival.log_location_scale import ErrorDistribution, differentiate_interval
from pipeline.fit.survival.profile_likelihood import critical_deviations, critical_drop
from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError, RefusedError

_NODES = 21
_FEWEST_BATCHES = 3
_MODE_STEPS = 30
_STEP = 1e-4
"""Of differences of gradients, in units of order one."""
_LARGEST = 12.0
"""τ is searched up to this many times the scatter of all ln t."""


@dataclass(frozen=True)
class BatchCoefficient:
    """A coefficient of ln t beside the scatter of batches, with 95 % limits.

    A column that is the same for all specimens of each batch is known from as many values as there are batches, which its
    limits allow for.
    """

    name: str
    value: Estimate
    standard_error: float


@dataclass(frozen=True)
class BatchEffect:
    """How many times as long a batch lives as the mean one, with 95 % limits for τ as fitted; drawn towards 1."""

    name: str
    specimens: int
    failures: int
    factor: Estimate


@dataclass(frozen=True)
class BatchScatter:
    """`tau` is the standard deviation of ln t between batches, `sigma` the scatter within them.

    `p_value` is that of τ = 0 against τ > 0, where `statistic` is 0 in half of all cases without a scatter of batches.
    """

    family: str
    tau: Estimate
    sigma: float
    coefficients: tuple[BatchCoefficient, ...]
    batches: tuple[BatchEffect, ...]
    log_likelihood: float
    statistic: float
    p_value: float


def fit_batch_scatter(
    lives: Lives, covariates: Sequence[Covariate], batches: Sequence[str], family: str, *, drop: float | None = None
) -> BatchScatter:
    """Regression of lives with a random effect of the batch, by maximum likelihood.

    Parameters
    ----------
    lives : n lives in s, censored in any way
    covariates : each with n values; none is needed
    batches : (n,) name of the batch of each
    family : exponential, Weibull, log-normal or log-logistic
    drop : of the profile at the limits of τ; None: `critical_drop` for as many values as there are
        batches, less what is the same within each of them

    Raises
    ------
    NotIdentifiableError
        Fewer than three batches, no batch of two or more, or no more batches than coefficients of what is the same within
        each; covariates that tell nothing.
    RefusedError
        There is not one batch for each life.

    Notes
    -----
    Each batch is integrated by adaptive Gauss–Hermite quadrature (J. Pinheiro, D. Bates, J. Comput. Graph. Stat. 4 (1995) 12)
    with 21 nodes around its most likely effect. Limits of τ are those of the profile. How often they hold the truth:
    tests/studies/results.md.
    """
    if len(batches) != lives.lower.size:
        raise RefusedError(f"{len(batches)} batches for {lives.lower.size} lives", expected="one for each")
    names, place = np.unique(np.array([str(b) for b in batches]), return_inverse=True)
    if names.size < _FEWEST_BATCHES:
        raise NotIdentifiableError(
            f"{names.size} {'batch tells' if names.size == 1 else 'batches tell'} nothing of a scatter between batches",
            expected=f"{_FEWEST_BATCHES} or more",
        )
    if np.bincount(place).max() < 2:
        raise NotIdentifiableError(
            "no batch has two specimens: the scatter between batches cannot be told from that within",
            expected="batches of two or more",
        )
    design = make_design(covariates, np.isfinite(lives.upper))
    between = int(_same_within(design.matrix, place).sum())
    if names.size <= between:
        raise NotIdentifiableError(
            f"{names.size} batches for {between} coefficients of what is the same within each batch",
            expected="more batches, or covariates that vary within them",
        )
    without, start, _ = log_likelihood_of(lives, design.x, family)
    model = _Integrated(lives, design.x, place.astype(np.int64), family)
    best = model.climb(model.begin(start))
    top = model.value(best) - lives.log_jacobian
    if top <= without + 1e-9:
        best = model.climb(model.begin(start, 0.0), tau=0.0)
        top = without
    statistic = max(2 * (top - without), 0.0)
    allowed = critical_drop(int(names.size), between) if drop is None else drop
    tau = model.limit_tau(best, top + lives.log_jacobian - allowed)
    failed = np.isfinite(lives.upper)
    return BatchScatter(
        family,
        tau,
        model.sigma(best),
        model.coefficients(best, ("intercept", *design.names), int(failed.sum())),
        model.effects(best, names, failed),
        top,
        statistic,
        float(special.chdtrc(1, statistic)) / 2 if statistic > 0 else 1.0,
    )


class _Integrated:
    """The likelihood over (τ, c of columns of order one, ln σ where it is fitted), batches integrated out."""

    def __init__(self, lives: Lives, x: Float, place: Int, family: str) -> None:
        self.place, self.batches = place, int(place.max()) + 1
        self.error = ERRORS[family]
        self.free_sigma = family != EXPONENTIAL
        scale = x.std(axis=0)
        self.centre, self.scale = x.mean(axis=0), np.where(scale > 0, scale, 1.0)
        self.design = np.column_stack((np.ones(x.shape[0]), (x - self.centre) / self.scale))
        logs = lives.logarithms()
        self.low, self.high = logs.lower[0], logs.upper[0]
        self.entered = np.full(self.low.size, -np.inf) if logs.entered is None else logs.entered[0]
        self.spread = float(np.std(np.where(np.isfinite(self.low), self.low, self.high)))
        self.nodes, weights = np.polynomial.hermite_e.hermegauss(_NODES)
        self.log_weights = np.log(weights) + self.nodes**2 / 2 - np.log(2 * np.pi) / 2
        self.modes = np.zeros(self.batches)

    def begin(self, plain: Float, tau: float | None = None) -> Float:
        """Parameters from coefficients without a scatter of batches."""
        c = np.concatenate(([plain[0] + plain[1:] @ self.centre], plain[1:] * self.scale))
        sigma = [np.log(max(self.spread, 1e-3) / 2)] if self.free_sigma else []
        return np.concatenate(([self.spread / 4 if tau is None else tau], c, sigma))

    def sigma(self, at: Float) -> float:
        return float(np.exp(at[-1])) if self.free_sigma else 1.0

    def value(self, at: Float) -> float:
        return self.differentiate(at)[0]

    def differentiate(self, at: Float) -> tuple[float, Float]:
        """Log-likelihood of ln t and its gradient."""
        tau, sigma = float(at[0]), self.sigma(at)
        predictor = self.design @ at[1 : 1 + self.design.shape[1]]
        u, log_share = self._nodes(predictor, tau, sigma)
        terms = self._terms(predictor[:, None] + tau * u[self.place], sigma)
        heights = self._per_batch(terms.value) - u**2 / 2 + log_share
        totals = special.logsumexp(heights, axis=1)
        share = np.exp(heights - totals[:, None])[self.place]
        slope = (share * terms.slope).sum(axis=1)
        gradient = [np.array([(share * terms.slope * u[self.place]).sum()]), slope @ self.design]
        if self.free_sigma:
            gradient.append(np.array([(share * terms.slope_of_log_sigma).sum()]))
        return float(totals.sum()), np.concatenate(gradient)

    def _per_batch(self, values: Float) -> Float:
        """(batches, columns) sums of (n, columns)."""
        found = np.zeros((self.batches, values.shape[1]))
        np.add.at(found, self.place, values)
        return found

    def _nodes(self, predictor: Float, tau: float, sigma: float) -> tuple[Float, Float]:
        """(batches, nodes) effects in units of τ around the most likely one, and ln of what each stands for."""
        u = self.modes
        for _ in range(_MODE_STEPS):
            terms = self._terms((predictor + tau * u[self.place])[:, None], sigma)
            slope = tau * self._per_batch(terms.slope)[:, 0] - u
            # Late entry may take the concavity away; the normal law of the effects stays.
            bend = np.maximum(1 - tau**2 * self._per_batch(terms.curvature)[:, 0], 1.0)
            step = np.clip(slope / bend, -2.0, 2.0)
            u = u + step
            if np.abs(step).max() < 1e-9:
                break
        self.modes = u
        width = 1 / np.sqrt(bend)
        return u[:, None] + width[:, None] * self.nodes, self.log_weights + np.log(width)[:, None]

    def _terms(self, location: Float, sigma: float) -> _Terms:
        return _differentiate_lives(self.error, (self.low, self.high, self.entered), location, sigma)

    def climb(self, start: Float, *, tau: float | None = None) -> Float:
        """The maximum from `start`, or that at a given τ."""
        held = start.copy()
        if tau is not None:
            held[0] = tau
        free = slice(0 if tau is None else 1, None)

        def loss(part: Float) -> tuple[float, Float]:
            at = held.copy()
            at[free] = part
            value, gradient = self.differentiate(at)
            return -value, -gradient[free]

        bounds: list[tuple[float | None, float | None]] = [(0.0, _LARGEST * self.spread)] if tau is None else []
        bounds += [(None, None)] * self.design.shape[1]
        bounds += [(np.log(self.spread) - 12, np.log(self.spread) + 6)] if self.free_sigma else []
        options = {"maxiter": 500, "ftol": 1e-13, "gtol": 1e-7}
        held[free] = optimize.minimize(loss, held[free], jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
        return held

    def limit_tau(self, best: Float, level: float) -> Estimate:
        """τ with the places where its profile has fallen to `level`; 0 where it has not down to there."""
        near = best

        def excess(tau: float) -> float:
            nonlocal near
            near = self.climb(near, tau=tau)
            return self.value(near) - level

        tau = float(best[0])
        lower = 0.0 if excess(0.0) >= 0 else float(optimize.brentq(excess, 0.0, tau, rtol=1e-5))
        near, end = best, max(2 * tau, 0.5 * self.sigma(best))
        while excess(end) > 0:
            end *= 2
            if end > _LARGEST * self.spread:
                return Estimate(tau, lower, float("inf"))
        return Estimate(tau, lower, float(optimize.brentq(excess, tau, end, rtol=1e-5)))

    def coefficients(self, best: Float, names: Sequence[str], failures: int) -> tuple[BatchCoefficient, ...]:
        p = self.design.shape[1]
        # Where no scatter of batches is seen it stays at its bound, and the others are known as without it.
        free = np.arange(0 if best[0] > 1e-6 * self.spread else 1, best.size)
        information = np.empty((free.size, free.size))
        for row, column in enumerate(free):
            step = np.zeros(best.size)
            step[column] = _STEP
            ahead, behind = (self.differentiate(best + side * step)[1][free] for side in (1, -1))
            information[row] = (behind - ahead) / (2 * _STEP)
        covariance = np.linalg.inv((information + information.T) / 2)
        first = int(np.argmax(free == 1))
        change = np.diag(np.concatenate(([1.0], 1 / self.scale)))
        change[0, 1:] = -self.centre / self.scale
        errors = np.sqrt(np.diag(change @ covariance[first : first + p, first : first + p] @ change.T))
        values = change @ best[1 : 1 + p]
        between = _same_within(self.design, self.place)
        found = []
        for i, name in enumerate(names):
            if not between[i]:
                deviations = critical_deviations(failures, p)
            else:
                deviations = critical_deviations(self.batches, int(between.sum()))
            half = deviations * float(errors[i])
            value = float(values[i])
            found.append(BatchCoefficient(name, Estimate(value, value - half, value + half), float(errors[i])))
        return tuple(found)

    def effects(self, best: Float, names: np.ndarray, failed: Bool) -> tuple[BatchEffect, ...]:
        tau, sigma = float(best[0]), self.sigma(best)
        predictor = self.design @ best[1 : 1 + self.design.shape[1]]
        u, log_share = self._nodes(predictor, tau, sigma)
        heights = self._per_batch(self._terms(predictor[:, None] + tau * u[self.place], sigma).value)
        share = special.softmax(heights - u**2 / 2 + log_share, axis=1)
        mean = (share * u).sum(axis=1)
        deviation = np.sqrt((share * (u - mean[:, None]) ** 2).sum(axis=1))
        found = []
        for i, name in enumerate(names):
            limits = (float(np.exp(tau * (mean[i] + side * Z * deviation[i]))) for side in (0, -1, 1))
            here = self.place == i
            found.append(BatchEffect(str(name), int(here.sum()), int(failed[here].sum()), Estimate(*limits)))
        return tuple(found)


def _same_within(columns: Float, place: Int) -> Bool:
    """(p,) columns that are the same for all specimens of each batch; the intercept is one of them."""
    first = columns[np.unique(place, return_index=True)[1]]
    return np.asarray((np.abs(columns - first[place]) <= 1e-9 * np.abs(columns).max(axis=0)).all(axis=0))


@dataclass(frozen=True)
class _Terms:
    """Of each life at each location (n, columns): log-likelihood, its two derivatives in the location, that in ln σ."""

    value: Float
    slope: Float
    curvature: Float
    slope_of_log_sigma: Float


def _differentiate_lives(
    error: ErrorDistribution, ends: tuple[Float, Float, Float], location: Float, sigma: float
) -> _Terms:
    low, high, entered = ends
    exact, right, left = low == high, np.isposinf(high), np.isneginf(low)
    inside = ~(exact | right | left)
    value, slope, curvature, of_sigma = (np.zeros_like(location) for _ in range(4))

    def z_at(end: Float, rows: Bool) -> Float:
        return np.asarray((end[rows, None] - location[rows]) / sigma)

    def add(rows: Bool, z: Float, terms: tuple[Float, Float, Float], sign: float = 1.0) -> None:
        value[rows] += sign * terms[0]
        slope[rows] -= sign * terms[1] / sigma
        curvature[rows] += sign * terms[2] / sigma**2
        of_sigma[rows] -= sign * terms[1] * z

    for rows, end, terms in ((exact, low, error.exact), (right, low, error.right), (left, high, error.left)):
        if rows.any():
            z = z_at(end, rows)
            add(rows, z, terms(z))
    value[exact] -= np.log(sigma)
    of_sigma[exact] -= 1.0
    if inside.any():
        first, second = z_at(low, inside), z_at(high, inside)
        total, slopes, curves, cross = differentiate_interval(error, first, second)
        add(inside, first, (total, slopes[0], curves[0] + 2 * cross))
        add(inside, second, (np.zeros_like(total), slopes[1], curves[1]))
    late = np.isfinite(entered)
    if late.any():
        z = z_at(entered, late)
        add(late, z, error.right(z), -1.0)
    return _Terms(value, slope, curvature, of_sigma)
