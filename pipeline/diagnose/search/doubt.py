"""Whether what explains the data might be none of the listed causes: quantities left free beside those, and in their place.

No form of a cause is exactly reality's, and what it leaves a free quantity follows in part. How much of that is no reason for a
doubt was read off sessions whose truth is known and of another form.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.free_quantities import FreeQuantity, fit_free_quantities
from pipeline.diagnose.search.several_causes import CLOSE


@dataclass(frozen=True)
class Demand:
    """What a quantity left free beside the causes must be, for them to be none or in doubt.

    level : probability below which it differs
    share : of what it and the causes explain together, over the share that forms of right causes leave
    of_weak : the part of it for causes that explain next to nothing; what is small follows no other course than the first order of
        its form
    """

    level: float
    share: float
    of_weak: float

    def tolerates(self, found: FreeQuantity, fall: float) -> float:
        """Share of what a quantity and causes that explain `fall` of χ² explain together, up to which it is their form."""
        return self.share * (self.of_weak + (1 - self.of_weak) * min(1.0, fall / _ALL_OF_FORM)) * found.tolerated

    def met_by(self, found: FreeQuantity, fall: float) -> bool:
        """Whether a quantity explains, left free, beside causes that explain `fall` of χ² a share that no form of theirs does."""
        return found.p_value < self.level and found.excess > self.tolerates(found, fall) * (fall + found.excess)


@dataclass(frozen=True)
class Doubt(Demand):
    """The same for a doubt. `in_place` : share of what the causes explain that it must explain in their place: it stands for them then."""

    in_place: float


_ALL_OF_FORM = 1000.0
"""χ² that causes explain from which all that forms differ by is tolerated."""
SURE, DOUBT = Demand(1e-4, 1.0, 0.5), Doubt(0.03, 0.6, 0.25, 0.5)
DOUBT_OF_SOME, DOUBT_OF_MANY = replace(DOUBT, level=5e-3), Doubt(2e-3, 0.6, 0.5, 1.0)
"""For `unknown`, and for a doubt by quantities of very few numbers, of a number for each recording, say, and of many: the more numbers,
the less does what they follow stand for one thing."""
_FEW = 12
"""Numbers up to which a quantity left free stands for one thing; with more it follows a little of everything."""
_BETTER, _FEWEST = 2.0, 3
"""χ² by which a quantity left free, alone, must explain more than one cause for a doubt, for a listed one is likelier from the start;
and its numbers at most: more imitate, with a number for each recording, whatever comes with time. Two causes that happen to be
there at once are less likely, by as much as parts causes, and what explains all of both has any number of numbers."""


def choose_doubt(found: FreeQuantity) -> Doubt:
    """What a quantity has to be for a doubt, by how many numbers it has."""
    if found.degrees_of_freedom <= _FEWEST:
        return DOUBT
    return DOUBT_OF_SOME if found.degrees_of_freedom <= _FEW else DOUBT_OF_MANY


def find_beside_causes(
    plain: ExtendedFit, final: ExtendedFit, alone: Sequence[FreeQuantity]
) -> tuple[FreeQuantity, ...]:
    """Quantities left free beside the causes that are no form of theirs, and explain much of the same without them, `alone`."""
    fall = plain.chi2 - final.chi2
    stands = {d.text for d in alone if d.excess > choose_doubt(d).in_place * fall}
    return tuple(d for d in fit_free_quantities(final, stands) if choose_doubt(d).met_by(d, fall))


def find_instead_of_causes(
    plain: ExtendedFit, final: ExtendedFit, alone: Sequence[FreeQuantity]
) -> tuple[FreeQuantity, ...]:
    """Quantities left free that explain, alone, more than the causes do."""
    others = len(final.of.chosen) - 1
    least = plain.chi2 - final.chi2 + _BETTER - others * 2 * CLOSE
    return tuple(d for d in alone if d.evidence > least and (others or d.degrees_of_freedom <= _FEWEST))
