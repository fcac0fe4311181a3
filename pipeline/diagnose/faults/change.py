"""A film that was another one from one recording on: torn, or clamped anew."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pipeline.diagnose.faults import fault as ids
from pipeline.diagnose.faults.agreement import agrees
from pipeline.diagnose.faults.fault import Fault
from pipeline.diagnose.faults.undo import scale_of
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.plain_fit import PlainFit, compute_deviations, make_bounds
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import minimise
from schemas.arrays import Bool, Float
from schemas.numbers import significant
from schemas.protocols import CALIBRATION, ELECTRICAL

_FEWEST = 2
"""Recordings before and after a change at least: what one recording shows is a fault of its own."""
_FLOOR = 0.005
"""Scatter of the logarithm of a recording's scale that is always allowed for."""
_LEAST = 2 * _FLOOR
"""Logarithm of a change below which it is not looked for: twice the scatter that is always allowed for."""
_LARGEST = 2.0
"""Logarithm of the largest change that is searched."""


def find_change(session: Session, simulation: Simulation, fit: PlainFit, chi2: float) -> Fault | None:
    """The recordings from which on the film was another, None where no single change explains nearly all of the misfit.

    Parameters
    ----------
    fit : film and rig that most recordings agree on
    chi2 : of the session without a change
    """
    place = _find_step(session, simulation, fit)
    if place is None or not shows_in_more_than_one_test(session, place[0]):
        return None
    first, start = place
    rows = session.recording_of >= first
    fits = [_fit_change(session, simulation, fit, rows, start, change) for change in (_tear, _rescale)]
    before, (chi2, change) = chi2, min(fits)
    fall = before - chi2
    odds = 0.5 * fall - float(np.log(max(fall, 2.0))) + float(np.log(RULES.fault.prior))
    left = chi2 / session.size
    if odds < np.log(RULES.fault.named / (1 - RULES.fault.named)) or not agrees(left, before / session.size):
        return None
    return Fault(
        ids.SPECIMEN_CHANGED,
        tuple(r.recording_id for r in session.recordings[first:]),
        float(1 / (1 + np.exp(-min(odds, 50.0)))),
        f"from {session.recordings[first].recording_id} on the film pulls {significant(np.exp(change), 3)} times as strongly "
        "as before, or its force is read so much larger",
        left_per_value=left,
    )


def shows_in_more_than_one_test(session: Session, first: int) -> bool:
    """Whether tests of one kind lie on both sides of a change, or both loadings do: what one kind alone shows that comes last is as likely a
    mechanism that the others do not show."""
    tests = [(r.protocol, r.loading) for r in session.recordings if r.loading != CALIBRATION]
    after = [(r.protocol, r.loading) for r in session.recordings[first:] if r.loading != CALIBRATION]
    before = tests[: len(tests) - len(after)]
    return bool(set(before) & set(after)) or len({x for _, x in before} & {x for _, x in after}) > 1


def _find_step(session: Session, simulation: Simulation, fit: PlainFit) -> tuple[int, float] | None:
    """Number of the first recording after the largest step of the recordings' scales, and its logarithm; None without one."""
    log, sd = _measure_scales(session, simulation, fit)
    known = np.flatnonzero(np.isfinite(log))
    best: tuple[float, int, float] | None = None
    for cut in range(_FEWEST, known.size - _FEWEST + 1):
        before, after = known[:cut], known[cut:]
        weight = 1 / (sd**2 + _FLOOR**2)
        low, high = (float(np.average(log[part], weights=weight[part])) for part in (before, after))
        left = float(
            np.sum(weight[before] * (log[before] - low) ** 2) + np.sum(weight[after] * (log[after] - high) ** 2)
        )
        if best is None or left < best[0]:
            best = left, int(after[0]), high - low
    return None if best is None or abs(best[2]) < _LEAST else best[1:]


def _measure_scales(session: Session, simulation: Simulation, fit: PlainFit) -> tuple[Float, Float]:
    """(R,) logarithm of each recording's features over those predicted, and its standard deviation; NaN where unknown."""
    predicted = simulation.predict(fit.model, fit.theta)
    y, f = session.whiten(session.value), session.whiten(predicted)
    of_force = _scale_force(session, 2.0) != 1.0
    log = np.full(len(session.recordings), np.nan)
    sd = np.full(log.size, np.inf)
    for number in range(log.size):
        own = (session.recording_of == number) & of_force
        power = float(f[own] @ f[own])
        if power > 0:
            scale = float(y[own] @ f[own]) / power
            if scale > 0:
                log[number], sd[number] = np.log(scale), 1 / (scale * np.sqrt(power))
    return log, sd


def _scale_force(session: Session, factor: float) -> Float:
    """(N,) factor of each value under a factor on all forces."""
    parts = [
        np.full(
            p.block.size,
            scale_of(p.block.kind, session.recordings[p.recording].loading == ELECTRICAL, {"force": factor}),
        )
        for p in session.places
    ]
    return np.concatenate(parts)


Change = Callable[[Session, Simulation, PlainFit, Float, float], Float]


def _tear(session: Session, simulation: Simulation, fit: PlainFit, thetas: Float, change: float) -> Float:
    """(B, N) features with a film of another width: its springs and the actuation change alike."""
    moved = thetas.copy()
    for i, name in enumerate(fit.model.names):
        if name.startswith("log k") or name == "log actuation":
            moved[:, i] += change
    return simulation.predict_several(fit.model, moved)


def _rescale(session: Session, simulation: Simulation, fit: PlainFit, thetas: Float, change: float) -> Float:
    """(B, N) features with all of the force in proportion."""
    return np.asarray(_scale_force(session, float(np.exp(change))) * simulation.predict_several(fit.model, thetas))


def _fit_change(
    session: Session, simulation: Simulation, fit: PlainFit, rows: Bool, start: float, change: Change
) -> tuple[float, float]:
    """χ² of the session with a change in some rows, and the logarithm of the change."""
    about = simulation.about(fit.model.physical(fit.theta))

    def residuals(several: Float) -> Float:
        found = []
        for x in several:
            before = about.predict_several(fit.model, x[None, :-1])[0]
            after = change(session, about, fit, x[None, :-1], float(x[-1]))[0]
            data = session.whiten(session.value - np.where(rows, after, before))
            found.append(np.concatenate([data, compute_deviations(fit.model, x[:-1])]))
        return np.array(found)

    low, high = make_bounds(fit.model)
    found = minimise(residuals, np.append(fit.theta, start), np.append(low, -_LARGEST), np.append(high, _LARGEST))
    return found.chi2, float(found.x[-1])
