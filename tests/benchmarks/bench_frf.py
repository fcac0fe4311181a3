"""Frequency response of a long sweep against one real transform of its samples, in turn in one run."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.fft

from pipeline.transform.chirp import chirp_response
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

TITLE = "Frequency response of a sweep of 1 000 000 samples"
ROUNDS = 15
RATE, SAMPLES = 10_000.0, 1_000_000


def sweep() -> Recording:
    """1 to 100 Hz in 85 s between rests, a spring of 4 N/mm, noise on both channels."""
    rng = np.random.default_rng(0)
    t = np.clip(np.arange(SAMPLES) / RATE - 5, 0, 85)
    rate = np.log(100) / 85
    ends = np.clip(t / 0.2, 0, 1) * np.clip((85 - t) / 0.2, 0, 1)
    x = 0.3 * ends * np.sin(2 * np.pi * np.expm1(rate * t) / rate)
    stamps = 1_772_000_000_000_000_000 + np.arange(SAMPLES) * 100_000
    metadata = RecordingMetadata.parse(
        {
            "recording_id": "sweep",
            "protocol": "chirp",
            "loading": "mechanical",
            "specimen_id": "spring",
            "started_at": "2026-03-01T10:00:00Z",
            "frequency_start_hz": 1,
            "frequency_stop_hz": 100,
            "sweep": "log",
            "repeats": 1,
        }
    )
    values = {"displacement": x + rng.normal(0, 5e-4, SAMPLES), "force": 4 * x + rng.normal(0, 1e-3, SAMPLES)}
    return Recording(metadata, RigConstants(), {q: Channel(q, stamps, v) for q, v in values.items()})


def run() -> list[dict[str, Any]]:
    recording = sweep()
    force = recording.channels["force"].values
    tasks: dict[str, Callable[[], Any]] = {
        "one rfft of one channel (scipy)": lambda: scipy.fft.rfft(force),
        "response with variance, both channels": lambda: chirp_response(recording),
    }
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(ROUNDS):
        for name, task in tasks.items():
            started = time.perf_counter()
            task()
            times[name].append(time.perf_counter() - started)
    base = statistics.median(times["one rfft of one channel (scipy)"])
    response, _ = chirp_response(recording)
    error = float(np.median(np.abs(response.value / 4 - 1)))
    notes = ("", f"{response.frequency_hz.size} lines, median error {error:.1e}; aim: at most 3")
    return [
        {
            "name": name,
            "seconds": statistics.median(several),
            "ratio": statistics.median(several) / base,
            "note": note,
        }
        for (name, several), note in zip(times.items(), notes, strict=True)
    ]
