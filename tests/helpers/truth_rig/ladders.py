"""Relaxations that no small number of arms gives, as ladders of arms for the integrator."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

Float = NDArray[np.float64]


@lru_cache(maxsize=64)
def stretched_exponential(beta: float) -> tuple[Float, Float]:
    """Weights and times (in units of τ) of 18 arms whose sum is exp(−(t/τ)^β), to 1 % of the initial value."""
    times = np.logspace(-3.5, 2.0, 18)
    t = np.logspace(-3.5, 2.3, 150)
    weights, _ = nnls(np.exp(-t[:, None] / times), np.exp(-(t**beta)))
    kept = weights > 1e-6
    return weights[kept] / weights.sum(), times[kept]


def power_law(exponent: float) -> tuple[Float, Float]:
    """Springs and times s of 30 arms, 10 µs to 10⁵ s, whose sum is (s·1 s)^α between the ends.

    s^α = sin(πα)/π ∫ r^(α−1) s/(s + r) dr over r = 1/τ > 0, on equal steps of ln r.
    """
    log_rate = np.linspace(math.log(1e-5), math.log(1e5), 30)
    springs = math.sin(math.pi * exponent) / math.pi * np.exp(exponent * log_rate) * (log_rate[1] - log_rate[0])
    return springs, np.exp(-log_rate)
