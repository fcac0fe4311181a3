"""Several causes at once: further ones beside the best single ones, as long as that makes a hypothesis more probable.

What a cause's own form leaves is no further cause: each is looked for under the weights that the likelihood gives to what the causes
before it leave. Forward steps propose, dropping each cause in turn takes back, and the posterior of all of them decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.diagnose.mechanisms import MECHANISMS
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.fit_mechanisms import (
    confirm_best,
    drop_mechanism,
    finish_fit,
    fit_each_mechanism,
    hand_over_relaxation,
    temper_fit,
)
from pipeline.diagnose.search.form_functions import is_form_of
from pipeline.diagnose.search.posterior import (
    Hypothesis,
    Posterior,
    rank_hypotheses,
    reweigh_fit,
    settle_hypotheses,
    weigh_fit,
)
from pipeline.diagnose.search.screen import Score, Secants, compute_signatures, find_best_scores

_ROUGHLY = 6
"""Steps of a fit under other weights."""
_FEWEST, _MOST = 2, 5
"""Further mechanisms that are fitted on each base at least and at most."""
_MOST_PUT_BACK = 2
"""Hypotheses whose causes are searched anew."""


def add_causes(singles: Sequence[Hypothesis], changes: Secants) -> list[Hypothesis]:
    """Hypotheses of several causes.

    Parameters
    ----------
    singles : hypotheses of one cause each, or of one beside the lag of the amplifier
    changes : of all mechanisms about the plain model, or that with the lag of the amplifier

    Returns
    -------
    Those that were tried, and simpler ones; empty where nothing that a single cause leaves shows another
    """
    found: list[Hypothesis] = []
    bases = choose_bases(singles)
    for _ in range(1, RULES.cause.most):
        more = [h for base in bases if len(base.causes) < RULES.cause.most for h in _add_cause(base, changes)]
        more += _try_beside_others(more, bases)
        found += more
        bases = [h for h in rank_hypotheses(more)[:1] if h.log_joint > bases[0].log_joint] if bases else []
        if not bases:
            break
    found += _put_back(found, changes)
    return [*found, *_take_back(found, singles)]


def choose_bases(singles: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The most probable causes, each where it is at its best: two ends of a search for one cause are one base.

    What contradicts one base altogether hardly weighs beside it any more, and shows beside another.
    """
    return list(Posterior.of(singles).hypotheses[: RULES.cause.bases])


def try_causes_of_form(
    base: Hypothesis, regions: Sequence[Hypothesis], listed: Sequence[Hypothesis], changes: Secants
) -> list[Hypothesis]:
    """Listed causes beside a base that a region without a name may be the form of, where none was tried.

    What has no name is found in any form; a cause whose own form the screen hardly sees would never be asked beside it.

    Parameters
    ----------
    base : the plain model, or one with causes
    regions : at their optima, beside the base
    listed : hypotheses of listed causes so far; regions less probable than the best of them ask for nothing
    changes : of all mechanisms about the plain model, or that with the lag of the amplifier
    """
    least = max((h.log_joint for h in listed), default=-np.inf)
    likely = [h.region.region for h in regions if h.region is not None and h.log_joint > least]
    known = {frozenset(h.causes) for h in listed}
    ids = [
        id
        for id, mechanism in MECHANISMS.items()
        if any(is_form_of(region, mechanism) for region in likely) and {*base.causes, id} not in known
    ]
    if not ids:
        return []
    fit = reweigh_fit(base, _ROUGHLY)
    signatures = compute_signatures(changes, fit)
    scores = [s for s in find_best_scores(signatures) if s.chosen.id in ids]
    found = [weigh_fit(f) for f in confirm_best(fit_each_mechanism(fit, scores, signatures, len(ids)))]
    return [*found, *_take_back(found, listed)]


def _add_cause(base: Hypothesis, changes: Secants) -> list[Hypothesis]:
    """The causes of a base with one more, where what they leave shows one.

    It is looked for under two kinds of weights. Under those of the base's own likelihood, what is the wrong form of its causes counts for
    little; but so does what another cause does, for to that likelihood it is noise that is louder, or something that nobody has thought of.
    So it is looked for as the first one was, too: under weights by which every block may be wrong by a share of its misfit.
    Where what a screen promises most of makes nothing more probable, what it promises less of is asked as well.
    """
    own = reweigh_fit(base, _ROUGHLY)
    found: list[Hypothesis] = []
    for fit in (own, temper_fit(own)):
        signatures = compute_signatures(changes, fit)
        scores = find_best_scores(signatures)
        if not scores or not signatures.reaches(scores[0].statistic, RULES.cause.level):
            continue
        for ids in rank_promising(scores):
            own_scores = [
                s for s in scores if s.chosen.id in ids and signatures.reaches(s.statistic, RULES.cause.level)
            ]
            fits = fit_each_mechanism(fit, own_scores, signatures, len(ids)) if own_scores else []
            found += settle_hypotheses([weigh_fit(f) for f in confirm_best(fits)])
            if any(h.log_joint > base.log_joint for h in found):
                break
    return settle_hypotheses(found)


def rank_promising(scores: Sequence[Score]) -> tuple[list[str], list[str]]:
    """Mechanisms that a screen promises nearly as much of as of its best, for which of them explains most only fits tell; and the next."""
    ids = list(dict.fromkeys(s.chosen.id for s in scores))
    close = {s.chosen.id for s in scores if s.statistic > RULES.fit.close_further * scores[0].statistic}
    number = int(np.clip(len(close), _FEWEST, _MOST))
    return ids[:number], ids[number:_MOST]


def _try_beside_others(found: Sequence[Hypothesis], bases: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses of a further cause that shows beside one base, beside the other bases.

    Bases that do nearly as well leave a further cause to be seen by a little more or a little less; where only one of them had it tried
    beside it, that one would be believed for nothing else.

    Parameters
    ----------
    found : of a base and a further cause, which is the last of its fit
    bases : the bases
    """
    known = {frozenset(h.causes) for h in found}
    best = max((h.log_joint for h in found), default=0.0)
    near = [h for h in rank_hypotheses(found) if h.log_joint > best - RULES.fit.close_call]
    # Of each further cause the fit that does best is the last, and stays.
    fits = {h.causes[-1]: h.model for h in reversed(near)}
    tried = []
    for base in bases:
        further = [
            fit for id, fit in fits.items() if id not in base.causes and frozenset((*base.causes, id)) not in known
        ]
        if not further:
            continue
        beside = reweigh_fit(base, _ROUGHLY)
        for fit in further:
            of = replace(beside.of, chosen=(*beside.of.chosen, fit.of.chosen[-1]))
            start = of.make_entries(beside.theta, (*beside.values, fit.values[-1]))
            tried.append(weigh_fit(finish_fit(of.fit(start, most=_ROUGHLY))))
    return settle_hypotheses(tried)


def _take_back(found: Sequence[Hypothesis], others: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Hypotheses near the best without each of their causes in turn: a cause may come to a better optimum beside another that does next
    to nothing than it came to alone.

    What is left of several hypotheses may be the same causes: of these the best goes on to its optimum.
    """
    best = max((h.log_joint for h in (*others, *found)), default=0.0)
    near = [h for h in found if h.log_joint > best - RULES.fit.close_call]
    there = Posterior.of(without for h in near for without in _drop_each(h)).hypotheses
    return settle_hypotheses([*there, *(weigh_fit(finish_fit(h.model)) for h in there)])


def _put_back(found: Sequence[Hypothesis], changes: Secants) -> list[Hypothesis]:
    """The most probable hypotheses of several causes with each cause in turn searched anew beside the others.

    A cause was found beside what came before it, and where it stands then the next one was found: with all of them there, another of its
    optima may be the better one.
    """
    several = [h for h in Posterior.of(found).hypotheses if len(_list_own(h)) > 1][:_MOST_PUT_BACK]
    best = max((h.log_joint for h in several), default=0.0)
    again: list[Hypothesis] = []
    for h in several:
        for number in _list_own(h) if h.log_joint > best - RULES.fit.close_call else ():
            id = h.model.of.chosen[number].id
            base = reweigh_fit(weigh_fit(finish_fit(drop_mechanism(h.model, number))), _ROUGHLY)
            signatures = compute_signatures(changes, base)
            scores = [s for s in find_best_scores(signatures) if s.chosen.id == id]
            again += [weigh_fit(f) for f in confirm_best(fit_each_mechanism(base, scores, signatures, 1))]
    return settle_hypotheses(again)


def _list_own(hypothesis: Hypothesis) -> list[int]:
    """Numbers of the causes of a hypothesis that are no lag which the monitor shows."""
    return [i for i, c in enumerate(hypothesis.model.of.chosen) if not c.is_monitored_lag]


def _drop_each(hypothesis: Hypothesis) -> list[Hypothesis]:
    """The hypothesis without each of its causes in turn, all else where it is. What a relaxation did, an arm of the film may do."""
    fit = hypothesis.model
    if len(fit.of.chosen) < 2:
        return []
    found = []
    for i in range(len(fit.of.chosen)):
        found.append(drop_mechanism(fit, i))
        with_arm = hand_over_relaxation(fit, i)
        if with_arm is not None:
            found.append(drop_mechanism(fit, i, with_arm))
    return [weigh_fit(f) for f in found]
