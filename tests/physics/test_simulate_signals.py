"""Excitations, amplifier and sensors of the virtual rig."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.physics import excitation
from pipeline.simulate.drive import Amplifier
from pipeline.simulate.sensors import Sensor, delayed, low_pass, random_stream

RATE = 20_000.0


def test_sweep_begins_and_ends_at_rest_and_passes_the_band() -> None:
    time = np.arange(0, 22, 1 / RATE) - 1.0
    x = excitation.sweep(
        time,
        start_hz=1,
        stop_hz=100,
        duration_s=20,
        amplitude=1.0,
        exponent=-0.75,
        taper_start_s=0.5,
        taper_stop_s=0.05,
    )
    assert np.all(x[time < 0] == 0)
    assert np.all(x[time > 20] == 0)
    speed = np.gradient(x, 1 / RATE)
    assert abs(speed[np.searchsorted(time, 0.0)]) < 0.01
    assert abs(speed[np.searchsorted(time, 20.0)]) < 0.01
    # zero crossings tell the frequency: 10 Hz half way through a log sweep, amplitude 10^−0.75 there
    middle = (time > 9.5) & (time < 10.5)
    crossings = np.sum(np.diff(np.sign(x[middle])) != 0)
    assert crossings == pytest.approx(20, abs=1)
    assert np.max(np.abs(x[middle])) == pytest.approx(10**-0.75, rel=0.1)


def test_linear_sweep_has_its_mean_frequency_half_way() -> None:
    time = np.arange(0, 10, 1 / RATE)
    x = excitation.sweep(time, start_hz=10, stop_hz=50, duration_s=10, amplitude=2.0, logarithmic=False)
    middle = (time > 4.75) & (time < 5.25)
    assert np.sum(np.diff(np.sign(x[middle])) != 0) == pytest.approx(30, abs=1)
    assert np.max(np.abs(x)) == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize(("kind", "crest"), [("full", 1.68), ("odd", 1.70)])
def test_schroeder_phases_keep_the_crest_factor_low(kind: str, crest: float) -> None:
    u = excitation.schroeder_multisine(20_000, excitation.excited_lines(kind, 100))
    assert np.max(np.abs(u)) == pytest.approx(1.0)
    assert 1 / np.sqrt(np.mean(u**2)) == pytest.approx(crest, abs=0.02)


def test_voltage_squared_has_the_lines_and_no_others() -> None:
    lines = excitation.excited_lines("odd", 99)
    voltage = excitation.square_root_drive(excitation.schroeder_multisine(20_000, lines), 7.0)
    spectrum = np.abs(np.fft.rfft(voltage**2)) / 10_000
    rest = np.setdiff1d(np.arange(1, 10_001), lines)
    assert spectrum[rest].max() < 1e-12 * 49
    assert spectrum[lines].min() > 2.0
    assert voltage.max() == pytest.approx(7.0)
    # against the voltage itself the products would fall between the lines
    assert np.abs(np.fft.rfft(voltage))[rest].max() > 100


def test_random_odd_lines_leave_one_of_each_four_out() -> None:
    lines = excitation.excited_lines("random_odd", 99, np.random.default_rng(seed=1))
    assert np.all(lines % 2 == 1)
    odd = np.arange(1, 100, 2)
    for first in range(0, 48, 4):
        assert np.isin(odd[first : first + 4], lines).sum() == 3


def test_cycles_run_from_zero_to_the_peak() -> None:
    time = np.arange(0, 12, 1e-3)
    x = excitation.raised_cosine(time - 1, frequency_hz=1.0, peak_to_peak=4.0, cycles=10)
    assert (x.min(), x.max()) == (0.0, pytest.approx(4.0))
    assert x[time > 11.001] == pytest.approx(0.0, abs=1e-12)
    assert np.fft.rfft(x[1000:11000])[10] / 5000 == pytest.approx(-2.0)


def test_pulses_are_on_and_off_for_whole_samples() -> None:
    time = np.arange(600) * 0.01
    v = excitation.pulses(time, levels=(3.0, 5.0), on_s=1.0, off_s=0.7, first_s=0.3)
    assert [int(np.sum(v == level)) for level in (3.0, 5.0)] == [100, 100]
    assert list(np.flatnonzero(np.diff(v)) + 1) == [30, 130, 200, 300]


def test_amplifier_rises_and_falls_with_its_own_times() -> None:
    amplifier = Amplifier(1.5, rise_time_constant_s=0.01, fall_time_constant_s=0.03)
    command = np.concatenate([np.zeros(100), np.full(2000, 4.0), np.zeros(2000)])
    _, out = amplifier.amplify(command, 1e-4)
    t = np.arange(2000) * 1e-4
    assert out[100:2100] == pytest.approx(6 * (1 - np.exp(-t / 0.01)), abs=1e-9)
    assert out[2100:4100] == pytest.approx(6 * np.exp(-t / 0.03), abs=1e-7)


def test_equal_times_take_the_same_course_as_unequal_ones_do_in_the_limit() -> None:
    demand = np.abs(np.sin(np.arange(3000) * 0.01)) * 7
    equal = Amplifier(1.5, 0.01, 0.01).follow(demand, 1e-4)
    nearly = Amplifier(1.5, 0.01, 0.01 * (1 + 1e-12)).follow(demand, 1e-4)
    assert equal == pytest.approx(nearly, abs=1e-9)


def test_slew_limit_bounds_the_slope() -> None:
    out = Amplifier(1.0, 1e-3, 1e-3, slew_kv_per_s=50.0).follow(np.concatenate([[0.0], np.full(5000, 7.0)]), 1e-4)
    assert np.max(np.diff(out)) == pytest.approx(50.0 * 1e-4)
    assert out[-1] == pytest.approx(7.0)


def test_hidden_lag_shows_the_demand_on_the_monitor() -> None:
    command = np.concatenate([np.zeros(10), np.ones(100)])
    film, monitor = Amplifier(2.0, 0.01, 0.01, monitored=False).amplify(command, 1e-3)
    assert monitor[10] == 2.0
    assert film[10] == 0.0


@pytest.mark.parametrize("delay_s", [1e-3, 1.234e-3, 2.5e-5])
def test_a_delay_is_a_negative_phase(delay_s: float) -> None:
    time = np.arange(20_000) / RATE
    x = np.sin(2 * np.pi * 100 * time)
    y = delayed(x, delay_s * RATE)
    ratio = np.fft.rfft(y[10_000:])[50] / np.fft.rfft(x[10_000:])[50]
    assert np.angle(ratio, deg=True) == pytest.approx(-360 * 100 * delay_s, abs=1e-4)
    assert abs(ratio) == pytest.approx(1, abs=1e-5)


def test_filter_is_a_single_pole() -> None:
    time = np.arange(40_000) / RATE
    for f in (10.0, 50.0, 100.0):
        x = np.sin(2 * np.pi * f * time)
        y = low_pass(x, 50.0, 1 / RATE)
        ratio = np.fft.rfft(y[20_000:])[int(f)] / np.fft.rfft(x[20_000:])[int(f)]
        assert ratio == pytest.approx(1 / (1 + 1j * f / 50), rel=2e-4)


def test_converter_steps_limits_and_noise() -> None:
    sensor = Sensor(sample_rate_hz=1000.0, noise_sd=0.0, low=-2.0, high=2.0)
    assert sensor.resolution == 2.0**-14
    signal = np.linspace(-3, 3, 30_001)
    values = sensor.digitise(signal, 1e-3, 1, np.random.default_rng(seed=0))
    assert (values.min(), values.max()) == (-2.0, 2.0 - 2.0**-14)
    assert np.all(values / 2.0**-14 == np.rint(values / 2.0**-14))
    inside = np.abs(signal) < 1.9
    assert np.std(values[inside] - signal[inside]) == pytest.approx(2.0**-14 / np.sqrt(12), rel=0.05)
    noisy = Sensor(sample_rate_hz=1000.0, noise_sd=1e-3, low=-2.0, high=2.0)
    flat = noisy.digitise(np.full(100_000, 0.3), 1e-3, 2, np.random.default_rng(seed=0))
    assert flat.size == 50_000
    assert np.std(flat) == pytest.approx(1e-3, rel=0.02)


def test_random_streams_depend_on_their_names_only() -> None:
    first = random_stream(7, "PA-1", "noise", "force").standard_normal(4)
    random_stream(7, "PA-2").standard_normal(4)
    assert np.array_equal(first, random_stream(7, "PA-1", "noise", "force").standard_normal(4))
    for other in (random_stream(8, "PA-1", "noise", "force"), random_stream(7, "PA-1", "noise", "voltage")):
        assert not np.array_equal(first, other.standard_normal(4))
