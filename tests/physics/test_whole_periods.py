"""Periods of multisines: no whole number of samples in one, for the clocks of recorder and generator are two, and too few of them."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.features.whole_periods import make_whole
from pipeline.simulate.campaign import read_campaign, simulate_one
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.recording import Channel, Recording

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


def multisine(periods: int) -> Recording:
    """A film under a multisine of so many periods of a second."""
    rig = {"clamp_mass_kg": 0.05, "load_cell_stiffness_n_per_mm": 20.0, "damping_ratio": 0.05, "load_cell_range_n": 2.0}
    sizes = {"film_length_mm": 50.0, "film_width_mm": 50.0, "film_thickness_mm": 0.5, "stretch_1": 1.3}
    electrode = {"active_length_mm": 40.0, "active_width_mm": 40.0}
    film = {"k0_n_per_mm": 0.3, "relative_permittivity": 2.8}
    test = {"test": "sphs", "drive_kv": 4.0, "lines": "full", "frequency_stop_hz": 20.0, "sample_rate_hz": 1000.0}
    table = {
        "name": "few",
        "seed": 1,
        "started_at": "2026-03-02T09:00:00+01:00",
        "rigs": {"bench": rig},
        "materials": {"film": film},
        "specimens": {"F-1": {"rig": "bench", "material": "film", "geometry": sizes | electrode}},
        "recordings": [{**test, "specimens": ["F-1"], "periods": periods}],
    }
    campaign = read_campaign(table)
    return simulate_one(campaign, campaign.planned[0]).recording


def test_a_record_that_ends_within_its_second_period_is_refused_with_its_number() -> None:
    """It began with a period before the onset, which is none, and ended in an error of numpy."""
    with pytest.raises(NotIdentifiableError, match="1 settled period"):
        reduce(multisine(2))
    assert reduce(multisine(4)).blocks
