"""Judging diagnoses against the truth: one session made, reduced, diagnosed and compared. For the tests and for the study.

    case = Case(seed=7, size="compact", effects=(("cyclic_softening", 3.0),))   # at 3 × the smallest detectable severity
    judge(case)                                                                 # → Judgement

Severities are multiples of what the specimen's own clean session says is the smallest detectable one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from pipeline.diagnose.diagnosis import diagnose, film_of, main_key
from pipeline.diagnose.reduce import reduce
from pipeline.diagnose.results import NONE, Diagnosis
from tests.hidden_effects.truth import (
    KINDS,
    Effect,
    Session,
    compact_designs,
    full_designs,
    make_session,
    random_effect,
)

DESIGNS = {"compact": compact_designs, "full": full_designs}
INSEPARABLE = (
    frozenset({"thermal_softening", "cyclic_softening"}),
    frozenset({"drive_offset", "field_dependent_permittivity", "wrinkling"}),
    frozenset({"missing_relaxation", "power_law_relaxation"}),
)
"""Groups that cannot be told apart without further recordings (temperature; both polarities and more voltages; a slower decade)."""
_BAND = np.geomspace(1.0, 100.0, 40)


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
    before, after, size : held-out mean squares in units of the noise and their number; NaN without
    bias : largest deviation of the plain film's parameters from the truth in standard deviations
    curve_before, curve_after : mean relative error of k(jω) over 1–100 Hz of the plain and of the extended film
    seconds : of the diagnosis alone
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
    id: str, multiple: float, smallest: Mapping[str, Mapping[str, float]], rng: np.random.Generator
) -> Effect | None:
    """A random effect at a multiple of the smallest detectable severity; None where the session cannot show it."""
    if id not in smallest:
        return None
    values = smallest[id]
    kind = KINDS[id]
    severity = multiple * values[kind.key if kind.key in values else next(iter(values))]
    if kind.signed and rng.random() < 0.5:
        severity = -severity
    return random_effect(id, severity, rng)


def judge(case: Case) -> Judgement:
    """Makes, diagnoses and compares a session."""
    rng = np.random.default_rng([case.seed, len(case.effects), *(sum(map(ord, id)) for id, _ in case.effects)])
    if not case.effects:
        diagnosis, session = clean(case.seed, case.size, case.material), None
        return _compared(case, diagnosis, session, ())
    smallest = clean(case.seed, case.size, case.material).smallest_parameters
    effects = [_hidden(id, multiple, smallest, rng) for id, multiple in case.effects]
    if any(e is None for e in effects):
        return _nothing(case)
    chosen = tuple(e for e in effects if e is not None)
    session = made(case, chosen)
    return _compared(case, observe(session), session, chosen)


def _hidden(
    id: str, multiple: float, smallest: Mapping[str, Mapping[str, float]], rng: np.random.Generator
) -> Effect | None:
    """Listed effects by what is detectable, unlisted ones by shares of their typical severity."""
    if KINDS[id].listed:
        return effect_at(id, multiple, smallest, rng)
    return random_effect(id, multiple * KINDS[id].typical, rng)


def _compared(case: Case, d: Diagnosis, session: Session | None, effects: tuple[Effect, ...]) -> Judgement:
    bias = before = after = float("nan")
    covered = None
    if session is not None:
        film = session.truth.specimen.film
        truth = film.stiffness(_BAND)
        before, after = (
            float(np.mean(np.abs(f.stiffness(_BAND) - truth) / np.abs(truth))) for f in (d.plain_film, film_of(d))
        )
        if d.extension is not None and len(d.plain_film.k) == len(film.k):
            true = np.array([film.k0, *film.k, *film.tau])
            plain = np.array([d.plain_film.k0, *d.plain_film.k, *d.plain_film.tau])
            bias = float(np.max(np.abs(plain - true) / np.array(d.extension.plain_film_sd)))
        covered = _covered(d, session, effects)
    held = d.held_out
    return Judgement(
        case=case,
        severities=tuple(e.severity for e in effects),
        verdict=d.verdict,
        named=d.mechanisms,
        possible=d.also_possible,
        covered=covered,
        before=float("nan") if held is None else held.before**2,
        after=float("nan") if held is None else held.after**2,
        size=0 if held is None else held.size,
        bias=bias,
        curve_before=before,
        curve_after=after,
        explained=d.candidates[0].explained if d.candidates else float("nan"),
        p_value=d.p_value,
    )


def _covered(d: Diagnosis, session: Session, effects: tuple[Effect, ...]) -> bool | None:
    """Whether the 90 % interval of the severity holds the truth, for effects whose form defines it."""
    id = effects[0].id
    if not KINDS[id].exact or d.extension is None or id not in d.extension.severities:
        return None
    estimates = d.extension.severities[id]
    key = main_key(id, estimates)
    said = session.truth.equivalent[id].get(key)
    if not isinstance(said, int | float):
        return None
    return bool(abs(estimates[key].value - said) < 1.645 * estimates[key].sd)


def _nothing(case: Case) -> Judgement:
    nan = float("nan")
    return Judgement(case, (), "not detectable", (), (), None, nan, nan, 0, nan, nan, nan, nan, nan)
