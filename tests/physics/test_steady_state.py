"""What follows a periodic target with two time constants is in steady state: a period ends where it began."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.mechanisms.actuation import follow_in_steady_state
from pipeline.diagnose.search.extended_model import Chosen, compose_chosen
from pipeline.diagnose.simulation.effects import Scale, Wave
from schemas.arrays import Float

INTERVAL_S = 1e-3
SECONDS = st.floats(1e-4, 30.0)


def make_target(seed: int, samples: int) -> Float:
    """Two states (2, W) of a squared voltage above an onset."""
    phase = np.arange(samples) / samples
    shift = np.random.default_rng(seed).uniform(0, 2 * np.pi, size=(2, 1))
    wave = np.cos(2 * np.pi * phase + shift) + 0.7 * np.cos(2 * np.pi * 5 * phase - 2 * shift)
    return np.asarray(np.maximum(wave**2 - 0.4, 0.0))


def follow_sample_by_sample(target: Float, rise_s: float, fall_s: float, periods: int) -> Float:
    """The same by small steps in time, over many periods from the mean."""
    rates = INTERVAL_S / np.array([rise_s, fall_s])
    level = target.mean(axis=1)
    trail = np.empty_like(target)
    for _ in range(periods):
        for i, now in enumerate(target.T):
            share = -np.expm1(-np.where(now > level, rates[0], rates[1]))
            level = level + share * (now - level)
            trail[:, i] = level
    return trail


@pytest.mark.parametrize(("rise_s", "fall_s"), [(0.16, 1.4), (0.5, 0.5), (0.3, 0.05)])
def test_it_is_what_many_periods_come_to(rise_s: float, fall_s: float) -> None:
    target = make_target(1, 640)
    found = follow_in_steady_state(target, INTERVAL_S, rise_s, fall_s)
    expected = follow_sample_by_sample(target, rise_s, fall_s, periods=12)
    assert found == pytest.approx(expected, abs=0.02 * target.max())


@given(st.integers(0, 10_000), SECONDS, SECONDS)
def test_it_stays_within_the_target_and_shifts_with_it(seed: int, rise_s: float, fall_s: float) -> None:
    target = make_target(seed, 640)
    once = follow_in_steady_state(target, INTERVAL_S, rise_s, fall_s)
    assert (once >= target.min(axis=1, keepdims=True) - 1e-9).all()
    assert (once <= target.max(axis=1, keepdims=True) + 1e-9).all()
    shifted = np.roll(target, 10, axis=1)  # a whole number of cells
    assert follow_in_steady_state(shifted, INTERVAL_S, rise_s, fall_s) == pytest.approx(
        np.roll(once, 10, axis=1), abs=1e-6
    )


def test_a_target_at_rest_is_its_level() -> None:
    target = np.full((1, 640), 2.5)
    assert follow_in_steady_state(target, INTERVAL_S, 0.2, 3.0) == pytest.approx(target, rel=1e-9)


def test_wrinkles_that_stay_lower_the_slope_of_what_acts_and_hold_a_part_of_it() -> None:
    """A share w of the area is at the onset whatever the voltage does, the rest follows: V² − w (V² − Vc²)."""
    kv = np.sqrt(make_target(3, 640))
    wave = Wave(kv, kv**2, INTERVAL_S, Scale(0.0, float(kv.max()), 0.0, 1.0, 10.0))
    values = {"overload": 0.2, "growth": 0.5, "recovery_s": 1e4, "rise_s": 1e-4, "kept": 1.0}
    found = compose_chosen((Chosen("wrinkling", "of_area"),), (values,)).squared[0](wave).squared
    slope, level = np.polyfit((kv**2).ravel(), found.ravel(), 1)
    assert slope == pytest.approx(0.5, abs=0.01)
    assert level == pytest.approx(0.5 * (kv.max() / 1.2) ** 2, rel=0.02)
