"""What no listed mechanism does, in general terms: quantities of the simulation that are left free where no law says
how.

A listed mechanism that stands for an unlisted one leaves what it cannot follow: a stiffness that differs from recording
to recording, a bend of the force over strain of any shape, a resonance that is not the clamp's. Smooth patterns of the
residual hardly see that, spread over all recordings as it is; a few free numbers in the stage where it acts do. Of
several courses of which one at a time is likely the best is taken, and its probability multiplied by their number. What
film, rig and the mechanisms in the model absorb is taken off, so that the sum of squares of the scores is χ² under the
null.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.extended_model import Extended, ExtendedFit
from pipeline.diagnose.search.patterns import compute_quadratic
from pipeline.diagnose.search.screen import make_absorbed_basis, project_out
from pipeline.diagnose.simulation.effects import Course, Effect, Film, Reading, View
from pipeline.diagnose.simulation.session import Session
from schemas.arrays import Complex, Float

_STEP = 1e-4
"""Size of the effects by which features are differentiated."""
_KNOTS_HZ = np.geomspace(0.01, 160.0, 15), np.geomspace(5.0, 160.0, 26)
"""Frequencies at which the stiffness is free: few over all tests, and many over sweeps, Hz."""
_CHARGING_S = (0.0, 0.2, 1.5, 4.0, 12.0)
"""Times in which what follows the voltage charges, s."""
_PERIODS_S = np.geomspace(600.0, 7200.0, 16)
"""Periods of a stiffness that comes and goes, s."""
_RATE_S = 0.1
"""Time by which strain rates are made strains, s."""


@dataclass(frozen=True)
class FreeQuantity:
    """One quantity left free beside a model.

    Parameters
    ----------
    text : what differs, in words
    statistic, degrees_of_freedom : χ² under the null
    tolerated : share of what it and the causes explain together that it may have where the causes are right
    effects, values : one effect of size `_STEP` for each free number, and the best value of each
    forms : number of courses of which this is the best
    """

    text: str
    statistic: float
    degrees_of_freedom: int
    tolerated: float
    effects: tuple[Effect, ...] = ()
    values: tuple[float, ...] = ()
    forms: int = 1

    @property
    def p_value(self) -> float:
        """Probability under the null, over all courses that were looked at."""
        return min(1.0, self.forms * float(chdtrc(max(self.degrees_of_freedom, 1), self.statistic)))

    @property
    def excess(self) -> float:
        """χ² that it explains beyond what its free numbers take of the noise."""
        return self.statistic - self.degrees_of_freedom

    @property
    def evidence(self) -> float:
        """The same, less what choosing among its courses takes of the noise."""
        return self.excess - 2 * float(np.log(self.forms))

    def compute_change(self, of: Extended, x: Float) -> Float:
        """(N,) what it would change in features at its best values, to first order.

        Parameters
        ----------
        of, x : the model with features, and its entries (P,)
        """
        return (
            np.asarray(self.values) @ _differentiate(of, x, self.effects) if self.effects else np.zeros(of.session.size)
        )


def fit_free_quantities(fit: ExtendedFit, among: Collection[str] | None = None) -> tuple[FreeQuantity, ...]:
    """Every quantity left free beside a fitted model, the least probable first.

    Parameters
    ----------
    fit : the model at its optimum
    among : texts of those that are asked; None: all
    """
    of, session = fit.of, fit.of.session
    absorbed = make_absorbed_basis(fit)
    found = []
    for free in _propose_quantities(session):
        if not free.effects or (among is not None and free.text not in among):
            continue
        rows = _differentiate(of, fit.x, free.effects)
        seen = of.weight[:, None] * session.whiten(np.nan_to_num(rows).T)
        length = np.linalg.norm(seen, axis=0)
        visible = (length > RULES.doubt.visible) & np.isfinite(rows).all(axis=1)
        if not visible.any():
            continue
        scale = np.maximum(length, RULES.doubt.visible)
        gram, score = project_out(fit, seen / scale, absorbed)
        at_once = free.at_once or visible.size
        forms = [i[visible[i]] for i in np.arange(visible.size).reshape(-1, at_once) if visible[i].any()]
        tests = []
        for i in forms:
            statistic, freedom, best = compute_quadratic(gram[np.ix_(i, i)], score[i])
            effects, values = tuple(free.effects[k] for k in i), tuple((best / scale[i]).tolist())
            tests.append(FreeQuantity(free.text, statistic, freedom, free.tolerated, effects, values, len(forms)))
        found.append(min(tests, key=lambda d: d.p_value))
    return tuple(sorted(found, key=lambda d: d.p_value))


def _differentiate(of: Extended, x: Float, effects: Sequence[Effect]) -> Float:
    """(E, N) derivatives of the features by effects of size `_STEP`, beside those of the model."""
    base, own, theta = of.predict(x), of.effect(x), x[: of.model.size]
    return np.array([(of.simulation.predict(of.model, theta, own | effect) - base) / _STEP for effect in effects])


@dataclass(frozen=True)
class _Proposed:
    """A quantity that can be left free.

    Parameters
    ----------
    text : what differs, in words
    effects : one of size `_STEP` for each free number
    at_once : numbers that make one course, of which the best is taken; 0: all are one
    tolerated : share that it may have beside right causes
    """

    text: str
    effects: list[Effect]
    at_once: int = 0
    tolerated: float = RULES.doubt.tolerated


def _propose_quantities(session: Session) -> Iterator[_Proposed]:
    """All quantities that can be left free in a session."""
    spans = _group_recordings(session)
    yield _Proposed(
        "the stiffness differs from recording to recording", [_change_stiffness(_weigh_span(s)) for s in spans]
    )
    yield _Proposed(
        "the stiffness changes for good",
        [_change_stiffness(_weigh_span((t, np.inf))) for t in _choose_moments(session)],
        1,
    )
    yield _Proposed(
        "the stiffness comes and goes over the session",
        [_change_stiffness(_weigh_sine(period, turn)) for period in _PERIODS_S for turn in (0.0, 0.25)],
        2,
    )
    if session.scale.voltage_kv > 0:
        yield _Proposed(
            "the actuation differs from recording to recording", [_change_actuation(_weigh_span(s)) for s in spans]
        )
        ways = [_change_actuation(f) for f in _weigh_voltage(session.scale.voltage_kv)]
        yield _Proposed("the actuation follows the voltage in another way", ways, 1)
    for knots in _KNOTS_HZ:
        yield _Proposed(
            "the stiffness under mechanical tests follows the frequency in another way",
            [_change_stiffness(_weigh_frequency(knots, i, turn)) for i in range(knots.size) for turn in (1.0, 1j)],
            tolerated=RULES.doubt.tolerated_by_frequency,
        )
    if session.scale.strain > 0:
        yield _Proposed(
            "the force follows the strain in another way", [Effect(tension=(t,)) for t in _bend_tension(session)]
        )
    yield _Proposed(
        "the reading follows the force in another way", [Effect(reading=(_bend_reading(power),)) for power in (2, 3)]
    )


def _group_recordings(session: Session) -> list[tuple[float, float]]:
    """Times in the session between the starts of recordings, those of long sessions in groups."""
    groups = np.array_split(session.start_s, min(session.start_s.size, RULES.doubt.most_recordings))
    first = np.array([g[0] for g in groups])
    # What comes after the last recording is none of them.
    edges = np.concatenate([[-np.inf], first[1:] - 1e-3, [session.scale.duration_s + 1.0]])
    return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))


def _choose_moments(session: Session) -> Float:
    """Times in the session between its states, recordings, sweeps and cycles, at which something may have happened."""
    times = np.unique(session.states.session_s)
    between = (times[:-1] + times[1:]) / 2
    chosen = np.unique(np.linspace(0, between.size - 1, min(between.size, RULES.doubt.most_moments)).astype(np.int64))
    return np.asarray(between[chosen], dtype=np.float64)


Weight = Callable[[View], Float | Complex]


def _change_stiffness(weight: Weight) -> Effect:
    """A film that is stiffer by `_STEP` times a weight."""

    def stiffer(film: Film, view: View) -> Film:
        return Film(film.k * (1 + _STEP * weight(view)), film.share)

    return Effect(film=(stiffer,))


def _change_actuation(weight: Weight) -> Effect:
    """An actuation that is stronger by `_STEP` times a weight."""
    return Effect(actuation=(lambda view: 1 + _STEP * weight(view),))


def _weigh_span(span: tuple[float, float]) -> Weight:
    """1 within a span of the session's time."""
    return lambda view: np.asarray((view.session_s >= span[0]) & (view.session_s < span[1]), dtype=np.float64)


def _weigh_sine(period_s: float, turn: float) -> Weight:
    """A sine over the session's time."""
    return lambda view: np.sin(2 * np.pi * (view.session_s / period_s + turn))


def _weigh_voltage(highest_kv: float) -> list[Weight]:
    """Powers of the voltage, at once and as something that charges slowly."""

    def at(power: int, charging_s: float) -> Weight:
        return lambda view: (view.voltage_kv / highest_kv) ** power / (1 + 2j * np.pi * view.frequency_hz * charging_s)

    return [at(power, charging_s) for power in (1, 2, 4) for charging_s in _CHARGING_S]


def _weigh_frequency(knots: Float, number: int, turn: complex) -> Weight:
    """A triangle over the logarithm of the frequency about one of the knots, in mechanical tests."""
    width = float(np.log(knots[1] / knots[0]))

    def weight(view: View) -> Float | Complex:
        if view.test not in ("sweep", "cyclic"):
            return np.zeros((1, 1))
        away = np.abs(np.log(np.maximum(view.frequency_hz, 1e-9) / knots[number])) / width
        return np.asarray(turn * np.maximum(0.0, 1 - away))

    return weight


def _bend_tension(session: Session) -> list[Callable[[Course], Float]]:
    """Powers of the strain, and what goes with its rate: smooth, and with its sign alone, as friction and hysteresis
    do."""
    largest = session.scale.strain

    def force(shape: Callable[[Float, Float], Float]) -> Callable[[Course], Float]:
        def tension(course: Course) -> Float:
            x = course.strain / largest
            rate = np.gradient(x, axis=-1) / np.broadcast_to(course.interval_s, x.shape)
            return np.asarray(
                course.tension + _STEP * course.static * session.scale.length_mm * largest * shape(x, rate)
            )

        return tension

    return [
        force(lambda x, rate: x**2),
        force(lambda x, rate: x**3),
        force(lambda x, rate: x**4),
        force(lambda x, rate: x * rate * _RATE_S),
        force(lambda x, rate: np.tanh(rate / _RATE_S)),
        force(lambda x, rate: np.abs(x) * np.tanh(rate / _RATE_S)),
    ]


def _bend_reading(power: int) -> Callable[[Reading], Float]:
    """A reading that bends with a power of the force."""

    def bent(reading: Reading) -> Float:
        if reading.largest_n <= 0:  # no mechanical test says what a large force is
            return reading.force
        return np.asarray(reading.force + _STEP * reading.largest_n * (reading.force / reading.largest_n) ** power)

    return bent
