"""Sweeps: against the integrated equations of motion, closed forms, and known delays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.transform.chirp import chirp_response
from pipeline.transform.respond import respond
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.recording import Channel, Recording
from tests.physics.rig_truth import SILICONE, START_NS, Sweep, Truth, filtered, recording

RATE = 2000.0
BAND = {"frequency_start_hz": 1.0, "frequency_stop_hz": 100.0, "sweep": "log"}
FORCE_NOISE, DISPLACEMENT_NOISE = 1e-3, 0.5e-3


def clock(before: float, after: float, duration: float = 20.0, rate: float = RATE) -> np.ndarray:
    return np.arange(round((before + duration + after) * rate)) / rate - before


@pytest.fixture(scope="module")
def integrated() -> tuple[Truth, np.ndarray, np.ndarray]:
    """Polyacrylate on a soft load cell, 10 s sweep: displacement and force from the equations of motion."""
    truth, sweep = Truth(), Sweep(1.0, 100.0, 10.0, 0.3)
    time = clock(0.5, 2.5, 10.0)
    return truth, sweep(time), truth.force(time, sweep, (0.0, 10.0))


def noisy(values: np.ndarray, sd: float, seed: int) -> np.ndarray:
    return values + np.random.default_rng(seed).normal(0.0, sd, values.size)


@pytest.mark.long
@pytest.mark.slow
def test_matches_the_integrated_equations_of_motion(integrated) -> None:
    truth, x, force = integrated
    errors, ratios = [], []
    for seed in range(8):
        run = recording(
            {"displacement": noisy(x, DISPLACEMENT_NOISE, seed), "force": 0.9 + noisy(force, FORCE_NOISE, 100 + seed)},
            RATE,
            repeats=1,
            **BAND,
        )
        response, warnings = chirp_response(run)
        true = truth.measured(response.frequency_hz)
        errors.append(np.abs(response.value / true - 1))
        ratios.append(np.abs(response.value - true) ** 2 / response.variance)
        assert warnings == ()
    assert response.usable.all()
    assert response.frequency_hz.size >= 40
    assert np.median(errors) < 0.0004
    assert np.quantile(errors, 0.9) < 0.001
    assert np.max(errors) < 0.003
    assert 0.9 < np.mean(ratios) < 1.3


@pytest.mark.long_after(4)
@pytest.mark.parametrize(("begin", "end"), [(0.0, 20.0), (0.4, 20.0), (0.0, 20.5)])
@pytest.mark.parametrize("what", ["stiffness", "measured"])
def test_a_record_cut_out_of_a_sweep_keeps_an_honest_variance(what: str, begin: float, end: float) -> None:
    truth, sweep = Truth(), Sweep(1.0, 112.2, 20.5, 0.3, taper_s=0.02)
    fine = np.arange(round(23 * RATE * 8)) / (8 * RATE) - 1
    force = filtered(sweep(fine), 1 / (8 * RATE), getattr(truth, what))[::8]
    time = fine[::8]
    cut = (time >= begin - 1e-9) & (time < end - 1e-9)
    errors, ratios = [], []
    for seed in range(6):
        run = recording(
            {
                "displacement": noisy(sweep(time)[cut], DISPLACEMENT_NOISE, seed),
                "force": noisy(force[cut], FORCE_NOISE, 50 + seed),
            },
            RATE,
            repeats=1,
            **BAND,
        )
        response, warnings = chirp_response(run)
        assert any("transient" in w for w in warnings)
        true = getattr(truth, what)(response.frequency_hz)
        good = response.usable
        assert good.sum() > 0.9 * good.size
        errors.append(np.abs(response.value / true - 1)[good])
        ratios.append((np.abs(response.value - true) ** 2 / response.variance)[good])
    # Free transient terms: median 0.0005, and single bins wrong by factors of up to 15.
    assert np.median(np.concatenate(errors)) < 0.0004
    assert np.concatenate(errors).max() < 0.003
    assert 0.85 < np.mean(np.concatenate(ratios)) < 1.35


def test_a_lightly_damped_resonance_narrows_the_windows() -> None:
    truth, sweep = Truth(film=SILICONE), Sweep(1.0, 100.0, 20.0, 0.3)
    time = clock(1.0, 4.0)
    fine = np.arange(time.size * 8) / (8 * RATE) - 1.0
    force = filtered(sweep(fine), 1 / (8 * RATE), truth.measured)[::8]
    run = recording(
        {"displacement": noisy(sweep(time), DISPLACEMENT_NOISE, 1), "force": noisy(force, FORCE_NOISE, 2)},
        RATE,
        repeats=1,
        **BAND,
    )
    response, _ = chirp_response(run)
    true = truth.measured(response.frequency_hz)
    near = np.abs(response.frequency_hz - 53) < 6
    assert near.sum() >= 4
    assert np.abs(response.value / true - 1)[near].max() < 0.004
    width = np.array(response.details["half_width"])
    assert width[near].min() < width[response.frequency_hz > 60].min() / 2


def test_a_known_delay_has_negative_phase() -> None:
    sweep = Sweep(1.0, 200.0, 10.0, 1.0)
    time = clock(0.5, 1.0, 10.0)
    run = recording(
        {"displacement": sweep(time), "force": 3.0 * sweep(time - 1e-3)},
        RATE,
        repeats=1,
        **{**BAND, "frequency_stop_hz": 200.0},
    )
    response, _ = chirp_response(run)
    at = np.interp(100.0, response.frequency_hz, np.degrees(np.unwrap(np.angle(response.value))))
    assert at == pytest.approx(-36.0, abs=0.05)
    assert np.abs(response.value) == pytest.approx(3.0, rel=2e-3)


@pytest.mark.parametrize("shift_ns", [137_000, 500_000 * 3 + 61_000])
def test_different_start_times_are_a_delay_not_a_rounded_sample(shift_ns: int) -> None:
    sweep = Sweep(1.0, 100.0, 10.0, 1.0)
    time = clock(0.5, 1.0, 10.0)
    late = time + shift_ns * 1e-9
    stamps = START_NS + shift_ns + np.rint(np.arange(time.size) * 1e9 / RATE).astype(np.int64)
    run = recording(
        {"displacement": sweep(time), "force": 2.0 * sweep(late)},
        RATE,
        repeats=1,
        details={"force": {"time_ns": stamps}},
        **BAND,
    )
    response, _ = chirp_response(run)
    assert np.abs(np.degrees(np.angle(response.value))).max() < 0.02


def test_a_stated_latency_is_taken_off() -> None:
    sweep = Sweep(1.0, 100.0, 10.0, 1.0)
    time = clock(0.5, 1.0, 10.0)
    channels = {"displacement": sweep(time), "force": 2.0 * sweep(time - 0.8e-3)}
    plain, _ = chirp_response(recording(channels, RATE, repeats=1, **BAND))
    told, _ = chirp_response(recording(channels, RATE, repeats=1, details={"force": {"delay_s": 0.8e-3}}, **BAND))
    assert np.degrees(np.angle(plain.value[-1])) < -25
    assert np.abs(np.degrees(np.angle(told.value))).max() < 0.02


def test_the_pole_of_a_stated_filter_is_taken_off() -> None:
    sweep, corner = Sweep(1.0, 100.0, 10.0, 1.0), 300.0
    fine = clock(0.5, 1.0, 10.0, 16 * RATE)
    slow = filtered(sweep(fine), 1 / (16 * RATE), lambda f: 1 / (1 + 1j * f / corner))[::16]
    channels = {"displacement": sweep(fine)[::16], "force": slow}
    told, _ = chirp_response(recording(channels, RATE, repeats=1, details={"force": {"filter_hz": corner}}, **BAND))
    assert np.abs(told.value - 1).max() < 2e-3


def test_several_rates_come_onto_one_clock() -> None:
    truth, sweep = Truth(load_cell=200.0, clamp_alone_hz=900.0), Sweep(1.0, 100.0, 10.0, 0.3)
    fine = clock(0.5, 1.5, 10.0, 10_000.0)
    force = filtered(sweep(fine), 1e-4, truth.measured)[::10]
    stamps = START_NS + 40_000 + np.arange(force.size) * 1_000_000
    shifted = filtered(sweep(fine + 40e-6), 1e-4, truth.measured)[::10]
    run = recording(
        {"displacement": sweep(fine), "force": shifted},
        10_000.0,
        repeats=1,
        details={"force": {"time_ns": stamps}},
        **BAND,
    )
    response, warnings = chirp_response(run)
    assert any("interpolated" in w for w in warnings)
    true = truth.measured(response.frequency_hz)
    assert np.abs(response.value / true - 1)[response.usable].max() < 2e-3


def repeated(
    gain_of_first: float = 1.0, *, period: float = 8.00013, count: int = 4
) -> tuple[Truth, dict[str, np.ndarray]]:
    truth, sweep = Truth(), Sweep(1.0, 100.0, 6.0, 0.3)
    fine = np.arange(round((1.0 + count * period) * RATE * 4)) / (4 * RATE) - 0.7
    x = sum(sweep(fine - p * period) for p in range(count))
    force = filtered(x, 1 / (4 * RATE), truth.measured)
    force = force * np.where(fine < period - 0.4, gain_of_first, 1.0)
    return truth, {"displacement": x[::4], "force": force[::4]}


@pytest.mark.slow
@pytest.mark.parametrize("told", [{"period_s": 8.0, "repeats": 4}, {"repeats": 4}, {}])
def test_repeats_are_averaged_in_synchrony(told) -> None:
    truth, clean = repeated()
    ratios, errors = [], []
    for seed in range(5):
        channels = {
            "displacement": noisy(clean["displacement"], DISPLACEMENT_NOISE, seed),
            "force": noisy(clean["force"], 5 * FORCE_NOISE, 30 + seed),
        }
        response, warnings = chirp_response(recording(channels, RATE, **told, **BAND))
        true = truth.measured(response.frequency_hz)
        errors.append(np.abs(response.value / true - 1))
        ratios.append(np.abs(response.value - true) ** 2 / response.variance)
    assert warnings == ()
    assert response.repeats == 4
    assert np.median(errors) < 0.002
    assert 0.8 < np.mean(ratios) < 1.35
    # The clock of the generator is 0.13 ms slow per period: found from the phases.
    steps = np.diff(response.details["repeat_delay_s"])
    assert np.ptp(steps) < 2e-6
    assert response.details["first_repeat"]["p_value"] > 1e-3


def test_covariance_formula_of_repeats() -> None:
    """σ_H² = |H|²[σ_Y²/|Y|² + σ_U²/|U|² − 2Re(σ_YU/(YU*))]/P at one bin, against 4000 drawn averages."""
    rng = np.random.default_rng(seed=5)
    u, h, repeats, draws = 3.0 + 1.0j, 2.0 - 1.0j, 4, 4000
    shared = rng.normal(size=(draws, repeats, 2)) @ [1, 1j] * 0.05
    nu = shared + rng.normal(size=(draws, repeats, 2)) @ [1, 1j] * 0.03
    ny = 1.5 * shared + rng.normal(size=(draws, repeats, 2)) @ [1, 1j] * 0.04
    big_u, big_y = u + nu, h * u + ny
    found = big_y.mean(1) / big_u.mean(1)
    scatter = np.std(found - found.mean()) ** 2
    var_y, var_u = 2 * (1.5**2 * 0.05**2 + 0.04**2), 2 * (0.05**2 + 0.03**2)
    cov = 2 * 1.5 * 0.05**2
    y = h * u
    formula = abs(h) ** 2 * (var_y / abs(y) ** 2 + var_u / abs(u) ** 2 - 2 * (cov / (y * np.conj(u))).real) / repeats
    assert scatter == pytest.approx(formula, rel=0.06)
    # The transform pools |Y − H U|², which is the same number: shown here on the same draws.
    rest = big_y - h * big_u
    pooled = np.mean(np.abs(rest - rest.mean(1, keepdims=True)) ** 2) * repeats / (repeats - 1) / repeats / abs(u) ** 2
    assert pooled == pytest.approx(formula, rel=0.06)


def test_a_different_first_repeat_is_reported_and_left_out() -> None:
    truth, channels = repeated(gain_of_first=1.03)
    channels = {q: noisy(v, FORCE_NOISE, i) for i, (q, v) in enumerate(channels.items())}
    response, warnings = chirp_response(recording(channels, RATE, period_s=8.0, repeats=4, **BAND))
    first = response.details["first_repeat"]
    assert first["relative_difference"] == pytest.approx(0.03, abs=0.002)
    assert first["left_out"]
    assert response.repeats == 3
    assert any("first repeat differs" in w for w in warnings)
    assert np.median(np.abs(response.value / truth.measured(response.frequency_hz) - 1)) < 0.002
    assert response.details["repeat_gain"][0] - response.details["repeat_gain"][1] == pytest.approx(0.03, abs=0.003)


def test_repeats_without_rest_are_periods() -> None:
    truth, sweep = Truth(), Sweep(1.0, 100.0, 6.0, 0.3)
    fine = np.arange(round(24.0 * RATE * 4)) / (4 * RATE)
    x = sum(sweep(fine - 6.0 * p) for p in range(4))
    force = filtered(x, 1 / (4 * RATE), truth.measured)[::4]
    run = recording(
        {"displacement": noisy(x[::4], DISPLACEMENT_NOISE, 1), "force": noisy(force, FORCE_NOISE, 2)},
        RATE,
        repeats=4,
        period_s=6.0,
        **BAND,
    )
    response, warnings = chirp_response(run)
    assert response.repeats == 3
    assert any("without rest" in w for w in warnings)
    assert np.abs(response.value / truth.measured(response.frequency_hz) - 1).max() < 0.004


def test_a_repeat_with_a_gap_is_left_out_and_single_lost_samples_are_not() -> None:
    _, channels = repeated()
    channels = {q: noisy(v, FORCE_NOISE, i) for i, (q, v) in enumerate(channels.items())}
    channels["force"][[3000, 9000]] = np.nan
    response, warnings = chirp_response(recording(channels, RATE, period_s=8.0, repeats=4, **BAND))
    assert response.repeats == 4
    assert any("2 lost samples" in w for w in warnings)
    channels["force"][20_000:20_400] = np.nan
    response, warnings = chirp_response(recording(channels, RATE, period_s=8.0, repeats=4, **BAND))
    assert response.repeats == 3
    assert any("1 repeats with gaps" in w for w in warnings)


@pytest.mark.slow
def test_a_truncated_sweep_gives_the_band_it_reached(integrated) -> None:
    truth, x, force = integrated
    cut = int(6.0 * RATE)  # the sweep has reached 12.6 Hz here
    run = recording(
        {"displacement": noisy(x[:cut], 5e-4, 1), "force": noisy(force[:cut], 1e-3, 2)}, RATE, repeats=1, **BAND
    )
    response, warnings = chirp_response(run)
    good = response.usable
    assert response.frequency_hz[good].max() < 12.6
    relative = np.abs(response.value - truth.measured(response.frequency_hz)) / response.standard_error
    assert np.median(relative[good]) < 2
    assert warnings


@pytest.mark.parametrize("stopped_s", [3.0, 4.2, 5.1, 7.0, 8.5])
def test_no_line_is_usable_that_a_stopped_sweep_did_not_reach(integrated, stopped_s: float) -> None:
    """Wherever it is stopped, after rest or not: what leaks from the cut is no response."""
    _, x, force = integrated
    for begin in (0.0, 0.5):
        first, stop = int(begin * RATE), int((0.5 + stopped_s) * RATE)
        signals = {"displacement": noisy(x[first:stop], 5e-4, 3), "force": noisy(force[first:stop], 1e-3, 4)}
        run = recording(signals, RATE, repeats=1, **BAND)
        reached_hz = 100 ** (stopped_s / 10)
        if reached_hz < 12:
            with pytest.raises(NotIdentifiableError, match=r"usable|too short"):
                chirp_response(run)
        else:
            response, _ = chirp_response(run)
            assert response.frequency_hz[response.usable].max() < reached_hz


def test_single_lost_rows_cost_a_sweep_nothing(integrated) -> None:
    """Eight rows of a file are missing in both channels, three neighbours among them."""
    truth, x, force = integrated
    ratios = []
    for seed in range(4):
        signals = {"displacement": noisy(x, 5e-4, seed), "force": noisy(force, 1e-3, 20 + seed)}
        lost = np.append(np.random.default_rng(seed).integers(700, 10_000, 6), [9000, 9001])
        for values in signals.values():
            values[lost] = np.nan
        response, warnings = chirp_response(recording(signals, RATE, repeats=1, **BAND))
        true = truth.measured(response.frequency_hz)
        assert response.usable.mean() > 0.9
        assert any("lost samples" in w for w in warnings)
        good = response.usable
        ratios.append(np.abs(response.value[good] - true[good]) ** 2 / response.variance[good])
    assert np.mean(np.concatenate(ratios)) < 1.3


@pytest.mark.parametrize(("lasted", "longer_rest_s"), [(1.05, 0.0), (1.3, 0.0), (1.49, 0.0), (1.3, 4.0)])
def test_a_test_aborted_in_its_second_sweep_gives_the_first_one(lasted: float, longer_rest_s: float) -> None:
    """What was begun and not ended is left out: the response is that of the record cut after the first rest."""
    truth, clean = repeated()
    rest = np.zeros(round(longer_rest_s * RATE))
    cut = int((0.7 + longer_rest_s + lasted * 8.0) * RATE)
    ratios = []
    for seed in range(6):
        channels = {
            "displacement": noisy(np.append(rest, clean["displacement"]), DISPLACEMENT_NOISE, seed)[:cut],
            "force": noisy(np.append(rest, clean["force"]), 5 * FORCE_NOISE, 30 + seed)[:cut],
        }
        response, warnings = chirp_response(recording(channels, RATE, period_s=8.0, repeats=4, **BAND))
        good = response.usable
        true = truth.measured(response.frequency_hz[good])
        ratios.append(np.abs(response.value[good] - true) ** 2 / response.variance[good])
        assert good.sum() >= 30
        assert response.frequency_hz[good].max() > 90
    assert np.mean(np.concatenate(ratios)) < 1.3
    assert any("ends within a further sweep" in w for w in warnings)
    assert not any("come to rest" in w or "ends with the sweep" in w for w in warnings)


@given(
    force_scale=st.floats(1e-3, 1e3),
    displacement_scale=st.floats(1e-3, 1e3),
    shift=st.integers(-(10**15), 10**15),
    level=st.floats(-10, 10),
)
@settings(max_examples=15, deadline=None)
def test_units_clock_and_offset_do_not_matter(force_scale, displacement_scale, shift, level) -> None:
    sweep = Sweep(2.0, 60.0, 4.0, 0.3)
    time = clock(0.3, 0.7, 4.0, 500.0)
    x, force = noisy(sweep(time), 1e-4, 3), noisy(sweep(time - 2e-3), 1e-4, 4)
    band = {"frequency_start_hz": 2.0, "frequency_stop_hz": 60.0, "sweep": "log", "repeats": 1}
    base, _ = chirp_response(recording({"displacement": x, "force": force}, 500.0, **band))
    changed = recording({"displacement": displacement_scale * x, "force": force_scale * (force + level)}, 500.0, **band)
    changed = replace(changed, channels={q: replace(c, time_ns=c.time_ns + shift) for q, c in changed.channels.items()})
    other, _ = chirp_response(changed)
    factor = force_scale / displacement_scale
    np.testing.assert_allclose(other.value, factor * base.value, rtol=1e-6)
    np.testing.assert_allclose(other.variance, factor**2 * base.variance, rtol=1e-3)


def test_lines_do_not_share_data(integrated) -> None:
    _, x, force = integrated
    response, _ = chirp_response(
        recording({"displacement": x, "force": noisy(force, 1e-3, 1)}, RATE, repeats=1, **BAND)
    )
    width = np.array(response.details["half_width"])
    bins = response.frequency_hz * x.size / RATE
    assert np.all(np.diff(bins) > width[1:] + width[:-1] - 1)
    assert response.effective_lines == response.frequency_hz.size


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda x, f: (x[1200:1700], f[1200:1700]), "too short"),
        (lambda x, f: (np.zeros_like(x), f), "does not move"),
        (lambda x, f: (noisy(0 * x, 1e-3, 1), noisy(0 * f, 1e-3, 2)), "noise"),
        (lambda x, f: (x, noisy(0 * f, 1e-3, 2)), "noise"),
        (lambda x, f: (x, np.clip(f, -0.2, 0.2)), "saturated"),
        (lambda x, f: (x, np.full_like(f, np.nan)), "finite|value"),
    ],
)
def test_what_cannot_carry_a_response_is_refused_with_its_reason(integrated, change, reason) -> None:
    _, x, force = integrated
    x, force = change(x, force)
    run = recording({"displacement": x, "force": force}, RATE, repeats=1, **BAND)
    with pytest.raises(NotIdentifiableError, match=reason) as caught:
        respond(run)
    assert caught.value.where == "run-1"


def test_clipping_in_a_part_of_the_sweep_marks_its_lines(integrated) -> None:
    _, x, force = integrated
    limit = 0.85 * np.abs(force).max()
    run = recording({"displacement": x, "force": np.clip(force, -limit, limit)}, RATE, repeats=1, **BAND)
    response, _ = chirp_response(run)
    marked = np.array(["clipped" in why for why in response.unusable_because])
    assert 0 < marked.sum() < marked.size / 2
    assert not response.usable[marked].any()


def broken_sweep(gaps: list[tuple[float, float]], *, kind: str, noise: float = 1e-3) -> Recording:
    """A sweep from 1 to 100 Hz in 40 s, 2 s of rest around it, on a film of two arms; its force is lost in the gaps (begin, length; s)."""
    low, high, duration, rest, rate = 1.0, 100.0, 40.0, 2.0, 1000.0
    count = int((duration + 2 * rest) * rate)
    t = np.arange(count) / rate - rest
    since = np.clip(t, 0, duration)
    growth = np.log(high / low) / duration
    turns = (
        low / growth * np.expm1(growth * since)
        if kind == "log"
        else low * since + (high - low) / (2 * duration) * since**2
    )
    x = 0.2 * np.sin(2 * np.pi * turns) * ((t >= 0) & (t <= duration))
    f = np.fft.rfftfreq(4 * count, 1 / rate)
    force = np.fft.irfft(np.fft.rfft(x, 4 * count) * two_arms(f), 4 * count)[:count]
    rng = np.random.default_rng(3)
    x, force = x + rng.normal(0, 0.2 * noise, count), 0.5 + force + rng.normal(0, 0.2 * noise, count)
    for begin, length in gaps:
        force[(t >= begin) & (t < begin + length)] = np.nan
    ns = 1_772_370_300_000_000_000 + np.arange(count) * 1_000_000
    about = {
        "recording_id": "broken", "protocol": "chirp", "loading": "mechanical", "specimen_id": "s", "sweep": kind,
        "started_at": "2026-03-01T14:05:00+01:00", "frequency_start_hz": low, "frequency_stop_hz": high,
    }  # fmt: skip
    channels = {"displacement": Channel("displacement", ns, x), "force": Channel("force", ns, force)}
    return Recording(RecordingMetadata.parse(about), RigConstants(), channels)


def two_arms(frequency_hz: np.ndarray) -> np.ndarray:
    turn = 2j * np.pi * frequency_hz * 0.05
    return np.asarray(1.0 + 0.5 * turn / (1 + turn))


@pytest.mark.parametrize("kind", ["log", "linear"])
@pytest.mark.parametrize(
    ("gaps", "lost", "least"),
    [
        ([(24.0, 0.2)], 0.2, 70),
        ([(10.0, 0.2), (30.0, 0.5)], 0.3, 60),
        ([(41.0, 0.2)], 0.05, 60),
        ([(-1.0, 0.2)], 0.05, 60),
        ([(float(begin), 0.05) for begin in range(3, 40, 4)], 0.4, 10),
    ],
    ids=["one", "two", "in the rest after", "in the rest before", "ten"],
)
def test_a_gap_in_a_sweep_costs_what_it_touches(
    gaps: list[tuple[float, float]], lost: float, least: int, kind: str
) -> None:
    """A gap of 0.2 s cost 40 % of the sweep, all that was not its longest unbroken part; and its lines must be right."""
    response, warnings = chirp_response(broken_sweep(gaps, kind=kind))
    assert any("unbroken parts are used" in warning for warning in warnings)
    assert response.usable.sum() >= least
    assert (~response.usable).sum() <= lost * response.usable.size
    assert (np.diff(response.frequency_hz) > 0).all()
    error = np.abs(response.value - two_arms(response.frequency_hz))[response.usable]
    score = error / response.standard_error[response.usable]
    assert np.sqrt(np.mean(score**2)) < 1.4
    assert score.max() < 4.5
    for name in ("half_width", "degree", "degrees_of_freedom"):
        assert len(response.details[name]) == response.frequency_hz.size
    if len(gaps) == 1 and 0 < gaps[0][0] < 40:
        assert response.frequency_hz[response.usable].min() < 2.5
        assert response.frequency_hz[response.usable].max() > 90
