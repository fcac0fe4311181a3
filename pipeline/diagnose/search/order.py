"""The film's order beside causes: what is said to be a cause may be a relaxation that the plain model has not been given.

The order is chosen on the mechanical responses to the plain model. Where these are few, or a strong cause bends them, the film may well have
an arm more: then that cause leaves something which another cause is said to be, for an arm is not asked among the causes.
"""

from __future__ import annotations

import numpy as np

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.search.plain_fit import begin_arm, list_arm_times
from pipeline.diagnose.simulation.parameters import BaseModel
from schemas.arrays import Float

_RATIO = 0.3
"""Stiffness over that at rest with which an arm begins."""
_ROUGH, _FULL = 4, 15
"""Steps of a search from each of several times, and of that from the best of them."""
_APART = 1.5
"""Ratio of the times of two arms below which they are one."""


def take_up_arm(final: ExtendedFit) -> tuple[BaseModel, Float] | None:
    """The plain model with one more arm, and its entries, where that does as well as one of the causes, or is needed beside them all.

    Parameters
    ----------
    final : the most probable causes at their optimum

    Returns
    -------
    None where the film has as many arms as it may have, or no use for another
    """
    of = final.of
    if of.model.arms >= RULES.plain.orders[-1] or not of.chosen:
        return None
    each = [None, *(i for i in range(len(of.chosen)) if not of.is_lag(i))]
    (model, theta), chi2 = min((_fit_with_arm(final, left_out) for left_out in each), key=lambda pair: pair[1])
    # The causes alone go on as long as they did with the arm.
    if chi2 >= final.of.fit(final, most=_FULL).chi2 or not _is_further(model, theta):
        return None
    return model, theta


def _is_further(model: BaseModel, theta: Float) -> bool:
    """Whether all arms are there, each at a time of its own: two at one time are one."""
    film = model.physical(theta).film
    times = np.sort(film.tau)
    return min(film.k) > RULES.fit.vanished * film.k0 and bool(np.all(times[1:] > _APART * times[:-1]))


def _fit_with_arm(final: ExtendedFit, left_out: int | None) -> tuple[tuple[BaseModel, Float], float]:
    """The plain model with one more arm beside all causes but one, and its χ².

    With what an arm has to be worth where no cause is left out, and without it in place of a relaxation that is one.
    """
    of = final.of
    kept = [c.owner != left_out for c in of.coordinates]
    chosen = tuple(c for i, c in enumerate(of.chosen) if i != left_out)
    starts = [(_RATIO, float(time)) for time in list_arm_times(of.session)]
    as_arm = None if left_out is None else of.chosen[left_out].mechanism.as_arm
    if left_out is not None and as_arm is not None:
        values = final.values[left_out]
        starts = [(values["stiffness_ratio"], values["time_constant_s"])]
    ends = []
    for ratio, time in starts:
        model, theta = begin_arm(of.session, of.model, final.theta, ratio, time)
        others = Extended(of.session, of.simulation, model, chosen, of.weight, of.quiet)
        ends.append(others.fit(np.concatenate([theta, final.x[of.model.size :][kept]]), most=_ROUGH, thorough=False))
    best = min(ends, key=lambda f: f.chi2)
    best = best.of.fit(best, most=_FULL)
    worth = RULES.plain.arm_worth * max(1.0, best.chi2 / max(of.session.size - best.x.size, 1))
    if left_out is None:
        return (best.of.model, best.theta), best.chi2 + worth
    return (best.of.model, best.theta), best.chi2 - (worth if as_arm is not None else 0.0)
