"""Whether the cause may be one that is in no list: quantities left free beside the causes, and in their place.

No mechanism has exactly reality's form, and a free quantity follows in part what a cause leaves. How much of that is no
reason for a doubt was read off sessions whose truth is known and of another form (`RULES.doubt`).
"""

from __future__ import annotations

from collections.abc import Sequence

from pipeline.diagnose.rules import RULES, Demand
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.free_quantities import FreeQuantity, fit_free_quantities


def choose_demand(found: FreeQuantity) -> Demand:
    """What a quantity must be for a doubt: the more numbers it has, the less does what they follow stand for one thing."""
    if found.degrees_of_freedom <= RULES.doubt.few:
        return RULES.doubt.faint
    return RULES.doubt.faint_of_some if found.degrees_of_freedom <= RULES.doubt.some else RULES.doubt.faint_of_many


def compute_tolerance(demand: Demand, found: FreeQuantity, fall: float) -> float:
    """Share of what a free quantity and the causes explain together that the form of the causes accounts for.

    Parameters
    ----------
    demand : what is asked of the quantity
    found : the quantity, beside the causes
    fall : χ² that the causes explain
    """
    weak = demand.of_weak
    return demand.share * (weak + (1 - weak) * min(1.0, fall / RULES.doubt.all_of_form)) * found.tolerated


def meets_demand(demand: Demand, found: FreeQuantity, fall: float) -> bool:
    """Whether a free quantity explains more, beside causes that explain `fall` of χ², than any form of theirs would
    leave to it."""
    return found.p_value < demand.level and found.excess > compute_tolerance(demand, found, fall) * (
        fall + found.excess
    )


def find_beside_causes(
    plain: ExtendedFit, final: ExtendedFit, alone: Sequence[FreeQuantity]
) -> tuple[FreeQuantity, ...]:
    """Free quantities that explain more beside the causes than their form leaves, and much of the same without the
    causes.

    Parameters
    ----------
    plain, final : the plain model and the one with the causes
    alone : all free quantities beside the plain model
    """
    fall = plain.chi2 - final.chi2
    in_place = {d.text for d in alone if d.excess > choose_demand(d).in_place * fall}
    return tuple(d for d in fit_free_quantities(final, in_place) if meets_demand(choose_demand(d), d, fall))


def find_instead_of_causes(
    plain: ExtendedFit, final: ExtendedFit, alone: Sequence[FreeQuantity]
) -> tuple[FreeQuantity, ...]:
    """Free quantities that explain more than the causes do, in their place.

    A listed cause is likelier from the start, and so a quantity must be better by some χ² and have few numbers: with a
    number for each recording it imitates whatever comes with time. Several causes that happen to be there at once are
    less likely, by what parts causes.
    """
    others = len(final.of.chosen) - 1
    least = plain.chi2 - final.chi2 + RULES.doubt.better - others * 2 * RULES.cause.close
    return tuple(d for d in alone if d.evidence > least and (others or d.degrees_of_freedom <= RULES.doubt.few))
