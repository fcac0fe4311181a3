"""Sizes of an actuator, and the loss of equilibrium under a field, against energies minimised step by step."""

from __future__ import annotations

import math

import pytest

from pipeline.fit.actuator.known import pull_in_limit
from pipeline.physics.actuator import Sizes, incremental_ratio, nominal_tangent, pull_in_number
from pipeline.physics.regions import pull_in_field
from tests.helpers.actuator_truth import find_loss


@pytest.mark.parametrize(("pre", "across", "exponent"), [(1.3, None, 1.5), (2.0, None, 2.0), (1.5, 1.2, 1.5)])
def test_pull_in_is_where_the_energy_has_no_minimum_any_more(pre: float, across: float | None, exponent: float) -> None:
    assert pull_in_number(pre, across, exponent) == pytest.approx(find_loss(pre, across, exponent), rel=0.02)


def test_pull_in_of_a_free_neo_hookean_film_is_the_published_one() -> None:
    """Zhao and Suo (2007): 0.69 √(μ/ε) nominal, whatever the modulus; `pull_in_field` has the same number."""
    assert math.sqrt(3 * pull_in_number(1.0, None, 2.0)) == pytest.approx(0.687, abs=2e-3)
    limit = pull_in_limit(0.6, 4.7, (1.0, None))
    assert limit.field_mv_per_m == pytest.approx(pull_in_field(0.6, 4.7), rel=0.02)


def test_sizes_give_stiffness_force_and_capacitance() -> None:
    """The thesis' film: 7 kV, 40 mm, 4.7, 1 mm at 1.4 has 0.097 N; 15 x 30 mm of 1 mm 18.7 pF."""
    one = Sizes(70.0, 40.0, 1 / 1.4**0.5, 70.0, 40.0)
    assert 4.7 * one.force_per_permittivity * 49 == pytest.approx(0.097, abs=5e-4)
    assert 4.7 * Sizes(15, 30, 1, 15, 30).capacitance_per_permittivity_nf == pytest.approx(0.0187, abs=1e-4)
    many = Sizes(70.0, 40.0, 1 / 1.4**0.5, 35.0, 40.0, layers=6, strips=3)
    assert many.force_per_permittivity == pytest.approx(3 * one.force_per_permittivity)
    assert many.stiffness_per_modulus == pytest.approx(2 * one.stiffness_per_modulus)
    assert many.film_volume_mm3 == pytest.approx(18 * one.film_volume_mm3)
    with pytest.raises(ValueError, match="electrodes are larger"):
        Sizes(70, 40, 1, 71, 40)
    with pytest.raises(ValueError, match="above 0"):
        Sizes(70, 40, 0, 70, 40)


@pytest.mark.parametrize("across", [None, 1.4])
def test_tangent_is_the_slope_of_the_stress(across: float | None) -> None:
    """By differences of the uniaxial stress, (4/9)(λ^½ − λ^(−7/4)) with free sides (thesis, eq 3.14 corrected)."""

    def stress(stretch: float) -> float:
        side = stretch**-0.5 if across is None else across
        return 4 / 9 * (stretch**0.5 - stretch**-2.5 * side**-1.5)

    for stretch in (1.0, 1.5, 2.5):
        slope = (stress(stretch + 1e-5) - stress(stretch - 1e-5)) / 2e-5
        assert nominal_tangent(stretch, across) == pytest.approx(slope, rel=1e-6)
    expected = 2.0**2 * nominal_tangent(2.0, across) / nominal_tangent(1.0, None)
    assert incremental_ratio((1.0, None), (2.0, across)) == pytest.approx(expected)
