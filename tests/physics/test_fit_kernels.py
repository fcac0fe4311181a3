"""Responses of arms in frequency and time against integration in time and differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.physics.film import RelaxationModel, Shape, arm_step, series_share, stiffness_and_slopes
from pipeline.physics.held_step import Hold, hold_stiffness, series_hold_stiffness, series_hold_values
from pipeline.physics.rig import Rig, rig_of_constants, rig_prior
from schemas.metadata import RigConstants
from tests.helpers.fit_truth import (
    ACRYLATE,
    BAND,
    CELL,
    CLAMP_HZ,
    DAMPING,
    MASS,
    STACK,
    film,
    mechanical,
    relaxation_force,
    rig,
)

Float = NDArray[np.float64]


def theta_of(model: tuple[float, tuple[float, ...], tuple[float, ...]]) -> tuple[Float, Shape]:
    k, c = np.array(model[1]), np.array(model[2])
    shape = Shape(k.size)
    return shape.join(model[0], k, c / k, 0.0), shape


def test_stiffness_is_springs_in_series_with_dampers() -> None:
    theta, shape = theta_of(ACRYLATE)
    value, _ = stiffness_and_slopes(theta, shape, 2 * np.pi * BAND)
    assert np.allclose(value, film(BAND, ACRYLATE), rtol=1e-13)


def test_state_space_of_the_film_gives_the_same_stiffness() -> None:
    """C (jω − A)⁻¹ B + D with D = k0 + Σ ki (thesis, eq 4.3 with k0 in D): the static stiffness is k0."""
    k0, k, c = ACRYLATE[0], np.array(ACRYLATE[1]), np.array(ACRYLATE[2])
    model = RelaxationModel(k0, tuple(k), tuple(c / k))
    for f in (0.0, 1.0, 52.0):
        response = -k @ np.linalg.solve(2j * np.pi * f * np.eye(3) - np.diag(-k / c), k / c) + k0 + k.sum()
        assert model.stiffness(f) == pytest.approx(response, rel=1e-13)
    assert model.stiffness(0.0) == k0


def test_parameters_of_a_film_and_back() -> None:
    """Logarithms in any order of the arms; the film has its longest first."""
    shape = Shape(2, dashpot=True)
    theta = np.log([0.4, 3.0, 0.6, 0.02, 1.5, 0.03])
    model = shape.model(theta)
    assert model.tau == pytest.approx((1.5, 0.02))
    assert np.allclose(shape.theta(model), np.log([0.4, 0.6, 3.0, 1.5, 0.02, 0.03]))
    assert np.allclose(model.stiffness(BAND), stiffness_and_slopes(theta, shape, 2 * np.pi * BAND)[0], rtol=1e-13)


def test_films_in_series_are_one_whose_compliances_add_up() -> None:
    k, other = film(BAND, ACRYLATE), film(BAND, STACK)
    share = series_share(k, other)
    assert np.allclose(1 / (k * share), 1 / k + 1 / other, rtol=1e-12)


def test_one_step_of_an_arm_is_the_solution_of_its_equation() -> None:
    """ḟ = k ė − f/τ for an even extension: against a thousand small steps, and at the ends of the range."""
    tau, k, extension, start = 0.3, 2.0, 0.7, 1.1
    decay, gain = arm_step(np.array([0.5 / tau]))
    force, h = start, 0.5 / 20_000
    for _ in range(20_000):
        middle = force + h / 2 * (k * extension / 0.5 - force / tau)
        force += h * (k * extension / 0.5 - middle / tau)
    assert decay * start + gain * k * extension == pytest.approx(force, rel=1e-6)
    assert np.allclose(arm_step(np.array([0.0, 1e3])), [[1.0, 0.0], [1.0, 1e-3]])


def test_hertz_are_not_radians() -> None:
    """Largest loss of an arm at f = 1/(2πτ)."""
    model = RelaxationModel(0.0, (1.0,), (0.01,))
    f = np.linspace(1, 100, 9901)
    assert f[np.argmax(model.stiffness(f).imag)] == pytest.approx(1 / (2 * np.pi * 0.01), abs=0.01)


@pytest.mark.parametrize("dashpot", [False, True])
@pytest.mark.parametrize("kind", ["lines", "rigid", "compliant"])
def test_slopes_are_derivatives(kind: str, dashpot: bool) -> None:
    shape = Shape(2, True, dashpot)
    theta = np.log([0.4, 0.6, 3.0, 1.5, 0.02] + ([0.03] if dashpot else []))
    hold = Hold(np.geomspace(0.001, 50, 25), np.geomspace(0.001, 20, 25), 0.05)

    def value(x: Float) -> NDArray[np.complex128]:
        if kind == "lines":
            return stiffness_and_slopes(x, shape, 2 * np.pi * BAND)[0]
        if kind == "rigid":
            return hold_stiffness(x, shape, hold)[0].astype(complex)
        return series_hold_stiffness(x, shape, hold, 2.5)[0].astype(complex)

    if kind == "lines":
        slopes = stiffness_and_slopes(theta, shape, 2 * np.pi * BAND)[1]
    elif kind == "rigid":
        slopes = hold_stiffness(theta, shape, hold)[1].astype(complex)
    else:
        slopes = series_hold_stiffness(theta, shape, hold, 2.5)[1].astype(complex)
    for i in range(theta.size):
        step = 1e-5 * np.eye(theta.size)[i]
        difference = (value(theta + step) - value(theta - step)) / 2e-5
        assert np.allclose(slopes[:, i], difference, atol=1e-7 * np.abs(difference).max() + 1e-12)


@pytest.mark.parametrize("cell", [None, 2.0, 40.0])
@pytest.mark.parametrize("ramp", [0.05, 0.002])
def test_relaxation_after_a_ramp_is_what_springs_and_dampers_do(cell: float | None, ramp: float) -> None:
    """Means over windows of any width, the first one where the fastest arm has just let go."""
    theta, shape = theta_of(STACK)
    start, width = np.geomspace(1e-4, 40, 12), np.geomspace(0.005, 20, 12)
    nodes = ramp + start + width * np.linspace(0, 1, 4001)[:, None]
    clean = relaxation_force(nodes.ravel(), STACK, ramp, cell).reshape(nodes.shape)
    expected = np.trapezoid(clean, nodes, axis=0) / width
    if cell is None:
        found = hold_stiffness(theta, shape, Hold(start, width, ramp))[0]
    else:
        hold = Hold(start, width, ramp)
        found, _, by_cell = series_hold_stiffness(theta, shape, hold, cell)
        up = series_hold_stiffness(theta, shape, hold, cell * 1.00001)[0]
        assert np.allclose(by_cell, (up - found) / 1e-5, rtol=1e-3)
        one = np.array([STACK[0]]), np.array([STACK[1]]), np.array([STACK[2]]) / np.array([STACK[1]]), 0.0
        assert np.allclose(series_hold_values(*one, hold, cell)[0], found, rtol=1e-10)
    assert np.allclose(found, expected, rtol=3e-5)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(0.2, 5.0),
    st.lists(st.tuples(st.floats(0.05, 50), st.floats(-3.5, 1.5)), min_size=1, max_size=5),
    st.floats(0.5, 500),
)
def test_series_with_a_load_cell_keeps_its_limits(k0: float, arms: list[tuple[float, float]], cell: float) -> None:
    """At once all springs act, in the end the main one; in between the force falls."""
    k, tau = np.array([a for a, _ in arms]), 10 ** np.array([b for _, b in arms])
    if np.min(np.diff(np.sort(np.log(tau))), initial=1.0) < 1e-3:
        return
    shape = Shape(k.size)
    theta = shape.join(k0, k, tau, 0.0)
    hold = Hold(np.array([1e-9, 1e-4, 1e-2, 1.0, 1e2, 1e6]), np.zeros(6), 0.0)
    value = series_hold_stiffness(theta, shape, hold, cell)[0]
    total = k0 + k.sum()
    assert value[0] == pytest.approx(total * cell / (total + cell), rel=1e-3)
    assert value[-1] == pytest.approx(k0 * cell / (k0 + cell), rel=1e-6)
    assert np.all(np.diff(value) <= 1e-9 * total)


def test_rig_response_and_its_derivatives() -> None:
    k = film(BAND, ACRYLATE)
    w = 2 * np.pi * BAND
    constants = np.array([MASS, CELL, DAMPING, 1.0])
    rig = rig_of_constants(constants)
    value, by_k, by_constants = rig.response_slopes(k, w)
    assert np.allclose(value, mechanical(BAND, k), rtol=1e-13)
    assert np.allclose(value, rig.mechanical(k, rig.clamp(w)), rtol=1e-13)
    assert np.allclose(rig.film_stiffness(value, rig.clamp(w)), k, rtol=1e-9)
    assert np.allclose((rig.response_slopes(k * (1 + 1e-6), w)[0] - value) / (1e-6 * k), by_k, rtol=1e-4)
    for actuation in (None, 0.002):
        base, _, by = rig.response_slopes(k, w, actuation)
        for i in range(4):
            step = constants * np.where(np.arange(4) == i, 1e-6, 0)
            difference = (rig_of_constants(constants + step).response_slopes(k, w, actuation)[0] - base) / step[i]
            assert np.allclose(by[:, i], difference, atol=2e-5 * np.abs(difference).max())
    assert by_constants.shape == (100, 4)


def test_derivatives_of_the_inversions() -> None:
    """∂k/∂G, ∂(F_A/V²)/∂H and those by mass, stiffness, damping and gain, against differences; every inversion
    undoes its forward model."""
    k, w, actuation = film(BAND, ACRYLATE), 2 * np.pi * BAND, 0.002
    constants = np.array([MASS, CELL, DAMPING, 1.0])
    rig = rig_of_constants(constants)
    g, h = rig.mechanical(k, rig.clamp(w)), actuation * rig.electrical(k, rig.clamp(w))
    assert np.allclose(rig.film_stiffness_of_actuation(h, actuation, rig.clamp(w)), k, rtol=1e-9)
    assert np.allclose(rig.blocked_force(h, k, rig.clamp(w)), actuation, rtol=1e-12)

    def stiffness(constants: Float, g: NDArray[np.complex128]) -> NDArray[np.complex128]:
        rig = rig_of_constants(constants)
        return rig.film_stiffness(g, rig.clamp(w))

    def blocked(constants: Float, h: NDArray[np.complex128]) -> NDArray[np.complex128]:
        rig = rig_of_constants(constants)
        return rig.blocked_force(h, k, rig.clamp(w))

    for value, response, slopes in (
        (stiffness, g, rig.film_stiffness_slopes(g, w)),
        (blocked, h, rig.blocked_force_slopes(h, k, w)),
    ):
        by_response, by_constants = slopes
        rise = (value(constants, response * (1 + 1e-6)) - value(constants, response)) / (1e-6 * response)
        assert np.allclose(rise, by_response, rtol=1e-3)
        for i in range(4):
            step = constants * np.where(np.arange(4) == i, 1e-6, 0)
            difference = (value(constants + step, response) - value(constants - step, response)) / (2 * step[i])
            assert np.allclose(by_constants[:, i], difference, atol=1e-6 * np.abs(difference).max())


def test_constants_broadcast_and_a_rigid_load_cell_shows_the_film() -> None:
    k, w = film(BAND, ACRYLATE), 2 * np.pi * BAND
    both = Rig(*(np.array([v, 1.1 * v])[:, None] for v in (MASS, CELL, DAMPING)))
    found = both.mechanical(k, both.clamp(w))
    for row, factor in zip(found, (1.0, 1.1), strict=True):
        one = Rig(factor * MASS, factor * CELL, factor * DAMPING)
        assert np.allclose(row, one.mechanical(k, one.clamp(w)), rtol=1e-14)
    rigid = Rig(MASS, np.inf, DAMPING)
    assert np.array_equal(rigid.mechanical(k, rigid.clamp(w)), k)
    assert rigid.damping_ratio == 0
    assert np.isinf(Rig(0.0, CELL, 0.0).clamp_omega)


def test_resonance_is_where_the_balance_of_forces_puts_it() -> None:
    """A spring of 2 N/mm on the rig: |G| peaks at √((kL + k)/M)."""
    f = np.linspace(40, 70, 30001)
    rig = Rig(MASS, CELL, 1e-6)
    value = rig.mechanical(np.full(f.size, 2.0 + 0j), rig.clamp(2 * np.pi * f))
    assert f[np.argmax(np.abs(value))] == pytest.approx(np.sqrt((CELL + 2.0) / MASS) / 2 / np.pi, rel=1e-4)


def test_prior_of_the_rig_file() -> None:
    prior = rig_prior(rig())
    assert prior is not None
    assert np.allclose(prior.sd, [0.03 * MASS, 0.02 * CELL, DAMPING, 0.0])
    assert rig_prior(None) is None
    assert rig_prior(RigConstants()) is None


def test_measured_clamp_frequency_replaces_a_missing_constant() -> None:
    known = {"clamp_frequency_hz": CLAMP_HZ, "clamp_frequency_hz_sd": 0.05}
    from_mass = rig_prior(RigConstants(clamp_mass_kg=1e3 * MASS, clamp_mass_kg_sd=1.0 * MASS, **known))
    from_cell = rig_prior(
        RigConstants(load_cell_stiffness_n_per_mm=CELL, load_cell_stiffness_n_per_mm_sd=0.02, **known)
    )
    assert from_mass is not None
    assert from_cell is not None
    assert from_mass.nominal[1] == pytest.approx(CELL, rel=1e-9)
    assert from_cell.nominal[0] == pytest.approx(MASS, rel=1e-9)
    assert any("clamp-alone" in a for a in from_cell.assumed)
