"""Tempering: every block may be wrong by a share of the plain model's misfit, for no mechanism has exactly reality's
form.

How large that share is, is assumed as long as nothing is known, and read off a cause that explains much more than that.
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


def measure_excess(plain: ExtendedFit, fit: ExtendedFit) -> float:
    """χ² that a fit leaves beyond the noise, in standard deviations of what the noise alone would leave. Both have the
    same weights."""
    noise = expect_noise_chi2(plain)
    return float((fit.chi2 - noise) / np.sqrt(2 * max(noise, 1.0)))


def measure_explained_share(plain: ExtendedFit, extended: ExtendedFit) -> float:
    """Share of the plain model's misfit beyond the noise that an extended model explains. Both have the same weights."""
    fall = plain.chi2 - extended.chi2
    return float(np.clip(fall / max(plain.chi2 - expect_noise_chi2(plain), fall, 1e-9), 0.0, 1.0))


def sum_by_block(fit: ExtendedFit, noise: bool = False) -> Float:
    """(B,) weighted χ² of each block; with `noise` what the noise alone would leave."""
    squares = fit.of.weight**2 if noise else fit.misfit**2
    return np.array([float(squares[p.first : p.stop].sum()) for p in fit.of.session.places])


def sum_by_part(fit: ExtendedFit, noise: bool = False) -> Float:
    """(B + 1,) the same, and last that of the rig's priors: a cause may do nothing but reconcile features with the
    rig's file."""
    files = fit.solution.residual[fit.of.session.size :][: int(np.isfinite(fit.of.model.prior_sd).sum())]
    return np.append(sum_by_block(fit, noise), files.size if noise else float(files @ files))


def estimate_form_share(plain: ExtendedFit, extended: ExtendedFit) -> float:
    """Form error of a cause, as most blocks show it; `temper.share` at most.

    What another cause leaves in some of the blocks counts for nothing in the median of all.

    Parameters
    ----------
    plain, extended : without and with the cause; both with weights of the noise alone
    """
    size = sum_by_block(plain, noise=True)
    before, after = sum_by_block(plain) - size, sum_by_block(extended) - size
    clear = before > RULES.temper.clearly * np.sqrt(2 * size) + 2 * RULES.temper.clearly
    if clear.sum() < RULES.temper.fewest_blocks:
        return RULES.temper.share
    shares = np.sqrt(np.maximum(after[clear], 0.0) / before[clear])
    return float(min(RULES.temper.share, RULES.temper.of_median * np.median(shares)))
