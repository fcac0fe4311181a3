"""Multisines whose period is no whole number of samples: the recorder's clock and the generator's are two."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.features.whole_periods import make_whole
from schemas.arrays import Float
from schemas.recording import Channel

RATE, PERIOD_S, LINES = 1000.0, 1.0, np.arange(1, 100, 2)
PHASES = np.pi * np.arange(LINES.size) ** 2 / LINES.size


def wave(time_s: Float, late_s: float = 0.0) -> Float:
    """A multisine after half a second of rest."""
    since = time_s[:, None] - 0.5 - late_s
    moved = np.cos(2 * np.pi * LINES / PERIOD_S * since + PHASES).sum(axis=1) / np.sqrt(LINES.size)
    return np.where(since[:, 0] >= 0, moved, 0.0)


def record(sampled_s: float, stamped_s: float) -> dict[str, Channel]:
    """Two channels sampled at one interval and stamped with another."""
    count = np.arange(8000)
    stamps = 1_700_000_000_000_000_000 + np.rint(1e9 * stamped_s * count).astype(np.int64)
    time_s = sampled_s * count
    return {
        "voltage": Channel("voltage", stamps, wave(time_s)),
        "force": Channel("force", stamps, wave(time_s, 0.002)),
    }


def test_a_clock_that_claims_other_times_has_as_many_samples_in_a_period() -> None:
    channels = record(1 / RATE, (1 - 9e-5) / RATE)
    found, period_s = make_whole(channels, "voltage", PERIOD_S)
    assert found["voltage"].values is channels["voltage"].values
    assert period_s == pytest.approx(PERIOD_S * (1 - 9e-5), rel=1e-9)


@pytest.mark.parametrize("samples", [1000.09, 999.6])
def test_two_clocks_are_brought_to_one_in_which_a_period_is_whole(samples: float) -> None:
    found, period_s = make_whole(record(PERIOD_S / samples, PERIOD_S / samples), "voltage", PERIOD_S)
    assert period_s == pytest.approx(PERIOD_S, rel=1e-6)
    time = found["force"].time_ns
    interval_s = float(time[-1] - time[0]) / (time.size - 1) * 1e-9
    assert period_s / interval_s == pytest.approx(round(samples), abs=1e-3)
    settled = slice(2000, 7900)
    seconds = (time - 1_700_000_000_000_000_000) * 1e-9
    assert found["force"].values[settled] == pytest.approx(wave(seconds, 0.002)[settled], abs=2e-3)


def test_what_is_whole_or_not_stated_stays_as_it_is() -> None:
    channels = record(1 / RATE, 1 / RATE)
    assert make_whole(channels, "voltage", PERIOD_S) == (channels, PERIOD_S)
    assert make_whole(channels, "voltage", None) == (channels, None)
