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
from pipeline.diagnose.further import CLOSE, several
from pipeline.diagnose.plain import PlainFit
from pipeline.diagnose.predict import Simulation
from pipeline.diagnose.refit import confirmed, ranked, tried
from pipeline.diagnose.results import AMBIGUOUS, NAMED, NONE, UNKNOWN
from pipeline.diagnose.screen import Signatures, scores, secants, signatures
from pipeline.diagnose.session import Session
from pipeline.diagnose.structure import Structure, structure
from pipeline.diagnose.tempering import explained, noise_chi2, tempered

Float = NDArray[np.float64]


@dataclass(frozen=True)
class Demand:
    """What a quantity left free beside the causes must be, for them to be none or in doubt.

    level : probability below which it differs
    share : of what it and the causes explain together, over the share that forms of right causes leave
    of_weak : the part of it for causes that explain next to nothing; what is small follows no other course than the first order of
        its form
    """

    level: float
    share: float
    of_weak: float


@dataclass(frozen=True)
class Doubt(Demand):
    """The same for a doubt. `in_place` : share of what the causes explain that it must explain in their place: it stands for them then."""

    in_place: float


SURE, DOUBT = Demand(1e-4, 1.0, 0.5), Doubt(0.03, 0.6, 0.25, 0.5)
DOUBT_OF_SOME, DOUBT_OF_MANY = replace(DOUBT, level=5e-3), Doubt(2e-3, 0.6, 0.5, 1.0)
"""For `unknown`, and for a doubt by quantities of very few numbers, of a number for each recording, say, and of many: the more numbers,
the less does what they follow stand for one thing."""
LEVEL = 0.002
"""False-alarm level of the search over the listed mechanisms."""
STRUCTURE_LEVEL = 1e-5
"""The same for patterns that no mechanism proposes; their noise is known less well than that of signatures."""
CANDIDATES = 8
CLOSE_MISFIT = 1.3
"""Ratio of what two causes leave, root mean square over the noise, within which the form decides, not the data."""
EXPLAINED = 0.6
"""Share of the misfit that the causes must explain together for their names to be said, where more than noise is left."""
LEFT_LEVEL = 1e-3
_FEW = 12
"""Numbers up to which a quantity left free stands for one thing; with more it follows a little of everything."""
_BETTER, _FEWEST = 2.0, 3
"""χ² by which a quantity left free, alone, must explain more than one cause for a doubt, for a listed one is likelier from the start;
and its numbers at most: more imitate, with a number for each recording, whatever comes with time. Two causes that happen to be
there at once are less likely, by as much as parts causes, and what explains all of both has any number of numbers."""
_ALL_OF_FORM = 1000.0
"""χ² that causes explain from which all that forms differ by is tolerated."""
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
    doubtful : what seems to; instead : what explains more than the causes, alone
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
    doubtful: tuple[Departure, ...] = ()
    instead: tuple[Departure, ...] = ()

    @property
    def pattern_stays(self) -> bool:
        """Whether the final model leaves a pattern. Where the plain one shows none, a weak one is of what is not known of the noise."""
        level = LEFT_LEVEL if self.before.p_value < STRUCTURE_LEVEL else STRUCTURE_LEVEL
        return self.after is not None and self.after.p_value < level


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

    What it was tempered by is asked from where the tempered fit has gone; the causes, where they gain little more than that could be.
    """
    plain, untempered = outcome.plain, outcome.untempered
    if plain is not untempered:
        further = untempered.of.fit(plain.theta)
        if further.chi2 < _FAR_BETTER * untempered.chi2:
            return further.theta
    if not outcome.singles or plain.chi2 - outcome.singles[0].chi2 > _MANY * outcome.threshold:
        return None
    again = [plain.of.fit(f.theta) for f in outcome.singles[:2]]
    best = min(again, key=lambda f: f.chi2)
    return best.theta if best.chi2 < plain.chi2 - _CLEARLY_BETTER else None


_RESTARTS, _MANY, _CLEARLY_BETTER = 3, 10.0, 1.0
_FAR_BETTER = 0.9
"""Share of χ² below which a fit was not where it belongs; what a few steps more bring changes no weight."""


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
    singles = confirmed(tried(plain, scores(weakened), weakened, CANDIDATES))
    gained = max((plain.chi2 - f.chi2 for f in singles), default=0.0)
    left = structure(plain) if unlisted else None
    patterned = left is not None and left.p_value < LEFT_LEVEL
    if not patterned and gained < _CONFIRMED * threshold:
        # The screen was led on by what the model absorbs of a strong effect, or a pattern is within the form of the model.
        return replace(nothing, p_value=looked.p_value(gained)) if singles else nothing
    searched = several(untempered, plain, singles, changes)
    plain, singles, final = searched.plain, searched.singles, searched.final
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
    singles = ranked([final if _better_single(final, f) else f for f in singles])
    alternatives = _alternatives(plain, final, singles)
    share = explained(plain, final)
    after = structure(final)
    alone = departures(plain)
    doubtful = _in_their_place(
        plain, final, alone, [d for d in departures(final) if _departs(plain, final, d, _doubt(d))]
    )
    beside = tuple(d for d in doubtful if _departs(plain, final, d, SURE))
    instead = _instead(plain, final, alone)
    outcome = Outcome(
        AMBIGUOUS if alternatives or doubtful or instead else NAMED,
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
        doubtful,
        instead,
    )
    unexplained = beside or (outcome.pattern_stays and share < EXPLAINED and _left(plain, final) > _MORE_THAN_NOISE)
    return replace(outcome, verdict=UNKNOWN) if unexplained else outcome


def _better_single(final: ExtendedFit, single: ExtendedFit) -> bool:
    """Whether what is left of several causes is a better optimum of the same one."""
    return final.of.chosen == single.of.chosen and final.log_evidence > single.log_evidence


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
            fit = of.fit(start, most=_ROUGHLY, near=final, thorough=False)
            if fit.chi2 > final.chi2 + _ON_THE_WAY * (plain.chi2 - final.chi2):
                continue
            fit = of.fit(fit.x, most=20)
        else:
            fit = single
        if _as_good(plain, final, fit):
            fits.append(fit)
    return ranked(fits)


def _as_good(plain: ExtendedFit, best: ExtendedFit, other: ExtendedFit) -> bool:
    if best.log_evidence - other.log_evidence < CLOSE:
        return True
    # What both leave beyond the noise: where even the best leaves much, its form is wrong and the ratio decides.
    left, left_other = _left(plain, best), _left(plain, other)
    return left > _MUCH_LEFT and left_other < CLOSE_MISFIT**2 * left


def _left(plain: ExtendedFit, fit: ExtendedFit) -> float:
    """χ² that a fit leaves beyond the noise, in standard deviations of the noise's."""
    noise = noise_chi2(plain)
    return float((fit.chi2 - noise) / np.sqrt(2 * max(noise, 1.0)))


_MORE_THAN_NOISE, _MUCH_LEFT = 3.0, 6.0
"""Standard deviations of χ² up to which what is left may be noise, whose level is known to a per cent or two itself, and from which
it is much."""
_ROUGHLY, _ON_THE_WAY = 6, 0.5
"""Steps after which an alternative must have come this near to what the causes explain, for it to be brought to an end."""


def _doubt(found: Departure) -> Doubt:
    if found.degrees_of_freedom <= _FEWEST:
        return DOUBT
    return DOUBT_OF_SOME if found.degrees_of_freedom <= _FEW else DOUBT_OF_MANY


def _in_their_place(
    plain: ExtendedFit, final: ExtendedFit, alone: Sequence[Departure], found: Sequence[Departure]
) -> tuple[Departure, ...]:
    """Of quantities left free those that explain much of the same without the causes."""
    fall = plain.chi2 - final.chi2
    stands = {d.text for d in alone if d.excess > _doubt(d).in_place * fall}
    return tuple(d for d in found if d.text in stands)


def _instead(plain: ExtendedFit, final: ExtendedFit, alone: Sequence[Departure]) -> tuple[Departure, ...]:
    """Quantities left free that explain, alone, more than the causes do."""
    others = len(final.of.chosen) - 1
    least = plain.chi2 - final.chi2 + _BETTER - others * 2 * CLOSE
    return tuple(d for d in alone if d.evidence > least and (others or d.degrees_of_freedom <= _FEWEST))


def _departs(plain: ExtendedFit, final: ExtendedFit, found: Departure, demand: Demand) -> bool:
    """Whether a quantity explains, left free, beside the causes a share that no form of theirs does."""
    fall = plain.chi2 - final.chi2
    share = demand.share * (demand.of_weak + (1 - demand.of_weak) * min(1.0, fall / _ALL_OF_FORM))
    return found.p_value < demand.level and found.excess > share * found.tolerated * (fall + found.excess)
