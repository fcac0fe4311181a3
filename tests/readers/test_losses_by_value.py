"""Samples that are lost by what they were are no damage, however few gaps they make; samples lost by chance are."""

from __future__ import annotations

import numpy as np
import pytest

from ingest.plausible import find_losses_by_value

TIME_S = np.arange(0, 4, 0.01)


def swing(hertz: float, noise: float = 0.0) -> np.ndarray:
    """A sinusoid of 1 with noise of that standard deviation."""
    return np.sin(2 * np.pi * hertz * TIME_S + 0.3) + noise * np.random.default_rng(25).standard_normal(TIME_S.size)


@pytest.mark.parametrize("hertz", [1.0, 1.5, 5.0])
@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_the_negative_half_of_few_or_many_periods_is_no_damage(hertz: float, noise: float) -> None:
    """Four periods in a whole record are four gaps."""
    values = swing(hertz, noise)
    assert find_losses_by_value(np.where(values < 0, np.nan, values)) == "the lowest"


@pytest.mark.parametrize("hertz", [1.0, 5.0])
def test_small_values_of_few_or_many_periods_are_no_damage(hertz: float) -> None:
    values = swing(hertz)
    assert find_losses_by_value(np.where(np.abs(values) < 0.2, np.nan, values)) == "the smallest"


@pytest.mark.parametrize("gaps", [3, 4, 6, 12])
def test_gaps_that_fall_by_chance_are_damage(gaps: int) -> None:
    rng = np.random.default_rng(gaps)
    for _ in range(300):
        values = swing(rng.uniform(0.5, 5), rng.choice([0.0, 0.01]))
        for first in rng.integers(0, TIME_S.size, gaps):
            values[first : first + int(rng.integers(1, 30))] = np.nan
        assert find_losses_by_value(values) == ""


def test_what_lies_beyond_a_range_is_damage() -> None:
    values = swing(1.0)
    assert find_losses_by_value(np.where(values > 0.7, np.nan, values)) == ""


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("noise", [0.0, 0.001])
def test_one_sign_lost_at_both_ends_only_is_no_damage(sign: int, noise: float) -> None:
    """A force that begins and ends on the other side of zero: no gap between samples that were kept."""
    values = np.sin(np.pi * (TIME_S / 3.2 - 0.125)) + noise * np.random.default_rng(3).standard_normal(TIME_S.size)
    lost = np.where(values < 0, np.nan, sign * values)
    assert np.isnan(lost[[0, -1]]).all()
    assert find_losses_by_value(lost) == ("the negative ones" if sign > 0 else "the positive ones")


def test_one_sign_lost_at_one_end_is_no_damage() -> None:
    values = np.cos(0.7 * np.pi * np.arange(4000) / 4000)
    assert find_losses_by_value(np.where(values < 0, np.nan, values)) == "the negative ones"


def test_samples_lost_at_rest_or_before_a_load_are_damage() -> None:
    """A sensor that was switched on late and off early, around a load that rests at zero, and one around a ramp."""
    rest = np.where((TIME_S > 1) & (TIME_S < 3), 0.7, 0.0)
    ramp = np.minimum(TIME_S, 4 - TIME_S)
    for values in (rest, ramp):
        values[:30] = values[-40:] = np.nan
        assert find_losses_by_value(values) == ""


@pytest.mark.parametrize(("decimals", "hertz"), [(1, 3.0), (1, 0.5), (2, 0.5)])
def test_lost_whole_numbers_are_no_damage(decimals: int, hertz: float) -> None:
    time_s = np.arange(0, 40, 0.01)
    noise = 0.02 * np.random.default_rng(25).standard_normal(time_s.size)
    values = np.round(5 * np.sin(2 * np.pi * hertz * time_s) + noise, decimals)
    assert find_losses_by_value(np.where(values == np.round(values), np.nan, values)) == "the whole numbers"
