"""What a plan of life tests takes for true: life over voltage, its scatter, and how sure one is of them.

ln t = m + n ln(V / reference) + σ (w − median of w), with m the logarithm of the median life at the reference voltage.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.fit.survival.error_distributions import LOGISTIC
from pipeline.fit.survival.life_regression import LOG_LOGISTIC, LifeRegression
from pipeline.fit.survival.lifetime_distributions import LOG_NORMAL, WEIBULL
from pipeline.fit.survival.log_location_scale import NORMAL, SMALLEST_EXTREME_VALUE, ErrorDistribution
from schemas.arrays import Float
from schemas.errors import UsageError

ERRORS: dict[str, ErrorDistribution] = {
    WEIBULL: SMALLEST_EXTREME_VALUE,
    LOG_NORMAL: NORMAL,
    LOG_LOGISTIC: LOGISTIC,
}
"""Families of lives that a plan can be made for."""
_NODES = np.sqrt(3.0) * np.array([-1.0, 0.0, 1.0])
_NODE_WEIGHTS = np.array([1.0, 4.0, 1.0]) / 6
"""Gauss and Hermite's rule of three points for a normal distribution: exact for its first five moments."""


@dataclass(frozen=True)
class LifeAssumptions:
    """Life over voltage as far as it is known before the test.

    Parameters
    ----------
    reference_kv : voltage at which the median life is given
    centre : (3,) ln of the median life in s there, exponent of the inverse power law, ln σ
    covariance : (3, 3) of them: how sure one is; zeros for a plan that believes its numbers
    families : those that the lives may have, as likely as each other; the interval is that of the first
    """

    reference_kv: float
    centre: Float
    covariance: Float
    families: tuple[str, ...] = (WEIBULL,)

    @property
    def family(self) -> str:
        return self.families[0]

    def sure(self) -> LifeAssumptions:
        """The same numbers, believed: what an optimal plan is made from."""
        return replace(self, covariance=np.zeros((3, 3)), families=self.families[:1])

    def scenarios(self) -> tuple[Scenario, ...]:
        """Lives that may be, with their weights, which sum to 1."""
        spread, directions = np.linalg.eigh(self.covariance)
        root = directions * np.sqrt(np.maximum(spread, 0.0))
        kept = np.sqrt(np.maximum(spread, 0.0)) > 1e-9
        axes = [np.arange(3) if keep else np.array([1]) for keep in kept]
        picks = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        weights = np.prod(np.where(kept, _NODE_WEIGHTS[picks], 1.0), axis=1) / len(self.families)
        points = self.centre + _NODES[picks] @ root.T
        return tuple(
            Scenario(self.reference_kv, float(m), float(n), float(np.exp(log_sigma)), family, float(weight))
            for family in self.families
            for (m, n, log_sigma), weight in zip(points, weights, strict=True)
        )


@dataclass(frozen=True)
class Scenario:
    """One way that lives may be: `log_median` (s) at the reference voltage, exponent, scatter, family, and its
    weight.
    """

    reference_kv: float
    log_median: float
    exponent: float
    sigma: float
    family: str
    weight: float = 1.0

    @property
    def error(self) -> ErrorDistribution:
        return ERRORS[self.family]

    @property
    def median_w(self) -> float:
        return float(self.error.quantile_of_survival(np.array(0.5)))

    def location(self, voltage_kv: Float) -> Float:
        """Location of ln t in ln s at voltages (…,)."""
        at = np.log(np.asarray(voltage_kv) / self.reference_kv)
        return np.asarray(self.log_median - self.sigma * self.median_w + self.exponent * at)

    def life_s(self, voltage_kv: float, failed_share: float = 0.5) -> float:
        """Time in s by which a share has failed."""
        w = float(self.error.quantile_of_survival(np.array(1 - failed_share)))
        return float(np.exp(self.location(np.array(voltage_kv)) + self.sigma * w))


def assume_life(
    *,
    reference_kv: float,
    median_h: float,
    exponent: float,
    shape: float,
    median_factor: float = 1.0,
    exponent_sd: float = 0.0,
    shape_factor: float = 1.0,
    families: tuple[str, ...] = (WEIBULL,),
) -> LifeAssumptions:
    """Assumptions from what a laboratory would say.

    Parameters
    ----------
    reference_kv, median_h : a voltage and the median life there in h
    exponent : of the inverse power law, below 0
    shape : Weibull shape, or 1/σ of the other families
    median_factor, shape_factor : the truth lies within this factor with 68 %; 1: exactly known
    exponent_sd : standard deviation of the exponent

    Raises
    ------
    UsageError
        A number has no meaning there.
    """
    wanted = (
        (reference_kv > 0, f"a reference voltage of {reference_kv:g} kV", "a voltage above 0"),
        (median_h > 0, f"a median life of {median_h:g} h", "a time above 0"),
        (exponent < 0, f"an exponent of {exponent:g}", "one below 0: life falls with voltage"),
        (shape > 0, f"a shape of {shape:g}", "a shape above 0"),
        (median_factor >= 1, f"a factor of {median_factor:g} on the median life", "a factor of at least 1"),
        (shape_factor >= 1, f"a factor of {shape_factor:g} on the shape", "a factor of at least 1"),
        (exponent_sd >= 0, f"a standard deviation of {exponent_sd:g} of the exponent", "one of at least 0"),
    )
    for good, problem, expected in wanted:
        if not good:
            raise UsageError(problem, expected=expected)
    spread = np.array([np.log(median_factor), exponent_sd, np.log(shape_factor)])
    centre = np.array([np.log(median_h * 3600), exponent, -np.log(shape)])
    return LifeAssumptions(reference_kv, centre, np.diag(spread**2), families)


def assume_as_fitted(fit: LifeRegression, reference_kv: float) -> LifeAssumptions:
    """Assumptions from a regression on the voltage alone by the inverse power law.

    Parameters
    ----------
    fit : of a family in `ERRORS`
    reference_kv : within the voltages that were tested
    """
    intercept, exponent = (one.value.value for one in fit.coefficients)
    sigma, at = fit.sigma.value, float(np.log(reference_kv))
    w = float(ERRORS[fit.family].quantile_of_survival(np.array(0.5)))
    change = np.array([[1.0, at, sigma * w], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    centre = np.array([intercept + exponent * at + sigma * w, exponent, np.log(sigma)])
    return LifeAssumptions(reference_kv, centre, change @ fit.covariance @ change.T, (fit.family,))


def doubt(assumed: LifeAssumptions, families: tuple[str, ...]) -> LifeAssumptions:
    """The same with lives that may also be of other families."""
    return replace(assumed, families=tuple(dict.fromkeys((*assumed.families, *families))))
