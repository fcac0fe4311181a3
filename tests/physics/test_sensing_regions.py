"""Capacitance of sensing regions by their place (thesis, eq 5.6 to 5.12), and pull-in."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from pipeline.physics.regions import apart, beside, circular, pull_in_field, shared


def test_slopes_of_the_thesis_geometry() -> None:
    h = 1e-6
    for region, slope in (
        (lambda x: apart(x, 75, 20), -0.364),
        (lambda x: beside(x, 75, 20), 1.27),
        (shared, 2.0),
        (circular, 4.0),
    ):
        assert float(region(1.0)) == pytest.approx(1.0)
        assert float((region(1 + h) - region(1 - h)) / (2 * h)) == pytest.approx(slope, abs=5e-3)


def test_beside_grows_where_apart_shrinks_and_more_so() -> None:
    assert float(apart(1.05, 75, 20)) - 1 == pytest.approx(-0.018, abs=5e-4)
    assert float(beside(1.05, 75, 20)) - 1 == pytest.approx(0.063, abs=5e-4)
    assert float(beside(1 + 1e-6, 40, 20)) == pytest.approx(1.0, abs=1e-9)


def test_pull_in_is_the_largest_field_that_a_free_film_carries() -> None:
    best = minimize_scalar(lambda x: -(x**-2 - x**-8), bounds=(1.0, 2.0), method="bounded")
    assert -best.fun == pytest.approx(0.4725, abs=1e-4)
    field = pull_in_field(0.1, 4.7)
    assert 8.8541878e-6 * 4.7 * field**2 == pytest.approx(0.4725 * 0.1 / 3)
    assert np.isfinite(field)
