"""Predictions of several films at once, and from few nodes, against the plain ones: a search must not go another way for its speed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import pytest

from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.mechanisms import MECHANISMS, make_effect
from pipeline.diagnose.search.plain_fit import fit_plain
from pipeline.diagnose.simulation.effects import NONE, Effect
from pipeline.diagnose.simulation.families import Family
from pipeline.diagnose.simulation.parameters import BaseModel
from pipeline.diagnose.simulation.session import Session, make_session
from pipeline.diagnose.simulation.simulation import Simulation
from tests.helpers.judging import Case, made

SESSION = 4_242
"""Seed of a session: specimen, pauses and noise follow from it."""

FORMS = [(id, variant) for id, m in MECHANISMS.items() for variant in m.forms]
SHARE = 1e-3
"""What few nodes may miss of what a cause changes, root mean square; causes' forms are wrong by far more."""
NOISE = 0.02
"""What they may miss beside, in standard deviations of the noise."""


@dataclass(frozen=True)
class _Fitted:
    """A session, its simulation from all nodes with onsets as its film has them, and its plain model at θ."""

    session: Session
    simulation: Simulation
    model: BaseModel
    theta: np.ndarray


@lru_cache(maxsize=1)
def fitted() -> _Fitted:
    session = make_session([reduce(r) for r in made(Case(SESSION), ()).recordings])
    simulation = Simulation(session)
    found = fit_plain(session, simulation)
    physical = found.model.physical(found.theta)
    return _Fitted(session, simulation.measured_against(physical), found.model, found.theta)


def effect(id: str, variant: str) -> Effect:
    """A clear one: three tenths up the plausible range of each parameter."""
    values = {p.name: p.low + 0.3 * (p.high - p.low) for p in MECHANISMS[id].list_parameters(variant)}
    return make_effect(id, values, variant)


@pytest.mark.long_after(1)
@pytest.mark.slow
@pytest.mark.parametrize(("id", "variant"), FORMS)
def test_several_at_once_are_as_one_by_one(id: str, variant: str) -> None:
    of = fitted()
    about = of.simulation.about(of.model.physical(of.theta))
    thetas = of.theta + 1e-4 * np.eye(of.theta.size)[::3]
    one_by_one = np.array([about.predict(of.model, theta, effect(id, variant)) for theta in thetas])
    # Another simulation: this one remembers.
    fresh = of.simulation.about(of.model.physical(of.theta))
    at_once = fresh.predict_several(of.model, thetas, effect(id, variant))
    assert np.abs(of.session.whiten((at_once - one_by_one).T)).max() < 1e-8


@pytest.mark.long_after(23)
@pytest.mark.slow
@pytest.mark.parametrize(("id", "variant"), [("", ""), *FORMS])
def test_few_nodes_do_about_the_film_that_they_are_for(id: str, variant: str) -> None:
    of = fitted()
    own = effect(id, variant) if id else NONE
    theta = of.theta + 0.02
    about = of.simulation.about(of.model.physical(of.theta))
    whole, few = (s.predict(of.model, theta, own) for s in (of.simulation, about))
    plain = of.simulation.predict(of.model, theta)
    missed, changed = (of.session.whiten(v) for v in (few - whole, whole - plain))
    assert np.linalg.norm(missed) < SHARE * np.linalg.norm(changed) + NOISE * np.sqrt(missed.size)


@pytest.mark.slow
def test_a_resonance_that_few_nodes_do_not_carry_is_simulated_with_all() -> None:
    """A clamp a fifth lighter with a tenth of the damping, asked of nodes for the fitted one: not a digit is lost."""
    of = fitted()
    about = of.simulation.about(of.model.physical(of.theta))
    theta = of.theta.copy()
    for i, name in enumerate(of.model.names):
        if "load-cell damping" in name:
            theta[i] = of.model.entries[i].low
        if "clamp mass" in name:
            theta[i] -= 6.0
    # A film that hardly damps.
    theta[1 : 1 + of.model.arms] -= 5.0
    whole, few = (s.predict(of.model, theta) for s in (of.simulation, about))
    assert np.array_equal(whole, few)
    assert not np.array_equal(*(s.predict(of.model, of.theta + 1e-3) for s in (of.simulation, about)))


@pytest.mark.slow
def test_few_nodes_are_few() -> None:
    """A third of them at most, in every family that has many."""
    of = fitted()
    physical = of.model.physical(of.theta)
    many = [f for f in of.simulation._families if isinstance(f, Family) and f.frequency.size > 500]
    assert many
    for family in many:
        few = family.with_few_nodes(physical)
        assert few is not None
        assert few.frequency.size < family.frequency.size / 3
