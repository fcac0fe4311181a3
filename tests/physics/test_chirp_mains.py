"""Mains on both channels of a sweep: where nothing else excites a line, its ratio is no response."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.transform.respond import respond
from pipeline.transform.response import FrequencyResponse
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

RATE = 1000
REST_S, SWEEP_S = 2.0, 20.0


def response(*, repeats: int, highest: float, on_input: float, seed: int = 1) -> FrequencyResponse:
    """A spring of 0.3 N/mm, swept from 1 Hz to `highest` though the metadata say 200 Hz, with 50, 100 and 150 Hz on both."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(SWEEP_S * RATE)) / RATE
    rate = np.log(highest) / SWEEP_S
    sweep = np.concatenate([np.zeros(int(REST_S * RATE)), np.sin(2 * np.pi * np.expm1(rate * t) / rate)])
    x = np.concatenate([*[sweep] * repeats, np.zeros(int(REST_S * RATE))])
    force = 0.3 * x + rng.normal(0, 1e-3, x.size)
    x = x + rng.normal(0, 1e-4, x.size)
    for n in (1, 2, 3):
        turning = 2 * np.pi * 50 * n * np.arange(x.size) / RATE
        x = x + on_input / n * np.sin(turning + 0.3)
        force = force + 0.05 / n * np.sin(turning + 1.2)
    ns = 1_772_370_300_000_000_000 + np.arange(x.size) * (1_000_000_000 // RATE)
    about = {
        "recording_id": "m-1", "specimen_id": "S", "protocol": "chirp", "loading": "mechanical", "sweep": "log",
        "started_at": "2026-03-01T14:05:00+01:00", "frequency_start_hz": 1, "frequency_stop_hz": 200, "repeats": repeats,
    }  # fmt: skip
    channels = {"displacement": Channel("displacement", ns, x), "force": Channel("force", ns, force)}
    (found,) = respond(Recording(RecordingMetadata.parse(about), RigConstants(), channels)).responses
    return found


@pytest.mark.parametrize("repeats", [1, 3])
@pytest.mark.parametrize("on_input", [0.0, 0.002, 0.005, 0.02])
def test_no_line_is_usable_that_the_mains_alone_excites(repeats: int, on_input: float) -> None:
    """At 50 Hz the ratio of the two hums is up to 8 times the spring, with a small variance of its own."""
    found = response(repeats=repeats, highest=40.0, on_input=on_input)
    good = found.usable
    off = np.abs(found.value[good] - 0.3)
    assert good.sum() >= 20
    assert np.all(off < 6 * np.sqrt(found.variance[good]) + 3e-3), found.frequency_hz[good][off.argmax()]


@pytest.mark.parametrize("repeats", [1, 3])
def test_lines_that_the_sweep_passes_stay_usable_beside_a_small_hum(repeats: int) -> None:
    found = response(repeats=repeats, highest=200.0, on_input=0.002)
    near = np.abs(found.frequency_hz / 50 - 1) < 0.1
    assert found.usable[near].any()
