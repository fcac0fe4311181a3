"""Whole tests on the virtual rig: responses, hidden effects, lifetimes and self-sensing against independent truth."""

from __future__ import annotations

import copy
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import least_squares
from scipy.stats import kstest, weibull_min

from pipeline.physics.film import RelaxationModel
from pipeline.simulate.bench import Slip
from pipeline.simulate.campaign import SimulatedRecording, load_campaign, read_campaign, simulate, simulate_one
from pipeline.simulate.lifetime import LifetimeGroup
from pipeline.transform.cyclic import cyclic_response
from schemas.errors import UsageError

THESIS = load_campaign("thesis")
QUIET = {"noise_sd": 0.0, "bits": 0}
RIG: dict[str, Any] = {
    "clamp_mass_kg": 0.1874,
    "load_cell_stiffness_n_per_mm": 20.0,
    "damping_ratio": 0.005,
    "channels": {q: dict(QUIET) for q in ("force", "displacement", "voltage", "command", "capacitance")},
}
GEOMETRY = {
    "film_length_mm": 50.0,
    "film_width_mm": 50.0,
    "film_thickness_mm": 1.0,
    "stretch_1": 1.4,
    "active_length_mm": 40.0,
    "active_width_mm": 40.0,
}
TABLE: dict[str, Any] = {
    "name": "check",
    "seed": 1,
    "started_at": "2024-03-04T08:00:00+00:00",
    "rigs": {"shaker": RIG},
    "materials": {
        "acrylic": {
            "k0_n_per_mm": 1.0,
            "k_n_per_mm": [1.5, 2.0, 30.0],
            "c_n_s_per_mm": [0.05, 0.02, 0.02],
            "relative_permittivity": 4.7,
        }
    },
    "specimens": {"A": {"rig": "shaker", "material": "acrylic", "pretension_n": 0.9, "geometry": GEOMETRY}},
}
CHIRP = {"test": "chirp", "specimens": ["A"], "id": "chirp", "amplitude_mm": 0.7, "amplitude_exponent": -0.75}
SPHS = {"test": "sphs", "specimens": ["A"], "id": "sphs", "drive_kv": 7.0, "periods": 6}


def made(
    *entries: dict[str, Any], effects: dict[str, Any] | None = None, quiet: bool = True
) -> list[SimulatedRecording]:
    table = copy.deepcopy(TABLE) | {"recordings": list(entries)}
    if effects:
        table["specimens"]["A"]["effects"] = effects
    if not quiet:
        table["rigs"]["shaker"]["channels"] = {}
    return list(simulate(read_campaign(table)))


def values(simulated: SimulatedRecording, quantity: str) -> np.ndarray:
    return simulated.recording.channels[quantity].values


def film(f: np.ndarray) -> np.ndarray:
    s = 2j * np.pi * f
    return 1.0 + sum(k * c * s / (k + c * s) for k, c in ((1.5, 0.05), (2.0, 0.02), (30.0, 0.02)))


def rig_response(k: np.ndarray, f: np.ndarray, mass: float = 0.1874e-3, kl: float = 20.0) -> np.ndarray:
    omega = 2 * np.pi * f
    damping = 2 * 0.005 * np.sqrt(20.0 * 0.1874e-3)
    return kl / (k + kl - mass * omega**2 + 1j * omega * damping)


def chirp_response(simulated: SimulatedRecording) -> tuple[np.ndarray, np.ndarray]:
    """Ratio of two transforms of the whole record, which begins and ends at rest."""
    x, force = values(simulated, "displacement"), values(simulated, "force")
    f = np.fft.rfftfreq(x.size, 1 / 2000)
    band = (f >= 1.5) & (f <= 99)
    return f[band], (np.fft.rfft(force - force[0]) / np.fft.rfft(x - x[0]))[band]


def sphs_response(simulated: SimulatedRecording) -> tuple[np.ndarray, np.ndarray]:
    """Last period, force against measured voltage squared, at the excited lines; a drop of tension is positive."""
    force, squared = values(simulated, "force")[-2000:], values(simulated, "voltage")[-2000:] ** 2
    lines = np.arange(1, 100, 2)
    return lines.astype(float), -np.fft.rfft(force)[lines] / np.fft.rfft(squared)[lines]


def test_chirp_and_multisine_have_the_closed_form_responses() -> None:
    chirp, sphs = made(CHIRP, SPHS)
    f, response = chirp_response(chirp)
    k = film(f)
    assert np.max(np.abs(response / (k * rig_response(k, f)) - 1)) < 1.5e-4
    f, response = sphs_response(sphs)
    # ε0 εr w/z of the current sizes, and the share of the active length
    maxwell = 8.8541878e-6 * 4.7 * 40 / (1 / np.sqrt(1.4)) * 40 / 70
    assert np.max(np.abs(response / (maxwell * rig_response(film(f), f)) - 1)) < 2e-4
    assert values(chirp, "force")[0] == pytest.approx(0.9)


def test_noise_of_the_rig_leaves_the_stiffness_identifiable_to_one_percent() -> None:
    (chirp,) = made(CHIRP | {"repeats": 3}, quiet=False)
    x, force = values(chirp, "displacement"), values(chirp, "force")
    u, y = (np.fft.rfft((v - v[:2000].mean())[2000:].reshape(3, -1), axis=1).mean(axis=0) for v in (x, force))
    f = np.fft.rfftfreq(42_000, 1 / 2000)
    band = (f >= 1.2) & (f <= 98)
    f, u, y = f[band], u[band], y[band]

    def model(p: np.ndarray, at: np.ndarray) -> np.ndarray:
        s = 2j * np.pi * at
        return np.exp(p[0]) + sum(np.exp(p[i]) * s / (s + np.exp(p[i + 1])) for i in (1, 3, 5))

    def residual(p: np.ndarray) -> np.ndarray:
        k = model(p, f)
        error = (y - k * rig_response(k, f, 0.1874e-3 * np.exp(p[7]), 20 * np.exp(p[8])) * u) / 0.05
        return np.concatenate([error.real, error.imag, p[7:] / 0.01])

    start = np.array([0, 0.7, 3.0, 0.7, 5.0, 3.0, 7.0, 0, 0])
    found = least_squares(residual, start).x
    grid = np.linspace(1, 100, 100)
    assert np.mean(np.abs(model(found, grid) / film(grid) - 1)) < 0.01


@pytest.mark.parametrize("sign", [1, -1])
def test_hidden_rig_constants_move_the_response(sign: int) -> None:
    errors = {"mass_error": 0.02 * sign, "stiffness_error": 0.06}
    (chirp,) = made(CHIRP, effects={"rig_constants": errors})
    f, response = chirp_response(chirp)
    k = film(f)
    expected = k * rig_response(k, f, 0.1874e-3 * (1 + 0.02 * sign), 21.2)
    # the true damping stays what it is
    assert np.max(np.abs(response / expected - 1)) < 1.5e-4
    assert chirp.recording.rig.load_cell_stiffness_n_per_mm == 20.0
    assert chirp.truth["rig"]["load_cell_stiffness_n_per_mm"] == pytest.approx(21.2)


def test_gain_error_and_delay_act_on_their_channel_only() -> None:
    plain, wrong, late = (
        made(CHIRP, effects=e)[0]
        for e in (None, {"gain_error": {"gain": 0.1}}, {"sensor_delay": {"delay_s": 5e-4, "channel": "force"}})
    )
    assert values(wrong, "force") == pytest.approx(1.1 * values(plain, "force"))
    assert np.array_equal(values(wrong, "displacement"), values(plain, "displacement"))
    f, response = chirp_response(late)
    _, reference = chirp_response(plain)
    assert np.max(np.abs(response / reference / np.exp(-2j * np.pi * f * 5e-4) - 1)) < 1e-4


def test_lag_is_invisible_against_the_measured_voltage_unless_the_monitor_leads() -> None:
    lag = {"rise_time_constant_s": 1e-3}
    seen, hidden = (made(SPHS, effects={"drive_lag": lag | {"monitored": monitored}})[0] for monitored in (True, False))
    f, response = sphs_response(seen)
    maxwell = 8.8541878e-6 * 4.7 * 40 * np.sqrt(1.4) * 40 / 70
    expected = maxwell * rig_response(film(f), f)
    assert np.max(np.abs(response / expected - 1)) < 2e-4
    _, response = sphs_response(hidden)
    # roughly a pole of 1 ms: V² lags by as much as V
    assert np.angle(response[-1] / expected[-1], deg=True) == pytest.approx(-np.degrees(2 * np.pi * 99e-3), abs=6)


def test_hum_is_at_the_mains_with_a_phase_of_its_own_in_each_recording() -> None:
    hold = {"test": "step_mechanical", "specimens": ["A"], "id": "s{n}", "step_mm": 0.1, "hold_s": 2.0, "rest_s": 2.0}
    twice = made(
        hold | {"vary": {"ramp_s": [0.02, 0.03]}}, effects={"mains_hum": {"amplitude_n": 0.01, "second_n": 0.004}}
    )
    phasors = [np.fft.rfft(values(s, "force")[:4000])[[100, 200]] / 2000 for s in twice]
    for phasor in phasors:
        assert np.abs(phasor) == pytest.approx([0.01, 0.004], rel=1e-6)
    assert abs(np.angle(phasors[0][0] / phasors[1][0])) > 0.01


def test_a_leaky_film_sags_by_the_square_of_its_voltage_as_the_current_builds_up() -> None:
    steps = {
        "test": "step_electrical",
        "specimens": ["A"],
        "id": "s",
        "levels_kv": [3.0, 6.0],
        "on_s": 5.0,
        "off_s": 5.0,
    }
    leak = {"droop": 0.1, "at_kv": 6.0, "build_up_s": 0.4}
    plain, leaky = (made(steps | {"rest_s": 1.0}, effects=e)[0] for e in (None, {"leakage": leak}))
    given, seen = values(plain, "voltage"), values(leaky, "voltage")
    assert np.array_equal(values(plain, "command"), values(leaky, "command"))
    on = np.flatnonzero(np.diff(given) > 1)
    for first, level in zip(on, (3.0, 6.0), strict=True):
        for after_s in (0.4, 4.5):
            sag = 1 - seen[first + round(after_s * 2000)] / level
            assert sag == pytest.approx(0.1 * (level / 6) ** 2 * (1 - np.exp(-after_s / 0.4)), abs=3e-4)
    # the film feels what the monitor shows: at rest the force follows the square of that voltage
    held = slice(on[1] + 9000, on[1] + 9100)
    pulls = [0.9 - values(s, "force")[held].mean() for s in (plain, leaky)]
    assert pulls[1] / pulls[0] == pytest.approx((seen[held].mean() / 6) ** 2, rel=2e-3)


def test_crosstalk_is_in_the_force_while_the_voltage_changes_and_nowhere_else() -> None:
    share = {"n_s_per_kv": 5e-5, "corner_hz": 160.0}
    plain, picking_up = (made(SPHS, effects=e)[0] for e in (None, {"crosstalk": share}))
    assert np.array_equal(values(plain, "voltage"), values(picking_up, "voltage"))
    extra = np.fft.rfft((values(picking_up, "force") - values(plain, "force"))[-2000:])[1:100]
    voltage = np.fft.rfft(values(plain, "voltage")[-2000:])[1:100]
    s = 2j * np.pi * np.arange(1, 100)
    strong = np.abs(voltage) > 0.1 * np.abs(voltage).max()
    assert extra[strong] == pytest.approx((5e-5 * s * voltage / (1 + s / (2 * np.pi * 160)))[strong], rel=0.01)
    (pulled,) = made(CHIRP, effects={"crosstalk": share})
    (sound,) = made(CHIRP)
    assert np.array_equal(values(pulled, "force"), values(sound, "force"))


@pytest.mark.slow
def test_baseline_falls_with_the_logarithm_of_time() -> None:
    hold = {"test": "step_electrical", "specimens": ["A"], "id": "s", "levels_kv": [1.0], "on_s": 1.0, "off_s": 98.0}
    plain, drifting = (
        made(hold | {"sample_rate_hz": 100.0}, effects=e)[0]
        for e in (None, {"baseline_drift": {"per_decade": 0.05, "t0_s": 1.0}})
    )
    loss = values(plain, "force") - values(drifting, "force")
    time = np.arange(loss.size) / 100
    assert loss == pytest.approx(0.05 * 0.9 * np.log10(1 + time), rel=2e-3, abs=1e-9)


GROUP = LifetimeGroup(
    configuration="c",
    prefix="p",
    count=4000,
    voltage_kv=8.0,
    test_duration_s=1e9,
    shape=1.7,
    scale_s=50.0,
    location_s=3.0,
)


@pytest.mark.parametrize("draw", ["independent", "stratified"])
def test_lives_follow_their_distribution(draw: str) -> None:
    from dataclasses import replace

    group = replace(GROUP, draw=draw, reference_kv=7.5, voltage_exponent=10.0)
    lives = group.lives_s(np.random.default_rng(seed=5))
    # h = (β/t0)(t/t0)^(β−1) (V/V0)^p: the scale falls by (V/V0)^(−p/β)
    scale = 50.0 * (8.0 / 7.5) ** (-10.0 / 1.7)
    assert kstest(lives, weibull_min(1.7, loc=3.0, scale=scale).cdf).pvalue > 0.01
    cut = replace(group, maximum_s=40.0).lives_s(np.random.default_rng(seed=5))
    assert cut.max() < 40.0
    law = weibull_min(1.7, loc=3.0, scale=scale)
    assert kstest(cut, lambda t: law.cdf(t) / law.cdf(40.0)).pvalue > 0.01


def test_the_three_cases_look_like_those_of_the_thesis() -> None:
    campaign = THESIS
    groups: dict[str, list[Any]] = {}
    for planned in campaign.planned:
        if planned.procedure.protocol == "lifetime":
            groups.setdefault(planned.procedure.group.prefix, []).append(planned.procedure)
    lives = {name: np.array([life.life_s for life in group]) for name, group in groups.items()}
    one, two, three = lives["RP1"], lives["RP2"], lives["RP3"]
    assert (one.size, two.size, three.size) == (20, 20, 10)
    assert one.min() > 4
    assert one.max() <= 120
    assert one.mean() == pytest.approx(39, abs=6)
    assert one.std(ddof=1) == pytest.approx(33, abs=6)
    assert np.sum(one < 60) == pytest.approx(16, abs=1)
    assert np.sum(np.isfinite(two)) == 16
    assert two.min() > 100
    assert np.minimum(two, 240).mean() == pytest.approx(202, abs=8)
    assert not np.isfinite(three).any()
    sites = [life.site for life in groups["RP1"]]
    assert (sites.count("rod"), sites.count("lead")) == (19, 1)
    regions = [life.region for life in groups["RP1"]]
    assert [regions.count(r) for r in ("left", "centre", "right")] == [7, 10, 3]
    assert all(life.site == "none" and life.region is None for life in groups["RP3"])


def lifetime_table(**changed: Any) -> dict[str, Any]:
    table = copy.deepcopy(TABLE)
    table["rigs"]["shaker"]["channels"]["voltage"] = {"sample_rate_hz": 100.0}
    table["rigs"]["shaker"]["channels"]["force"] = {"sample_rate_hz": 100.0}
    group = {
        "configuration": "c",
        "prefix": "L",
        "count": 1,
        "voltage_kv": 7.5,
        "test_duration_s": 20.0,
        "shape": 3.0,
        "scale_s": 10.0,
        "specimen": {"rig": "shaker", "material": "acrylic", "pretension_n": 0.9, "geometry": GEOMETRY},
    }
    return table | {"lifetimes": [group | changed]}


def test_a_breakdown_collapses_the_voltage_and_returns_the_tension() -> None:
    (made_,) = simulate(read_campaign(lifetime_table()))
    voltage, current, force = (values(made_, q) for q in ("voltage", "leakage_current", "force"))
    start = np.flatnonzero(voltage >= 0.95 * 7.5)[0]
    last = np.flatnonzero(voltage > 0.9 * 7.5)[-1]
    assert made_.truth["failed"] is True
    assert (last - start) / 100 == pytest.approx(made_.truth["lifetime_s"], abs=0.03)
    assert np.all(voltage[last + 2 :] < 0.5 * 7.5)
    assert (voltage.size - last) / 100 == pytest.approx(2.0, abs=0.05)
    assert current[last] == pytest.approx(1.5, abs=0.3)
    assert current[last + 5] == pytest.approx(450, abs=1)
    assert force[last - 100 : last].mean() < 0.87
    assert force[-50:].mean() == pytest.approx(0.9, abs=2e-3)


def test_survivors_are_switched_off_or_raised_to_breakdown() -> None:
    (off,) = simulate(read_campaign(lifetime_table(scale_s=1e6)))
    voltage = values(off, "voltage")
    on = np.flatnonzero(voltage >= 0.95 * 7.5)
    assert (on[-1] - on[0]) / 100 == pytest.approx(20.0, abs=0.03)
    assert off.truth["failed"] is False
    assert off.recording.metadata.failure_site == "none"
    raised = lifetime_table(scale_s=1e6, raise_step_kv=0.25, raise_every_s=2.0, breakdown_kv=9.5)
    (up,) = simulate(read_campaign(raised))
    assert values(up, "voltage").max() == pytest.approx(9.5, abs=0.02)
    assert up.truth == off.truth | {"recording_id": "L-01-lifetime"}


def test_a_glitch_is_short() -> None:
    (made_,) = simulate(read_campaign(lifetime_table(scale_s=1e6, glitches=1)))
    voltage = values(made_, "voltage")
    on = np.flatnonzero(voltage >= 0.95 * 7.5)
    low = voltage[on[0] : on[-1]] < 0.5 * 7.5
    assert np.sum(low) == pytest.approx(20, abs=1)


SENSING: dict[str, Any] = {
    "rig": "shaker",
    "material": "grease",
    "active_springs": 1.4,
    "constrained_length_mm": 30.0,
    "rest_capacitance_pf": 28.6,
    "pretension_n": 0.5,
    "geometry": {
        "film_length_mm": 50.0,
        "film_thickness_mm": 1.0,
        "stretch_1": 1.5,
        "active_length_mm": 20.0,
        "active_width_mm": 30.0,
        "sensing_length_mm": 15.0,
        "sensing_width_mm": 30.0,
    },
}


def sensing_table(entry: dict[str, Any]) -> dict[str, Any]:
    table = copy.deepcopy(TABLE)
    table["materials"]["grease"] = {
        "k0_n_per_mm": 0.062,
        "k_n_per_mm": [0.04, 0.04, 0.06],
        "tau_s": [3.0, 0.4, 0.02],
        "relative_permittivity": 4.7,
    }
    rig = table["rigs"]["shaker"]
    rig |= {"clamp_mass_kg": 0.02, "damping_ratio": 0.02, "rise_time_constant_s": 0.02, "fall_time_constant_s": 0.02}
    for quantity in ("command", "voltage", "force"):
        rig["channels"][quantity]["sample_rate_hz"] = 200.0
    table["specimens"] = {"S": SENSING}
    return table | {"recordings": [{"specimens": ["S"], "id": "s"} | entry]}


def test_open_loop_capacitance_follows_an_independent_integration() -> None:
    """Three parts in series on a rigid load cell, tension and extensions by an adaptive integration."""
    entry = {"test": "step_electrical", "levels_kv": [8.0], "on_s": 10.0, "off_s": 5.0, "rest_s": 1.0}
    (made_,) = simulate(read_campaign(sensing_table(entry)))
    lengths = np.array([20.0, 15.0, 10.0])
    k0 = 0.062 * 75 / lengths
    springs = np.array([0.04, 0.04, 0.06])[None, :] * (75 / lengths)[:, None]
    springs[0] *= 1.4
    taus = np.array([3.0, 0.4, 0.02])
    maxwell = 8.8541878e-6 * 4.7 * 30 / (1 / np.sqrt(1.5))

    def voltage(t: float) -> float:
        if t < 1.0:
            return 0.0
        if t < 11.0:
            return 8 * (1 - float(np.exp(-(t - 1) / 0.02)))
        return 8 * float(np.exp(-(t - 11) / 0.02))

    def parts(t: float, points: np.ndarray) -> tuple[float, np.ndarray]:
        """Tension and extensions: unknowns of a linear system with the load cell's spring as fourth element."""
        matrix = np.zeros((4, 4))
        right = np.zeros(4)
        for j in range(3):
            matrix[j, 0], matrix[j, 1 + j] = 1.0, -(k0[j] + springs[j].sum())
            right[j] = -springs[j] @ points[j] - (maxwell * voltage(t) ** 2 if j == 0 else 0.0)
        matrix[3] = [1 / 20.0, 1.0, 1.0, 1.0]
        solved = np.linalg.solve(matrix, right)
        return float(solved[0]), solved[1:]

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        points = y.reshape(3, 3)
        _, extensions = parts(t, points)
        return ((extensions[:, None] - points) / taus).ravel()

    time = np.arange(values(made_, "capacitance").size) / 100
    solved = solve_ivp(
        rates, (0, time[-1]), np.zeros(9), t_eval=time, method="LSODA", rtol=1e-8, atol=1e-10, max_step=0.05
    )
    states = [parts(t, y.reshape(3, 3)) for t, y in zip(time, solved.y.T, strict=True)]
    expected_c = 28.6 * (1 + np.array([e[1] for _, e in states]) / 15.0)
    expected_f = 0.5 + np.array([tension for tension, _ in states])
    # the clamp rings for a moment after each edge, which the rigid truth does not
    quiet = (np.abs(time - 1) > 0.3) & (np.abs(time - 11) > 0.3)
    assert values(made_, "capacitance")[quiet] == pytest.approx(expected_c[quiet], abs=2e-4)
    assert values(made_, "force")[::2][quiet] == pytest.approx(expected_f[quiet], abs=2e-5)
    at = np.searchsorted(time, 10.9)
    assert 0.5 - values(made_, "force")[::2][at] == pytest.approx(0.044, abs=0.002)
    assert 28.6 - values(made_, "capacitance")[at] == pytest.approx(0.25, abs=0.03)


def test_closed_loop_holds_the_capacitance_while_voltage_and_force_overshoot() -> None:
    entry = {
        "test": "step_closed_loop",
        "demand_step_pf": -0.1,
        "proportional_gain": 40.0,
        "integral_gain": 120.0,
        "hold_s": 20.0,
    }
    (made_,) = simulate(read_campaign(sensing_table(entry)))
    c, demand, v, f = (values(made_, q) for q in ("capacitance", "demand", "voltage", "force"))
    time, fine = np.arange(c.size) / 100, np.arange(v.size) / 200
    assert set(np.round(np.unique(demand), 6)) == {28.5, 28.6}
    late = (time > 18) & (time < 23)
    assert c[late] == pytest.approx(28.5, abs=1e-3)
    assert v.max() > 1.2 * v[(fine > 18) & (fine < 23)].mean()
    drop = 0.5 - f
    assert drop[fine < 10].max() > 1.2 * drop[(fine > 18) & (fine < 23)].mean()
    assert v[-1] == pytest.approx(0.0, abs=1e-6)
    assert made_.recording.metadata.controller == "closed"


def test_constraint_and_geometry_set_the_share_of_the_force() -> None:
    table = sensing_table({"test": "step_electrical", "levels_kv": [8.0], "on_s": 60.0, "off_s": 1.0})
    free = copy.deepcopy(table)
    free["specimens"]["S"]["constrained_length_mm"] = 0.0
    drops = []
    for t in (table, free):
        (made_,) = simulate(read_campaign(t))
        drops.append(0.5 - values(made_, "force")[200 * 61])
    assert drops[0] / drops[1] == pytest.approx((20 / 45) / (20 / 75), rel=0.01)


def test_force_map_is_the_maxwell_stress_of_the_stretched_film() -> None:
    table = copy.deepcopy(TABLE)
    table["materials"]["acrylic"]["relative_permittivity"] = 2.6
    table["rigs"]["shaker"]["channels"] = {
        q: dict(QUIET, sample_rate_hz=100.0) for q in ("voltage", "force_1", "force_2")
    }
    table["specimens"]["A"]["geometry"] = {
        "film_thickness_mm": 1.0,
        "active_length_mm": 30.0,
        "active_width_mm": 30.0,
        "active_drawn": "undeformed",
    }
    entry = {"test": "force_map", "specimens": ["A"], "id": "m", "stretch_1": 1.2, "stretch_2": 3.0, "drive_kv": 7.0}
    (made_,) = simulate(read_campaign(table | {"recordings": [entry | {"on_s": 3.0, "off_s": 3.0, "cycles": 2}]}))
    time = np.arange(values(made_, "force_1").size) / 100
    for quantity, with_acrylic in (("force_1", 0.661), ("force_2", 0.264)):
        force = values(made_, quantity)
        drop = force[time < 0.9].mean() - force[(time > 3.5) & (time < 3.9)].mean()
        assert drop == pytest.approx(with_acrylic * 2.6 / 4.7, rel=2e-3)


def test_calibrations_show_the_clamp_alone_and_the_weights() -> None:
    entries = (
        {"test": "tap", "rigs": ["shaker"], "id": "tap"},
        {"test": "weight", "rigs": ["shaker"], "id": "weight", "masses_kg": [0.05, 0.1], "sample_rate_hz": 200},
    )
    tap, weight = made(*entries)
    ring = values(tap, "force")[int(1.1 * 2000) : int(4.9 * 2000)]
    spectrum = np.abs(np.fft.rfft(ring * np.hanning(ring.size), 1 << 18))
    f_c = np.sqrt(20.0 / 0.1874e-3) / (2 * np.pi)
    assert np.argmax(spectrum) * 2000 / (1 << 18) == pytest.approx(f_c, abs=0.02)
    early, later = (np.abs(ring[a : a + 400]).max() for a in (0, 4000))
    assert np.log(early / later) / (2 * np.pi * f_c * 2.0) == pytest.approx(0.005, rel=0.02)
    force = values(weight, "force")
    plateaus = [force[int(t * 200) : int((t + 0.4) * 200)].mean() for t in (4.5, 9.5, 14.5, 19.5)]
    assert plateaus == pytest.approx([0, 0.05 * 9.80665, 0.1 * 9.80665, 0], abs=2e-3)
    assert weight.recording.metadata.masses_kg == (0.05, 0.1)


@pytest.mark.parametrize(("specimen", "scale"), [("ST-1", 1.0), ("ST-2", 0.995)])
def test_stacks_soften_with_strain_as_measured(specimen: str, scale: float) -> None:
    """Thesis, fig 4-8: at 5 Hz 3.0 N/mm at 10 % strain and 2.3 N/mm at 50 %, while the phase hardly moves."""
    names = [f"{specimen}-cyclic-5Hz-{strain}" for strain in (0.1, 0.3, 0.5)]
    planned = {p.recording_id: p for p in THESIS.planned}
    found = [cyclic_response(simulate_one(THESIS, planned[name]).recording)[0] for name in names]
    magnitude = np.array([abs(one.value[0]) for one in found])
    phase = np.array([np.degrees(np.angle(one.value[0])) for one in found])
    assert magnitude == pytest.approx(scale * np.array([3.0, 2.52, 2.3]), rel=0.015)
    assert np.ptp(phase) < 1.0


def test_a_film_slips_where_friction_no_longer_holds_it() -> None:
    """A spring in a clamp is elastoplastic with kinematic hardening: beyond the holding force the slope is that of spring and hardening in
    series, and on the way back it holds for twice the force."""
    k0, holds, hardening = 1.0, 0.4, 0.5
    path = np.concatenate([np.linspace(0, 1, 401), np.linspace(1, 0, 401)[1:]])
    slip = Slip(holds, hardening)
    felt = slip.felt(RelaxationModel(k0, (), (), 0.0), 5 + path, 1e-3) - 5
    force = k0 * felt
    slope = k0 * hardening / (1 + hardening)
    rising = np.where(path[:401] < holds / k0, k0 * path[:401], holds + slope * (path[:401] - holds / k0))
    assert force[:401] == pytest.approx(rising, abs=2e-3)
    top, turned = rising[-1], 2 * holds / k0
    back = np.where(
        1 - path[401:] < turned, top - k0 * (1 - path[401:]), top - 2 * holds - slope * (1 - path[401:] - turned)
    )
    assert force[401:] == pytest.approx(back, abs=3e-3)
    assert np.array_equal(slip.felt(RelaxationModel(k0, (1.0,), (0.1,), 0.0), 0.1 * path, 1e-3), 0.1 * path)


def test_a_film_of_several_parts_is_refused_where_it_would_slip() -> None:
    table = copy.deepcopy(TABLE)
    table["specimens"]["A"] = table["specimens"]["A"] | {
        "active_springs": 1.4,
        "effects": {"clamp_slip": {"holds_n": 0.1}},
    }
    table["recordings"] = [
        {"test": "cyclic", "specimens": ["A"], "frequency_hz": 1.0, "strain_pp": 0.1, "sample_rate_hz": 100}
    ]
    with pytest.raises(UsageError, match="several parts"):
        list(simulate(read_campaign(table)))
