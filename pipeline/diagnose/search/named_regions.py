"""Listed causes as regions with a name: a function without a formula that is a listed cause's but for the form is that cause.

A cause is what it depends on; its formula is one function of many. A smooth function of the same stage and the same variable that
changes the recordings as the formula does, but for a share that the form of a cause may be wrong by (`form.bends`), says the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import logsumexp

from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.form_functions import is_form_of
from pipeline.diagnose.search.likelihood import find_absorbed
from pipeline.diagnose.search.posterior import Hypothesis
from schemas.arrays import Float


def name_regions(
    listed: Sequence[Hypothesis], regions: Sequence[Hypothesis], plain: ExtendedFit
) -> tuple[list[Hypothesis], list[Hypothesis]]:
    """Gives the evidence of regions to the listed causes that they are forms of.

    Parameters
    ----------
    listed : hypotheses of listed causes at their optima
    regions : hypotheses of regions at their optima
    plain : the model that the regions are beside: the plain one, with the film that most groups of features agree on, or one with causes

    Returns
    -------
    The listed causes, and the regions that are none of theirs
    """
    absorbed = find_absorbed(plain)
    named, unnamed = list(listed), []
    for region in regions:
        places = [i for i, h in enumerate(named) if _may_be_form_of(region, h) and _is_near(region, h, absorbed)]
        if not places:
            unnamed.append(region)
            continue
        total = float(logsumexp([named[i].log_joint for i in places]))
        for i in places:
            cause = named[i]
            own = region.log_joint + cause.log_joint - total - cause.log_prior
            odd = cause.odd if cause.log_evidence > own else region.odd
            named[i] = replace(cause, log_evidence=float(np.logaddexp(cause.log_evidence, own)), odd=odd)
    return named, unnamed


def _may_be_form_of(region: Hypothesis, listed: Hypothesis) -> bool:
    """Whether the one cause that a hypothesis has more than a region is beside acts in its stage, and depends on the same."""
    fit, more = region.region, list(listed.causes)
    if fit is None or not {*region.beside} <= {*more} or len(more) != len(region.beside) + 1:
        return False
    (own,) = {*more} - {*region.beside}
    return is_form_of(fit.region, MECHANISMS[own])


def _is_near(region: Hypothesis, cause: Hypothesis, absorbed: Float) -> bool:
    """Whether a cause changes the features as a region's function does, but for the largest share that a form may be wrong by.

    Parameters
    ----------
    absorbed : (N, R) basis of what film and rig take up
    """
    fit = region.region
    if fit is None:
        return False
    session, base = cause.model.of.session, fit.plain
    apart = session.whiten(np.nan_to_num(fit.predict() - cause.model.of.predict(cause.model.x)))
    effect = session.whiten(fit.compute_change_in(base.of, base.x + fit.step))
    return _measure_beyond(apart, absorbed) < max(RULES.form.bends) * _measure_beyond(effect, absorbed)


def _measure_beyond(change: Float, absorbed: Float) -> float:
    """Length of a whitened change (N,) beyond what film and rig take up."""
    return float(np.linalg.norm(change - absorbed @ (absorbed.T @ change)))
