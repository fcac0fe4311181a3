"""Sweeps of voltage: force over the square of the measured voltage, against a film written out here."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.transform.respond import respond
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.protocols import PROTOCOLS
from schemas.recording import Channel, Recording

RATE, SECONDS, REST = 2000.0, 40.0, 2.0
LOW, HIGH = 1.0, 100.0
STATIC, LOST, TAU = 0.004, 0.5, 0.01
"""Drop of tension in N/kV², of which half comes later with 10 ms."""


def recording(*, bias_kv: float, swing_kv: float, noise_n: float, told: bool = True) -> Recording:
    """A logarithmic sweep of the voltage on a film with one relaxation, integrated exactly between fine steps."""
    fine = 16
    t = np.arange(0.0, SECONDS + 2 * REST, 1 / (RATE * fine))
    since = np.clip(t - REST, 0.0, SECONDS)
    rate = np.log(HIGH / LOW) / SECONDS
    phase = 2 * np.pi * LOW * np.expm1(rate * since) / rate
    on = (t >= REST) & (t < REST + SECONDS)
    v = np.where(on, bias_kv + swing_kv * np.sin(phase), bias_kv)
    square = v**2
    kept = np.exp(-1 / (RATE * fine * TAU))
    late = np.empty(t.size)
    late[0] = square[0]
    mean = (square[1:] + square[:-1]) / 2
    for i, driven in enumerate(mean * (1 - kept)):
        late[i + 1] = kept * late[i] + driven
    force = 1.0 - STATIC * (LOST * square + (1 - LOST) * late)
    rng = np.random.default_rng(14)
    v, force = v[::fine], force[::fine] + rng.normal(0, noise_n, t[::fine].size)
    ns = 1_772_370_300_000_000_000 + np.round(t[::fine] * 1e9).astype(np.int64)
    keys: dict[str, object] = {
        "recording_id": "e-1", "specimen_id": "S", "protocol": "chirp", "loading": "electrical",
        "started_at": "2026-03-01T14:05:00+01:00",
    }  # fmt: skip
    if told:
        keys |= {"frequency_start_hz": LOW, "frequency_stop_hz": HIGH, "sweep": "log"}
    channels = {"voltage": Channel("voltage", ns, v), "force": Channel("force", ns, force)}
    return Recording(RecordingMetadata.parse(keys), RigConstants(), channels)


@pytest.mark.long_after(2)
@pytest.mark.parametrize(
    ("bias", "swing", "told", "lowest", "highest"),
    [
        (0.0, 4.0, True, 2.6, 180.0),
        (2.5, 2.5, True, 1.5, 160.0),
        (5.0, 1.0, True, 1.5, 90.0),
        (0.0, 4.0, False, 4.0, 150.0),
    ],
)
def test_the_response_is_that_of_the_film(bias: float, swing: float, told: bool, lowest: float, highest: float) -> None:
    """Without a bias the square sweeps twice the frequency; with one, both."""
    (response,) = respond(recording(bias_kv=bias, swing_kv=swing, noise_n=2e-4, told=told)).responses
    assert (response.quantity, response.loading) == (FORCE_PER_VOLTAGE_SQUARED, "electrical")
    good = response.usable
    f = response.frequency_hz[good]
    truth = STATIC * (LOST + (1 - LOST) / (1 + 2j * np.pi * f * TAU))
    off = np.abs(response.value[good] - truth)
    assert f[0] < lowest
    assert f[-1] > highest
    assert np.median(off / np.abs(truth)) < 0.01
    assert np.mean(off**2 / response.variance[good]) < 3


def test_a_sweep_of_voltage_is_a_protocol() -> None:
    assert PROTOCOLS["chirp", "electrical"].required == (("voltage", "force"),)
