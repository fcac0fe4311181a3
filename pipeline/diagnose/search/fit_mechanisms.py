"""Nonlinear fits of the mechanisms that a screen proposes, alone or on top of others, each from several starts.

A fit has three stages: rough searches from all starts of which the best go on, rounds of further steps as long as these
gain something, and the confirmation of the optimum with central differences, for the mechanisms near the best alone.
Belongs here: how starts are made and which optimum is kept. What the optima mean is in `judge`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.mechanisms.mechanism import SEVERITY, Mechanism
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Chosen, Extended, ExtendedFit
from pipeline.diagnose.search.screen import Score, Signatures, make_absorbed_basis, scale_severities
from pipeline.diagnose.search.tempering import expect_noise_chi2, lower_outlier_weights, temper_weights
from pipeline.diagnose.simulation.parameters import ACTUATION
from pipeline.physics.least_squares import Solution
from schemas.arrays import Float

_FEW, _ROUGHLY, _THOROUGHLY = 2, 6, 25
"""Steps after which the searches from several starts are compared, of a rough fit, and of a thorough one."""
_MOST_ROUNDS = 20
"""Rounds of further steps at most."""
_TRIALS, _CONFIRMATIONS = 20, 8
"""Steps of a round of confirming an optimum, many of which may be too long; and rounds at most: along a bent valley
each gains a little."""
_LEAST_SHARE, _MOST_SHARE = 1e-3, 3.0
"""Least and largest part of a screen's severity at which a fit starts."""
_SMALL = 1e-3
"""Part of a screen's severity that is next to nothing."""
_SETTLING, _SAME_WEIGHT = 4, 0.05
"""Rounds of weighing the blocks anew at most, and relative change of the weights that is none."""

Start = Mapping[str, float]


def fit_each_mechanism(
    base: ExtendedFit, scores: Sequence[Score], signatures: Signatures, number: int, goal: float = np.inf
) -> list[ExtendedFit]:
    """The best variant of each promising mechanism, fitted on top of `base`.

    Parameters
    ----------
    base : the model to which one mechanism is added
    scores, signatures : what a screen about that model promises, best first
    number : mechanisms that are fitted at least
    goal : χ² to which a fit has to come down to be of use

    Returns
    -------
    One fit per mechanism, in the order of the screen

    Notes
    ----- A mechanism is given up where the screen promises so little that its fit could come near neither the best of
    those fitted so far nor the goal. A mechanism whose place film and rig can take is never given up, for a screen sees
    next to nothing of a strong one; and wherever it stands in the screen it is fitted if the best of the others is
    known to be taken for it. The same holds of all where much is to explain.
    """
    by_id = _group_by_mechanism(scores)
    kept: list[ExtendedFit] = []

    def add_fit(id: str) -> None:
        reach = min([goal, *(_bound_chi2(base, f) for f in kept)])
        hopeful = [
            s for s in by_id[id] if _may_be_unseen(id, base) or base.chi2 - RULES.fit.hopeless * s.statistic < reach
        ]
        fits = [fit_mechanism(base, s, signatures, reach) for s in hopeful]
        if fits:
            kept.append(max(fits, key=lambda f: f.log_evidence))

    for id in list(by_id)[:number]:
        add_fit(id)
    if not kept:
        return kept
    best = max(kept, key=lambda f: f.log_evidence)
    for id in list(by_id)[number:]:
        if _may_be_unseen(id, base) and id in best.of.chosen[-1].mechanism.confusable:
            add_fit(id)
    return _exchange_films(base, kept, best)


def _group_by_mechanism(scores: Sequence[Score]) -> dict[str, list[Score]]:
    """Mechanisms of a screen, best first, each with its best variants."""
    by_id: dict[str, list[Score]] = {}
    for score in scores:
        own = by_id.setdefault(score.chosen.id, [])
        if len(own) < RULES.fit.variants and (not own or score.statistic > RULES.fit.close_variant * own[0].statistic):
            own.append(score)
    return by_id


def _bound_chi2(base: ExtendedFit, best: ExtendedFit) -> float:
    """χ² up to which another fit may be as good as this one once more is known."""
    explained = RULES.fit.near_of_explained * (base.chi2 - best.chi2)
    left = RULES.fit.near_of_left * (best.chi2 - expect_noise_chi2(base))
    return best.chi2 + max(explained, left, 0.0)


def _exchange_films(base: ExtendedFit, kept: Sequence[ExtendedFit], best: ExtendedFit) -> list[ExtendedFit]:
    """The same fits, or better ones about the film of a mechanism that theirs can be taken for.

    Two mechanisms that are alike may have ended at films that make room for the one or the other; each is searched
    about both.
    """
    near = [
        f
        for f in kept
        if _may_be_taken_for(f, best) and _may_be_taken_for(best, f) and f.chi2 < best.chi2 + RULES.fit.close_call
    ]

    def refit(fit: ExtendedFit) -> ExtendedFit:
        if fit is best and near:
            return _refit_about_film_of(min(near, key=lambda f: f.chi2), best, base)
        return _refit_about_film_of(best, fit, base) if _may_be_taken_for(fit, best) else fit

    return [refit(f) for f in kept]


def _may_be_taken_for(fit: ExtendedFit, other: ExtendedFit) -> bool:
    """Whether film and rig can take the place of a fit's mechanism, and the other fit's is a different one that it is
    confused with."""
    one, two = fit.of.chosen[-1].mechanism, other.of.chosen[-1].mechanism
    return one.id != two.id and one.absorbed and (one.id in two.confusable or two.id in one.confusable)


def _refit_about_film_of(other: ExtendedFit, fit: ExtendedFit, base: ExtendedFit) -> ExtendedFit:
    """The fit, or a better one of its mechanism from the film and the rig of another."""
    again = fit.of.fit(fit.of.make_entries(other.theta, fit.values), most=_ROUGHLY, near=fit, thorough=False)
    both = [fit, follow_to_end(base, again, np.inf)]
    if min(f.chi2 for f in both) < other.chi2 + RULES.fit.close_call:
        # Rough ends do not say which of two valleys is the deeper one, nor which is the wider.
        return max((finish_fit(f) for f in both), key=lambda f: f.log_evidence)
    return min(both, key=lambda f: f.chi2)


def rank_by_evidence(fits: Sequence[ExtendedFit]) -> tuple[ExtendedFit, ...]:
    """The fits, best evidence first."""
    return tuple(sorted(fits, key=lambda f: -f.log_evidence))


def confirm_best(fits: Sequence[ExtendedFit]) -> tuple[ExtendedFit, ...]:
    """The fits, best evidence first; those near the best are brought to their optimum."""
    top = max((f.log_evidence for f in fits), default=0.0)
    near = top - RULES.fit.close_call - RULES.fit.close_call_share * abs(top)
    return rank_by_evidence([finish_fit(f) if f.log_evidence > near else f for f in fits])


def fit_mechanism(base: ExtendedFit, score: Score, signatures: Signatures, reach: float = np.inf) -> ExtendedFit:
    """The optimum with one mechanism more.

    Never worse than `base` but for the priors of the mechanism: a start at a vanishing severity is among those tried.

    Parameters
    ----------
    base : the model to which the mechanism is added
    score : the mechanism in a variant, and the point at which the screen saw it best
    signatures : all points of the screen
    reach : χ² to which the fit has to come down to be of use; a search that will not ends early
    """
    of = replace(base.of, chosen=(*base.of.chosen, score.chosen))
    best = follow_to_end(base, min(_fit_from_starts(base, of, score, signatures), key=lambda f: f.chi2), reach)
    if not score.chosen.mechanism.absorbed and _hides_causes(base):
        best = min(best, _fit_from_afar(base, of, score.chosen.mechanism, reach), key=lambda f: f.chi2)
    if score.chosen.mechanism.absorbed:
        best = _revive_arms(base, best, reach)
    if not best.chi2 <= base.chi2:
        faint = scale_severities(score.chosen.mechanism, score.values, _SMALL)
        start = of.make_entries(base.theta, (*base.values, faint))
        again = of.fit(start, most=_ROUGHLY, near=base, thorough=False)
        best = again if not best.chi2 < again.chi2 else best
    return best


def _fit_from_starts(base: ExtendedFit, of: Extended, score: Score, signatures: Signatures) -> list[ExtendedFit]:
    """Rough fits of one mechanism more, from all starts that are worth it."""
    mechanism = score.chosen.mechanism
    starts = _list_starts(base, of, score, signatures)
    entries = [of.make_entries(_make_room(base, score.chosen, values), (*base.values, values)) for values in starts]
    if mechanism.absorbed:
        # Film and rig first: they must make room before the severity may move.
        rooms = drop_astray([of.fit_material(x, _ROUGHLY, base) for x in entries], base)
        begins = [(room.x, room.jacobian) for room in rooms]
    else:
        begins = [(x, of.lend(base)) for x in entries]
    if mechanism.as_filed is not None and any(base.of.model.rigs):
        begins.append((_start_as_filed(of, base, mechanism.as_filed), of.lend(base)))
    if len(begins) == 1 or (mechanism.absorbed and base.of.leaves_film):
        # As long as film and rig make room, the search that is behind may end ahead.
        return [of.fit(x, most=_ROUGHLY, jacobian=j, thorough=False) for x, j in begins]
    begun = sorted((of.fit(x, most=_FEW, jacobian=j, thorough=False) for x, j in begins), key=lambda f: f.chi2)
    return [
        f if f.solution.converged else of.fit(f, most=_ROUGHLY - _FEW, thorough=False)
        for f in begun[: RULES.fit.followed]
    ]


def _fit_from_afar(base: ExtendedFit, of: Extended, mechanism: Mechanism, reach: float) -> ExtendedFit:
    """The optimum from the largest plausible severity, to which film and rig have made room.

    No slope leads there from where the screen looks: film and rig stand where they hide a strong effect.
    """
    far = {p.name: p.high if p.role == SEVERITY else p.start for p in mechanism.parameters}
    room = of.fit_material(of.make_entries(base.theta, (*base.values, far)), _ROUGHLY, base)
    return follow_to_end(base, of.fit(room.x, most=_ROUGHLY, jacobian=room.jacobian, thorough=False), reach)


def _list_starts(base: ExtendedFit, of: Extended, score: Score, signatures: Signatures) -> list[Start]:
    """Parameters from which one mechanism more is searched: the screen's best point first."""
    mechanism = score.chosen.mechanism
    part = float(np.clip(score.share, _LEAST_SHARE, _MOST_SHARE))
    first: Start = scale_severities(mechanism, score.values, part)
    if mechanism.absorbed:
        others = sorted(_list_levels(score, signatures), key=_make_remaining(base, of, score.chosen))
        return [first, *others[: RULES.fit.starts]]
    if mechanism.onset:
        return [first, *_start_above_onset(base, of, score, signatures)]
    return [first]


def _list_levels(score: Score, signatures: Signatures) -> list[Start]:
    """The other points of the screen for the same mechanism and variant: the best one of each severity."""
    best: dict[tuple[float, ...], tuple[float, Start]] = {}
    names = [p.name for p in score.chosen.mechanism.severities]
    for c, values, along in zip(signatures.chosen, signatures.values, signatures.score, strict=True):
        if c != score.chosen:
            continue
        key = tuple(values[n] for n in names)
        if key not in best or along > best[key][0]:
            best[key] = float(along), values
    return [dict(values) for _, values in best.values() if dict(values) != dict(score.values)]


def _start_above_onset(base: ExtendedFit, of: Extended, score: Score, signatures: Signatures) -> list[Start]:
    """Low severities, each with the shape that leaves least.

    The screen's part of a high severity may lie below where anything begins, and no slope leads out of there; and the
    shape that a high severity would have to have is not that of a low one.
    """
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


def _start_as_filed(of: Extended, base: ExtendedFit, as_filed: Callable[[float, float], Start]) -> Float:
    """Entries with the rig as its file has it, and its deviations in the mechanism: only the priors have a slope along
    that exchange."""
    model, theta = base.of.model, base.of.model.with_rigs_as_filed(base.theta)
    pairs = zip(model.physical(base.theta).rigs, model.physical(theta).rigs, model.rigs, strict=True)
    known = [(here, filed) for here, filed, prior in pairs if prior is not None]
    mass = float(np.mean([here.mass / filed.mass for here, filed in known]))
    stiffness = float(np.mean([here.stiffness / filed.stiffness for here, filed in known]))
    return of.make_entries(theta, (*base.values, as_filed(mass - 1, stiffness - 1)))


def _make_room(base: ExtendedFit, chosen: Chosen, values: Start) -> Float:
    """θ with a film, and an actuation, that are stronger by what the mechanism takes at rest."""
    softening = chosen.mechanism.softening
    if softening is None:
        return base.theta
    model, theta = base.of.model, base.theta.copy()
    more = -float(np.log(max(softening(values), 1e-3)))
    theta[: 1 + model.arms] += more
    actuation = model.index(ACTUATION)
    if actuation is not None:
        theta[actuation] += more
    return theta


def _make_remaining(base: ExtendedFit, of: Extended, chosen: Chosen) -> Callable[[Start], float]:
    """A function of a start: χ² that stays once everything that the base may move has made room, to first order."""
    absorbed = make_absorbed_basis(base)

    def compute_remaining(values: Start) -> float:
        (residual,) = of.residuals(of.make_entries(_make_room(base, chosen, values), (*base.values, values))[None])
        seen = residual[: absorbed.shape[0]]
        kept = float(residual @ residual - np.sum((absorbed.T @ seen) ** 2))
        return kept if np.isfinite(kept) else np.inf

    return compute_remaining


def drop_astray(rooms: Sequence[Solution], base: ExtendedFit) -> list[Solution]:
    """Of starts at several severities those from which the data can be reached, the nearest in any case; all where much
    is to explain.

    Parameters
    ----------
    rooms : where film and rig are at their best for each severity
    base : the model without the mechanism
    """
    astray = np.inf if _is_strong(base) else RULES.fit.astray * base.chi2
    least = min(room.chi2 for room in rooms)
    return [room for room in rooms if room.chi2 <= max(astray, least)]


def _may_be_unseen(id: str, base: ExtendedFit) -> bool:
    """Whether a screen sees next to nothing of a strong mechanism."""
    return MECHANISMS[id].absorbed or _hides_causes(base)


def _hides_causes(base: ExtendedFit) -> bool:
    """Whether a model of film and rig alone stands where a strong cause has bent it to."""
    return base.of.leaves_film and _is_strong(base)


def _is_strong(base: ExtendedFit) -> bool:
    """Whether so much is to explain that causes may be far from where a screen sees them."""
    return base.chi2 > RULES.fit.strong * base.of.session.size


def follow_to_end(base: ExtendedFit, fit: ExtendedFit, reach: float) -> ExtendedFit:
    """On from a rough optimum as long as that adds to what it explains: a strong effect is far from where a screen sees
    it.

    Parameters
    ----------
    base : the model without the mechanism
    fit : where the search stands
    reach : χ² to which the fit has to come down to be of use; a search that will not ends early
    """
    for _ in range(_MOST_ROUNDS):
        if fit.solution.converged:
            break
        again = fit.of.fit(fit, most=_ROUGHLY, thorough=False)
        fall, fit = fit.chi2 - again.chi2, again
        stands_still = not fall > RULES.fit.still_falling * abs(base.chi2 - again.chi2)
        if stands_still or fit.chi2 - RULES.fit.hopeless * fall > reach:
            break
    return fit


def _revive_arms(base: ExtendedFit, fit: ExtendedFit, reach: float) -> ExtendedFit:
    """The fit, or a better one from where its arms that have vanished are as in `base`.

    An arm of next to no stiffness has no slope left by which it could come back, and a mechanism that begins too strong
    takes more of the arms than it needs in the end.
    """
    arms = fit.of.model.arms
    springs = 1 + np.arange(arms)
    vanished = springs[fit.theta[springs] < base.theta[springs] + np.log(RULES.fit.vanished)]
    if vanished.size == 0:
        return fit
    x = fit.x.copy()
    for places in (vanished, vanished + arms):
        x[places] = base.theta[places]
    again = follow_to_end(base, fit.of.fit(x, most=_ROUGHLY, near=base, thorough=False), reach)
    return min(fit, again, key=lambda f: f.chi2)


def finish_fit(fit: ExtendedFit) -> ExtendedFit:
    """The same fit brought to its optimum, and confirmed with central differences."""
    found = fit.of.refine(fit.of.fit(fit, most=_THOROUGHLY))
    for _ in range(_CONFIRMATIONS):
        again = fit.of.continue_fit(found, most=_TRIALS)
        fall = found.chi2 - again.chi2
        if fall < RULES.fit.settled_chi2:
            break
        found = fit.of.refine(again)
        if fall < RULES.fit.settled_share * found.chi2:
            break
    return found


def temper_fit(fit: ExtendedFit) -> ExtendedFit:
    """The optimum of the same causes where every block may be wrong by a share of what they leave of it."""
    session = fit.of.session
    of = fit.of.reweigh(temper_weights(session, session.whiten(session.value - fit.of.predict(fit.x))))
    return of.refine(of.fit(fit.x, most=_ROUGHLY, near=fit))


def settle_outliers(fit: ExtendedFit) -> ExtendedFit:
    """The optimum with blocks that the model does not describe counted for less: the film is where the others agree."""
    tempered = fit.of.weight
    for _ in range(_SETTLING):
        weight = lower_outlier_weights(fit, tempered)
        if np.allclose(weight, fit.of.weight, rtol=_SAME_WEIGHT):
            break
        of = fit.of.reweigh(weight)
        fit = of.refine(of.fit(fit.x, most=_THOROUGHLY, near=fit))
    return fit


def drop_mechanism(fit: ExtendedFit, number: int, theta: Float | None = None) -> ExtendedFit:
    """The model without mechanism `number` of a fit, with all else where it is, or film and rig at other entries theta (P,)."""
    of, values = _leave_out(fit, number)
    return of.fit(of.make_entries(fit.theta if theta is None else theta, values), most=0)


def _leave_out(fit: ExtendedFit, number: int) -> tuple[Extended, tuple[Start, ...]]:
    """The model without mechanism `number`, and what the values of the others are."""
    chosen = tuple(c for i, c in enumerate(fit.of.chosen) if i != number)
    return replace(fit.of, chosen=chosen), tuple(v for i, v in enumerate(fit.values) if i != number)


def hand_over_relaxation(fit: ExtendedFit, number: int) -> Float | None:
    """Entries (P,) of film and rig with a relaxation that a fit names taken up by an arm; None where it names none.

    Without it the film would have to find that stiffness again, along a valley in which little falls. The arm next to it takes it on, or
    any one that does less gives its place to it: which of these leaves least decides.
    """
    as_arm = fit.of.chosen[number].mechanism.as_arm
    model, film = fit.of.model, fit.of.model.physical(fit.theta).film
    if as_arm is None or not film.k:
        return None
    values = fit.values[number]
    more, time_s = values["stiffness_ratio"] * film.k0, values["time_constant_s"]
    nearest = int(np.argmin([abs(np.log(tau / time_s)) for tau in film.tau]))
    k, tau = film.k[nearest], film.tau[nearest]
    together = float(np.exp((k * np.log(tau) + more * np.log(time_s)) / (k + more))), k + more
    without, others = _leave_out(fit, number)
    starts = []
    for place, arm in [(nearest, together), *((i, (time_s, more)) for i in range(model.arms))]:
        arms = list(zip(film.tau, film.k, strict=True))
        arms[place] = arm
        arms.sort(reverse=True)
        theta = model.theta(replace(film, k=tuple(k for _, k in arms), tau=tuple(t for t, _ in arms)))
        theta[model.film.stop :] = fit.theta[model.film.stop :]
        starts.append(theta)
    left = without.residuals(np.array([without.make_entries(theta, others) for theta in starts]))
    return starts[int(np.argmin(np.sum(np.nan_to_num(left, nan=np.inf) ** 2, axis=1)))]


def order_causes(fit: ExtendedFit) -> ExtendedFit:
    """The same fit with its mechanisms in the order of what each explains beside the rest."""
    number = len(fit.of.chosen)
    if number < 2:
        return fit
    order = np.argsort([-finish_fit(drop_mechanism(fit, i)).chi2 for i in range(number)], kind="stable")
    if np.array_equal(order, np.arange(number)):
        return fit
    of = replace(fit.of, chosen=tuple(fit.of.chosen[i] for i in order))
    return finish_fit(of.fit(of.make_entries(fit.theta, tuple(fit.values[i] for i in order)), most=3))
