"""A small measuring campaign for tests of the nightly: written in a second, analysed in a few."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pytest

import pipeline.nightly.night
from ingest.mcap_writer import RecordingWriter
from pipeline import Lab
from pipeline.nightly.night import nightly
from schemas.tables import TABLES

START = datetime(2026, 3, 1, 8, 0, tzinfo=UTC)
RIG = """clamp_mass_kg = 0.05
clamp_mass_kg_sd = 0.001
load_cell_stiffness_n_per_mm = 40.0
load_cell_stiffness_n_per_mm_sd = 0.4
load_cell_range_n = 5.0
"""


def small_campaign(raw: Path, *, chirps: int = 2, lives: int = 4) -> Path:
    """Chirps of one specimen, lifetime tests of two configurations, a rig file.

    Without chirps a night takes a third of the time: there is nothing to fit and no specimen to diagnose.
    """
    (raw / "rigs").mkdir(parents=True)
    (raw / "rigs" / "rig-a.toml").write_text(RIG)
    for number in range(chirps):
        chirp(raw / f"P-1-chirp-{number}.mcap", number)
    for number in range(lives):
        life(raw / f"L-{number}.mcap", number)
    return raw


def make_lab_of_one_life(folder: Path) -> tuple[Path, Lab]:
    """A raw folder with one recording, and the lab of a night over it that wrote no report."""
    raw, lab = folder / "raw", Lab(folder / "lab")
    raw.mkdir()
    life(raw / "L-1.mcap", 1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pipeline.nightly.night, "_write_report", lambda *_: None)
        assert nightly([raw], lab, jobs=0).exit_status == 0
    return raw, lab


def copy_night(raw: Path, lab: Path, folder: Path) -> tuple[Path, Lab]:
    """A raw folder and its lab in another folder, as if the nights so far had been there."""
    shutil.copytree(raw, folder / "raw")
    shutil.copytree(lab, folder / "lab")
    copied = Lab(folder / "lab")
    with duckdb.connect(
        str(copied.database)
    ) as connection:  # the files are looked at anew, as nothing is known of them
        there = [str(raw), str(folder / "raw")]
        for table in TABLES.values():
            if "source_path" in table.names:
                connection.execute(f"UPDATE {table.name} SET source_path = replace(source_path, ?, ?)", there)
        connection.execute("DELETE FROM files")
    return folder / "raw", copied


def about(name: str, protocol: str, loading: str, specimen: str, minutes: int, **more: Any) -> dict[str, Any]:
    """Metadata of a recording."""
    return {
        "recording_id": name,
        "protocol": protocol,
        "loading": loading,
        "specimen_id": specimen,
        "started_at": (START + timedelta(minutes=minutes)).isoformat(),
        "campaign": "small",
        "rig_id": "rig-a",
        **more,
    }


def write(path: Path, metadata: dict[str, Any], rate_hz: float, channels: dict[str, tuple[str, Any]]) -> Path:
    """One native file with channels of equal rate: quantity to (unit, values)."""
    begin = int(datetime.fromisoformat(metadata["started_at"]).timestamp() * 1e9)
    with RecordingWriter(path, metadata) as recording:
        for quantity, (unit, values) in channels.items():
            recording.add_channel(quantity, unit)
            recording.append(quantity, begin, 1 / rate_hz, values)
    return path


def chirp(path: Path, number: int, *, stiffness: float = 1.0, **more: Any) -> Path:
    """A sweep from 1 to 20 Hz on a spring of 1 N/mm, or another, with a damper of 0.002 N s/mm."""
    rate, duration, low, high = 400.0, 6.0, 1.0, 20.0
    t = np.arange(int(rate * duration)) / rate
    growth = np.log(high / low)
    phase = 2 * np.pi * low * duration / growth * (np.exp(growth * t / duration) - 1)
    speed = 2 * np.pi * low * np.exp(growth * t / duration)
    noise = np.random.default_rng(number)
    x = 0.2 * np.sin(phase)
    f = 0.5 + stiffness * x + 0.002 * 0.2 * speed * np.cos(phase) + noise.normal(0, 1e-3, t.size)
    metadata = about(
        more.pop("name", path.stem), "chirp", "mechanical", "P-1", number, sweep="log", repeats=1, period_s=duration
    )
    metadata |= {"frequency_start_hz": low, "frequency_stop_hz": high, **more}
    channels = {"displacement": ("mm", x + noise.normal(0, 5e-4, t.size)), "force": ("N", f)}
    return write(path, metadata, rate, channels)


def life(path: Path, number: int, *, fails_at: float | None = None, **more: Any) -> Path:
    """A lifetime test of 4 s at 7.5 kV; every second one breaks down, at a time of its own."""
    rate = 200.0
    t = np.arange(int(rate * 5)) / rate
    voltage = np.where((t > 0.5) & (t < 4.5), 7500.0, 0.0)
    at = 1.5 + 0.3 * number if fails_at is None and number % 2 else fails_at
    if at is not None:
        voltage[t > at] = 0.0
    voltage += np.random.default_rng(100 + number).normal(0, 3.0, t.size)
    metadata = about(
        more.pop("name", path.stem), "lifetime", "electrical", f"L-{number}", 60 + number, voltage_setpoint_kv=7.5
    )
    metadata |= {"test_duration_s": 4.0, "configuration": "A" if number < 2 else "B", **more}
    return write(path, metadata, rate, {"voltage": ("V", voltage)})
