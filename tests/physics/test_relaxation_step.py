"""Step and hold: against the closed-form response of the film to a ramp."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.transform.relaxation import relaxation_curve
from pipeline.transform.respond import respond
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording
from tests.physics.rig_truth import recording

SPRINGS, TIMES, K0 = (0.4, 1.0), (2.5, 0.1), 0.4
RATE = 1000.0


def relaxed(time: np.ndarray, start: float, ramp: float, height: float) -> np.ndarray:
    """Force of the film for a ramp: integral of its relaxation function over the ramp."""

    def integral(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0.0)
        return K0 * t + sum(k * tau * -np.expm1(-t / tau) for k, tau in zip(SPRINGS, TIMES, strict=True))

    return height / ramp * (integral(time - start) - integral(time - start - ramp))


def run(ramp: float, *, seed: int = 0, until: float = 120.0, back: float | None = None, **noise: float):
    rng = np.random.default_rng(seed)
    time = np.arange(round(until * RATE)) / RATE
    x = 2 * np.clip((time - 4.0) / ramp, 0, 1)
    force = relaxed(time, 4.0, ramp, 2.0)
    if back is not None:
        x = x - 2 * np.clip((time - back) / ramp, 0, 1)
        force = force - relaxed(time, back, ramp, 2.0)
    x, force = x + rng.normal(0, 5e-4, x.size), force + rng.normal(0, noise.get("force", 1e-3), x.size)
    return time, recording({"displacement": 3 + x, "force": 0.7 + force}, RATE, protocol="step")


@pytest.mark.long_after(1)
@pytest.mark.slow
@pytest.mark.parametrize("ramp", [0.0005, 0.05, 0.4])
def test_window_means_and_their_variance(ramp: float) -> None:
    scores = []
    for seed in range(20):
        time, made = run(ramp, seed=seed)
        curve, warnings = relaxation_curve(made)
        since = time - curve.details["ramp_start_s"]
        exact = relaxed(time, curve.details["ramp_start_s"], curve.ramp_s, 2.0) / 2.0
        means = [exact[(since >= a - 1e-9) & (since <= b + 1e-9)].mean() for a, b in curve.window_s]
        scores.append((curve.stiffness - means) ** 2 / (curve.variance + curve.rest_variance))
    assert warnings == ()
    assert curve.ramp_s == pytest.approx(max(ramp, 0.8 / RATE), rel=0.4 if ramp < 0.01 else 0.01)
    assert curve.step == pytest.approx(2.0, abs=1e-4)
    assert curve.usable.all()
    assert 25 <= curve.time_s.size <= 70
    assert np.all(np.diff(curve.time_s) > 0)
    slow = curve.time_s > 0.5
    assert 0.7 < np.mean(np.array(scores)[:, slow]) < 1.4
    assert np.mean(scores) < 1.6


def test_a_release_is_a_step_down_with_windows_of_its_own() -> None:
    time, made = run(0.05, back=60.0)
    curve, warnings = relaxation_curve(made)
    assert curve.details["held_s"] == pytest.approx(60.0 - 4.05, abs=0.02)
    (down,) = curve.later
    assert (down.start_s, down.ramp_s, down.step) == pytest.approx((56.0, 0.05, -2.0), abs=3e-3)
    assert warnings == ()
    first = curve.step_number == 1
    assert first.sum() >= 25
    assert (~first).sum() >= 25
    assert curve.window_s[first, 1].max() < 56.0
    assert curve.window_s[~first, 0].min() > 56.05
    assert curve.first_step().time_s.size == first.sum()
    exact = (relaxed(time, 4.0, 0.05, 2.0) - relaxed(time, 60.0, 0.05, 2.0)) / 2.0
    since = time - curve.details["ramp_start_s"]
    means = [exact[(since >= a - 1e-9) & (since <= b + 1e-9)].mean() for a, b in curve.window_s]
    error = (curve.stiffness - means) / np.sqrt(curve.variance + curve.rest_variance)
    assert np.abs(error)[curve.time_s > 0.5].max() < 5


def ringing(decay_s: float, size_n: float = 0.2) -> Recording:
    """A step whose clamp rings on after it."""
    time, made = run(0.01)
    since = np.maximum(time - 4.01, 0)
    ring = np.where(time > 4.01, size_n * np.exp(-since / decay_s) * np.cos(2 * np.pi * 52 * since), 0.0)
    channels = {q: c.values for q, c in made.channels.items()}
    return recording({**channels, "force": channels["force"] + ring}, RATE, protocol="step")


def test_one_window_that_rings_is_no_plural() -> None:
    curve, warnings = relaxation_curve(ringing(0.03, 0.1))
    assert (~curve.usable).sum() == 1
    assert any(w.replace("\xa0", " ").startswith("1 window up to") and "step rings and is" in w for w in warnings)


def test_ringing_windows_are_marked() -> None:
    curve, warnings = relaxation_curve(ringing(0.5))
    assert 3 < (~curve.usable).sum() < curve.usable.size / 2
    assert curve.usable[curve.time_s > 4].all()
    assert any("ring" in w for w in warnings)


def test_rounding_of_a_quiet_channel_is_not_averaged_away() -> None:
    _, made = run(0.05, force=0.0)
    force = np.rint(made.channels["force"].values / 2e-3) * 2e-3
    made = recording(
        {"displacement": made.channels["displacement"].values, "force": force},
        RATE,
        protocol="step",
        details={"force": {"resolution": 2e-3}},
    )
    curve, _ = relaxation_curve(made)
    assert np.all(curve.variance >= (2e-3**2 / 12) / curve.step**2 * 0.999)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda x, f: (x[4200:], f[4200:]), "no step"),
        (lambda x, f: (x[:4065], f[:4065]), "held|windows"),
        (lambda x, f: (0 * x + np.random.default_rng(seed=0).normal(0, 1e-3, x.size), f), "no step"),
        (lambda x, f: (x, np.minimum(f, 1.2)), "saturated"),
    ],
)
def test_what_cannot_carry_a_curve_is_refused(change, reason) -> None:
    _, made = run(0.05)
    x, force = change(made.channels["displacement"].values, made.channels["force"].values)
    with pytest.raises(NotIdentifiableError, match=reason) as caught:
        respond(recording({"displacement": x, "force": force}, RATE, protocol="step"))
    assert caught.value.where == "run-1"


@pytest.mark.parametrize(("ramp", "rest_s"), [(4.0, 0.0), (0.05, 0.0), (1.0, 0.5), (0.05, 0.02)])
def test_a_machine_that_records_when_it_moves_gives_its_curve(ramp: float, rest_s: float) -> None:
    """The step is found from the noise of differences, however short the rest; without any the ramp's beginning is the level."""
    _, made = run(ramp, until=600.0)
    first = round((4.0 - rest_s) * RATE)
    signals = {name: channel.values[first:] for name, channel in made.channels.items()}
    curve, warnings = relaxation_curve(recording(signals, RATE, protocol="step"))
    assert curve.step == pytest.approx(2.0, rel=2e-3)
    assert curve.ramp_s == pytest.approx(ramp, rel=0.03, abs=2 / RATE)
    # Mean of the film's closed form over each window, with the error that the result states.
    time = np.arange(signals["force"].size) / RATE - rest_s
    true = relaxed(time, 0.0, ramp, 2.0) / 2.0
    late = curve.time_s > 2 * ramp + 0.05
    for at, value, sd in zip(curve.time_s[late], curve.stiffness[late], np.sqrt(curve.variance[late]), strict=True):
        assert abs(value - np.interp(at, time, true)) < 5 * np.hypot(sd, np.sqrt(curve.rest_variance)) + 2e-3 * value
    assert any("begins with the record" in w for w in warnings) == (rest_s < 8 / RATE)


@pytest.mark.parametrize("second", [0.0, 2.0, 3.0])
@pytest.mark.parametrize("ramp_samples", [1, 2, 3, 20])
def test_an_input_without_noise_that_moves_at_once_holds_its_steps(ramp_samples: int, second: float) -> None:
    """A machine that records its set point: the smallest change of its speed is the ramp, and no step of a converter."""
    rng = np.random.default_rng(seed=4)
    time = np.arange(0.0, 120.0, 0.02)
    ramp = ramp_samples * 0.02
    x = 2 * np.clip(time / ramp, 0, 1) + second * np.clip((time - 60.0) / ramp, 0, 1)
    force = relaxed(time, 0.0, ramp, 2.0) + relaxed(time, 60.0, ramp, second) + rng.normal(0, 1e-3, time.size)
    curve, _ = relaxation_curve(recording({"displacement": x, "force": force}, 50.0, protocol="step"))
    assert curve.step == pytest.approx(2.0, rel=1e-3)
    late = (curve.time_s > 1) & (curve.time_s < 59)
    true = np.interp(curve.time_s[late], time, relaxed(time, 0.0, ramp, 2.0) / 2.0)
    np.testing.assert_allclose(curve.stiffness[late], true, atol=5e-3 * true.max())


@pytest.mark.parametrize("second_s", [30.0, 60.0, 90.0])
def test_of_several_steps_all_are_taken(second_s: float) -> None:
    """However long each is held: a window is the film's own force, with what the first step left in it."""
    rng = np.random.default_rng(seed=3)
    time = np.arange(0.0, 120.0, 0.02)
    x = 2 * np.clip((time - 4.0) / 0.4, 0, 1) + 3 * np.clip((time - second_s) / 0.4, 0, 1)
    force = relaxed(time, 4.0, 0.4, 2.0) + relaxed(time, second_s, 0.4, 3.0)
    x, noisy = x + rng.normal(0, 5e-4, x.size), force + rng.normal(0, 1e-3, x.size)
    curve, warnings = relaxation_curve(recording({"displacement": x, "force": noisy}, 50.0, protocol="step"))
    assert curve.step == pytest.approx(2.0, abs=1e-3)
    (second,) = curve.later
    assert (second.start_s, second.ramp_s, second.step) == pytest.approx((second_s - 4.0, 0.4, 3.0), abs=0.01)
    assert curve.usable.all()
    first = curve.step_number == 1
    assert curve.window_s[first, 1].max() < second_s - 4.0 + 0.02, "one sample"
    assert (~first).sum() > 10
    since = time - curve.details["ramp_start_s"]
    means = [force[(since >= a - 1e-9) & (since <= b + 1e-9)].mean() / 2 for a, b in curve.window_s]
    # Before that the ramps' instants count, which are known to a fraction of a sample.
    settled = np.where(first, curve.time_s, curve.time_s - second.start_s) > 1.0
    assert np.abs(curve.stiffness - means)[settled].max() < 5e-3
    assert not warnings


def test_what_is_no_step_ends_a_staircase_aloud() -> None:
    """Cycles after the second hold are no steps."""
    time = np.arange(0.0, 120.0, 0.02)
    x = 2 * np.clip((time - 4.0) / 0.4, 0, 1) + 3 * np.clip((time - 40.0) / 0.4, 0, 1)
    cycling = np.where(time > 80, np.sin(2 * np.pi * 0.25 * (time - 80)), 0.0)
    force = relaxed(time, 4.0, 0.4, 2.0) + relaxed(time, 40.0, 0.4, 3.0) + cycling
    rng = np.random.default_rng(seed=4)
    made = {"displacement": x + cycling + rng.normal(0, 5e-4, x.size), "force": force + rng.normal(0, 1e-3, x.size)}
    curve, warnings = relaxation_curve(recording(made, 50.0, protocol="step"))
    assert len(curve.later) == 1
    assert curve.window_s[-1, 1] == pytest.approx(76.0, abs=0.1)
    assert any("moved again 76" in warning for warning in warnings)


@pytest.mark.parametrize("rest_s", [0.0, 4.0])
@pytest.mark.parametrize("is_slack", [True, False])
def test_a_film_that_goes_slack_between_two_steps_ends_its_first_curve(is_slack: bool, rest_s: float) -> None:
    """It cannot push: what a linear film would remember of the first step is gone. A film under tension keeps both."""
    rng = np.random.default_rng(seed=5)
    time = np.arange(0.0, 200.0, 0.02)
    steps = [(rest_s, 2.0), (rest_s + 60, -2.0), (rest_s + 100, 3.0)]
    x = sum(height * np.clip((time - start) / 0.4, 0, 1) for start, height in steps)
    forces = [np.sign(height) * relaxed(time, start, 0.4, abs(height)) for start, height in steps]
    kept = forces[0] * (time < rest_s + 60) + forces[2] if is_slack else sum(forces)
    made = {"displacement": x + rng.normal(0, 5e-4, x.size), "force": kept + rng.normal(0, 1e-3, x.size)}
    curve, warnings = relaxation_curve(recording(made, 50.0, protocol="step"))
    assert any("goes slack" in warning for warning in warnings) == is_slack
    assert len(curve.later) == (0 if is_slack else 2)
    late = (curve.time_s > 1) & (curve.time_s < 59)
    true = np.interp(curve.time_s[late], time - rest_s, forces[0] / 2.0)
    np.testing.assert_allclose(curve.stiffness[late], true, atol=5e-3 * true.max())
