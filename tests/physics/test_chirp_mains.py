"""Mains on both channels of a sweep: where nothing else excites a line, its ratio is no response."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.transform.respond import respond
from pipeline.transform.response import FrequencyResponse
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording
from tests.physics.rig_truth import recording, schroeder

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


def other_test(kind: str, mains: float, highest: float, on_input: float, on_output: float) -> tuple[Recording, float]:
    """Noise, a multisine, or a sweep of voltage on a spring of 0.3 with mains and two harmonics on both channels; and the gain."""
    rng = np.random.default_rng(1)
    about = {"frequency_start_hz": 1, "frequency_stop_hz": highest}
    if kind == "noise":
        spectrum = np.fft.rfft(rng.normal(size=60 * RATE))
        f = np.fft.rfftfreq(60 * RATE, 1 / RATE)
        x = 30 * np.fft.irfft(np.where((f < 1) | (f > highest), 0, spectrum))
        x, about = 0.5 * x / x.std(), {"protocol": "noise"}
    elif kind == "sphs":
        u = np.tile(schroeder(np.arange(1, int(highest) + 1), RATE), 12)
        x = np.concatenate([np.zeros(RATE // 2), 3.5 * (1 + u)])
        about |= {"protocol": "sphs", "loading": "electrical", "period_s": 1.0}
    else:
        t = np.arange(int(SWEEP_S * RATE)) / RATE
        rate = np.log(highest) / SWEEP_S
        rest = np.zeros(int(REST_S * RATE))
        x = np.concatenate([rest, 4 * np.sin(2 * np.pi * np.expm1(rate * t) / rate), rest])
        about |= {"protocol": "chirp", "loading": "electrical", "sweep": "log"}
    gain = 0.3 if kind == "noise" else 0.003
    force = gain * x if kind == "noise" else -gain * x**2
    turning = 2 * np.pi * mains * np.arange(x.size) / RATE
    hum = [sum(np.sin(n * turning + phase * n) / n for n in (1, 2, 3)) for phase in (0.3, 1.2)]
    given = "displacement" if kind == "noise" else "voltage"
    channels = {
        given: x + on_input * hum[0] + rng.normal(0, 1e-4, x.size),
        "force": 0.9 + force + on_output * hum[1] + rng.normal(0, 1e-3, x.size),
    }
    return recording(channels, RATE, **about), gain


@pytest.mark.parametrize("kind", ["noise", "sphs", "sweep of voltage"])
@pytest.mark.parametrize("mains", [50.0, 60.0])
@pytest.mark.parametrize("highest", [40.0, 200.0])
@pytest.mark.parametrize("hum", [(0.0, 0.05), (0.005, 0.05), (0.02, 0.2)])
def test_no_other_test_calls_mains_a_response(
    kind: str, mains: float, highest: float, hum: tuple[float, float]
) -> None:
    """Noise kept lines beyond its band that the mains alone excite; a multisine those that they fall on, 10 times too large."""
    made, gain = other_test(kind, mains, highest, *hum)
    (found,) = respond(made).responses
    good = found.usable
    off = np.abs(found.value[good] - gain)
    assert good.sum() >= 30
    assert np.all(off < np.maximum(6 * np.sqrt(found.variance[good]), 0.05 * gain)), found.frequency_hz[good][
        off.argmax()
    ]


@pytest.mark.parametrize("kind", ["noise", "sphs", "sweep of voltage"])
def test_mains_lines_stay_usable_where_there_is_no_hum(kind: str) -> None:
    made, _ = other_test(kind, 50.0, 200.0, 0.0, 0.0)
    (found,) = respond(made).responses
    near = np.abs(found.frequency_hz / 50 - 1) < 0.03
    assert found.usable[near].all()
