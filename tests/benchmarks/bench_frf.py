"""Frequency response of a long sweep against one real transform of its samples and against two others, in turn.

The others get the same samples and are read off at our lines: scipy's Welch estimate of H1 over segments (nothing known of the
sweep), and pyFRF's H1 of the whole record. Neither says how uncertain it is, nor leaves the rests out.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.fft
import scipy.signal
from numpy.typing import NDArray

from pipeline.transform.chirp import chirp_response
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

TITLE = "Frequency response of a sweep of 1 000 000 samples"
ROUNDS = 15
RATE, SAMPLES = 10_000.0, 1_000_000
SEGMENT = 65_536
"""Samples of a segment of Welch's estimate: 6.6 s, the slowest line has six periods in it."""
Samples = NDArray[np.float64]
Estimate = tuple[Samples, NDArray[np.complex128]]


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


def welch(displacement: Samples, force: Samples) -> Estimate:
    """H1 from scipy's Welch spectra: frequency in Hz, force by displacement in N/mm."""
    at, across = scipy.signal.csd(displacement, force, RATE, nperseg=SEGMENT)
    _, own = scipy.signal.welch(displacement, RATE, nperseg=SEGMENT)
    return at, across / own


def by_pyfrf(displacement: Samples, force: Samples) -> Estimate:
    """H1 of pyFRF: frequency in Hz, force by displacement in N/mm. Types are those that it does not convert."""
    import pyFRF

    found = pyFRF.FRF(int(RATE), displacement, force, exc_type="f", resp_type="e")
    return found.get_f_axis(), found.get_H1().ravel()


def run() -> list[dict[str, Any]]:
    recording = sweep()
    force, displacement = (recording.channels[name].values for name in ("force", "displacement"))
    tasks: dict[str, Callable[[], Any]] = {
        "one rfft of one channel (scipy)": lambda: scipy.fft.rfft(force),
        "response with variance, both channels": lambda: chirp_response(recording),
        f"scipy csd and welch, segments of {SEGMENT}": lambda: welch(displacement, force),
        "pyFRF, H1 of the whole record": lambda: by_pyfrf(displacement, force),
    }
    times: dict[str, list[float]] = {name: [] for name in tasks}
    for _ in range(ROUNDS):
        for name, task in tasks.items():
            started = time.perf_counter()
            task()
            times[name].append(time.perf_counter() - started)
    base = statistics.median(times["one rfft of one channel (scipy)"])
    response, _ = chirp_response(recording)
    estimates = (
        response.value,
        *(np.interp(response.frequency_hz, *peer(displacement, force)) for peer in (welch, by_pyfrf)),
    )
    errors = [f"median error {np.median(np.abs(value / 4 - 1)):.1e}" for value in estimates]
    notes = ("", f"{response.frequency_hz.size} lines, {errors[0]}; aim: at most 3", errors[1], errors[2])
    return [
        {
            "name": name,
            "seconds": statistics.median(several),
            "ratio": statistics.median(several) / base,
            "note": note,
        }
        for (name, several), note in zip(times.items(), notes, strict=True)
    ]
