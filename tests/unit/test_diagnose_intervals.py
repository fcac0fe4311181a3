"""Ends of severities' intervals: where χ² has risen, not where its curvature at the optimum says that it would have."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.diagnose.mechanisms import SEVERITY
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.intervals import NORMAL_90, find_interval_ends

Float = NDArray[np.float64]


def fit_of(bent: float) -> ExtendedFit:
    """Two entries that can change places; the second is a severity whose own term of χ² flattens out where `bent` is not 0."""

    def residual(x: Float) -> Float:
        own = np.tanh(bent * x[1]) / bent if bent else x[1]
        return np.array([100 * (x[0] + x[1]), 2 * own])

    jacobian = np.array([[100.0, 100.0], [0.0, 2.0]])
    parameter = SimpleNamespace(role=SEVERITY)
    of = SimpleNamespace(
        coordinates=(SimpleNamespace(parameter=parameter, fixed=False),),
        model=SimpleNamespace(size=1),
        limits=(np.array([-5.0, -5.0]), np.array([5.0, 5.0])),
        residuals=lambda several: np.array([residual(x) for x in several]),
    )
    solution = SimpleNamespace(jacobian=jacobian)
    covariance = np.linalg.inv(jacobian.T @ jacobian)
    found = SimpleNamespace(of=of, solution=solution, x=np.zeros(2), covariance=covariance, chi2=0.0)
    return cast(ExtendedFit, found)


def test_a_straight_valley_has_the_interval_of_its_curvature() -> None:
    down, up = find_interval_ends(fit_of(0.0), np.array([0.5]))
    assert (down[0], up[0]) == pytest.approx((-0.5 * NORMAL_90, 0.5 * NORMAL_90))


def test_where_the_valley_is_flatter_the_interval_is_longer() -> None:
    down, up = find_interval_ends(fit_of(1.0), np.array([0.5]))
    assert down[0] == pytest.approx(-up[0], rel=1e-6)
    assert 2.0 < (2 * np.tanh(up[0])) ** 2 < 3.5
    assert up[0] > 1.15 * 0.5 * NORMAL_90


def test_an_interval_ends_at_the_limits_of_the_search() -> None:
    down, up = find_interval_ends(fit_of(3.0), np.array([0.5]))
    assert (down[0], up[0]) == (-5.0, 5.0)
