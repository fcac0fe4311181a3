"""Staircases of strain: the responses to all ramps together, and films whose steps are not in proportion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.physics.film import Shape
from pipeline.physics.held_step import FurtherRamp, Hold, hold_stiffness, series_hold_stiffness, series_hold_values
from pipeline.transform.relaxation import RelaxationCurve, relaxation_curve
from schemas.arrays import Float
from tests.physics.rig_truth import recording

K0, ARMS = 0.05, ((0.03, 8.0), (0.02, 120.0))
HOLD_S, RAMP_S = 120.0, 20.0


def staircase(
    heights: tuple[float, ...], factors: tuple[float, ...] | None = None, *, seed: int = 0, thinned: bool = True
) -> RelaxationCurve:
    """The curve of a film that is ramped by `heights` mm one after the other; each adds its share times its factor."""
    period = HOLD_S + RAMP_S
    # As machines do it: a sample every 1.2 s while it moves, every 6 s while it holds.
    time = np.concatenate(
        [
            i * period + np.concatenate([np.arange(0, RAMP_S, 1.2), np.arange(RAMP_S + 3, period, 6.0)])
            for i in range(len(heights))
        ]
        if thinned
        else [np.arange(0, period * len(heights), 0.1)]
    )
    rng = np.random.default_rng(seed)
    x, force = np.zeros(time.size), np.zeros(time.size)
    for i, (height, factor) in enumerate(zip(heights, factors or (1.0,) * len(heights), strict=True)):
        since = time - i * period
        x += height * np.clip(since / RAMP_S, 0, 1)
        force += factor * K0 * height * np.clip(since / RAMP_S, 0, 1)
        for k, tau in ARMS:
            during = 1 - np.exp(-np.clip(since, 0, RAMP_S) / tau)
            force += factor * k * height / RAMP_S * tau * during * np.exp(-np.clip(since - RAMP_S, 0, None) / tau)
    made = recording(
        {
            "displacement": x + rng.normal(0, 2e-3, time.size),
            "force": force + rng.normal(0, 3e-4 * max(map(abs, heights)), time.size),
        },
        1.0,
        protocol="step",
    )
    ticks = made.start_ns + np.round(time * 1e9).astype(np.int64)
    channels = {quantity: replace(c, time_ns=ticks) for quantity, c in made.channels.items()}
    return relaxation_curve(replace(made, channels=channels))[0]


@pytest.mark.parametrize("heights", [(25.0, 25.0, 25.0, 25.0), (25.0, 50.0, -30.0, -45.0)], ids=["up", "up and down"])
def test_a_linear_film_is_found_from_all_steps(heights: tuple[float, ...]) -> None:
    """Holds as short as the memory of the film: the first one alone says little, and ramps hide half of the fast arm."""
    curve = staircase(heights)
    assert [ramp.step for ramp in curve.later] == pytest.approx(heights[1:], rel=2e-3)
    assert [ramp.ramp_s for ramp in curve.later] == pytest.approx([RAMP_S] * (len(heights) - 1), rel=0.02)
    fits = fit_specimen([], relaxations=[curve])
    assert fits.selected_order == 2
    found = fits.selected.estimates
    for name, truth in (("k0", K0), ("k1", 0.02), ("tau1", 120.0), ("k2", 0.03), ("tau2", 8.0)):
        assert found[name].value == pytest.approx(truth, rel=0.35 if name.endswith("2") else 0.05), name
        assert found[name].lower * 0.98 < truth < found[name].upper * 1.02, name
    assert not any("in proportion" in warning for warning in fits.warnings)


def test_steps_that_are_not_in_proportion_get_factors_of_their_own() -> None:
    """A film that softens with strain: the model is that of the first step, and what the others add is said."""
    fits = fit_specimen([], relaxations=[staircase((25.0,) * 4, (1.0, 0.8, 0.6, 0.5), thinned=False)])
    (said,) = (warning for warning in fits.warnings if "in proportion" in warning)
    told = [float(part.split(" ± ")[0]) for part in said.split("add ")[2].split(", ") if " ± " in part]
    assert told == pytest.approx([0.8, 0.6, 0.5], abs=0.02)
    assert fits.selected.model.k0 == pytest.approx(K0, rel=0.05)
    assert fits.selected.model.k == pytest.approx((0.02, 0.03), rel=0.05)
    assert fits.selected.model.tau == pytest.approx((120.0, 8.0), rel=0.05)
    assert fits.selected.reduced_chi2 < 1.5


def test_the_response_to_several_ramps_is_the_sum_of_theirs() -> None:
    """Rigid and behind a load cell that gives way, with slopes; values before a ramp know nothing of it."""
    shape = Shape(spring=True, arms=2, dashpot=False)
    theta = np.log([0.4, 1.0, 0.3, 0.1, 5.0])
    start, width = np.array([0.5, 2.0, 9.0, 10.5, 15.0, 40.0]), np.array([0.1, 1.0, 0.2, 1.0, 0.0, 5.0])
    further = (FurtherRamp(8.5, 0.3, 2.0), FurtherRamp(14.0, 0.0, -2.5))
    hold = Hold(start, width, 0.2, further)
    assert hold.level.tolist() == [1, 1, 3, 3, 0.5, 0.5]
    assert hold.since_last == pytest.approx([0.5, 2.0, 0.5, 2.0, 1.0, 26.0])

    def alone(ramp: FurtherRamp, cell: float | None) -> Float:
        kept = start >= ramp.delay
        one = Hold(start[kept] - ramp.delay, width[kept], ramp.duration)
        value = np.zeros(start.size)
        value[kept] = (
            hold_stiffness(theta, shape, one)[0] if cell is None else series_hold_stiffness(theta, shape, one, cell)[0]
        )
        return ramp.share * value

    for cell in (None, 2.5):
        total = sum(alone(ramp, cell) for ramp in (FurtherRamp(0.0, 0.2, 1.0), *further))

        def predicted(x: Float, cell: float | None = cell) -> Float:
            return hold_stiffness(x, shape, hold)[0] if cell is None else series_hold_stiffness(x, shape, hold, cell)[0]

        assert predicted(theta) == pytest.approx(total, rel=1e-10)
        slopes = (
            hold_stiffness(theta, shape, hold) if cell is None else series_hold_stiffness(theta, shape, hold, cell)
        )[1]
        for i in range(theta.size):
            step = 1e-6 * np.eye(theta.size)[i]
            numeric = (predicted(theta + step) - predicted(theta - step)) / 2e-6
            assert slopes[:, i] == pytest.approx(numeric, rel=1e-5, abs=1e-8)
    k = np.exp(theta)
    many = series_hold_values(k[:1], k[None, 1:3], k[None, 3:], 0.0, hold, 2.5)[0]
    assert many == pytest.approx(series_hold_stiffness(theta, shape, hold, 2.5)[0], rel=1e-10)
