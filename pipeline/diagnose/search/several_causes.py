"""Several causes at once: further ones added to a single one, and dropped again where the others do without.

A further cause has to add more than the form of those before it can be wrong by. Where one cause explains nearly everything, its
form is known far better than was assumed, and a weaker one beside it is looked for on the scale that this leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import (
    confirm_best,
    drop_mechanism,
    finish_fit,
    fit_each_mechanism,
    rank_by_evidence,
)
from pipeline.diagnose.search.screen import Score, Secants, compute_secants, compute_signatures, find_best_scores
from pipeline.diagnose.search.tempering import (
    estimate_form_share,
    expect_noise_chi2,
    measure_excess,
    sum_by_part,
    temper_weights,
)
from schemas.arrays import Int

_ROUGHLY = 6


@dataclass(frozen=True)
class Searched:
    """The plain model, the single causes, best evidence first, and the model with all causes; on one scale. None: no cause."""

    plain: ExtendedFit
    singles: tuple[ExtendedFit, ...]
    final: ExtendedFit | None


def combine_causes(
    untempered: ExtendedFit, plain: ExtendedFit, singles: Sequence[ExtendedFit], changes: Secants
) -> Searched:
    """Causes added one by one to the best single ones, and those that are no longer needed dropped."""
    worth = [f for f in singles if f.log_evidence > plain.log_evidence]
    if not worth:
        return Searched(plain, tuple(singles), None)
    best, shown = _add_causes(plain, worth, changes)
    if len(best.of.chosen) > 1:
        return Searched(plain, tuple(singles), _drop_needless_causes(plain, best, shown))
    return _search_weaker_causes(untempered, plain, singles, changes) or Searched(plain, tuple(singles), best)


def _search_weaker_causes(
    untempered: ExtendedFit, plain: ExtendedFit, singles: Sequence[ExtendedFit], changes: Secants
) -> Searched | None:
    """Causes beside the best single one, on the scale that its form is seen to need; None where that is no finer, or shows none.

    `changes`, those about the plain model, say whether there may be any that is worth the trouble of those about the cause.
    """
    alone = singles[0]
    raw = alone.of.with_weight(np.ones(untempered.of.session.size))
    share = estimate_form_share(untempered, finish_fit(raw.fit(alone.x, most=_ROUGHLY)))
    if share > RULES.cause.finer_scale * RULES.temper.share:
        return None
    weight = temper_weights(untempered.of.session, untempered.misfit, share)

    def moved(fit: ExtendedFit) -> ExtendedFit:
        of = fit.of.with_weight(weight)
        return of.refined(of.fit(fit.x, most=_ROUGHLY))

    plain, base = moved(plain), finish_fit(moved(alone))
    looked = compute_signatures(changes, base)
    found = find_best_scores(looked)
    if not found or not looked.reaches(found[0].statistic, RULES.cause.look_level):
        return None
    best, shown = _add_causes(plain, [base], compute_secants(base), share)
    if len(best.of.chosen) > 1:
        best = _drop_needless_causes(plain, best, shown, share)
    if len(best.of.chosen) == 1:
        return None
    return Searched(plain, rank_by_evidence([base, *(moved(f) for f in singles[1:])]), best)


def _add_causes(
    plain: ExtendedFit, worth: Sequence[ExtendedFit], changes: Secants, share: float = RULES.temper.share
) -> tuple[ExtendedFit, bool]:
    """Causes added one by one: a further one where it is significant on what is left, and adds a share worth naming.

    That there is one a cause shows that is like none of those before it; which it is the evidence says, whatever they are like. True
    where one was chosen in this way.
    """
    best, shown = worth[0], False
    for number in range(1, RULES.cause.most):
        bases = worth[: RULES.cause.bases] if number == 1 else [best]
        bases = [b for b in bases if b.chi2 < RULES.cause.hopeless_base * worth[0].chi2]
        further: list[ExtendedFit] = []
        for base in bases:
            looked = compute_signatures(changes, base)
            found = find_best_scores(looked)
            if not found or not looked.reaches(found[0].statistic, RULES.cause.level):
                if base is bases[0] and measure_excess(plain, base) < RULES.cause.noise:
                    break  # what the best leaves is noise: others with a cause more could explain nothing else
                continue
            promising = [s for s in found if _is_promising(plain, base, s, share)]
            goal = min([best.chi2 - RULES.cause.close, *(f.chi2 + RULES.cause.out_of_reach for f in further)])
            further += fit_each_mechanism(base, promising, looked, 2, goal=goal)
        better = [f for f in further if _is_worthwhile(plain, best, f, shown, share)]
        if not better:
            break
        sure = max(f.log_evidence for f in better) + RULES.cause.close
        likelier = [f for f in further if f.log_evidence > sure and _is_worthwhile(plain, best, f, True, share)]
        shown = shown or bool(likelier)
        best = confirm_best(likelier or better)[0]
    return best, shown


def _is_promising(plain: ExtendedFit, base: ExtendedFit, score: Score, share: float) -> bool:
    """Whether a screen's Λ comes near what a further cause must add; fits often find more than the screen, rarely twice that."""
    least = RULES.cause.screen_part * RULES.cause.leaving_noise * RULES.cause.of_explained * _scale_demand(share)
    return score.statistic > max(
        2 * RULES.cause.close, least * min(plain.chi2 - base.chi2, base.chi2 - expect_noise_chi2(plain))
    )


def _scale_demand(share: float) -> float:
    """What is asked of a further cause where forms may be wrong by a share, over what is asked as long as nothing is known of that."""
    return (share / RULES.temper.share) ** 2 if share > RULES.cause.exact_form else 0.0


def _is_worthwhile(
    plain: ExtendedFit, best: ExtendedFit, more: ExtendedFit, shown: bool = False, share: float = RULES.temper.share
) -> bool:
    """Whether a further cause is one, and not the form of those before it: it has to add much where it adds anything.

    shown : there is one, whatever it is like
    """
    if more.log_evidence - best.log_evidence < RULES.cause.close:
        return False
    before, so_far, now = (sum_by_part(f) for f in (plain, best, more))
    added = so_far - now
    order = np.argsort(-added)
    most = np.cumsum(np.maximum(added[order], 0.0)) <= RULES.cause.place * np.sum(np.maximum(added, 0.0))
    where = order[: int(most.sum()) + 1]
    noise = sum_by_part(plain, noise=True)
    adds, explained = float(added[where].sum()), float((before - so_far)[where].sum())
    of_another = shown or explained < RULES.cause.nothing_explained * adds or not _contains_confusable(more)
    form = _scale_demand(share) * (
        RULES.cause.leaving_noise if measure_excess(plain, more) < RULES.cause.noise and of_another else 1.0
    )
    least = (
        (form * RULES.cause.of_all if of_another else RULES.cause.of_all_if_alike) * (plain.chi2 - best.chi2),
        form * RULES.cause.of_explained * explained,
        RULES.cause.of_left * float((so_far - noise)[where].sum()),
    )
    return adds > max(least)


def _contains_confusable(fit: ExtendedFit) -> bool:
    """Whether one of the causes can be taken for another of them: both together may be the form of one."""
    ids = {c.id for c in fit.of.chosen}
    return any(ids & set(c.mechanism.confusable) for c in fit.of.chosen)


def _drop_needless_causes(
    plain: ExtendedFit, final: ExtendedFit, shown: bool = False, share: float = RULES.temper.share
) -> ExtendedFit:
    """Causes that are no longer needed are dropped; those that stay are in the order of what each explains beside the others."""
    while len(final.of.chosen) > 1:
        fewer = [drop_mechanism(final, i) for i in range(len(final.of.chosen))]
        best = max(fewer, key=lambda f: f.log_evidence)
        if _is_worthwhile(plain, best, final, shown, share):
            return _reorder_causes(final, np.argsort([-f.chi2 for f in fewer], kind="stable"))
        final = best
    return final


def _reorder_causes(final: ExtendedFit, order: Int) -> ExtendedFit:
    """The same fit with its causes in another order."""
    if np.array_equal(order, np.arange(order.size)):
        return final
    of = replace(final.of, chosen=tuple(final.of.chosen[i] for i in order))
    return finish_fit(of.fit(of.entries(final.theta, tuple(final.values[i] for i in order)), most=3))
