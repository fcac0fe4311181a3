"""Nonlinear fits of mechanisms that a screen proposes, alone or on top of others, from several starts.

Belongs here: how starts are made and which optimum is kept. What the optima mean is in `decide`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Chosen, Extended, ExtendedFit
from pipeline.diagnose.search.screen import Score, Signatures, make_absorbed_basis, scale_severities
from pipeline.diagnose.search.tempering import expect_noise_chi2, lower_outlier_weights
from pipeline.physics.least_squares import Solution
from schemas.arrays import Float

_ABSORBED = frozenset(
    {
        "passive_strip",
        "missing_relaxation",
        "power_law_relaxation",
        "sensor_delay",
        "rig_constants",
        "load_cell_damping",
        "gain_error",
    }
)
"""Material and rig can take the place of these: they are restarted at several fixed severities."""
_FEW, _ROUGHLY, _THOROUGHLY = 2, 6, 25
"""Steps after which the searches from several starts are compared, of a rough fit, and of a thorough one."""
_LEAST_SHARE, _MOST_SHARE = 1e-3, 3.0
_SMALL = 1e-3
_TRIALS, _CONFIRMATIONS = 20, 8
"""Steps of a round, of which many may be too long, rounds of confirming an optimum at most, and the fall of χ², alone and as a share
of it, below which there is no other: along a bent valley each round gains a little."""
_SETTLING, _SAME_WEIGHT = 4, 0.05
"""Rounds of weighing the blocks anew at most, and change of the weights that is none."""
_MOST_ROUNDS = 20
"""Rounds of further steps at most, and share of what a mechanism explains that a round must add for another to follow."""


def _group_by_mechanism(found: Sequence[Score]) -> dict[str, list[Score]]:
    """Mechanisms of a screen, best first, each with its best forms."""
    by_id: dict[str, list[Score]] = {}
    for score in found:
        forms = by_id.setdefault(score.chosen.id, [])
        if len(forms) < RULES.fit.variants and (
            not forms or score.statistic > RULES.fit.close_variant * forms[0].statistic
        ):
            forms.append(score)
    return by_id


def fit_each_mechanism(
    base: ExtendedFit, found: Sequence[Score], looked: Signatures, mechanisms: int, goal: float = np.inf
) -> list[ExtendedFit]:
    """The best form of each of the best mechanisms of a screen, fitted on top of `base`.

    Those are left out of which the screen promises so little that they could not come near both the best of those fitted so far and
    `goal`, a χ²; but never those that the material can take the place of: of a strong one a screen sees next to nothing. For the same
    reason those of them are fitted, wherever they stand in the screen, that the best of the others is known to be taken for.
    """
    by_id = _group_by_mechanism(found)
    kept: list[ExtendedFit] = []

    def fitted(forms: Sequence[Score]) -> list[ExtendedFit]:
        reach = min([goal, *(_bound_chi2(base, f) for f in kept)])
        hopeful = [s for s in forms if s.chosen.id in _ABSORBED or base.chi2 - RULES.fit.hopeless * s.statistic < reach]
        fits = [fit_mechanism(base, form, looked, reach) for form in hopeful]
        return [max(fits, key=lambda f: f.log_evidence)] if fits else []

    for id in list(by_id)[:mechanisms]:
        kept += fitted(by_id[id])
    if not kept:
        return kept
    best = max(kept, key=lambda f: f.log_evidence)
    for id in list(by_id)[mechanisms:]:
        if id in _ABSORBED and id in best.of.chosen[-1].mechanism.confusable:
            kept += fitted(by_id[id])
    near = [
        f
        for f in kept
        if _may_be_taken_for(f, best) and _may_be_taken_for(best, f) and f.chi2 < best.chi2 + RULES.fit.close_call
    ]

    def again(fit: ExtendedFit) -> ExtendedFit:
        if fit is best and near:
            return _refit_from_film_of(min(near, key=lambda f: f.chi2), best, base)
        return _refit_from_film_of(best, fit, base) if _may_be_taken_for(fit, best) else fit

    return [again(f) for f in kept]


def _may_be_taken_for(fit: ExtendedFit, best: ExtendedFit) -> bool:
    """Whether a mechanism is another than the best one, alike, and may have been left at the film that makes room for something else."""
    one, other = fit.of.chosen[-1].mechanism, best.of.chosen[-1].mechanism
    confusable = one.id in other.confusable or other.id in one.confusable
    return one.id != other.id and one.id in _ABSORBED and confusable


def _refit_from_film_of(best: ExtendedFit, fit: ExtendedFit, base: ExtendedFit) -> ExtendedFit:
    """The fit, or a better one of its mechanism about the film and the rig of the best one."""
    again = fit.of.fit(fit.of.entries(best.theta, fit.values), most=_ROUGHLY, thorough=False)
    ends = [fit, _follow_to_end(base, again, np.inf)]
    if min(f.chi2 for f in ends) < best.chi2 + RULES.fit.close_call:
        # Rough ends do not say which of two valleys is the deeper one, nor which is the wider.
        return max((finish_fit(f) for f in ends), key=lambda f: f.log_evidence)
    return min(ends, key=lambda f: f.chi2)


def _bound_chi2(base: ExtendedFit, best: ExtendedFit) -> float:
    """χ² up to which a fit may be as good as this one once more is known."""
    return best.chi2 + max(
        RULES.fit.near_of_explained * (base.chi2 - best.chi2),
        RULES.fit.near_of_left * (best.chi2 - expect_noise_chi2(base)),
        0.0,
    )


def rank_by_evidence(fits: Sequence[ExtendedFit]) -> tuple[ExtendedFit, ...]:
    """Best evidence first."""
    return tuple(sorted(fits, key=lambda f: -f.log_evidence))


def confirm_best(fits: Sequence[ExtendedFit]) -> tuple[ExtendedFit, ...]:
    """Best evidence first, the close ones with their searches brought to an end; nothing of nothing."""
    top = max((f.log_evidence for f in fits), default=0.0)
    return rank_by_evidence(
        [
            finish_fit(f) if f.log_evidence > top - RULES.fit.close_call - RULES.fit.close_call_share * abs(top) else f
            for f in fits
        ]
    )


def fit_mechanism(base: ExtendedFit, score: Score, signatures: Signatures, reach: float = np.inf) -> ExtendedFit:
    """The optimum with one mechanism more, from the screen's point and from others where the material can take its place.

    Never worse than `base` but for the mechanism's priors: a start at a vanishing severity is among them. The search ends early where
    it will not come down to a χ² of `reach`.
    """
    of = replace(base.of, chosen=(*base.of.chosen, score.chosen))
    far = score.chosen.id in _ABSORBED
    fits = _fit_from_starts(base, of, score, signatures, far)
    best = _follow_to_end(base, min(fits, key=lambda f: f.chi2), reach)
    if far:
        best = _revive_arms(base, best, reach)
    if not best.chi2 <= base.chi2:
        faint = of.entries(base.theta, (*base.values, scale_severities(score.chosen.mechanism, score.values, _SMALL)))
        again = of.fit(faint, most=_ROUGHLY, near=base, thorough=False)
        best = again if not best.chi2 < again.chi2 else best
    return best


def _fit_from_starts(
    base: ExtendedFit, of: Extended, score: Score, signatures: Signatures, far: bool
) -> list[ExtendedFit]:
    """Rough ends of the searches for one mechanism more that are worth it. `far`: material and rig can take its place."""
    starts: list[Mapping[str, float]] = [
        scale_severities(score.chosen.mechanism, score.values, float(np.clip(score.share, _LEAST_SHARE, _MOST_SHARE)))
    ]
    if far:
        starts += sorted(_list_levels(score, signatures), key=_make_remaining(base, of, score.chosen))[
            : RULES.fit.starts
        ]
    elif score.chosen.mechanism.onset:
        starts += _start_above_onset(base, of, score, signatures)
    begins = [of.entries(_make_room(base, score.chosen, values), (*base.values, values)) for values in starts]
    if far:
        # The material first: it must make room before the severity may move.
        begins = [room.x for room in _drop_lost([of.room(x, _ROUGHLY, base) for x in begins], base)]
    if score.chosen.id == "rig_constants" and any(base.of.model.rigs):
        begins.append(_start_from_files(of, base))
    near = None if far else base
    if len(begins) == 1 or (far and not base.of.chosen):
        # As long as the material makes room, the search that is behind may end ahead.
        return [of.fit(x, most=_ROUGHLY, near=near, thorough=False) for x in begins]
    begun = sorted((of.fit(x, most=_FEW, near=near, thorough=False) for x in begins), key=lambda f: f.chi2)
    return [
        f if f.solution.converged else of.fit(f, most=_ROUGHLY - _FEW, thorough=False)
        for f in begun[: RULES.fit.followed]
    ]


def _drop_lost(rooms: Sequence[Solution], base: ExtendedFit) -> list[Solution]:
    """Those of several severities that the data may come to; of a strong effect, all."""
    lost = np.inf if base.chi2 > RULES.fit.strong * base.of.session.size else RULES.fit.astray * base.chi2
    least = min(room.chi2 for room in rooms)
    return [room for room in rooms if room.chi2 <= max(lost, least)]


def _follow_to_end(base: ExtendedFit, fit: ExtendedFit, reach: float) -> ExtendedFit:
    """On from a rough optimum as long as that adds to what it explains: a strong effect is far from where a screen sees it."""
    for _ in range(_MOST_ROUNDS):
        if fit.solution.converged:
            break
        again = fit.of.fit(fit, most=_ROUGHLY, thorough=False)
        fall, fit = fit.chi2 - again.chi2, again
        if (
            not fall > RULES.fit.still_falling * abs(base.chi2 - again.chi2)
            or fit.chi2 - RULES.fit.hopeless * fall > reach
        ):
            break
    return fit


def _revive_arms(base: ExtendedFit, fit: ExtendedFit, reach: float) -> ExtendedFit:
    """The fit, or a better one from where its arms that have vanished are as in `base`: an arm of next to no stiffness has no slope
    left by which it could come back, and a mechanism that begins too strong takes more of the arms than it needs in the end."""
    arms = fit.of.model.arms
    springs = 1 + np.arange(arms)
    vanished = springs[fit.theta[springs] < base.theta[springs] + np.log(RULES.fit.vanished)]
    if vanished.size == 0:
        return fit
    x = fit.x.copy()
    for places in (vanished, vanished + arms):
        x[places] = base.theta[places]
    return min(fit, _follow_to_end(base, fit.of.fit(x, most=_ROUGHLY, thorough=False), reach), key=lambda f: f.chi2)


def _make_remaining(base: ExtendedFit, of: Extended, chosen: Chosen) -> Callable[[Mapping[str, float]], float]:
    """What χ² a start leaves once everything that the base may move has made room, to first order."""
    absorbed = make_absorbed_basis(base)

    def remaining(values: Mapping[str, float]) -> float:
        (residual,) = of.residuals(of.entries(_make_room(base, chosen, values), (*base.values, values))[None])
        seen = residual[: absorbed.shape[0]]
        kept = float(residual @ residual - np.sum((absorbed.T @ seen) ** 2))
        return kept if np.isfinite(kept) else np.inf

    return remaining


def _make_room(base: ExtendedFit, chosen: Chosen, values: Mapping[str, float]) -> Float:
    """θ with a film, and an actuation, that are stronger by what the mechanism takes at rest."""
    softening = chosen.mechanism.softening
    if softening is None:
        return base.theta
    model, theta = base.of.model, base.theta.copy()
    more = -float(np.log(max(softening(values), 1e-3)))
    theta[: 1 + model.arms] += more
    actuation = model.index("log actuation")
    if actuation is not None:
        theta[actuation] += more
    return theta


def _start_from_files(of: Extended, base: ExtendedFit) -> Float:
    """Entries with the rig's deviations handed to the mechanism: only the priors have a slope along that exchange."""
    model, theta = base.of.model, base.of.model.with_rigs_as_filed(base.theta)
    pairs = zip(model.physical(base.theta).rigs, model.physical(theta).rigs, model.rigs, strict=True)
    known = [(here, filed) for here, filed, prior in pairs if prior is not None]
    mass = float(np.mean([(here.mass / filed.mass).item() for here, filed in known]))
    stiffness = float(np.mean([(filed.compliance / here.compliance).item() for here, filed in known]))
    return of.entries(theta, (*base.values, {"mass_error": mass - 1, "stiffness_error": stiffness - 1}))


def finish_fit(fit: ExtendedFit) -> ExtendedFit:
    """The same optimum, confirmed with central differences."""
    found = fit.of.refined(fit.of.fit(fit.x, most=_THOROUGHLY))
    for _ in range(_CONFIRMATIONS):
        again = fit.of.further(found, most=_TRIALS)
        fall = found.chi2 - again.chi2
        if fall < RULES.fit.settled_chi2:
            break
        found = fit.of.refined(again)
        if fall < RULES.fit.settled_share * found.chi2:
            break
    return found


def settle_outliers(fit: ExtendedFit) -> ExtendedFit:
    """The optimum with blocks that it does not describe counted for less: the film is where the others agree."""
    tempered = fit.of.weight
    for _ in range(_SETTLING):
        weight = lower_outlier_weights(fit, tempered)
        if np.allclose(weight, fit.of.weight, rtol=_SAME_WEIGHT):
            break
        of = fit.of.with_weight(weight)
        fit = of.refined(of.fit(fit.x, most=_THOROUGHLY))
    return fit


def drop_mechanism(fit: ExtendedFit, number: int) -> ExtendedFit:
    """The optimum without mechanism `number` of a fit."""
    chosen = tuple(c for i, c in enumerate(fit.of.chosen) if i != number)
    values = tuple(v for i, v in enumerate(fit.values) if i != number)
    of = replace(fit.of, chosen=chosen)
    return finish_fit(of.fit(of.entries(fit.theta, values), most=_ROUGHLY))


def _start_above_onset(
    base: ExtendedFit, of: Extended, score: Score, signatures: Signatures
) -> list[Mapping[str, float]]:
    """Low severities, each with its best shape: the screen's share of a high one may lie below where anything begins, and no slope
    leads out; and the shape that a high one would have to have is not that of a low one."""
    low = {p.name: p.low for p in score.chosen.mechanism.severities}
    points = [v for c, v in zip(signatures.chosen, signatures.values, strict=True) if c == score.chosen]
    shapes = {tuple(v for k, v in values.items() if k not in low): values for values in points}
    remaining = _make_remaining(base, of, score.chosen)
    return [
        min(
            ({**shape, **{name: times * least for name, least in low.items()}} for shape in shapes.values()),
            key=remaining,
        )
        for times in RULES.fit.onset_starts
    ]


def _list_levels(score: Score, signatures: Signatures) -> list[Mapping[str, float]]:
    """Other points of the same mechanism and form: the best of each severity."""
    best: dict[tuple[float, ...], tuple[float, Mapping[str, float]]] = {}
    names = [p.name for p in score.chosen.mechanism.severities]
    for c, values, along in zip(signatures.chosen, signatures.values, signatures.score, strict=True):
        if c != score.chosen:
            continue
        key = tuple(values[n] for n in names)
        if key not in best or along > best[key][0]:
            best[key] = float(along), values
    return [dict(values) for _, values in best.values() if dict(values) != dict(score.values)]
