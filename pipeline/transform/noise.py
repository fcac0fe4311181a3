"""Spectral density of a correlated residual, from an autoregressive model of it."""

from __future__ import annotations

import numpy as np

from schemas.arrays import Float, Int

_LARGEST_ORDER = 20
_GIVING_BACK = 4


def autoregression(residual: Float, removed: Float | None = None) -> tuple[Float, float]:
    """Coefficients a (p,) and innovation variance of e_t = Σ a_i e_{t−i} + noise.

    `removed` (k,) are the frequencies, in cycles per sample, of the k terms that were fitted before; without it a mean was
    taken off. Each of them took the power of the noise at its frequency with it, which is given back: otherwise slow noise
    looks faster and smaller than it is. p follows from the Bayesian criterion: a long model would trace the holes.
    """
    e = residual - residual.mean()
    n = e.size
    removed = np.zeros(1) if removed is None else removed
    largest = int(min(_LARGEST_ORDER, n // 10))
    left = np.array([e[lag:] @ e[: n - lag] for lag in range(largest + 1)]) / n
    if left[0] == 0:
        return np.zeros(0), 0.0
    turns = np.exp(-2j * np.pi * np.outer(np.arange(largest + 1), removed))
    waves, covariance = turns.real, left
    for _ in range(_GIVING_BACK):
        coefficients, innovation = _levinson(covariance, n)
        taken = innovation / np.abs(1 - coefficients @ turns[1 : coefficients.size + 1]) ** 2
        covariance = left + waves @ np.minimum(taken, n * left[0]) / n
    return _levinson(covariance, n)


def _levinson(covariance: Float, n: int) -> tuple[Float, float]:
    """Coefficients and innovation variance from an autocovariance (lags,), order by the Bayesian criterion."""
    best, chosen, variance = np.inf, np.zeros(0), float(covariance[0])
    a, error = np.zeros(0), float(covariance[0])
    for order in range(covariance.size):
        if order:
            reflection = (covariance[order] - a @ covariance[order - 1 : 0 : -1]) / error
            longer = np.empty(order)
            longer[:-1], longer[-1] = a - reflection * a[::-1], reflection
            a = longer
            error *= 1 - reflection**2
            if error <= 1e-14 * covariance[0]:
                break
        criterion = n * np.log(error) + (order + 1) * np.log(n)
        if criterion < best:
            best, chosen, variance = criterion, a, error
    return chosen, variance


def density_ratio(coefficients: Float, cycles_per_sample: float) -> float:
    """Density at a frequency over the innovation variance: 1/|1 − Σ a_i e^{−jωi}|²."""
    turns = np.exp(-2j * np.pi * cycles_per_sample * np.arange(1, coefficients.size + 1))
    return float(1 / np.abs(1 - np.sum(coefficients * turns)) ** 2)


def mean_variances(residual: Float, lengths: Int) -> Float:
    """Variance of the mean of `lengths` (m,) successive samples of such noise, (m,)."""
    coefficients, innovation = autoregression(residual)
    lags = int(min(max(int(lengths.max()), 1), 4096))
    covariance = _autocovariance(coefficients, innovation, lags)
    cumulated = np.concatenate([[0.0], np.cumsum(covariance[1:])])
    weighted = np.concatenate([[0.0], np.cumsum(np.arange(1, lags) * covariance[1:])])
    result = np.empty(lengths.size)
    for i, n in enumerate(lengths):
        m = int(min(n, lags)) - 1
        result[i] = (covariance[0] + 2 * (cumulated[m] - weighted[m] / n)) / n
    # Strongly negative correlations can bring the estimate below what quantised samples allow.
    return np.asarray(np.maximum(result, 1e-3 * covariance[0] / lengths))


def _autocovariance(coefficients: Float, innovation: float, lags: int) -> Float:
    p = coefficients.size
    result = np.zeros(lags)
    if p == 0:
        result[0] = innovation
        return result
    # Yule-Walker equations for the first p + 1 lags, then the recursion.
    system = np.zeros((p + 1, p + 1))
    for i in range(p + 1):
        system[i, i] += 1
        for k in range(1, p + 1):
            system[i, abs(i - k)] -= coefficients[k - 1]
    right = np.zeros(p + 1)
    right[0] = innovation
    start = np.linalg.solve(system, right)
    count = min(lags, p + 1)
    result[:count] = start[:count]
    for i in range(p + 1, lags):
        result[i] = coefficients @ result[i - 1 : i - p - 1 : -1]
    return result
