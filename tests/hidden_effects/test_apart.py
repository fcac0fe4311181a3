"""A film whose temperature is not the one that is recorded beside it, and causes that predict nothing of what was left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.judge import judge_session
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import Chosen
from pipeline.diagnose.search.posterior import Posterior, weigh_fit
from pipeline.diagnose.search.screen import compute_secants
from tests.helpers.plain_evidence import find_plain
from tests.helpers.truth_rig import Effect, make_session

SESSION = 104
"""Seed of a session: specimen, pauses and noise follow from it."""
TESTS = (
    *({"protocol": "chirp", "strain_pp": s} for s in (0.006, 0.05, 0.02)),
    *({"protocol": "cyclic", "strain_pp": s, "frequency_hz": 1.0, "cycles": 10} for s in (0.04, 0.12)),
    {"protocol": "chirp", "strain_pp": 0.006},
)
RISE_K = 6.0
"""What the film warms by in the end."""


@pytest.fixture(scope="module")
def warming() -> list[RecordingFeatures]:
    """A film that warms as the session goes on, without a temperature."""
    effect = Effect("thermal_softening", 4e-3, {"rise_k": RISE_K})
    return [reduce(r) for r in make_session(SESSION, TESTS, [effect]).recordings]


def beside(features: list[RecordingFeatures], temperatures: tuple[float, ...]) -> list[RecordingFeatures]:
    """The session with temperatures that were recorded beside it, °C."""
    return [replace(f, values={**f.values, "temperature_degc": t}) for f, t in zip(features, temperatures, strict=True)]


def search(features: list[RecordingFeatures], variant: str) -> Evidence:
    """What a search finds that tries warming in one variant alone."""
    found = find_plain(features)
    assert found.posterior is not None
    of = replace(found.plain.of, chosen=(Chosen("thermal_softening", variant),))
    start = {"per_kelvin": 4e-3, "time_constant_s": 600.0, "self_heating_k": 1e-3, "shift": 0.1, "rise_k": 5.0}
    fit = of.fit(of.make_entries(found.plain.theta, (start,)), most=60)
    return replace(found, posterior=Posterior.of([*found.posterior.hypotheses, weigh_fit(fit)]))


def test_a_thermometer_that_shows_the_room_does_not_hide_a_film_that_warms(warming: list[RecordingFeatures]) -> None:
    """The room was warm in the morning; the film took its heat from what it did."""
    room = beside(warming, (23.9, 23.7, 23.8, 23.6, 23.7, 23.5))
    apart, recorded = (search(room, variant).posterior for variant in ("apart", "recorded"))
    assert apart is not None
    assert recorded is not None
    best = apart.hypotheses[0]
    assert best.causes == ("thermal_softening",)
    assert best.log_joint > recorded.hypotheses[0].log_joint + 10


def test_what_is_not_recorded_is_no_question_of_its_own(warming: list[RecordingFeatures]) -> None:
    """Without a temperature both variants say the same, and only the first is asked."""
    variants = {
        name: {c.variant for c in compute_secants(find_plain(own).plain).chosen if c.id == "thermal_softening"}
        for name, own in (("none", warming), ("room", beside(warming, (23.0, 23.1, 23.1, 23.2, 23.3, 23.3))))
    }
    assert variants == {"none": {"recorded"}, "room": {"recorded", "apart"}}


@pytest.mark.parametrize(
    ("gain", "verdict"), [(0.99, "named"), (0.3, "ambiguous"), (0.05, "unknown"), (-1.0, "unknown")]
)
def test_causes_are_told_by_what_they_predict(warming: list[RecordingFeatures], gain: float, verdict: str) -> None:
    found = search(warming, "recorded")
    assert judge_session(found) == "named"
    learned = found.learn_gain(gain)
    assert judge_session(learned) == verdict
    assert learned.posterior is not None
    told = learned.posterior.named_share
    assert (told <= RULES.gain.listed_below + 1e-9) == (verdict == "unknown")
    assert sum(learned.posterior.probability.values()) == pytest.approx(1.0)
    assert np.isclose(told, RULES.gain.listed_below) == (verdict == "unknown")
