"""The plain model's search: where rig files are far from the truth, and how sure its film is."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.diagnose.faults.fitted import fit_session
from pipeline.diagnose.features.kinds import STEP_CAPACITANCE
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.report import estimate_film_sd
from pipeline.diagnose.search.extended_model import Chosen, Extended
from pipeline.diagnose.search.fit_mechanisms import hand_over_relaxation
from pipeline.diagnose.search.plain_fit import choose_sensing, fit_plain
from pipeline.diagnose.simulation.parameters import STRAIN, STRESS, TENSION
from pipeline.diagnose.simulation.session import make_session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.film import RelaxationModel
from tests.helpers.judging import Case, made
from tests.helpers.truth_rig import Effect, compact_designs
from tests.helpers.truth_rig import make_session as true_session
from tests.helpers.truth_rig.material import Film, random_specimen
from tests.helpers.truth_rig.session import full_designs

HARD_THIRD_ARM = 700_267_027
"""Seed of a session whose third arm is hard to find."""
SLOW_FILM = 1
"""Seed of a film whose only arm is slower than the sweeps."""
FAR_CLAMP, FAR_CLAMP_TOO = 895_730_046, 895_730_069
"""Seeds of sessions whose clamps are put far from their files."""
THREE_ARMS = 1
"""Seed of a session that shows three arms of its film."""
ARM_OF_OTHERS = 971_896_718
"""Seed of three recordings whose steps of voltage show an arm that their sinusoid does not."""


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(("seed", "mass_error"), [(FAR_CLAMP, -0.39), (FAR_CLAMP_TOO, 0.4)])
def test_the_search_ends_at_the_film_with_a_clamp_far_from_its_file(seed: int, mass_error: float) -> None:
    """Twenty standard deviations away, and from the wrong side of the resonance."""
    truth = true_session(seed, compact_designs()[:4], (Effect("rig_constants", mass_error, {}),))
    session = make_session([reduce(r) for r in truth.recordings])
    found = fit_plain(session, Simulation(session))
    assert found.chi2 < 1.6 * session.size
    film, band = truth.truth.specimen.film, np.geomspace(1.0, 100.0, 30)
    error = np.abs(found.model.physical(found.theta).film.stiffness(band) / film.stiffness(band) - 1)
    assert error.max() < 0.02


@pytest.mark.long
@pytest.mark.slow
def test_a_third_arm_is_found_where_two_leave_nearly_everything() -> None:
    """A search of three arms that stops short looks as if two would do, and the third like a hidden cause."""
    session = make_session([reduce(r) for r in made(Case(HARD_THIRD_ARM), ()).recordings])
    found = fit_plain(session, Simulation(session))
    assert found.model.arms == 3
    assert found.chi2 < 1.2 * session.size


@pytest.mark.slow
def test_taps_with_a_known_mass_and_without_tell_the_mass_of_the_clamp() -> None:
    """Their frequencies are √(kL/M) and √(kL/(M + m)) of one clamp: alone, neither says what M is."""
    truth = true_session(FAR_CLAMP, compact_designs()[:4], (Effect("rig_constants", 0.08, {}),))
    taps: tuple[dict[str, Any], ...] = ({"protocol": "tap"}, {"protocol": "tap", "extra_clamp_mass_kg": 0.2})

    def mass(*designs: dict[str, Any]) -> tuple[float, float]:
        session = make_session([reduce(r) for r in truth.extended(*designs).recordings])
        found = fit_plain(session, Simulation(session))
        of = Extended(session, Simulation(session), found.model, (), np.ones(session.size))
        fit = of.refine(of.fit(found.theta, most=3))
        place = next(i for i, name in enumerate(found.model.names) if "clamp mass" in name)
        assert [n for n in found.model.names if n.startswith("rig 1")] == []
        return float(found.model.physical(fit.theta).rigs[0].mass), float(np.sqrt(fit.covariance[place, place]))

    bare, both = mass(taps[0]), mass(*taps)
    true = truth.truth.rig.hidden.law.mass
    assert abs(both[0] / true - 1) < 0.01
    assert abs(bare[0] / true - 1) > abs(both[0] / true - 1)
    assert both[1] < 0.3 * bare[1]


@pytest.mark.slow
def test_a_recording_with_a_mass_on_the_clamp_has_the_response_of_the_heavier_one() -> None:
    truth = true_session(FAR_CLAMP, compact_designs()[:4], ())
    chirp = next(d for d in compact_designs() if d["protocol"] == "chirp")
    session = make_session([reduce(r) for r in truth.extended({**chirp, "extra_clamp_mass_kg": 0.1}).recordings])
    assert session.loaded == ((0, 0.0), (0, 1e-4))
    found = fit_plain(session, Simulation(session))
    assert found.chi2 < 1.2 * session.size


def test_a_damper_is_surer_than_its_spring_and_time_where_only_their_product_shows() -> None:
    truth = true_session(FAR_CLAMP, compact_designs()[:4], ())
    session = make_session([reduce(r) for r in truth.recordings])
    simulation = Simulation(session)
    found = fit_plain(session, simulation)
    of = Extended(session, simulation, found.model, (), np.ones(session.size))
    sd, dampers = estimate_film_sd(of.refine(of.fit(found.theta, most=3)))
    film = found.model.physical(found.theta).film
    n = len(film.k)
    assert len(sd) == 1 + 2 * n
    assert len(dampers) == n
    relative = np.hypot(np.array(sd[1 : 1 + n]) / film.k, np.array(sd[1 + n :]) / film.tau)
    assert np.all(np.array(dampers) > 0)
    assert np.all(np.array(dampers) / film.c < np.sqrt(2) * relative)
    fastest = -1
    assert dampers[fastest] / film.c[fastest] < relative[fastest], (
        "arm above the band: k and tau err against each other"
    )


@pytest.mark.slow
@pytest.mark.parametrize("tau_s", [12.0, 40.0])
def test_an_arm_slower_than_every_sweep_is_found(tau_s: float) -> None:
    """To the responses it is a spring; what the mean force does over a recording tells it from one."""
    specimen = random_specimen(np.random.default_rng(SLOW_FILM), kind=None, name="S")
    film = Film(specimen.film.k0, (0.5 * specimen.film.k0,), (tau_s,))
    designs = [d for d in full_designs() if d["protocol"] in ("chirp", "cyclic") and d.get("loading") != "electrical"]
    truth = true_session(SLOW_FILM, [*designs[:2], *designs[6:7]], material=replace(specimen, film=film))
    session = make_session([reduce(r) for r in truth.recordings])
    found = fit_plain(session, Simulation(session))
    fitted = found.model.physical(found.theta).film
    assert len(fitted.k) == 1
    assert fitted.k0 == pytest.approx(film.k0, rel=0.05)
    assert fitted.tau[0] == pytest.approx(tau_s, rel=0.1)


def test_entries_of_the_mechanical_tests_alone_are_those_of_the_model_or_none() -> None:
    """A search that began at them stopped with an error where other tests had added an arm."""
    drift = Effect("humidity", 0.014, {"period_s": 1031.5})
    truth = true_session(ARM_OF_OTHERS, [compact_designs()[i] for i in (1, 3, 5)], (drift,))
    session = make_session([reduce(r) for r in truth.recordings])
    found = fit_plain(session, Simulation(session))
    assert found.model.arms == 2
    assert found.mechanical is None


@pytest.mark.parametrize("sensing", [STRAIN, TENSION, STRESS])
def test_what_a_sensing_region_follows_is_read_off_its_capacitance(sensing: str) -> None:
    """Where it was as the squared voltage while the force crept, an amplifier that lags was said to be the cause."""
    designs = [{"protocol": "chirp", "loading": "mechanical"}, {"protocol": "step", "loading": "electrical"}]
    session = make_session([reduce(r) for r in true_session(5, designs).recordings])
    simulation = Simulation(session)
    model = replace(session.base_model(1), sensing=sensing)
    # A stiff film that creeps within the plateaus, on a load cell that gives way: the three differ by far more than the noise.
    theta = model.theta(
        RelaxationModel(5.0, (2.0,), (0.5,), 0.0), log_actuation=np.log(1e-3), capacitance_per_force=1.0
    )
    noise = session.sd * np.random.default_rng(1).normal(size=session.size)
    measured = replace(session, value=simulation.predict(model, theta) + noise)
    assert choose_sensing(measured, simulation, session.base_model(1), theta).sensing == sensing


@pytest.mark.parametrize("times", [-1.0, 100.0])
def test_a_sensing_region_may_make_any_number_of_pf_of_a_newton(times: float) -> None:
    """Above 60 pF per N the search stopped at the bound of a logarithm, 80 000 standard deviations off."""
    designs = [{"protocol": "chirp", "loading": "mechanical"}, {"protocol": "step", "loading": "electrical"}]
    recordings = true_session(5, designs).recordings
    chi2 = []
    for factor in (1.0, times):
        scaled = []
        for r in recordings:
            sensed = r.channels.get("capacitance")
            if sensed is not None:
                more = sensed.values[0] + factor * (sensed.values - sensed.values[0])
                r = replace(r, channels={**r.channels, "capacitance": replace(sensed, values=more)})
            scaled.append(reduce(r))
        session, _, plain = fit_session(scaled)
        assert any(p.block.kind == STEP_CAPACITANCE for p in session.places)
        chi2.append(plain.chi2)
    assert chi2[1] == pytest.approx(chi2[0], rel=0.01)


@pytest.mark.slow
def test_a_relaxation_takes_the_place_of_an_arm_that_does_nothing() -> None:
    """A search may have lost an arm to where nothing is measured; the one next to the relaxation is needed where it is."""
    truth = true_session(THREE_ARMS, compact_designs()[:4], ())
    session = make_session([reduce(r) for r in truth.recordings])
    simulation = Simulation(session)
    found = fit_plain(session, simulation)
    film = found.model.physical(found.theta).film
    slow, k_slow = film.tau[0], film.k[0]
    idle = 1e-4, 1e-9
    theta = found.model.theta(replace(film, tau=(*film.tau[1:], idle[0]), k=(*film.k[1:], idle[1])))
    theta[found.model.film.stop :] = found.theta[found.model.film.stop :]
    of = Extended(session, simulation, found.model, (Chosen("missing_relaxation", ""),), np.ones(session.size))
    values = {"stiffness_ratio": k_slow / film.k0, "time_constant_s": slow, "spread": 1.0}
    fit = of.fit(of.make_entries(theta, (values,)), most=0)
    again = hand_over_relaxation(fit, 0)
    assert again is not None
    assert again == pytest.approx(found.theta, rel=1e-6)
