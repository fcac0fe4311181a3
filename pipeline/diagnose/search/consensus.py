"""The film that most recordings agree on, and causes searched from there.

A strong cause bends the film of the plain model, in the end of all recordings, and a search from a bent film may end anywhere. Under the
weights that the likelihood gives, groups of features that most others contradict count for next to nothing: film and rig are where the
others are at rest, and a cause has to explain the rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import fit_each_mechanism
from pipeline.diagnose.search.likelihood import Linearised
from pipeline.diagnose.search.posterior import Hypothesis, settle_hypothesis, weigh_fit
from pipeline.diagnose.search.screen import compute_secants, compute_signatures, find_best_scores
from pipeline.diagnose.search.tempering import temper_weights
from pipeline.physics.least_squares import Solution, central
from schemas.arrays import Float


def find_consensus(fits: Sequence[ExtendedFit], mechanical: Float | None) -> Hypothesis:
    """A model with the film and the rig that most groups of features agree on.

    Parameters
    ----------
    fits : the plain model, or the same with the lag of the amplifier, at its optima under other weights
    mechanical : (P₀,) entries of the plain model with the film and the rig of the mechanical tests alone; None where there are no others

    Returns
    -------
    The model at its optimum under the weights that the likelihood gives it
    """
    starts = list(fits)
    if mechanical is not None:
        starts.append(stand_at(fits[0], np.concatenate([mechanical, fits[0].x[mechanical.size :]])))
    starts = [f for f in starts if Linearised.of(f).is_computed] or list(fits)
    return max((settle_hypothesis(weigh_fit(f)) for f in starts), key=lambda h: h.log_evidence)


def search_from_consensus(base: ExtendedFit, agreed: Hypothesis) -> list[Hypothesis]:
    """Hypotheses of one cause more each, found from the film that most groups of features agree on.

    Parameters
    ----------
    base : the plain model, or the same with the lag of the amplifier, under weights that allow for causes of any form
    agreed : that model where most agree

    Returns
    -------
    Empty where that is the film of `base`
    """
    if agreed.log_evidence < weigh_fit(base).log_evidence + RULES.fit.bent:
        return []
    start = stand_at(agreed.model, agreed.model.x)
    signatures = compute_signatures(compute_secants(start), start)
    scores = find_best_scores(signatures)
    return [weigh_fit(f) for f in fit_each_mechanism(start, scores, signatures, RULES.fit.from_consensus)]


def stand_at(fit: ExtendedFit, x: Float) -> ExtendedFit:
    """The model at entries (P,), not at its optimum, under weights that allow every block a share of what is missed there."""
    session = fit.of.session
    simulation = fit.of.simulation.about(fit.of.model.physical(x[: fit.of.model.size]))
    of = fit.of.move_to(session, simulation, np.ones(session.size))
    of = of.reweigh(temper_weights(session, of.compute_data_residual(x)))
    (residual,) = of.residuals(x[None])
    jacobian = central(of.residuals, x, *of.limits)
    return ExtendedFit(of, Solution(x, residual, jacobian, float(residual @ residual), converged=False))
