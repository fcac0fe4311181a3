"""The plain model's search: where rig files are far from the truth, and how sure its film is."""

import numpy as np
import pytest

from pipeline.diagnose.diagnosis import _film_sd
from pipeline.diagnose.extend import Extended
from pipeline.diagnose.plain import fit_plain
from pipeline.diagnose.predict import Simulation
from pipeline.diagnose.reduce import reduce
from pipeline.diagnose.session import make_session
from tests.hidden_effects.truth import Effect, compact_designs
from tests.hidden_effects.truth import make_session as true_session


@pytest.mark.parametrize(("seed", "mass_error"), [(895730046, -0.39), (895730069, 0.4)])
def test_the_search_ends_at_the_film_with_a_clamp_far_from_its_file(seed: int, mass_error: float) -> None:
    """Twenty standard deviations away, and from the wrong side of the resonance."""
    truth = true_session(seed, compact_designs()[:4], (Effect("rig_constants", mass_error, {}),))
    session = make_session([reduce(r) for r in truth.recordings])
    found = fit_plain(session, Simulation(session))
    assert found.chi2 < 1.6 * session.size
    film, band = truth.truth.specimen.film, np.geomspace(1.0, 100.0, 30)
    error = np.abs(found.model.physical(found.theta).film.stiffness(band) / film.stiffness(band) - 1)
    assert error.max() < 0.02


def test_a_damper_is_surer_than_its_spring_and_time_where_only_their_product_shows() -> None:
    truth = true_session(895730046, compact_designs()[:4], ())
    session = make_session([reduce(r) for r in truth.recordings])
    simulation = Simulation(session)
    found = fit_plain(session, simulation)
    of = Extended(session, simulation, found.model, (), np.ones(session.size))
    sd, dampers = _film_sd(of.refined(of.fit(found.theta, most=3)))
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
