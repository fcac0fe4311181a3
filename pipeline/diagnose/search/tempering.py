"""Tempering: weights under which causes are searched, before it is known which and how right their forms are.

Every block may be wrong by a share of the plain model's misfit. What is found is compared under the likelihood of `likelihood`.
"""

from __future__ import annotations

import numpy as np

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.simulation.session import Session
from schemas.arrays import Float


def temper_weights(session: Session, misfit: Float, share: float = RULES.temper.share) -> Float:
    """(N,) weights by which the variance of every block grows by the square of a share of its misfit.

    Parameters
    ----------
    session : with its blocks
    misfit : (N,) whitened residual of the plain model
    share : form error
    """
    weight = np.ones(session.size)
    for p in session.places:
        own = misfit[p.first : p.stop]
        weight[p.first : p.stop] = 1 / np.sqrt(1 + share**2 * max(0.0, float(own @ own) / own.size - 1))
    return weight


def lower_outlier_weights(fit: ExtendedFit, weight: Float) -> Float:
    """(N,) weights, lowered in blocks that a fit misses by more than the noise, until it misses them by as much as the
    noise.

    What no model describes says little of the film.

    Parameters
    ----------
    fit : the model at its optimum
    weight : (N,) weights without that
    """
    found = weight.copy()
    for p in fit.of.session.places:
        own = slice(p.first, p.stop)
        size = p.block.size
        missed = float(np.sum((fit.misfit[own] * weight[own] / fit.of.weight[own]) ** 2))
        if missed > size + RULES.temper.outlier * np.sqrt(2 * size):
            found[own] *= np.sqrt(size / missed)
    return found


def expect_noise_chi2(plain: ExtendedFit) -> float:
    """χ² that the noise alone would leave under the weights of a fit of the plain model."""
    return float(np.sum(plain.of.weight**2)) - plain.of.model.size


def measure_explained_share(plain: ExtendedFit, extended: ExtendedFit) -> float:
    """Share of the plain model's misfit beyond the noise that an extended model explains. Both have the same weights."""
    fall = plain.chi2 - extended.chi2
    return float(np.clip(fall / max(plain.chi2 - expect_noise_chi2(plain), fall, 1e-9), 0.0, 1.0))
