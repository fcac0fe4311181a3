"""What is taken for granted is said: each default that the analyses use, and none where nothing is missing."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.analyse.assumptions import find_assumptions
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

BASE = {"recording_id": "r", "specimen_id": "S", "started_at": "2026-03-01T08:00:00Z", "rest_before_s": 600}
SIZES = {"film_length_mm": 50, "film_width_mm": 20, "film_thickness_mm": 0.2}
RIG = {
    "rig_id": "rig-a", "clamp_mass_kg": 0.05, "clamp_mass_kg_sd": 0.001, "load_cell_stiffness_n_per_mm": 40,
    "load_cell_stiffness_n_per_mm_sd": 0.4, "load_cell_damping_n_s_per_mm": 0.001,
    "load_cell_damping_n_s_per_mm_sd": 0.001, "force_gain": 1.0,
}  # fmt: skip


def assumed(
    protocol: str, loading: str, channels: str, rig: dict[str, object] | None = None, **keys: object
) -> dict[str, str]:
    """What is assumed, and the value that it is taken to have."""
    time = np.arange(10, dtype=np.int64)
    recording = Recording(
        RecordingMetadata.parse({**BASE, "protocol": protocol, "loading": loading, **keys}),
        RigConstants.parse(RIG if rig is None else rig),
        {name: Channel(name, time, np.zeros(10)) for name in channels.split()},
    )
    found = find_assumptions(recording)
    assert all(one.because and one.touches for one in found)
    assert len({one.what for one in found}) == len(found), "one row for each"
    return {one.what: one.value for one in found}


def test_a_cycle_without_sizes_is_a_cube() -> None:
    found = assumed("cycle", "mechanical", "displacement force")
    assert found["sizes of the film"] == "a cube of 1 mm: 1 MPa = 1 N/mm, stretch − 1 = mm"
    some = assumed("cycle", "mechanical", "displacement force", film_length_mm=50)
    assert some["sizes of the film"] == "cross-section 1 mm²"
    assert some["pre-stretch along the force"] == "1"


def test_a_cycle_with_its_sizes_is_none() -> None:
    found = assumed("cycle", "mechanical", "displacement force", **SIZES, stretch_1=1.2)
    assert found.keys() == {"volume of the film", "polarity of displacement and force", "rest length"}
    assert found["rest length"] == "displacement 0 is stretch 1.2"


def test_stress_and_stretch_without_all_sizes_are_those_of_a_cube() -> None:
    found = assumed(
        "chirp", "mechanical", "stretch stress", film_length_mm=50, frequency_start_hz=1, frequency_stop_hz=9
    )
    assert "cube" in found["sizes of the film"], "a part of the sizes is not used there"


@pytest.mark.parametrize(
    ("left_out", "what", "value"),
    [
        ("clamp_mass_kg_sd", "clamp mass", "± 3 %"),
        ("load_cell_stiffness_n_per_mm_sd", "load-cell stiffness", "± 2 %"),
        ("load_cell_damping_n_s_per_mm", "damping of the load cell", "none"),
        ("load_cell_damping_n_s_per_mm_sd", "load-cell damping", "± 100 %, at least 1 % of critical"),
        ("load_cell_stiffness_n_per_mm", "clamp and load cell", "not in the response"),
        ("clamp_mass_kg", "clamp mass", "inertia neglected"),
        ("force_gain", "gain of the force channel", "1"),
    ],
)
def test_what_a_rig_file_leaves_out(left_out: str, what: str, value: str) -> None:
    rig = {key: given for key, given in RIG.items() if key != left_out}
    keys = {"frequency_start_hz": 1, "frequency_stop_hz": 9}
    whole = assumed("chirp", "mechanical", "displacement force", **keys)
    assert whole.keys() == {"polarity of displacement and force"}
    found = assumed("chirp", "mechanical", "displacement force", rig, **keys)
    assert found[what] == value
    assert "rig-a" in str(RIG["rig_id"])


def test_what_an_electrical_test_leaves_out() -> None:
    keys = {**SIZES, "stretch_1": 4.0, "active_length_mm": 10, "active_width_mm": 10, "relative_permittivity": 4.7}
    found = assumed("force_map", "electrical", "voltage force_1 force_2", **keys)
    assert found == {
        "pre-stretch across the force": "0.5, 1/√stretch_1",
        "state of the film whose electrode was measured": "undeformed",
        "layers": "1",
        "standard deviation of the permittivity": "10 %",
    }
    stack = assumed("force_map", "electrical", "voltage force_1 force_2", **keys, layers=4)
    assert stack["film_thickness_mm of a stack"] == "that of all layers together"
    steps = assumed("step", "electrical", "voltage force command", **keys)
    assert steps["state of the film whose electrode was measured"] == "stretched"
    assert steps["gain of the amplifier"] == "the measured voltage over its command"


def test_what_a_life_leaves_out() -> None:
    found = assumed("lifetime", "electrical", "voltage", rods=2)
    assert found.keys() == {
        "set point", "planned duration of the test", "electrodes over the rods", "film over the rods",
    }  # fmt: skip
    sized = assumed("lifetime", "electrical", "voltage", rods=2, film_length_mm=16, film_width_mm=7)
    assert "film over the rods" not in sized


def test_rest_is_assumed_where_no_key_says_it() -> None:
    found = assumed("step", "mechanical", "displacement force", rest_before_s="")
    assert found["rest before the recording"] == "as long as it takes: at rest at its first sample"


def test_a_channel_that_no_analysis_uses_is_named() -> None:
    found = assumed("step", "electrical", "voltage force displacement temperature command", rest_before_s=1)
    assert found == {
        "channel displacement": "not used",
        "gain of the amplifier": "the measured voltage over its command",
    }
    life = assumed("lifetime", "electrical", "voltage temperature", voltage_setpoint_kv=7, test_duration_s=60)
    assert life == {"channel temperature": "not used"}
