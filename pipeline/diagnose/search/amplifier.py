"""What the amplifier makes of its command, which is read before anything else.

Command and measured voltage show the lag of an amplifier as plainly as an oscilloscope does, and film and rig have no part in it: what is
simulated is driven by the voltage that was measured. Where it is beyond doubt, all else is asked beside it: a further lag as well, that the
monitor does not show. A lag that is as the rig's file states it is no finding, and what the amplifier makes of its command is not asked
further. Not here: a lag of which the
monitor shows nothing, which is one cause among others.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.diagnose.features.kinds import AMPLIFIER, RecordingFeatures
from pipeline.diagnose.mechanisms.drive import DRIVE_LAG, FURTHER, MONITORED
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Chosen, Extended, ExtendedFit
from pipeline.diagnose.search.fit_mechanisms import confirm_best, finish_fit, fit_each_mechanism
from pipeline.diagnose.search.plain_fit import PlainFit
from pipeline.diagnose.search.screen import Signatures, find_best_scores
from pipeline.diagnose.search.tempering import temper_weights
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import minimise
from schemas.metadata import RigConstants

_FILED = ("rise_time_constant_s", "fall_time_constant_s", "slew_kv_per_s")
"""What a rig's file may state of its amplifier, as the severity of its lag is told."""
_FILED_SD = 0.1
"""Relative standard deviation of what a file states without one."""
_LEAST_SD = 0.01
"""Relative error that is always allowed for: no amplifier is exactly of first order."""
_MOST = 25
"""Steps of a fit from what a file states."""
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


def drop_filed_lag(session: Session, simulation: Simulation, plain: PlainFit) -> list[RecordingFeatures] | None:
    """The recordings of a session without what its amplifier makes of its command, where that lags as the rig's file states it.

    What a lag of our form leaves of the voltages says how an amplifier differs from first order, and is no finding either.

    Parameters
    ----------
    session, simulation : with tests in which command and voltage were recorded
    plain : the plain model, fitted

    Returns
    -------
    None where no file states a lag, or the recordings show another one: that is a finding
    """
    own = np.isin(session.kind, list(AMPLIFIER))
    rigs = [session.recordings[p.recording].rig for p in session.places if p.block.kind in AMPLIFIER]
    if len({_state_lag(rig) for rig in rigs}) != 1 or not _state_lag(rigs[0]):
        return None
    missed = float(np.sum(plain.misfit[own] ** 2))
    if not _measure_missed(_fit_filed_lag(session, simulation, plain, rigs[0]))[0] < RULES.fit.amplifier_left * missed:
        return None
    return [replace(r, blocks=tuple(b for b in r.blocks if b.kind not in AMPLIFIER)) for r in session.recordings]


def _state_lag(rig: RigConstants) -> tuple[tuple[str, float], ...]:
    """What a rig's file states of its amplifier's lag; empty where it has no time constant of the rise."""
    values = {name: getattr(rig, f"amplifier_{name}") for name in _FILED}
    if values[_FILED[0]] is None:
        return ()
    return tuple((name, value) for name, value in values.items() if value is not None)


def _fit_filed_lag(session: Session, simulation: Simulation, plain: PlainFit, rig: RigConstants) -> ExtendedFit:
    """The plain model with a lag of the amplifier as the rig's file states it, within its errors; what the file does not state may be
    anything."""
    weight = temper_weights(session, plain.misfit)
    of = Extended(session, simulation, plain.model, (Chosen(DRIVE_LAG.id, MONITORED),), weight)
    rise, rise_sd = _read_filed(rig, _FILED[0])
    start, spread = {"rise_time_constant_s": rise}, {"rise_time_constant_s": rise_sd}
    for name, parameter, per in ((_FILED[1], "fall_ratio", 1 / rise), (_FILED[2], "limit_kv", rise)):
        if getattr(rig, f"amplifier_{name}") is not None:
            value, spread[parameter] = _read_filed(rig, name)
            start[parameter] = value * per
    x = of.make_entries(plain.theta, (start,))
    low, high = (limits.copy() for limits in of.limits)
    for place, c in enumerate(of.coordinates, start=plain.model.size):
        name = c.parameter.name
        if name in spread:
            factor = float(np.exp(RULES.fault.off * spread[name]))
            low[place], high[place] = c.entry(start[name] / factor), c.entry(start[name] * factor)
    return ExtendedFit(of, minimise(of.residuals, x, low, high, most=_MOST, moving=of.settled))


def _read_filed(rig: RigConstants, name: str) -> tuple[float, float]:
    """What a rig's file states of its amplifier, and its relative standard deviation."""
    value, sd = getattr(rig, f"amplifier_{name}"), getattr(rig, f"amplifier_{name}_sd")
    return value, _FILED_SD if sd is None else max(sd / value, _LEAST_SD)


def _measure_missed(fit: ExtendedFit) -> tuple[float, int]:
    """χ² of what a model leaves of the voltages measured against the command, under the noise, and their number."""
    session = fit.of.session
    own = np.isin(session.kind, list(AMPLIFIER))
    residual = session.whiten(session.value - fit.of.predict(fit.x))[own]
    return float(residual @ residual), int(own.sum())
