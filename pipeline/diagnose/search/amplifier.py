"""What the amplifier makes of its command, which is read before anything else.

Command and measured voltage show the lag of an amplifier as plainly as an oscilloscope does, and film and rig have no part in it: what is
simulated is driven by the voltage that was measured. Where it is beyond doubt, all else is asked beside it. Not here: a lag that the monitor
does not show, which is one cause among others.
"""

from __future__ import annotations

import numpy as np

from pipeline.diagnose.features.kinds import AMPLIFIER
from pipeline.diagnose.mechanisms.drive import DRIVE_LAG, MONITORED
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import confirm_best, fit_each_mechanism
from pipeline.diagnose.search.screen import Signatures, find_best_scores


def find_amplifier_lag(plain: ExtendedFit, signatures: Signatures) -> ExtendedFit | None:
    """The plain model with the lag of the amplifier, where command and measured voltage leave no doubt of it.

    Parameters
    ----------
    plain : the plain model under weights that allow for causes of any form
    signatures : of all mechanisms about it

    Returns
    -------
    None where the amplifier does as the plain model says, or something else may do the same
    """
    missed, size = _measure_missed(plain)
    if not missed > RULES.fit.strong * size:
        return None
    scores = [s for s in find_best_scores(signatures) if s.chosen.mechanism.shows & AMPLIFIER]
    fits = confirm_best(fit_each_mechanism(plain, scores, signatures, len(scores)))
    if not fits:
        return None
    best, *others = fits
    (chosen,) = best.of.chosen
    rival = max((f.log_evidence for f in others), default=-np.inf)
    is_clear = (chosen.id, chosen.variant) == (
        DRIVE_LAG.id,
        MONITORED,
    ) and rival < best.log_evidence - RULES.fit.close_call
    return best if is_clear and _measure_missed(best)[0] < RULES.fit.amplifier_left * missed else None


def _measure_missed(fit: ExtendedFit) -> tuple[float, int]:
    """χ² of what a model leaves of the voltages measured against the command, under the noise, and their number."""
    session = fit.of.session
    own = np.isin(session.kind, list(AMPLIFIER))
    residual = session.whiten(session.value - fit.of.predict(fit.x))[own]
    return float(residual @ residual), int(own.sum())
