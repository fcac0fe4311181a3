"""Sweeps over time: what the kernels of features make of a force without the kernels, and the film's strain as a sweep passes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.faults.undo import stretch_clock
from pipeline.diagnose.features import blocks, chirp
from pipeline.diagnose.features.kinds import CHIRP_HARMONIC, CHIRP_RESPONSE
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.features.sweep_kernels import Piece, SpectrumReader, SweepReader, bands_of, harmonics_of
from pipeline.diagnose.search.detectable import discount_further_arms
from pipeline.diagnose.search.extended_model import Chosen, Extended, compose_chosen
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.search.screen import compute_secants, compute_signatures
from pipeline.diagnose.simulation.session import Session, make_session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.diagnose.simulation.sweep_courses import SweepCourse
from pipeline.diagnose.simulation.sweeps import SweepFamily
from pipeline.physics.film import RelaxationModel
from tests.helpers.truth_rig import Effect
from tests.helpers.truth_rig import Session as TrueSession
from tests.helpers.truth_rig import make_session as true_session

SESSION, SESSION_OF_SWEEPS_AND_CYCLES = 613, 101
"""Seeds of sessions: specimen, pauses and noise follow from them."""

SWEEPS: tuple[dict[str, Any], ...] = tuple({"protocol": "chirp", "strain_pp": s} for s in (0.006, 0.05))
CYCLES: tuple[dict[str, Any], ...] = ({"protocol": "cyclic", "strain_pp": 0.08, "frequency_hz": 1.0, "cycles": 10},)
BENDING: Mapping[str, Mapping[str, float]] = {
    "sensor_saturation": {"overload": 0.2, "softness": 0.03},
    "clamp_slip": {"overload": 0.2, "hardening": 0.5, "creep_s": 0.01},
}


@pytest.mark.slow
@given(
    seed=st.integers(0, 10_000),
    rest=st.integers(20, 400),
    after=st.integers(1, 600),
    high_hz=st.floats(20.0, 120.0),
    falling=st.booleans(),
)
def test_a_reader_is_what_the_kernels_are(seed: int, rest: int, after: int, high_hz: float, falling: bool) -> None:
    rng, interval, low_hz, duration_s = np.random.default_rng(seed), 1e-3, 2.0, 2.0
    t = np.arange(round(duration_s / interval)) * interval
    rate = np.log(high_hz / low_hz) / duration_s
    sweep = np.sin(2 * np.pi * low_hz * np.expm1(rate * t) / rate)
    moved = np.concatenate([np.zeros(rest), sweep[::-1] if falling else sweep, np.zeros(after)])
    moved += 1e-4 * rng.normal(size=moved.size)
    piece = Piece(moved, rest, rest + t.size, interval, low_hz, high_hz)
    bands = bands_of(piece)
    harmonics = harmonics_of(piece, bands)
    force = rng.normal(size=moved.size).cumsum()
    response, harmonic = SweepReader(piece, bands.moment, bands.frequency).read(force)
    assert response == pytest.approx(bands.kernels @ force, rel=1e-8, abs=1e-9 * np.abs(response).max())
    if harmonics is None:
        assert harmonic.size == 0
    else:
        wanted = harmonics.kernels @ force
        assert harmonic == pytest.approx(wanted, rel=1e-7, abs=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("factor", [0.9, 0.9407, 1.25])
def test_a_sweep_whose_clock_is_put_right_is_read_by_the_same_kernels(factor: float) -> None:
    """Its windows were those of the old clock at frequencies of the new one: another number of harmonics ended the diagnosis."""
    (recording,) = (r for r in true_session(SESSION, SWEEPS[:1]).recordings)
    features = reduce(recording)
    mended = stretch_clock(stretch_clock(features, factor), 1.0)
    blocks_of = {kind: [b for b in mended.blocks if b.kind == kind] for kind in (CHIRP_RESPONSE, CHIRP_HARMONIC)}
    before = [b for b in features.blocks if b.kind == CHIRP_RESPONSE]
    for was, response, harmonic in zip(before, blocks_of[CHIRP_RESPONSE], blocks_of[CHIRP_HARMONIC], strict=True):
        nodes = np.geomspace(0.1, 1e3, 60)
        force = np.random.default_rng(4).normal(size=response.support["piece_mm"].size).cumsum()
        seen = SweepCourse(response, nodes * factor).read(force)
        assert seen.size == response.size + harmonic.size + 1
        np.testing.assert_allclose(seen, SweepCourse(was, nodes).read(force), rtol=1e-9, atol=1e-9 * np.abs(seen).max())
        assert response.support["piece_s"] * factor == pytest.approx(was.support["piece_s"])
        assert harmonic.support["within_hz"].max() <= 0.41 * factor / was.support["piece"][2]


def test_a_spectrum_is_read_as_the_force_that_it_is() -> None:
    rng, count, inside = np.random.default_rng(3), 2500, slice(5, 260)
    t = np.arange(2000) * 1e-3
    moved = np.concatenate([np.zeros(300), np.sin(2 * np.pi * (2 * t + 12 * t**2)), np.zeros(200)])
    piece = Piece(moved, 300, 2300, 1e-3, 2.0, 100.0)
    bands = bands_of(piece)
    reader = SweepReader(piece, bands.moment, bands.frequency)
    spectrum = rng.normal(size=255) + 1j * rng.normal(size=255)
    whole = np.zeros(count // 2 + 1, dtype=complex)
    whole[inside] = spectrum
    force = np.fft.irfft(whole, count)
    response, harmonic = reader.read(force)
    wanted = np.concatenate([response.real, response.imag, harmonic.real, harmonic.imag, [force[300:2300].mean()]])
    assert harmonic.size > 0
    assert SpectrumReader(reader, inside).read(spectrum) == pytest.approx(
        wanted, rel=1e-9, abs=1e-12 * np.abs(wanted).max()
    )


def film_of(truth: TrueSession) -> RelaxationModel:
    film = truth.truth.specimen.film
    return RelaxationModel(film.k0, tuple(film.k), tuple(film.tau), 0.0)


def test_the_force_over_time_is_that_of_a_time_domain_rig() -> None:
    """Through a resonance that has no time to build up: the truth integrates its equations of motion, and shares no code."""
    truth = true_session(SESSION, SWEEPS[1:], ())
    session = make_session([reduce(r) for r in truth.recordings])
    simulation = Simulation(session)
    found = fit_plain(session, simulation)
    physical = found.model.physical(found.theta)
    (family,) = (f for f in simulation._families if isinstance(f, SweepFamily))
    linear = family.linear(physical, compose_chosen((), ()))
    force = truth.noise_free[0].channels["force"].values
    force = force - force[:100].mean()
    for sweep in family._sweeps:
        course = sweep.course
        wave = course.wave(course.at_bins(linear.response[:1])[0] * course.input)
        moving = wave[course.piece.start : course.piece.end]
        places = np.lib.stride_tricks.sliding_window_view(force, moving.size)
        # The record is thinned to where the sweep ends; the truth is not.
        assert force.size >= moving.size
        at = int(np.argmax(places @ moving))
        error = np.linalg.norm(places[at] - moving) / np.linalg.norm(moving)
        assert error < 0.03
    steady = np.abs(linear.response).max() * session.scale.strain * session.scale.length_mm
    assert simulation.loads(physical).reading_n == pytest.approx(
        float(np.abs(truth.noise_free[0].channels["force"].values).max()), rel=0.03
    )
    assert steady > 1.2 * np.abs(force).max(), "a sweep in which the resonance builds up shows nothing here"


def test_a_sweep_over_time_is_whole_where_it_begins() -> None:
    """The largest strain is at the lowest frequencies, a few oscillations that hold much below their own: where slack begins."""
    truth = true_session(SESSION, SWEEPS[1:], ())
    session = make_session([reduce(r) for r in truth.recordings])
    (family,) = (f for f in Simulation(session)._families if isinstance(f, SweepFamily))
    for sweep in family._sweeps:
        course, piece = sweep.course, sweep.course.piece
        moved = piece.input - piece.input[: piece.start].mean()
        first = slice(piece.start, piece.start + round(1.5 / piece.interval_s))
        apart = course.wave(course.input)[first] - moved[first]
        assert np.abs(apart).max() < 0.02 * np.abs(moved).max()


@pytest.mark.long_after(1)
@pytest.mark.slow
@pytest.mark.parametrize("overload", [0.05, 0.1, 0.3])
def test_slack_begins_as_in_time(overload: float) -> None:
    """From a few peaks of a passing resonance on: where the film rings, the tension is not |k| times the strain.

    The truth bends as b/(1 − b), the mechanism as e^b − 1: half the width bends alike.
    """
    softness, residual = 0.15, 0.03
    effects = (Effect("slack", overload, {"residual": residual, "softness": softness}),)
    truth, slack = (true_session(SESSION, SWEEPS[1:], hidden) for hidden in ((), effects))
    session = make_session([reduce(r) for r in truth.recordings])
    simulation = Simulation(session)
    found = fit_plain(session, simulation)
    physical = found.model.physical(found.theta)
    (family,) = (f for f in simulation._families if isinstance(f, SweepFamily))
    loads = simulation.loads(physical)
    floor = float(slack.truth.equivalent["slack"]["preload_n"])
    values = {"overload": loads.fall_n / floor - 1, "residual": residual, "softness": softness / 2}
    effect = compose_chosen((Chosen("slack", ""),), (values,))
    passed = family._passed(family.linear(physical, effect), physical, effect, loads)
    before, after = (t.noise_free[0].channels["force"] for t in (truth, slack))
    change = np.fft.rfft(after.values - before.values)
    hz = np.fft.rfftfreq(before.values.size, float(np.median(np.diff(before.time_ns))) / 1e9)
    # About the resonance: what slack does to the mean is read off elsewhere.
    change[(hz < 60) | (hz > 110)] = 0.0
    true = np.fft.irfft(change, before.values.size)
    simulated = np.concatenate([s.course.wave(p.force) for s, p in zip(family._sweeps, passed, strict=True)])
    assert np.linalg.norm(simulated) == pytest.approx(np.linalg.norm(true), rel=0.3)


@pytest.fixture(scope="module")
def mixed() -> tuple[TrueSession, Session]:
    truth = true_session(SESSION_OF_SWEEPS_AND_CYCLES, (*SWEEPS, *CYCLES), ())
    return truth, make_session([reduce(r) for r in truth.recordings])


@pytest.mark.slow
@pytest.mark.parametrize("id", BENDING)
def test_parts_of_a_session_are_simulated_as_within_the_whole(mixed: tuple[TrueSession, Session], id: str) -> None:
    """Sweeps and groups of cycles are left out as wholes: what stays of a recording must not change."""
    truth, session = mixed
    simulation = Simulation(session)
    film = film_of(truth)
    model = session.base_model(len(film.k))
    theta = model.theta(film)
    effect = compose_chosen((Chosen(id, ""),), (BENDING[id],))
    whole = simulation.predict(model, theta, effect)
    for odd in (0, 1):
        keep = [p.state % 2 == odd for p in session.places]
        part = session.part(keep)
        rows = np.concatenate([np.arange(p.first, p.stop) for p, k in zip(session.places, keep, strict=True) if k])
        found = Simulation(part, simulation).predict(model, theta, effect)
        apart = (found - whole[rows]) / session.sd[rows]
        assert float(np.abs(apart).max()) < 0.05 * float(
            np.abs((whole - simulation.predict(model, theta)) / session.sd).max()
        )


@pytest.mark.long
@pytest.mark.slow
def test_an_arm_that_the_model_could_still_have_is_nothing_to_find() -> None:
    """Below the highest order a relaxation has to be told from one arm more."""
    truth = true_session(SESSION_OF_SWEEPS_AND_CYCLES, (*SWEEPS, *CYCLES), ())
    session = make_session([reduce(r) for r in truth.recordings])
    simulation = Simulation(session)
    lengths = []
    for order in (1, 3):
        found = fit_plain(session, simulation, order=order)
        of = Extended(session, simulation, found.model, (), np.ones(session.size))
        fit = of.refine(of.fit(found.theta, most=3))
        looked = compute_signatures(compute_secants(fit), fit)
        lengths.append((looked, discount_further_arms(fit, looked).length))
    (looked, beyond), (full, unchanged) = lengths
    assert np.array_equal(unchanged, full.length)
    relaxing = np.array([c.id in ("missing_relaxation", "power_law_relaxation") for c in looked.chosen])
    assert np.array_equal(beyond[~relaxing], looked.length[~relaxing])
    weak = relaxing & looked.weak
    assert np.all(beyond[weak] < 0.7 * looked.length[weak])


MANY_SWEEPS = {"protocol": "chirp", "strain_pp": 0.03, "repeats": 7}


@pytest.mark.long
@pytest.mark.slow
def test_of_many_sweeps_each_is_read_with_those_just_before_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Read with all the others, seven cost five times as much as need be and twenty fifteen times: the square of their number."""
    truth = true_session(SESSION, (MANY_SWEEPS,), ())
    seen: list[int] = []

    class Counted(blocks.Functionals):
        def __init__(self, kernels: np.ndarray, first: int, count: int, interval_s: float) -> None:
            seen.append(count)
            super().__init__(kernels, first, count, interval_s)

    monkeypatch.setattr(blocks, "Functionals", Counted)
    found, counts = {}, {}
    for remembered in (chirp._REMEMBERED, 99):
        monkeypatch.setattr(chirp, "_REMEMBERED", remembered)
        seen.clear()
        session = make_session([reduce(r) for r in truth.recordings])
        found[remembered], counts[remembered] = session, sum(seen)
    few, whole = found.values()
    assert [p.block.label for p in few.places] == [p.block.label for p in whole.places]
    assert np.array_equal(few.value, whole.value)
    assert few.covariate("time_s") == pytest.approx(whole.covariate("time_s"))
    fitted = fit_plain(whole, Simulation(whole))
    one, other = (Simulation(s).predict(fitted.model, fitted.theta) for s in (few, whole))
    assert np.abs((one - other) / whole.sd).max() < 0.05
    assert few.sd == pytest.approx(whole.sd, rel=0.05)
    read, all_read = counts.values()
    assert read < 0.6 * all_read


def test_what_is_left_of_a_sweep_without_its_response_is_simulated() -> None:
    """A part of a session is left out to be predicted: of a single sweep the response may be."""
    truth = true_session(SESSION, SWEEPS[1:], ())
    session = make_session([reduce(r) for r in truth.recordings])
    found = fit_plain(session, Simulation(session))
    rest = session.part([p.block.kind != CHIRP_RESPONSE for p in session.places])
    assert CHIRP_HARMONIC in rest.kinds
    slips = compose_chosen((Chosen("clamp_slip", ""),), ({"overload": 0.2, "hardening": 0.5, "creep_s": 0.01},))
    assert np.isfinite(Simulation(rest).predict(found.model, found.theta, slips)).all()
