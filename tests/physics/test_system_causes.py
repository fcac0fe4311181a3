"""Causes in a system of another kind, against truths that another integrator makes (`solve_ivp`, input as a sum of sines)."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

from pipeline.diagnose.judge import judge_predictions
from pipeline.diagnose.results import NAMED, NONE
from pipeline.diagnose.single.comparison import Comparison, compare_predictions
from pipeline.diagnose.single.oscillator import (
    ARM,
    BAND_LIMITED,
    CUBIC,
    DELAY,
    HOLDS,
    RATE,
    Oscillator,
    SystemRecord,
    make_linear,
)
from pipeline.diagnose.single.oscillator_fit import LinearStarts
from pipeline.diagnose.single.system_diagnosis import list_system_discrepancies
from pipeline.diagnose.single.system_mechanisms import SystemQuestion, ask_system
from schemas.errors import NotIdentifiableError

Float = NDArray[np.float64]
Force = Callable[[float, float, float], tuple[float, float]]

INTERVAL_S, SAMPLES = 1e-3, 1800
OMEGA, DAMPING, GAIN = 2 * np.pi * 90.0, 2 * np.pi * 90.0 * 0.16, 2.0 * (2 * np.pi * 90.0) ** 2
NOISE = 0.004
"""Of the outputs below, which reach about 1."""


def _drive(level: float, growing: bool, seed: int) -> tuple[Callable[[float], float], Float]:
    """Odd multisine of random phase to 250 Hz, of that root mean square, growing fourfold or steady; as a function and sampled."""
    rng = np.random.default_rng(seed)
    period = SAMPLES * INTERVAL_S
    omegas = 2 * np.pi * np.arange(1, 250 * period, 8) / period
    phases = rng.uniform(0, 2 * np.pi, omegas.size)
    size = level * np.sqrt(2 / omegas.size)

    def at(t: float) -> float:
        envelope = 0.4 + 1.2 * t / period if growing else 1.0
        return float(size * envelope * np.cos(omegas * t + phases).sum())

    return at, np.array([at(t) for t in np.arange(SAMPLES) * INTERVAL_S])


def _record(
    extra: Force, level: float = 0.08, growing: bool = True, periodic: bool = False, seed: int = 1
) -> SystemRecord:
    """Record of a truth y″ + d y′ + w² y + extra = g u with a hidden state, by Dormand and Prince."""
    at, sampled = _drive(level, growing, seed)
    start = -SAMPLES * INTERVAL_S if periodic else 0.0

    def rate(t: float, x: Float) -> list[float]:
        y, v, q = x
        force, q_rate = extra(y, v, q)
        return [v, GAIN * at(t) - DAMPING * v - OMEGA**2 * y - force, q_rate]

    times = np.arange(SAMPLES) * INTERVAL_S
    found = solve_ivp(rate, (start, times[-1]), [0, 0, 0], t_eval=times, rtol=1e-6, atol=1e-7)
    y = found.y[0] + NOISE * np.random.default_rng(seed + 100).standard_normal(SAMPLES)
    return SystemRecord("record", sampled, y, INTERVAL_S, periodic=periodic)


W2 = OMEGA**2
TRUTHS: dict[str, Force] = {
    "none": lambda y, v, q: (0.0, 0.0),
    "strain_stiffening": lambda y, v, q: (0.4 * W2 * y**3, 0.0),
    "amplitude_softening": lambda y, v, q: (-0.08 * W2 * y**3, 0.0),
    "slack": lambda y, v, q: (0.25 * W2 * y**2, 0.0),
    "load_cell_damping": lambda y, v, q: (0.25 * abs(v) * v, 0.0),
    "clamp_slip": lambda y, v, q: (0.4 * W2 * q, v - abs(v) * q / 0.1),
    "missing_relaxation": lambda y, v, q: (0.5 * W2 * q, v - q * 200.0),
}


@functools.cache
def _question(truth: str) -> tuple[SystemQuestion, Comparison]:
    question = ask_system([_record(TRUTHS[truth])])
    return question, _compare(question)


def _compare(q: SystemQuestion) -> Comparison:
    return compare_predictions(q.plain, q.models, q.measured, q.left_out, q.sd)


@pytest.mark.long_after(1)
@pytest.mark.slow
@pytest.mark.parametrize("truth", [name for name in TRUTHS if name != "none"])
def test_the_cause_is_named(truth: str) -> None:
    question, found = _question(truth)
    best = found.ranked[0]
    assert (judge_predictions(found), best.model.mechanism) == (NAMED, truth)
    assert best.gain > 0.9
    assert best.lower > 0.8
    assert best.explained > 0.9
    assert question.sd == pytest.approx(1.06 * NOISE, rel=0.15)
    assert best.after < 1.3


@pytest.mark.slow
def test_nothing_is_found_where_there_is_nothing() -> None:
    question, found = _question("none")
    assert judge_predictions(found) == NONE or not found.possible
    assert np.std(question.plain.whole - question.measured) == pytest.approx(NOISE, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("truth", "key", "expected"),
    [
        ("strain_stiffening", "stiffening", lambda amplitude: 3 * 0.4 * amplitude**2),
        ("amplitude_softening", "drop", lambda amplitude: 0.08 * amplitude**2),
        ("slack", "residual", lambda amplitude: 1 - 2 * 0.25 * amplitude),
        ("clamp_slip", "hardening", lambda amplitude: 0.4),
        ("missing_relaxation", "stiffness_ratio", lambda amplitude: 0.5),
        ("missing_relaxation", "time_constant_s", lambda amplitude: 5e-3),
    ],
)
def test_its_size_is_within_its_uncertainty(truth: str, key: str, expected: Callable[[float], float]) -> None:
    question, found = _question(truth)
    size = found.ranked[0].model.severity[key]
    assert size.lower < size.value < size.upper
    assert abs(size.value - expected(question.amplitude)) < 3 * size.sd
    assert size.sd < 0.05 * abs(size.value)


@pytest.mark.slow
def test_a_saturated_reading_is_named() -> None:
    record = _record(TRUTHS["none"])
    limit = 1.2 * float(np.abs(record.output).max())
    bent = replace(record, output=record.output / np.sqrt(1 + (record.output / limit) ** 2))
    best = _compare(ask_system([bent])).ranked[0]
    assert best.model.mechanism == "sensor_saturation"
    size = best.model.severity["overload"]
    assert abs(size.value - (np.sqrt(1 + 1 / 1.2**2) - 1)) < 3 * size.sd + 0.01
    assert best.lower > 0.8


@pytest.mark.slow
def test_nonlinear_damping_is_that_of_the_fastest_motion() -> None:
    question, found = _question("load_cell_damping")
    simulated = next(s for s in question.simulations if s.mechanism == "load_cell_damping").outputs[0]
    size = found.ranked[0].model.severity["damping_ratio"]
    fastest = float(np.abs(np.gradient(simulated, INTERVAL_S)).max())
    assert abs(size.value - 0.25 * fastest / 2 / OMEGA) < 3 * size.sd


@pytest.mark.slow
def test_places_of_the_discrepancy_grow_with_the_output() -> None:
    question, _ = _question("strain_stiffening")
    found = {d.statement.partition(" (")[0]: d for d in list_system_discrepancies(question)}
    assert found["where it is largest"].chi2 > 2 * found["where the output is smallest"].chi2
    assert "about its resonance" in found
    assert not list_system_discrepancies(_question("none")[0])


@pytest.mark.long
@pytest.mark.slow
def test_a_steady_period_and_a_louder_record() -> None:
    """A period is predicted from a louder record and the reverse, and the names say which."""
    period = replace(_record(TRUTHS["strain_stiffening"], 0.05, growing=False, periodic=True, seed=3), name="period")
    loud = replace(_record(TRUTHS["strain_stiffening"], seed=4), name="loud")
    question = ask_system([period, loud], sd=NOISE)
    found = _compare(question)
    assert [part.name for part in question.parts] == ["loud, the loudest", "period"]
    assert question.parts[1].places.size == SAMPLES
    assert (judge_predictions(found), found.ranked[0].model.mechanism) == (NAMED, "strain_stiffening")
    errors = found.ranked[0].model.unseen - question.left_out
    assert all(np.std(errors[part.values]) < 2 * NOISE for part in question.parts)


@pytest.mark.slow
def test_steps_from_rest() -> None:
    """Levels that are held one after the other; the mean is compared here, and so is the beginning."""
    edges = np.arange(10) * 0.2
    levels = np.array([0, 0.1, 0.2, 0.3, 0.4, 0.3, 0.2, 0.1, 0])

    def at(t: float) -> float:
        return float(np.diff(levels) @ (t > edges[1:9] - INTERVAL_S / 2))

    def rate(t: float, x: Float) -> list[float]:
        return [x[1], GAIN * at(t) - DAMPING * x[1] - W2 * x[0] - 0.4 * W2 * x[0] ** 3]

    times = np.arange(1800) * INTERVAL_S
    found = solve_ivp(rate, (0, times[-1]), [0, 0], t_eval=times, rtol=1e-6, atol=1e-8, max_step=INTERVAL_S)
    y = found.y[0] + 0.002 * np.random.default_rng(seed=5).standard_normal(times.size)
    record = SystemRecord("steps", np.array([at(t) for t in times]), y, INTERVAL_S, from_rest=True)
    best = _compare(ask_system([record])).ranked[0]
    assert best.model.mechanism == "strain_stiffening"
    assert best.lower > 0.9
    assert best.model.whole.size == times.size


def test_the_linear_oscillator_is_exact() -> None:
    """Response to one period of a sine against the formula, cut into stretches, and late."""
    ratio, n = 0.05, 4000
    t = np.arange(n) * INTERVAL_S
    wave = 2 * np.pi * 75.0
    record = SystemRecord("sine", np.cos(wave * t), np.zeros(n), INTERVAL_S, periodic=True)
    theta = make_linear(damping=2 * ratio, gain=1.0)
    late = theta.copy()
    late[DELAY] = OMEGA * 0.4 * INTERVAL_S
    found = Oscillator([record], 1.0, OMEGA, 2 * ratio)(np.array([theta, late]).T)[0]
    response = OMEGA**2 / (OMEGA**2 - wave**2 + 2j * ratio * OMEGA * wave)
    for simulated, by in zip(found, (0.0, 0.4 * INTERVAL_S), strict=True):
        exact = (response * np.exp(1j * wave * (t - by))).real
        np.testing.assert_allclose(simulated, exact, atol=2e-3 * abs(response))


def _noisy(size: int, spike: float, seed: int = 1) -> SystemRecord:
    """White noise through a low pass of 0.1 s, sampled every 10 ms, with one spike in the input."""
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(size)
    y = lfilter([0.1], [1, -0.9], u) + 1e-3 * rng.standard_normal(size)
    u[size // 3] += spike
    return SystemRecord("record", u, y, 0.01)


@pytest.mark.parametrize("size", [2, 3, 40, 127])
def test_too_few_samples_are_said_so(size: int) -> None:
    with pytest.raises(NotIdentifiableError, match=f"the records have {size} samples"):
        ask_system([_noisy(size, 0.0)])


@pytest.mark.parametrize("finer", [1, 3])
@pytest.mark.parametrize("hold", HOLDS)
def test_a_linear_system_is_filtered_as_it_is_stepped(hold: str, finer: int) -> None:
    """A cube that is as good as nothing makes it one that is stepped, from sample to sample."""
    oscillator = Oscillator([_noisy(300, 2.0)], 1.0, 60.0, 0.2, hold=hold, finer=finer)
    plain = make_linear(0.3, 1.7)
    relaxing, gone = plain.copy(), plain.copy()
    relaxing[[ARM, RATE]] = 0.4, -1.0
    gone[ARM] = 0.4
    stepped = np.array([plain, relaxing, gone])
    stepped[:, CUBIC] = 1e-300
    (both,) = oscillator(np.array([plain, relaxing, gone, *stepped]).T)
    assert np.ptp(both[0]) > 0.1
    assert both[:3] == pytest.approx(both[3:], abs=1e-10 * float(np.ptp(both)))
    assert not np.allclose(both[0], both[1], atol=1e-3)


@pytest.mark.parametrize("spike", [50.0, 1e6, 1e9])
def test_a_spike_sends_the_linear_start_nowhere(spike: float) -> None:
    record = _noisy(2000, spike)
    (mode,) = LinearStarts([record]).find(1, BAND_LIMITED)
    omega, ratio = mode.angular_frequency, mode.ratio
    lowest, highest = 2 * np.pi / (2000 * 0.01), np.pi / 0.01
    assert 0.49 * lowest < omega < 2.01 * highest
    assert 1e-4 <= ratio <= 3.0


def test_a_system_that_remembers_longer_than_its_record_is_not_asked() -> None:
    record = _noisy(2000, 0.0)
    ringing = replace(record, output=np.sin(2 * np.pi * 0.06 * np.arange(2000) * 0.01))
    with pytest.raises(NotIdentifiableError, match="remembers its start"):
        ask_system([ringing])


@pytest.mark.slow
def test_a_system_without_a_resonance_is_simulated() -> None:
    """A low pass of first order, 1/(1 + jω 0.1 s), which is the limit of a damped resonance: sines by their formula."""
    rng = np.random.default_rng(5)
    t = np.arange(2000) * 0.01
    omegas, phases = 2 * np.pi * np.arange(0.1, 8, 0.1), rng.uniform(0, 2 * np.pi, 79)
    waves = np.exp(1j * (np.outer(t, omegas) + phases))
    u, y = waves.sum(axis=1).real, (waves / (1 + 0.1j * omegas)).sum(axis=1).real
    record = SystemRecord("record", u, y + 1e-3 * rng.standard_normal(t.size), 0.01)
    question = ask_system([record])
    misfit = np.sqrt(np.mean((question.plain.whole - question.measured) ** 2))
    assert misfit < 0.1 * np.std(question.measured)
