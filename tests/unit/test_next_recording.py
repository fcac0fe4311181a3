"""How sure a recording that was not made is to tell two causes apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnose.proposals.designs import Proposal
from pipeline.diagnose.proposals.imagined import Wanted, choose_best
from pipeline.diagnose.proposals.next_recording import ENOUGH, Separation
from pipeline.diagnose.report import list_separators
from pipeline.diagnose.results import NextRecording

SAYS = st.floats(0.0, 1e4)
AHEAD = st.floats(-9.0, 9.0)


@given(if_believed=SAYS, if_alternative=SAYS, ahead=AHEAD, simpler=AHEAD)
def test_either_may_be_the_fit_believed(
    if_believed: float, if_alternative: float, ahead: float, simpler: float
) -> None:
    one, other = (
        Separation(if_believed, if_alternative, ahead, simpler),
        Separation(if_alternative, if_believed, -ahead, -simpler),
    )
    assert one.log_undecided == pytest.approx(other.log_undecided, rel=1e-9, abs=1e-12)
    assert one.log_undecided <= 1e-12


@given(if_believed=st.floats(20.0, 1e3), if_alternative=st.floats(20.0, 1e3), ahead=AHEAD, more=st.floats(1.01, 100.0))
def test_more_of_the_same_is_surer(if_believed: float, if_alternative: float, ahead: float, more: float) -> None:
    pair = Separation(if_believed, if_alternative, ahead, 0.0)
    assert pair.multiply(more).log_undecided < pair.log_undecided


@pytest.mark.parametrize(
    "pair", [Separation(14.0, 4.5, 8.3, 0.0), Separation(20.0, 20.0, 0.0, 3.0), Separation(6.0, 9.0, 4.0, -5.0)]
)
def test_it_is_the_share_of_recordings_that_leave_both(pair: Separation) -> None:
    """Against the causes themselves: one of them is drawn as likely as it is, then what χ² says with the noise it has."""
    rng = np.random.default_rng(seed=7)
    believed_is_true = rng.random(200_000) < 1 / (1 + np.exp(-pair.ahead / 2))
    says = np.where(believed_is_true, pair.if_believed, pair.if_alternative)
    ahead = np.where(believed_is_true, 1, -1) * (pair.ahead + pair.simpler)
    noise = 2 * np.sqrt(says) * rng.standard_normal(says.size)
    assert np.exp(pair.log_undecided) == pytest.approx(np.mean(says + noise + ahead < ENOUGH), abs=5e-3)


def test_what_tells_apart_is_said_of_causes_that_no_proposal_does() -> None:
    """In the words of either mechanism; a cause without words for it has none."""
    named, others = ["field_dependent_permittivity"], ["leakage", "drive_offset", "mains_hum"]
    leakage, offset = list_separators(named, others, None)
    assert leakage.startswith("field_dependent_permittivity from leakage: ")
    assert "polarities" in offset
    proposal = NextRecording(({"protocol": "step"},), "steps", 20.0, leaves=("leakage",))
    assert list_separators(named, others, proposal) == (leakage,)
    assert list_separators(named, others, NextRecording(({"protocol": "step"},), "steps", 20.0)) == ()


def test_what_says_nothing_leaves_both() -> None:
    assert np.exp(Separation(0.0, 0.0, 3.0, 0.0).log_undecided) == pytest.approx(1.0)


def test_an_alternative_that_can_imitate_the_cause_pays_for_its_parameters() -> None:
    """A delay that a lag with three parameters follows: a recording that holds these three leaves the delay alone."""
    as_free, freer = Separation(60.0, 6.0, 0.0, 0.0), Separation(60.0, 6.0, 0.0, -6.0)
    assert freer.log_undecided < as_free.log_undecided - 0.5


@dataclass(frozen=True)
class Worth:
    """A proposal that is worth so much a period."""

    proposal: Proposal
    each: float

    def compute_merit(self) -> float:
        return self.each * float(self.proposal.design["periods"])

    def multiply(self, often: float) -> Worth:
        return Worth(self.proposal, self.each * often)


SPHS = Proposal(
    {"protocol": "sphs", "loading": "electrical", "drive_kv": 5.0, "frequency_stop_hz": 100.0, "periods": 100.0},
    "an SPHS",
)


@pytest.mark.parametrize(
    ("each", "periods"), [(0.04, 100.0), (0.02, 300.0), (0.005, 1000.0), (0.0015, 1000.0), (0.0009, None)]
)
def test_longer_ones_are_proposed_only_where_shorter_ones_leave_a_doubt(each: float, periods: float | None) -> None:
    best = choose_best([SPHS], lambda p: Worth(p, each), Wanted(least=1.0, good=2.0, enough=4.0))
    assert (None if best is None else best.proposal.design["periods"]) == periods
