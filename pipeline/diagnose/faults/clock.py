"""Outputs that are stamped late in many recordings: by a clock that runs apart from that of the input in all of them, or by a delay that all
tests of one kind have and the others have not. A delay that all have alike is a mechanism of its own."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from pipeline.diagnose.faults import fault as ids
from pipeline.diagnose.faults.agreement import agrees, count_chi2, measure_left
from pipeline.diagnose.faults.correct import write, write_ratio
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
from schemas.protocols import ELECTRICAL, MECHANICAL

_DRIFTS = np.geomspace(2e-6, 1e-3, 22)
"""Drifts of a clock at which its search begins, of either sign."""
_DELAYS = np.geomspace(2e-6, 1e-2, 22)
"""Delays in s at which their search begins, of either sign."""
_ROUNDS, _SETTLED = 4, 0.01
"""Times at most that a drift is followed anew from where its search ended, and the share of it by which it moves no more."""
_DRIFT_UNIT, _DELAY_UNIT = 1e-5, 1e-5
"""Drift and delay in s that count as 1 in a search."""


@dataclass(frozen=True)
class _Way:
    """A way in which outputs may be stamped late.

    Parameters
    ----------
    recordings : ids of those in which they are
    drifting : whether by a share of the time since the start, in place of a constant delay
    tests : which tests these are, in words
    """

    recordings: frozenset[str]
    drifting: bool
    tests: str

    @property
    def unit(self) -> float:
        return _DRIFT_UNIT if self.drifting else _DELAY_UNIT

    @property
    def sizes(self) -> Float:
        """Sizes at which a search begins."""
        return _DRIFTS if self.drifting else _DELAYS

    def split(self, size: float) -> tuple[float, float]:
        """Delay in s and drift."""
        return (0.0, size) if self.drifting else (size, 0.0)

    def put_right(self, recordings: Sequence[RecordingFeatures], size: float) -> list[RecordingFeatures]:
        """The features with the knowledge of it."""
        return [follow_delay(r, *self.split(size)) if r.recording_id in self.recordings else r for r in recordings]

    def state(self, size: float, names: Sequence[str], probability: float, left: float) -> Fault:
        """The fault, in recordings in the order of their session."""
        if self.drifting:
            cause, key, now, then = ids.CLOCK_DRIFT, "columns.force.time_scale", "1", write_ratio(1 / (1 + size))
            way = "ahead of" if size > 0 else "behind"
            ppm = significant(1e6 * abs(size), 3)
            words = f"the clock of the force runs {ppm} ppm {way} that of the input in {self.tests}"
        else:
            cause, key, now, then = ids.CHANNEL_SKEW, "columns.force.delay_s", "", write(size)
            words = f"the force is stamped {significant(1e3 * size, 3)} ms late in {self.tests}"
        corrections = tuple(Correction(name, cause, key, now, then, probability) for name in names)
        return Fault(cause, tuple(names), probability, words, corrections, False, left)


@dataclass(frozen=True)
class _Late:
    """A drift or delay at the optimum next to it, χ² of the features, and film and rig there."""

    size: float
    chi2: float
    plain: PlainFit


def _list_ways(recordings: Sequence[RecordingFeatures]) -> Iterator[_Way]:
    """A drift of all recordings, and a delay of those of each kind of mechanical test, where there are several and others beside them."""
    tests = [r for r in recordings if r.loading == MECHANICAL]
    yield _Way(frozenset(r.recording_id for r in recordings), True, "all tests")
    for protocol in dict.fromkeys(r.protocol for r in tests):
        own = frozenset(r.recording_id for r in tests if r.protocol == protocol)
        if 1 < len(own) < len(recordings):
            yield _Way(own, False, f"all recordings of {protocol}")


def _list_sensors(recordings: Sequence[RecordingFeatures]) -> tuple[_Way, _Way]:
    """Delays of the force, which all tests have, and of the displacement, which all mechanical tests have."""
    every, moved = (
        frozenset(r.recording_id for r in recordings if r.loading in loadings)
        for loadings in ({MECHANICAL, ELECTRICAL}, {MECHANICAL})
    )
    return _Way(every, False, "all tests"), _Way(moved, False, "all mechanical tests")


def find_late(
    recordings: Sequence[RecordingFeatures], fitted: Fitted, without: Collection[str]
) -> tuple[list[RecordingFeatures], Fitted, Fault] | None:
    """Outputs that are stamped late by a drift in all recordings alike, or by a delay in all of one kind, with the recordings put right.

    Parameters
    ----------
    recordings : of the session
    fitted : those of them that are not in `without`

    Returns
    -------
    None where that does not explain nearly all of the misfit, or where a constant delay of a sensor does as well: that is a mechanism
    """
    asked = [r for r in recordings if r.recording_id not in without]
    session, _, plain = fitted
    off = count_chi2(session, plain.misfit)
    before = measure_left(session, off)
    scanned = [(*found, way) for way in _list_ways(asked) if (found := _scan(session, way)) is not None]
    if not scanned:
        return None
    _, start, way = min(scanned, key=lambda item: item[0])
    # From the film that the recordings have once they are put right: that of the plain fit is bent by the drift.
    late = _follow(asked, way, start, fit_session(way.put_right(asked, start))[2])
    if not agrees(measure_left(session, late.chi2), before):
        return None
    size = late.size
    again = fit_session(way.put_right(asked, size))
    whole = count_chi2(again[0], again[2].misfit)
    left = measure_left(again[0], whole)
    if not agrees(left, before):
        return None
    other = off
    for sensor in _list_sensors(asked):
        delay = _scan(session, sensor)
        if delay is not None:
            other = min(other, _refine(asked, sensor, delay[1], again[2], afresh=True).chi2)
    odds = 0.5 * (other - whole) - 0.5 * float(np.log(max(off - whole, 2.0)))
    probability = float(1 / (1 + np.exp(-np.clip(odds + np.log(RULES.fault.prior), -50, 50))))
    if probability < RULES.fault.named:
        return None
    if way.drifting:  # as it does in those that are still asked for another fault
        way = replace(way, recordings=frozenset(r.recording_id for r in recordings))
    names = [r.recording_id for r in recordings if r.recording_id in way.recordings]
    return way.put_right(recordings, size), again, way.state(size, names, probability, left)


def _scan(session: Session, way: _Way) -> tuple[float, float] | None:
    """Roughness and size with which the responses are most like those of a film; None where no size makes them much more so."""
    late = [session.recordings[p.recording].recording_id in way.recordings for p in session.places]

    def roughness(size: float) -> float:
        places = tuple(
            replace(p, block=advance_block(p.block, *way.split(size))) if own else p
            for p, own in zip(session.places, late, strict=True)
        )
        return measure_roughness(replace(session, places=places))

    try:
        as_it_is = roughness(0.0)
        tried = [(roughness(float(sign * size)), sign, i) for i, size in enumerate(way.sizes) for sign in (-1, 1)]
    except NotIdentifiableError:
        return None
    _, sign, i = min(tried)
    ends = np.log(way.sizes[[max(i - 1, 0), min(i + 1, way.sizes.size - 1)]])
    found = minimize_scalar(
        lambda x: roughness(float(sign * np.exp(x))), bounds=tuple(ends), method="bounded", options={"xatol": _SETTLED}
    )
    rough, size = min((float(found.fun), float(sign * np.exp(found.x))), (min(tried)[0], float(sign * way.sizes[i])))
    return (rough, size) if rough < RULES.fault.smoother * as_it_is else None


def _follow(recordings: Sequence[RecordingFeatures], way: _Way, start: float, near: PlainFit) -> _Late:
    """The drift or delay from a value nearby, sought anew from where its search ended until it moves no more or explains no more."""
    found = _refine(recordings, way, start, near)
    for _ in range(_ROUNDS - 1):
        last, found = found, _refine(recordings, way, found.size, found.plain)
        if abs(found.size - last.size) < _SETTLED * abs(found.size) or found.chi2 > last.chi2:
            break
    return found


def _refine(
    recordings: Sequence[RecordingFeatures], way: _Way, start: float, near: PlainFit, *, afresh: bool = False
) -> _Late:
    """The drift or delay fitted together with film and rig, from recordings put right by a value nearby.

    `near` is a fit of much the same recordings: the start of this one, or with `afresh` one of its starts at the most.
    """
    session = assemble_session(way.put_right(recordings, start))
    simulation = Simulation(session)
    if afresh:
        # With all arms that there may be: what the drift has done to the fit decides nothing of their number here.
        model = session.base_model(RULES.plain.orders[-1])
        near = fit_from_ladders(session, simulation, model, near if near.model.names == model.names else None)
    about = simulation.about(near.model.physical(near.theta))
    late = [
        p
        for p in session.places
        if p.block.kind in RESPONSES and session.recordings[p.recording].recording_id in way.recordings
    ]

    def residuals(several: Float) -> Float:
        predicted = about.predict_several(near.model, several[:, :-1])
        for values, x in zip(predicted, several, strict=True):
            for p in late:
                factor = turn(p.block, *way.split(way.unit * x[-1]))
                values[p.first : p.stop] = turned(values[p.first : p.stop], factor)
        data = session.whiten((session.value - predicted).T).T
        beside = np.array([compute_deviations(near.model, x[:-1]) for x in several])
        return np.concatenate([data, beside], axis=1)

    low, high = make_bounds(near.model)
    widest = abs(start) / way.unit
    found = minimise(residuals, np.append(near.theta, 0.0), np.append(low, -widest), np.append(high, widest))
    plain = replace(near, theta=found.x[:-1])
    return _Late(start + way.unit * float(found.x[-1]), count_chi2(session, found.residual), plain)
