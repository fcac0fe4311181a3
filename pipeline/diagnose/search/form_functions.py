"""Smooth functions of what a stage depends on: regions without a name as hypotheses, and the form errors of listed causes.

Both are the shapes of `regions`, to first order about the plain model. A region stands for itself; beside a listed cause the same shapes
say by how much its form may be wrong.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import logsumexp

from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.mechanisms.mechanism import Mechanism
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.likelihood import (
    LARGEST,
    Groups,
    Linearised,
    Peak,
    Products,
    find_absorbed,
    find_peak,
    measure_trace,
)
from pipeline.diagnose.search.posterior import (
    Bend,
    Hypothesis,
    RegionFit,
    compute_change_by_cause,
    compute_change_by_causes,
    measure_trace_of_causes,
    share_of_next,
)
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


def weigh_regions(base: Hypothesis, changes: Sequence[RegionChange]) -> list[Hypothesis]:
    """All regions without a name as hypotheses, to first order about the plain model, or beside causes that are sure.

    Parameters
    ----------
    base : the plain model, with the film that most groups of features agree on, or one with listed causes at its optimum
    changes : of all regions, about the plain model; what a listed cause of the base may depend on is the form of that cause
    """
    fit = base.model
    own = [MECHANISMS[id] for id in base.causes]
    changes = [c for c in changes if not any(is_form_of(c.region, m) for m in own)]
    believed = RULES.prior
    # What has no name is as rare beside a cause as it is alone, against the listed causes.
    beside = base.log_prior + np.log(share_of_next(fit.of.chosen) / believed.listed) if base.causes else 0.0
    prior = float(np.log(believed.unnamed / max(len(changes), 1)) + beside)
    name = f"{base.name}+" if base.causes else ""
    about = _About(
        fit,
        Groups.of(fit.of.session, fit.of.quiet),
        find_absorbed(fit),
        compute_change_by_causes(fit),
        list_forms(base.bend, Linearised.of(fit)),
    )
    found = [_weigh_region(about, change, name + change.region.id, prior) for change in changes]
    return [replace(h, bend=base.bend) for h in found]


def is_form_of(region: Region, mechanism: Mechanism) -> bool:
    """Whether a region shows as the stage of a mechanism does and depends on the same."""
    return mechanism.stage in region.alike and region.depends_on in mechanism.covariates


@dataclass(frozen=True)
class _About:
    """What regions are added to: a fit, its groups of features, what film and rig absorb, and what its causes change (N,).

    Parameters
    ----------
    forms : (log prior, model to first order, with what the form of its causes may be wrong by or without)
    """

    fit: ExtendedFit
    groups: Groups
    absorbed: Float
    by_causes: Float
    forms: tuple[tuple[float, Linearised], ...]


def _weigh_region(about: _About, change: RegionChange, name: str, prior: float) -> Hypothesis:
    """One region, over all widths of its prior."""
    region, seen, fit, groups = change.region, change.seen, about.fit, about.groups
    evidence, best = [], None
    columns = change.columns[:, seen] * region.width[seen]
    before = measure_trace(groups, about.absorbed, about.by_causes)
    forms = [(log_prior, Products.of(groups, m.extend(columns)), m.jacobian.shape[1]) for log_prior, m in about.forms]
    for width in WIDTHS:
        scale, own = width * region.width[seen], width * columns
        for believed, form, first in forms:
            extended = form.scale_last(columns.shape[1], float(width))
            trace = before
            for _ in range(2):  # the trace of the function follows from its fit
                peak = find_peak(groups, extended, trace, first, noise_alone=False)
                trace = measure_trace(groups, about.absorbed, about.by_causes + own @ peak.step[first:])
            evidence.append(believed + integrate_peak(fit, peak))
            if evidence[-1] == max(evidence):
                weights, spread = np.zeros(seen.size), np.zeros((seen.size, seen.size))
                weights[seen] = scale * peak.step[first:]
                spread[np.ix_(seen, seen)] = np.outer(scale, scale) * peak.covariance[first:, first:]
                best = RegionFit(region, weights, spread, fit, peak.step[: fit.x.size], float(width)), peak
    assert best is not None, region.id
    total = float(logsumexp(evidence) - np.log(WIDTHS.size))
    return Hypothesis(name, total, prior, None, best[0], best[1].weight, best[1].odd)


def integrate_peak(fit: ExtendedFit, peak: Peak) -> float:
    """Log evidence in Laplace's approximation at a peak over the entries of a fit, and weights after them with standard normal priors."""
    size = fit.x.size
    own = float(np.linalg.slogdet(peak.covariance[size:, size:])[1])
    return peak.log_likelihood + fit.integrate_mechanisms(peak.covariance[:size, :size]) + 0.5 * own


def list_forms(bend: Bend | None, about: Linearised) -> tuple[tuple[float, Linearised], ...]:
    """A model to first order with the form of its causes as it is, and wrong in the most probable way.

    Parameters
    ----------
    bend : what that changes; None: nothing
    about : the model

    Returns
    -------
    Logarithms of what is believed of each beforehand, and the models
    """
    if bend is None:
        return ((0.0, about),)
    return (float(np.log(1 - RULES.form.bent)), about), (bend.log_prior, about.extend(bend.columns))


def allow_form_errors(found: Sequence[Hypothesis], changes: Sequence[RegionChange]) -> list[Hypothesis]:
    """The hypotheses of listed causes; the form of each cause may be wrong by smooth functions of what it depends on.

    No formula is exactly reality's: what a cause does in its stage may be another function of the same covariate, by a share of its
    effect (`form.bends`, each as likely), one cause in one way at a time: what is free in more ways costs more than it tells. The shapes
    are those of the regions without a name, about the causes in place of nothing.

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
    fit, rules = hypothesis.model, RULES.form
    ways = _list_bends(fit, changes, anew=anew)
    if not ways:
        return hypothesis
    groups, about = Groups.of(fit.of.session, fit.of.quiet), Linearised.of(fit)
    trace = measure_trace_of_causes(fit, groups)
    prior = float(np.log(rules.bent / len(ways) / len(rules.bends)))
    peaks = []
    for columns in ways:
        products = Products.of(groups, about.extend(columns))
        parts = [products.scale_last(columns.shape[1], share) for share in rules.bends]
        peaks += [find_peak(groups, part, trace, fit.x.size, noise_alone=False) for part in parts]
    joint = np.array([prior + integrate_peak(fit, peak) for peak in peaks])
    as_it_is = float(np.log(1 - rules.bent)) + hypothesis.log_evidence
    best = int(np.argmax(joint))
    odd = hypothesis.odd if as_it_is > joint[best] else peaks[best].odd
    total = float(logsumexp([as_it_is, *joint]))
    way, share = divmod(best, len(rules.bends))
    return replace(hypothesis, log_evidence=total, odd=odd, bend=Bend(rules.bends[share] * ways[way], prior))


def _list_bends(fit: ExtendedFit, changes: Sequence[RegionChange], *, anew: bool) -> list[Float]:
    """Ways in which the form of one cause of a fit may be wrong: (N, K) changes of the features by the shapes of a region, as large as
    what the cause itself does."""
    absorbed = find_absorbed(fit)
    found = []
    for number, chosen in enumerate(fit.of.chosen):
        own = [c for c in changes if is_form_of(c.region, chosen.mechanism)]
        if anew:
            own = [change for c in own if (change := differentiate_region(fit, c.region, absorbed)).seen.any()]
        effect = compute_change_by_cause(fit, number)
        size = float(np.linalg.norm(effect - absorbed @ (absorbed.T @ effect)))
        found += [c.columns[:, c.seen] * _scale_shapes(c, size) for c in own]
    return found


def _scale_shapes(change: RegionChange, size: float) -> Float:
    """(K,) scales of a region's shapes with which one of them, usually, changes the features by a length `size`."""
    width, length = change.region.width[change.seen], change.length[change.seen]
    return np.asarray(width * size / np.sqrt(np.mean((width * length) ** 2)))
