"""What is read off the probabilities of hypotheses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.search.posterior import Hypothesis, Posterior
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
