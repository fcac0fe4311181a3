"""Closed loops against records written out here; gains; what is named when something is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.analyse.recording import analyse_recording
from pipeline.commands.show.controller import ControllerStudy
from pipeline.fit.sensing.gains import propose_gains
from pipeline.fit.sensing.self_sensing import fit_sensing
from pipeline.simulate.campaign import load_campaign, simulate_one
from pipeline.transform.loop import LoopResponse, measure_loop
from pipeline.transform.step import measure_steps
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording
from tests.helpers import sensing_truth


def loop(
    *,
    overshoot: float = 0.0,
    tau: float = 0.2,
    hold: float = 20.0,
    drift: float = 0.0,
    noise: float = 1.0,
    seed: int = 0,
    sign: int = 1,
    force_peak: float = 0.5,
) -> Recording:
    """Demand 28.6 → 28.5 pF for a while; the capacitance follows, the force overshoots and may drift with log time."""
    rng = np.random.default_rng(seed)
    rate, lead, off = 100.0, 5.0, 4.0
    t = np.arange(int(rate * (lead + hold + off))) / rate
    since = t - lead
    on = (since >= 0) & (since < hold)
    wave = overshoot / 100 * np.exp(-since / 0.5) * np.sin(np.clip(since, 0, 1) * np.pi)
    y = np.where(on, 1 - np.exp(-np.maximum(since, 0) / tau) + np.where(on, wave * 2, 0), 0.0)
    step = -0.1 * sign
    relation = 1 + np.where(since > 1, drift * np.log(np.maximum(since, 1)), 0.0)
    drop = 0.016 * np.where(on, relation + force_peak * np.exp(-np.maximum(since, 0) / 2), 0.0)
    about = sensing_truth.metadata(controller="closed", proportional_gain=40.0, integral_gain=240.0)
    return sensing_truth.recording(
        about,
        t,
        voltage=np.where(on, 4.9 + 2 * np.exp(-np.maximum(since, 0) / 2), 0.0)
        + 0.003 * noise * rng.standard_normal(t.size),
        force=0.5 - drop + 0.001 * noise * rng.standard_normal(t.size),
        capacitance=28.6 + step * y + 0.002 * noise * rng.standard_normal(t.size),
        demand=np.where(on, 28.6 + step, 28.6),
    )


def without(recording: Recording, quantity: str) -> Recording:
    return replace(recording, channels={k: v for k, v in recording.channels.items() if k != quantity})


def test_numbers_of_a_clean_loop() -> None:
    found = measure_loop(loop(noise=1e-6))
    assert found.demand_step_pf == pytest.approx(-0.1)
    assert found.hold_s == pytest.approx(20.0)
    assert found.rise_time_s == pytest.approx(0.2 * np.log(9), abs=0.02)
    assert found.settling_time_s == pytest.approx(0.2 * np.log(20), abs=0.02)
    assert found.overshoot_percent == 0.0
    assert found.force_overshoot_percent == pytest.approx(50, abs=1)
    assert found.error_sign == 1
    assert found.peak_kv == pytest.approx(6.9, abs=0.05)
    assert found.relation_drift_percent is None  # 20 s are too short to follow a drift


def test_overshoot_is_found_beyond_the_noise_only() -> None:
    truth = measure_loop(loop(overshoot=20, noise=1e-6)).overshoot_percent
    assert truth is not None
    assert truth > 5
    noisy = measure_loop(loop(overshoot=20)).overshoot_percent
    assert noisy == pytest.approx(truth, abs=3)
    assert measure_loop(loop()).overshoot_percent == 0.0


def test_a_capacitance_that_rises_with_the_voltage_needs_the_other_sign() -> None:
    assert measure_loop(loop(sign=-1)).error_sign == -1


def test_drift_of_the_relation_lies_within_its_limits() -> None:
    held = []
    for seed in range(40):
        share = 0.02 if seed % 2 else 0.0
        found = measure_loop(loop(hold=300, drift=share, seed=seed, force_peak=0.0))
        assert found.relation_drift_percent is not None
        assert found.relation_drift_percent_sd is not None
        late = 1 + share * np.log(np.geomspace(20, 300, 200))
        truth = 100 * share * np.log(300 / 20) / late.mean()
        held.append(abs(found.relation_drift_percent - truth) < 1.96 * found.relation_drift_percent_sd)
    assert sum(held) >= 34


def test_without_a_demand_the_level_reached_stands_for_it_and_that_is_said() -> None:
    found = measure_loop(without(loop(), "demand"))
    assert found.demand_step_pf is None
    assert found.error_rms_pf is None
    assert found.error_sign is None
    assert any("no demand channel" in w for w in found.warnings)
    assert found.rise_time_s == pytest.approx(0.2 * np.log(9), abs=0.05)
    noted = analyse_recording(without(loop(), "demand")).notes
    assert any("without a demand channel" in note for note in noted)


def test_without_a_capacitance_there_is_no_loop_but_the_force_is_measured() -> None:
    bare = without(loop(), "capacitance")
    with pytest.raises(NotIdentifiableError, match="without a capacitance"):
        measure_loop(bare)
    analysis = analyse_recording(bare)
    assert not analysis.failures
    assert any("no capacitance channel: force only" in note for note in analysis.notes)
    assert any("closed loop without a capacitance" in note for note in analysis.notes)
    (steps,) = (result.steps for result in analysis.carried if hasattr(result, "steps"))
    assert steps[0].force_step_n == pytest.approx(0.016, abs=0.001)


def test_a_demand_that_never_changes_or_hardly_is_named() -> None:
    recording = loop()
    demand = recording.channels["demand"]
    still = replace(demand, values=np.full(demand.values.size, 28.6))
    with pytest.raises(NotIdentifiableError, match="does not change"):
        measure_loop(replace(recording, channels={**recording.channels, "demand": still}))
    tiny = replace(demand, values=np.where(demand.values < 28.55, 28.59999, 28.6))
    with pytest.raises(NotIdentifiableError, match="demand changes by"):
        measure_loop(replace(recording, channels={**recording.channels, "demand": tiny}))


def test_one_step_only_gives_a_ratio_and_says_so() -> None:
    truth = sensing_truth.sensing(np.random.default_rng(seed=3))
    steps = measure_steps(truth.recording).steps
    fit = fit_sensing([steps[-1:]], truth.recording.metadata)
    assert fit.force_per_capacitive_strain.value == pytest.approx(truth.slope_n, rel=0.05)
    assert "one step only: no scatter, no linearity" in fit.warnings
    assert fit.drift_pf_per_hour is None
    assert fit.force_exponent is None


def test_steps_shorter_than_the_settling_time_are_named() -> None:
    t = np.arange(0, 16, 0.005)
    voltage, drop = np.zeros(t.size), np.zeros(t.size)
    for begin in (2.0, 6.0, 10.0):
        since = t - begin
        on = (since >= 0) & (since < 2.0)
        voltage[on] = 8.0
        drop[on] = 0.05 * (1 - np.exp(-since[on] / 3.0))
    rng = np.random.default_rng(seed=4)
    made = sensing_truth.recording(
        sensing_truth.metadata(), t, voltage=voltage, force=0.5 - drop + 1e-4 * rng.standard_normal(t.size)
    )
    steps = measure_steps(made).steps
    assert all("the step is shorter than its settling time" in s.warnings for s in steps)
    assert all(s.force_step_n > 0 for s in steps)


def response(kp: float, ki: float, rise: float, over: float, force: float, *, settled: bool = True) -> LoopResponse:
    return replace(
        measure_loop(loop(noise=1e-6)),
        recording_id=f"g-{kp:g}-{ki:g}",
        proportional_gain=kp,
        integral_gain=ki,
        rise_time_s=rise,
        overshoot_percent=over,
        force_overshoot_percent=force,
        settling_time_s=1.0 if settled else None,
    )


def test_the_gains_proposed_keep_both_limits_with_the_least_force() -> None:
    tried = [
        response(10, 40, 1.5, 0, 5),
        response(10, 240, 0.4, 12, 40),
        response(40, 240, 0.45, 3, 30),
        response(40, 400, 0.2, 8, 60),
        response(80, 240, 0.3, 2, 10, settled=False),
    ]
    (proposal,) = propose_gains(tried)
    assert proposal.best is not None
    assert (proposal.best.proportional_gain, proposal.best.integral_gain) == (40, 240)
    assert proposal.gentle is not None
    assert proposal.gentle.rise_time_s == 1.5
    assert proposal.kept == 2
    assert "40 V/pF and 240 V/pF/s keep" in proposal.statement
    assert propose_gains(tried[:3]) == ()
    (none,) = propose_gains([replace(x, rise_time_s=2.0) for x in tried])
    assert none.best is None
    assert "none of 5 pairs" in none.statement


def test_the_virtual_controller_has_the_right_sign_and_the_printed_one_does_nothing() -> None:
    """Thesis, eq 5.17 and 5.18: with E = C_d − C and positive gains the voltage stays at zero."""
    campaign = load_campaign("controller")
    planned = next(p for p in campaign.planned if p.recording_id == "acrylic-40-240")
    found = measure_loop(simulate_one(campaign, planned).recording)
    assert found.error_sign == 1
    assert found.settling_time_s is not None
    printed = replace(planned, procedure=replace(planned.procedure, thesis_sign=True))  # type: ignore[type-var]
    silent = simulate_one(campaign, printed).recording
    assert float(np.abs(silent.channels["voltage"].values).max()) < 0.1


def test_a_controller_study_prints_its_table_and_proposes() -> None:
    campaign = load_campaign("controller")
    study = ControllerStudy()
    for planned in campaign.planned:
        if planned.recording_id.startswith("silicone-") and planned.recording_id.endswith(("-120", "-400")):
            study.add(simulate_one(campaign, planned).recording)
    assert study.text.count("<- proposed") == 1
    assert "Controller of silicone" in study.text
    (proposal,) = propose_gains(study.loops)
    assert proposal.gentle is not None  # silicone hardly creeps: quick and without overshoot of the force
    assert (proposal.gentle.rise_time_s or 1) < 0.5
    assert ControllerStudy().text == ""
    thesis = load_campaign("thesis")
    study.add(simulate_one(thesis, next(p for p in thesis.planned if p.recording_id == "SS-2-open-loop")).recording)
    assert study.text == "", "a campaign that tries gains among other things is no study of them"
