"""Linear sweeps that begin at 0 Hz, as many generators make them."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.analyse.recording import analyse_recording
from pipeline.transform.respond import respond
from schemas.errors import RefusedError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

RATE = 500


def recording(**keys: object) -> Recording:
    """A spring of 0.3 N/mm swept linearly from 0 to 50 Hz in a minute, with rest on both sides."""
    t = np.arange(60 * RATE) / RATE
    x = np.concatenate([np.zeros(RATE), 0.5 * np.sin(np.pi * 50 / 60 * t**2), np.zeros(2 * RATE)])
    force = 1 + 0.3 * x + np.random.default_rng(2).normal(0, 1e-3, x.size)
    ns = 1_772_370_300_000_000_000 + np.arange(x.size) * (1_000_000_000 // RATE)
    about = {
        "recording_id": "c-1", "specimen_id": "S", "protocol": "chirp", "loading": "mechanical", "sweep": "linear",
        "started_at": "2026-03-01T14:05:00+01:00", "frequency_start_hz": 0, "frequency_stop_hz": 50, **keys,
    }  # fmt: skip
    channels = {"displacement": Channel("displacement", ns, x), "force": Channel("force", ns, force)}
    return Recording(RecordingMetadata.parse(about), RigConstants(), channels)


@pytest.mark.parametrize("ends", [{}, {"frequency_start_hz": 50, "frequency_stop_hz": 0}])
def test_a_sweep_from_zero_has_a_response_and_features(ends: dict[str, object]) -> None:
    swept = recording(**ends)
    (response,) = respond(swept).responses
    good = response.usable
    assert good.sum() > 30
    assert np.median(np.abs(response.value[good] - 0.3)) < 3e-3
    assert analyse_recording(swept).failures == []


@pytest.mark.parametrize("keys", [{"sweep": "log"}, {"frequency_stop_hz": 0}])
def test_a_sweep_that_cannot_be_is_refused(keys: dict[str, object]) -> None:
    with pytest.raises(RefusedError, match="cannot be"):
        recording(**keys)
