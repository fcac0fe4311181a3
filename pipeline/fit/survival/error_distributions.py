"""Distributions of the scatter of ln t beside the two of `log_location_scale`: logistic, and Prentice's log gamma.

The log gamma distribution has a shape q: 1 is the smallest extreme value (Weibull lives), 0 the normal (log-normal lives),
and lives are generalised gamma (K. O. Stacy; R. L. Prentice, Biometrika 61 (1974) 539).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import special

from pipeline.fit.survival.log_location_scale import NORMAL, ErrorDistribution
from schemas.arrays import Float

_NEARLY_NORMAL = 1e-4
"""Shapes |q| below this are taken as normal, from which they differ by less than the rounding."""
_STIRLING = 100.0
"""From this k on three terms of Stirling's series give ln Γ(k) to all digits, without a difference of large numbers."""
_TINY = 1e-290
_Terms = tuple[Float, Float, Float]


def _logistic_exact(z: Float) -> _Terms:
    p = special.expit(z)
    return z - 2 * np.logaddexp(0, z), 1 - 2 * p, -2 * p * (1 - p)


def _logistic_right(z: Float) -> _Terms:
    p = special.expit(z)
    return -np.logaddexp(0, z), -p, -p * (1 - p)


def _logistic_left(z: Float) -> _Terms:
    p = special.expit(z)
    return -np.logaddexp(0, -z), 1 - p, -p * (1 - p)


LOGISTIC = ErrorDistribution(
    "logistic",
    _logistic_exact,
    _logistic_right,
    _logistic_left,
    lambda z: np.asarray(special.expit(-z)),
    lambda s: np.asarray(-special.logit(s)),
)


def log_gamma(q: float) -> ErrorDistribution:
    """Prentice's log gamma distribution of shape `q`.

    Notes
    -----
    ln f(w) = ln|q| + k ln k − k − ln Γ(k) + k (q w − e^{q w} + 1) with k = 1/q²; S(w) = Γ(k, k e^{q w})/Γ(k) for q > 0,
    one less that for q < 0.
    """
    if abs(q) < _NEARLY_NORMAL:
        return NORMAL
    k = 1 / q**2
    constant = (
        -np.log(2 * np.pi) / 2 - 1 / (12 * k) + 1 / (360 * k**3) - 1 / (1260 * k**5)
        if k > _STIRLING
        else np.log(abs(q)) + k * np.log(k) - k - special.gammaln(k)
    )
    upper, lower = (special.gammaincc, special.gammainc) if q > 0 else (special.gammainc, special.gammaincc)

    def power(z: Float) -> Float:
        return np.asarray(np.exp(np.minimum(q * z, 600.0)))

    def exact(z: Float) -> _Terms:
        less = np.expm1(np.minimum(q * z, 600.0))
        return constant + k * (q * z - less), -k * q * less, -1 - less

    def tail(z: Float, share: Callable[[float, Float], Float], sign: float) -> _Terms:
        """ln of the probability beyond z on one side; far out from the density over its own slope."""
        value, slope, _ = exact(z)
        probability = share(k, k * power(z))
        with np.errstate(divide="ignore"):
            far = value - np.log(np.maximum(-sign * slope, 1e-12))
            log_probability = np.where(probability > _TINY, np.log(np.maximum(probability, _TINY)), far)
        first = -sign * np.exp(np.minimum(value - log_probability, 300.0))
        return log_probability, first, first * (slope - first)

    def quantile_of_survival(s: Float) -> Float:
        inverse = special.gammainccinv if q > 0 else special.gammaincinv
        return np.asarray(np.log(np.maximum(inverse(k, s), _TINY) / k) / q)

    return ErrorDistribution(
        f"log gamma of shape {q:g}",
        exact,
        lambda z: tail(z, upper, 1.0),
        lambda z: tail(z, lower, -1.0),
        lambda z: np.asarray(upper(k, k * power(z))),
        quantile_of_survival,
    )
