"""From fits to a verdict: is there anything, which causes explain it, which cannot be told apart, what stays unexplained.

The rule is that of a careful reader. Nothing is selected on noise: without a discrepancy at the calibrated level the search ends.
With one, causes compete on a tempered scale, on which every block may be wrong by a share of its own misfit, for no extension has
exactly the form of reality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.departures import Departure, departures
from pipeline.diagnose.extend import Extended, ExtendedFit
from pipeline.diagnose.plain import PlainFit
from pipeline.diagnose.predict import Simulation
from pipeline.diagnose.refit import finished, proposals, refit, without
from pipeline.diagnose.results import AMBIGUOUS, NAMED, NONE, UNKNOWN
from pipeline.diagnose.screen import Score, Secants, Signatures, scores, secants, signatures
from pipeline.diagnose.session import Session
from pipeline.diagnose.structure import Structure, structure

Float = NDArray[np.float64]

LEVEL = 0.003
"""False-alarm level of the search over the listed mechanisms."""
STRUCTURE_LEVEL = 1e-5
"""The same for patterns that no mechanism proposes; their noise is known less well than that of signatures."""
TEMPER = 0.15
"""Share of a block's misfit that a form which is not quite right may leave."""
CANDIDATES = 8
MOST_CAUSES = 3
_FURTHER = 2
"""Best single causes on which a second one is tried."""
SECOND_SHARE, SECOND_OF_LEFT, SECOND_OF_TRACE = 0.08, 0.4, 0.02
"""Least shares of the misfit explained so far, of what it leaves, and of what the causes so far change, that a further cause must
add in the blocks in which it adds anything: less is the form of those before it."""
SECOND_OF_ALL = 0.01
"""The same of the misfit that the causes so far explain anywhere."""
_WHERE = 0.9
"""Share of what a cause adds that counts as the place where it does."""
SECOND_LEVEL = 1e-3
CLOSE = 4.6
"""Difference of log evidence (9.2 of Λ) within which causes cannot be told apart."""
CLOSE_MISFIT = 1.3
"""Ratio of what two causes leave, root mean square over the noise, within which the form decides, not the data."""
EXPLAINED = 0.6
"""Share of the misfit that the causes must explain together for their names to be said, where more than noise is left."""
LEFT_LEVEL = 1e-3
DEPARTED_LEVEL = 1e-5
"""Probability below which a quantity left free differs."""
_CONFIRMED = 0.8
"""Share of the threshold Λ that a fitted cause must reach, which the screen only promised."""


@dataclass(frozen=True)
class Outcome:
    """What was decided, with the fits behind it; all on the tempered scale but `untempered`.

    plain : the plain model; singles : every single cause tried, best evidence first; final : the model that is believed
    alternatives : fits in which the strongest cause is replaced by one that does as well
    p_value : of the whole search; threshold : Λ at the false-alarm level
    explained : share of the misfit that the final model explains; looked : signatures that the plain model was searched with
    before, after : patterns that the plain and the final model leave; departed : what differs freely beside the final model
    """

    verdict: str
    untempered: ExtendedFit
    plain: ExtendedFit
    singles: tuple[ExtendedFit, ...]
    final: ExtendedFit | None
    alternatives: tuple[ExtendedFit, ...]
    p_value: float
    threshold: float
    explained: float
    looked: Signatures
    before: Structure
    after: Structure | None
    departed: tuple[Departure, ...] = ()


def decide(session: Session, simulation: Simulation, fitted: PlainFit) -> Outcome:
    """Verdict for a session whose plain model is fitted."""
    of = Extended(session, simulation, fitted.model, (), np.ones(session.size))
    start = fitted.theta
    for _ in range(_RESTARTS):
        outcome = _decided(of, start)
        better = _elsewhere(outcome)
        if better is None:
            break
        start = better
    return outcome


def _elsewhere(outcome: Outcome) -> Float | None:
    """Entries at which the plain model does better than where it was left: a search that ended early looks like a discrepancy.

    Asked where the causes gain little more than that could be.
    """
    if not outcome.singles or outcome.plain.chi2 - outcome.singles[0].chi2 > _MANY * outcome.threshold:
        return None
    again = [outcome.plain.of.fit(f.theta) for f in outcome.singles[:2]]
    best = min(again, key=lambda f: f.chi2)
    return best.theta if best.chi2 < outcome.plain.chi2 - _CLEARLY_BETTER else None


_RESTARTS, _MANY, _CLEARLY_BETTER = 3, 10.0, 1.0


def _decided(of: Extended, start: Float) -> Outcome:
    session = of.session
    untempered = of.refined(of.fit(start, most=3))
    against = of.simulation.measured_against(of.model.physical(untempered.theta))
    of = replace(of, simulation=against)
    untempered = ExtendedFit(of, untempered.solution)
    changes = secants(untempered)
    looked = signatures(changes, untempered)
    found = scores(looked)
    before = structure(untempered)
    p_value = looked.p_value(found[0].statistic) if found else 1.0
    threshold = looked.threshold(LEVEL) if found else float("inf")
    listed, unlisted = p_value < LEVEL, before.p_value < STRUCTURE_LEVEL
    nothing = Outcome(
        NONE, untempered, untempered, (), None, (), p_value, threshold, float("nan"), looked, before, None
    )
    if not (listed or unlisted):
        return nothing
    weighted = of.with_weight(tempered(session, untempered.misfit))
    plain = weighted.refined(weighted.fit(untempered.theta))
    weakened = signatures(changes, plain)
    singles = _confirmed(_tried(plain, scores(weakened), weakened, CANDIDATES))
    confirmed = max((plain.chi2 - f.chi2 for f in singles), default=0.0)
    left = structure(plain) if unlisted else None
    patterned = left is not None and left.p_value < LEFT_LEVEL
    if not patterned and confirmed < _CONFIRMED * threshold:
        # The screen was led on by what the model absorbs of a strong effect, or a pattern is within the form of the model.
        return replace(nothing, p_value=looked.p_value(confirmed)) if singles else nothing
    final = _forward(plain, singles, changes)
    p_value = min(p_value, before.p_value if unlisted else 1.0)
    if final is None:
        return Outcome(
            UNKNOWN,
            untempered,
            plain,
            singles,
            None,
            (),
            p_value,
            threshold,
            0.0,
            looked,
            before,
            left or structure(plain),
        )
    final = _backward(plain, final)
    singles = _ranked([final if _better_single(final, f) else f for f in singles])
    alternatives = _alternatives(plain, final, singles)
    share = explained(plain, final)
    after = structure(final)
    beside = _departed(plain, final)
    verdict = _verdict(alternatives, share, after, beside)
    return Outcome(
        verdict,
        untempered,
        plain,
        singles,
        final,
        alternatives,
        p_value,
        threshold,
        share,
        looked,
        before,
        after,
        beside,
    )


def tempered(session: Session, misfit: Float) -> Float:
    """(N,) weights: the variance of every block grows by the square of `TEMPER` times its misfit."""
    weight = np.ones(session.size)
    for p in session.places:
        own = misfit[p.first : p.stop]
        excess = max(0.0, float(own @ own) / own.size - 1)
        weight[p.first : p.stop] = 1 / np.sqrt(1 + TEMPER**2 * excess)
    return weight


def explained(plain: ExtendedFit, extended: ExtendedFit) -> float:
    """Share of the plain model's misfit, in excess of the noise, that an extended one explains (tempered scale)."""
    fall = plain.chi2 - extended.chi2
    return float(np.clip(fall / max(plain.chi2 - noise_chi2(plain), fall, 1e-9), 0.0, 1.0))


def noise_chi2(plain: ExtendedFit) -> float:
    """χ² that the noise alone would leave on the tempered scale."""
    return float(np.sum(plain.of.weight**2)) - plain.of.model.size


def _tried(base: ExtendedFit, found: Sequence[Score], looked: Signatures, mechanisms: int) -> list[ExtendedFit]:
    fits = []
    for forms in proposals(found, mechanisms):
        fits.append(max((refit(base, form, looked) for form in forms), key=lambda f: f.log_evidence))
    return fits


def _ranked(fits: Sequence[ExtendedFit]) -> tuple[ExtendedFit, ...]:
    return tuple(sorted(fits, key=lambda f: -f.log_evidence))


def _confirmed(fits: Sequence[ExtendedFit]) -> tuple[ExtendedFit, ...]:
    """Best evidence first, the close ones with their searches brought to an end; nothing of nothing."""
    top = max((f.log_evidence for f in fits), default=0.0)
    return _ranked([finished(f) if f.log_evidence > top - _CLOSE_CALL - 0.02 * abs(top) else f for f in fits])


_CLOSE_CALL = 12.0


def _forward(plain: ExtendedFit, singles: Sequence[ExtendedFit], changes: Secants) -> ExtendedFit | None:
    """Causes added one by one: a further one where it is significant on what is left, and adds a share worth naming."""
    worth = [f for f in singles if f.log_evidence > plain.log_evidence]
    if not worth:
        return None
    best = worth[0]
    for number in range(1, MOST_CAUSES):
        bases = worth[:_FURTHER] if number == 1 else [best]
        bases = [b for b in bases if b.chi2 < _HOPELESS * worth[0].chi2]
        further: list[ExtendedFit] = []
        for base in bases:
            looked = signatures(changes, base)
            found = scores(looked)
            if not found or looked.p_value(found[0].statistic) > SECOND_LEVEL:
                continue
            further += _tried(base, [s for s in found if _promising(plain, base, s)], looked, 2)
        better = [f for f in further if _worthwhile(plain, best, f)]
        if not better:
            break
        best = _confirmed(better)[0]
    return best


_HOPELESS = 3.0


def _promising(plain: ExtendedFit, base: ExtendedFit, score: Score) -> bool:
    """Whether a screen's Λ comes near what a further cause must add; fits often find more than the screen, rarely twice that."""
    return score.statistic > max(
        2 * CLOSE, 0.5 * SECOND_SHARE * min(plain.chi2 - base.chi2, base.chi2 - noise_chi2(plain))
    )


def _worthwhile(plain: ExtendedFit, best: ExtendedFit, more: ExtendedFit) -> bool:
    """Whether a further cause is one, and not the form of those before it: it has to add much where it adds anything."""
    if more.log_evidence - best.log_evidence < CLOSE:
        return False
    before, so_far, now = (_by_block(f) for f in (plain, best, more))
    added = so_far - now
    order = np.argsort(-added)
    most = np.cumsum(np.maximum(added[order], 0.0)) <= _WHERE * np.sum(np.maximum(added, 0.0))
    where = order[: int(most.sum()) + 1]
    noise = _by_block(plain, noise=True)
    least = (
        SECOND_OF_ALL * (plain.chi2 - best.chi2),
        SECOND_SHARE * float((before - so_far)[where].sum()),
        SECOND_OF_LEFT * float((so_far - noise)[where].sum()),
        SECOND_OF_TRACE * float(best.trace[where].sum()),
    )
    return float(added[where].sum()) > max(least)


def _by_block(fit: ExtendedFit, noise: bool = False) -> Float:
    """(B,) weighted χ² of each block, or what the noise alone would leave."""
    squares = fit.of.weight**2 if noise else fit.misfit**2
    return np.array([float(squares[p.first : p.stop].sum()) for p in fit.of.session.places])


def _backward(plain: ExtendedFit, final: ExtendedFit) -> ExtendedFit:
    """Causes that are no longer needed are dropped; those that stay are in the order of what each explains beside the others."""
    while len(final.of.chosen) > 1:
        fewer = [without(final, i) for i in range(len(final.of.chosen))]
        best = max(fewer, key=lambda f: f.log_evidence)
        if _worthwhile(plain, best, final):
            return _in_order(final, np.argsort([-f.chi2 for f in fewer], kind="stable"))
        final = best
    return final


def _better_single(final: ExtendedFit, single: ExtendedFit) -> bool:
    """Whether what is left of several causes is a better optimum of the same one."""
    return final.of.chosen == single.of.chosen and final.log_evidence > single.log_evidence


def _in_order(final: ExtendedFit, order: NDArray[np.int64]) -> ExtendedFit:
    """The same fit with its causes in another order."""
    if np.array_equal(order, np.arange(order.size)):
        return final
    of = replace(final.of, chosen=tuple(final.of.chosen[i] for i in order))
    return finished(of.fit(of.entries(final.theta, tuple(final.values[i] for i in order)), most=3))


def _alternatives(plain: ExtendedFit, final: ExtendedFit, singles: Sequence[ExtendedFit]) -> tuple[ExtendedFit, ...]:
    """Fits with the strongest cause replaced by another single candidate, as far as they do as well."""
    others = final.of.chosen[1:]
    held = {c.id for c in final.of.chosen}
    fits = []
    for single in singles:
        c = single.of.chosen[0]
        if c.id in held:
            continue
        if others:
            of = replace(final.of, chosen=(c, *others))
            start = of.entries(single.theta, (single.values[0], *final.values[1:]))
            fit = of.fit(start, most=_ROUGHLY, near=single, thorough=False)
            if fit.chi2 > final.chi2 + _ON_THE_WAY * (plain.chi2 - final.chi2):
                continue
            fit = of.fit(fit.x, most=20)
        else:
            fit = single
        if _as_good(plain, final, fit):
            fits.append(fit)
    return _ranked(fits)


def _as_good(plain: ExtendedFit, best: ExtendedFit, other: ExtendedFit) -> bool:
    if best.log_evidence - other.log_evidence < CLOSE:
        return True
    noise = noise_chi2(plain)
    # What both leave beyond the noise: where even the best leaves much, its form is wrong and the ratio decides.
    left, left_other = best.chi2 - noise, other.chi2 - noise
    if left < _MUCH_LEFT * np.sqrt(2 * max(noise, 1.0)):
        return False
    return left_other < CLOSE_MISFIT**2 * left


_MUCH_LEFT = 6.0
_ROUGHLY, _ON_THE_WAY = 6, 0.5
"""Steps after which an alternative must have come this near to what the causes explain, for it to be brought to an end."""


def _verdict(alternatives: Sequence[ExtendedFit], share: float, after: Structure, departed: Sequence[Departure]) -> str:
    left = after.p_value < LEFT_LEVEL
    if (left and share < EXPLAINED) or departed:
        return UNKNOWN
    return AMBIGUOUS if alternatives else NAMED


def _departed(plain: ExtendedFit, final: ExtendedFit) -> tuple[Departure, ...]:
    """Quantities that explain, left free, beside the causes a share that no form of theirs does."""
    fall, found = plain.chi2 - final.chi2, departures(final)
    return tuple(d for d in found if d.p_value < DEPARTED_LEVEL and d.excess > d.tolerated * (fall + d.excess))
