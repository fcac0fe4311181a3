"""A recording that misses the film of the others: is it another film, or does a mechanism do that to this one?

What one recording alone shows, a mechanism may always be said to do there. It has to be one that can: the search for causes is asked with
the recording and without it, and another film is what the two searches say, together with the recording by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from pipeline.diagnose.faults.agreement import agrees, miss, sum_by_recording
from pipeline.diagnose.faults.fault import FOREIGN_RECORDING, Correction, Fault
from pipeline.diagnose.faults.fitted import Fitted, fit_session
from pipeline.diagnose.faults.hypotheses import ANOTHER_FILM, weigh_another_film
from pipeline.diagnose.faults.predict import Suspect
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.evidence import Evidence
from pipeline.diagnose.search.extended_model import Extended
from pipeline.diagnose.search.likelihood import Linearised
from pipeline.diagnose.search.plain_fit import PlainFit
from pipeline.diagnose.search.posterior import Hypothesis, weigh_fit
from pipeline.diagnose.simulation.session import Session
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError


@dataclass(frozen=True)
class Doubt:
    """Recordings that a film of their own explains: one, or all from one recording on.

    Parameters
    ----------
    log_prior : of another film, with what its free parameters cost
    """

    recordings: tuple[str, ...]
    log_prior: float


@dataclass(frozen=True)
class Change:
    """A fault that recordings have from one on, with what a mechanism may say of it.

    Parameters
    ----------
    fault : it
    as_one : the session with these recordings among the others
    doubt : that film and rig are the same in all of it
    """

    fault: Fault
    as_one: Fitted
    doubt: Doubt


def doubt_film(suspect: Suspect) -> Doubt | None:
    """The doubt about one recording; None where no film of its own explains it either."""
    if not agrees(suspect.own_film_chi2 / max(suspect.size, 1), suspect.sound_chi2 / max(suspect.size, 1)):
        return None
    recording = suspect.session.recordings[suspect.number]
    return Doubt((recording.recording_id,), weigh_another_film(suspect))


def doubt_change(fault: Fault, as_one: Fitted, fit: PlainFit) -> Change:
    """A change as one that the search for causes has to be asked about.

    Parameters
    ----------
    fit : film and rig that the recordings before it agree on
    """
    session = as_one[0]
    numbers = [n for n, r in enumerate(session.recordings) if r.recording_id in fault.recordings]
    suspect = Suspect.of(session, numbers, fit, int(np.bincount(session.rig[numbers]).argmax()))
    return Change(fault, as_one, Doubt(fault.recordings, weigh_another_film(suspect)))


def list_unexplained(doubts: Sequence[Doubt], session: Session, evidence: Evidence) -> tuple[Doubt, ...]:
    """The doubts about recordings that miss the others under the most probable explanation as well, or that only a function without a name
    brings together with them: it explains what one recording shows as well as another film does."""
    best = None if evidence.posterior is None else evidence.posterior.hypotheses[0]
    if best is not None and best.region is not None and not best.causes:
        return tuple(doubts)
    chi2, size = sum_by_recording(session, _residual(session, evidence, best))
    doubted = np.isin([r.recording_id for r in session.recordings], [id for d in doubts for id in d.recordings])
    if 2 * doubted.sum() > doubted.size:
        return ()
    others = float(chi2[~doubted].sum() / max(size[~doubted].sum(), 1.0))
    missing = {r.recording_id for r, out in zip(session.recordings, miss(chi2, size, others), strict=True) if out}
    return tuple(d for d in doubts if missing.issuperset(d.recordings))


def _residual(session: Session, evidence: Evidence, best: Hypothesis | None) -> Float:
    """(N,) whitened residuals, not weighted."""
    if best is not None and best.region is not None:
        return session.whiten(session.value - best.region.predict())
    fit = evidence.noise_fit if best is None else best.model
    return Linearised.of(fit).residual


def weigh_doubts(doubts: Sequence[Doubt], session: Session, evidence: Evidence, without: Evidence) -> tuple[Fault, ...]:
    """The faults of the doubtful recordings, with how probable it is that they have one; none where that is as good as excluded.

    Parameters
    ----------
    session : with these recordings among the others
    evidence, without : what the search found in it, and in the session without them
    """
    probability = _weigh_other_films(doubts, session, evidence, without)
    if probability is None or probability < 1 - RULES.fault.named:
        return ()
    alike = () if evidence.best is None else evidence.best.causes
    return tuple(_state(own, probability, alike) for d in doubts for own in _list_recordings(d, session))


def weigh_change(change: Change, evidence: Evidence, without: Evidence) -> float:
    """Probability that recordings have the fault of a change, and no mechanism does in them what it does; 1 where they cannot be asked by
    themselves, so that nothing speaks against it.

    Parameters
    ----------
    evidence, without : what the search found with these recordings among the others, and without them
    """
    probability = _weigh_other_films([change.doubt], change.as_one[0], evidence, without)
    return 1.0 if probability is None else probability


def _weigh_other_films(
    doubts: Sequence[Doubt], session: Session, evidence: Evidence, without: Evidence
) -> float | None:
    """Probability that the recordings of each doubt are of another film; None where they cannot be asked by themselves."""
    try:
        alone = sum(_weigh_alone(_list_recordings(d, session)) for d in doubts)
    except NotIdentifiableError:
        return None
    return float(expit(without.log_evidence + alone + sum(d.log_prior for d in doubts) - evidence.log_evidence))


def _list_recordings(doubt: Doubt, session: Session) -> Sequence[RecordingFeatures]:
    """Those that it is about."""
    return [r for r in session.recordings if r.recording_id in doubt.recordings]


def _weigh_alone(own: Sequence[RecordingFeatures]) -> float:
    """Log evidence of recordings with a film of their own."""
    session, simulation, plain = fit_session(own)
    of = Extended(session, simulation, plain.model, (), np.ones(session.size))
    fit = of.fit(plain.theta)
    return max(weigh_fit(fit, noise_alone=alone).log_joint for alone in (True, False))


def _state(own: RecordingFeatures, probability: float, alike: tuple[str, ...]) -> Fault:
    correction = Correction(own.recording_id, FOREIGN_RECORDING, "specimen_id", own.specimen_id, "", probability)
    return Fault(
        FOREIGN_RECORDING,
        (own.recording_id,),
        probability,
        ANOTHER_FILM,
        (correction,),
        sets_aside=probability > 0.5,
        alike=alike,
    )
