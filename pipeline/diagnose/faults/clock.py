"""Clocks of two channels that run apart in all recordings: what a drift leaves, and a constant delay does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.diagnose.faults import fault as ids
from pipeline.diagnose.faults.agreement import agrees, count_chi2, measure_left
from pipeline.diagnose.faults.fault import Correction, Fault
from pipeline.diagnose.faults.fitted import Fitted, assemble_session, fit_session
from pipeline.diagnose.faults.undo import RESPONSES, advance_block, follow_delay, turn, turned
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.plain_fit import (
    PlainFit,
    compute_deviations,
    fit_from_ladders,
    make_bounds,
    measure_roughness,
)
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import minimise
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.numbers import significant

_DRIFTS = np.geomspace(2e-6, 1e-3, 22)
"""Drifts of a clock at which its search begins, of either sign."""
_DELAYS = np.geomspace(2e-6, 1e-2, 22)
"""Delays in s that must not do as well."""
_ROUNDS, _SETTLED = 4, 0.01
"""Times at most that a drift is followed anew from where its search ended, and the share of it by which it moves no more."""
_DRIFT_UNIT, _DELAY_UNIT = 1e-5, 1e-5
"""Drift and delay in s that count as 1 in a search."""


def find_drift(
    recordings: Sequence[RecordingFeatures], fitted: Fitted
) -> tuple[list[RecordingFeatures], Fitted, Fault] | None:
    """A clock of the output that runs fast or slow in all recordings alike, with the recordings put right.

    None where that does not explain nearly all of the misfit, or where a constant delay does as well: that is a
    mechanism of its own.
    """
    session, _, plain = fitted
    off = count_chi2(session, plain.misfit)
    before = measure_left(session, off)
    start = _scan(session, _DRIFTS, drifting=True)
    if start is None:
        return None
    drift, chi2, near = start, off, start + 1.0
    for _ in range(_ROUNDS):
        if abs(drift - near) < _SETTLED * abs(drift):
            break
        near = drift
        drift, chi2 = _refine([follow_delay(r, 0.0, near) for r in recordings], near, plain, drifting=True)
    if not agrees(measure_left(session, chi2), before):
        return None
    changed = [follow_delay(r, 0.0, drift) for r in recordings]
    again = fit_session(changed)
    whole = count_chi2(again[0], again[2].misfit)
    left = measure_left(again[0], whole)
    if not agrees(left, before):
        return None
    other = off
    delay = _scan(session, _DELAYS, drifting=False)
    if delay is not None:
        late = _refine([follow_delay(r, delay, 0.0) for r in recordings], delay, again[2], drifting=False)
        other = min(other, late[1])
    odds = 0.5 * (other - whole) - 0.5 * float(np.log(max(off - whole, 2.0)))
    probability = float(1 / (1 + np.exp(-np.clip(odds + np.log(RULES.fault.prior), -50, 50))))
    if probability < RULES.fault.named:
        return None
    way = "ahead of" if drift > 0 else "behind"
    words = f"the clock of the force runs {significant(1e6 * abs(drift), 3)} ppm {way} that of the input in all tests"
    key, then = "columns.force.time_scale", f"{1 / (1 + drift):.9g}"
    corrections = tuple(Correction(r.recording_id, ids.CLOCK_DRIFT, key, "1", then, probability) for r in recordings)
    names = tuple(r.recording_id for r in recordings)
    return changed, again, Fault(ids.CLOCK_DRIFT, names, probability, words, corrections, False, left)


def _scan(session: Session, sizes: Float, *, drifting: bool) -> float | None:
    """The drift or delay that makes the responses most like those of a film; None where none makes them much more so."""

    def roughness(size: float) -> float:
        late = (0.0, size) if drifting else (size, 0.0)
        places = tuple(replace(p, block=advance_block(p.block, *late)) for p in session.places)
        return measure_roughness(replace(session, places=places))

    try:
        as_it_is = roughness(0.0)
        found = min((roughness(float(sign * size)), float(sign * size)) for size in sizes for sign in (-1, 1))
    except NotIdentifiableError:
        return None
    return found[1] if found[0] < RULES.fault.smoother * as_it_is else None


def _refine(
    recordings: Sequence[RecordingFeatures], start: float, near: PlainFit, *, drifting: bool
) -> tuple[float, float]:
    """The drift or delay fitted together with film and rig, from recordings put right by a value nearby, and χ² with it.

    `near` is a fit of the same recordings without it.
    """
    session = assemble_session(recordings)
    simulation = Simulation(session)
    # With all arms that there may be: what the drift has done to the fit decides nothing of their number here.
    model = session.base_model(RULES.plain.orders[-1])
    plain = fit_from_ladders(session, simulation, model, near if near.model.names == model.names else None)
    about = simulation.about(plain.model.physical(plain.theta))
    unit = _DRIFT_UNIT if drifting else _DELAY_UNIT

    def residuals(several: Float) -> Float:
        predicted = about.predict_several(plain.model, several[:, :-1])
        for values, x in zip(predicted, several, strict=True):
            late = (0.0, unit * x[-1]) if drifting else (unit * x[-1], 0.0)
            for p in session.places:
                if p.block.kind in RESPONSES:
                    values[p.first : p.stop] = turned(values[p.first : p.stop], turn(p.block, *late))
        data = session.whiten((session.value - predicted).T).T
        beside = np.array([compute_deviations(plain.model, x[:-1]) for x in several])
        return np.concatenate([data, beside], axis=1)

    low, high = make_bounds(plain.model)
    widest = abs(start) / unit
    found = minimise(residuals, np.append(plain.theta, 0.0), np.append(low, -widest), np.append(high, widest))
    return start + unit * float(found.x[-1]), count_chi2(session, found.residual)
