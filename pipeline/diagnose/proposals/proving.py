"""What to measure next where causes may be none of the list: the recording in which the doubt itself would be decided.

A doubt is a quantity that explains something, left free beside the causes or in their place. Were it real, it would
show in a further recording as far as the causes do not take it up and their forms are known; were it chance, the
recording would say so, and the causes would explain more. The recording proposed is that after which, were the causes
true, least of a doubt would be left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pipeline.diagnose.proposals.designs import LITTLE_WARMER_K, Proposal, list_proposals, select_showing
from pipeline.diagnose.proposals.imagined import Seen, Wanted, choose_best, imagine_session
from pipeline.diagnose.results import NextRecording
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.doubt import choose_demand, compute_tolerance
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.free_quantities import FreeQuantity

_NOTHING = 1e-3
"""χ² that is nothing."""


def propose_proving(
    plain: ExtendedFit, final: ExtendedFit, beside: Sequence[FreeQuantity], instead: Sequence[FreeQuantity]
) -> NextRecording | None:
    """The test after which least of a doubt would be left, were the causes the right ones; None where too much would.

    Parameters
    ----------
    plain, final : the plain model and the one with the causes
    beside, instead : free quantities that explain something beside the causes, and more than they do in their place
    """

    def judge(proposal: Proposal) -> DoubtInTest | None:
        made = imagine_session(final, proposal)
        if made is None:
            return None
        believed, without = (Seen.of_fit(*made, fit) for fit in (final, plain))
        whiten, added = made[0].whiten, believed.values - without.values
        return DoubtInTest(
            proposal,
            plain.chi2 - final.chi2,
            without.measure_shown(added, added),
            tuple((d, believed.measure_shown(whiten(d.compute_change(believed.of, final.x)), added)) for d in beside),
            tuple(
                (d, without.measure_against(believed.values - whiten(d.compute_change(without.of, plain.x))))
                for d in instead
            ),
        )

    least = RULES.proposal.proving
    causes = [c.mechanism for c in final.of.chosen[:1]]
    warmer_k = LITTLE_WARMER_K if any(c.mechanism.warms for c in final.of.chosen) else None
    best = choose_best(
        select_showing(list_proposals(final.of.session, warmer_k), causes),
        judge,
        Wanted(least, least, least),
    )
    if best is None:
        return None
    names = " and ".join(c.id for c in final.of.chosen)
    goes = "goes" if len(final.of.chosen) == 1 else "go"
    return NextRecording(
        best.proposal.designs, f"{best.proposal.text}: shows whether {names} {goes} on", best.find_separation()
    )


@dataclass(frozen=True)
class DoubtInTest:
    """A proposal, and what it would say of the quantities that cast a doubt; all in χ².

    Parameters
    ----------
    proposal : the test
    fall : what the causes explain so far
    add : what they would explain in the test
    beside : each quantity beside the causes, and what the test would say of it
    instead : each quantity in place of the causes, and what the test would say against it
    """

    proposal: Proposal
    fall: float
    add: float
    beside: tuple[tuple[FreeQuantity, float], ...]
    instead: tuple[tuple[FreeQuantity, float], ...]

    def compute_merit(self) -> float:
        """What is tolerated of the worst quantity over what would be left of it, were the causes true.

        0 where the causes do not show in the test: what they do there nobody has seen.
        """
        beside = [self._over_left(d, says) for d, says in self.beside]
        worst = min([*beside, *(self._over_ahead(d, says) for d, says in self.instead)])
        return worst if self.add > RULES.proposal.shown else 0.0

    def _over_left(self, found: FreeQuantity, says: float) -> float:
        # The further recording has nothing of it, so that its best value goes down with what is known of it; but the
        # form has.
        statistic = found.statistic / (1 + says / found.statistic)
        excess, fall = (
            max(statistic - found.degrees_of_freedom, _NOTHING) + RULES.proposal.form_of_added * self.add,
            self.fall + self.add,
        )
        return compute_tolerance(choose_demand(found), found, fall) * (fall + excess) / excess

    def _over_ahead(self, found: FreeQuantity, says: float) -> float:
        return says / (2 * RULES.cause.close + max(found.evidence - self.fall, 0.0))

    def find_separation(self) -> float:
        """χ² that the test would say of the doubts or, where these are about recordings made, of the causes."""
        return min([*(says or self.add for _, says in self.beside), *(says for _, says in self.instead)])

    def multiply(self, often: float) -> DoubtInTest:
        """What so many times the data would say at most."""

        def more(found: tuple[tuple[FreeQuantity, float], ...]) -> tuple[tuple[FreeQuantity, float], ...]:
            return tuple((d, often * says) for d, says in found)

        return replace(self, add=often * self.add, beside=more(self.beside), instead=more(self.instead))
