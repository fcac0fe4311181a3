"""What to measure next: the recording in which two causes that fit alike would differ most.

Were one cause true and the other fitted to all recordings, the new one included, Dᵀ (N + J C Jᵀ)⁻¹ D is what χ² would say against
the fitted one; D is the difference of the two predictions in standard deviations, N the noise with what the forms may be wrong by, J
the fitted cause's derivatives there, C its covariance from the recordings at hand. Which of them is true is as likely as the
recordings at hand make it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import log_expit, log_ndtr

from pipeline.diagnose.mechanisms import Mechanism
from pipeline.diagnose.proposals.designs import WARMER_K, Proposal, list_proposals, select_showing
from pipeline.diagnose.proposals.imagined import Seen, Wanted, choose_best, imagine_session
from pipeline.diagnose.results import NextRecording
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit

ENOUGH = 2 * RULES.cause.close
"""Difference of Λ from which a cause stands alone."""
_WANTED = Wanted(*(-math.log(undecided) for undecided in RULES.proposal.undecided))
"""Of the probability that a recording leaves two causes undecided: above the first it is not proposed, above the others longer ones
are, if they are surer."""
_LITTLE = 1e-9
"""χ² that says nothing."""
_STEPS = 10
"""Steps of a fit in which a cause is tried in its other forms."""


def propose_separating(final: ExtendedFit, alternatives: Sequence[ExtendedFit]) -> NextRecording | None:
    """Of a catalogue of tests the one that separates the believed cause from its closest rival best; None where none would."""
    if not alternatives:
        return None
    believed, rivals = _list_variants(final), [form for fit in alternatives for form in _list_variants(fit)]
    causes = [f.of.chosen[0].mechanism for f in (final, *alternatives)]
    best = choose_best(
        select_showing(list_proposals(final.of.session, WARMER_K), causes),
        lambda proposal: _judge_proposal(proposal, believed, rivals),
        _WANTED,
    )
    if best is None:
        return None
    names = " and ".join([final.of.chosen[0].id, alternatives[0].of.chosen[0].id])
    chance = min(1 - math.exp(-best.merit()), RULES.proposal.most_certain)
    text = f"{best.proposal.text}: tells {names} apart with a probability of {100 * chance:.0f} %"
    return NextRecording(best.proposal.designs, text, best.separation())


@dataclass(frozen=True)
class Separation:
    """A form believed and a rival in a recording that was not made: what χ² would say against the rival were the form true, and
    against the form were the rival true; what puts the form ahead so far, and what it would gain by having fewer parameters."""

    if_form: float
    if_rival: float
    ahead: float
    simpler: float

    @property
    def log_undecided(self) -> float:
        """Logarithm of the probability that not the true one of the two is ahead by enough once the recording is made.

        What χ² says has four times itself as variance.
        """
        later = self.ahead + self.simpler
        either = ((self.if_form, later), (self.if_rival, -later))
        margins = [(says + ahead - ENOUGH) / (2 * np.sqrt(max(says, _LITTLE))) for says, ahead in either]
        true = log_expit([self.ahead / 2, -self.ahead / 2])
        return float(np.logaddexp(*(true + log_ndtr(np.negative(margins)))))

    def times(self, often: float) -> Separation:
        return replace(self, if_form=often * self.if_form, if_rival=often * self.if_rival)


@dataclass(frozen=True)
class SeparationInTest:
    """A proposal, and how far apart each pair of a form believed and a rival is in it."""

    proposal: Proposal
    apart: tuple[Separation, ...]

    def separation(self) -> float:
        return min(min(pair.if_form, pair.if_rival) for pair in self.apart)

    def merit(self) -> float:
        """Of a pair that it decides, the least sure one: −ln of the probability that it does not."""
        return -max(pair.log_undecided for pair in self.apart)

    def times(self, often: float) -> SeparationInTest:
        """What so many times the data would say at most."""
        return replace(self, apart=tuple(pair.times(often) for pair in self.apart))


def _judge_proposal(
    proposal: Proposal, believed: Sequence[ExtendedFit], rivals: Sequence[ExtendedFit]
) -> SeparationInTest | None:
    """What a proposal would say; None where its recording would have no features."""
    made = imagine_session(believed[0], proposal)
    if made is None:
        return None
    seen = [[Seen.of_fit(*made, fit) for fit in fits] for fits in (believed, rivals)]
    apart = [_compute_separation(one, other) for one in seen[0] for other in seen[1]]
    return SeparationInTest(proposal, tuple(apart))


def _list_variants(fit: ExtendedFit) -> list[ExtendedFit]:
    """A fit, and those with other forms of its first cause that do as well: whichever is true, a recording has to tell it from the
    others."""
    first, *others = fit.of.chosen
    found = [fit]
    for variant in first.mechanism.variants:
        if variant != first.variant:
            of = replace(fit.of, chosen=(replace(first, variant=variant), *others))
            starts = [fit.values[0], *_reverse_signs(first.mechanism, fit.values[0])]
            tried = [of.fit(of.entries(fit.theta, (own, *fit.values[1:])), most=_STEPS) for own in starts]
            other = min(tried, key=lambda f: f.chi2)
            found += [other] if other.chi2 < fit.chi2 + 2 * RULES.cause.close else []
    return found


def _reverse_signs(mechanism: Mechanism, values: Mapping[str, float]) -> list[dict[str, float]]:
    """The parameters with severities of the other sign, where they may have one: what one channel reads too high another may read
    too low."""
    if not all(p.signed for p in mechanism.severities):
        return []
    return [{**values, **{p.name: -values[p.name] / (1 + values[p.name] * p.factor) for p in mechanism.severities}}]


def _compute_lead(form: ExtendedFit, rival: ExtendedFit) -> float:
    """Twice the log evidence of a form over a rival's; nothing where what both leave, not the evidence, makes it a rival."""
    ahead = 2 * (form.log_evidence - rival.log_evidence)
    return ahead if ahead < 2 * RULES.cause.close else 0.0


def _compute_separation(form: Seen, rival: Seen) -> Separation:
    ahead = _compute_lead(form.fit, rival.fit)
    apart = form.values - rival.values
    simpler = form.narrowed(apart) - rival.narrowed(apart)
    return Separation(rival.against(form.values), form.against(rival.values), ahead, simpler)
