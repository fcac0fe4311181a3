"""What to measure next: the recording in which two causes that fit alike would differ most.

Were one cause true and the other fitted to all recordings, the new one included, Dᵀ (N + J C Jᵀ)⁻¹ D is what χ² would
say against the fitted one; D is the difference of the two predictions in standard deviations, N the noise with what the
forms may be wrong by, J the fitted cause's derivatives there, C its covariance from the recordings at hand. Which of
them is true is as likely as the recordings at hand make it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_expit, log_ndtr

from pipeline.diagnose.mechanisms import Mechanism
from pipeline.diagnose.proposals.designs import WARMER_K, Proposal, Test, list_proposals, select_showing
from pipeline.diagnose.proposals.imagined import Seen, Wanted, choose_best, imagine_sessions
from pipeline.diagnose.results import NextRecording
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.posterior import RegionFit

ENOUGH = 2 * RULES.cause.close
"""Difference of Λ from which a cause stands alone."""
_WANTED = Wanted(*(-math.log(undecided) for undecided in RULES.proposal.undecided))
"""Of the probability that a recording leaves two causes undecided: above the first it is not proposed, above the others
longer ones are, if they are surer."""
_LITTLE = 1e-9
"""χ² that says nothing."""
_STEPS = 10
"""Steps of a fit in which a cause is tried in its other forms."""


@dataclass(frozen=True)
class Rival:
    """What may be in place of the causes.

    Parameters
    ----------
    fit : with other listed causes; or the plain model or one with causes, beside which `region` acts
    region : something without a name; None for listed causes
    behind : twice the log odds by which the causes are ahead of it
    """

    fit: ExtendedFit
    region: RegionFit | None
    behind: float

    def find_names(self) -> tuple[str, ...]:
        """Ids of its listed causes; of a region stage and what it depends on."""
        return (*(c.id for c in self.fit.of.chosen), *(() if self.region is None else (self.region.region.id,)))


def propose_separating(final: ExtendedFit, rivals: Sequence[Rival]) -> NextRecording | None:
    """Of a catalogue of tests the one that separates the causes from what may be in their place best.

    Where no test separates the causes from all rivals, it is chosen for those rivals that some test can separate from them; where no
    single one does that either, for the most probable of these. The text says from which rivals it does not tell the causes.

    Parameters
    ----------
    final : the model with the causes
    rivals : what may be in their place, the most probable first

    Returns
    -------
    None where no test would separate the causes from any of them
    """
    if not rivals:
        return None
    causes = [c.mechanism for fit in (final, *(r.fit for r in rivals)) for c in fit.of.chosen[:1]]
    proposals = select_showing(list_proposals(final.of.session, WARMER_K), causes)
    judge = _make_judge(final, rivals)

    def choose(among: Collection[int]) -> SeparationInTest | None:
        return choose_best(proposals, lambda proposal: judge(proposal, among), _WANTED)

    told: Sequence[int] = range(len(rivals))
    best = choose(told)
    if best is None:
        told = [number for number in told if choose([number]) is not None]
        best = choose(told) if told else None
    if best is None and told:
        told = told[:1]
        best = choose(told)
    if best is None:
        return None
    chance = min(1 - math.exp(-best.compute_merit()), RULES.proposal.most_certain)
    one, other = _find_difference(final, rivals[told[0]])
    text = f"{best.proposal.text}: tells {one} and {other} apart with a probability of {100 * chance:.0f} %"
    left = [r for number, r in enumerate(rivals) if number not in told]
    text += f", not from {' or '.join(_find_difference(final, r)[1] for r in left)}" if left else ""
    leaves = tuple(dict.fromkeys(id for r in left for id in r.find_names()))
    return NextRecording(best.proposal.designs, text, best.find_separation(), leaves)


def _find_difference(final: ExtendedFit, rival: Rival) -> tuple[str, str]:
    """Names of what only the causes have, and of what only the rival has."""
    one, other = set(final.of.mechanism_ids), set(rival.find_names())
    first, second = (" with ".join(sorted(own)) for own in (one - other or one, other - one or other))
    return first, second


@dataclass(frozen=True)
class Separation:
    """A believed fit and an alternative in a recording that was not made.

    Parameters
    ----------
    if_believed : χ² that it would say against the alternative, were the believed one true
    if_alternative : χ² that it would say against the believed one, were the alternative true
    ahead : twice the log evidence that puts the believed one ahead so far
    simpler : what the believed one would gain by having fewer parameters
    """

    if_believed: float
    if_alternative: float
    ahead: float
    simpler: float

    @property
    def log_undecided(self) -> float:
        """Logarithm of the probability that the true one of the two is not ahead by enough once the recording is made.

        What χ² says has four times itself as variance.
        """
        later = self.ahead + self.simpler
        either = ((self.if_believed, later), (self.if_alternative, -later))
        margins = [(says + ahead - ENOUGH) / (2 * np.sqrt(max(says, _LITTLE))) for says, ahead in either]
        true = log_expit([self.ahead / 2, -self.ahead / 2])
        return float(np.logaddexp(*(true + log_ndtr(np.negative(margins)))))

    def multiply(self, often: float) -> Separation:
        """The same for so many times the data."""
        return replace(self, if_believed=often * self.if_believed, if_alternative=often * self.if_alternative)


@dataclass(frozen=True)
class SeparationInTest:
    """A proposal, and how far it separates each pair of a believed fit and an alternative."""

    proposal: Proposal
    apart: tuple[Separation, ...]

    def find_separation(self) -> float:
        """χ² by which the closest pair is separated."""
        return min(min(pair.if_believed, pair.if_alternative) for pair in self.apart)

    def compute_merit(self) -> float:
        """−ln of the probability that the least sure pair is not decided."""
        return -max(pair.log_undecided for pair in self.apart)

    def multiply(self, often: float) -> SeparationInTest:
        """What so many times the data would say at most."""
        return replace(self, apart=tuple(pair.multiply(often) for pair in self.apart))


def _make_judge(
    final: ExtendedFit, rivals: Sequence[Rival]
) -> Callable[[Proposal, Collection[int]], SeparationInTest | None]:
    """What tells how far a proposal separates the causes from some of the rivals, given by their numbers; it tells None where
    the proposed recordings would have no features.

    Each proposal is simulated once, whichever rivals are asked.
    """
    believed = _list_variants(final)
    others = [
        (number, replace(r, fit=v))
        for number, r in enumerate(rivals)
        for v in (_list_variants(r.fit) if r.fit.of.chosen else [r.fit])
    ]
    imagine_session = imagine_sessions(final)
    known: dict[tuple[Test, ...], list[tuple[int, Separation]] | None] = {}

    def separate(proposal: Proposal) -> list[tuple[int, Separation]] | None:
        made = imagine_session(proposal)
        if made is None:
            return None
        seen = [Seen.of_fit(*made, fit) for fit in believed]
        alternatives = [(number, rival, Seen.of_fit(*made, rival.fit)) for number, rival in others]
        return [
            (number, _compute_separation(one, rival, other)) for one in seen for number, rival, other in alternatives
        ]

    def judge(proposal: Proposal, among: Collection[int]) -> SeparationInTest | None:
        tests = tuple(frozenset(design.items()) for design in proposal.designs)
        if tests not in known:
            known[tests] = separate(proposal)
        pairs = known[tests]
        return None if pairs is None else SeparationInTest(proposal, tuple(s for n, s in pairs if n in among))

    return judge


def _list_variants(fit: ExtendedFit) -> list[ExtendedFit]:
    """A fit, and those with other variants of its first mechanism that do as well: whichever is true has to be told
    from the others."""
    first, *others = fit.of.chosen
    found = [fit]
    for variant in first.mechanism.variants:
        if variant != first.variant:
            of = replace(fit.of, chosen=(replace(first, variant=variant), *others))
            starts = [fit.values[0], *_reverse_signs(first.mechanism, fit.values[0])]
            tried = [of.fit(of.make_entries(fit.theta, (own, *fit.values[1:])), most=_STEPS) for own in starts]
            other = min(tried, key=lambda f: f.chi2)
            found += [other] if other.chi2 < fit.chi2 + 2 * RULES.cause.close else []
    return found


def _reverse_signs(mechanism: Mechanism, values: Mapping[str, float]) -> list[dict[str, float]]:
    """Parameters with severities of the other sign where there is one: what one channel reads too high another may read
    too low."""
    if not all(p.signed for p in mechanism.severities):
        return []
    return [{**values, **{p.name: -values[p.name] / (1 + values[p.name] * p.factor) for p in mechanism.severities}}]


def _compute_separation(believed: Seen, rival: Rival, other: Seen) -> Separation:
    """What a recording would say for and against the causes and one rival."""
    values = other.values
    if rival.region is not None:
        change = rival.region.compute_change_in(other.of, rival.fit.x)
        values = values + other.of.session.whiten(change)
        return Separation(
            other.measure_against(believed.values - (values - other.values)),
            believed.measure_against(values),
            rival.behind,
            0.0,
        )
    apart = believed.values - values
    simpler = believed.measure_narrowing(apart) - other.measure_narrowing(apart)
    return Separation(other.measure_against(believed.values), believed.measure_against(values), rival.behind, simpler)
