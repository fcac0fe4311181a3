"""What is read off the probabilities of hypotheses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Chosen, ExtendedFit
from pipeline.diagnose.search.posterior import Hypothesis, Posterior, believe
from pipeline.diagnose.search.several_causes import choose_bases

EVIDENCE = st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=12)


def make_posterior(evidence: list[float]) -> Posterior:
    return Posterior.of(
        Hypothesis(str(i), e, -1.0, None, None, np.ones(1), np.zeros(1)) for i, e in enumerate(evidence)
    )


@given(EVIDENCE, st.floats(0.5, 0.999))
def test_probabilities_sum_to_one_and_the_set_is_the_smallest_that_holds_enough(
    evidence: list[float], enough: float
) -> None:
    posterior = make_posterior(evidence)
    assert sum(posterior.probability.values()) == pytest.approx(1.0)
    chosen = posterior.find_set(enough)
    held = [posterior.probability[h.name] for h in chosen]
    assert sum(held) >= enough - 1e-9
    assert sum(held[:-1]) < enough + 1e-9
    assert held == sorted(held, reverse=True)


def make_hypothesis(name: str, evidence: float) -> Hypothesis:
    return Hypothesis(name, evidence, 0.0, None, None, np.ones(1), np.zeros(1))


def test_two_ends_of_one_search_take_no_other_causes_place_as_a_base() -> None:
    """A lag that only a strong softening hides was never tried beside it."""
    found = [
        make_hypothesis(*h) for h in (("cyclic_softening", -1.0), ("cyclic_softening", -1.1), ("drive_lag", -50.0))
    ]
    assert [(h.name, h.log_evidence) for h in choose_bases(found)] == [("cyclic_softening", -1.0), ("drive_lag", -50.0)]


def test_of_one_name_the_best_counts() -> None:
    twice = Posterior.of(make_hypothesis("slack", e) for e in (-3.0, -1.0, -2.0))
    assert [h.log_evidence for h in twice.hypotheses] == [-1.0]


def test_variants_share_what_is_believed_of_their_mechanism() -> None:
    """Two variants that do as well are believed as one mechanism without variants is; a variant that fails takes half of it along."""

    @dataclass(frozen=True)
    class Fitted:
        of: SimpleNamespace

    def make_variant(variant: str, evidence: float) -> Hypothesis:
        chosen = Chosen("drive_lag", variant)
        fit = cast(ExtendedFit, Fitted(SimpleNamespace(chosen=(chosen,))))
        return replace(make_hypothesis("drive_lag", evidence), fit=fit, log_prior=believe((chosen,), noise_alone=False))

    one, other = (make_variant(v, -7.0) for v in MECHANISMS["drive_lag"].variants)
    whole = -7.0 + np.log(RULES.prior.listed / len(MECHANISMS))
    [both] = Posterior.of([one, other, one]).hypotheses
    assert both.log_joint == pytest.approx(whole)
    assert Posterior.of([one]).hypotheses[0] is one
    [best] = Posterior.of([one, replace(other, log_evidence=-50.0)]).hypotheses
    assert best.log_joint == pytest.approx(whole - np.log(2))
    assert best.log_evidence == -7.0
