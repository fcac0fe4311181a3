"""The likelihood of a group of features: that of noise within the noise, and slow to condemn beyond it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.likelihood import Groups, Linearised, find_peak, score_groups

SIZE = st.integers(1, 200)
ROUND = st.floats(0.0, 1e4)


def one_group(size: int, rms: float) -> tuple[Groups, np.ndarray]:
    return Groups(np.zeros(size, dtype=np.int64), np.array([size])), np.full(size, rms)


@given(size=SIZE, rms=ROUND, more=st.floats(1.001, 100.0), trace=st.floats(0.0, 1e6), alone=st.booleans())
def test_more_left_is_less_likely_and_no_square_counts_more_than_in_the_noise(
    size: int, rms: float, more: float, trace: float, alone: bool
) -> None:
    groups, residual = one_group(size, rms)
    little, weight, odd = score_groups(groups, residual, np.array([trace]), noise_alone=alone)
    much, *_ = score_groups(groups, more * residual, np.array([trace]), noise_alone=alone)
    assert much <= little + 1e-9
    assert 0 < weight[0] <= 1 + 1e-12
    assert 0 <= odd[0] <= 1 + 1e-12
    assert not (alone and odd[0] > 0)


@given(size=SIZE, rms=st.floats(0.5, 100.0), trace=st.floats(0.0, 1e6))
def test_the_weight_is_the_slope(size: int, rms: float, trace: float) -> None:
    groups, residual = one_group(size, rms)
    modes = min(size, RULES.form.modes)
    if size * rms**2 < size - modes + 0.01:
        return
    step = 1e-5
    low, high = (
        score_groups(groups, residual * (1 + s), np.array([trace]), noise_alone=False)[0] for s in (-step, step)
    )
    _, weight, _ = score_groups(groups, residual, np.array([trace]), noise_alone=False)
    assert (high - low) / (2 * step) == pytest.approx(-float(residual @ residual) * weight[0], rel=1e-3, abs=1e-3)


def test_what_misses_a_group_a_thousandfold_says_hardly_more_than_what_misses_it_a_hundredfold() -> None:
    groups, residual = one_group(80, 1.0)
    scores = [
        score_groups(groups, scale * residual, np.zeros(1), noise_alone=False)[0] for scale in (1.0, 100.0, 1000.0)
    ]
    assert scores[0] - scores[1] > 15
    assert scores[1] - scores[2] < 0.5 * (scores[0] - scores[1])


def test_a_form_error_in_proportion_to_the_effect_is_forgiven() -> None:
    """Left over by a tenth of what the hypothesis changes there, against the same without any change of its own."""
    groups, residual = one_group(80, 5.0)
    with_effect, *_ = score_groups(groups, residual, np.array([50.0**2]), noise_alone=False)
    without, *_ = score_groups(groups, residual, np.zeros(1), noise_alone=False)
    assert with_effect > without + 2


def test_a_test_that_is_twice_as_noisy_as_its_rests_is_noise_and_one_that_is_far_off_is_not() -> None:
    """Of a long group: no few modes hold so much."""
    groups, residual = one_group(800, 1.0)
    quiet, loud, far = (score_groups(groups, s * residual, np.zeros(1), noise_alone=True)[0] for s in (1.0, 2.0, 100.0))
    anything = score_groups(groups, 100.0 * residual, np.zeros(1), noise_alone=False)[0]
    assert loud > quiet - 800 * np.log(2) - 10
    assert anything > far + 1e3


@given(rms=st.lists(st.floats(0.9, 20.0), min_size=2, max_size=12))
def test_the_weight_of_each_group_is_the_slope_over_its_squares(rms: list[float]) -> None:
    """What kind of session it is follows from all groups together."""
    size = 30
    number = np.repeat(np.arange(len(rms)), size)
    groups = Groups(number, np.bincount(number))
    residual = np.repeat(rms, size)

    def score(changed: np.ndarray) -> float:
        return score_groups(groups, changed, np.zeros(len(rms)), noise_alone=False)[0]

    _, weight, _ = score_groups(groups, residual, np.zeros(len(rms)), noise_alone=False)
    for own in range(len(rms)):
        low, high = (score(np.where(number == own, residual * (1 + s), residual)) for s in (-1e-5, 1e-5))
        assert (high - low) / 2e-5 == pytest.approx(-size * rms[own] ** 2 * weight[own], rel=1e-3, abs=1e-3)


def test_where_many_groups_drift_another_is_no_surprise() -> None:
    """A session drifts as no rest shows or it does not: the tenth group that drifts says less than the first one."""
    count, size = 10, 20
    number = np.repeat(np.arange(count), size)
    groups = Groups(number, np.bincount(number), kind=("step.force",) * count)

    def score(drifting: int) -> float:
        squares = np.where(np.arange(count) < drifting, size + 60.0, size)
        return score_groups(groups, np.sqrt(squares / size)[number], np.zeros(count), noise_alone=True)[0]

    assert score(0) - score(1) > score(count - 1) - score(count) + 1


def test_the_peak_leaves_a_wrong_group_aside() -> None:
    """One constant, measured in three groups of which one is far off."""
    rng = np.random.default_rng(seed=5)
    number = np.repeat(np.arange(3), 40)
    data = 3.0 + rng.normal(size=120) + np.where(number == 2, 500.0, 0.0)
    about = Linearised(data - 3.4, -np.ones((120, 1)), np.zeros(0), np.zeros((0, 1)))
    peak = find_peak(Groups(number, np.bincount(number)), about, np.zeros(3), 0, noise_alone=False)
    assert 3.4 + peak.step[0] == pytest.approx(3.0, abs=0.5)
    assert peak.weight[-1] < 0.01 < 0.9 < peak.weight[0]
    assert peak.odd[2] > 0.99 > 0.05 > peak.odd[0]


def test_what_the_best_hypothesis_leaves_is_the_noise_that_others_are_measured_against() -> None:
    """A thousand values with noise 5 % quieter than its rest: to miss them by the noise of the rest is a misfit of 90."""
    number, size = np.zeros(1000, dtype=np.int64), np.array([1000])
    best, other = np.full(1000, 0.95), np.full(1000, 1.0)
    alike, apart = (
        score_groups(groups, best, np.zeros(1), noise_alone=False)[0]
        - score_groups(groups, other, np.zeros(1), noise_alone=False)[0]
        for groups in (Groups(number, size), Groups(number, size, np.array([float(best @ best)])))
    )
    assert alike < 4
    assert apart > 10


def test_a_calibration_holds_nothing_that_nobody_has_thought_of() -> None:
    film, weight = (
        Groups(np.zeros(1, dtype=np.int64), np.array([1]), kind=(kind,)) for kind in ("step.force", "weight.gain")
    )
    residual = np.array([44.0])
    forgiven, _, (odd,) = score_groups(film, residual, np.zeros(1), noise_alone=False)
    condemned, _, (never,) = score_groups(weight, residual, np.zeros(1), noise_alone=False)
    assert forgiven > -15
    assert condemned < -80
    assert odd > 0.5 > 1e-6 > never
