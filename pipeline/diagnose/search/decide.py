"""From fits to a verdict: is there anything, which causes explain it, which cannot be told apart, what stays unexplained.

The rule is that of a careful reader. Nothing is selected on noise: without a discrepancy at the calibrated level the search ends.
With one, causes compete on a tempered scale, on which every block may be wrong by a share of its own misfit, for no extension has
exactly the form of reality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.diagnose.results import AMBIGUOUS, NAMED, NONE, UNKNOWN
from pipeline.diagnose.search.doubt import SURE, find_beside_causes, find_instead_of_causes
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import confirm_best, fit_each_mechanism, rank_by_evidence
from pipeline.diagnose.search.free_quantities import FreeQuantity, fit_free_quantities
from pipeline.diagnose.search.patterns import Patterns, test_patterns
from pipeline.diagnose.search.plain_fit import PlainFit
from pipeline.diagnose.search.screen import Signatures, compute_secants, compute_signatures, find_best_scores
from pipeline.diagnose.search.several_causes import CLOSE, combine_causes
from pipeline.diagnose.search.tempering import measure_excess, measure_explained_share, temper_weights
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from schemas.arrays import Float

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
    before: Patterns
    after: Patterns | None
    departed: tuple[FreeQuantity, ...] = ()
    doubtful: tuple[FreeQuantity, ...] = ()
    instead: tuple[FreeQuantity, ...] = ()

    @property
    def pattern_stays(self) -> bool:
        """Whether the final model leaves a pattern. Where the plain one shows none, a weak one is of what is not known of the noise."""
        level = LEFT_LEVEL if self.before.p_value < STRUCTURE_LEVEL else STRUCTURE_LEVEL
        return self.after is not None and self.after.p_value < level


def decide(session: Session, simulation: Simulation, fitted: PlainFit) -> Outcome:
    """Verdict for a session whose plain model is fitted."""
    about = simulation.about(fitted.model.physical(fitted.theta))
    of = Extended(session, about, fitted.model, (), np.ones(session.size))
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
    film = of.model.physical(untempered.theta)
    of = replace(of, simulation=of.simulation.about(film).measured_against(film))
    untempered = ExtendedFit(of, untempered.solution)
    changes = compute_secants(untempered)
    looked = compute_signatures(changes, untempered)
    found = find_best_scores(looked)
    before = test_patterns(untempered)
    p_value = looked.p_value(found[0].statistic) if found else 1.0
    threshold = looked.threshold(LEVEL) if found else float("inf")
    listed, unlisted = p_value < LEVEL, before.p_value < STRUCTURE_LEVEL
    nothing = Outcome(
        NONE, untempered, untempered, (), None, (), p_value, threshold, float("nan"), looked, before, None
    )
    if not (listed or unlisted):
        return nothing
    weighted = of.with_weight(temper_weights(session, untempered.misfit))
    plain = weighted.refined(weighted.fit(untempered.theta))
    weakened = compute_signatures(changes, plain)
    singles = confirm_best(fit_each_mechanism(plain, find_best_scores(weakened), weakened, CANDIDATES))
    gained = max((plain.chi2 - f.chi2 for f in singles), default=0.0)
    left = test_patterns(plain) if unlisted else None
    patterned = left is not None and left.p_value < LEFT_LEVEL
    if not patterned and gained < _CONFIRMED * threshold:
        # The screen was led on by what the model absorbs of a strong effect, or a pattern is within the form of the model.
        return replace(nothing, p_value=looked.p_value(gained)) if singles else nothing
    searched = combine_causes(untempered, plain, singles, changes)
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
            left or test_patterns(plain),
        )
    singles = rank_by_evidence([final if _better_single(final, f) else f for f in singles])
    alternatives = _alternatives(plain, final, singles)
    share = measure_explained_share(plain, final)
    after = test_patterns(final)
    alone = fit_free_quantities(plain)
    doubtful = find_beside_causes(plain, final, alone)
    beside = tuple(d for d in doubtful if SURE.met_by(d, plain.chi2 - final.chi2))
    instead = find_instead_of_causes(plain, final, alone)
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
    unexplained = beside or (
        outcome.pattern_stays and share < EXPLAINED and measure_excess(plain, final) > _MORE_THAN_NOISE
    )
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
    return rank_by_evidence(fits)


def _as_good(plain: ExtendedFit, best: ExtendedFit, other: ExtendedFit) -> bool:
    if best.log_evidence - other.log_evidence < CLOSE:
        return True
    # What both leave beyond the noise: where even the best leaves much, its form is wrong and the ratio decides.
    left, left_other = measure_excess(plain, best), measure_excess(plain, other)
    return left > _MUCH_LEFT and left_other < CLOSE_MISFIT**2 * left


_MORE_THAN_NOISE, _MUCH_LEFT = 3.0, 6.0
"""Standard deviations of χ² up to which what is left may be noise, whose level is known to a per cent or two itself, and from which
it is much."""
_ROUGHLY, _ON_THE_WAY = 6, 0.5
"""Steps after which an alternative must have come this near to what the causes explain, for it to be brought to an end."""
