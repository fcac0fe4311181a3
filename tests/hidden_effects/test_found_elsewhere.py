"""What a search in some recordings found is tried in a search of others: neither may lack what the other one has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.diagnose.faults.fitted import fit_session
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import Chosen, Extended
from pipeline.diagnose.search.found_elsewhere import try_found_elsewhere
from pipeline.diagnose.search.patterns import test_patterns as find_patterns
from pipeline.diagnose.search.posterior import Posterior, weigh_fit
from pipeline.diagnose.search.screen import compute_secants, compute_signatures
from tests.helpers.truth_rig import Effect
from tests.helpers.truth_rig import make_session as true_session

SESSION = 101
"""Seed of a session: specimen, pauses and noise follow from it."""
TESTS = (
    *({"protocol": "chirp", "strain_pp": s} for s in (0.006, 0.05, 0.02)),
    {"protocol": "cyclic", "strain_pp": 0.12, "frequency_hz": 1.0, "cycles": 10},
)
CAUSE = Chosen("amplitude_softening", "running")


@pytest.fixture(scope="module")
def features() -> list[RecordingFeatures]:
    return [reduce(r) for r in true_session(SESSION, TESTS, [Effect("amplitude_softening", 0.2)]).recordings]


def search(features: list[RecordingFeatures], *causes: Chosen) -> Evidence:
    """What a search that tries nothing but these causes finds."""
    session, simulation, plain = fit_session(features)
    of = Extended(session, simulation, plain.model, (), np.ones(session.size))
    fit = of.refine(of.fit(plain.theta))
    signatures = compute_signatures(compute_secants(fit), fit)
    found = Evidence(fit, signatures, 0.0, 10.0, find_patterns(fit), plain=fit)
    hypotheses = [weigh_fit(fit, noise_alone=True), weigh_fit(fit)]
    for cause in causes:
        extended = replace(of, chosen=(cause,))
        hypotheses.append(weigh_fit(extended.fit(extended.make_entries(fit.theta, ({"drop": 0.2},)), most=40)))
    return replace(found, posterior=Posterior.of(hypotheses))


def test_a_cause_that_a_search_did_not_find_is_taken_over_from_another(features: list[RecordingFeatures]) -> None:
    lacking, knowing = search(features), search(features[:-1], CAUSE)
    posterior = try_found_elsewhere(knowing, lacking)
    assert posterior is not None
    best = posterior.hypotheses[0]
    assert best.causes == (CAUSE.id,)
    assert best.model.of.session is lacking.plain.of.session
    own = search(features, CAUSE).posterior
    assert own is not None
    assert best.log_joint > own.hypotheses[0].log_joint - 1


def test_a_search_that_found_nothing_has_nothing_to_tell(features: list[RecordingFeatures]) -> None:
    knowing = search(features, CAUSE)
    assert try_found_elsewhere(replace(knowing, posterior=None), knowing) is None
    assert try_found_elsewhere(knowing, replace(knowing, posterior=None)) is None
