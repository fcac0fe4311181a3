"""What load-unload cycles take, against closed forms of linear films and areas known by construction."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.analyse.cycle import cycle_loops
from pipeline.analyse.recording import analyse_recording
from pipeline.transform.loops import find_loops, measure_modulus
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata
from tests.helpers.sensing_truth import recording

RATE, SPEED, HALF = 50.0, 3.0, 6.0
PERIOD = 4 * HALF / SPEED


def triangles(count: int, start: float) -> tuple[np.ndarray, np.ndarray]:
    """Times, and a ramp from 0 to the middle, a hold of 120 s, so many triangles round it and a hold."""
    corners_x = [0.0, start, start, *[start + HALF, start - HALF] * count, start, start]
    times = [0.0, start / 5, start / 5 + 120]
    times.append(times[-1] + HALF / SPEED)
    times += [times[-1] + 2 * HALF / SPEED * (i + 1) for i in range(2 * count - 1)]
    times += [times[-1] + HALF / SPEED, times[-1] + HALF / SPEED + 3]
    t = np.arange(0, times[-1], 1 / RATE)
    return t, np.interp(t, times, corners_x)


def maxwell(t: np.ndarray, x: np.ndarray, stiffness: float, tau: float) -> np.ndarray:
    """Force of a spring and a dashpot in line under straight movements between the samples, exactly."""
    left = np.exp(-np.diff(t) / tau)
    force = np.zeros(t.size)
    for i in range(1, t.size):
        force[i] = force[i - 1] * left[i - 1] + stiffness * (x[i] - x[i - 1]) / (t[i] - t[i - 1]) * tau * (
            1 - left[i - 1]
        )
    return force


def steady_loss(stiffness: float, tau: float) -> float:
    """Loss of one arm in a steady triangle, in closed form: 2 A 2 k τ v (1 − (4 τ/T) tanh(T/4τ))."""
    return 4 * HALF * stiffness * tau * SPEED * (1 - 4 * tau / PERIOD * np.tanh(PERIOD / (4 * tau)))


def test_the_steady_loss_of_a_linear_film_is_that_of_the_closed_form() -> None:
    """A slow arm still relaxes under the mean: its drift adds 5 % to the area of each cycle, and is none of the loss."""
    t, x = triangles(10, 20.0)
    film = 0.025 * x + maxwell(t, x, 0.030, 4.0) + maxwell(t, x, 0.015, 150.0)
    noise = np.random.default_rng(35).normal(0, 0.0016, t.size)
    found = find_loops(t, x, film + noise + 0.003)
    expected = steady_loss(0.030, 4.0) + steady_loss(0.015, 150.0)
    assert expected == pytest.approx(0.6642, abs=2e-4)
    assert len(found) == 9
    steady = [loop.steady_loss for loop in found[2:]]
    assert np.mean(steady) == pytest.approx(expected, rel=0.006)
    assert np.mean([loop.loss for loop in found[2:]]) > 1.03 * expected
    assert [loop.low for loop in found] == pytest.approx([14.0] * 9, abs=0.1)
    assert found[4].secant == pytest.approx(0.068, abs=0.001)
    assert found[0].loss_share == pytest.approx(0.087, abs=0.004)


def test_one_cycle_from_rest_to_rest_is_taken_as_it_is() -> None:
    x = np.concatenate([np.zeros(40), np.linspace(0, 10, 500), np.linspace(10, 0, 500)[1:], np.zeros(40)])
    t = np.arange(x.size) / RATE
    up = np.arange(x.size) < 540
    (loop,) = find_loops(t, x, np.where(up, 2.0, 1.0) * x)
    assert loop.loss == pytest.approx(50.0, rel=0.01)
    assert loop.work == pytest.approx(100.0, rel=0.01)
    assert loop.steady_loss is None
    assert (loop.least, loop.most) == (0.0, 20.0)


def test_growing_cycles_are_each_one() -> None:
    x = np.concatenate([np.interp(np.arange(400), [0, 200, 400], [0, top, 0]) for top in (2, 4, 8)])
    found = find_loops(np.arange(x.size) / RATE, x, x**2)
    assert [round(loop.high, 6) for loop in found] == [2.0, 4.0, 8.0]
    assert [loop.loss for loop in found] == pytest.approx([0, 0, 0], abs=1e-9)


@pytest.mark.parametrize("x", [np.linspace(0, 5, 200), np.zeros(50), np.empty(0), np.minimum(np.arange(200), 100.0)])
def test_what_does_not_come_back_is_no_cycle(x: np.ndarray) -> None:
    with pytest.raises(NotIdentifiableError, match="come back"):
        find_loops(np.arange(x.size) / RATE, x, x)


def test_an_approach_and_a_last_way_home_are_no_cycles() -> None:
    t, x = triangles(1, 20.0)
    with pytest.raises(NotIdentifiableError):
        find_loops(t, x, x)


def test_cycles_that_end_elsewhere_than_they_began_are_counted() -> None:
    """From the unloaded film to 20, then between 4 and 20: the first has no loss of its own."""
    corners = [0.0, 20.0, 4.0, 20.0, 4.0, 20.0, 4.0]
    t = np.arange(0, 60, 0.02)
    x = np.interp(t, np.linspace(0, 60, len(corners)), corners)
    found = find_loops(t, x, 0.1 * x + 0.05 * np.sign(np.gradient(x)))
    assert [loop.unclosed for loop in found] == [1, 1]
    whole = find_loops(t, np.interp(t, np.linspace(0, 60, 7), [0.0, 20, 0, 20, 0, 20, 0]), 0.1 * x)
    assert [loop.unclosed for loop in whole] == [0, 0, 0]


def test_the_modulus_of_the_start_is_the_slope_from_2_to_10_percent() -> None:
    t = np.arange(0, 40, 0.05)
    stretch = 1 + np.interp(t, [0, 10, 20, 30, 40], [0, 1, 0, 1, 0])
    stress = 900 * (stretch - 1) - 400 * (stretch - 1) ** 2
    first, second = find_loops(t, stretch, stress)
    known = (stretch >= 1.02) & (stretch <= 1.1) & (t <= 10)
    expected = np.cov(stretch[known], stress[known])[0, 1] / np.var(stretch[known], ddof=1)
    assert measure_modulus(stretch, stress, first) == pytest.approx(expected, rel=1e-9)
    assert measure_modulus(stretch, stress, second) == pytest.approx(expected, rel=1e-2)
    # under a pre-stretch the loading does not pass there
    assert measure_modulus(stretch + 0.4, stress, first) is None


def test_forces_and_stresses_of_a_machine_that_gives_both_are_both_told() -> None:
    """The force was there, and only the stress was told."""
    t = np.arange(0, 20, 0.05)
    x = np.interp(t, [0, 10, 20], [0, 50, 0])
    force = 0.04 * x + 0.1 * np.sin(np.pi * t / 10)
    about = RecordingMetadata(
        recording_id="a1", started_at=datetime(2026, 3, 2, 9, tzinfo=UTC), specimen_id="a", protocol="cycle",
        loading="mechanical", film_length_mm=50.0, film_width_mm=20.0, film_thickness_mm=0.5,
    )  # fmt: skip
    both = {"displacement": x, "force": force, "stretch": 1 + x / 50, "stress": 100 * force}
    (told,) = cycle_loops(recording(about, t, **both)).to_pylist()
    (alone,) = cycle_loops(recording(about, t, displacement=x, force=force)).to_pylist()
    assert told["force_high_n"] == pytest.approx(force.max())
    assert told["stress_high_kpa"] == pytest.approx(100 * force.max())
    assert told["loss_mj"] == pytest.approx(abs(np.trapezoid(force, x)), rel=1e-3)
    assert told["loss_kj_per_m3"] == pytest.approx(told["loss_mj"] * 1000 / (50 * 20 * 0.5), rel=1e-6)
    for name, value in told.items():
        assert alone[name] == (pytest.approx(value) if isinstance(value, float) else value), name


def test_a_displacement_that_stands_still_beside_a_stretch_takes_nothing_from_it() -> None:
    """The cycles were looked for again in each pair, and a sensor that is not connected lost all of them."""
    t = np.arange(0, 20, 0.05)
    stretch = 1 + np.interp(t, [0, 10, 20], [0, 1, 0])
    about = RecordingMetadata(
        recording_id="a1", started_at=datetime(2026, 3, 2, 9, tzinfo=UTC), specimen_id="a", protocol="cycle", loading="mechanical",
    )  # fmt: skip
    stress = 90 * (stretch - 1) + 10 * np.sin(np.pi * t / 10)
    given = {"stretch": stretch, "stress": stress, "displacement": np.zeros(t.size), "force": 1e-3 * stress}
    (told,) = cycle_loops(recording(about, t, **given)).to_pylist()
    (alone,) = cycle_loops(recording(about, t, stretch=stretch, stress=stress)).to_pylist()
    assert told["loss_kj_per_m3"] == pytest.approx(alone["loss_kj_per_m3"])
    assert told["loss_kj_per_m3"] > 0
    assert told["secant_n_per_mm"] is None


@given(seed=st.integers(0, 1000), step=st.floats(1e-4, 0.01))
def test_a_turn_that_a_converter_reaches_in_several_steps_is_one_turn(seed: int, step: float) -> None:
    """Of ten slow cycles two to seven were told. (A rest that moves by more than `STILL` of the range is none.)"""
    t = np.arange(0, 102, 0.02)
    x = np.where((t > 1) & (t < 101), 1 - np.cos(2 * np.pi * 0.1 * (t - 1)), 0.0)
    read = np.round((x + np.random.default_rng(seed).normal(0, 0.5 * step, t.size)) / step) * step
    loops = find_loops(t, read, 0.4 * read)
    assert len(loops) == 10
    assert sum(loop.unclosed for loop in loops) == 0


def test_sinusoids_take_what_the_loss_modulus_says() -> None:
    """A sinusoid that a testing machine records as cycles had a complex stiffness, and no loss of a cycle."""
    t = np.arange(0, 42, 0.01)
    phase = 2 * np.pi * 0.5 * (t - 1)
    on = (t >= 1) & (t <= 41)
    x = np.where(on, 2.0 - 2.0 * np.cos(phase), 0.0)
    force = np.where(on, 0.05 * x + 2.0 * 0.012 * np.sin(phase), 0.0)
    about = RecordingMetadata(
        recording_id="a1", started_at=datetime(2026, 3, 2, 9, tzinfo=UTC), specimen_id="a", protocol="cyclic", loading="mechanical",
        frequency_hz=0.5,
    )  # fmt: skip
    (table,) = analyse_recording(recording(about, t, displacement=x, force=force)).tables["cycle_loops"]
    loops = table.to_pylist()
    assert len(loops) == 20
    middle = [row["steady_loss_mj"] for row in loops[2:-2]]
    assert middle == pytest.approx([np.pi * 0.012 * 2.0**2] * len(middle), rel=2e-3)
