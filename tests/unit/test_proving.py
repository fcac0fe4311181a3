"""Which recording is worth making to see a doubt go."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.proposals.designs import Proposal
from pipeline.diagnose.proposals.proving import DoubtInTest
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.doubt import choose_demand, compute_tolerance, meets_demand
from pipeline.diagnose.search.free_quantities import FreeQuantity

TEST = Proposal({"protocol": "sphs", "loading": "electrical"}, "a test")
WAY = FreeQuantity("the actuation follows the voltage in another way", 12.0, 1, 0.08)
SPANS = FreeQuantity("the stiffness differs from recording to recording", 25.0, 9, 0.08)
SAYS = st.floats(0.0, 1e3)


def judged(says: float, add: float = 5.0, found: FreeQuantity = WAY) -> DoubtInTest:
    return DoubtInTest(TEST, 200.0, add, ((found, says),), ())


@given(says=SAYS, more=st.floats(1.0, 1e3), found=st.sampled_from([WAY, SPANS]))
def test_the_more_a_recording_says_of_a_doubt_the_better(says: float, more: float, found: FreeQuantity) -> None:
    assert judged(says + more, found=found).compute_merit() >= judged(says, found=found).compute_merit()


def test_a_recording_that_says_nothing_leaves_the_doubt_where_it_is() -> None:
    """Just as much is left as is tolerated: that is the least for which a recording is proposed."""
    alone = judged(0.0, add=1.01)
    excess = compute_tolerance(choose_demand(WAY), WAY, 200.0) * (200.0 + WAY.excess)
    assert alone.compute_merit() == pytest.approx(excess / WAY.excess, rel=0.02)
    assert alone.compute_merit() < RULES.proposal.proving
    tolerated = replace(WAY, statistic=3.0)
    assert not meets_demand(choose_demand(tolerated), tolerated, 200.0)
    assert judged(0.0, add=1.01, found=tolerated).compute_merit() > RULES.proposal.proving


def test_where_the_causes_do_not_show_nothing_is_decided() -> None:
    assert judged(1e3, add=0.9).compute_merit() == 0.0


def test_the_form_of_a_cause_shows_where_the_cause_does() -> None:
    """Of two tests that say as much of a doubt, that counts for less in which the cause is most of what is seen."""
    assert judged(60.0, add=160.0).compute_merit() < judged(60.0, add=2.0).compute_merit()


def test_the_worst_doubt_counts() -> None:
    both = DoubtInTest(TEST, 200.0, 5.0, ((WAY, 300.0), (SPANS, 0.0)), ())
    assert both.compute_merit() == judged(0.0, found=SPANS).compute_merit()


def test_what_explains_more_in_place_of_the_causes_has_to_fall_behind_by_that() -> None:
    ahead = replace(WAY, statistic=231.0)
    little, much = (DoubtInTest(TEST, 200.0, 5.0, (), ((ahead, says),)) for says in (20.0, 80.0))
    assert little.compute_merit() < RULES.proposal.proving < much.compute_merit()
    assert little.multiply(4.0).compute_merit() == replace(much, add=20.0).compute_merit()
    assert much.find_separation() == 80.0
