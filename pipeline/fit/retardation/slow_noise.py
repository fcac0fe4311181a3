"""How far a displacement wanders by itself: noise of the samples and a random walk, told apart by likelihood.

A wandering zero looks like creep. Whoever takes the residuals for independent finds one retardation time too many, and intervals
that are too narrow; so both variances are estimated first, and everything after is weighted by them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs
from scipy.optimize import minimize

from pipeline.transform.holds import HeldRecord
from schemas.arrays import Float

_FLOOR = 1e-6
"""Least share of the displacement's range that a sample's noise is taken for: a curve without noise has no likelihood."""
_LEAST_WALK = 1e-12
"""Least share of a sample's variance that the walk is taken for over the whole record."""
_SIDES = 0.4, 1.0
"""First steps of the search in the logarithms of the noise and of the walk."""
_STARTS = (1e-6, 1e-3, 1.0)
"""Shares of the samples' variance that the walk has over the whole record, from which the likelihood is climbed."""


@dataclass(frozen=True)
class SlowNoise:
    """`sample_sd` mm of one sample, `walk` mm²/s of the random walk: its variance grows by so much a second."""

    sample_sd: float
    walk: float

    def covariance(self, record: HeldRecord) -> Float:
        """(n, n) mm² of the windows' means; within a window of the width w the walk is a sixth of w older than at its middle."""
        since = record.time_s - min(record.time_s[0], record.history_s[0])
        total = self.walk * np.minimum(since[:, None], since[None, :])
        own = -self.walk * record.width_s / 6 + self.sample_sd**2 / record.count + record.step**2 + record.jump**2
        total[np.diag_indices_from(total)] += own
        return np.asarray(total)


def estimate_noise(record: HeldRecord, basis: Float, near: SlowNoise | None = None) -> SlowNoise:
    """Both variances by restricted maximum likelihood (Patterson and Thompson, Biometrika 58, 1971), climbed from `near` where given.

    `basis` (n, p) are the columns that whatever the film does is made of; it takes its share of the freedom with it.
    """
    likelihood = _Likelihood(record, basis)
    span = float(np.ptp(likelihood.target)) or 1.0
    told = record.scatter[record.scatter > 0]
    guess = max(float(np.median(told)) if told.size else 1e-3 * span, _FLOOR * span)
    length = record.end_s - record.history_s[0]

    starts = (
        [(guess, share * guess**2 / length) for share in _STARTS] if near is None else [(near.sample_sd, near.walk)]
    )
    # Logarithms over those of the guess: steps must not depend on the unit of the displacement.
    unit = np.log([guess, guess**2 / length])

    def noise_at(x: Float) -> SlowNoise:
        return SlowNoise(*np.exp(x + unit).tolist())

    def score(x: Float) -> float:
        return likelihood.score(noise_at(x), restricted=True)

    lowest = np.array([math.log(_FLOOR * span / guess), math.log(_LEAST_WALK)])
    highest = np.array([math.log(span / guess), 2 * math.log(span / guess)])
    found = []
    for start in starts:
        first = np.clip(np.log(start) - unit, lowest, highest)
        # Away from a limit that it starts at.
        sides = np.where(first + _SIDES > highest, -1.0, 1.0) * _SIDES
        options = {
            "xatol": 0.02,
            "fatol": 0.01,
            "maxiter": 120,
            "initial_simplex": first + np.vstack([[0, 0], np.diag(sides)]),
        }
        bounds = list(zip(lowest, highest, strict=True))
        found.append(minimize(score, first, method="Nelder-Mead", bounds=bounds, options=options))
    return noise_at(min(found, key=lambda one: one.fun).x)


def best_score(record: HeldRecord, basis: Float, near: SlowNoise) -> float:
    """−2 × the largest log-likelihood of a record over both variances, from `near` on, where `basis` (n, p) is fitted; constants left out."""
    likelihood = _Likelihood(record, basis)

    def score(x: Float) -> float:
        noise = SlowNoise(near.sample_sd * math.exp(x[0]), near.walk * math.exp(x[1]))
        return likelihood.score(noise, restricted=False)

    # Beside a model that is wrong both are larger by orders of magnitude: from there a search from `near` does not arrive.
    square = likelihood.mean_square(near)
    start = np.array([0.5, 1.0]) * math.log(max(square, 1.0))
    simplex = start + np.array([[0.0, 0.0], [0.15, 0.0], [0.0, 0.3]])
    options = {"xatol": 0.02, "fatol": 0.005, "maxiter": 80, "initial_simplex": simplex}
    return float(minimize(score, start, method="Nelder-Mead", options=options).fun)


class _Likelihood:
    """Likelihood of the usable windows of a record under noises, where columns (n, p) are fitted.

    It is asked a hundred times for each of a thousand records: LAPACK is called as it is.
    """

    def __init__(self, record: HeldRecord, basis: Float) -> None:
        rows = record.usable
        columns = basis[rows]
        size = np.linalg.norm(columns, axis=0)
        columns = columns[:, size > 0] / size[size > 0]
        u, s, _ = np.linalg.svd(columns, full_matrices=False)
        self.target = record.displacement[rows]
        self._both = np.column_stack([u[:, s > 1e-9 * s[0]], self.target])
        # Variances are the sum of those of a noise of 1 mm, of a walk of 1 mm²/s, and of what is known.
        sampled, walked, known = (
            noise.covariance(record)[np.ix_(rows, rows)]
            for noise in (SlowNoise(1.0, 0.0), SlowNoise(0.0, 1.0), SlowNoise(0.0, 0.0))
        )
        self._sampled, self._known, self._walked = np.diag(sampled - known), np.diag(known), walked - known

    def _whiten(self, noise: SlowNoise) -> tuple[Float, Float] | None:
        """Diagonal of the root of the covariance, and columns and target in its units; None where it is none."""
        covariance = noise.walk * self._walked
        covariance.flat[:: len(covariance) + 1] += noise.sample_sd**2 * self._sampled + self._known
        # Symmetric: its transpose is in the order that LAPACK works in.
        root, failed = dpotrf(covariance.T, lower=1, clean=0, overwrite_a=1)
        return None if failed else (np.diag(root), dtrtrs(root, self._both, lower=1)[0])

    def mean_square(self, noise: SlowNoise) -> float:
        """Mean square of what is left of the target in units of a noise; 1 where that is none."""
        found = self._whiten(noise)
        if found is None:
            return 1.0
        x, y = found[1][:, :-1], found[1][:, -1]
        return float(np.mean((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2))

    def score(self, noise: SlowNoise, *, restricted: bool) -> float:
        """−2 × the (restricted) log-likelihood, constants left out."""
        found = self._whiten(noise)
        if found is None:
            return math.inf
        diagonal, white = found
        x, y = white[:, :-1], white[:, -1]
        factor, failed = dpotrf(x.T @ x, clean=0)
        if failed:
            return math.inf
        rest = y - x @ dpotrs(factor, x.T @ y)[0]
        spent = 2 * float(np.log(np.diag(factor)).sum()) if restricted else 0.0
        return 2 * float(np.log(diagonal).sum()) + spent + float(rest @ rest)
