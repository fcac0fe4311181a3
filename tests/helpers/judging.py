"""Judging diagnoses against the truth: one session made, reduced, diagnosed and compared. For the tests and for the study.

    case = Case(seed=7, size="compact", effects=(("cyclic_softening", 3.0),))   # at 3 × the smallest detectable severity
    judge(case)                                                                 # → Judgement

Severities are multiples of the smallest detectable one: of what the diagnosis of the specimen's own clean session says for
causes that it knows, of what its features show of the others, and of those that begin at a load: there severities are counted from
where they begin, and a per cent in that is many in what they do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from pipeline.diagnose.diagnosis import diagnose
from pipeline.diagnose.features.kinds import REST_HUM, FeatureBlock
from pipeline.diagnose.features.reduce import reduce
from pipeline.diagnose.report import choose_film, find_main_key
from pipeline.diagnose.results import AMBIGUOUS, NAMED, NONE, Diagnosis, HeldOut, Predicted
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit, orthonormalise
from pipeline.diagnose.search.plain_fit import fit_plain, make_bounds
from pipeline.diagnose.simulation.hum import with_hum
from pipeline.diagnose.simulation.session import Place
from pipeline.diagnose.simulation.session import Session as FeatureSession
from pipeline.diagnose.simulation.session import make_session as session_of
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.film import RelaxationModel
from pipeline.physics.least_squares import central
from tests.helpers.truth_rig import (
    KINDS,
    Effect,
    Session,
    compact_designs,
    full_designs,
    make_session,
    random_effect,
)

Float = NDArray[np.float64]

DESIGNS = {"compact": compact_designs, "full": full_designs}
INSEPARABLE = (
    frozenset({"thermal_softening", "cyclic_softening"}),
    frozenset({"drive_offset", "field_dependent_permittivity", "wrinkling"}),
    frozenset({"field_dependent_permittivity", "leakage"}),
    frozenset({"missing_relaxation", "power_law_relaxation"}),
)
"""Groups that cannot be told apart without further recordings (temperature; both polarities and more voltages; the current of the film;
a slower decade)."""
_BAND = np.geomspace(1.0, 100.0, 40)
_DETECTABLE = 5.1
"""Length of a trace, in standard deviations of the noise, that is found with 80 % probability at the level of the search."""
_FIRST_GUESS, _BEYOND = 0.05, 2.0
_MOST_ROUNDS, _CLOSE, _MOST_STEP = 10, 0.1, (0.03, 30.0)
_NOISE, _FEW = 3.0, 10.0
"""Mean square in units of the noise, and more of it for few values, that noise explains."""


@dataclass(frozen=True)
class Case:
    """A session to be diagnosed: effects with multiples of their smallest detectable severity, shapes drawn by the seed."""

    seed: int
    size: str = "compact"
    effects: tuple[tuple[str, float], ...] = ()
    material: str | None = None


@dataclass(frozen=True)
class Judgement:
    """What was hidden and what was said.

    hidden : ids; multiples, severities in the kinds' keys (NaN: not detectable on this specimen, nothing was hidden)
    verdict, named, possible : of the diagnosis
    covered : whether the 90 % interval of the first effect's severity holds the truth; None where not defined
    before, after, size : held-out mean square error of both models against the noise-free truth in units of the noise, and the
        number of features; NaN without
    bias : largest change of the plain film's parameters by what is hidden, from the specimen's clean session with the same noise, in
        standard deviations
    curve_before, curve_after : mean relative error of k(jω) over 1–100 Hz of the plain and of the extended film
    apart_before, apart_after : largest deviation of their parameters from the truth, in standard deviations of the plain film's; NaN
        where the truth has another number of arms
    off : deviation of that severity from the truth in standard deviations; NaN where not defined
    split : whether the recording that an ambiguous diagnosis proposes, made and diagnosed with the others, leaves one cause, the
        right one; False where it proposes none, None where the diagnosis is not ambiguous
    proposed : whether the diagnosis proposes a recording
    """

    case: Case
    severities: tuple[float, ...]
    verdict: str
    named: tuple[str, ...]
    possible: tuple[str, ...]
    covered: bool | None
    before: float
    after: float
    size: int
    bias: float
    curve_before: float
    curve_after: float
    explained: float
    p_value: float
    left_p_value: float = float("nan")
    gain: float = float("nan")
    off: float = float("nan")
    split: bool | None = None
    proposed: bool = False
    apart_before: float = float("nan")
    apart_after: float = float("nan")

    @property
    def nearer(self) -> bool:
        """Whether the extended film is nearer to the truth than the plain one, in what its bias is told by."""
        if np.isnan(self.apart_before) or np.isnan(self.apart_after):
            return self.curve_after < self.curve_before
        return self.apart_after < self.apart_before

    @property
    def hidden(self) -> tuple[str, ...]:
        return tuple(id for id, _ in self.case.effects)

    @property
    def found(self) -> bool:
        return self.verdict != NONE

    @property
    def first(self) -> str:
        """The first cause named; the verdict where none is."""
        return self.named[0] if self.verdict in ("named", "ambiguous") and self.named else self.verdict


def observe(session: Session) -> Diagnosis:
    """Diagnosis of a session of the truth rig."""
    return diagnose([reduce(recording) for recording in session.recordings])


def made(case: Case, effects: tuple[Effect, ...]) -> Session:
    return make_session(case.seed, DESIGNS[case.size](), effects, material=case.material)


@lru_cache(maxsize=4)
def clean(seed: int, size: str, material: str | None = None) -> Diagnosis:
    """Diagnosis of the specimen's session with nothing hidden."""
    case = Case(seed, size, (), material)
    return observe(made(case, ()))


def effect_at(
    id: str, multiple: float, smallest: Mapping[str, Mapping[str, float]], rng: np.random.Generator, case: Case
) -> Effect | None:
    """A random effect at a multiple of the smallest detectable severity; None where the session cannot show it.

    What a diagnosis says of a cause that it knows holds for its usual form. Of other forms, of causes that begin at a load, and of
    causes that it does not know, the features themselves tell.
    """
    kind = KINDS[id]
    drawn, sign = _drawn(id, rng)
    usual = all(
        drawn.shape.get(name, default) == default for name, default in kind.shape.items() if isinstance(default, str)
    )
    if kind.listed and usual and not kind.onset:
        if id not in smallest:
            return None
        values = smallest[id]
        least = values[kind.key if kind.key in values else next(iter(values))]
    else:
        found = smallest_of(case, drawn)
        if found is None:
            return None
        least = found
    return replace(drawn, severity=sign * multiple * least)


def _drawn(id: str, rng: np.random.Generator) -> tuple[Effect, float]:
    """A random effect of usual severity, and the sign that it is to have."""
    drawn = random_effect(id, KINDS[id].typical, rng)
    return drawn, -1.0 if KINDS[id].signed and rng.random() < 0.5 else 1.0


def _drawing(case: Case) -> np.random.Generator:
    return np.random.default_rng([case.seed, len(case.effects), *(sum(map(ord, id)) for id, _ in case.effects)])


def hidden_in(judgement: Judgement) -> tuple[Effect, ...]:
    """What was hidden in a session that has been judged: shapes are drawn by the seed, severities were found."""
    rng = _drawing(judgement.case)
    drawn = [_drawn(id, rng)[0] for id, _ in judgement.case.effects]
    return tuple(replace(e, severity=s) for e, s in zip(drawn, judgement.severities, strict=True))


def judged(case: Case) -> tuple[Judgement, ...]:
    """The judgement of a case; with it that of the specimen's clean session, which had to be diagnosed first."""
    return (judge(case),) if not case.effects else (judge(replace(case, effects=())), judge(case))


def judge(case: Case) -> Judgement:
    """Makes, diagnoses and compares a session."""
    rng = _drawing(case)
    if not case.effects:
        diagnosis, session = clean(case.seed, case.size, case.material), None
        return _compared(case, diagnosis, session, ())
    smallest = clean(case.seed, case.size, case.material).smallest_parameters
    effects = [effect_at(id, multiple, smallest, rng, case) for id, multiple in case.effects]
    if any(e is None for e in effects):
        return _nothing(case)
    chosen = tuple(e for e in effects if e is not None)
    session = made(case, chosen)
    return _compared(case, observe(session), session, chosen)


def smallest_of(case: Case, effect: Effect) -> float | None:
    """Severity of an effect at which its trace could just be found; None where that is beyond all reason.

    The trace is the noise-free difference that it makes to what a simulation of the plain film leaves, without what material and rig
    absorb, in units of the noise: what is measured is in the simulation as well. Blocks that only one of them has count for nothing.
    It grows as a power of the severity, of one that is found on the way.
    """
    low, high = (0.0, 0.0), (np.inf, np.inf)
    severity, beyond = _FIRST_GUESS * effect.severity, _BEYOND * KINDS[effect.id].strong
    for _ in range(_MOST_ROUNDS):
        length = _trace(case, replace(effect, severity=severity))
        if abs(length / _DETECTABLE - 1) < _CLOSE:
            break
        if length < _DETECTABLE:
            low = severity, length
        else:
            high = severity, length
        if low[1] > 0 and np.isfinite(high[1]):
            slope = np.log(high[1] / low[1]) / np.log(high[0] / low[0])
            severity = low[0] * (_DETECTABLE / low[1]) ** (1 / slope)
        else:
            severity *= float(np.clip(_DETECTABLE / max(length, 1e-9), *_MOST_STEP))
        if severity > beyond:
            return None
    return float(severity)


def _trace(case: Case, effect: Effect) -> float:
    """Length of an effect's trace in standard deviations of the noise."""
    plain = _plain(case.seed, case.size, case.material)
    session = plain.fit.of.session
    now, in_now = _placed(session, *_left(made(case, (effect,)), plain.fit))
    before, in_before = plain.left
    rest = plain.jacobian.shape[0] - session.size
    shared = np.concatenate([in_now & in_before, np.ones(rest, dtype=bool)])
    seen = np.concatenate([session.whiten(np.where(in_now & in_before, now - before, 0.0)), np.zeros(rest)]) * shared
    jacobian = plain.jacobian * shared[:, None]
    absorb = orthonormalise(jacobian)
    return float(np.linalg.norm(seen - absorb @ (absorb.T @ seen)))


@dataclass(frozen=True)
class _Plain:
    """Plain fit of a clean session; what it leaves of the features without noise, and where it has them, (N,) each; its Jacobian
    (M, P) there."""

    fit: ExtendedFit
    left: tuple[Float, NDArray[np.bool_]]
    jacobian: Float


@lru_cache(maxsize=2)
def _plain(seed: int, size: str, material: str | None) -> _Plain:
    truth = made(Case(seed, size, (), material), ())
    session = with_hum(session_of([reduce(recording) for recording in truth.recordings]))
    simulation = Simulation(session)
    fitted = fit_plain(session, simulation)
    of = Extended(session, simulation, fitted.model, (), np.ones(session.size))
    fit = of.refine(of.fit(fitted.theta, most=3))
    silent, left = _left(truth, fit)
    without_noise = Simulation(silent)

    def whitened(thetas: Float) -> Float:
        found = without_noise.predict_several(of.model, thetas)
        return np.array([session.whiten(-_placed(session, silent, values)[0]) for values in found])

    # What is measured of the drive has noise as well, and with it the simulation: what absorbs is asked without.
    jacobian = fit.solution.jacobian.copy()
    jacobian[: session.size] = central(whitened, fit.theta, *make_bounds(of.model))
    return _Plain(fit, _placed(session, silent, left), jacobian)


def _left(truth: Session, fit: ExtendedFit) -> tuple[FeatureSession, Float]:
    """The session without noise, and what a fit of the plain model leaves of it, (N′,)."""
    silent = session_of([reduce(recording) for recording in truth.noise_free], fit.of.session.laws)
    return silent, silent.value - Simulation(silent).predict(fit.of.model, fit.theta)


def _placed(session: FeatureSession, other: FeatureSession, values: Float) -> tuple[Float, NDArray[np.bool_]]:
    """Values (N′,) of another session where this one has the same blocks, and which those are, (N,) each; mains at rest, which are
    a score of the noise, left out."""
    blocks = {key: values[p.first : p.stop] for p, key in _keys(other) if p.block.kind != REST_HUM}
    placed, known = np.zeros(session.size), np.zeros(session.size, dtype=bool)
    for p, key in _keys(session):
        own = slice(p.first, p.stop)
        if key in blocks and blocks[key].shape == (p.block.size,):
            placed[own], known[own] = blocks[key], True
    return placed, known


def _keys(session: FeatureSession) -> list[tuple[Place, str]]:
    return [(p, _key(session.recordings[p.recording].recording_id, p.block)) for p in session.places]


def noise_free(truth: Session) -> dict[str, Float]:
    """Features of the recordings without noise, block by block.

    Where rest ends and which samples a block takes is found in the data. A block that came out so different without noise that
    the noise does not explain it is another one, and left out.
    """
    session = session_of([reduce(recording) for recording in truth.recordings])
    true = {_key(r.metadata.recording_id, b): b.value for r in truth.noise_free for b in reduce(r).blocks}
    found = {}
    for p, key in _keys(session):
        value = true.get(key)
        if value is None or value.shape != p.block.value.shape:
            continue
        apart = float(np.mean(((p.block.value - value) / session.sd[p.first : p.stop]) ** 2))
        if apart < _NOISE + _FEW / value.size:
            found[key] = value
    return found


def _key(recording_id: str, block: FeatureBlock | Predicted) -> str:
    """A block's name without the measured level in it, which noise moves."""
    return f"{recording_id}: {block.kind}: {block.label.partition(' at ')[0]}"


def _held_out(held: HeldOut, truth: Session) -> tuple[float, float, int]:
    """Mean squares of both models' held-out errors against the truth in units of the noise, and the number of features."""
    true = noise_free(truth)
    before = after = 0.0
    size = 0
    for p in held.predicted:
        value = true.get(_key(p.recording_id, p))
        if value is not None and value.size == p.plain.size:
            before += float(np.sum(((p.plain - value) / p.sd) ** 2))
            after += float(np.sum(((p.extended - value) / p.sd) ** 2))
            size += value.size
    return before / max(size, 1), after / max(size, 1), size


def _compared(case: Case, d: Diagnosis, session: Session | None, effects: tuple[Effect, ...]) -> Judgement:
    bias = before = after = float("nan")
    apart = [float("nan")] * 2
    covered, off, split = None, float("nan"), None
    if session is not None:
        film = session.truth.specimen.film
        truth = film.stiffness(_BAND)
        before, after = (
            float(np.mean(np.abs(f.stiffness(_BAND) - truth) / np.abs(truth))) for f in (d.plain_film, choose_film(d))
        )
        bias = _bias(d, clean(case.seed, case.size, case.material))
        apart = [_apart(d, f, film) for f in (d.plain_film, choose_film(d))]
        covered, off = _covered(d, session, effects)
        split = _split(d, session, effects)
    error, left, size = float("nan"), float("nan"), 0
    if session is not None and d.held_out is not None:
        error, left, size = _held_out(d.held_out, session)
    return Judgement(
        case=case,
        severities=tuple(e.severity for e in effects),
        verdict=d.verdict,
        named=d.mechanisms,
        possible=d.also_possible,
        covered=covered,
        before=error,
        after=left,
        size=size,
        bias=bias,
        curve_before=before,
        curve_after=after,
        explained=d.explained,
        p_value=d.p_value,
        left_p_value=d.left_p_value,
        gain=float("nan") if d.held_out is None else d.held_out.gain,
        off=off,
        split=split,
        proposed=d.next_recording is not None,
        apart_before=apart[0],
        apart_after=apart[1],
    )


def _bias(d: Diagnosis, without: Diagnosis) -> float:
    """Largest difference of the plain film's parameters with and without an effect, in standard deviations; NaN where not defined."""
    return _apart(d, d.plain_film, without.plain_film)


def _apart(d: Diagnosis, one: RelaxationModel, other: RelaxationModel) -> float:
    """Largest difference of two films' parameters in standard deviations of the plain one; NaN for other numbers of arms."""
    if d.extension is None or not len(one.k) == len(other.k) == len(d.plain_film.k):
        return float("nan")
    found, expected = (np.array([film.k0, *film.k, *film.tau]) for film in (one, other))
    return float(np.max(np.abs(found - expected) / np.array(d.extension.plain_film_sd)))


def _covered(d: Diagnosis, session: Session, effects: tuple[Effect, ...]) -> tuple[bool | None, float]:
    """Whether the 90 % interval of the first effect's severity holds the truth, and how many standard deviations it is off.

    None and NaN where its form does not define it, and where it is seen in another channel.
    """
    id = effects[0].id
    if not KINDS[id].exact or d.extension is None or id not in d.extension.severities:
        return None, float("nan")
    channel = session.truth.equivalent[id].get("channel", "")
    if not d.extension.variants[id].startswith(str(channel)):
        return None, float("nan")
    estimates = d.extension.severities[id]
    key = find_main_key(id, estimates)
    said = session.truth.equivalent[id].get(key)
    if not isinstance(said, int | float):
        return None, float("nan")
    found = estimates[key]
    return bool(found.lower <= said <= found.upper), float((found.value - said) / found.sd)


def _split(d: Diagnosis, session: Session, effects: tuple[Effect, ...]) -> bool | None:
    """Whether the proposed recording leaves the right causes alone."""
    if d.verdict != AMBIGUOUS:
        return None
    if d.next_recording is None:
        return False
    whole = ("repeats", "periods", "cycles")
    designs = [{k: int(v) if k in whole else v for k, v in design.items()} for design in d.next_recording.designs]
    again = observe(session.extended(*designs))
    return again.verdict == NAMED and set(again.mechanisms) == {e.id for e in effects}


def _nothing(case: Case) -> Judgement:
    nan = float("nan")
    return Judgement(case, (), "not detectable", (), (), None, nan, nan, 0, nan, nan, nan, nan, nan)
