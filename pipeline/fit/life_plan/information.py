"""What one specimen tells about the life at use conditions, and what it costs, before it is tested.

Belongs here: expected information, failures and hours of a specimen at a voltage for a duration. Choosing is in
`designs`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.fit.life_plan.assumptions import Scenario
from pipeline.fit.survival.log_location_scale import ErrorDistribution
from schemas.arrays import Float

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(48)
_EDGE = 1e-12


@dataclass(frozen=True)
class Expected:
    """What one specimen of each candidate test is expected to give, by scenario.

    Parameters
    ----------
    information : (scenarios, candidates, 3, 3) Fisher information on (location at the reference, exponent, ln σ)
    failures : (scenarios, candidates) probability to fail within the test
    hours : (scenarios, candidates) h on the rig until failure or the end of the test, set-up not counted
    """

    information: Float
    failures: Float
    hours: Float


def expect(scenarios: Sequence[Scenario], voltage_kv: Float, duration_s: Float) -> Expected:
    """Expected information, failures and rig hours of one specimen.

    Parameters
    ----------
    scenarios : ways that lives may be
    voltage_kv, duration_s : (candidates,) each test

    Notes
    -----
    The score of ln t = a + n x + σ w in (a, n, ln σ) is (s, s x, s w − 1)/… with s the slope of the log density of w;
    its mean square over failures and survivors is the information (W. Meeker, L. Escobar, Statistical Methods for
    Reliability Data (1998), appendix B and chapter 10). Integrals over the share failed by Gauss and Legendre's rule.
    """
    parts = [_of_one(scenario, voltage_kv, duration_s) for scenario in scenarios]
    return Expected(*(np.stack(column) for column in zip(*parts, strict=True)))


def _of_one(scenario: Scenario, voltage_kv: Float, duration_s: Float) -> tuple[Float, Float, Float]:
    location, sigma, error = scenario.location(voltage_kv), scenario.sigma, scenario.error
    end = (np.log(duration_s) - location) / sigma
    survival = error.survival(end)
    failed = 1 - survival
    share = failed[:, None] * (_NODES + 1) / 2
    weight = failed[:, None] * _WEIGHTS / 2
    w = error.quantile_of_survival(np.clip(1 - share, _EDGE, 1 - _EDGE))
    moments = _moments(error, w, weight, end, survival)
    x = np.log(voltage_kv / scenario.reference_kv)
    rows = np.stack([np.ones_like(x) / sigma, x / sigma, np.zeros_like(x)], axis=1)
    last = np.array([0.0, 0.0, 1.0])
    outer = rows[:, :, None] * rows[:, None, :] * moments[0][:, None, None]
    mixed = rows[:, :, None] * last * moments[1][:, None, None]
    information = outer + mixed + np.swapaxes(mixed, 1, 2) + last[:, None] * last * moments[2][:, None, None]
    life = np.exp(np.minimum(location[:, None] + sigma * w, 700.0))
    hours = ((weight * life).sum(axis=1) + survival * duration_s) / 3600
    return information, failed, hours


def _moments(
    error: ErrorDistribution, w: Float, weight: Float, end: Float, survival: Float
) -> tuple[Float, Float, Float]:
    """Expected products of the scores by the location (in units of σ) and by ln σ: (candidates,) each."""
    slope = error.exact(w)[1]
    by_location, by_scale = -slope, -(w * slope + 1)
    beyond = error.right(np.minimum(end, 30.0))[1]
    end_location, end_scale = -beyond, -np.minimum(end, 30.0) * beyond
    pairs = ((0, 0), (0, 1), (1, 1))
    inside, outside = (by_location, by_scale), (end_location, end_scale)
    found = [(weight * inside[i] * inside[j]).sum(axis=1) + survival * outside[i] * outside[j] for i, j in pairs]
    return found[0], found[1], found[2]


def slope_at_use(scenario: Scenario, use_kv: float, failed_share: float) -> Float:
    """(3,) derivative of the logarithm of the life that is asked for by (location at the reference, exponent, ln σ)."""
    w = float(scenario.error.quantile_of_survival(np.array(1 - failed_share)))
    return np.array([1.0, np.log(use_kv / scenario.reference_kv), scenario.sigma * w])
