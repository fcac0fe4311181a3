"""Systems and lone cycles whose output is rounded to steps far beyond its noise, or reset to zero at rest: the verdict is what it is without."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter

from pipeline.diagnose.single.cycle_diagnosis import estimate_noise_sd
from pipeline.diagnose.single.oscillator import SystemRecord
from pipeline.diagnose.single.still_outputs import bound_variance, find_moving
from pipeline.diagnose.single.system_parts import estimate_noise_sd as estimate_system_noise_sd
from tests.physics.test_cycle_causes import NOISE_KPA, cycle, diagnosed

Float = NDArray[np.float64]
STEPS = 12
"""Step of the converter over the standard deviation of the noise."""


def round_to(values: Float, step: float) -> Float:
    return np.round(values / step) * step


def put_rest_first(data: tuple[Float, Float, Float], stress: Float) -> tuple[Float, Float, Float]:
    time, stretch, own = data
    interval = time[1] - time[0]
    return (
        np.concatenate([np.arange(stress.size) * interval, stress.size * interval + time]),
        np.concatenate([np.ones(stress.size), stretch]),
        np.concatenate([stress, own]),
    )


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("branches", "verdict"), [(((30.0, 4.0),), "none"), (((30.0, 4.0), (60.0, 0.3)), "named")], ids=["none", "named"]
)
def test_a_cycle_keeps_its_verdict(branches: tuple[tuple[float, float], ...], verdict: str) -> None:
    """Rounded, one with a cause was right within a noise that was twice the rounding; reset at rest, one without had an unknown cause."""
    time, stretch, stress = data = cycle(branches)
    for altered in (
        data,
        (time, stretch, round_to(stress, STEPS * NOISE_KPA)),
        put_rest_first(data, np.zeros(80)),
    ):
        found, _ = diagnosed(altered)
        assert found.verdict == verdict
        assert found.mechanisms == (("missing_relaxation",) if verdict == "named" else ())


@pytest.mark.parametrize("make", [lambda v, s: v, lambda v, s: round_to(v, STEPS * s)], ids=["as it is", "rounded"])
def test_the_noise_of_a_system_is_that_of_its_rounding_and_of_no_rest(make: Callable[[Float, float], Float]) -> None:
    rng = np.random.default_rng(2)
    n, sd = 4000, 0.01
    u = lfilter([0.02], [1, -1.9, 0.92], rng.standard_normal(n))
    u = u / np.abs(u).max()
    record = SystemRecord("record", u, make(u + sd * rng.standard_normal(n), sd), 1e-3)
    still = replace(
        record,
        input=np.concatenate([np.zeros(3 * n), u]),
        output=np.concatenate([np.zeros(3 * n), record.output]),
    )
    expected = estimate_system_noise_sd([record])[0]
    assert estimate_system_noise_sd([still])[0] == pytest.approx(expected, rel=0.2)


def test_the_noise_of_a_cycle_is_that_of_its_rounding() -> None:
    """The median of what comes in whole steps is a whole step itself, or 0: a cycle in 6 steps of its converter had no noise at all."""
    rng = np.random.default_rng(1)
    course = 100 * np.sin(np.linspace(0, np.pi, 400)) ** 2
    noisy = course + 0.1 * rng.standard_normal(400)
    assert estimate_noise_sd(noisy) == pytest.approx(0.1, rel=0.2)
    for step in (0.1, 0.3, 1.2, 5.0):
        true = np.std(round_to(noisy, step) - course)
        assert true * 0.8 < estimate_noise_sd(round_to(noisy, step)) < true * 1.3, step
    assert estimate_noise_sd(round_to(noisy, 40.0)) == pytest.approx(20.0)
    reset = np.concatenate([np.zeros(900), noisy])
    assert estimate_noise_sd(reset) == pytest.approx(0.1, rel=0.2)


def test_what_stands_still_all_the_time_has_a_noise_that_numbers_resolve() -> None:
    assert find_moving(np.zeros(50)).all()
    assert bound_variance(np.ones(50), 0.0, 0.0) > 0
    assert bound_variance(np.arange(50.0), 0.0, -1e-9) > 0
