"""Tap and weights: against an integrated oscillator and exact levels, and what they do to the rig's constants."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from pipeline.analyse.recording import calibration_table
from pipeline.physics.rig import RigPrior
from pipeline.transform.calibration import TapCalibration, calibrate, sharpen
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from tests.physics.rig_truth import Truth, recording

RATE = 2000.0
TRUTH = Truth(load_cell=20.0, clamp_alone_hz=52.0, damping_ratio=0.005)
GRAVITY = 9.80665


@pytest.fixture(scope="module")
def ringing() -> np.ndarray:
    """Force of the clamp after three half-sine blows of 4 ms, integrated."""
    time = np.arange(round(10 * RATE)) / RATE
    mass, stiffness, damping = TRUTH.mass, TRUTH.load_cell, TRUTH.damping
    out, state, begin = np.zeros(time.size), [0.0, 0.0], 0.0
    for blow in (1.0, 4.0, 7.0):
        for stop, peak in ((blow, 0.0), (blow + 4e-3, 1.0), (blow + 3.0, 0.0)):
            if stop <= begin:
                continue

            def rates(t, y, blow=blow, peak=peak):
                push = peak * np.sin(np.pi * (t - blow) / 4e-3)
                return [y[1], (push - stiffness * y[0] - damping * y[1]) / mass]

            at = time[(time >= begin - 1e-12) & (time < stop - 1e-12)]
            solved = solve_ivp(
                rates, (begin, stop), state, t_eval=np.append(at, stop), method="DOP853", rtol=1e-9, atol=1e-12
            )
            out[np.searchsorted(time, at)] = stiffness * solved.y[0, :-1]
            state, begin = solved.y[:, -1].tolist(), stop
    return out


def tapped(force: np.ndarray, seed: int = 0, sd: float = 1e-3, **more):
    noisy = force + np.random.default_rng(seed).normal(0, sd, force.size)
    return recording({"force": 0.2 + noisy}, RATE, protocol="tap", loading="calibration", **more)


@pytest.mark.long
@pytest.mark.slow
def test_frequency_and_damping_with_their_errors(ringing) -> None:
    scores = []
    for seed in range(12):
        found = calibrate(tapped(ringing, seed))
        assert isinstance(found, TapCalibration)
        scores.append(
            [
                (found.frequency_hz - 52.0) / found.frequency_sd,
                (found.damping_ratio - 0.005) / found.damping_ratio_sd,
            ]
        )
    assert found.taps == 3
    assert found.frequency_hz == pytest.approx(52.0, rel=1e-5)
    assert found.damping_ratio == pytest.approx(0.005, rel=1e-3)
    assert np.sqrt(np.mean(np.square(scores))) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("size", [0.3, 0.03])
def test_weak_taps_give_wide_intervals(ringing, size) -> None:
    found = calibrate(tapped(size * ringing, 4))
    assert abs(found.frequency_hz - 52.0) < 4 * found.frequency_sd + 1e-5
    assert found.frequency_sd > 0.1 * calibrate(tapped(ringing, 4)).frequency_sd / size


def test_overload_of_the_blow_does_not_spoil_the_ringing(ringing) -> None:
    limit = 0.7 * np.abs(ringing).max()
    found = calibrate(tapped(np.clip(ringing, -limit, limit), 2, sd=0.0))
    assert found.frequency_hz == pytest.approx(52.0, rel=2e-4)
    assert found.damping_ratio == pytest.approx(0.005, rel=0.02)


@pytest.mark.parametrize("force", [np.zeros(20_000), np.where(np.arange(20_000) == 9000, 1.0, 0.0)])
def test_no_ringing_no_calibration(force) -> None:
    with pytest.raises(NotIdentifiableError):
        calibrate(tapped(force))


def test_what_rings_is_held_against_the_rig_file(ringing) -> None:
    def told(mass: float) -> RigConstants:
        return RigConstants(clamp_mass_kg=mass, load_cell_stiffness_n_per_mm=TRUTH.load_cell)

    assert calibrate(tapped(ringing, rig=told(1e3 * TRUTH.mass))).warnings == ()
    # A mass that is a fifth off is what the tap is there to find.
    assert any("rig file expects" in w for w in calibrate(tapped(ringing, rig=told(1.2e3 * TRUTH.mass))).warnings)
    with pytest.raises(NotIdentifiableError, match="far from"):
        calibrate(tapped(ringing, rig=told(1e4 * TRUTH.mass)))
    slow = recording(
        {"force": ringing[::25]}, RATE / 25, protocol="tap", loading="calibration", rig=told(1e3 * TRUTH.mass)
    )
    with pytest.raises(NotIdentifiableError, match="samples"):
        calibrate(slow)


def test_a_tap_with_a_mass_on_the_clamp_is_none_of_the_clamp_alone(ringing) -> None:
    """The clamp's own mass is the less by that, so that what rings is what the file expects of both."""
    rig = RigConstants(clamp_mass_kg=1e3 * TRUTH.mass - 0.05, load_cell_stiffness_n_per_mm=TRUTH.load_cell)
    found = calibrate(tapped(ringing, rig=rig, extra_clamp_mass_kg=0.05))
    assert isinstance(found, TapCalibration)
    assert (found.warnings, found.extra_mass_kg) == ((), 0.05)
    assert found.frequency_hz == pytest.approx(52.0, rel=1e-4)
    assert sharpen(rig, found) == rig
    quantities = calibration_table("run-1", found).column("quantity").to_pylist()
    assert quantities == ["loaded_clamp_frequency_hz", "loaded_damping_ratio"]
    assert any("rig file expects" in w for w in calibrate(tapped(ringing, rig=rig)).warnings)


def hung(levels, *, gain=1.02, offset=0.03, sd=1e-3, seed=0, masses=(0.02, 0.05, 0.1, 0.15)):
    rate, plateau = 500.0, 5.0
    force = np.repeat(np.array(levels) * GRAVITY, round(plateau * rate))
    time = np.arange(force.size) / rate
    # Each mass swings a little after it was hung.
    since = np.mod(time, plateau)
    force = force * (1 + 0.02 * np.exp(-since / 0.3) * np.cos(2 * np.pi * 2 * since))
    force = gain * force + offset + np.random.default_rng(seed).normal(0, sd, force.size)
    return recording(
        {"force": force},
        rate,
        protocol="weight",
        loading="calibration",
        masses_kg=",".join(str(m) for m in masses),
    )


@pytest.mark.parametrize(
    "levels",
    [
        (0, 0.02, 0.05, 0.1, 0.15, 0),
        (0, 0.02, 0.05, 0.1, 0.15),
        (0.02, 0.05, 0.1, 0.15),
        (0, 0.02, 0, 0.05, 0, 0.1, 0, 0.15, 0),
        (0, 0.02, 0.07, 0.17, 0.32),
    ],
)
def test_gain_and_offset_however_the_masses_were_hung(levels) -> None:
    found = calibrate(hung(levels))
    assert found.gain == pytest.approx(1.02, abs=5e-4)
    assert found.offset_n == pytest.approx(0.03, abs=5e-4)
    assert found.plateaus == len(levels)
    low, high = found.gain_interval
    assert low < 1.02 < high


@pytest.mark.study
def test_intervals_of_the_gain_cover() -> None:
    inside = 0
    for seed in range(40):
        found = calibrate(hung((0, 0.02, 0.05, 0.1, 0.15, 0), seed=seed, sd=0.02))
        inside += found.gain_interval[0] < 1.02 < found.gain_interval[1]
    assert inside >= 34


@pytest.mark.parametrize(
    ("levels", "masses", "reason"),
    [
        ((0, 0.02, 0.05), (0.02, 0.05, 0.1, 0.15, 0.2, 0.25), "do not go"),
        ((0, 0.15, 0.02, 0.1), (0.02, 0.05, 0.1), "straight line"),
        ((0, 0, 0), (0.02,), "steady levels"),
    ],
)
def test_levels_that_do_not_go_with_the_masses(levels, masses, reason) -> None:
    with pytest.raises(NotIdentifiableError, match=reason):
        calibrate(hung(levels, masses=masses))


def test_a_level_without_a_mass_may_be_written_as_one_of_0() -> None:
    levels = (0, 0.02, 0.05, 0.1, 0.15)
    written, left_out = calibrate(hung(levels, masses=levels)), calibrate(hung(levels))
    assert written.gain == left_out.gain
    assert written.plateaus == 5


def test_missing_masses_are_named() -> None:
    made = recording({"force": np.zeros(1000)}, 100.0, protocol="weight", loading="calibration")
    with pytest.raises(NotIdentifiableError, match="masses_kg"):
        calibrate(made)


def test_a_tap_sharpens_mass_stiffness_and_damping() -> None:
    rig = RigConstants(
        clamp_mass_kg=1e3 * TRUTH.mass * 1.03,
        clamp_mass_kg_sd=0.03e3 * TRUTH.mass,
        load_cell_stiffness_n_per_mm=0.98 * TRUTH.load_cell,
        load_cell_stiffness_n_per_mm_sd=0.02 * TRUTH.load_cell,
    )
    sharp = sharpen(rig, TapCalibration(52.0, 1e-3, 0.005, 2e-5, 3))
    ratio = sharp.load_cell_stiffness_n_per_mm / (sharp.clamp_mass_kg * 1e-3)
    assert np.sqrt(ratio) / (2 * np.pi) == pytest.approx(52.0, rel=1e-3)
    # Bayes in the logarithms: the larger prior moves more.
    up = np.log(sharp.load_cell_stiffness_n_per_mm / rig.load_cell_stiffness_n_per_mm)
    down = np.log(sharp.clamp_mass_kg / rig.clamp_mass_kg)
    assert down < 0 < up
    assert -down / up == pytest.approx((0.03 / 1.03) ** 2 / (0.02 / 0.98) ** 2, rel=1e-6)
    assert sharp.clamp_mass_kg_sd < 0.6 * rig.clamp_mass_kg_sd
    assert sharp.load_cell_damping_n_s_per_mm == pytest.approx(TRUTH.damping, rel=0.05)
    assert sharp.load_cell_damping_n_s_per_mm_sd < 0.03 * TRUTH.damping
    prior = RigPrior.of(sharp)
    correlation = prior.factor[0] @ prior.factor[1] / (prior.sd[0] * prior.sd[1])
    assert correlation > 0.99


def test_a_tap_without_constants_keeps_the_frequency() -> None:
    sharp = sharpen(RigConstants(), TapCalibration(52.0, 1e-3, 0.005, 2e-5, 3))
    assert sharp.clamp_frequency_hz == 52.0
    assert sharp.clamp_mass_kg is None


def test_weights_set_the_gain_and_two_of_them_are_weighted() -> None:
    once = sharpen(RigConstants(), calibrate(hung((0, 0.02, 0.05, 0.1, 0.15))))
    assert once.force_gain == pytest.approx(1.02, abs=5e-4)
    twice = sharpen(once, calibrate(hung((0, 0.02, 0.05, 0.1, 0.15), seed=5)))
    assert twice.force_gain == pytest.approx(1.02, abs=5e-4)
    assert twice.force_gain_sd < once.force_gain_sd * 1.5
