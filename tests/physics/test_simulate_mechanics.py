"""The virtual rig's equations of motion against other solutions of the same physics.

Truth: an adaptive integration of the equations written with internal points and analytic inputs, and closed-form
responses. Neither shares code with the integrator.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from pipeline.physics.film import RelaxationModel
from pipeline.physics.motion import Propagator, assemble, integrate
from pipeline.physics.rig import Rig

Complex = NDArray[np.complex128]

RIG = Rig(mass=0.1874e-3, stiffness=20.0, damping=6.1e-4)
THIRD = RelaxationModel(1.0, (1.5, 2.0, 30.0), (0.05 / 1.5, 0.01, 0.02 / 30))
DASHPOT = RelaxationModel(1.0, (1.5, 2.0), (0.05 / 1.5, 0.01), 0.02)


def stiffness(model: RelaxationModel, frequency_hz: NDArray[np.float64]) -> Complex:
    """k(jω) written with dampers, k0 + Σ k c jω/(k + c jω)."""
    s = 2j * np.pi * frequency_hz
    total = model.k0 + model.c_inf * s
    for k, c in zip(model.k, model.c, strict=True):
        total = total + k * c * s / (k + c * s)
    return np.asarray(total)


def rig_denominator(k: Complex, frequency_hz: NDArray[np.float64], rig: Rig = RIG) -> Complex:
    omega = 2 * np.pi * frequency_hz
    return np.asarray(k + rig.stiffness - rig.mass * omega**2 + 1j * omega * rig.damping)


def driven_by_sine(system_input: str, model: RelaxationModel, seconds: float, hz: float) -> tuple[np.ndarray, ...]:
    """Force of the load cell from an adaptive integration; displacement or Maxwell force sin²(πft)-shaped."""
    mass, kl, cl = RIG.mass, RIG.stiffness, RIG.damping
    omega = 2 * np.pi * hz

    def shape(t: float) -> tuple[float, float]:
        return 0.5 * (1 - np.cos(omega * t)), 0.5 * omega * np.sin(omega * t)

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        value, slope = shape(t)
        end, speed, maxwell = (value, slope, 0.0) if system_input == "displacement" else (0.0, 0.0, value)
        points, x, v = y[:-2], y[-2], y[-1]
        # c (ẋ_i − ẋ′) = k (x0 − x_i): the internal points, measured from where they rest
        arms = np.array(model.k) * (end - points)
        points_rate = v + arms / np.array(model.c)
        tension = model.k0 * (end - x) + arms.sum() + model.c_inf * (speed - v) - maxwell
        return np.array([*points_rate, v, (tension - kl * x - cl * v) / mass])

    time = np.arange(0, seconds, 1 / 2000)
    solved = solve_ivp(
        rates, (0, seconds), np.zeros(len(model.k) + 2), t_eval=time, method="Radau", rtol=1e-9, atol=1e-11
    )
    return time, kl * solved.y[-2]


@pytest.mark.long_after(1)
@pytest.mark.slow
@pytest.mark.parametrize("model", [THIRD, DASHPOT], ids=["three arms", "pure dashpot"])
@pytest.mark.parametrize("system_input", ["displacement", "force"])
def test_motion_equals_an_adaptive_integration(model: RelaxationModel, system_input: str) -> None:
    time, expected = driven_by_sine(system_input, model, 0.3, 35.0)
    factor = 20
    fine = np.arange(time.size * factor) / (2000 * factor)
    signal = 0.5 * (1 - np.cos(2 * np.pi * 35.0 * fine))
    inputs = [signal, None] if system_input == "displacement" else [None, signal]
    force = integrate(assemble([model], RIG, active=0), inputs, 1 / (2000 * factor))[0, ::factor]
    assert np.max(np.abs(force - expected)) < 2e-5 * np.max(np.abs(expected))


@pytest.mark.parametrize("model", [THIRD, DASHPOT], ids=["three arms", "pure dashpot"])
def test_steady_response_is_the_closed_form_to_a_ten_thousandth_at_100_hz(model: RelaxationModel) -> None:
    lines = np.array([1.0, 10.0, 40.0, 52.0, 60.0, 90.0, 100.0])
    rate = 20_000
    time = np.arange(20 * rate) / rate
    signal = np.sum([np.sin(2 * np.pi * f * time + f) for f in lines], axis=0)
    k = stiffness(model, lines)
    den = rig_denominator(k, lines)
    system = assemble([model], RIG, active=0)
    for inputs, expected in (([signal, None], k * 20.0 / den), ([None, signal], -20.0 / den)):
        force = integrate(system, inputs, 1 / rate)[0, -rate:]
        found = np.fft.rfft(force)[lines.astype(int)] / np.fft.rfft(signal[-rate:])[lines.astype(int)]
        assert np.max(np.abs(found / expected - 1)) < 1e-4


def test_equilibrium_stays() -> None:
    system = assemble([THIRD], RIG, active=0)
    force = integrate(system, [np.full(1000, 0.4), None], 1e-4)[0]
    assert force == pytest.approx(np.full(1000, 0.4 * 1.0 * 20.0 / 21.0), rel=1e-12)


def test_parts_in_series_share_the_maxwell_force_and_move_the_sensing_part() -> None:
    active = RelaxationModel(0.23, (0.2, 0.25), (3.0, 0.4))
    sensing = RelaxationModel(0.31, (0.2, 0.2, 0.3), (3.0, 0.4, 0.02))
    frequency = np.array([0.05, 0.5, 5.0, 40.0, 90.0])
    ka, ks = stiffness(active, frequency), stiffness(sensing, frequency)
    series = ka * ks / (ka + ks)
    force = -ks / (ka + ks) * 20.0 / rig_denominator(series, frequency)
    # with the clamp at x′ = force/kL, the tension is force + inertia, and the sensing part extends by tension/k_S
    omega = 2 * np.pi * frequency
    tension = force * (1 - RIG.mass * omega**2 / 20.0 + 1j * omega * RIG.damping / 20.0)
    system = assemble([active, sensing], RIG, active=0, watched=1)
    identity = np.eye(system.a.shape[0])
    found = np.array(
        [(system.c @ np.linalg.solve(1j * w * identity - system.a, system.b) + system.d)[:, 1] for w in omega]
    )
    assert found[:, 0] == pytest.approx(force, rel=1e-9)
    assert found[:, 1] == pytest.approx(tension / ks, rel=1e-9)


def test_a_uniform_film_passes_on_the_share_of_its_lengths_at_once() -> None:
    parts = [RelaxationModel(k0, (2 * k0,), (0.3,)) for k0 in (1.0, 0.5)]
    stiff = Rig(1e-6, 1e6, 1.0)
    steps = np.concatenate([np.zeros(10), np.ones(4000)])
    force = integrate(assemble(parts, stiff, active=0), [None, steps], 1e-3)[0]
    share = 0.5 / (1.0 + 0.5)
    assert force[50:] == pytest.approx(np.full(force.size - 50, -share), rel=1e-5)


arms = st.lists(st.tuples(st.floats(0.05, 40), st.floats(1e-3, 2.0)), min_size=0, max_size=4)


@settings(max_examples=40, deadline=None)
@given(arms=arms, k0=st.floats(0.05, 5), kl=st.floats(5, 35), hz=st.floats(45, 60), zeta=st.floats(1e-3, 0.03))
def test_a_held_step_ends_at_the_static_force(
    arms: list[tuple[float, float]], k0: float, kl: float, hz: float, zeta: float
) -> None:
    model = RelaxationModel(k0, tuple(k for k, _ in arms), tuple(t for _, t in arms))
    mass = kl / (2 * np.pi * hz) ** 2
    rig = Rig(mass, kl, 2 * zeta * np.sqrt(kl * mass))
    # with kL in series the slowest time is at most τ (kL + k(∞))/(kL + k0)
    slowest = max((t for _, t in arms), default=0.0) * (1 + sum(k for k, _ in arms) / (kl + k0))
    seconds = 20 * max(slowest, 1 / (zeta * 2 * np.pi * hz))
    step = np.ones(20_000)
    step[0] = 0.0
    force = integrate(assemble([model], rig), [step, None], seconds / step.size)[0]
    assert force[-1] == pytest.approx(k0 * kl / (k0 + kl), rel=1e-6)


def test_arms_of_one_time_are_their_sum() -> None:
    twice = RelaxationModel(1.0, (0.7, 0.8), (0.02, 0.02))
    once = RelaxationModel(1.0, (1.5,), (0.02,))
    signal = np.sin(2 * np.pi * 30 * np.arange(4000) / 20_000)
    found, expected = (integrate(assemble([m], RIG), [signal, None], 5e-5)[0] for m in (twice, once))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_blocks_of_the_propagator_follow_the_integrator() -> None:
    parts = [RelaxationModel(0.2, (0.2,), (3.0,)), RelaxationModel(0.3, (0.2, 0.3), (0.4, 0.02))]
    system = assemble(parts, RIG, active=0, watched=1)
    rng = np.random.default_rng(seed=3)
    signal = np.concatenate([[0.0], np.cumsum(rng.standard_normal(400))])
    expected = integrate(system, [None, signal], 1e-3)
    block = Propagator.of(system, 1, 1e-3, 20)
    state = np.zeros(system.a.shape[0])
    for end in range(20, 401, 20):
        state = block.advance @ state + block.gather @ signal[end - 20 : end + 1]
        found = system.c @ state + system.d[:, 1] * signal[end]
        assert found == pytest.approx(expected[:, end], rel=1e-8, abs=1e-10)


def test_a_chain_refuses_a_pure_dashpot() -> None:
    with pytest.raises(ValueError, match="one part"):
        assemble([DASHPOT, THIRD], RIG, active=0)
