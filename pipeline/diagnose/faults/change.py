"""What was another from one recording on, the film (torn, or clamped anew) or the gain of the load cell; and a gain that is another where
the force is large, in another range."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.faults import fault as ids
from pipeline.diagnose.faults.agreement import agrees, count_chi2, measure_left
from pipeline.diagnose.faults.correct import write
from pipeline.diagnose.faults.fault import Correction, Fault
from pipeline.diagnose.faults.fitted import fit_session
from pipeline.diagnose.faults.levels import log_likelihood_of
from pipeline.diagnose.faults.undo import scale_of
from pipeline.diagnose.features.kinds import RecordingFeatures
from pipeline.diagnose.features.observed import FORCE_SWING
from pipeline.diagnose.mechanisms.sensor import GAIN_ERROR
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.plain_fit import PlainFit, compute_deviations, make_bounds
from pipeline.diagnose.simulation.parameters import ACTUATION, PER_FORCE
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import minimise
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError
from schemas.numbers import significant
from schemas.protocols import CALIBRATION, ELECTRICAL

_FEWEST = 2
"""Recordings of one loading before and after a change at least: what one recording shows is a fault of its own."""
_FLOOR = 0.005
"""Scatter of the logarithm of a recording's scale that is always allowed for."""
_LEAST = 2 * _FLOOR
"""Logarithm of a change below which it is not looked for: twice the scatter that is always allowed for."""
_LARGEST = 2.0
"""Logarithm of the largest change that is searched."""
_SOFTEST, _PLACES = 1.2, 25
"""Logarithm of the largest change of the springs that is looked for, and places from one to the other side."""
_ALIKE = 4
"""Places of a change that are fitted at most where the springs do not say at which it is."""
_ROUGHLY, _STEPS = 25, 200
"""Steps of that search at most, of every change and of the nearest: sweeps before it may say next to nothing of arms that later tests see."""
_PROMISING = 0.2
"""Share of χ² that the nearest change has to come down to after few steps, to be followed to its end."""
_SCALE = "columns.force.scale"
_RANGES = 1.5
"""Largest over least swing of the forces in a range at least: what depends on the strain would grow over it."""
_WORTH_SAYING = 0.05
"""Probability from which what may have changed is said."""


@dataclass(frozen=True)
class _Part:
    """Recordings of a session that may be read, or be, otherwise than the others.

    Parameters
    ----------
    members : (R,) which they are
    step : logarithm of their features over those of the others
    offsets : logarithms of what film and actuation of the others are over those of the fit
    left : weighted square of what that does not explain of the recordings' scales
    of_range : whether they are those with the largest forces, in place of the last
    """

    members: Bool
    step: float
    offsets: tuple[float, float]
    left: float
    of_range: bool


def find_change(session: Session, simulation: Simulation, fit: PlainFit, chi2: float) -> Fault | None:
    """The recordings from which on the film was another, or whose force was read in another range; None where no such change explains
    nearly all of the misfit.

    Parameters
    ----------
    fit : film and rig that most recordings agree on
    chi2 : of the session without a change, without the amplifier's share
    """
    parts = _list_parts(session, simulation, fit)
    if not parts:
        return None
    tried = [(part, _fit_changes(session, simulation, fit, part)) for part in parts]
    part, fits = min(tried, key=lambda each: min(left for left, _ in each[1].values()))
    nearest = min(fits, key=lambda name: fits[name][0])
    if fits[nearest][0] < _PROMISING * chi2:
        fits = {**fits, **_fit_changes(session, simulation, fit, part, _STEPS, [nearest])}
    before, chi2 = chi2, fits[nearest][0]
    fall = before - chi2
    odds = 0.5 * fall - float(np.log(max(fall, 2.0))) + float(np.log(RULES.fault.prior))
    left = measure_left(session, chi2)
    if abs(fits[nearest][1]) < _LEAST:
        return None
    if odds < np.log(RULES.fault.named / (1 - RULES.fault.named)) or not agrees(left, measure_left(session, before)):
        return None
    if part.of_range:
        return _state_range(session, part.members, fits[GAIN_ERROR.id][1], left)
    return _state_change(session, int(np.argmax(part.members)), fits, nearest, left)


def merge_foreign(found: Sequence[Fault], session: Session, doubted: Collection[str] = ()) -> list[Fault]:
    """Faults with those of foreign recordings as one where they are all of one film, and all that were made before, or from, one recording:
    the specimen was another from there on.

    Parameters
    ----------
    session : with all recordings, in the order of time
    doubted : recordings that may be of another film as well, without being told as such
    """
    foreign = [f for f in found if f.cause == ids.FOREIGN_RECORDING]
    if not foreign:
        return list(found)
    named = {id for f in foreign for id in f.recordings}
    tests = [r for r in session.recordings if r.loading != CALIBRATION]
    # Those that miss the others by less than a film does in most tests are of the other film where all of the others are.
    sets = dict.fromkeys(frozenset(names) for names in (named.union(doubted), named))
    ways = (w for names in sets if (w := _split_at_one(tests, names)) is not None)
    way = next((w for w in ways if w[1] <= RULES.fault.agrees), None)
    if way is None:
        return list(found)
    first, left = way
    changed = tests[first:]
    probability = min(f.probability for f in foreign)
    corrections = tuple(
        Correction(r.recording_id, ids.SPECIMEN_CHANGED, "specimen_id", r.specimen_id, "", probability) for r in changed
    )
    words = f"from {changed[0].recording_id} on the film is not that of before"
    change = Fault(
        ids.SPECIMEN_CHANGED,
        tuple(r.recording_id for r in changed),
        probability,
        words,
        corrections,
        left_per_value=left,
    )
    return [f for f in found if f.cause != ids.FOREIGN_RECORDING] + [change]


def _split_at_one(tests: Sequence[RecordingFeatures], names: Collection[str]) -> tuple[int, float] | None:
    """Number of the first test after the one place that parts some from the others, and χ² per value that one film for these leaves; None where
    there is no such place, or they cannot be asked by themselves.

    Parameters
    ----------
    names : several of the tests
    """
    turns = np.flatnonzero(np.diff([r.recording_id in names for r in tests])) + 1
    if len(names) < _FEWEST or turns.size != 1:
        return None
    try:
        together, _, fit = fit_session([r for r in tests if r.recording_id in names])
    except NotIdentifiableError:
        return None
    return int(turns[0]), measure_left(together, count_chi2(together, fit.misfit))


def _state_range(session: Session, members: Bool, log_factor: float, left: float) -> Fault:
    """The fault of a range of the load cell."""
    own = [r for r, inside in zip(session.recordings, members, strict=True) if inside]
    factor, least = float(np.exp(log_factor)), min(r.values[FORCE_SWING] for r in own)
    words = f"where the force swings by {significant(least, 2)} N and more it is read {significant(factor, 3)} times as large as elsewhere"
    corrections = tuple(
        Correction(r.recording_id, GAIN_ERROR.id, _SCALE, "1", write(1 / factor), RULES.fault.named) for r in own
    )
    names = tuple(r.recording_id for r in own)
    return Fault(GAIN_ERROR.id, names, RULES.fault.named, words, corrections, left_per_value=left)


def _state_change(
    session: Session, first: int, fits: Mapping[str, tuple[float, float]], nearest: str, left: float
) -> Fault:
    """The fault, with the other thing that may have changed where the recordings do not tell them apart.

    The clamp's resonance moves with the film's stiffness and not with a gain, and a gain reads the tension at rest otherwise as well.
    """
    behind = {name: -0.5 * (chi2 - fits[nearest][0]) / max(left, 1.0) for name, (chi2, _) in fits.items()}
    as_gain, as_before = _judge_tension(session, first, fits[GAIN_ERROR.id][1])
    odd_film = (
        float(np.log(RULES.fault.stray)) + behind[GAIN_ERROR.id] + as_before
    )  # new, and yet as under another gain
    log = np.array([np.logaddexp(behind[ids.SPECIMEN_CHANGED], odd_film), behind[GAIN_ERROR.id] + as_gain])
    share = np.exp(log - np.logaddexp(*log))
    shares = {ids.SPECIMEN_CHANGED: float(share[0]), GAIN_ERROR.id: float(share[1])}
    cause, other = sorted(shares, key=lambda name: -shares[name])
    factor = float(np.exp(fits[nearest][1]))
    changed = session.recordings[first:]
    corrections = []
    for name in (n for n in (cause, other) if shares[n] >= _WORTH_SAYING):
        for own in changed:
            if name == GAIN_ERROR.id:
                now, then = "1", write(1 / factor)
                corrections.append(Correction(own.recording_id, name, _SCALE, now, then, shares[name]))
            else:
                now = own.specimen_id
                corrections.append(Correction(own.recording_id, name, "specimen_id", now, "", shares[name]))
    size = significant(factor, 3)
    words = {
        ids.SPECIMEN_CHANGED: f"the film pulls {size} times as strongly as before",
        GAIN_ERROR.id: f"the force is read {size} times as large as before",
    }
    open_words = (
        " (or the film changed so much)" if cause == GAIN_ERROR.id else " (or its force is read so much larger)"
    )
    return Fault(
        cause,
        tuple(r.recording_id for r in changed),
        shares[cause],
        f"from {changed[0].recording_id} on {words[cause]}" + (open_words if shares[other] >= _WORTH_SAYING else ""),
        tuple(corrections),
        left_per_value=left,
    )


def _judge_tension(session: Session, first: int, log_factor: float) -> tuple[float, float]:
    """Log likelihood of the tension at rest after a change: read by another factor, and the same; 0 where it is not known."""
    rest = [r.values.get("rest_force_n", np.nan) for r in session.recordings]
    before, after = (np.array(part)[np.isfinite(part)] for part in (rest[:first], rest[first:]))
    if not before.size or not after.size or np.median(before) * np.median(after) <= 0:
        return 0.0, 0.0
    middle = float(np.median(before))
    spread = float(np.median(np.abs(np.append(before / middle, after / np.median(after)) - 1))) / 0.6745
    if spread > RULES.fault.rest_spread:
        return 0.0, 0.0
    sd = float(np.hypot(RULES.fault.rest_sd, spread))
    ratio = float(np.log(np.median(after) / middle))
    stray = float(np.log(RULES.fault.stray * sd / RULES.fault.anywhere))
    found = [float(np.logaddexp(log_likelihood_of((ratio - x) / sd), stray)) for x in (log_factor, 0.0)]
    return found[0], found[1]


def shows_in_more_than_one_test(session: Session, members: Bool) -> bool:
    """Whether tests of one kind are on both sides of a change, or both loadings are: what one kind alone shows that comes last is as likely a
    mechanism that the others do not show.

    Parameters
    ----------
    members : (R,) recordings after the change
    """
    before, after = (
        {
            (r.protocol, r.loading)
            for r, own in zip(session.recordings, members, strict=True)
            if own == side and r.loading != CALIBRATION
        }
        for side in (False, True)
    )
    return bool(before & after) or len({x for _, x in before} & {x for _, x in after}) > 1


def _list_parts(session: Session, simulation: Simulation, fit: PlainFit) -> list[_Part]:
    """Recordings that may be, or be read, otherwise than the others: the last ones, or those with the largest forces, whose scales differ most
    clearly from the others', and the last ones whose springs do."""
    by_scale = _rank_parts(session, *_measure_scales(session, simulation, fit), by_range=True)[:1]
    by_springs = _rank_parts(session, *_measure_springs(session, simulation, fit), by_range=False)
    # Tests under voltage have no springs: among those between two others nothing says where the change is.
    alike = [p for p in by_springs if p.left <= by_springs[0].left + 1][:_ALIKE]
    chosen = by_scale + [p for p in alike if not any((p.members == q.members).all() for q in by_scale)]
    return [p for p in chosen if abs(p.step) >= _LEAST]


def _rank_parts(session: Session, log: Float, sd: Float, *, by_range: bool) -> list[_Part]:
    """The parts of a session, the one first after which the recordings' scales are most nearly two values.

    Parameters
    ----------
    log, sd : (R,) logarithms of scales with their standard deviations; NaN where unknown
    by_range : whether parts by the size of the force are asked as well
    """
    known = np.isfinite(log)
    swing = np.array([r.values.get(FORCE_SWING, np.nan) for r in session.recordings])
    electrical = np.array([r.loading == ELECTRICAL for r in session.recordings])
    parts = [(np.arange(log.size) >= first, False) for first in range(1, log.size)]
    if by_range and not np.isnan(swing[known]).any():
        limits = np.unique(swing[known])
        parts += [(np.asarray(swing >= limit), True) for limit in limits if limits[-1] > _RANGES * limit]
    found = []
    for members, of_range in parts:
        # Either loading has a scale of its own: what is on both sides of one of them tells. Over forces by voltage the voltage is another.
        telling = [~electrical] if of_range else [electrical, ~electrical]
        sides = np.array([[(own & known & side).sum() for side in (members, ~members)] for own in telling])
        if sides[sides.all(axis=1)].sum(axis=0).min() < _FEWEST:
            continue
        columns = np.stack([~electrical, electrical, members], axis=1)[known].astype(float)
        weighted = columns / np.hypot(sd[known], _FLOOR)[:, None]
        if (
            not shows_in_more_than_one_test(session, members)
            or np.linalg.matrix_rank(weighted[:, columns.any(axis=0)]) < columns.any(axis=0).sum()
        ):
            continue
        data = log[known] / np.hypot(sd[known], _FLOOR)
        moved = np.linalg.lstsq(weighted, data, rcond=None)[0]
        left = float(np.sum((data - weighted @ moved) ** 2))
        found.append(_Part(members, float(moved[2]), (float(moved[0]), float(moved[1])), left, of_range))
    return sorted(found, key=lambda p: (p.left, p.of_range))


def _measure_springs(session: Session, simulation: Simulation, fit: PlainFit) -> tuple[Float, Float]:
    """(R,) logarithm of the film's springs in each mechanical recording over those of the fit, and its standard deviation; NaN where unknown."""
    places = np.linspace(-_SOFTEST, _SOFTEST, _PLACES)
    moved = np.repeat(fit.theta[None], places.size, axis=0)
    moved[:, [i for i, name in enumerate(fit.model.names) if name.startswith("log k")]] += places[:, None]
    left = session.whiten((session.value - simulation.predict_several(fit.model, moved)).T).T ** 2
    log = np.full(len(session.recordings), np.nan)
    sd = np.full(log.size, np.inf)
    for number, recording in enumerate(session.recordings):
        chi2 = left[:, session.recording_of == number].sum(axis=1)
        best = int(np.argmin(chi2))
        if recording.loading == ELECTRICAL or not 0 < best < places.size - 1:
            continue
        slope, bend = (chi2[best + 1] - chi2[best - 1]) / 2, chi2[best + 1] - 2 * chi2[best] + chi2[best - 1]
        if bend > 0:
            step = places[1] - places[0]
            log[number], sd[number] = places[best] - step * slope / bend, step * float(np.sqrt(2 / bend))
    return log, sd


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


Change = Callable[[Session, Simulation, PlainFit, Float, Float], Float]


def _change_film(session: Session, simulation: Simulation, fit: PlainFit, thetas: Float, change: Float) -> Float:
    """(B, N) features with a film whose springs change by one factor and, where it is known, its actuation by another: a tear takes as much off
    both, a new clamping stretches the film."""
    moved = thetas.copy()
    for i, name in enumerate(fit.model.names):
        if name.startswith("log k"):
            moved[:, i] += change[0]
        elif name == ACTUATION:
            moved[:, i] += change[1]
        elif name == PER_FORCE:  # a stiffer film is strained less by a force
            moved[:, i] *= np.exp(-change[0])
    return simulation.predict_several(fit.model, moved)


def _rescale(session: Session, simulation: Simulation, fit: PlainFit, thetas: Float, change: Float) -> Float:
    """(B, N) features with all of the force in proportion."""
    return np.asarray(_scale_force(session, float(np.exp(change[0]))) * simulation.predict_several(fit.model, thetas))


def _fit_changes(
    session: Session,
    simulation: Simulation,
    fit: PlainFit,
    part: _Part,
    most: int = _ROUGHLY,
    causes: Collection[str] = (GAIN_ERROR.id, ids.SPECIMEN_CHANGED),
) -> Mapping[str, tuple[float, float]]:
    """Cause → χ² of the session with what it changes in a part, and the logarithm of the change.

    Parameters
    ----------
    most : steps of each search
    causes : those that are asked
    """
    rows = part.members[session.recording_of]
    ways = {GAIN_ERROR.id: (_rescale, 1)}
    if not part.of_range:
        ways[ids.SPECIMEN_CHANGED] = _change_film, 1 + (ACTUATION in fit.model.names)
    return {
        cause: _fit_change(session, simulation, fit, rows, part, *way, most=most)
        for cause, way in ways.items()
        if cause in causes
    }


def _fit_change(
    session: Session,
    simulation: Simulation,
    fit: PlainFit,
    rows: Bool,
    part: _Part,
    change: Change,
    free: int,
    *,
    most: int,
) -> tuple[float, float]:
    """χ² of the session with a change in some rows, with what a second number that says it costs; and the logarithm of the change, of a film
    that of its springs.

    Parameters
    ----------
    free : numbers that say what changed
    most : steps of the search
    """
    about = simulation.about(fit.model.physical(fit.theta))

    def residuals(several: Float) -> Float:
        found = []
        for x in several:
            before = about.predict_several(fit.model, x[None, :-free])[0]
            after = change(session, about, fit, x[None, :-free], x[-free:])[0]
            data = session.whiten(session.value - np.where(rows, after, before))
            found.append(np.concatenate([data, compute_deviations(fit.model, x[:-free])]))
        return np.array(found)

    low, high = make_bounds(fit.model)
    start = fit.theta.copy()
    for i, name in enumerate(fit.model.names):
        start[i] += part.offsets[0] if name.startswith("log k") else part.offsets[1] if name == ACTUATION else 0.0
    furthest = np.full(free, _LARGEST)
    start = np.concatenate([np.clip(start, low, high), np.full(free, part.step)])
    found = minimise(residuals, start, np.append(low, -furthest), np.append(high, furthest), most=most)
    # Of two changes that explain as much the one with fewer numbers is the likelier (Schwarz 1978).
    spared = (free - 1) * float(np.log(max(session.size, 2)))
    return count_chi2(session, found.residual) + spared, float(found.x[-free])
