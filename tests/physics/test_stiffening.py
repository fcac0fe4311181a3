"""A film that stiffens: what the tangent rises by at a strain does not ask how the film came there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.diagnose.mechanisms import make_effect
from tests.physics.courses import of_a_spring

Float = NDArray[np.float64]
RISE, LARGEST = 0.2, 0.12


def tension(strain: Float, uneven: float, *, periodic: bool, power: float = 2.0) -> Float:
    """Of a spring of 3 N/mm and 50 mm under a strain (P,), over that of the spring at 1."""
    course = of_a_spring(strain[None], length_mm=50.0, largest=LARGEST, periodic=periodic)
    (stiffer,) = make_effect("strain_stiffening", {"stiffening": RISE, "asymmetry": uneven, "exponent": power}).tension
    return np.asarray(stiffer(course)[0] / 150.0)


@pytest.mark.parametrize("uneven", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("power", [1.0, 2.5])
@pytest.mark.parametrize("periodic", [True, False], ids=["period", "ramp"])
def test_the_tangent_rises_by_the_severity_at_the_largest_strain(uneven: float, power: float, periodic: bool) -> None:
    strain = np.linspace(0.0, LARGEST, 2001)
    slope = np.gradient(tension(strain, uneven, periodic=periodic, power=power), strain)
    assert slope[0] == pytest.approx(1.0, abs=1e-3)
    assert slope[-1] == pytest.approx(1 + RISE, rel=1e-3)
    half = 1 + RISE * 0.5**power
    assert slope[1000] == pytest.approx(half, rel=1e-3)


def test_a_ramp_and_a_period_through_the_same_strains_pull_alike() -> None:
    strain = LARGEST / 2 * (1 - np.cos(2 * np.pi * np.arange(64) / 64))
    assert tension(strain, 0.4, periodic=False) == pytest.approx(tension(strain, 0.4, periodic=True))


def test_it_stiffens_on_one_side_only_where_it_is_all_uneven() -> None:
    strain = np.linspace(-LARGEST, LARGEST, 2001)
    slope = np.gradient(tension(strain, 1.0, periodic=True), strain)
    assert slope[0] == pytest.approx(1 - RISE, rel=1e-2)
    assert slope[-1] == pytest.approx(1 + RISE, rel=1e-2)
