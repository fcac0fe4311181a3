"""What to measure next: the recording in which two causes that fit alike would differ most.

Were one cause true and the other fitted to all recordings, the new one included, Dᵀ (N + J C Jᵀ)⁻¹ D is what χ² would say against
the fitted one; D is the difference of the two predictions in standard deviations, N the noise with what the forms may be wrong by, J
the fitted cause's derivatives there, C its covariance from the recordings at hand. Which of them is true is as likely as the
recordings at hand make it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_expit, log_ndtr

from pipeline.diagnose.designs import LITTLE_WARMER_K, OFTEN, WARMER_K, Proposal, catalogue, imagined, repeated, showing
from pipeline.diagnose.extend import ExtendedFit
from pipeline.diagnose.further import CLOSE
from pipeline.diagnose.noise_density import NoiseLaw
from pipeline.diagnose.predict import Simulation
from pipeline.diagnose.results import NextRecording
from pipeline.diagnose.session import Session, make_session
from pipeline.diagnose.solve import central
from schemas.errors import NotIdentifiableError

Float = NDArray[np.float64]

_MODEL_ERROR = 0.15
"""Share of a predicted difference that counts as noise: neither cause has exactly its form."""
_ENOUGH = 2 * CLOSE
"""Difference of χ² from which a cause stands alone."""
_OF_WHAT_IS_SEEN = 0.15
"""Share of what the causes explain so far that a recording must show of them, for a doubt that came by chance to pass."""
_UNDECIDED, _SURELY = 0.1, 0.03
"""Probability that a recording leaves two causes undecided, above which it is not proposed; and above which a longer one is, if that
is surer."""
_LITTLE = 1e-9
"""χ² that says nothing."""
_STEPS = 10
"""Steps of a fit in which a cause is tried in its other forms."""


def next_recording(final: ExtendedFit, alternatives: Sequence[ExtendedFit]) -> NextRecording | None:
    """Of a catalogue of tests the one that separates the believed cause from its closest rival best; None where none would."""
    if not alternatives:
        return None
    best = _best(final, alternatives, WARMER_K, _Judged.sureness, -np.log(_UNDECIDED), -np.log(_SURELY))
    if best is None:
        return None
    rivals = " and ".join([final.of.chosen[0].id, alternatives[0].of.chosen[0].id])
    return NextRecording(best.proposal.designs, f"{best.proposal.text}: tells {rivals} apart", best.separation())


def proving_recording(plain: ExtendedFit, final: ExtendedFit) -> NextRecording | None:
    """The test in which the causes believed would show most, where they may be none of the list: what is in no list goes another way
    there, and a doubt that came by chance does not come again. None where they would show next to nothing."""
    least = max(_ENOUGH, _OF_WHAT_IS_SEEN * (plain.chi2 - final.chi2))
    best = _best(final, [plain], LITTLE_WARMER_K, _Judged.separation, least, least)
    if best is None:
        return None
    names = " and ".join(c.id for c in final.of.chosen)
    goes = "goes" if len(final.of.chosen) == 1 else "go"
    return NextRecording(
        best.proposal.designs, f"{best.proposal.text}: shows whether {names} {goes} on", best.separation()
    )


@dataclass(frozen=True)
class _Apart:
    """A form believed and a rival in a recording that was not made: what χ² would say against the rival were the form true, and
    against the form were the rival true; and what puts the form ahead so far."""

    if_form: float
    if_rival: float
    ahead: float

    @property
    def log_undecided(self) -> float:
        """Logarithm of the probability that not the true one of the two is ahead by enough once the recording is made.

        What χ² says has four times itself as variance.
        """
        either = ((self.if_form, self.ahead), (self.if_rival, -self.ahead))
        margins = [(says + ahead - _ENOUGH) / (2 * np.sqrt(max(says, _LITTLE))) for says, ahead in either]
        true = log_expit([self.ahead / 2, -self.ahead / 2])
        return float(np.logaddexp(*(true + log_ndtr(np.negative(margins)))))

    def times(self, often: float) -> _Apart:
        return replace(self, if_form=often * self.if_form, if_rival=often * self.if_rival)


@dataclass(frozen=True)
class _Judged:
    """A proposal, and how far apart each pair of a form believed and a rival is in it."""

    proposal: Proposal
    apart: tuple[_Apart, ...]

    def separation(self) -> float:
        return min(min(pair.if_form, pair.if_rival) for pair in self.apart)

    def sureness(self) -> float:
        """Of a pair that it decides, the least sure one: −ln of the probability that it does not."""
        return -max(pair.log_undecided for pair in self.apart)

    def times(self, often: float) -> _Judged:
        """What so many times the data would say at most."""
        return replace(self, apart=tuple(pair.times(often) for pair in self.apart))


def _best(
    final: ExtendedFit,
    rivals: Sequence[ExtendedFit],
    warmer_k: float,
    merit: Callable[[_Judged], float],
    least: float,
    enough: float,
) -> _Judged | None:
    """Of the catalogue what has the most merit; where that is not `enough`, it or the best of what can be repeated often, whichever has
    more; None where that is less than the `least`."""
    believed = _forms(final)
    causes = [c.mechanism for f in (final, *rivals) for c in f.of.chosen[:1]]

    def best(proposals: Iterable[Proposal]) -> list[_Judged]:
        """Best first."""
        judged = [_judged(p, believed, rivals) for p in proposals]
        return sorted((j for j in judged if j is not None), key=merit, reverse=True)

    found = best(showing(catalogue(final.of.session, warmer_k), causes))
    if not any(merit(j) >= enough for j in found[:1]):
        hopeful = [repeated(j.proposal) for j in found if merit(j.times(OFTEN.get(j.proposal.test, 1))) >= enough]
        found = sorted([*best([p for p in hopeful if p is not None][:1]), *found[:1]], key=merit, reverse=True)
    return found[0] if found and merit(found[0]) >= least else None


def _judged(proposal: Proposal, believed: Sequence[ExtendedFit], rivals: Sequence[ExtendedFit]) -> _Judged | None:
    """What a proposal would say; None where its recording would have no features."""
    final = believed[0]
    session = final.of.session
    try:
        new = imagined(session, final.of.model.physical(final.theta), proposal)
        later = make_session([*session.recordings, *new], _laws(session, len(new)))
    except NotIdentifiableError:
        return None
    number = len(session.recordings)
    # What severities are relative to stays that of the session at hand, however large the new recording is.
    part = replace(later.part([p.recording >= number for p in later.places]), scale=session.scale)
    simulation = Simulation(part, final.of.simulation)
    seen = [[_Seen.of(part, simulation, fit) for fit in fits] for fits in (believed, rivals)]
    apart = [_apart(one, other) for one in seen[0] for other in seen[1]]
    return _Judged(proposal, tuple(apart))


def _forms(fit: ExtendedFit) -> list[ExtendedFit]:
    """A fit, and those with other forms of its first cause that do as well: whichever is true, a recording has to tell."""
    first, *others = fit.of.chosen
    found = [fit]
    for variant in first.mechanism.variants:
        if variant != first.variant:
            of = replace(fit.of, chosen=(replace(first, variant=variant), *others))
            other = of.fit(fit.x, most=_STEPS)
            found += [other] if other.chi2 < fit.chi2 + 2 * CLOSE else []
    return found


def _ahead(form: ExtendedFit, rival: ExtendedFit) -> float:
    """Twice the log evidence of a form over a rival's; nothing where what both leave, not the evidence, makes it a rival."""
    ahead = 2 * (form.log_evidence - rival.log_evidence)
    return ahead if ahead < 2 * CLOSE else 0.0


def _laws(session: Session, number: int) -> dict[tuple[int, str], NoiseLaw]:
    """Noise of a session's channels, with that of so many further recordings: as loud as that of the others."""
    return {
        key: replace(law, white=np.append(law.white, np.full(number, np.median(law.white))))
        for key, law in session.laws.items()
    }


@dataclass(frozen=True)
class _Seen:
    """What a fit says of recordings that were not made, and how surely; whitened.

    values : (N,) features; moves : (N, N) covariance that its own uncertainty gives them
    """

    fit: ExtendedFit
    values: Float
    moves: Float

    @classmethod
    def of(cls, part: Session, simulation: Simulation, fit: ExtendedFit) -> _Seen:
        of = fit.of.on(part, simulation, np.ones(part.size))
        rows = central(of.data_residual, fit.x, *of.limits)
        return cls(fit, part.whiten(of.predict(fit.x)), rows @ fit.covariance @ rows.T)


def _apart(form: _Seen, rival: _Seen) -> _Apart:
    difference = form.values - rival.values
    if not np.isfinite(difference).all():
        return _Apart(0.0, 0.0, _ahead(form.fit, rival.fit))
    # What forms may be wrong by is weighed down for the fit as well: it takes less of the difference up.
    noise = np.diag(1 + (_MODEL_ERROR * difference) ** 2)

    def against(fitted: _Seen) -> float:
        return float(difference @ np.linalg.solve(noise + fitted.moves, difference))

    return _Apart(against(rival), against(form), _ahead(form.fit, rival.fit))
