"""When a simulation is not adequate: the one rule, for sessions and for records that are asked alone.

A model with causes may be named where nothing speaks against it (`Shortfall`): no part of the data is left that neither noise nor the
form of the cause explains, no severity has ended at its limit, and none is finer than the samples are. The plain model is right
where no place is beyond the noise (`combine`), of which pages list those that are (`schemas.places`).

Does not belong here: how probable causes are (`search.posterior`), and what a verdict makes of it (`judge`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from pipeline.diagnose.rules import RULES
from schemas.numbers import percent


@dataclass(frozen=True)
class Shortfall:
    """What speaks against a model with causes.

    Parameters
    ----------
    something_else : largest probability that a part of the data is wrong by something else
    left : share of the misfit beyond the noise that it leaves; 0 where it leaves noise
    at_limit : whether a severity has ended at the largest value that is searched
    unresolved : whether a severity is finer than the samples can tell
    """

    something_else: float = 0.0
    left: float = 0.0
    at_limit: bool = False
    unresolved: bool = False

    @property
    def is_adequate(self) -> bool:
        """Whether nothing speaks against it."""
        return not any(self._list_faults())

    def describe(self) -> str:
        """What speaks against it, in words; empty where nothing does."""
        words = (
            "leaves data that something else more probably makes wrong",
            f"leaves {percent(self.left, 3)} of the misfit, which is no noise",
            "would have to be as strong as a search allows, or stronger",
            "would be finer than the samples tell",
        )
        return " and ".join(text for text, applies in zip(words, self._list_faults(), strict=True) if applies)

    def _list_faults(self) -> tuple[bool, bool, bool, bool]:
        rules = RULES.adequacy
        return self.something_else > rules.something_else, self.left > rules.left, self.at_limit, self.unresolved


def is_at_end(value: float, neutral: float, low: float, high: float) -> bool:
    """Whether a fit ended where its search does, on the side of its neutral value on which it is.

    Parameters
    ----------
    value : of the fit
    neutral : where it does nothing
    low, high : limits of the search
    """
    reach = (high if value > neutral else low) - neutral
    return reach != 0 and (value - neutral) / reach > RULES.adequacy.at_limit


def combine(p_values: Iterable[float]) -> float:
    """Probability that the noise alone makes one of several places as wrong as the worst of them is (Bonferroni).

    Parameters
    ----------
    p_values : of all places
    """
    found = list(p_values)
    return min(1.0, len(found) * min(found)) if found else 1.0
