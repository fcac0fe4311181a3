"""A stiffness or an actuation that comes out negative is a finding, whatever protocol shows it; noise and inertia are none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.analyse.recording import analyse_content, analyse_recording
from pipeline.analyse.signs import find_negative
from pipeline.transform.response import STIFFNESS, FrequencyResponse
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording
from tests.physics.test_steps import record

START_NS = 1_767_225_600_000_000_000


def turned(recording: Recording, quantity: str = "force") -> Recording:
    """The same with a channel that counts the other way."""
    channel = recording.channels[quantity]
    return replace(recording, channels={**recording.channels, quantity: replace(channel, values=-channel.values)})


def pulled(protocol: str, move: np.ndarray, force: np.ndarray, rate: float, **keys: object) -> Recording:
    ns = START_NS + np.round(np.arange(move.size) / rate * 1e9).astype(np.int64)
    about = {
        "recording_id": "r",
        "specimen_id": "S",
        "protocol": protocol,
        "loading": "mechanical",
        "started_at": "2026-01-01T00:00:00Z",
    }
    channels = {"displacement": Channel("displacement", ns, move), "force": Channel("force", ns, force)}
    return Recording(RecordingMetadata.parse({**about, **keys}), RigConstants(), channels)


def statements(recording: Recording) -> list[str]:
    return [one.statement for one in find_negative(recording, analyse_recording(recording).carried)]


def test_steps_of_the_voltage() -> None:
    recording = record([8.0] * 6)
    assert statements(recording) == []
    (found,) = statements(turned(recording))
    assert found.startswith("the actuation is negative, −0.0440 N in the mean step: the force counts the other way")


def test_a_relaxation() -> None:
    t = np.arange(6000) / 100
    move = 0.5 * np.clip((t - 5) / 0.1, 0, 1)
    force = move * (0.3 + 0.2 * np.exp(-np.clip(t - 5, 0, None) / 3)) + np.random.default_rng(0).normal(0, 1e-4, t.size)
    assert statements(pulled("step", move, force, 100.0)) == []
    for recording in (pulled("step", move, -force, 100.0), pulled("step", -move, force, 100.0)):
        (found,) = statements(recording)
        assert found.startswith("the stiffness is negative")
        assert "force or displacement counts the other way" in found


def test_a_cycle() -> None:
    move = np.concatenate([np.linspace(0, 50, 400), np.linspace(50, 0, 400)])
    force = 0.02 * move + np.random.default_rng(0).normal(0, 1e-3, move.size)
    sizes = {"film_length_mm": 50, "film_width_mm": 20, "film_thickness_mm": 0.2}
    assert find_negative(pulled("cycle", move, force, 10.0, **sizes), []) == ()
    (found,) = find_negative(pulled("cycle", move, -force, 10.0, **sizes), [])
    assert "kPa per stretch" in found.statement


def response(value: np.ndarray, sd: float) -> FrequencyResponse:
    f = np.geomspace(1, 30, value.size)
    return FrequencyResponse(
        frequency_hz=f, value=value.astype(complex), variance=np.full(f.size, sd**2), usable=np.ones(f.size, bool),
        unusable_because=("",) * f.size, quantity=STIFFNESS, loading="mechanical",
    )  # fmt: skip


def test_inertia_and_noise_are_no_negative_stiffness() -> None:
    assert find_negative(None, [response(np.full(30, -0.01), 0.05)]) == (), "within the noise"
    inertia = 0.3 * (1 - (np.geomspace(1, 30, 30) / 10) ** 2)
    assert find_negative(None, [response(inertia, 1e-3)]) == ()
    (found,) = find_negative(None, [response(np.full(30, -0.3), 1e-3)])
    assert found.statement.startswith("the stiffness is negative, −0.300 N/mm at 1 to 2.87 Hz")
    recording = pulled("chirp", np.zeros(10), np.zeros(10), 10.0, frequency_start_hz=20, frequency_stop_hz=30)
    rig = RigConstants.parse({"clamp_mass_kg": 0.05, "load_cell_stiffness_n_per_mm": 0.05})
    heavy = replace(recording, rig=rig)
    assert find_negative(heavy, [response(np.full(30, -0.3), 1e-3)]) != (), "below 0.7 of 5 Hz it is the film"


def test_it_is_a_row_and_a_problem_of_the_recording() -> None:
    row, analysis = analyse_content(turned(record([8.0] * 6)), "recording")
    assert row["status"] == "ok"
    assert "the actuation is negative" in row["problem"]
    (found,) = analysis.joined()["discrepancies"].to_pylist()
    assert (found["specimen_id"], found["recording_id"], found["where_found"]) == ("D-1", "step-1", "sign")
    assert found["p_value"] < 1e-6


@pytest.mark.parametrize("quantity", ["voltage", "capacitance"])
def test_a_turned_voltage_acts_the_same(quantity: str) -> None:
    assert statements(turned(record([8.0] * 6), quantity)) == []
