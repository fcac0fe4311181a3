"""What to measure next: the recording in which two causes that fit alike would differ most.

Were one cause true and the other fitted to all recordings, the new one included, Dᵀ (I + J C Jᵀ)⁻¹ D is what χ² would say against
the fitted one; D is the difference of the two predictions in standard deviations, J the fitted cause's derivatives there, C its
covariance from the recordings at hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.designs import LITTLE_WARMER_K, WARMER_K, Proposal, catalogue, imagined, showing
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
_NORMAL_80 = 1.282


def next_recording(final: ExtendedFit, alternatives: Sequence[ExtendedFit]) -> NextRecording | None:
    """Of a catalogue of tests the one that separates the believed cause from its closest rival best; None where none would."""
    best = _best(final, alternatives, WARMER_K) if alternatives else None
    if best is None or best.surely < _ENOUGH:
        return None
    rivals = " and ".join([final.of.chosen[0].id, alternatives[0].of.chosen[0].id])
    return NextRecording(best.proposal.designs, f"{best.proposal.text}: tells {rivals} apart", best.separation)


def proving_recording(plain: ExtendedFit, final: ExtendedFit) -> NextRecording | None:
    """The test in which the causes believed would show most, where they may be none of the list: what is in no list goes another way
    there, and a doubt that came by chance does not come again. None where they would show next to nothing."""
    best = _best(final, [plain], LITTLE_WARMER_K)
    if best is None or best.separation < max(_ENOUGH, _OF_WHAT_IS_SEEN * (plain.chi2 - final.chi2)):
        return None
    names = " and ".join(c.id for c in final.of.chosen)
    return NextRecording(best.proposal.designs, f"{best.proposal.text}: shows whether {names} goes on", best.separation)


@dataclass(frozen=True)
class _Best:
    """A proposal, its least `separation` from any rival, and the least difference of χ² that then is nearly sure."""

    proposal: Proposal
    separation: float
    surely: float


def _best(final: ExtendedFit, rivals: Sequence[ExtendedFit], warmer_k: float) -> _Best | None:
    session = final.of.session
    physical = final.of.model.physical(final.theta)
    best: _Best | None = None
    causes = [c.mechanism for f in (final, *rivals) for c in f.of.chosen[:1]]
    for proposal in showing(catalogue(session, warmer_k), causes):
        try:
            new = imagined(session, physical, proposal)
            later = make_session([*session.recordings, *new], _laws(session, len(new)))
        except NotIdentifiableError:
            continue
        number = len(session.recordings)
        # What severities are relative to stays that of the session at hand, however large the new recording is.
        part = replace(later.part([p.recording >= number for p in later.places]), scale=session.scale)
        separations = [_separation(part, final, rival) for rival in rivals]
        surely = min(_nearly_surely(s) + r.chi2 - final.chi2 for s, r in zip(separations, rivals, strict=True))
        if best is None or surely > best.surely:
            best = _Best(proposal, min(separations), surely)
    return best


def _laws(session: Session, number: int) -> dict[tuple[int, str], NoiseLaw]:
    """Noise of a session's channels, with that of so many further recordings: as loud as that of the others."""
    return {
        key: replace(law, white=np.append(law.white, np.full(number, np.median(law.white))))
        for key, law in session.laws.items()
    }


def _nearly_surely(separation: float) -> float:
    """Difference of χ² that noise leaves with a probability of 90 % where this one is expected: its variance is four times it."""
    return separation - _NORMAL_80 * 2 * float(np.sqrt(separation))


def _separation(part: Session, one: ExtendedFit, other: ExtendedFit) -> float:
    simulation = Simulation(part, one.of.simulation)
    weight = np.ones(part.size)
    first, second = (replace(f.of, session=part, simulation=simulation, weight=weight) for f in (one, other))
    difference = part.whiten(first.predict(one.x) - second.predict(other.x))
    if not np.isfinite(difference).all():
        return 0.0
    difference = difference / np.sqrt(1 + _MODEL_ERROR**2 * difference**2)
    found = []
    for of, fit in ((first, one), (second, other)):
        rows = central(of.data_residual, fit.x, *of.limits)
        inside = np.eye(part.size) + rows @ fit.covariance @ rows.T
        found.append(float(difference @ np.linalg.solve(inside, difference)))
    return min(found)
