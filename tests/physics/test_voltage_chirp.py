"""Sweeps of the voltage in the diagnosis: their features against a rig that integrates in time and shares no code with it."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.faults.fitted import fit_session
from pipeline.diagnose.faults.undo import scale_channels, stretch_clock
from pipeline.diagnose.features import kinds
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.features.voltage_chirp import find_still
from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.simulation.effects import Effect, bent
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics import excitation
from pipeline.simulate.campaign import read_campaign, simulate
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.protocols import ELECTRICAL
from schemas.recording import Channel, Recording
from tests.physics.test_simulate_tests import TABLE

NOISE = {"force": 2e-3, "displacement": 1e-4, "voltage": 1e-3, "command": 0.0, "capacitance": 0.05}
MECHANICAL = {"test": "chirp", "specimens": ["A"], "id": "moved", "amplitude_mm": 0.7, "repeats": 2, "sweep_s": 12.0}
SWEPT = {"test": "chirp_electrical", "specimens": ["A"], "id": "swept", "sweep_s": 20.0, "rest_s": 2.0}
"""Of the voltage; bias and swing in kV are each test's own."""


BIASED, LOW = (3.0, 2.5), (1.5, 1.2)


def record(*entries: dict[str, Any]) -> list[Recording]:
    """Recordings of one film with a region that senses, with noise."""
    table = copy.deepcopy(TABLE) | {"recordings": list(entries)}
    rig = table["rigs"]["shaker"]
    rig |= {"rise_time_constant_s": 0.0, "fall_time_constant_s": 0.0}
    rig["channels"] = {quantity: {"noise_sd": sd, "bits": 0} for quantity, sd in NOISE.items()}
    table["specimens"]["A"]["geometry"] |= {"sensing_length_mm": 20.0, "sensing_width_mm": 40.0}
    return [one.recording for one in simulate(read_campaign(table))]


@cache
def record_sweeps(*swings: tuple[float, float], repeats: int = 1) -> tuple[Recording, ...]:
    """A sweep of the driven end, and sweeps of the voltage of bias and swing in kV."""
    swept = [
        SWEPT | {"id": f"swept-{bias:g}", "bias_kv": bias, "swing_kv": swing, "repeats": repeats}
        for bias, swing in swings
    ]
    return tuple(record(MECHANICAL, *swept))


def with_channel(recording: Recording, quantity: str, change: Callable[[Float], Float]) -> Recording:
    """The recording with the samples of one channel changed."""
    channel = recording.channels[quantity]
    return replace(
        recording,
        channels={**recording.channels, quantity: replace(channel, values=change(channel.values))},
    )


def make_bipolar() -> Recording:
    """A sweep of ±4 kV without bias over a film of one relaxation on a rigid cell: a drop of 4 mN/kV², half of it 10 ms late."""
    rate_hz, seconds = 2000.0, 24.0
    t = np.arange(0, seconds, 1 / rate_hz)
    v = 4.0 * excitation.sweep(
        t - 2.0, start_hz=1.0, stop_hz=80.0, duration_s=20.0, amplitude=1.0, taper_start_s=0.5, taper_stop_s=0.1
    )
    frequency = np.fft.rfftfreq(4 * t.size, 1 / rate_hz)
    answer = 0.004 * (0.5 + 0.5 / (1 + 2j * np.pi * frequency * 0.01))
    force = 1.0 - np.fft.irfft(np.fft.rfft(v**2, 4 * t.size) * answer)[: t.size]
    rng = np.random.default_rng(5)
    ns = 1_772_370_300_000_000_000 + np.round(t * 1e9).astype(np.int64)
    keys = {
        "recording_id": "e-1", "specimen_id": "S", "protocol": "chirp", "loading": "electrical",
        "started_at": "2026-03-01T14:05:00+01:00", "frequency_start_hz": "1", "frequency_stop_hz": "80",
    }  # fmt: skip
    channels = {
        "voltage": Channel("voltage", ns, v + rng.normal(0, 1e-3, t.size)),
        "force": Channel("force", ns, force + rng.normal(0, 2e-4, t.size)),
    }
    return Recording(RecordingMetadata.parse(keys), RigConstants(), channels)


def list_residuals(recordings: Sequence[RecordingFeatures]) -> dict[str, Float]:
    """What the plain model leaves of each kind of features of the sweeps of the voltage, in standard deviations."""
    session, _, fit = fit_session(list(recordings))
    found: dict[str, list[float]] = {}
    for p in session.places:
        if p.block.kind.startswith("electrical_chirp"):
            found.setdefault(p.block.kind, []).extend(fit.solution.residual[p.first : p.stop])
    return {kind: np.array(values) for kind, values in found.items()}


@pytest.mark.parametrize(("swing", "repeats"), [((3.0, 2.0), 1), ((4.0, 1.0), 2)])
def test_a_film_without_effects_leaves_the_noise(swing: tuple[float, float], repeats: int) -> None:
    """What brings the voltage to its bias is simulated with the rest; the command's sweep shows the amplifier's gain."""
    left = list_residuals([reduce(r) for r in record_sweeps(swing, repeats=repeats)])
    assert set(left) == {
        kinds.VOLTAGE_CHIRP_RESPONSE,
        kinds.VOLTAGE_CHIRP_HARMONIC,
        kinds.VOLTAGE_CHIRP_CAPACITANCE,
        kinds.VOLTAGE_CHIRP_AMPLIFIER,
    }
    for kind, residual in left.items():
        assert 0.6 < np.mean(residual**2) < 1.5, kind


def test_without_a_bias_twice_the_frequency_is_swept() -> None:
    features = reduce(make_bipolar())
    (response,) = (b for b in features.blocks if b.kind == kinds.VOLTAGE_CHIRP_RESPONSE)
    half = response.size // 2
    f = response.frequency_hz[:half]
    assert f.min() == pytest.approx(2.0, rel=0.1)
    assert f.max() == pytest.approx(160.0, rel=0.1)
    answer = 0.004 * (0.5 + 0.5 / (1 + 2j * np.pi * f * 0.01))
    off = response.value[:half] + 1j * response.value[half:] - answer
    assert np.median(np.abs(off)) < 0.01 * 0.004


def test_what_acts_on_the_voltage_is_predicted_as_a_rig_does_it() -> None:
    """A monitor that reads 0.2 kV too little: the film sees more than was recorded, of which the square makes harmonics and gain."""
    offset_kv = 0.2
    true = record_sweeps(BIASED, LOW)
    told = [
        with_channel(r, "voltage", lambda v: v - offset_kv) if r.metadata.loading == ELECTRICAL else r for r in true
    ]
    _, _, fit = fit_session([reduce(r) for r in true])
    shifted = make_session([reduce(r) for r in told])
    effect = MECHANISMS["drive_offset"].effect({"offset_kv": offset_kv}, "offset")
    moved = Simulation(shifted)
    plain = moved.predict(fit.model, fit.theta)
    predicted = moved.predict(fit.model, fit.theta, effect)
    for p in shifted.places:
        if p.block.kind not in (kinds.VOLTAGE_CHIRP_RESPONSE, kinds.VOLTAGE_CHIRP_HARMONIC):
            continue
        own = slice(p.first, p.stop)
        before, after = (shifted.whiten(shifted.value - v)[own] for v in (plain, predicted))
        assert np.mean(after**2) < 1.6, (p.block.kind, p.block.label)
        if p.block.kind == kinds.VOLTAGE_CHIRP_RESPONSE:
            assert np.mean(before**2) > 20


def test_a_cell_that_bends_is_read_as_it_was_recorded() -> None:
    """A reading bends the force over time, harmonics among them: the recorded force, bent, shows what the simulation makes of it."""
    true = record_sweeps(BIASED, LOW)
    _, _, fit = fit_session([reduce(r) for r in true])
    session = make_session([reduce(r) for r in true])
    simulation = Simulation(session)
    plain = simulation.predict(fit.model, fit.theta)
    loads = simulation.loads(fit.model.physical(fit.theta))
    effect = Effect(reading=(lambda reading: -0.02 * reading.force**2,))
    reading = effect.reading

    def bend(force: Float) -> Float:
        return force + bent(force, 0.0, loads.reading_n, reading)

    told = make_session([reduce(with_channel(r, "force", bend)) for r in true])
    change = simulation.predict(fit.model, fit.theta, effect) - plain
    seen = told.value - session.value
    for p in session.places:
        if p.block.kind != kinds.VOLTAGE_CHIRP_RESPONSE:
            continue
        own = slice(p.first, p.stop)
        assert np.linalg.norm(seen[own]) > 0
        assert np.linalg.norm(seen[own] - change[own]) < 0.05 * np.linalg.norm(seen[own])


def test_a_voltage_in_another_unit_and_a_clock_are_undone() -> None:
    moved, true = record_sweeps(BIASED)
    in_volts = reduce(with_channel(true, "voltage", lambda v: 1e3 * v))
    mended = scale_channels(in_volts, {"voltage": 1e-3})
    right = reduce(true)
    for found, wanted in zip(mended.blocks, right.blocks, strict=True):
        assert found.value == pytest.approx(wanted.value, rel=1e-6, abs=1e-9 * np.abs(wanted.value).max())
    _, simulation, fit = fit_session([reduce(moved), right])
    again = make_session([reduce(moved), stretch_clock(stretch_clock(right, 0.9), 1 / 0.9)])
    effect = MECHANISMS["drive_offset"].effect({"offset_kv": 0.1}, "offset")
    assert Simulation(again).predict(fit.model, fit.theta, effect) == pytest.approx(
        simulation.predict(fit.model, fit.theta, effect), rel=1e-6, abs=1e-9
    )


@pytest.mark.parametrize(("quiet", "window"), [(400, 100), (50, 100)])
def test_what_stands_still_for_long_enough_is_still(quiet: int, window: int) -> None:
    wave = np.concatenate([np.sin(np.arange(300) / 5), np.full(quiet, 0.0), np.sin(np.arange(300) / 5)])
    still = find_still(wave, window)
    assert still[300 + quiet // 2] == (quiet >= window)
    assert not still[:250].any()


@pytest.mark.long_after(30)
def test_an_offset_of_the_monitor_is_named() -> None:
    told = [
        with_channel(r, "voltage", lambda v: v - 0.2) if r.metadata.loading == ELECTRICAL else r
        for r in record_sweeps(BIASED, LOW, (2.0, 2.0))
    ]
    found = diagnose([reduce(r) for r in told])
    assert "drive_offset" in (*found.mechanisms, *found.also_possible)
    assert not set(found.mechanisms) - {"drive_offset"}


def test_a_sweep_that_ends_after_a_few_turns_has_no_features() -> None:
    """It said "behaves as simulated" of a record whose response is refused."""
    whole = make_bipolar()
    cut = {
        q: replace(c, time_ns=c.time_ns[:5800], values=c.values[:5800]) for q, c in whole.channels.items()
    }  # 2 s of rest, 0.9 s of a sweep from 1 Hz
    with pytest.raises(NotIdentifiableError, match=r"ends after [\d.]+ turns"):
        reduce(replace(whole, channels=cut))
