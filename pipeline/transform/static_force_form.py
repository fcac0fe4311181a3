"""One form of what a film's tension does under voltage: drift, slow part and noise, fitted to means over windows.

    F(t) = F0 + b log(t + t0) + w(t) − Σ A_c g(t − on_c, t − off_c) + e(t)
    g = 1 − r e^{−(t − on)/τ}   while the voltage is on,      g = r (1 − e^{−(off − on)/τ}) e^{−(t − off)/τ}   after it

w is a smooth course of any shape (an integrated Wiener process), e noise whose neighbours may go together. Belongs here: the fit of
one form. Does not belong here: which forms are tried and how they are averaged (`static_force`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from pipeline.physics.least_squares import Options, minimise_each, with_prior
from schemas.arrays import Bool, Float, Int

_DRIFT_S, _SLOW_S = (1e-3, 30.0), (0.05, 0.5)
"""Plausible t0 in lengths of the record; shortest τ in s and longest in times of voltage: what is slower cannot be told from drift."""
_SLOW_SD = 0.15
"""Standard deviation of r before anything is measured: in the thesis 90 % of the force came within 0.1 s (figure 5-5)."""
_WITHIN_SD = 3.0
_SEARCH = Options(fall=1e-3)
_ROUNDS, _ENOUGH = 3, 0.05
"""Searches for a noise at most, and twice the log probability that is not worth another."""


@dataclass(frozen=True)
class Windows:
    """Means of the force over windows.

    Parameters
    ----------
    time : (m,) s
    force : (m,) N
    length_s : (m,) s
        Length of each window.
    start_s, record_s : float, s
        Start and length of the whole record.
    cycles : pairs of s
        When the voltage came on and went off.
    """

    time: Float
    force: Float
    length_s: Float
    start_s: float
    record_s: float
    cycles: Sequence[tuple[float, float]]

    @cached_property
    def lasted_s(self) -> Float:
        """(C,) how long the voltage was on."""
        return np.array([off - on for on, off in self.cycles])

    @cached_property
    def since_s(self) -> tuple[Float, Float]:
        """(m, C) since the voltage came on and since it went off, 0 before."""
        on, off = (self.time[:, None] - np.array(edges) for edges in zip(*self.cycles, strict=True))
        return np.maximum(on, 0.0), np.maximum(off, 0.0)

    @cached_property
    def state(self) -> tuple[Bool, Bool]:
        """(m, C) whether the voltage has come on, and whether it has gone off."""
        on, off = (self.time[:, None] >= np.array(edges) for edges in zip(*self.cycles, strict=True))
        return on, off


@dataclass(frozen=True)
class Searched:
    """What is not linear, log t0 (and log τ and r of a slow part), with means and standard deviations before the measurement."""

    mean: Float
    sd: Float

    @classmethod
    def of(cls, windows: Windows, *, slow: bool) -> Searched:
        """Log t0 alone, or log τ and r, too, where a part of the force comes slowly."""
        shortest = min(off - on for on, off in windows.cycles)
        least = np.log([_DRIFT_S[0] * windows.record_s, _SLOW_S[0]])
        most = np.log([_DRIFT_S[1] * windows.record_s, max(_SLOW_S[1] * shortest, 2 * _SLOW_S[0])])
        mean, sd = np.append((least + most) / 2, 0.0), np.append((most - least) / 4, _SLOW_SD)
        return cls(mean, sd) if slow else cls(mean[:1], sd[:1])

    def spread_starts(self) -> list[Float]:
        """Where searches begin."""
        if self.mean.size == 1:
            return [self.mean + self.sd * shift for shift in (-0.5, 1.0)]
        return [self.mean + self.sd * np.array([0.0, shift, 0.3]) for shift in (-1.5, -0.5, 0.5, 1.5)]


@dataclass(frozen=True)
class Whitener:
    """(m, m) that makes windows alike and independent, and the logarithm of its determinant."""

    matrix: Float
    log_determinant: float

    @classmethod
    def of(cls, covariance: Float) -> Whitener:
        """Of the covariance of windows."""
        root = cholesky(covariance, lower=True)
        matrix = solve_triangular(root, np.eye(root.shape[0]), lower=True)
        return cls(matrix, -float(np.sum(np.log(np.diag(root)))))


@dataclass(frozen=True)
class FormFit:
    """The optimum of one form.

    Parameters
    ----------
    log_probability : float
        Of the record given the form, up to a constant that all forms share.
    searched : (k,)
    force_n, variance : (C,) N and N²
        Forces and their variances, with what all other parameters leave open; that these are estimated is in the degrees of freedom.
    """

    log_probability: float
    searched: Float
    force_n: Float
    variance: Float


def noise_covariance(windows: Windows, memory_s: float) -> Float:
    """(m, m) of means of noise whose correlation falls as exp(−t/memory), 1 on average; 0 for noise without memory."""
    if memory_s <= 0:
        return np.diag(1 / windows.length_s / np.mean(1 / windows.length_s))
    x = windows.length_s / memory_s
    between = np.abs(windows.time[:, None] - windows.time) / memory_s
    np.fill_diagonal(between, x)
    # The integral of exp(−|t − u|/memory) over two windows, in logarithms: of long windows both factors are out of range.
    factor = x / 2 + np.log(-np.expm1(-x)) - np.log(x)
    covariance = np.exp(factor[:, None] + factor - between)
    np.fill_diagonal(covariance, 2 / x + 2 / x**2 * np.expm1(-x))
    return np.asarray(covariance / np.mean(np.diag(covariance)))


def course_covariance(windows: Windows) -> Float:
    """(m, m) of an integrated Wiener process whose second derivative is 1 over a record of length 1 (Wahba 1978)."""
    t = (windows.time - windows.start_s) / windows.record_s
    first, last = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
    return np.asarray(first**2 * (3 * last - first) / 6)


def fit_form(windows: Windows, whitener: Whitener, searched: Searched, start: Float) -> FormFit:
    """Most probable parameters of one form, and how probable the form makes the record.

    Parameters
    ----------
    windows, whitener, searched
        The record, its covariance up to the variance of the noise, and what is searched.
    start : (k,)
        Where the search begins.

    Returns
    -------
    FormFit

    Notes
    -----
    F0, b, A and the variance of the noise are integrated out exactly, b as the drift over the whole record (Patterson and Thompson
    1971); what is searched by Laplace's method (Tierney and Kadane 1986). The search is one of
    least squares (`least_squares`) for a noise that follows from where the last one ended: at its end both are most probable.
    """
    seen: dict[bytes, _Point] = {}

    def look(scaled: Float) -> _Point:
        # A search begins where the one before has ended, and ends where it has been.
        if (key := scaled.tobytes()) not in seen:
            seen[key] = _Point.of(windows, whitener, searched, searched.mean + searched.sd * scaled)
        return seen[key]

    wide = np.full(start.size, _WITHIN_SD)
    place = np.clip((start - searched.mean) / searched.sd, -wide, wide)
    at = look(place)
    for _ in range(_ROUNDS):
        noise, before = at.noise, at.loss

        def lose(points: Float, _: Int, noise: float = noise) -> tuple[Float, Float]:
            (scaled,) = points
            here = look(scaled)
            return here.residual[None] / math.sqrt(noise), -here.beside[None] * searched.sd / math.sqrt(noise)

        likely = with_prior(lose, np.zeros(start.size), np.eye(start.size))
        (found,) = minimise_each(likely, [place], -wide, wide, _SEARCH)
        place = found.x
        at = look(place)
        if before - at.loss < _ENOUGH:
            break
    jacobian, beside = at.jacobian, at.beside
    hessian = beside.T @ beside / at.noise + np.diag(searched.sd**-2.0)
    volume = np.sum(np.log(np.abs(np.diag(at.r)))) + 0.5 * np.linalg.slogdet(hessian)[1] + np.sum(np.log(searched.sd))
    whole = np.column_stack([jacobian, at.design])
    information = whole.T @ whole / at.noise
    k = at.x.size
    information[:k, :k] += np.diag(searched.sd**-2.0)
    scale = 1 / np.sqrt(np.diag(information))
    variance = scale**2 * np.diag(np.linalg.pinv(information * np.outer(scale, scale), rcond=1e-12, hermitian=True))
    return FormFit(
        log_probability=float(whitener.log_determinant - 0.5 * at.loss - volume),
        searched=at.x,
        force_n=at.linear[2:],
        variance=variance[k + 2 :],
    )


@dataclass(frozen=True)
class _Point:
    """A place of a search: whitened design with its factors, linear parameters, residual, and minus twice the log probability."""

    windows: Windows
    whitener: Whitener
    searched: Searched
    x: Float
    design: Float
    q: Float
    r: Float
    linear: Float
    residual: Float
    freedom: int
    loss: float

    @classmethod
    def of(cls, windows: Windows, whitener: Whitener, searched: Searched, x: Float) -> _Point:
        seen_alike = whitener.matrix @ np.column_stack([build_design(windows, x), windows.force])
        design, y = seen_alike[:, :-1], seen_alike[:, -1]
        q, r = np.linalg.qr(design)
        seen = q.T @ y
        residual, freedom = y - q @ seen, y.size - design.shape[1]
        squares = max(float(residual @ residual), np.finfo(float).tiny)
        loss = freedom * math.log(squares) + float(np.sum(((x - searched.mean) / searched.sd) ** 2))
        linear = solve_triangular(r, seen)
        return cls(windows, whitener, searched, x, design, q, r, linear, residual, freedom, loss)

    @property
    def noise(self) -> float:
        """Variance of a window's noise."""
        return max(float(self.residual @ self.residual), np.finfo(float).tiny) / self.freedom

    @cached_property
    def jacobian(self) -> Float:
        """(m, k) derivatives of the model by what is searched."""
        return np.asarray(self.whitener.matrix @ differentiate_design(self.windows, self.x, self.linear))

    @cached_property
    def beside(self) -> Float:
        """(m, k) what the linear parameters leave of them."""
        return np.asarray(self.jacobian - self.q @ (self.q.T @ self.jacobian))


def build_design(windows: Windows, x: Float) -> Float:
    """(m, 2 + C) columns of F0, b and the forces at what is searched; b is the drift over the whole record."""
    time, late = windows.time, math.exp(x[0])
    drift = np.log(time - windows.start_s + late)
    course = [np.ones_like(time), (drift - drift.mean()) / math.log1p(windows.record_s / late)]
    has_come, has_gone = windows.state
    if x.size == 1:
        return np.column_stack([*course, -np.where(has_gone, 0.0, has_come)])
    tau, share = math.exp(x[1]), x[2]
    up, down = (np.exp(-since / tau) for since in windows.since_s)
    # The part that came slowly goes slowly: what it had reached is left when the voltage goes.
    reached = -share * np.expm1(-windows.lasted_s / tau)
    return np.column_stack([*course, -np.where(has_gone, reached * down, np.where(has_come, 1 - share * up, 0.0))])


def differentiate_design(windows: Windows, x: Float, linear: Float) -> Float:
    """(m, k) derivatives of `build_design(windows, x) @ linear` by x."""
    since, late = windows.time - windows.start_s, math.exp(x[0])
    drift, change = np.log(since + late), late / (since + late)
    whole, shrinks = math.log1p(windows.record_s / late), windows.record_s / (late + windows.record_s)
    course = change - change.mean() + (drift - drift.mean()) * shrinks / whole
    columns = [linear[1] / whole * course]
    if x.size > 1:
        tau, share, force = math.exp(x[1]), x[2], linear[2:]
        up, down = (past / tau for past in windows.since_s)
        has_come, has_gone = windows.state
        rises, falls, lasted = np.exp(-up), np.exp(-down), windows.lasted_s / tau
        rest = np.exp(-lasted)
        grown = np.where(has_gone, falls * (1 - rest), np.where(has_come, -rises, 0.0))
        later = np.where(has_gone, falls * ((1 - rest) * down - rest * lasted), np.where(has_come, -rises * up, 0.0))
        columns += [-share * (later @ force), -(grown @ force)]
    return np.column_stack(columns)
