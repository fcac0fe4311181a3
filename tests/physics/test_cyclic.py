"""Sinusoids at one frequency: against the closed form of the film's force with its transient."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from pipeline.transform.cyclic import cyclic_response
from pipeline.transform.respond import respond
from schemas.errors import NotIdentifiableError
from tests.physics.rig_truth import START_NS, Truth, recording

STACK = (0.40, (0.40, 1.00, 50.0), (1.00, 0.10, 0.05))
"""Table 4.2, third order."""


def cycles(frequency: float, count: float, rate: float, amplitude: float = 1.0, rest: float = 0.3):
    """Time, displacement A(1 − cos ωt) and force of the stack, arm by arm in closed form, from rest."""
    time = np.arange(round((count / frequency + rest) * rate)) / rate - rest
    t, w = np.maximum(time, 0.0), 2 * np.pi * frequency
    k0, springs, dampers = STACK
    x = amplitude * (1 - np.cos(w * t))
    force = k0 * x
    for k, c in zip(springs, dampers, strict=True):
        # f' = k x' − f k/c with x' = A w sin wt: particular solution and what makes f(0) = 0.
        rate_of_arm = k / c
        steady = k * (-1j * amplitude * w) / (1j * w + rate_of_arm)
        force = force + (steady * np.exp(1j * w * t)).real - steady.real * np.exp(-rate_of_arm * t)
    return time, x, force


def coloured(rng: np.random.Generator, n: int, sd: float, memory: float) -> np.ndarray:
    return sd * lfilter([np.sqrt(1 - memory**2)], [1, -memory], rng.normal(size=n))


@pytest.mark.long_after(1)
@pytest.mark.slow
@pytest.mark.parametrize(
    ("frequency", "count", "rate"), [(5.0, 10, 1000.0), (0.01, 3, 50.0), (0.1, 10, 100.0), (0.5, 5, 200.0)]
)
@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_response_and_its_variance(frequency, count, rate, memory) -> None:
    exact = 1.0003 * frequency  # the crosshead is not quite at the frequency that it was told
    _, x, force = cycles(exact, count, rate)
    truth = Truth(film=STACK).stiffness(np.array([exact]))[0]
    errors, ratios = [], []
    for seed in range(15):
        rng = np.random.default_rng(seed)
        run = recording(
            {
                "displacement": x + rng.normal(0, 5e-4, x.size),
                "force": 0.5 + force + coloured(rng, x.size, 1e-3, memory),
            },
            rate,
            protocol="cyclic",
            frequency_hz=frequency,
            cycles=count,
        )
        response, _, warnings = cyclic_response(run)
        assert warnings == ()
        assert response.frequency_hz[0] == pytest.approx(exact, rel=1e-3)
        errors.append(abs(response.value[0] / truth - 1))
        ratios.append(abs(response.value[0] - truth) ** 2 / response.variance[0])
    assert np.sqrt(np.mean(np.square(errors))) < 0.001
    assert 0.35 < np.mean(ratios) < 1.9
    assert response.repeats == count - 2


@pytest.mark.long
@pytest.mark.slow
def test_correlated_noise_widens_the_error_as_it_should() -> None:
    """Noise with a memory of 400 samples at 1 kHz, 200 draws: the variance is right, a white one would be 20 times off."""
    _, x, force = cycles(0.5, 12, 250.0)
    truth = Truth(film=STACK).stiffness(np.array([0.5]))[0]
    errors, variances = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        run = recording(
            {"displacement": x, "force": force + coloured(rng, x.size, 2e-2, 0.98)},
            250.0,
            protocol="cyclic",
            frequency_hz=0.5,
        )
        response, _, _ = cyclic_response(run)
        errors.append(abs(response.value[0] - truth) ** 2)
        variances.append(response.variance[0])
    assert np.mean(errors) / np.mean(variances) == pytest.approx(1.0, abs=0.35)


def test_harmonics_are_even_and_odd_and_the_drive_is_not_blamed() -> None:
    time, x, _ = cycles(1.0, 10, 500.0)
    rng = np.random.default_rng(seed=1)
    wave = x - 1.0
    force = 2.0 * x + 0.05 * wave**2 + 0.03 * wave**3
    run = recording(
        {"displacement": x, "force": np.where(time > 0, force, 0.0) + rng.normal(0, 1e-4, x.size)},
        500.0,
        protocol="cyclic",
        frequency_hz=1.0,
        total_length_mm=20.0,
    )
    response, distortions, _ = cyclic_response(run)
    found = {d.kind: dict(zip(d.harmonic.tolist(), d.level, strict=True)) for d in distortions}
    assert found["even"][2] == pytest.approx(0.05 / 2, rel=0.01)
    assert found["odd"][3] == pytest.approx(0.03 / 4, rel=0.01)
    assert found["even"][4] < 5 * found["noise"][4]
    assert response.amplitude == pytest.approx(0.05, rel=1e-3)
    distorted = x + 0.02 * np.cos(4 * np.pi * np.maximum(time, 0))
    run = recording({"displacement": distorted, "force": 2 * distorted}, 500.0, protocol="cyclic", frequency_hz=1.0)
    _, distortions, _ = cyclic_response(run)
    assert all(d.level.max() < 1e-6 for d in distortions)


def test_first_and_last_cycle_are_kept_apart() -> None:
    time, x, _ = cycles(1.0, 10, 500.0)
    force = 2.0 * x * np.where(time < 1.0, 1.1, 1.0)
    run = recording({"displacement": x, "force": force}, 500.0, protocol="cyclic", frequency_hz=1.0)
    response, _, _ = cyclic_response(run)
    assert response.value[0].real == pytest.approx(2.0, rel=1e-3)
    assert response.details["first_over_last"] == pytest.approx(1.1, rel=0.01)
    assert response.details["cycle_number"][0] == 1
    assert response.details["cycle_number"][-1] == 10


def test_delay_jitter_and_stretch() -> None:
    """Output 10 ms late at 2 Hz is −7.2°; jittered stamps do no harm; stretch and stress read as those of a 1 mm cube."""
    rng = np.random.default_rng(seed=3)
    stamps = START_NS + np.cumsum(rng.integers(6_000_000, 16_000_000, 900))
    t = (stamps - stamps[0]) * 1e-9
    run = recording(
        {"stretch": 1.2 + 0.1 * np.sin(4 * np.pi * t), "stress": 300 + 50 * np.sin(4 * np.pi * (t - 0.01))},
        100.0,
        protocol="cyclic",
        details={"stretch": {"time_ns": stamps}, "stress": {"time_ns": stamps}},
    )
    response, _, _ = cyclic_response(run)
    assert response.frequency_hz[0] == pytest.approx(2.0, rel=1e-4)
    assert np.degrees(np.angle(response.value[0])) == pytest.approx(-7.2, abs=0.05)
    assert abs(response.value[0]) == pytest.approx(0.5, rel=1e-3)  # 50 kPa = 0.05 N over 0.1 mm


def test_a_long_record_is_fitted_in_blocks_and_as_good() -> None:
    _, x, force = cycles(1.0, 300, 1000.0)
    truth = Truth(film=STACK).stiffness(np.array([1.0]))[0]
    run = recording({"displacement": x, "force": force}, 1000.0, protocol="cyclic", frequency_hz=1.0)
    response, _, _ = cyclic_response(run)
    assert abs(response.value[0] / truth - 1) < 3e-4


def test_capacitance_is_reported() -> None:
    time, x, force = cycles(1.0, 10, 200.0)
    wave = -0.5 * (x - 1) + 0.05 * np.cos(4 * np.pi * np.maximum(time, 0))
    run = recording(
        {"displacement": x, "force": force, "capacitance": 28.0 + wave}, 200.0, protocol="cyclic", frequency_hz=1.0
    )
    details = cyclic_response(run)[0].details
    assert details["capacitance_per_input_pf"] == pytest.approx(0.5, rel=1e-3)
    assert abs(details["capacitance_phase_deg"]) == pytest.approx(180, abs=0.1)
    assert details["capacitance_harmonics"][0] == pytest.approx(0.1, rel=0.01)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda x, f: (x[:900], f[:900]), "whole cycles"),
        (lambda x, f: (0 * x, f), "does not move"),
        (lambda x, f: (x, np.clip(f, -5, 1.2)), "saturated"),
    ],
)
def test_what_cannot_carry_a_response_is_refused(change, reason) -> None:
    _, x, force = cycles(1.0, 10, 500.0)
    x, force = change(x, force)
    with pytest.raises(NotIdentifiableError, match=reason) as caught:
        respond(recording({"displacement": x, "force": force}, 500.0, protocol="cyclic", frequency_hz=1.0))
    assert caught.value.where == "run-1"


@pytest.mark.parametrize("stated", [0.4, 1.3, 2.5])
def test_an_input_of_another_frequency_is_named_with_it(stated: float) -> None:
    _, x, force = cycles(1.0, 20, 500.0)
    with pytest.raises(NotIdentifiableError, match=r"moves at (1|0\.99\d|1\.0\d) Hz and not at"):
        respond(recording({"displacement": x, "force": force}, 500.0, protocol="cyclic", frequency_hz=stated))
