"""What the amplifier makes of its command, which is read before anything else.

Command and measured voltage show the lag of an amplifier as plainly as an oscilloscope does, and film and rig have no part in it: what is
simulated is driven by the voltage that was measured. Where it is beyond doubt, all else is asked beside it: a further lag as well, that the
monitor does not show. Not here: a lag of which the monitor shows nothing, which is one cause among others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.diagnose.features.kinds import AMPLIFIER
from pipeline.diagnose.mechanisms.drive import DRIVE_LAG, FURTHER, MONITORED
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Chosen, ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import confirm_best, finish_fit, fit_each_mechanism
from pipeline.diagnose.search.screen import Signatures, find_best_scores

_STARTS, _STEPS = 4, 6
"""Time constants from which a further lag is searched, and steps after which the searches are compared."""


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
    scores = [
        s
        for s in find_best_scores(signatures)
        if s.chosen.mechanism.shows & AMPLIFIER and (s.chosen.id != DRIVE_LAG.id or s.chosen.variant == MONITORED)
    ]
    fits = confirm_best(fit_each_mechanism(plain, scores, signatures, len(scores)))
    if not fits:
        return None
    best, *others = fits
    rival = max((f.log_evidence for f in others), default=-np.inf)
    is_clear = best.of.mechanism_ids == (DRIVE_LAG.id,) and rival < best.log_evidence - RULES.fit.close_call
    return best if is_clear and _measure_missed(best)[0] < RULES.fit.amplifier_left * missed else None


def fit_further_lag(given: ExtendedFit) -> ExtendedFit:
    """The lag of the amplifier with one more behind it that the monitor does not show: electrodes and leads take their time as well.

    Parameters
    ----------
    given : the plain model with the monitored lag

    Returns
    -------
    The model at its optimum, under the same weights
    """
    of = replace(given.of, chosen=(Chosen(DRIVE_LAG.id, FURTHER),))
    (lag,) = given.values
    further = DRIVE_LAG.parameter("further_time_constant_s")
    starts = [
        of.make_entries(given.theta, ({**lag, further.name: float(s)},))
        for s in np.geomspace(further.low, further.high, _STARTS)
    ]
    begun = [of.fit(x, most=_STEPS, near=given, thorough=False) for x in starts]
    return finish_fit(min(begun, key=lambda f: f.chi2))


def _measure_missed(fit: ExtendedFit) -> tuple[float, int]:
    """χ² of what a model leaves of the voltages measured against the command, under the noise, and their number."""
    session = fit.of.session
    own = np.isin(session.kind, list(AMPLIFIER))
    residual = session.whiten(session.value - fit.of.predict(fit.x))[own]
    return float(residual @ residual), int(own.sum())
