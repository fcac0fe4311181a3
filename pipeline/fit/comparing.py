"""Are two films, or two batches of films, the same? Differences with their intervals, and what those intervals hold."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg, stats

from schemas.arrays import Float

MEASURING, WELCH, PREDICTION = "measuring errors", "Welch", "prediction"
"""What an interval rests on: the errors of two measurements, the scatter of two batches, or that of the batch a film is held against."""
_RESOLVED = 1e-12
"""Share of the largest variance below which a direction is none."""


@dataclass(frozen=True)
class Sample:
    """A quantity in the specimens of one item: values (n,) with their standard deviations (n,), NaN where none is known."""

    values: Float
    sds: Float

    @property
    def mean(self) -> float:
        return float(np.mean(self.values))

    @property
    def sd(self) -> float:
        """Standard deviation: of the measurement of one specimen, or among several; NaN where none is known."""
        return float(np.std(self.values, ddof=1)) if self.values.size > 1 else float(self.sds[0])


@dataclass(frozen=True)
class Difference:
    """Second less first, with its 95 % interval, the p-value of no difference, and what they rest on."""

    value: float
    lower: float
    upper: float
    p_value: float
    rests_on: str


def compare_samples(first: Sample, second: Sample, *, level: float = 0.95) -> Difference | None:
    """The difference of two items in one quantity.

    Parameters
    ----------
    first, second : a specimen each, or the specimens of a batch
    level : of the interval

    Returns
    -------
    The difference of the means. Two specimens: the normal interval of their measuring errors, which says nothing of other
    specimens of their kind. Two batches: Welch's t interval (Welch 1947). A specimen against a batch of n: the t interval of
    s √(1 + 1/n), whether it may be one of the batch. None where no spread is known.
    """
    value = second.mean - first.mean
    n, m = first.values.size, second.values.size
    if n == 1 and m == 1:
        spread, freedom, rests_on = math.hypot(first.sd, second.sd), math.inf, MEASURING
    elif n > 1 and m > 1:
        a, b = first.sd**2 / n, second.sd**2 / m
        if a + b <= 0:
            return None
        spread, freedom, rests_on = math.sqrt(a + b), (a + b) ** 2 / (a**2 / (n - 1) + b**2 / (m - 1)), WELCH
    else:
        batch = first if n > 1 else second
        size = batch.values.size
        spread, freedom, rests_on = batch.sd * math.sqrt(1 + 1 / size), size - 1, PREDICTION
    if not math.isfinite(spread) or spread <= 0:
        return None
    law = stats.norm() if math.isinf(freedom) else stats.t(freedom)
    reach = float(law.ppf(0.5 + level / 2)) * spread
    return Difference(value, value - reach, value + reach, float(2 * law.sf(abs(value) / spread)), rests_on)


@dataclass(frozen=True)
class WholeTest:
    """Wald's test of all parameters at once: χ², degrees of freedom, p."""

    chi2: float
    freedom: int
    p_value: float


def compare_parameters(first: Float, second: Float, covariance: Float) -> WholeTest:
    """Whether two vectors (p,) of estimates may be of one film: dᵀ C⁻¹ d against χ² (Wald 1943).

    Parameters
    ----------
    covariance : (p, p) of the difference: the sum of both where the estimates are independent; directions without any
        variance are left out and lower the degrees of freedom
    """
    values, vectors = linalg.eigh(covariance)
    kept = values > _RESOLVED * max(float(values[-1]), 0.0)
    along = vectors[:, kept].T @ (second - first)
    chi2, freedom = float(np.sum(along**2 / values[kept])), int(kept.sum())
    return WholeTest(chi2, freedom, float(stats.chi2.sf(chi2, freedom)) if freedom else math.nan)
