"""Static force of an actuator under voltage, with the drift of its pre-stretch fitted before, during and after at once.

    F(t) = F0 + b log(t + t0) + w(t) − Σ A_c g(t − on_c, t − off_c)
    g = 1 − r e^{−(t − on)/τ}   while the voltage is on,      g = r e^{−(t − off)/τ}   after it

A film that was just stretched goes on relaxing (log of time, and what a smooth course of any shape adds to that); under voltage most of
the force comes at once and a part r slowly. The level before alone would book the drift as force: 5 % of it and more. Does not belong here: edges of the voltage, and means of
repeats.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from schemas.arrays import Float, Int
from schemas.errors import NotIdentifiableError

_WINDOWS = 30
"""Means into which each part of the record, before, during and after, is taken together: drift and creep are slow."""
_FEWEST_WINDOWS = 4
_LEAST_SLOW_S, _SLOW_STARTS, _DRIFT_STARTS = 0.05, 4, 3
_WORTH = 6.0
"""Twice the log likelihood for which the slow part is taken: the 99 % point of χ² with two degrees is 9.2, half-way between that and
BIC's for a hundred windows."""
_WANDERS: Float = np.concatenate([[0.0], np.geomspace(1e-2, 1e10, 25)])
"""Variance of an integrated Wiener process over a record's length, in units of the variance of a window's noise, that is tried."""
_ROUNDS = 2
"""Turns of a search given the course's variance and of that given the search."""
_LARGEST_SLOW, _LONGEST_SLOW = 0.8, 0.5
"""Largest slow part, and its longest time over the shortest time of voltage: what is slower cannot be told from drift."""


@dataclass(frozen=True)
class StaticForce:
    """Drops of tension under voltage, corrected for drift.

    Parameters
    ----------
    force_n : (C,) N, positive
        What each time of voltage comes to in the end.
    force_sd_n : (C,) N
        Standard deviation, with what drift and slow part leave open.
    degrees_of_freedom : int
        Of these standard deviations.
    """

    force_n: Float
    force_sd_n: Float
    degrees_of_freedom: int


def fit_static_force(time: Float, force: Float, cycles: Sequence[tuple[float, float]], settle_s: float) -> StaticForce:
    """Static force of every time of voltage of a record.

    Parameters
    ----------
    time : (n,) s, ascending
    force : (n,) N, tension
    cycles : pairs of s
        When the voltage came on and went off, in the order of time.
    settle_s : float
        Time after every edge that is left out: the voltage on its way, the ringing of the clamp.

    Returns
    -------
    StaticForce

    Raises
    ------
    NotIdentifiableError
        Where a time of voltage or the rest before the first has fewer than four samples.

    Notes
    -----
    Samples are taken together to means over windows, whose scatter about the model is the noise, so that correlation of neighbouring
    samples does not make intervals too narrow. The drift and the slow part are searched from several starts (variable projection: A, F0
    and b are linear given t0, τ and r); the slow part is kept where it is worth its parameters.
    """
    windows = _windows(time, force, cycles, settle_s)
    plain = _fit(windows, cycles, slow=False)
    slow = _fit(windows, cycles, slow=True)
    best = slow if 2 * (slow.likelihood - plain.likelihood) > _WORTH else plain
    return _result(best, windows, cycles)


@dataclass(frozen=True)
class _Windows:
    """Means of the force: (m,) s, N and number of samples; start of the record in s."""

    time: Float
    force: Float
    count: Float
    start_s: float
    length_s: float


@dataclass(frozen=True)
class _Fitted:
    """Optimum: searched (log t0[, log τ, r]), linear (F0, b, A…), sum of squares of weighted residuals, degrees of freedom.

    whitener : (m, m) that makes windows alike and independent; likelihood : restricted, in logarithm
    """

    searched: Float
    linear: Float
    cost: float
    freedom: int
    whitener: Float
    likelihood: float


def _windows(time: Float, force: Float, cycles: Sequence[tuple[float, float]], settle_s: float) -> _Windows:
    edges = [float(time[0]) - settle_s, *(edge for cycle in cycles for edge in cycle), float(time[-1])]
    means: list[tuple[float, float, int]] = []
    for number, (begin, end) in enumerate(itertools.pairwise(edges)):
        inside = np.flatnonzero((time >= begin + settle_s) & (time < end))
        if inside.size < _FEWEST_WINDOWS:
            if number == 0 or number % 2:
                when = "before the voltage" if number == 0 else "while the voltage is on"
                raise NotIdentifiableError(
                    f"{inside.size} samples of force {when}",
                    expected=f"at least {_FEWEST_WINDOWS} after it has settled",
                )
            continue
        for part in np.array_split(inside, min(_WINDOWS, inside.size)):
            means.append((float(time[part].mean()), float(force[part].mean()), part.size))
    at, value, count = (np.array(column, dtype=float) for column in zip(*means, strict=True))
    return _Windows(at, value, count, float(time[0]), float(time[-1] - time[0]))


def _fit(windows: _Windows, cycles: Sequence[tuple[float, float]], *, slow: bool) -> _Fitted:
    """The best of several searches over what is not linear, then in turn with the variance of the smooth course."""
    shortest = min(off - on for on, off in cycles)

    def solved(x: Float, whitener: Float) -> tuple[Float, Float]:
        design = whitener @ _design(windows.time, x, windows.start_s, cycles)
        linear = np.linalg.lstsq(design, whitener @ windows.force, rcond=None)[0]
        return np.asarray(linear), np.asarray(design @ linear - whitener @ windows.force)

    def search(start: Sequence[float] | Float, whitener: Float) -> OptimizeResult:
        return least_squares(
            lambda x: solved(x, whitener)[1], np.clip(start, low, high), bounds=(low, high), x_scale="jac"
        )

    low, high = [math.log(1e-3 * windows.length_s)], [math.log(30 * windows.length_s)]
    starts = [[t] for t in np.linspace(low[0] + 2, high[0] - 1, _DRIFT_STARTS)]
    if slow:
        low, high = (
            [*low, math.log(_LEAST_SLOW_S), -_LARGEST_SLOW],
            [*high, math.log(max(_LONGEST_SLOW * shortest, 2 * _LEAST_SLOW_S)), _LARGEST_SLOW],
        )
        times = np.linspace(low[1], high[1], _SLOW_STARTS + 2)[1:-1]
        starts = [[t, tau, 0.1] for (t,) in starts for tau in times]
    course = _Course.of(windows)

    def settle(x: Float) -> tuple[Float, float]:
        """(m, m) whitener for the most likely variance of the course where the search has got to, and the likelihood."""
        design = _design(windows.time, x, windows.start_s, cycles)
        likelihood, wander = max((course.measure_likelihood(q, design, windows.force), q) for q in _WANDERS)
        return course.whiten(wander), likelihood

    # What a slow part may explain, a course that wanders may, too: searched under both.
    found = []
    for stiff in (course.whiten(0.0), settle(np.array(starts[0]) if not slow else np.array([*starts[0][:2], 0.0]))[0]):
        x = min((search(start, stiff) for start in starts), key=lambda one: one.cost).x
        for _ in range(_ROUNDS):
            whitener = settle(x)[0]
            x = search(x, whitener).x
        found.append((settle(x)[1], x, whitener))
    likelihood, x, whitener = max(found, key=lambda one: one[0])
    linear, residual = solved(x, whitener)
    return _Fitted(
        searched=x,
        linear=linear,
        cost=float(residual @ residual),
        freedom=residual.size - linear.size - x.size,
        whitener=whitener,
        likelihood=likelihood,
    )


@dataclass(frozen=True)
class _Course:
    """A smooth course of any shape beside the noise of windows: an integrated Wiener process (Wahba 1978).

    vectors, values : of its covariance, whitened by the noise; weight : (m,) that make windows alike
    """

    vectors: Float
    values: Float
    weight: Float

    @classmethod
    def of(cls, windows: _Windows) -> _Course:
        weight = np.sqrt(windows.count / windows.count.mean())
        t = (windows.time - windows.start_s) / windows.length_s
        first, last = np.minimum(t[:, None], t), np.maximum(t[:, None], t)
        covariance = first**2 * (3 * last - first) / 6 * np.outer(weight, weight)
        values, vectors = np.linalg.eigh(covariance)
        return cls(vectors, np.maximum(values, 0.0), weight)

    def whiten(self, wander: float) -> Float:
        """(m, m) that makes windows alike and independent where the course has that variance."""
        return np.asarray((self.vectors / np.sqrt(1 + wander * self.values)).T * self.weight)

    def measure_likelihood(self, wander: float, design: Float, force: Float) -> float:
        """Logarithm of the restricted likelihood (Patterson and Thompson 1971), with the noise at its best."""
        white = self.whiten(wander)
        q, r = np.linalg.qr(white @ design)
        y = white @ force
        left = y - q @ (q.T @ y)
        freedom = y.size - r.shape[0]
        spread = float(np.sum(np.log(1 + wander * self.values)))
        known = float(np.sum(np.log(np.maximum(np.abs(np.diag(r)), np.finfo(float).tiny))))
        noise = max(float(left @ left) / freedom, np.finfo(float).tiny)
        return float(-0.5 * (freedom * math.log(noise) + spread) - known)


def _design(time: Float, searched: Float, start_s: float, cycles: Sequence[tuple[float, float]]) -> Float:
    """(m, 2 + C) columns of F0, b and the forces at what is searched."""
    drift = np.log((time - start_s) + math.exp(searched[0]))
    columns = [np.ones_like(time), drift - drift.mean()]
    tau, share = (math.exp(searched[1]), searched[2]) if searched.size > 1 else (1.0, 0.0)
    for on, off in cycles:
        risen = np.where(time >= on, 1 - share * np.exp(-np.maximum(time - on, 0.0) / tau), 0.0)
        # The part that came slowly goes slowly: what it had reached is left when the voltage goes.
        reached = share * -math.expm1(-(off - on) / tau)
        fallen = np.where(time >= off, reached * np.exp(-np.maximum(time - off, 0.0) / tau), risen)
        columns.append(-fallen)
    return np.column_stack(columns)


def _result(fit: _Fitted, windows: _Windows, cycles: Sequence[tuple[float, float]]) -> StaticForce:
    """Forces with their covariance over all parameters: what drift and slow part leave open belongs to it."""
    size, count = fit.searched.size, len(cycles)
    everything = np.concatenate([fit.searched, fit.linear])

    def modelled(x: Float) -> Float:
        return np.asarray(fit.whitener @ (_design(windows.time, x[:size], windows.start_s, cycles) @ x[size:]))

    steps = 1e-5 * np.maximum(np.abs(everything), 1e-3)
    columns = [
        (modelled(everything + s) - modelled(everything - s)) / (2 * h)
        for s, h in zip(np.diag(steps), steps, strict=True)
    ]
    jacobian = np.column_stack(columns)
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), np.finfo(float).tiny)
    covariance = np.linalg.pinv((jacobian / scale).T @ (jacobian / scale), rcond=1e-10) / np.outer(scale, scale)
    variance = fit.cost / max(fit.freedom, 1) * np.diag(covariance)
    places: Int = np.arange(size + 2, size + 2 + count)
    return StaticForce(
        force_n=fit.linear[2:],
        force_sd_n=np.sqrt(np.maximum(variance[places], 0.0)),
        degrees_of_freedom=fit.freedom,
    )
