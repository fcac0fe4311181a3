"""What to measure next where causes may be none of the list: the recording in which the doubt itself would be decided.

A doubt is a quantity that explains something, left free beside the causes or in their place. Were it real, it would show in a further
recording as far as the causes do not take it up and their forms are known; were it chance, the recording would say so, and the
causes would explain more. The recording proposed is that after which, were the causes true, least of a doubt would be left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pipeline.diagnose.proposals.designs import LITTLE_WARMER_K, Proposal, catalogue, showing
from pipeline.diagnose.proposals.imagined import Seen, Wanted, best_of, made_up
from pipeline.diagnose.results import NextRecording
from pipeline.diagnose.search.departures import Departure
from pipeline.diagnose.search.doubt import of_number
from pipeline.diagnose.search.extend import ExtendedFit
from pipeline.diagnose.search.further import CLOSE

_ENOUGH = 1.0
"""What is tolerated of a quantity over what would be left of it, from which a recording is proposed; a longer one only where no other
comes to that, for the more it says the more the forms differ."""
_OF_FORM = 0.02
"""Share of what causes add in a recording that a quantity follows of what their forms differ by."""
_SHOWN = 1.0
"""χ² that causes must add in a recording for them to show there."""
_OF_WARMTH = "thermal_softening"
_NOTHING = 1e-3
"""χ² that is nothing."""


def proving_recording(
    plain: ExtendedFit, final: ExtendedFit, beside: Sequence[Departure], instead: Sequence[Departure]
) -> NextRecording | None:
    """The test after which least of the doubts would be left, were the causes believed the right ones; None where too much would.

    beside, instead : quantities that explain something beside the final model, and more than its causes in their place
    """

    def judge(proposal: Proposal) -> _Judged | None:
        made = made_up(final, proposal)
        if made is None:
            return None
        believed, rival = (Seen.of_fit(*made, fit) for fit in (final, plain))
        whiten, cause = made[0].whiten, believed.values - rival.values
        return _Judged(
            proposal,
            plain.chi2 - final.chi2,
            rival.shown(cause, cause),
            tuple((d, believed.shown(whiten(d.change(believed.of, final.x)), cause)) for d in beside),
            tuple((d, rival.against(believed.values - whiten(d.change(rival.of, plain.x)))) for d in instead),
        )

    causes = [c.mechanism for c in final.of.chosen[:1]]
    warmer_k = LITTLE_WARMER_K if any(c.id == _OF_WARMTH for c in final.of.chosen) else None
    best = best_of(showing(catalogue(final.of.session, warmer_k), causes), judge, Wanted(_ENOUGH, _ENOUGH, _ENOUGH))
    if best is None:
        return None
    names = " and ".join(c.id for c in final.of.chosen)
    goes = "goes" if len(final.of.chosen) == 1 else "go"
    return NextRecording(
        best.proposal.designs, f"{best.proposal.text}: shows whether {names} {goes} on", best.separation()
    )


@dataclass(frozen=True)
class _Judged:
    """A proposal, with what causes explain so far, `fall`, what they would `add`, and what the recording would say of each quantity
    beside them, and against each in their place; all in χ²."""

    proposal: Proposal
    fall: float
    add: float
    beside: tuple[tuple[Departure, float], ...]
    instead: tuple[tuple[Departure, float], ...]

    def merit(self) -> float:
        """What is tolerated of a quantity over what would be left of it, were the causes true; of the worst. Nothing where the causes do
        not show: what they do there nobody has seen."""
        beside = [self._over_left(d, says) for d, says in self.beside]
        worst = min([*beside, *(self._over_ahead(d, says) for d, says in self.instead)])
        return worst if self.add > _SHOWN else 0.0

    def _over_left(self, found: Departure, says: float) -> float:
        # The further recording has nothing of it, so that its best value goes down with what is known of it; but the form has.
        statistic = found.statistic / (1 + says / found.statistic)
        excess, fall = max(statistic - found.degrees_of_freedom, _NOTHING) + _OF_FORM * self.add, self.fall + self.add
        return of_number(found).tolerates(found, fall) * (fall + excess) / excess

    def _over_ahead(self, found: Departure, says: float) -> float:
        return says / (2 * CLOSE + max(found.evidence - self.fall, 0.0))

    def separation(self) -> float:
        """χ² that the recording would say of the doubts or, where these are of recordings made, of the causes."""
        return min([*(says or self.add for _, says in self.beside), *(says for _, says in self.instead)])

    def times(self, often: float) -> _Judged:
        def more(found: tuple[tuple[Departure, float], ...]) -> tuple[tuple[Departure, float], ...]:
            return tuple((d, often * says) for d, says in found)

        return replace(self, add=often * self.add, beside=more(self.beside), instead=more(self.instead))
