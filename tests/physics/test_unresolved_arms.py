"""Relaxations that are fitted alone: arms that the records resolve are found, those that they do not are told and left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.fit.relaxation.identify import fit_specimen
from pipeline.fit.relaxation.results import SpecimenFits
from pipeline.fit.relaxation.search import _fewer
from pipeline.physics.film import Shape
from pipeline.transform.relaxation import relaxation_curve
from schemas.arrays import Float
from tests.physics.rig_truth import recording

STEP, HOLD, K0 = 25.0, 600.0, 0.0805
SLOW = ((0.0178, 14.0), (0.0124, 170.0))


def fitted(arms: tuple[tuple[float, float], ...], ramp: float, time: Float, *, seed: int = 0) -> SpecimenFits:
    """Models of a record at `time` (s, the ramp begins at 0) of a film with `arms` (N/mm, s), ramped up and held."""
    rng = np.random.default_rng(seed)
    x = STEP * np.clip(time / ramp, 0, 1)
    force = K0 * x
    for k, tau in arms:
        during = 1 - np.exp(-np.clip(time, 0, ramp) / tau)
        force = force + k * STEP / ramp * tau * during * np.exp(-np.clip(time - ramp, 0, None) / tau)
    x, force = x + rng.normal(0, 2e-4, time.size), force + rng.normal(0, 1.2e-3, time.size)
    made = recording({"displacement": x, "force": force}, 100.0, protocol="step")
    ticks = made.start_ns + np.round(time * 1e9).astype(np.int64)
    channels = {quantity: replace(c, time_ns=ticks) for quantity, c in made.channels.items()}
    curve, _ = relaxation_curve(replace(made, channels=channels))
    return fit_specimen([], relaxations=[curve])


def even(interval: float) -> Float:
    return np.arange(0, HOLD, interval)


def thinning(ramp: float) -> Float:
    """Every 20 ms during the ramp, fewer and fewer samples while it is held: 200 in all."""
    return np.concatenate([np.arange(0, ramp, 0.02), ramp + np.geomspace(0.02, HOLD, 200)])


@pytest.mark.parametrize("ramp", [0.1, 0.3, 3.0, 20.0])
@pytest.mark.parametrize("sampling", ["even", "coarse", "thinning"])
def test_slow_arms_are_found_and_no_others(ramp: float, sampling: str) -> None:
    time = {"even": even(0.02), "coarse": even(0.5), "thinning": thinning(ramp)}[sampling]
    fits = fitted(SLOW, ramp, time)
    assert fits.selected_order == 2
    for name, truth in (("k0", K0), ("tau1", 170.0), ("tau2", 14.0), ("k1", 0.0124), ("k2", 0.0178)):
        found = fits.selected.estimates[name]
        assert found.value == pytest.approx(truth, rel=0.03)
        assert found.lower is not None
        assert found.upper is not None
        assert 0.98 * found.lower < truth < 1.02 * found.upper < 2 * truth


@pytest.mark.parametrize(("ramp", "fast"), [(0.1, (0.0312, 0.9)), (0.3, (0.0312, 0.9)), (0.5, (0.082, 0.35))])
def test_a_fast_arm_is_found_where_samples_thin_out_during_the_hold(ramp: float, fast: tuple[float, float]) -> None:
    """The interval of the clock at the ramp counts, not that of a hold of minutes: order 2 was chosen, with its arms bent."""
    fits = fitted((fast, *SLOW), ramp, thinning(ramp))
    assert fits.selected_order == 3
    assert fits.selected.model.k[2] == pytest.approx(fast[0], rel=0.1)
    assert fits.selected.model.tau[2] == pytest.approx(fast[1], rel=0.1)


@pytest.mark.long_after(2)
@pytest.mark.parametrize(
    ("ramp", "interval", "fast"),
    [(0.3, 0.02, (0.3, 0.03)), (3.0, 0.5, (0.3, 0.3)), (10.0, 0.5, (0.3, 1.0))],
)
def test_an_arm_that_the_ramp_hides_is_told_and_bends_no_other(
    ramp: float, interval: float, fast: tuple[float, float]
) -> None:
    """Its spring had no upper limit and came out as large as 10¹² N/mm; without it the other times were 10 to 20 % too short."""
    for seed in range(2):
        fits = fitted((fast, *SLOW), ramp, even(interval), seed=seed)
        assert fits.selected_order == 2
        assert any("order 3 is not taken" in warning for warning in fits.warnings)
        for name, truth in (("k0", K0), ("tau1", 170.0), ("tau2", 14.0)):
            found = fits.selected.estimates[name]
            assert found.lower is not None
            assert found.upper is not None
            assert found.lower < truth < found.upper < 1.5 * truth


@pytest.mark.parametrize(
    ("found", "order", "expected"),
    [(1, 1, ()), (0, 1, ("its one arm is not resolved",)), (0, 3, ("none of 3 arms resolved",)), (1, 2, ("only 1 of 2 arms resolved",))],
)  # fmt: skip
def test_arms_that_are_not_resolved_are_counted(found: int, order: int, expected: tuple[str, ...]) -> None:
    assert _fewer(Shape(found), order) == expected
