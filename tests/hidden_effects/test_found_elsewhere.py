"""What a search in some recordings found is tried in a search of others: neither may lack what the other one has."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import Chosen
from pipeline.diagnose.search.found_elsewhere import try_found_elsewhere
from pipeline.diagnose.search.posterior import Posterior, weigh_fit
from tests.helpers.plain_evidence import find_plain
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


def search(features: list[RecordingFeatures]) -> Evidence:
    """What a search finds that tries the cause alone."""
    found = find_plain(features)
    assert found.posterior is not None
    of = replace(found.plain.of, chosen=(CAUSE,))
    fit = of.fit(of.make_entries(found.plain.theta, ({"drop": 0.2},)), most=40)
    return replace(found, posterior=Posterior.of([*found.posterior.hypotheses, weigh_fit(fit)]))


def test_a_cause_that_a_search_did_not_find_is_taken_over_from_another(features: list[RecordingFeatures]) -> None:
    lacking, knowing = find_plain(features), search(features[:-1])
    posterior = try_found_elsewhere(knowing, lacking)
    assert posterior is not None
    best = posterior.hypotheses[0]
    assert best.causes == (CAUSE.id,)
    assert best.model.of.session is lacking.plain.of.session
    own = search(features).posterior
    assert own is not None
    assert best.log_joint > own.hypotheses[0].log_joint - 1


def test_a_search_that_found_nothing_has_nothing_to_tell(features: list[RecordingFeatures]) -> None:
    knowing = search(features)
    assert try_found_elsewhere(replace(knowing, posterior=None), knowing) is None
    assert try_found_elsewhere(knowing, replace(knowing, posterior=None)) is None
