"""Responses from noise: against a filter whose response is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from pipeline.transform.respond import respond
from pipeline.transform.response import FrequencyResponse
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording

RATE = 1000.0
POLE, GAIN = 0.9, 0.03


def truth(f: np.ndarray) -> np.ndarray:
    """y_t = 0.9 y_{t−1} + 0.03 u_t."""
    return np.asarray(GAIN / (1 - POLE * np.exp(-2j * np.pi * f / RATE)))


def response(seed: int, *, output_noise: float, input_noise: float = 0.0, seconds: float = 60.0) -> FrequencyResponse:
    rng = np.random.default_rng(seed)
    u = rng.normal(size=int(RATE * seconds))
    y = lfilter([GAIN], [1, -POLE], u) + rng.normal(0, output_noise, u.size)
    u = u + rng.normal(0, input_noise, u.size) if input_noise else u
    ns = 1_772_370_300_000_000_000 + np.round(np.arange(u.size) / RATE * 1e9).astype(np.int64)
    about = {
        "recording_id": "n-1", "specimen_id": "S", "protocol": "noise", "loading": "mechanical",
        "started_at": "2026-03-01T14:05:00+01:00",
    }  # fmt: skip
    channels = {"displacement": Channel("displacement", ns, u), "force": Channel("force", ns, y)}
    (found,) = respond(Recording(RecordingMetadata.parse(about), RigConstants(), channels)).responses
    return found


def test_the_response_is_the_filters_within_its_own_errors() -> None:
    """Over 20 draws the squared errors have the stated variance, at slow lines of one bin and at fast lines of many."""
    ratios = []
    for seed in range(20):
        found = response(seed, output_noise=0.03)
        assert found.usable.sum() > 50
        ratios.append(np.abs(found.value - truth(found.frequency_hz)) ** 2 / found.variance)
    slow, fast = np.array_split(np.mean(ratios, axis=0), 2)
    assert np.mean(slow) == pytest.approx(1, abs=0.25)
    assert np.mean(fast) == pytest.approx(1, abs=0.25)


def test_noise_on_the_input_lowers_the_first_estimate_and_the_second_tells_by_how_much() -> None:
    found = response(3, output_noise=0.0, input_noise=0.5)
    h1 = np.abs(found.value) / np.abs(truth(found.frequency_hz))
    assert np.median(h1) == pytest.approx(1 / 1.25, rel=0.03)
    assert np.median(h1 * np.array(found.details["h2_over_h1"])) == pytest.approx(1, rel=0.03)
    assert np.median(found.coherence) == pytest.approx(0.8, abs=0.03)


def test_an_output_that_does_not_answer_has_no_response() -> None:
    with pytest.raises(NotIdentifiableError, match="lines are usable"):
        response(1, output_noise=100.0)


def test_a_short_record_says_how_long_it_must_be() -> None:
    with pytest.raises(NotIdentifiableError, match="too few"):
        response(1, output_noise=0.01, seconds=0.9)
