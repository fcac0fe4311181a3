"""Responses from noise: against a filter whose response is known in closed form."""

from __future__ import annotations

from collections.abc import Sequence

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


def response(
    seed: int,
    *,
    output_noise: float,
    input_noise: float = 0.0,
    seconds: float = 60.0,
    tone_hz: float = 0.0,
    beside_tone: float = 1e-4,
    lost: Sequence[int] = (),
    stop_hz: float | None = None,
) -> FrequencyResponse:
    """Of noise, or of a tone with a little noise beside it; `lost` are samples that both channels lack, `stop_hz` what the metadata say."""
    rng = np.random.default_rng(seed)
    u = rng.normal(size=int(RATE * seconds))
    u = np.sin(2 * np.pi * tone_hz * np.arange(u.size) / RATE) + beside_tone * u if tone_hz else u
    y = lfilter([GAIN], [1, -POLE], u) + rng.normal(0, output_noise, u.size)
    u = u + rng.normal(0, input_noise, u.size) if input_noise else u
    ns = 1_772_370_300_000_000_000 + np.round(np.arange(u.size) / RATE * 1e9).astype(np.int64)
    about = {
        "recording_id": "n-1", "specimen_id": "S", "protocol": "noise", "loading": "mechanical",
        "started_at": "2026-03-01T14:05:00+01:00",
    } | ({"frequency_start_hz": 1.0, "frequency_stop_hz": stop_hz} if stop_hz else {})  # fmt: skip
    u, y, ns = (np.delete(values, list(lost)) for values in (u, y, ns))
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


@pytest.mark.parametrize("many", [1, 40])
def test_lost_samples_cost_the_pieces_that_they_touch(many: int) -> None:
    """Not all that comes before them: of 31 pieces two, or one more where the parts no longer fill with pieces."""
    whole, cut = (
        response(5, output_noise=0.03, lost=lost)
        for lost in ((), [s + i for s in (20_000, 41_000) for i in range(many)])
    )
    assert cut.usable.sum() == whole.usable.sum()
    assert np.median(cut.variance / np.interp(cut.frequency_hz, whole.frequency_hz, whole.variance)) < 1.3
    ratio = np.abs(cut.value - truth(cut.frequency_hz)) ** 2 / cut.variance
    assert np.mean(ratio) == pytest.approx(1, abs=0.35)


@pytest.mark.parametrize("tone_hz", [10.0, 10.13, 120.0])
def test_lines_beside_a_tone_are_not_excited_by_it(tone_hz: float) -> None:
    """Side lobes of a window are coherent, and their ratio is the response at the tone."""
    found = response(6, output_noise=1e-7, tone_hz=tone_hz)
    assert any("windows spread from stronger lines" in text for text in found.unusable_because)
    away = found.usable & (np.abs(found.frequency_hz / tone_hz - 1) > 0.05)
    error = np.abs(found.value - truth(found.frequency_hz)) / found.standard_error
    assert away.sum() > 20
    assert error[away].max() < 5


def test_the_last_line_is_its_own_bins_alone() -> None:
    """A stated band ends at 100 Hz, the noise at 500 Hz: the response falls by a factor of 4 between."""
    found = response(8, output_noise=1e-4, stop_hz=100.0)
    assert found.frequency_hz[-1] < 100
    error = np.abs(found.value - truth(found.frequency_hz)) / np.abs(found.value)
    assert error[-1] < 0.02


def test_a_tone_alone_has_no_response() -> None:
    with pytest.raises(NotIdentifiableError, match="lines are usable"):
        response(7, output_noise=1e-7, tone_hz=77.0, beside_tone=0.0)
