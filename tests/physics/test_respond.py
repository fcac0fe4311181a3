"""The door to the responses, the clocks behind it, and the rows that come out."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.analyse.responses import AVERAGED, distortion_table, response_table
from pipeline.transform.respond import RecordingResponse, respond
from pipeline.transform.response import STIFFNESS, Distortion, FrequencyResponse
from pipeline.transform.sampling import fill_short_gaps, sample
from schemas.errors import NotIdentifiableError
from schemas.recording import Channel
from tests.physics.rig_truth import START_NS, Sweep, recording


@pytest.mark.parametrize(
    ("protocol", "loading", "channels"),
    [
        ("lifetime", "electrical", ("voltage",)),
        ("step", "electrical", ("voltage", "force")),
        ("force_map", "electrical", ("voltage", "force_1", "force_2")),
        ("cycle", "mechanical", ("displacement", "force")),
        ("tap", "calibration", ("force",)),
    ],
)
def test_protocols_without_responses_give_none(protocol, loading, channels) -> None:
    made = recording({q: np.ones(100) for q in channels}, 100.0, protocol=protocol, loading=loading)
    assert respond(made) == RecordingResponse()


@pytest.mark.parametrize("protocol", ["chirp", "cyclic", "step"])
def test_a_missing_channel_is_named(protocol) -> None:
    made = recording({"displacement": np.sin(np.arange(1000) / 20)}, 100.0, protocol=protocol)
    with pytest.raises(NotIdentifiableError, match=r"no str|no force") as caught:
        respond(made)
    assert caught.value.where == "run-1"


def test_a_sweep_of_another_system_keeps_its_units() -> None:
    sweep = Sweep(1.0, 40.0, 8.0, 1.0)
    time = np.arange(5000) / 500 - 0.5
    made = recording(
        {"input": sweep(time), "output": -4 * sweep(time)},
        500.0,
        loading="other",
        frequency_start_hz=1,
        frequency_stop_hz=40,
        repeats=1,
        details={"input": {"unit": "V"}, "output": {"unit": "mA"}},
    )
    response = respond(made).responses[0]
    np.testing.assert_allclose(response.value, -4.0, rtol=1e-9)
    assert (response.quantity, response.loading) == ("output_per_input", "other")
    assert (response.details["input_unit"], response.details["output_unit"]) == ("V", "mA")


def channel(time_s, values, quantity="force") -> Channel:
    return Channel(
        quantity, START_NS + np.rint(np.asarray(time_s) * 1e9).astype(np.int64), np.asarray(values, dtype=float)
    )


def test_lost_samples_leave_holes_on_the_same_clock() -> None:
    time = np.delete(np.arange(1000) / 500, [100, 400, 401, 402])
    found = sample({"force": channel(time, np.sin(time))}, START_NS)
    assert found.count == 1000
    np.testing.assert_array_equal(np.flatnonzero(~found.finite), [100, 400, 401, 402])
    assert found.interval_s == pytest.approx(0.002, rel=1e-9)
    assert any("4 samples missing in 2 gaps" in note for note in found.notes)
    filled, count = fill_short_gaps(found.values["force"], 2)
    assert count == 1
    assert filled[100] == pytest.approx(np.sin(0.2), abs=1e-6)
    assert np.isnan(filled[400:403]).all()


def test_rounded_stamps_are_no_jitter() -> None:
    time = np.rint(np.arange(5000) / 1024 * 1e3) * 1e-3  # 1024 Hz, stamps in whole milliseconds
    values = np.sin(np.arange(5000) / 50)
    found = sample({"force": channel(time, values)}, START_NS)
    assert 1 / found.interval_s == pytest.approx(1024, rel=1e-4)
    np.testing.assert_array_equal(found.values["force"], values)


def test_jitter_is_interpolated_and_limits_the_band() -> None:
    rng = np.random.default_rng(seed=1)
    time = np.cumsum(rng.choice([0.010, 0.016, 0.017], 2000, p=[0.8, 0.1, 0.1]))
    time[1000:] += 0.299
    found = sample({"force": channel(time, np.sin(2 * np.pi * time))}, START_NS)
    assert found.interval_s == pytest.approx(0.010, rel=1e-6)
    clock = found.start_s["force"] + np.arange(found.count) * found.interval_s
    good = found.finite
    assert np.abs(found.values["force"] - np.sin(2 * np.pi * clock))[good].max() < 1e-3
    assert 0.28 < (~good).sum() * 0.01 < 0.34
    assert found.band_hz < 15
    assert any("gaps" in note for note in found.notes)


def test_channels_keep_their_true_starts() -> None:
    time = np.arange(2000) / 1000
    late = channel(time + 0.0123, np.arange(2000.0), "displacement")
    found = sample({"force": channel(time, np.arange(2000.0)), "displacement": late}, START_NS)
    assert found.count == 1988
    assert found.start_s["displacement"] - found.start_s["force"] == pytest.approx(0.0003, abs=1e-9)
    assert found.values["force"][0] == 12.0


def test_no_common_time() -> None:
    time = np.arange(200) / 100
    with pytest.raises(NotIdentifiableError, match="common time"):
        sample({"force": channel(time, time), "displacement": channel(time + 10, time, "displacement")}, START_NS)


def test_rows_of_responses() -> None:
    f = np.array([1.0, 2.0])
    made = FrequencyResponse(
        f,
        np.array([1 + 1j, np.nan]),
        np.array([0.04, np.nan]),
        np.array([True, False]),
        STIFFNESS,
        "mechanical",
        unusable_because=("", "noise"),
        amplification=np.array([1.5, np.inf]),
        recording_id="run-1",
        specimen_id="film-1",
        amplitude=0.1,
    )
    rows = response_table([made, made]).to_pylist()
    assert len(rows) == 4
    first, second = rows[:2]
    assert first["phase_deg"] == pytest.approx(45.0)
    assert first["standard_error"] == pytest.approx(0.2)
    assert first["unusable_because"] is None
    assert (first["stage"], first["recording_id"], first["amplitude"]) == ("measured", "run-1", 0.1)
    assert second["real"] is None
    assert second["amplification"] is None
    assert second["unusable_because"] == "noise"
    assert response_table([made], AVERAGED).to_pylist()[0]["recording_id"] is None
    assert response_table([]).num_rows == 0


def test_rows_of_distortions() -> None:
    table = distortion_table(
        "run-1",
        [
            Distortion("even", np.array([2.0, 4.0]), np.array([0.1, 0.2]), "N", np.array([2, 4])),
            Distortion("noise", np.array([1.0]), np.array([0.01]), "N"),
        ],
    )
    assert table.column("harmonic").to_pylist() == [2, 4, None]
    assert table.column("kind").to_pylist() == ["even", "even", "noise"]
