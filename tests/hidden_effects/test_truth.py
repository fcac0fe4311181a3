"""The truth rig against closed forms, and each hidden effect against what it must and must not touch."""

from __future__ import annotations

import ast
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Recording
from tests.helpers import truth_rig as truth
from tests.helpers.mechanism_ids import CONTRACT
from tests.helpers.truth_rig import KINDS, MECHANISMS, UNLISTED, Film, Rig, Session, Specimen, hide, sensors
from tests.helpers.truth_rig import design as designs
from tests.helpers.truth_rig.hidden import resolve
from tests.helpers.truth_rig.rig import TruthRig

SESSION, OTHER_SESSION, SHORT_SESSION, FULL_SESSION = 11, 12, 3, 21
HUMMING, PLAIN, SUBJECT_GIVEN = 4, 5, 0
"""Seeds of sessions: pauses and noise follow from them, and the specimen where none is given."""

Float = NDArray[np.float64]

SEVERITY_KEYS = {
    "rig_constants": {"mass_error", "stiffness_error"},
    "load_cell_damping": {"damping_ratio"},
    "drive_lag": {"rise_time_constant_s", "fall_time_constant_s", "slew_kv_per_s"},
    "amplitude_softening": {"drop", "strain_scale"},
    "cyclic_softening": {"loss", "cycles"},
    "missing_relaxation": {"stiffness_ratio", "time_constant_s"},
    "power_law_relaxation": {"exponent", "stiffness_ratio"},
    "baseline_drift": {"per_decade"},
    "thermal_softening": {"per_kelvin", "rise_k"},
    "field_dependent_permittivity": {"fraction"},
    "frequency_dependent_permittivity": {"per_decade"},
    "electrode_degradation": {"loss"},
    "slack": {"onset"},
    "strain_stiffening": {"stiffening"},
    "sensor_delay": {"delay_s", "channel"},
    "gain_error": {"gain"},
    "drive_offset": {"offset_kv"},
    "leakage": {"droop"},
    "wrinkling": {"onset_kv"},
    "clamp_slip": {"slip_force"},
    "mains_hum": {"amplitude_n"},
    "sensor_saturation": {"limit_n"},
    "passive_strip": {"ratio", "time_constant_s"},
}
SHORT = {
    "chirp": {"protocol": "chirp", "strain_pp": 0.05, "repeats": 1, "sweep_s": 4.0, "rest_s": 1.0},
    "sphs": {"protocol": "sphs", "drive_kv": 8.0, "periods": 3},
    "step": {"protocol": "step", "loading": "electrical", "drive_kv": 8.0, "cycles": 1, "on_s": 3.0, "off_s": 3.0},
    "cyclic": {"protocol": "cyclic", "strain_pp": 0.12, "cycles": 6},
    "relaxation": {
        "protocol": "step", "loading": "mechanical", "strain_pp": 0.08, "rest_s": 1.0, "hold_s": 8.0, "after_s": 1.0
    },
}  # fmt: skip
PASSIVE = (
    "load_cell_damping", "amplitude_softening", "cyclic_softening", "missing_relaxation", "power_law_relaxation",
    "slack", "strain_stiffening", "clamp_slip", "passive_strip", "edge_tear", "acoustic_resonance",
)  # fmt: skip


def specimen(kind: str, **changes: object) -> Specimen:
    return replace(truth.random_specimen(np.random.default_rng(seed=3), kind=kind), **changes)


def stiff_cell(film: Film) -> Specimen:
    """A load cell so stiff that it holds the film's end."""
    omega = 2 * np.pi * 200.0
    stiffness = 2e5 * (film.k0 + sum(film.k))
    return specimen("silicone", film=film, rig=Rig(stiffness / omega**2, stiffness, 0.05 * stiffness / omega, 1.5))


def single(subject: Specimen, design: dict[str, object]) -> Recording:
    return truth.make_session(SUBJECT_GIVEN, [design], material=subject).noise_free[0]


def values(recording: Recording, quantity: str) -> Float:
    return recording.channels[quantity].values


def preload(recording: Recording) -> float:
    return float(values(recording, "force")[0])


# ---- the plain rig against closed forms


@pytest.mark.parametrize("kind", truth.MATERIALS)
def test_plain_sweep_has_the_response_of_film_clamp_and_cell(kind: str) -> None:
    subject = specimen(kind)
    design = {"protocol": "chirp", "repeats": 1, "rest_s": 12.0, "sample_rate_hz": 4000.0, "knee_hz": 200.0}
    recording = single(subject, design)
    x, force = values(recording, "displacement"), values(recording, "force") - preload(recording)
    f = np.fft.rfftfreq(x.size, 1 / 4000.0)
    band = (f > 1.5) & (f < 90.0)
    k, rig, w = subject.film.stiffness(f), subject.rig, 2 * np.pi * f
    expected = k * rig.stiffness / (k + rig.stiffness - rig.mass * w**2 + 1j * w * rig.damping)
    measured = np.fft.rfft(force)[band] / np.fft.rfft(x)[band]
    np.testing.assert_allclose(measured, expected[band], rtol=1e-4)


@pytest.mark.parametrize("kind", truth.MATERIALS)
def test_plain_multisine_has_the_response_to_voltage_squared(kind: str) -> None:
    subject = specimen(kind)
    recording = single(subject, {"protocol": "sphs", "period_s": 1.0, "frequency_start_hz": 1.0, "periods": 40})
    last = slice(-1000, None)
    squared = np.fft.rfft(values(recording, "voltage")[last] ** 2)
    lines = np.arange(1, 100, 2)
    assert np.abs(squared[2:100:2]).max() < 1e-9 * np.abs(squared[lines]).max()
    measured = -np.fft.rfft(values(recording, "force")[last])[lines] / squared[lines]
    k, rig, w = subject.film.stiffness(lines.astype(float)), subject.rig, 2 * np.pi * lines
    geometry = subject.geometry
    thickness = geometry["film_thickness_mm"] / np.sqrt(geometry["stretch_1"])
    maxwell = 8.8541878e-6 * subject.permittivity * geometry["active_width_mm"] / thickness
    share = geometry["active_length_mm"] / geometry["total_length_mm"]
    expected = maxwell * share * rig.stiffness / (k + rig.stiffness - rig.mass * w**2 + 1j * w * rig.damping)
    np.testing.assert_allclose(measured, expected, rtol=1e-4)


def test_plain_relaxation_is_the_sum_of_exponentials() -> None:
    film = Film(0.8, (0.5, 1.2), (3.0, 0.15))
    subject = stiff_cell(film)
    recording = single(subject, {"protocol": "step", "loading": "mechanical", "hold_s": 20.0, "ramp_s": 0.2})
    height = 0.05 * subject.length_mm
    t = np.arange(values(recording, "force").size) / 250.0 - 8.0
    held = (t > 0.3) & (t < 20.1)
    # A half-cosine ramp of length r excites an arm as a step would, times π²/2 (1 + e^a)/(a² + π²), a = r/τ.
    expected = np.full(held.sum(), film.k0)
    for k, tau in zip(film.k, film.tau, strict=True):
        a = 0.2 / tau
        expected += k * np.exp(-t[held] / tau) * np.pi**2 / 2 * (1 + np.exp(a)) / (a**2 + np.pi**2)
    np.testing.assert_allclose(values(recording, "force")[held] - preload(recording), height * expected, rtol=1e-4)


def test_plain_cycles_agree_with_an_adaptive_integrator() -> None:
    subject = specimen("polyacrylate")
    recording = single(subject, {"protocol": "cyclic", "frequency_hz": 3.0, "cycles": 4})
    film, rig, amplitude, w = subject.film, subject.rig, 0.02 * subject.length_mm, 6 * np.pi
    k, tau = np.array(film.k), np.array(film.tau)

    def rates(t: float, y: Float) -> Float:
        moving = 1.0 < t < 1 + 4 / 3
        x = amplitude * (1 - np.cos(w * (t - 1))) if moving else 0.0
        v = amplitude * w * np.sin(w * (t - 1)) if moving else 0.0
        pull = film.k0 * (x - y[0]) + y[2:].sum() - rig.stiffness * y[0] - rig.damping * y[1]
        return np.concatenate([[y[1], pull / rig.mass], k * (v - y[1]) - y[2:] / tau])

    t = np.arange(values(recording, "force").size) / 250.0
    solution = solve_ivp(rates, (0, t[-1]), np.zeros(5), t_eval=t, method="LSODA", rtol=1e-9, atol=1e-11, max_step=0.02)
    expected = rig.stiffness * solution.y[0]
    error = values(recording, "force") - preload(recording) - expected
    assert np.abs(error).max() < 1e-4 * np.abs(expected).max()


def test_capacitance_follows_the_compliance_of_the_film() -> None:
    film = Film(0.5, (0.7,), (0.4,))
    subject = stiff_cell(film)
    recording = single(subject, {"protocol": "step", "loading": "electrical", "drive_kv": 6.0, "edge_s": 0.004})
    t = np.arange(values(recording, "capacitance").size) / 500.0 - 1.0
    on = (t > 0.02) & (t < 4.9)
    slow = film.tau[0] * (film.k0 + film.k[0]) / film.k0
    compliance = 1 / film.k0 - film.k[0] / (film.k0 * (film.k0 + film.k[0])) * np.exp(-(t[on] - 0.002) / slow)
    strain = subject.force_per_voltage_squared * 36.0 * compliance / subject.length_mm
    change = values(recording, "capacitance") / values(recording, "capacitance")[0] - 1
    np.testing.assert_allclose(change[on], -strain, rtol=1e-3)
    force = values(recording, "force")[on & (t > 1)] - preload(recording)
    np.testing.assert_allclose(force, -subject.force_per_voltage_squared * 36.0, rtol=1e-4)


# ---- effects


@cache
def rig_with(id: str | None, severity: float | None, kind: str = "polyacrylate") -> TruthRig:
    """A specimen with one effect, scaled as in a session of the five short tests."""
    base = truth.make_session(PLAIN, [SHORT["cyclic"], SHORT["chirp"], SHORT["step"]], material=kind).truth
    effects = () if id is None else (hide(id, severity),)
    hidden = resolve(effects, base.specimen, base.plain, np.random.default_rng(seed=1))
    return TruthRig(base.specimen, hidden, base.plain)


@cache
def signals(id: str | None, test: str, severity: float | None = None) -> dict[str, Float]:
    """Signals of a test on a fresh specimen, force from where it rests."""
    rig = rig_with(id, severity)
    subject = rig.specimen
    plan = designs.plan(SHORT[test], length_mm=subject.length_mm, fastest_s=min(subject.film.tau))
    found = rig.run(plan, rig.fresh(), np.random.default_rng(seed=2)).values
    names = {"chirp": "df", "sphs": "vf", "step": "vfc", "cyclic": "dfc", "relaxation": "df"}[test]
    chosen = [name for name in ("displacement", "voltage", "force", "capacitance") if name[0] in names]
    return {name: found[name] - (found[name][0] if name == "force" else 0.0) for name in chosen}


def distance(id: str, test: str, severity: float | None = None) -> float:
    """Change of a test's samples by an effect in standard deviations of the noise of a 20 N rig, all together."""
    noise = {"displacement": 4e-4, "voltage": 2.5e-3, "force": 1.5e-3, "capacitance": 2e-3}
    plain, changed = signals(None, test), signals(id, test, severity)
    return max(float(np.linalg.norm(changed[name] - plain[name])) / noise[name] for name in plain)


def test_every_mechanism_of_the_contract_can_be_hidden_and_five_more() -> None:
    assert set(MECHANISMS) == set(CONTRACT)
    assert len(UNLISTED) >= 5
    assert not set(UNLISTED) & set(CONTRACT)


@pytest.mark.long_after(18)
@pytest.mark.parametrize("id", KINDS)
def test_effect_shows_where_it_should_and_leaves_the_rest_alone(id: str) -> None:
    kind = KINDS[id]
    found = {test: distance(id, test) for test in SHORT}
    for test in kind.shows:
        assert found[test] > 25, (test, found)
    largest = max(found.values())
    for test in kind.silent:
        assert found[test] <= max(3.0, 0.015 * largest), (test, found)


@pytest.mark.parametrize("id", [id for id, kind in KINDS.items() if kind.silent == ("chirp", "cyclic", "relaxation")])
def test_electrical_effects_do_not_touch_mechanical_tests_at_all(id: str) -> None:
    assert all(distance(id, test) == 0 for test in ("chirp", "cyclic", "relaxation"))


@pytest.mark.long_after(12)
@pytest.mark.parametrize("id", [id for id in KINDS if id != "edge_tear"])
def test_effect_vanishes_with_its_severity(id: str) -> None:
    tests = [test for test in SHORT if distance(id, test) > 10]
    assert tests
    for test in tests[:2]:
        typical, strong = distance(id, test), distance(id, test, KINDS[id].strong)
        small = distance(id, test, 1e-3 * KINDS[id].typical)
        assert small < 0.02 * typical, (test, small, typical)
        assert strong > 1.1 * typical, (test, typical, strong)


@pytest.mark.parametrize("id", KINDS)
def test_severity_zero_is_the_plain_session_to_the_last_bit(id: str) -> None:
    plain, zero = tiny_session(), tiny_session((id, 0.0))
    for a, b in zip(plain.recordings, zero.recordings, strict=True):
        assert a.metadata == b.metadata
        assert a.rig == b.rig
        for name in a.channels:
            np.testing.assert_array_equal(values(a, name), values(b, name))


@pytest.mark.parametrize("form", ["shift", "two_pole"])
@pytest.mark.parametrize("delay_s", [5e-6, 2.8e-5, 4e-4])
def test_delay_shorter_than_a_step_is_one(form: str, delay_s: float) -> None:
    step, hz = 1e-4, 100.0
    time = np.arange(0.0, 1.0, step)
    seen = sensors.delayed(np.sin(2 * np.pi * hz * time), step, delay_s, form)[time >= 0.5]
    s = 2j * np.pi * hz
    found = 2j * np.mean(seen * np.exp(-s * time[time >= 0.5]))
    expected = np.exp(-s * delay_s) if form == "shift" else 1 / (1 + s * delay_s / 2) ** 2
    assert abs(found - expected) < 1e-3 * abs(1 - expected)


def test_effects_compose() -> None:
    both = tiny_session(("clamp_slip", 0.6), ("field_dependent_permittivity", 0.1))
    slip, field = tiny_session(("clamp_slip", 0.6)), tiny_session(("field_dependent_permittivity", 0.1))
    assert set(both.truth.equivalent) == {"clamp_slip", "field_dependent_permittivity"}
    np.testing.assert_array_equal(values(both.noise_free[0], "force"), values(slip.noise_free[0], "force"))
    both_drop, field_drop = (np.ptp(values(s.noise_free[1], "force")) for s in (both, field))
    assert both_drop == pytest.approx(field_drop, rel=0.02)
    assert both_drop < 0.97 * np.ptp(values(slip.noise_free[1], "force"))


@pytest.mark.parametrize("id", [None, *PASSIVE])
def test_film_gives_back_no_more_than_it_took(id: str | None) -> None:
    severity = None if id is None else KINDS[id].strong
    found = signals(id, "cyclic", severity)
    x, force = found["displacement"], found["force"]
    work = np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(x))
    stored = np.ptp(x) * np.ptp(force)
    assert work[-1] > 1e-3 * stored
    assert work.min() > -1e-3 * stored


@pytest.mark.parametrize("id", CONTRACT)
def test_severity_is_given_in_the_keys_of_the_contract(id: str) -> None:
    said = tiny_session((id, KINDS[id].typical)).truth.equivalent[id]
    assert set(said) >= SEVERITY_KEYS[id]


def test_random_shapes_stay_within_their_ranges() -> None:
    rng = np.random.default_rng(seed=0)
    for id, kind in KINDS.items():
        effect = truth.random_effect(id, kind.typical, rng)
        assert set(effect.shape) == set(kind.ranges)
        tiny_hidden = resolve((effect,), specimen("silicone"), rig_with(None, None).plain, rng)
        assert id in tiny_hidden.equivalent


def test_wrong_effects_are_refused() -> None:
    with pytest.raises(ValueError, match="no effect 'rust'"):
        hide("rust")
    with pytest.raises(ValueError, match="has no"):
        hide("slack", 0.5, colour="red")
    with pytest.raises(ValueError, match="severity"):
        hide("slack", -0.5)
    with pytest.raises(ValueError, match="twice"):
        tiny_session(("slack", 0.5), ("slack", 0.6))


# ---- sessions


@cache
def tiny_session(*effects: tuple[str, float]) -> Session:
    """Three short recordings."""
    plan = [
        {"protocol": "cyclic", "strain_pp": 0.05, "frequency_hz": 2.0, "cycles": 3},
        {"protocol": "step", "loading": "electrical", "on_s": 1.0, "off_s": 1.0, "cycles": 1},
        {"protocol": "cyclic", "strain_pp": 0.01, "frequency_hz": 2.0, "cycles": 3},
    ]
    return truth.make_session(SESSION, plan, effects, material="polyacrylate")


@pytest.fixture(scope="module")
def full() -> Session:
    return truth.full_session(FULL_SESSION)


def test_full_session_has_what_a_diagnosis_asks_for(full: Session) -> None:
    kinds = [(r.metadata.protocol, r.metadata.loading) for r in full.recordings]
    assert len(full.recordings) == 30
    assert kinds.count(("chirp", "mechanical")) == 8
    assert len({d["strain_pp"] for d in full.designs if d["protocol"] == "chirp"}) == 3
    assert full.designs[0]["strain_pp"] == full.designs[-1]["strain_pp"]
    assert len({d["drive_kv"] for d in full.designs if d["protocol"] == "sphs"}) == 4
    assert all("command" in r.channels for r in full.recordings if r.metadata.protocol == "sphs")
    assert len({d["drive_kv"] for d in full.designs if d["protocol"] == "step" and d["loading"] == "electrical"}) == 4
    assert ("step", "mechanical") in kinds
    starts = [r.start_ns for r in full.recordings]
    assert all(later > r.end_ns for later, r in zip(starts[1:], full.recordings, strict=False))


def test_sessions_are_small(full: Session) -> None:
    def megabytes(session: Session) -> float:
        arrays = [c.values for r in (*session.recordings, *session.noise_free) for c in r.channels.values()]
        clocks = {id(c.time_ns): c.time_ns for r in session.recordings for c in r.channels.values()}
        return sum(a.nbytes for a in (*arrays, *clocks.values())) / 1e6

    compact = truth.compact_session(HUMMING, ["mains_hum"])
    assert len(compact.recordings) == 10
    assert megabytes(full) < 25
    assert megabytes(compact) < 10


def test_metadata_and_constants_are_those_of_the_contract(full: Session) -> None:
    for recording in full.recordings:
        assert RecordingMetadata.parse(recording.metadata.to_text()) == recording.metadata
        assert RigConstants.parse(recording.rig.to_text()) == recording.rig
        assert recording.start_ns == round(recording.metadata.started_at.timestamp() * 1e9)


@pytest.mark.parametrize("seed", range(12))
def test_true_constants_lie_within_the_file(seed: int) -> None:
    subject = truth.random_specimen(np.random.default_rng(seed))
    file, rig = subject.rig_file, subject.rig
    for true, key in (
        (1e3 * rig.mass, "clamp_mass_kg"),
        (rig.stiffness, "load_cell_stiffness_n_per_mm"),
        (rig.damping, "load_cell_damping_n_s_per_mm"),
        (rig.amplifier_gain, "amplifier_gain_kv_per_v"),
    ):
        assert abs(true - file[key]) <= 2.05 * file[f"{key}_sd"]
    assert 45 < rig.clamp_frequency_hz < 61
    assert list(subject.film.tau) == sorted(subject.film.tau, reverse=True)


def test_film_is_never_slack_in_a_plain_session(full: Session) -> None:
    assert full.truth.rig.hidden.law.preload > 1.1 * full.truth.plain.fall
    assert max(values(r, "force").max() for r in full.recordings) < full.recordings[0].rig.load_cell_range_n


def test_same_seed_same_session_and_effects_leave_the_noise_alone() -> None:
    tiny_session.cache_clear()
    first = tiny_session()
    tiny_session.cache_clear()
    again, other = tiny_session(), tiny_session(("gain_error", 0.01))
    for a, b, c in zip(first.recordings, again.recordings, other.recordings, strict=True):
        for name in a.channels:
            assert values(a, name).tobytes() == values(b, name).tobytes()
        assert a.metadata == c.metadata
    noise = [values(s.recordings[0], "force") - values(s.noise_free[0], "force") for s in (first, other)]
    assert np.abs(noise[0] - noise[1]).max() <= first.recordings[0].channels["force"].resolution
    different = truth.make_session(OTHER_SESSION, [SHORT["cyclic"]], material="polyacrylate")
    assert different.truth.specimen != first.truth.specimen


def test_noise_is_as_stated_coloured_and_quantised(full: Session) -> None:
    for recording, clean in list(zip(full.recordings, full.noise_free, strict=True))[::5]:
        for name, channel in recording.channels.items():
            noise = channel.values - values(clean, name)
            assert noise.std() == pytest.approx(recording.rig.noise_sd[name], rel=0.06)
            steps = channel.values / channel.resolution
            np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)
    noise = values(full.recordings[2], "force") - values(full.noise_free[2], "force")
    power = np.abs(np.fft.rfft(noise)) ** 2
    assert power[1:8].mean() > 5 * power[power.size // 2 :].mean()


def test_softening_with_amplitude_has_its_drop_at_the_largest_amplitude() -> None:
    cycles = {"protocol": "cyclic", "strain_pp": 0.12, "cycles": 8, "frequency_hz": 0.5}

    def swing(*effects: tuple[str, float]) -> float:
        recording = truth.make_session(SHORT_SESSION, [cycles], effects, material="silicone").noise_free[0]
        return float(np.ptp(values(recording, "force")[-1250:-250]))

    assert swing(("amplitude_softening", 0.2)) == pytest.approx(0.8 * swing(), rel=0.03)


def test_drift_meets_the_logarithm() -> None:
    step = {"protocol": "step", "loading": "electrical", "drive_kv": 0.0, "cycles": 3}
    recording = truth.make_session(SHORT_SESSION, [step], [("baseline_drift", 0.05)]).noise_free[0]
    force, rest = values(recording, "force"), preload(recording)
    assert force[20 * 500] == pytest.approx(rest * (1 - 0.05 * np.log10(21)), rel=1e-9)
    assert np.all(np.diff(force) < 0)


def test_damage_stays_and_softening_with_amplitude_does_not() -> None:
    small, large = {"protocol": "cyclic", "strain_pp": 0.01}, {"protocol": "cyclic", "strain_pp": 0.12}

    def swings(effect: str) -> list[float]:
        session = truth.make_session(SHORT_SESSION, [small, large, small], [effect], material="polyacrylate")
        return [float(np.ptp(values(r, "force")[750:2250])) for r in session.noise_free]

    before, _, after = swings("cyclic_softening")
    assert after < 0.97 * before
    before, _, after = swings("amplitude_softening")
    assert after == pytest.approx(before, rel=1e-6)


def test_exposure_and_warming_carry_on_through_the_session() -> None:
    step = {"protocol": "step", "loading": "electrical", "cycles": 2}
    session = truth.make_session(
        SHORT_SESSION, [step, SHORT["cyclic"], step], ["electrode_degradation", "thermal_softening"]
    )
    first, last = (r for r in session.noise_free if r.metadata.protocol == "step")
    assert values(last, "capacitance")[0] == pytest.approx(values(first, "capacitance")[-1], rel=1e-9)
    assert values(last, "capacitance")[0] < 0.95 * values(first, "capacitance")[0]
    warm = session.make_recording("cyclic", temperature=True, rest_before_s=3000.0)
    assert values(warm, "temperature").mean() == pytest.approx(23 + 5.0, abs=0.6)


# ---- designs of further recordings


def test_further_recordings_continue_the_session() -> None:
    session = tiny_session(("cyclic_softening", 0.2))
    longer = session.extended({"protocol": "cyclic", "strain_pp": 0.01, "frequency_hz": 2.0, "cycles": 3})
    assert longer.recordings[:-1] == session.recordings
    assert len(session.recordings) == 3
    assert longer.recordings[-1].start_ns > longer.recordings[-2].end_ns
    proposed = session.make_recording("cyclic", strain_pp=0.01, frequency_hz=2.0, cycles=3)
    np.testing.assert_array_equal(values(proposed, "force"), values(longer.recordings[-1], "force"))
    damaged = values(longer.noise_free[-1], "force") - values(longer.noise_free[-1], "force")[0]
    fresh = values(tiny_session().noise_free[-1], "force") - values(tiny_session().noise_free[-1], "force")[0]
    assert np.ptp(damaged) < 0.97 * np.ptp(fresh)


def test_mass_on_the_clamp_lowers_the_frequency_of_a_tap() -> None:
    session = tiny_session()
    rig = session.truth.specimen.rig

    def frequency(**design: float) -> float:
        recording = session.extended({"protocol": "tap", "taps": 1, "tap_every_s": 8.0, **design}).noise_free[-1]
        ringing = values(recording, "force")
        crossings = np.flatnonzero((ringing[:-1] < 0) & (ringing[1:] >= 0))
        exact = crossings - ringing[crossings] / (ringing[crossings + 1] - ringing[crossings])
        return float((crossings.size - 1) / (exact[-1] - exact[0]) * 2000.0)

    assert frequency() == pytest.approx(rig.clamp_frequency_hz, rel=1e-4)
    heavier = np.sqrt(rig.stiffness / (rig.mass + 1e-4)) / (2 * np.pi)
    assert frequency(extra_clamp_mass_kg=0.1) == pytest.approx(heavier, rel=1e-4)
    changed = session.make_recording("chirp", extra_clamp_mass_kg=0.1)
    assert (changed.metadata.extra_clamp_mass_kg, changed.rig) == (
        0.1,
        replace(session.recordings[0].rig, noise_sd=changed.rig.noise_sd),
    )


def test_weights_show_the_gain_of_the_force_channel() -> None:
    session = tiny_session(("gain_error", 0.08))
    recording = session.extended({"protocol": "weight", "masses_kg": (0.05, 0.1), "plateau_s": 2.0}).noise_free[-1]
    force = values(recording, "force")
    assert force[350] == pytest.approx(1.08 * 0.05 * 9.80665, rel=1e-6)
    assert force[550] == pytest.approx(1.08 * 0.1 * 9.80665, rel=1e-6)
    assert force[50] == force[-1] == 0


def test_longer_film_rests_at_higher_tension_and_is_not_slack() -> None:
    plain, slack = (
        truth.make_session(SHORT_SESSION, [SHORT["cyclic"]], effects, material="polyacrylate")
        for effects in ((), [("slack", 1.0)])
    )

    def swing(session: Session, extension: float) -> tuple[Recording, Float]:
        recording = session.extended({**SHORT["cyclic"], "pre_extension_mm": extension}).noise_free[-1]
        return recording, values(recording, "force") - preload(recording)

    (flat, flat_swing), (held, held_swing) = swing(slack, 0.0), swing(slack, 6.0)
    rig, film = slack.truth.specimen.rig, slack.truth.specimen.film
    raised = 6.0 * film.k0 * rig.stiffness / (film.k0 + rig.stiffness)
    assert preload(held) == pytest.approx(preload(flat) + raised, rel=1e-6)
    assert values(held, "displacement")[0] == 0
    assert held.metadata.total_length_mm == pytest.approx(flat.metadata.total_length_mm + 6.0)
    expected = swing(plain, 0.0)[1]
    np.testing.assert_allclose(held_swing, expected, atol=1e-6)
    assert np.abs(flat_swing - expected).max() > 0.05


def test_tears_lower_the_stiffness_in_steps() -> None:
    cycles = {"protocol": "cyclic", "strain_pp": 0.05, "cycles": 20, "frequency_hz": 2.0}
    torn, whole = (
        truth.make_session(SHORT_SESSION, [cycles], effects, material="silicone").noise_free[0]
        for effects in ([("edge_tear", 0.2)], ())
    )
    # From peak to peak, where silicone has relaxed.
    peaks = 250 + 63 + 125 * np.arange(20)
    ratio = (values(torn, "force")[peaks] - preload(torn)) / (values(whole, "force")[peaks] - preload(whole))
    falls = -np.diff(ratio)
    assert ratio[0] == pytest.approx(1)
    assert 0.78 < ratio[-1] < 0.86
    # The clamp rings for a while after each jump.
    assert 1 <= np.sum(falls > 0.02) <= 3
    assert np.sum(np.abs(falls) < 1e-3) >= 10


def test_polarity_tells_an_offset_of_the_drive() -> None:
    session = tiny_session(("drive_offset", 0.3))
    drops = []
    for polarity in (1, -1):
        design = {"protocol": "step", "loading": "electrical", "cycles": 1, "polarity": polarity}
        drops.append(float(np.ptp(values(session.extended(design).noise_free[-1], "force"))))
    assert drops[0] > 1.1 * drops[1]


@pytest.mark.parametrize(
    ("design", "complaint"),
    [
        ({"protocol": "chirp", "volume": 3}, "volume"),
        ({"protocol": "creep"}, "creep"),
        ({"protocol": "chirp", "loading": "electrical"}, "electrical"),
        ({}, "None"),
    ],
)
def test_designs_that_are_none_are_refused(design: dict[str, object], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        tiny_session().extended(design)


def test_truth_shares_no_code_with_the_pipeline() -> None:
    allowed = ("schemas.metadata", "schemas.recording", "tests.helpers.truth_rig", "numpy", "scipy", "numba")
    for path in Path(truth.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert not name.startswith(("pipeline", "ingest", "reports")), (path.name, name)
                assert name.startswith(allowed) or not name.startswith(("schemas", "tests")), (path.name, name)
