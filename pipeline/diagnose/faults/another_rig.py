"""Recordings up to one, or from one on, that were made on another rig than their metadata name."""

from __future__ import annotations

import numpy as np

from pipeline.diagnose.faults.agreement import Agreement, agrees, leave_out
from pipeline.diagnose.faults.correct import list_corrections
from pipeline.diagnose.faults.fault import FOREIGN_RIG, Fault
from pipeline.diagnose.faults.hypotheses import ANOTHER_RIG, OF_RIG, Hypothesis
from pipeline.diagnose.faults.peers import has_peer
from pipeline.diagnose.faults.predict import Suspect
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from schemas.arrays import Bool
from schemas.protocols import CALIBRATION, MECHANICAL

_FEWEST = 2
"""Mechanical recordings on either rig at least: what one recording shows is a fault of its own."""


def find_another_rig(session: Session, simulation: Simulation, agreement: Agreement) -> Fault | None:
    """The recordings of one stretch of time, up to the begin or the end of the session, that a rig of their own explains with the film of the
    others; None where there is no such stretch.

    A mechanism that shows from one recording on, because the film is strained farther from there on, does not show in a recording like those
    before: one of them has to be like one of the others.

    Parameters
    ----------
    agreement : film and rig that the others agree on, with the recordings that miss them
    """
    members = _find_stretch(session, agreement.outside)
    if members is None:
        return None
    numbers = [int(n) for n in np.flatnonzero(members)]
    others = [r for r, own in zip(session.recordings, members, strict=True) if not own]
    repeated = any(r.loading == MECHANICAL and has_peer(r, others) for r in (session.recordings[n] for n in numbers))
    if not repeated or len({int(session.rig[n]) for n in numbers}) > 1:
        return None
    base = leave_out(session, simulation, agreement.fit, members)
    suspect = Suspect.of(session, numbers, base, int(session.rig[numbers[0]]))
    left = suspect.own_rig_chi2
    if not agrees(left / suspect.size, suspect.sound_chi2 / suspect.size):
        return None
    fall = suspect.temper(suspect.sound_chi2) - suspect.temper(left)
    odds = 0.5 * fall - 0.5 * OF_RIG * float(np.log(max(fall, 2.0))) + float(np.log(RULES.fault.prior))
    # What softens the film with time, strain or voltage makes another film of it, and is far more often there.
    as_film = min(suspect.own_film_chi2, suspect.scaled_film_chi2)
    over_film = 0.5 * (suspect.temper(as_film) - suspect.temper(left)) + float(
        np.log(RULES.fault.prior / RULES.fault.mechanism)
    )
    if min(odds, over_film) < np.log(RULES.fault.named / (1 - RULES.fault.named)):
        return None
    names = tuple(session.recordings[n].recording_id for n in numbers)
    hypothesis = Hypothesis(FOREIGN_RIG, ANOTHER_RIG, None, 0.0, OF_RIG)
    return Fault(
        FOREIGN_RIG,
        names,
        RULES.fault.named,
        ANOTHER_RIG,
        tuple(c for n in numbers for c in list_corrections(session.recordings[n], hypothesis, RULES.fault.named)),
        left_per_value=left / suspect.size,
    )


def _find_stretch(session: Session, outside: Bool) -> Bool | None:
    """(R,) recordings from the first mechanical one outside to the end, or from the begin to the last one, where all mechanical ones between are
    outside and the others are not; None otherwise."""
    moved = np.array([r.loading == MECHANICAL for r in session.recordings])
    tests = np.array([r.loading != CALIBRATION for r in session.recordings])
    own = outside[moved]
    turns = np.flatnonzero(np.diff(own.astype(int)))
    if turns.size != 1 or min(own.sum(), (~own).sum()) < _FEWEST:
        return None
    place = np.arange(outside.size)
    where = np.flatnonzero(moved & outside)
    return np.asarray(tests & ((place >= where[0]) if own[-1] else (place <= where[-1])))
