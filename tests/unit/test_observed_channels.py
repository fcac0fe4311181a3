"""What is read off the samples of a recording before any model is asked."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.diagnose.features.observed import find_still_rest, find_stopped, find_unmoved, read_period, repeats_after


def multisine(period: int, count: int, seed: int = 1) -> np.ndarray:
    rng = np.random.default_rng(seed)
    place = np.arange(period * count)
    lines = np.arange(1, 40)
    phase = rng.uniform(0, 2 * np.pi, lines.size)
    return np.sin(2 * np.pi * lines * place[:, None] / period + phase).sum(axis=1)


def raised(period: int, count: int) -> np.ndarray:
    """A voltage whose square is a multisine, between rests."""
    wave = multisine(period, count)
    voltage = np.sqrt(wave - 1.05 * wave.min())
    return np.concatenate([np.zeros(700), voltage, np.zeros(300)]) + np.random.default_rng(2).normal(
        0, 1e-3, 1000 + wave.size
    )


@pytest.mark.parametrize("period", [2000, 2119, 16000])
def test_a_period_is_read_to_the_sample(period: int) -> None:
    assert read_period(raised(period, 4)) == period


def test_a_signal_whose_periods_differ_a_little_repeats_after_one_of_them() -> None:
    """Whatever repeats best later: what repeats after the period that is stated has that period."""
    voltage = raised(2000, 6)
    assert repeats_after(voltage, 2000)
    assert not repeats_after(voltage, 1000)
    assert not repeats_after(voltage, 20_000)


def test_noise_has_no_period() -> None:
    assert read_period(np.random.default_rng(3).normal(size=5000)) is None


def test_an_input_that_stops_in_the_middle_is_told_with_its_share() -> None:
    voltage = raised(2000, 4)
    voltage[3000:3900] = voltage[3000]
    assert find_stopped(voltage, "voltage")["held_share_voltage"] == pytest.approx(900 / voltage.size)


def test_an_input_lost_at_the_value_where_it_rests_is_told_by_an_output_that_goes_on() -> None:
    """A monitor that falls to zero between two cycles of the drive; a drive that pauses, and a film that rings on, are no loss."""
    rng = np.random.default_rng(8)
    rest, squared = np.zeros(1000), raised(2000, 6) ** 2
    force = np.concatenate([rest, squared]) + rng.normal(0, 0.01, 1000 + squared.size)
    lost = np.concatenate([rest, np.sqrt(squared)])
    lost[4000:6500] = 0.0
    assert find_stopped(lost, "voltage", force)["held_share_voltage"] == pytest.approx(2500 / lost.size, rel=0.01)
    ringing = force.copy()
    place = np.arange(2500)
    ringing[4000:6500] = np.exp(-place / 300) * np.cos(place / 5) + rng.normal(0, 0.01, 2500)
    assert not find_stopped(lost, "voltage", ringing)
    assert not find_stopped(lost, "voltage", rng.normal(0, 0.01, force.size))


def test_an_input_of_coarse_steps_has_not_stopped() -> None:
    place = np.arange(20000)
    assert not find_stopped(np.round(8 * np.sin(2 * np.pi * place / 5000)) / 8, "displacement")


def test_an_input_that_rests_at_an_offset_has_not_stopped() -> None:
    """Ramp to a pre-strain, hold, cycles about it to the end of the record; and a sweep that ends where it happens to be, and holds."""
    place = np.arange(20000)
    ramp = np.linspace(0.0, 1.0, 2000)
    about = np.concatenate([np.zeros(500), ramp, np.ones(4000), 1 + 0.2 * np.sin(2 * np.pi * place / 500)])
    wave = np.concatenate(
        [np.zeros(500), np.sin(2 * np.pi * place / 5125), np.full(4000, np.sin(2 * np.pi * 19999 / 5125))]
    )
    for moved in (about, wave):
        assert not find_stopped(np.round(moved * 1e4) / 1e4, "displacement")


def test_an_input_that_is_noise_where_motion_is_stated_stands_still() -> None:
    noise = np.random.default_rng(4).normal(0, 1e-3, 4000)
    values = {"stated_pp_mm": 1.0, "seen_pp_mm": float(np.ptp(noise))}
    assert find_unmoved(values, "pp_mm", noise, "displacement") == {"held_share_displacement": 1.0}


def test_a_motion_in_another_unit_does_not_stand_still() -> None:
    moved = 1e-3 * np.sin(2 * np.pi * np.arange(4000) / 50)
    values = {"stated_pp_mm": 1.0, "seen_pp_mm": float(np.ptp(moved))}
    assert not find_unmoved(values, "pp_mm", moved, "displacement")


def test_a_rest_without_noise_was_clipped_where_the_rest_of_the_record_has_some() -> None:
    """A converter too coarse for the noise, and the zeros that a recorder writes before it is triggered, are no flat top."""
    rng = np.random.default_rng(5)
    force = np.concatenate([np.full(200, 4.6), 6.0 + rng.normal(0, 0.01, 3000)]).round(3)
    assert find_still_rest(force).sum() == 200
    assert not find_still_rest(np.concatenate([np.zeros(200), force[200:]])).any()
    assert not find_still_rest(np.round(force / 0.05) * 0.05).any()
