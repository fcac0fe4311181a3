"""Weighted means and lines whose points scatter more than their known noise, and values with honest 95 % limits.

The noise of each point is known from its recording; what comes on top (history, temperature, an electrode painted anew) is
a relative scatter that the points themselves must show (Mandel and Paule): it grows until χ² equals the degrees of
freedom, and then the limits are Student's.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize, special

from schemas.arrays import Float

_WIDEST = 3.0
"""Largest relative scatter that is looked for."""


@dataclass(frozen=True)
class Estimate:
    """A value with its standard deviation and the degrees of freedom that this stands on; `lower`, `upper`: 95 %."""

    value: float
    sd: float
    freedom: float = math.inf

    @property
    def _half(self) -> float:
        quantile = special.ndtri(0.975) if math.isinf(self.freedom) else special.stdtrit(max(self.freedom, 1.0), 0.975)
        return float(quantile) * self.sd

    @property
    def lower(self) -> float:
        return self.value - self._half

    @property
    def upper(self) -> float:
        return self.value + self._half

    def scaled(self, factor: float, relative_sd: float = 0.0) -> Estimate:
        """Times a factor that is itself known to a relative standard deviation."""
        value = factor * self.value
        return Estimate(value, math.hypot(factor * self.sd, value * relative_sd), self.freedom)


def scatter(chi2: Callable[[float], float], freedom: int) -> float:
    """Relative scatter at which χ² equals its degrees of freedom; 0 where the noise explains all."""
    if freedom < 1 or chi2(0.0) <= freedom:
        return 0.0
    if chi2(_WIDEST) >= freedom:
        return _WIDEST
    return float(optimize.brentq(lambda tau: chi2(tau) - freedom, 0.0, _WIDEST, xtol=1e-6))


def weighted_mean(values: Float, sd: Float) -> Estimate:
    """Mean of (n,) values with known standard deviations and a common relative scatter."""

    def at(tau: float) -> tuple[float, float, float]:
        weight = 1 / (sd**2 + (tau * values) ** 2)
        mean = float(weight @ values / weight.sum())
        return mean, float(1 / math.sqrt(weight.sum())), float(weight @ (values - mean) ** 2)

    tau = scatter(lambda t: at(t)[2], values.size - 1)
    mean, error, _ = at(tau)
    return Estimate(mean, error, values.size - 1 if tau else math.inf)


def regression(design: Float, y: Float, sd: Float, relative: Float) -> tuple[Float, Float, float]:
    """Least squares of y (n,) on design (n, p) with standard deviations sd (n,) and a scatter in units of `relative` (n,).

    Returns the solution (p,), its covariance (p, p) and the degrees of freedom (infinite where the noise explains all).
    """
    free = y.size - design.shape[1]

    def at(tau: float) -> tuple[Float, Float, float]:
        weight = 1 / np.sqrt(sd**2 + (tau * relative) ** 2)
        a, b = design * weight[:, None], y * weight
        covariance: Float = np.asarray(np.linalg.pinv(a.T @ a), dtype=np.float64)
        solution = covariance @ (a.T @ b)
        return solution, covariance, float(np.sum((b - a @ solution) ** 2))

    tau = scatter(lambda t: at(t)[2], free)
    solution, covariance, _ = at(tau)
    return solution, covariance, float(free) if tau else math.inf


@dataclass(frozen=True)
class Line:
    """A straight line through points with errors in both coordinates."""

    slope: Estimate
    sd: Float
    """(n,) standard deviation of y about the line, errors of x and the scatter included."""


def line(x: Float, y: Float, sx: Float, sy: Float) -> Line:
    """Straight line through (n,) points with errors in both (York and others, Am. J. Phys. 72, 2004)."""

    def at(tau: float) -> tuple[Line, float]:
        b = float(np.polyfit(x, y, 1)[0])
        wx, wy = 1 / sx**2, 1 / (sy**2 + (tau * y) ** 2)
        for _ in range(100):
            w = wx * wy / (wx + b * b * wy)
            xm, ym = float(w @ x / w.sum()), float(w @ y / w.sum())
            u, v = x - xm, y - ym
            beta = w * (u / wy + b * v / wx)
            new = float((w * beta) @ v / ((w * beta) @ u))
            settled = abs(new - b) < 1e-12 * abs(new)
            b = new
            if settled:
                break
        centred = beta - float(w @ beta / w.sum())
        chi2 = float(w @ (y - ym - b * (x - xm)) ** 2)
        slope = Estimate(b, 1 / math.sqrt(float(w @ centred**2)), x.size - 2 if tau else math.inf)
        return Line(slope, 1 / np.sqrt(w)), chi2

    tau = scatter(lambda t: at(t)[1], x.size - 2)
    return at(tau)[0]
