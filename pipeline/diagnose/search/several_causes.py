"""Several causes at once: further ones added to a single one, and dropped again where the others do without.

A further cause has to add more than the form of those before it can be wrong by. Where one cause explains nearly
everything, its form is known far better than was assumed, and a weaker cause beside it is looked for on the scale that
this leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import (
    confirm_best,
    drop_mechanism,
    finish_fit,
    fit_each_mechanism,
    rank_by_evidence,
    reorder_mechanisms,
)
from pipeline.diagnose.search.screen import (
    Score,
    Secants,
    compute_secants,
    compute_signatures,
    find_best_scores,
)
from pipeline.diagnose.search.tempering import (
    estimate_form_share,
    expect_noise_chi2,
    measure_excess,
    sum_by_part,
    temper_weights,
)

_ROUGHLY = 6
"""Steps of a fit under other weights."""
_EACH = 2
"""Further mechanisms that are fitted at least on each base."""


@dataclass(frozen=True)
class Combination:
    """The plain model, the single mechanisms, best evidence first, and the model with all causes; under the same
    weights.

    `final` is None where no mechanism is worth its parameters.
    """

    plain: ExtendedFit
    singles: tuple[ExtendedFit, ...]
    final: ExtendedFit | None


def combine_causes(
    noise_fit: ExtendedFit, plain: ExtendedFit, singles: Sequence[ExtendedFit], changes: Secants
) -> Combination:
    """Causes added one by one to the best single mechanisms, and those dropped that are no longer needed.

    Parameters
    ----------
    noise_fit, plain : the plain model with weights of the noise alone, and with tempered ones
    singles : mechanisms fitted alone, best evidence first
    changes : of all mechanisms about the plain model
    """
    worth = [f for f in singles if f.log_evidence > plain.log_evidence]
    if not worth:
        return Combination(plain, tuple(singles), None)
    best, is_shown = _add_causes(plain, worth, changes)
    if len(best.of.chosen) > 1:
        return Combination(plain, tuple(singles), _drop_needless(plain, best, is_shown))
    finer = _search_weaker(noise_fit, plain, singles, changes)
    return finer or Combination(plain, tuple(singles), best)


def _search_weaker(
    noise_fit: ExtendedFit, plain: ExtendedFit, singles: Sequence[ExtendedFit], changes: Secants
) -> Combination | None:
    """Causes beside the best single one, with weights by the form error that it is seen to have.

    None where that is no smaller than was assumed, or no further cause shows. Changes about the plain model say whether
    one may be there that is worth the cost of those about the cause.
    """
    alone = singles[0]
    raw = alone.of.reweigh(np.ones(noise_fit.of.session.size))
    share = estimate_form_share(noise_fit, finish_fit(raw.fit(alone.x, most=_ROUGHLY)))
    if share > RULES.cause.finer_scale * RULES.temper.share:
        return None
    weight = temper_weights(noise_fit.of.session, noise_fit.misfit, share)

    def reweigh(fit: ExtendedFit) -> ExtendedFit:
        of = fit.of.reweigh(weight)
        return of.refine(of.fit(fit.x, most=_ROUGHLY))

    plain, base = reweigh(plain), finish_fit(reweigh(alone))
    signatures = compute_signatures(changes, base)
    scores = find_best_scores(signatures)
    if not scores or not signatures.reaches(scores[0].statistic, RULES.cause.look_level):
        return None
    best, is_shown = _add_causes(plain, [base], compute_secants(base), share)
    if len(best.of.chosen) > 1:
        best = _drop_needless(plain, best, is_shown, share)
    if len(best.of.chosen) == 1:
        return None
    return Combination(plain, rank_by_evidence([base, *(reweigh(f) for f in singles[1:])]), best)


def _add_causes(
    plain: ExtendedFit, worth: Sequence[ExtendedFit], changes: Secants, share: float = RULES.temper.share
) -> tuple[ExtendedFit, bool]:
    """Causes added one by one: a further one where it is significant in what is left, and adds a share worth naming.

    A mechanism that is like none of the causes shows that there is a further one; which it is the evidence says,
    whatever they are like. True where one was chosen in this way.
    """
    best, is_shown = worth[0], False
    for number in range(1, RULES.cause.most):
        bases = worth[: RULES.cause.bases] if number == 1 else [best]
        bases = [b for b in bases if b.chi2 < RULES.cause.hopeless_base * worth[0].chi2]
        further = _fit_further(plain, bases, best, changes, share)
        better = [f for f in further if _is_worth_naming(plain, best, f, is_shown, share)]
        if not better:
            break
        sure = max(f.log_evidence for f in better) + RULES.cause.close
        likelier = [f for f in further if f.log_evidence > sure and _is_worth_naming(plain, best, f, True, share)]
        is_shown = is_shown or bool(likelier)
        best = confirm_best(likelier or better)[0]
    return best, is_shown


def _fit_further(
    plain: ExtendedFit, bases: Sequence[ExtendedFit], best: ExtendedFit, changes: Secants, share: float
) -> list[ExtendedFit]:
    """Fits with one cause more than each of the bases, where what these leave shows one."""
    further: list[ExtendedFit] = []
    for base in bases:
        signatures = compute_signatures(changes, base)
        scores = find_best_scores(signatures)
        if not scores or not signatures.reaches(scores[0].statistic, RULES.cause.level):
            if base is bases[0] and measure_excess(plain, base) < RULES.cause.noise:
                break  # what the best leaves is noise: others with a cause more could explain nothing else
            continue
        promising = [s for s in scores if _is_promising(plain, base, s, share)]
        goal = min([best.chi2 - RULES.cause.close, *(f.chi2 + RULES.cause.out_of_reach for f in further)])
        further += fit_each_mechanism(base, promising, signatures, _EACH, goal=goal)
    return further


def _is_promising(plain: ExtendedFit, base: ExtendedFit, score: Score, share: float) -> bool:
    """Whether a screen's Λ comes near what a further cause must add; fits often find more than the screen, rarely twice
    that."""
    rules = RULES.cause
    least = rules.screen_part * rules.leaving_noise * rules.of_explained * _scale_demand(share)
    left = base.chi2 - expect_noise_chi2(plain)
    return score.statistic > max(2 * rules.close, least * min(plain.chi2 - base.chi2, left))


def _scale_demand(share: float) -> float:
    """What is asked of a further cause for a form error, over what is asked for the one that is assumed."""
    return (share / RULES.temper.share) ** 2 if share > RULES.cause.exact_form else 0.0


def _is_worth_naming(
    plain: ExtendedFit,
    best: ExtendedFit,
    more: ExtendedFit,
    is_shown: bool = False,
    share: float = RULES.temper.share,
) -> bool:
    """Whether a further cause is one, and not the form of those before it: it has to add much where it adds anything.

    Parameters
    ----------
    plain, best, more : the plain model, that with the causes so far, and that with one more
    is_shown : whether a further cause is known to be there, whatever it is like
    share : form error of the causes so far
    """
    rules = RULES.cause
    if more.log_evidence - best.log_evidence < rules.close:
        return False
    before, so_far, now = (sum_by_part(f) for f in (plain, best, more))
    added = so_far - now
    order = np.argsort(-added)
    most = np.cumsum(np.maximum(added[order], 0.0)) <= rules.place * np.sum(np.maximum(added, 0.0))
    where = order[: int(most.sum()) + 1]
    noise = sum_by_part(plain, noise=True)
    adds, explained = float(added[where].sum()), float((before - so_far)[where].sum())
    is_another = is_shown or explained < rules.nothing_explained * adds or not _contains_confusable(more)
    leaves_noise = measure_excess(plain, more) < rules.noise and is_another
    demand = _scale_demand(share) * (rules.leaving_noise if leaves_noise else 1.0)
    least = (
        (demand * rules.of_all if is_another else rules.of_all_if_alike) * (plain.chi2 - best.chi2),
        demand * rules.of_explained * explained,
        rules.of_left * float((so_far - noise)[where].sum()),
    )
    return adds > max(least)


def _contains_confusable(fit: ExtendedFit) -> bool:
    """Whether one of the causes can be taken for another of them: both together may be the form of one."""
    ids = {c.id for c in fit.of.chosen}
    return any(ids & set(c.mechanism.confusable) for c in fit.of.chosen)


def _drop_needless(
    plain: ExtendedFit, final: ExtendedFit, is_shown: bool = False, share: float = RULES.temper.share
) -> ExtendedFit:
    """The model without causes that are no longer needed; the others in the order of what each explains beside the
    rest."""
    while len(final.of.chosen) > 1:
        fewer = [drop_mechanism(final, i) for i in range(len(final.of.chosen))]
        best = max(fewer, key=lambda f: f.log_evidence)
        if _is_worth_naming(plain, best, final, is_shown, share):
            return reorder_mechanisms(final, np.argsort([-f.chi2 for f in fewer], kind="stable"))
        final = best
    return final
