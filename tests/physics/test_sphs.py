"""Periodic multisines: the V² trap, noise, settling, distortions, and a measured electronic Duffing circuit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pipeline.transform.periodic import best_linear_approximation, line_spectra, period_starts
from pipeline.transform.respond import respond
from pipeline.transform.sphs import sphs_response
from schemas.errors import NotIdentifiableError
from tests.physics.rig_truth import Truth, filtered, recording, schroeder

RATE = 2000.0
PER_VOLTAGE = 2e-3
TRUTH = Truth(load_cell=20.0)
BAND = {"frequency_start_hz": 1.0, "frequency_stop_hz": 100.0}


def lines_of(kind: str) -> np.ndarray:
    if kind == "full":
        return np.arange(1, 101)
    odd = np.arange(1, 101, 2)
    if kind == "odd":
        return odd
    keep, rng = np.ones(odd.size, dtype=bool), np.random.default_rng(seed=2)
    for first in range(0, odd.size - 3, 4):
        keep[first + rng.integers(4)] = False
    return odd[keep]


def actuated(voltage: np.ndarray) -> np.ndarray:
    """Force of a linear film for a voltage that begins at 0, every sample a straight convolution."""
    return -filtered(voltage**2, 1 / RATE, lambda f: PER_VOLTAGE * TRUTH.ratio(f))


def run(voltage: np.ndarray, force: np.ndarray, seed: int | None = 0, **metadata):
    if seed is not None:
        rng = np.random.default_rng(seed)
        voltage, force = voltage + rng.normal(0, 3e-3, voltage.size), force + rng.normal(0, 1e-3, force.size)
    return recording(
        {"voltage": voltage, "force": 0.9 + force},
        RATE,
        protocol="sphs",
        loading="electrical",
        **{**BAND, "period_s": 1.0, **metadata},
    )


@pytest.mark.parametrize("kind", ["full", "odd", "random_odd"])
@pytest.mark.parametrize("root", [True, False])
def test_response_against_measured_voltage_squared(kind: str, root: bool) -> None:
    lines = lines_of(kind)
    u = schroeder(lines, 2000)
    voltage = np.concatenate([np.zeros(1000), np.tile(7 * np.sqrt((1 + u) / 2) if root else 3.5 * (1 + u), 12)])
    force = actuated(voltage)
    ratios, errors = [], []
    for seed in range(4):
        response, distortions, warnings = sphs_response(run(voltage, force, seed, lines=kind))
        true = PER_VOLTAGE * TRUTH.ratio(response.frequency_hz)
        ratios.append(np.abs(response.value - true) ** 2 / response.variance)
        errors.append(np.abs(response.value / true - 1))
        # No line of a linear film is beyond the noise, whatever the voltage's own harmonics.
        level = {d.kind: d.level for d in distortions}
        for name in set(level) - {"noise"}:
            assert np.median(level[name]) < 1.5 * np.median(level["noise"])
    np.testing.assert_array_equal(response.details["lines"], lines)
    assert warnings == ()
    assert np.median(errors) < 0.005
    assert 0.75 < np.mean(ratios) < 1.3


def test_the_trap_that_voltage_squared_avoids() -> None:
    """Against u the products of (1 + u)² scatter |G| by 12 % with all lines, and by nothing with odd lines, while the
    whole V² term, 22 % of the output, sits on even lines."""
    for kind, scatter in (("full", 0.12), ("odd", 0.0)):
        lines = lines_of(kind)
        u = schroeder(lines, 2000)
        spectrum_u, spectrum_v = np.fft.rfft(u), np.fft.rfft((3.5 * (1 + u)) ** 2)
        naive = np.abs(spectrum_v[lines] / spectrum_u[lines])
        assert naive.std() / naive.mean() == pytest.approx(scatter, abs=0.015)
        if kind == "odd":
            even = np.abs(spectrum_v[2:202:2])
            assert np.sqrt((even**2).sum() / (np.abs(spectrum_v[1:202]) ** 2).sum()) == pytest.approx(0.22, abs=0.02)
        voltage = np.tile(3.5 * (1 + u), 4)
        force = -PER_VOLTAGE * voltage**2
        response, _, _ = sphs_response(run(voltage, force, None, lines=kind))
        np.testing.assert_allclose(np.abs(response.value), PER_VOLTAGE, rtol=1e-9)


@pytest.mark.parametrize(("kind", "crest"), [("full", 1.68), ("odd", 1.70)])
def test_crest_factors(kind: str, crest: float) -> None:
    u = schroeder(lines_of(kind), 2000)
    voltage = np.tile(7 * np.sqrt((1 + u) / 2), 3)
    response, _, _ = sphs_response(run(voltage, -PER_VOLTAGE * voltage**2, None, lines=kind))
    assert response.details["crest_factor"] == pytest.approx(crest, abs=0.01)


def test_a_known_delay_has_negative_phase_and_a_drop_is_positive() -> None:
    u = schroeder(lines_of("full"), 2000)
    voltage = np.tile(7 * np.sqrt((1 + u) / 2), 5)
    late = np.roll(voltage, 2)  # 1 ms
    response, _, _ = sphs_response(run(voltage, -PER_VOLTAGE * late**2, None, lines="full"))
    assert np.degrees(np.angle(response.value[response.frequency_hz == 100.0]))[0] == pytest.approx(-36.0, abs=1e-6)
    assert response.value[0].real > 0


def test_settling_periods_are_dropped_and_slow_drift_does_no_harm() -> None:
    u = schroeder(lines_of("odd"), 2000)
    voltage = np.concatenate([np.zeros(500), np.tile(7 * np.sqrt((1 + u) / 2), 14)])
    time = np.arange(voltage.size) / RATE
    # A slow tail after the start: 0.8 s, so that about four periods are not settled.
    settling = 0.05 * np.exp(-np.maximum(time - 0.25, 0) / 0.8) * np.sin(2 * np.pi * 7.3 * time)
    drift = -0.02 * np.log10(1 + time)
    force = actuated(voltage) + np.where(time > 0.25, settling, 0.0) + drift
    response, _, _ = sphs_response(run(voltage, force, 3, lines="odd"))
    assert 2 <= response.details["settling_periods"][0] <= 7
    true = PER_VOLTAGE * TRUTH.ratio(response.frequency_hz)
    assert np.mean(np.abs(response.value - true) ** 2 / response.variance) < 2.0
    steady, _, _ = sphs_response(run(voltage[500:], actuated(voltage)[500:], 3, lines="odd"))
    assert steady.details["settling_periods"][0] <= 1


def test_even_and_odd_distortions_are_told_apart() -> None:
    u = schroeder(lines_of("random_odd"), 2000)
    v2 = 24.5 * (1 + u)
    voltage = np.tile(np.sqrt(v2), 10)
    signal = v2 - 24.5
    force = -PER_VOLTAGE * (signal + 2e-3 * signal**2)
    even_only, distortions, _ = sphs_response(run(voltage, np.tile(force, 10), 1, lines="random_odd"))
    level = {d.kind: np.sqrt(np.mean(d.level**2)) for d in distortions}
    expected = np.abs(np.fft.rfft(PER_VOLTAGE * 2e-3 * signal**2))[2:100:2] / 1000
    assert level["even"] == pytest.approx(np.sqrt(np.mean(expected**2)), rel=0.1)
    assert level["odd"] < 2 * level["noise"]
    cubic = -PER_VOLTAGE * (signal + 5e-4 * signal**3)
    odd, distortions, _ = sphs_response(run(voltage, np.tile(cubic, 10), 1, lines="random_odd"))
    level = {d.kind: np.sqrt(np.mean(d.level**2)) for d in distortions}
    assert level["odd"] > 10 * level["noise"]
    assert level["even"] < 2 * level["noise"]
    # Its stochastic part falls on the excited lines and belongs to the whole variance, not to the noise.
    assert np.median(odd.variance / odd.noise_variance) > 5
    assert np.median(even_only.variance / even_only.noise_variance) < 3


def test_a_voltage_offset_leaves_even_lines() -> None:
    """(V + 0.2 kV)² with the square-root drive: 0.6 % of the output on even lines."""
    u = schroeder(lines_of("odd"), 2000)
    voltage = np.tile(7 * np.sqrt((1 + u) / 2), 6)
    force = -PER_VOLTAGE * (voltage + 0.2) ** 2
    _, distortions, _ = sphs_response(run(voltage, force, None, lines="odd"))
    even = next(d for d in distortions if d.kind == "even")
    whole = np.abs(np.fft.rfft(force[:2000])[1:101]) / 1000
    assert np.sqrt((even.level**2).sum() / (whole**2).sum()) == pytest.approx(0.006, abs=0.0015)


def test_several_realisations_separate_noise_and_distortion() -> None:
    rng = np.random.default_rng(seed=8)
    lines, periods, count = lines_of("full"), 4, 12
    level, noise = 0.02, 0.01
    inputs, outputs = [], []
    for _ in range(count):
        phase = np.exp(2j * np.pi * rng.random(lines.size))
        distortion = level * (rng.normal(size=lines.size) + 1j * rng.normal(size=lines.size)) / np.sqrt(2)
        e = noise * (rng.normal(size=(periods, lines.size)) + 1j * rng.normal(size=(periods, lines.size))) / np.sqrt(2)
        inputs.append(np.tile(phase, (periods, 1)))
        outputs.append((2.0 + distortion) * phase + e)
    result = best_linear_approximation(inputs, outputs)
    assert np.mean(result.noise_variance) == pytest.approx(noise**2 / (periods * count), rel=0.1)
    assert np.mean(result.distortion_variance) == pytest.approx(level**2, rel=0.1)
    assert np.mean(result.variance) == pytest.approx((level**2 + noise**2 / periods) / count, rel=0.1)
    assert np.mean(np.abs(result.value - 2.0) ** 2 / result.variance) == pytest.approx(1.0, abs=0.3)


def test_realisations_in_one_record_are_found() -> None:
    lines, rng = lines_of("odd"), np.random.default_rng(seed=9)
    parts = []
    t = np.arange(2000) / 2000
    for _ in range(3):
        u = np.cos(2 * np.pi * np.outer(t, lines) + 2 * np.pi * rng.random(lines.size)).sum(axis=1)
        parts.append(np.tile(7 * np.sqrt((1 + u / np.abs(u).max()) / 2), 6))
    voltage = np.concatenate(parts)
    response, _, _ = sphs_response(run(voltage, actuated(voltage), 1, lines="odd"))
    assert response.details["realisations"] == 3
    assert response.details["variance_from"] == "realisations"
    true = PER_VOLTAGE * TRUTH.ratio(response.frequency_hz)
    assert np.median(np.abs(response.value / true - 1)) < 0.01


@pytest.mark.parametrize("told", [{"period_s": 1.0}, {"period_s": 1.00013}, {"period_s": None}])
def test_a_period_that_is_no_whole_number_of_samples(told) -> None:
    lines, period, count = lines_of("odd"), 1.00013, 8
    t = np.arange(int(count * period * RATE)) / RATE
    k = np.arange(1, lines.size + 1)
    angle = 2 * np.pi * np.outer(t / period, lines) - np.pi * k * (k - 1) / lines.size
    scale = 1 / np.abs(np.cos(angle).sum(axis=1)).max()
    h = PER_VOLTAGE * TRUTH.ratio(lines / period)
    voltage = 7 * np.sqrt((1 + scale * np.cos(angle).sum(axis=1)) / 2)
    force = -24.5 * scale * (np.abs(h) * np.cos(angle + np.angle(h))).sum(axis=1)
    made = run(voltage, force, None, lines="odd", **{q: v for q, v in told.items() if v is not None})
    if told["period_s"] is None:
        made = recording(
            {"voltage": voltage, "force": force},
            RATE,
            protocol="sphs",
            loading="electrical",
            lines="odd",
            **BAND,
        )
    response, _, _ = sphs_response(made)
    assert response.details["period_s"] == pytest.approx(period, abs=2e-6)
    np.testing.assert_allclose(response.value, PER_VOLTAGE * TRUTH.ratio(lines / period), rtol=1e-4)


def test_lines_of_a_broken_period_do_not_leak() -> None:
    period, lines, amplitude = 2000.26, np.array([1, 3, 50, 99]), np.array([1, 2j, 1 - 1j, 3])
    n = np.arange(20_003)
    x = (np.exp(2j * np.pi * np.outer(n, lines) / period) @ amplitude).real + 5
    spectra = line_spectra(x, period_starts(0.0, period, 10, n.size), 0.0, period, 140)
    assert np.abs(spectra[:, lines] - amplitude).max() < 1e-9
    assert np.abs(np.delete(spectra, [0, *lines], axis=1)).max() < 1e-9


def test_periods_with_gaps_are_left_out() -> None:
    u = schroeder(lines_of("odd"), 2000)
    voltage = np.tile(7 * np.sqrt((1 + u) / 2), 8)
    force = actuated(voltage)
    force[6100:6500] = np.nan
    response, _, warnings = sphs_response(run(voltage, force, 1, lines="odd"))
    assert any("1 periods with gaps" in w for w in warnings)
    assert np.median(np.abs(response.value / (PER_VOLTAGE * TRUTH.ratio(response.frequency_hz)) - 1)) < 0.01


def test_the_amplifier_is_reported_where_the_command_was_recorded() -> None:
    u = schroeder(lines_of("odd"), 2000)
    command = np.tile(7 * np.sqrt((1 + u) / 2) / 1.5, 6)
    voltage = np.roll(1.5 * command, 1)
    made = recording(
        {"voltage": voltage, "force": -PER_VOLTAGE * voltage**2, "command": command},
        RATE,
        protocol="sphs",
        loading="electrical",
        lines="odd",
        period_s=1.0,
        **BAND,
    )
    response, _, _ = sphs_response(made)
    np.testing.assert_allclose(response.details["amplifier_gain_kv_per_v"], 1.5, rtol=1e-9)
    assert response.details["amplifier_delay_s"] == pytest.approx(0.5e-3, rel=1e-6)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda v, f: (v[:1500], f[:1500]), "period"),
        (lambda v, f: (np.full_like(v, 3.0), f), "does not move"),
        (lambda v, f: (v, np.zeros_like(f)), "noise|usable"),
        (lambda v, f: (v, np.clip(f, -0.04, 0.0)), "saturated"),
    ],
)
def test_what_cannot_carry_a_response_is_refused(change, reason) -> None:
    u = schroeder(lines_of("odd"), 2000)
    voltage = np.tile(7 * np.sqrt((1 + u) / 2), 6)
    voltage, force = change(voltage, -PER_VOLTAGE * voltage**2)
    rng = np.random.default_rng(seed=1)
    if reason == "noise|usable":
        force = force + rng.normal(0, 1e-3, force.size)
    made = recording(
        {"voltage": voltage, "force": force},
        RATE,
        protocol="sphs",
        loading="electrical",
        lines="odd",
        period_s=1.0,
        **BAND,
    )
    with pytest.raises(NotIdentifiableError, match=reason):
        respond(made)


def test_silverbox(real_data: Path) -> None:
    """Electronic Duffing circuit, one period of an odd Schroeder multisine; numbers of its PROVENANCE.md."""
    path = real_data / "silverbox" / "Schroeder80mV.csv"
    if not path.exists():
        pytest.skip(f"no {path}")
    raw = np.genfromtxt(path, delimiter=",", skip_header=1, usecols=(2, 3))
    x, y = (raw - raw.mean(axis=0))[10584 : 10584 + 1024].T
    rate = 1e7 / 2**14
    made = recording({"input": x, "output": y}, rate, protocol="sphs", loading="other", period_s=1024 / rate)
    response, distortions, warnings = sphs_response(made)
    np.testing.assert_array_equal(response.details["lines"], np.arange(1, 336, 2))
    assert response.frequency_hz[[0, -1]] == pytest.approx([0.596, 199.68], abs=0.005)
    assert 1e3 * response.details["input_rms"] == pytest.approx(26.93, abs=0.01)
    assert 1e3 * response.details["output_rms"] == pytest.approx(55.56, abs=0.01)
    assert response.details["crest_factor"] == pytest.approx(1.660, abs=0.01)
    assert abs(response.value[0]) == pytest.approx(1.002, abs=0.001)
    peak = int(np.abs(response.value).argmax())
    assert response.details["lines"][peak] == 123
    assert abs(response.value[peak]) == pytest.approx(7.447, abs=0.001)
    assert np.degrees(np.angle(response.value[peak])) == pytest.approx(-97.2, abs=0.1)
    # One period: no noise variance, and the substitute is named.
    assert response.noise_variance is None
    assert response.coherence is None
    assert response.details["variance_from"] == "neighbouring lines"
    assert any("neighbouring lines" in w for w in warnings)
    # 2.6 % on the even lines of the output, part of which the 2.8 % of the input explain.
    even = next(d for d in distortions if d.kind == "even")
    raw_even = np.abs(np.fft.rfft(y)[2:336:2]) / 512
    odd = np.abs(np.fft.rfft(y)[1:336:2]) / 512
    assert np.sqrt(np.mean(raw_even**2)) / np.sqrt(np.mean(odd**2)) == pytest.approx(0.026, abs=0.001)
    assert np.sqrt(np.mean(even.level**2)) < 0.8 * np.sqrt(np.mean(raw_even**2))
