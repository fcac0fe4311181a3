"""A damaged film over one cycle: soft where it has been before, as stiff as ever at its largest strain (Ogden and Roxburgh 1999)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.diagnose.mechanisms import make_effect
from pipeline.diagnose.simulation.effects import Course
from tests.physics.courses import of_a_spring

Float = NDArray[np.float64]
LOSS, CYCLES, LARGEST = 0.08, 2.0, 0.1
TURN = 2 * np.pi * np.arange(64) / 64


def course(strain: Float, cycles: tuple[Float, Float] | None = None, *, periodic: bool = True) -> Course:
    """A spring of 3 N/mm and 30 mm under a strain over time (..., P)."""
    return of_a_spring(strain, length_mm=30.0, largest=LARGEST, periodic=periodic, cycles=cycles)


def added(of: Course, rejoining: float) -> Float:
    """Tension that comes back, over that of the film."""
    values = {"loss": LOSS, "cycles": CYCLES, "strain_scale": 1e3, "rejoining": rejoining}
    (rejoins,) = make_effect("cyclic_softening", values).tension
    return np.asarray((rejoins(of) - of.tension) / np.where(of.tension == 0, 1.0, of.tension))


def test_at_the_largest_strain_all_of_the_loss_comes_back_and_at_half_of_it_a_quarter() -> None:
    found = added(course(LARGEST * np.cos(TURN)[None]), 1.0)[0]
    assert found[0] == pytest.approx(LOSS)
    assert found == pytest.approx(LOSS * np.cos(TURN) ** 2, abs=1e-12)
    third = np.mean(2 * found * np.cos(TURN) * np.exp(-3j * TURN))
    assert third == pytest.approx(LOSS / 4, abs=1e-12)


def test_what_comes_back_grows_with_the_damage_of_the_cycles() -> None:
    """Half a cycle at the first, as the stiffness has it; none without cycles."""
    strain = LARGEST * np.cos(TURN)[None, None] * np.ones((3, 1, 1))
    first = last = np.array([[1.0], [2.0], [9.0]])
    share = added(course(strain, (first, last)), 1.0)[..., 0]
    assert share == pytest.approx(LOSS * -np.expm1(-(first - 0.5) / CYCLES))
    ramp = added(course(np.linspace(0.0, LARGEST, 50)[None], periodic=False), 1.0)[0]
    assert ramp[-1] == pytest.approx(LOSS * -np.expm1(-0.5 / CYCLES))


def test_a_film_that_does_not_rejoin_bends_nothing() -> None:
    values = {"loss": LOSS, "cycles": CYCLES, "strain_scale": 1.0, "rejoining": 0.0}
    assert make_effect("cyclic_softening", values).tension == ()
