"""Smooth functions of what a stage depends on: regions without a name as hypotheses, and the form errors of listed causes.

Both are the shapes of `regions`, to first order about the plain model. A region stands for itself; beside a listed cause the same shapes
say by how much its form may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.likelihood import LARGEST, Groups, Linearised, find_absorbed, find_peak, measure_trace
from pipeline.diagnose.search.posterior import Hypothesis, RegionFit, measure_trace_of_causes
from pipeline.diagnose.search.regions import STEP, Region, list_regions
from schemas.arrays import Bool, Float

WIDTHS = np.geomspace(1e-4, 1.0, 7)
"""Widths of the priors of a region's weights."""
_NEAR = 100.0
"""Log probability behind the best cause within which the form of another is allowed for about its own fit."""
_NO_TRACE = 1e-6
"""Length below which a shape leaves no trace."""


@dataclass(frozen=True)
class RegionChange:
    """What a region's shapes change in the features of a session, to first order.

    Parameters
    ----------
    region : what depends on what
    columns : (N, K) whitened change by each weight
    seen : (K,) whether a shape leaves a trace beyond what film and rig absorb
    length : (K,) length of that trace
    """

    region: Region
    columns: Float
    seen: Bool
    length: Float


def differentiate_regions(plain: ExtendedFit) -> list[RegionChange]:
    """All regions that leave a trace in a session, about the plain model.

    Parameters
    ----------
    plain : the plain model, with the film that most groups of features agree on
    """
    absorbed = find_absorbed(plain)
    found = [differentiate_region(plain, region, absorbed) for region in list_regions(plain.of.session)]
    return [change for change in found if change.seen.any()]


def differentiate_region(fit: ExtendedFit, region: Region, absorbed: Float) -> RegionChange:
    """A region about a fit, with its causes where it has any; `absorbed` (N, R) is the basis of what film and rig take up."""
    columns = compute_columns(fit, region)
    length = np.linalg.norm(columns - absorbed @ (absorbed.T @ columns), axis=0)
    return RegionChange(region, columns, length > _NO_TRACE, length)


def compute_columns(fit: ExtendedFit, region: Region) -> Float:
    """(N, K) whitened change of a session's features by each weight of a region, about a fit."""
    of, theta, own = fit.of, fit.theta, fit.of.effect(fit.x)
    base = of.predict(fit.x)
    changes = np.array([(of.simulation.predict(of.model, theta, own | e) - base) / STEP for e in region.effects])
    computed = np.all(np.abs(changes) < LARGEST, axis=1)
    return of.session.whiten(np.where(computed[:, None], changes, 0.0).T)


def weigh_regions(plain: ExtendedFit, changes: Sequence[RegionChange]) -> list[Hypothesis]:
    """All regions without a name as hypotheses, to first order about the plain model.

    Parameters
    ----------
    plain : the plain model, with the film that most groups of features agree on
    changes : of all regions, about it
    """
    groups, absorbed, about = Groups.of(plain.of.session, plain.of.quiet), find_absorbed(plain), Linearised.of(plain)
    prior = float(np.log(RULES.prior.unnamed / max(len(changes), 1)))
    return [_weigh_region(plain, groups, absorbed, about, change, prior) for change in changes]


def _weigh_region(
    plain: ExtendedFit,
    groups: Groups,
    absorbed: Float,
    about: Linearised,
    change: RegionChange,
    prior: float,
) -> Hypothesis:
    """One region, over all widths of its prior."""
    region, seen = change.region, change.seen
    size = about.jacobian.shape[1]
    evidence, best = [], None
    for width in WIDTHS:
        scale = width * region.width[seen]
        own = change.columns[:, seen] * scale
        extended = about.extend(own)
        trace = np.zeros(groups.size.size)
        for _ in range(2):  # the trace of the function follows from its fit
            peak = find_peak(groups, extended, trace, size, noise_alone=False)
            trace = measure_trace(groups, absorbed, own @ peak.step[size:])
        covariance = peak.covariance[size:, size:]
        evidence.append(peak.log_likelihood + 0.5 * float(np.linalg.slogdet(covariance)[1]))
        if evidence[-1] == max(evidence):
            weights, spread = np.zeros(seen.size), np.zeros((seen.size, seen.size))
            weights[seen] = scale * peak.step[size:]
            spread[np.ix_(seen, seen)] = np.outer(scale, scale) * covariance
            best = RegionFit(region, weights, spread, plain, peak.step[:size], float(width)), peak
    assert best is not None, region.id
    total = float(logsumexp(evidence) - np.log(len(evidence)))
    return Hypothesis(region.id, total, prior, None, best[0], best[1].weight, best[1].odd)


def allow_form_errors(found: Sequence[Hypothesis], changes: Sequence[RegionChange]) -> list[Hypothesis]:
    """The hypotheses of listed causes; the form of one alone may be wrong by smooth functions of what it depends on.

    No formula is exactly reality's: what a cause does in its stage may be another function of the same covariate, by a share of its
    effect (`form.bends`, each as likely). The shapes are those of the regions without a name, about the cause in place of nothing. Several
    causes have to do with their formulas: what the form of one would take up shows no other.

    Parameters
    ----------
    found : hypotheses of listed causes at their optima
    changes : of all regions, about the plain model
    """
    first = [_allow_form_error(h, changes) for h in found]
    near = max((h.log_joint for h in first), default=0.0) - _NEAR
    return [
        _allow_form_error(h, changes, anew=True) if a.log_joint > near else a for h, a in zip(found, first, strict=True)
    ]


def _allow_form_error(hypothesis: Hypothesis, changes: Sequence[RegionChange], *, anew: bool = False) -> Hypothesis:
    """One of them; `anew`: with the shapes about its own fit, for about the plain model they are not those of a strong effect."""
    fit = hypothesis.model
    if len(fit.of.chosen) != 1:
        return hypothesis
    mechanism = fit.of.chosen[0].mechanism
    own = [c for c in changes if c.region.stage == mechanism.stage and c.region.depends_on in mechanism.covariates]
    if anew:
        absorbed = find_absorbed(fit)
        own = [change for c in own if (change := differentiate_region(fit, c.region, absorbed)).seen.any()]
    if not own:
        return hypothesis
    groups, about = Groups.of(fit.of.session, fit.of.quiet), Linearised.of(fit)
    trace = measure_trace_of_causes(fit, groups)
    size = float(np.sqrt(trace @ groups.size))
    columns = np.concatenate([c.columns[:, c.seen] * _scale_shapes(c, size) for c in own], axis=1)
    evidence, odd = [hypothesis.log_evidence], [hypothesis.odd]
    for share in RULES.form.bends:
        peak = find_peak(groups, about.extend(share * columns), trace, fit.x.size, noise_alone=False)
        bent = peak.covariance[fit.x.size :, fit.x.size :]
        evidence.append(
            peak.log_likelihood
            + fit.integrate_mechanisms(peak.covariance[: fit.x.size, : fit.x.size])
            + 0.5 * float(np.linalg.slogdet(bent)[1])
        )
        odd.append(peak.odd)
    rules = RULES.form
    prior = np.array([1 - rules.bent, *[rules.bent / len(rules.bends)] * len(rules.bends)])
    total = float(logsumexp(evidence, b=prior))
    return replace(hypothesis, log_evidence=total, odd=odd[int(np.argmax(evidence))])


def _scale_shapes(change: RegionChange, size: float) -> Float:
    """(K,) scales of a region's shapes with which one of them, usually, changes the features by a length `size`."""
    width, length = change.region.width[change.seen], change.length[change.seen]
    return np.asarray(width * size / np.sqrt(np.mean((width * length) ** 2)))
