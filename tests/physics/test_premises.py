"""What a protocol takes for granted is looked at: a constant voltage for a life, one amplitude for a sinusoid, periods that are alike."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import chirp, lfilter

from pipeline.transform.breakdown import detect_breakdown
from pipeline.transform.breakdown_life import Lifetime
from pipeline.transform.cyclic import cyclic_response
from pipeline.transform.force_map import measure_force_map
from pipeline.transform.response import FrequencyResponse
from pipeline.transform.sphs import sphs_response
from pipeline.transform.step import measure_steps
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

Float = NDArray[np.float64]
START_NS = 1_772_000_000_000_000_000


def _record(protocol: str, loading: str, time_s: Float, channels: dict[str, Float], **known: Any) -> Recording:
    stamps = START_NS + np.round(time_s * 1e9).astype(np.int64)
    about = RecordingMetadata(
        recording_id="r", specimen_id="S", protocol=protocol, loading=loading, started_at=datetime(2026, 3, 1, tzinfo=UTC), **known
    )  # fmt: skip
    return Recording(about, RigConstants(), {name: Channel(name, stamps, v) for name, v in channels.items()})


# ---- a voltage that holds its level while it is on ------------------------------------------------------------------

STEP_S = np.arange(0, 60, 0.01)
PHASE_S = np.mod(STEP_S, 10)
ON = (PHASE_S > 3) & (PHASE_S < 8)
UNSTEADY = {
    "sag": np.where(PHASE_S > 5, 0.75, 1.0),
    "stairs": np.where(PHASE_S < 5, 0.5, 1.0),
    "droop": np.exp(-(PHASE_S - 3) / 20),
    "alternating": np.sign(np.sin(2 * np.pi * 2 * STEP_S)),
}


def _switch(shape: Float, noise_kv: float = 0.001) -> Recording:
    """Six times of 7 kV times a shape, with a force that follows its square at once."""
    rng = np.random.default_rng(27)
    voltage = 7 * ON * shape
    force = 1 - 1e-3 * voltage**2 + 1e-4 * rng.standard_normal(STEP_S.size)
    measured = voltage + noise_kv * rng.standard_normal(STEP_S.size)
    return _record("step", "electrical", STEP_S, {"voltage": measured, "force": force, "force_1": force}, stretch_1=2.0)


@pytest.mark.long_after(2)
@pytest.mark.parametrize("shape", UNSTEADY.values(), ids=UNSTEADY)
def test_a_voltage_that_is_not_constant_while_it_is_on_is_named(shape: Float) -> None:
    """At a step and at a static force: what it comes to is no answer to one voltage."""
    recording = _switch(shape)
    steps = measure_steps(recording).steps
    assert len(steps) == 6
    assert all(any("not constant while it is on" in text for text in step.warnings) for step in steps)
    said = [text for text in measure_force_map(recording).warnings if "not constant while it is on" in text]
    assert len(said) == 6
    assert said[0].startswith("force_1: cycle 1: ")


def test_a_sinusoid_is_no_step() -> None:
    with pytest.raises(NotIdentifiableError, match="the voltage makes no step"):
        measure_steps(_switch(np.sin(2 * np.pi * 20 * STEP_S)))


@pytest.mark.parametrize("noise_kv", [0.001, 0.2])
def test_a_voltage_that_holds_is_not_accused(noise_kv: float) -> None:
    recording = _switch(1 + 0.01 * np.sin(2 * np.pi * 0.7 * STEP_S), noise_kv)
    assert not [text for step in measure_steps(recording).steps for text in step.warnings if "not constant" in text]
    assert not [text for text in measure_force_map(recording).warnings if "not constant" in text]


# ---- constant voltage for a life -------------------------------------------------------------------------------------

LIFE_S = np.arange(0, 600, 0.05)


def _live(shape: Float) -> Lifetime:
    """A life at 6 kV times a shape from 2 s on, switched off at 500 s."""
    on = (LIFE_S > 2) & (LIFE_S < 500)
    noise = 0.003 * np.random.default_rng(1).standard_normal(LIFE_S.size)
    return detect_breakdown(
        _record("lifetime", "electrical", LIFE_S, {"voltage": 6 * shape * on + noise}, voltage_setpoint_kv=6.0)
    )


@pytest.mark.parametrize("hertz", [0.1, 0.01])
def test_a_voltage_that_swings_is_not_constant(hertz: float) -> None:
    with pytest.raises(
        NotIdentifiableError, match=r"goes to and fro between 4\.[78]\d? and 7\.[12]\d? kV: not constant"
    ):
        _live(1 + 0.2 * np.sin(2 * np.pi * hertz * LIFE_S))


@pytest.mark.parametrize("on_s", [25, 45])
def test_a_voltage_that_is_switched_by_the_clock_is_not_constant(on_s: float) -> None:
    with pytest.raises(NotIdentifiableError, match="not constant"):
        _live((np.mod(LIFE_S, 50) < on_s).astype(float))


def test_a_ripple_of_five_percent_is_constant() -> None:
    assert _live(1 + 0.04 * np.sin(2 * np.pi * 0.1 * LIFE_S)).lifetime_s == pytest.approx(498, abs=0.2)


def test_dips_at_any_time_are_no_programme() -> None:
    """Sags that recover come when they come."""
    shape = np.ones(LIFE_S.size)
    for at, away in ((40, 0.4), (133, 1.9), (151, 0.7), (320, 3.1)):
        shape[np.abs(LIFE_S - at - away / 2) < away / 2] = 0.4
    assert _live(shape).lifetime_s > 30


def test_a_voltage_that_rose_for_longer_than_it_was_held_is_said_so() -> None:
    """From a tenth of the set point to 95 % of it: 0.85 of 490 s."""
    notes = " ".join(_live(np.clip(LIFE_S / 490, 0, 1)).warnings)
    assert "took 416 s to rise, longer than it was held" in notes or "took 417 s to rise" in notes
    assert not any("to rise" in note for note in _live(np.ones(LIFE_S.size)).warnings)


# ---- one amplitude for a sinusoid ------------------------------------------------------------------------------------

CYCLIC_S = np.arange(0, 60, 0.01)
WAVE = np.sin(2 * np.pi * CYCLIC_S)


def _cycle(x: Float) -> tuple[FrequencyResponse, tuple[str, ...]]:
    force = 0.5 + 0.3 * x + 1e-4 * np.random.default_rng(2).standard_normal(x.size)
    response, _, warnings = cyclic_response(
        _record("cyclic", "mechanical", CYCLIC_S, {"displacement": x, "force": force}, frequency_hz=1.0)
    )
    return response, warnings


@pytest.mark.parametrize("envelope", [0.2 + CYCLIC_S / 60, np.where(CYCLIC_S < 30, 0.5, 1.0)], ids=["growing", "two"])
def test_several_amplitudes_in_one_recording_are_named(envelope: Float) -> None:
    with pytest.raises(
        NotIdentifiableError, match=r"the amplitude goes from 0\.\d+ to (1|1\.\d+) mm from cycle to cycle"
    ):
        _cycle(WAVE * envelope)


def test_an_amplitude_that_changes_a_little_is_noted() -> None:
    response, warnings = _cycle(WAVE * (1 + 0.08 * CYCLIC_S / 60))
    assert response.value[0].real == pytest.approx(0.3, rel=1e-3)
    assert any("the amplitude goes from" in warning for warning in warnings)
    assert not _cycle(WAVE)[1]


def test_a_triangle_is_no_sinusoid() -> None:
    """Its third harmonic is a ninth."""
    _, warnings = _cycle(2 / np.pi * np.arcsin(WAVE))
    assert any("no sinusoid: its third harmonic is 11 %" in warning for warning in warnings)


# ---- periods that are alike ------------------------------------------------------------------------------------------

PERIOD, PERIODS, RATE = 2000, 6, 1000.0
_LINES = np.arange(1, 200, 2)
ONE = np.cos(
    2 * np.pi * np.outer(np.arange(PERIOD) / PERIOD, _LINES) - np.pi * _LINES * (_LINES - 1) / _LINES.size
).sum(axis=1)
ONE /= np.abs(ONE).max()


def _drive(u: Float, period_s: float = PERIOD / RATE) -> tuple[FrequencyResponse, tuple[str, ...]]:
    voltage = np.sqrt(9 + 8 * u)
    force = 0.5 - 0.004 * lfilter([0.1], [1, -0.9], voltage**2)
    force += 1e-5 * np.random.default_rng(3).standard_normal(u.size)
    known = {"period_s": period_s, "frequency_start_hz": 0.5, "frequency_stop_hz": 100.0}
    time = np.arange(u.size) / RATE
    response, _, warnings = sphs_response(
        _record("sphs", "electrical", time, {"voltage": voltage, "force": force}, **known)
    )
    return response, warnings


def test_periods_that_are_alike_are_taken() -> None:
    response, _ = _drive(np.tile(ONE, PERIODS))
    assert response.usable.all()


@pytest.mark.parametrize("period_s", [1.9, 1.0, 1.5])
def test_another_period_than_that_of_the_input_is_named(period_s: float) -> None:
    with pytest.raises(NotIdentifiableError, match=r"no two periods of .* s of the input are alike"):
        _drive(np.tile(ONE, PERIODS), period_s)


def test_noise_and_sweeps_are_no_periods() -> None:
    size = PERIOD * PERIODS
    noise = np.clip(0.5 * lfilter([0.2], [1, -0.8], np.random.default_rng(4).standard_normal(size)), -1, 1)
    for u in (noise, chirp(np.arange(size) / RATE, 0.5, size / RATE, 100)):
        with pytest.raises(NotIdentifiableError, match="no two periods"):
            _drive(u)


def test_an_input_that_grows_from_period_to_period_is_named() -> None:
    with pytest.raises(NotIdentifiableError, match=r"the input goes from .* to .* % of its mean from period to period"):
        _drive(np.tile(ONE, PERIODS) * np.linspace(0.2, 1, PERIOD * PERIODS))
