"""What is read off a recording's samples to be compared with its metadata."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from pipeline.diagnose.features.observed import FREQUENCY, HELD, SEEN, observe_channels
from pipeline.diagnose.features.reduce import reduce
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording
from tests.helpers.everyday_faults import lose

STOP_HZ, RATE_HZ, SWEEP_S, REST_S = 100.0, 1000.0, 20.0, 1.0


def sweep(exponent: float, noise: float) -> Recording:
    """A logarithmic sweep from 1 to 100 Hz whose amplitude, 1 mm at first, follows frequency^exponent, between two rests."""
    time = np.arange(0.0, SWEEP_S + 2 * REST_S, 1 / RATE_HZ)
    since = np.clip(time - REST_S, 0.0, SWEEP_S)
    frequency = STOP_HZ ** (since / SWEEP_S)
    phase = 2 * np.pi * SWEEP_S / np.log(STOP_HZ) * (frequency - 1)
    fade = np.clip(since / 0.5, 0.0, 1.0) * np.clip((SWEEP_S - since) / 0.05, 0.0, 1.0)
    given = frequency**exponent * fade * np.sin(phase)
    rng = np.random.default_rng(1)
    stamps = np.rint(time * 1e9).astype(np.int64)
    made = {
        quantity: Channel(quantity, stamps, given + rng.normal(0.0, noise, given.size))
        for quantity in ("displacement", "force")
    }
    metadata = RecordingMetadata.parse({
        "recording_id": "R-1", "specimen_id": "S-1", "protocol": "chirp", "loading": "mechanical",
        "started_at": datetime(2026, 1, 1, tzinfo=UTC).isoformat(), "frequency_start_hz": "1", "frequency_stop_hz": "100",
        "total_length_mm": "50",
    })  # fmt: skip
    return Recording(metadata=metadata, rig=RigConstants(), channels=made)


@pytest.mark.parametrize("exponent", [0.3, 0.0, -0.3, -1.0])
def test_the_end_of_a_sweep_is_read_however_its_amplitude_goes(exponent: float) -> None:
    """Shakers and motors follow fast sweeps with less and less; that is no other sample rate."""
    seen = observe_channels(sweep(exponent, 2e-4))[SEEN + FREQUENCY]
    assert seen == pytest.approx(STOP_HZ, rel=0.03)


def test_a_sweep_that_ends_in_the_noise_has_no_highest_frequency() -> None:
    assert SEEN + FREQUENCY not in observe_channels(sweep(-1.5, 2e-3))


@pytest.mark.parametrize("given", [np.zeros(4000), np.r_[np.zeros(2000), np.nan, np.ones(1999)], np.full(4000, np.nan)])
def test_an_input_that_does_not_swing_has_none_either(given: np.ndarray) -> None:
    recording = sweep(0.0, 0.0)
    channel = recording.channels["displacement"]
    still = replace(channel, time_ns=channel.time_ns[:4000], values=given)
    force = replace(recording.channels["force"], time_ns=channel.time_ns[:4000], values=np.zeros(4000))
    seen = observe_channels(replace(recording, channels={"displacement": still, "force": force}))
    assert SEEN + FREQUENCY not in seen


def test_a_channel_that_is_lost_while_it_rests_is_dead_and_has_no_highest_frequency() -> None:
    """Its stretch without noise made the noise of the rest pass for the fastest swings of the sweep: a sample rate 4 times wrong."""
    recording = sweep(0.0, 2e-4)
    given = recording.channels["displacement"]
    step = 1e-4
    coarse = np.round(given.values / step) * step
    first = int((REST_S + 0.98 * SWEEP_S) * RATE_HZ)
    lost = np.where((np.arange(coarse.size) >= first) & (np.arange(coarse.size) < first + 900), 0.0, coarse)
    observed = observe_channels(
        replace(recording, channels={**recording.channels, "displacement": replace(given, values=lost)})
    )
    assert observed[HELD + "displacement"] == pytest.approx(900 / lost.size, rel=0.01)
    assert observed.get(SEEN + FREQUENCY, STOP_HZ) < 1.1 * STOP_HZ


def test_a_machine_that_resets_its_reading_at_rest_has_lost_nothing() -> None:
    recording = sweep(0.0, 2e-4)
    given = recording.channels["displacement"]
    moving = np.abs(np.arange(given.values.size) / RATE_HZ - REST_S - SWEEP_S / 2) < SWEEP_S / 2
    reset = replace(given, values=np.where(moving, given.values, 0.0))
    observed = observe_channels(replace(recording, channels={**recording.channels, "displacement": reset}))
    assert HELD + "displacement" not in observed


@pytest.mark.parametrize(("first", "stop"), [(0.4, 0.5), (0.0, 0.2), (0.85, 1.0)])
@pytest.mark.parametrize("quantity", ["force", "displacement"])
def test_what_one_channel_loses_while_the_other_goes_on_is_its_own(quantity: str, first: float, stop: float) -> None:
    """Lost samples were left out of all that follows, and nobody was told whose they were."""
    found = observe_channels(lose(sweep(0.0, 2e-4), quantity, first, stop))
    held = {name: share for name, share in found.items() if name.startswith(HELD)}
    assert held == {HELD + quantity: pytest.approx(stop - first, abs=0.002)}


@pytest.mark.parametrize("quantity", ["force", "displacement"])
@pytest.mark.parametrize("at_end", [False, True])
def test_a_logger_that_is_started_later_or_stopped_earlier_at_rest_has_lost_nothing(
    quantity: str, at_end: bool
) -> None:
    """Loggers are started one after the other: a tenth of the record without one of them was a dead channel."""
    whole = sweep(0.0, 2e-4)
    rest = 0.9 * REST_S / (whole.channels["force"].time_ns[-1] * 1e-9)
    first, stop = (1 - rest, 1.0) if at_end else (0.0, rest)
    found = observe_channels(lose(whole, quantity, first, stop))
    assert not any(name.startswith(HELD) for name in found)


def test_what_both_lose_is_no_channels_and_a_slower_clock_loses_nothing() -> None:
    whole = sweep(0.0, 2e-4)
    both = lose(lose(whole, "force", 0.4, 0.5), "displacement", 0.4, 0.5)
    force = whole.channels["force"]
    thinned = replace(force, time_ns=force.time_ns[::40], values=force.values[::40])
    slow = replace(whole, channels={**whole.channels, "force": thinned})
    for recording in (whole, both, slow):
        assert not any(name.startswith(HELD) for name in observe_channels(recording))


def test_only_a_loss_that_is_a_fault_stands_in_for_the_features() -> None:
    """Else the reason why there are none would be told to nobody."""
    whole = sweep(0.0, 2e-4)
    assert reduce(lose(whole, "force", 0.4, 0.55)).blocks == ()
    with pytest.raises(NotIdentifiableError):
        reduce(lose(whole, "force", 0.5, 0.505))
