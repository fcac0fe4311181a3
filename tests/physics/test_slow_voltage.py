"""The force under a slow voltage against numbers that are put in, from the draft to the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ingest.shapes import Trace, find_shape
from pipeline import Lab
from pipeline.analyse.signs import find_negative
from pipeline.cli import main
from pipeline.transform.slow_voltage import measure_slow_voltage
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

DROP, REST, DRIFT = 0.0043, 0.62, -2e-5
"""N/kV², N and N/s."""
TIME = np.arange(0, 100, 0.05)


def triangles(time_s: Float, *, pause_s: float = 0.0) -> Float:
    """Four triangles to 5 kV, 20 s each, from 10 s on."""
    since = (time_s - 10) % (20 + pause_s)
    on = (time_s >= 10) & (time_s < 10 + 4 * (20 + pause_s)) & (since < 20)
    return np.where(on, 5 * (1 - np.abs(since / 10 - 1)), 0.0)


def force(voltage: Float, power: float = 2.0) -> Float:
    noise = np.random.default_rng(5).normal(0, 1e-3, voltage.size)
    return REST + DRIFT * TIME - DROP * 25 * (voltage / 5) ** power + noise


@pytest.mark.parametrize(
    ("voltage", "protocol"),
    [
        (triangles(TIME), "cycle"),
        (triangles(TIME, pause_s=3), "cycle"),
        (5 * (1 - np.abs(TIME / 50 - 1)), "cycle"),
        (2.5 - 2.5 * np.cos(2 * np.pi * TIME / 20), "cycle"),
        (2.5 - 2.5 * np.cos(2 * np.pi * TIME / 0.5), "sphs"),
        (5.0 * (triangles(TIME) > 2), "step"),
        (np.array([0, 1, 2, 3, 4, 5, 4, 3, 2, 1, 0, 0])[np.minimum(TIME // 8, 11).astype(int)] * 1.0, "cycle"),
        (np.array([0, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 0])[np.minimum(TIME // 8, 11).astype(int)] * 1.0, "step"),
    ],
)
def test_slow_triangles_of_the_voltage_are_told_from_steps_and_fast_ones(voltage: Float, protocol: str) -> None:
    found = find_shape({"voltage": Trace(TIME, voltage), "force": Trace(TIME, force(voltage))})
    assert (found.protocol, found.loading) == (protocol, "electrical")


def test_a_converters_equal_readings_on_a_level_are_one_top() -> None:
    stairs = np.array([0, 2, 4, 6, 4, 2, 0])[np.minimum(TIME // 14, 6).astype(int)]
    voltage = stairs + 0.04 * np.round(np.random.default_rng(2).normal(0, 0.7, TIME.size))
    made = measure_slow_voltage(record(voltage))
    assert (made.cycles, made.drop_n_per_kv2) == (1, pytest.approx(DROP, rel=0.01))
    assert np.isnan(made.lower)


def record(voltage: Float) -> Recording:
    start = 1_772_000_000_000_000_000
    stamps = start + np.round(TIME * 1e9).astype(np.int64)
    channels = {"voltage": Channel("voltage", stamps, voltage), "force": Channel("force", stamps, force(voltage))}
    about = {
        "recording_id": "slow",
        "protocol": "cycle",
        "loading": "electrical",
        "specimen_id": "A-1",
        "started_at": "2026-03-01T10:00:00Z",
    }
    return Recording(metadata=RecordingMetadata.parse(about), rig=RigConstants(), channels=channels)


@pytest.mark.long
@pytest.mark.parametrize("power", [2.0, 1.5])
def test_a_night_gives_the_drop_over_the_squared_voltage_that_was_put_in(
    tmp_path: Path, power: float, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = tmp_path / "raw"
    raw.mkdir()
    voltage = triangles(TIME)
    rows = [f"{t:.2f},{v:.4f},{f:.6f}" for t, v, f in zip(TIME, voltage, force(voltage, power), strict=True)]
    (raw / "slow.csv").write_text("\n".join(["time (s),HV (kV),Force (N)", *rows, ""]))
    assert main(["add", str(raw / "slow.csv"), "--yes", "specimen_id=A-1", "started_at=2026-03-01T10:00:00Z"]) == 0
    assert "drop of the force over the squared voltage" in capsys.readouterr().out
    assert main(["nightly", str(raw), "--lab", str(tmp_path / "lab")]) == 0
    row = Lab(tmp_path / "lab").sql("SELECT * FROM voltage_cycles").iloc[0]
    assert (row["cycles"], row["peak_kv"]) == (4, pytest.approx(5, abs=0.01))
    assert row["exponent"] == pytest.approx(power, abs=0.03)
    if power == 2:
        assert row["rest_n"] == pytest.approx(REST, abs=3e-3)
        assert row["drop_n_per_kv2"] == pytest.approx(DROP, rel=0.005)
        assert row["drop_n_per_kv2_lower"] < DROP < row["drop_n_per_kv2_upper"]
        assert row["drift_n_per_min"] == pytest.approx(60 * DRIFT, abs=2e-4)
    else:
        assert "not with its square" in row["warnings"]
    page = (tmp_path / "lab" / "reports" / "specimens" / "A-1.html").read_text(encoding="utf-8")
    assert "The force drops by 0.00" in page
    assert "Squared voltage, kV²" in page or "<img" in page


def test_no_voltage_has_no_power() -> None:
    """Its noise was taken for triangles, and the force said to go with their fourth power."""
    with pytest.raises(NotIdentifiableError, match="does not go up and down"):
        measure_slow_voltage(record(np.random.default_rng(1).normal(0, 1e-3, TIME.size)))


def test_a_force_that_does_not_follow_the_voltage_is_told_no_power() -> None:
    slow = record(triangles(TIME))
    still = REST + np.random.default_rng(6).normal(0, 1e-3, TIME.size)
    channels = {**slow.channels, "force": Channel("force", slow.channels["force"].time_ns, still)}
    found = measure_slow_voltage(replace(slow, channels=channels))
    assert np.isnan(found.exponent)
    assert any("does not follow the voltage" in w for w in found.warnings)
    assert found.lower < 0 < found.upper


def test_a_force_that_rises_with_the_voltage_is_a_finding() -> None:
    slow = record(triangles(TIME))
    turned = replace(slow.channels["force"], values=-slow.channels["force"].values)
    channels = {**slow.channels, "force": turned}
    (found,) = find_negative(replace(slow, channels=channels), ())
    assert found.statement.startswith("the actuation is negative, \N{MINUS SIGN}0.0043")
    assert not find_negative(slow, ())


def test_a_voltage_of_both_signs_tells_both_and_a_monitor_off_zero_is_corrected() -> None:
    """One polarity pulls a tenth more; the monitor reads 30 V while the voltage is off."""
    since = (TIME - 10) % 40
    on = (TIME >= 10) & (TIME < 90)
    voltage = np.where(on, 5 * (np.abs((since + 30) % 40 / 10 - 2) - 1), 0.0)
    pulled = REST - DROP * voltage**2 * np.where(voltage > 0, 1.0, 1.1)
    slow = record(voltage + 0.03 + np.random.default_rng(7).normal(0, 2e-3, TIME.size))
    noisy = pulled + np.random.default_rng(8).normal(0, 5e-4, TIME.size)
    channels = {**slow.channels, "force": Channel("force", slow.channels["force"].time_ns, noisy)}
    found = measure_slow_voltage(replace(slow, channels=channels))
    assert found.positive == pytest.approx(DROP, rel=0.01)
    assert found.negative == pytest.approx(1.1 * DROP, rel=0.01)
    assert any("before the voltage rises" in w for w in found.warnings)
    assert np.isnan(measure_slow_voltage(record(triangles(TIME))).negative)


@pytest.mark.long
@pytest.mark.slow
def test_the_stroke_of_a_load_under_a_slow_voltage_is_measured_on_both_branches(tmp_path: Path) -> None:
    """0.031 mm/kV² at once and 0.005 with 2 s: less on the way up than on the way down."""
    voltage = triangles(TIME)
    slow = np.zeros(TIME.size)
    for i in range(1, TIME.size):
        slow[i] = slow[i - 1] + 0.05 / 2.0 * (0.005 * voltage[i] ** 2 - slow[i - 1])
    moved = 0.031 * voltage**2 + slow + np.random.default_rng(9).normal(0, 2e-3, TIME.size)
    found = find_shape({"voltage": Trace(TIME, voltage), "displacement": Trace(TIME, moved)})
    assert (found.protocol, found.loading) == ("isotonic", "electrical")
    raw = tmp_path / "raw"
    raw.mkdir()
    rows = [f"{t:.2f},{v:.4f},{x:.6f}" for t, v, x in zip(TIME, voltage, moved, strict=True)]
    (raw / "slow.csv").write_text("\n".join(["time (s),HV (kV),Stroke (mm)", *rows, ""]))
    assert main(["add", str(raw / "slow.csv"), "--yes", "specimen_id=A-1", "started_at=2026-03-01T10:00:00Z"]) == 0
    assert main(["nightly", str(raw), "--lab", str(tmp_path / "lab")]) == 0
    lab = Lab(tmp_path / "lab")
    row = lab.sql("SELECT * FROM isotonic_tests").iloc[0]
    assert 0.031 < row["mm_per_kv2_rising"] < row["mm_per_kv2"] < row["mm_per_kv2_falling"] < 0.037
    assert row["mm_per_kv2"] == pytest.approx(np.polyfit(voltage**2, moved, 1)[0], rel=0.01)
    stroke = lab.sql("SELECT * FROM isotonic_strokes").iloc[0]
    assert stroke["stroke_mm"] == pytest.approx(moved[np.abs(voltage - 5) < 0.03].mean(), rel=0.02)
    page = (tmp_path / "lab" / "reports" / "specimens" / "A-1.html").read_text(encoding="utf-8")
    assert "the film moves its load by 0.8" in page
    assert "on the way up and" in page
