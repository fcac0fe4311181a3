"""Which recordings of a session agree with each other: a fit of film and rig that some of them may miss by any amount.

χ² of a recording counts as under Student's t instead of the normal distribution (Lange, Little and Taylor 1989): one that
nothing can bring together with the others loses its weight, whatever is wrong with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from pipeline.diagnose.features.kinds import AMPLIFIER, CHIRP_RESPONSE, CYCLIC_RESPONSE, REST_HUM
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.plain_fit import (
    PlainFit,
    carry_entries,
    compute_residuals,
    fit_from_ladders,
    fit_plain,
    make_bounds,
    measure_roughness,
    refit_plain,
)
from pipeline.diagnose.simulation.parameters import BaseModel
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import minimise
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError

_NU = 4.0
"""Degrees of freedom of Student's t."""
_ROUNDS = 10
"""Rounds of reweighting at most."""
_SETTLED = 1e-4
"""Change of every entry below which the weights are settled."""
LOUDEST = max(RULES.form.louder) ** 2
"""χ² per value that a test leaves where its noise is as loud as it may be over that of its rests."""
_STARTS = 3
"""Sweeps whose own films a fit is begun from."""


@dataclass(frozen=True)
class Agreement:
    """Film and rig that most recordings agree on.

    Parameters
    ----------
    fit : the plain model at their optimum
    chi2, size : (R,) of each recording's features under it, and their number
    outside : (R,) recordings that miss it
    """

    fit: PlainFit
    chi2: Float
    size: Float
    outside: Bool

    @property
    def dispersion(self) -> float:
        """χ² per value of the recordings that agree."""
        inside = ~self.outside
        return float(self.chi2[inside].sum() / max(self.size[inside].sum(), 1.0))


def sum_by_recording(session: Session, misfit: Float) -> tuple[Float, Float]:
    """(R,) χ² and number of values of each recording, of a whitened residual (N,); mains are no matter of the film, and how the amplifier
    follows its command is none of the recording."""
    count, counted = len(session.recordings), _is_asked(session) & (session.kind != REST_HUM)
    chi2 = np.bincount(session.recording_of[counted], misfit[counted] ** 2, count)
    size = np.bincount(session.recording_of[counted], minlength=count)
    return np.asarray(chi2, dtype=np.float64), np.asarray(size, dtype=np.float64)


def count_chi2(session: Session, residual: Float) -> float:
    """χ² of a whitened residual, and of what deviates from the prior, without the amplifier's share, which no fault changes.

    That share may be a million times the rest: what is left of a difference of the two is rounding.

    Parameters
    ----------
    session : with N features
    residual : (N,) or longer, by the deviations from the prior
    """
    beside = float(np.sum(residual[session.size :] ** 2))
    return float(np.sum(residual[: session.size][_is_asked(session)] ** 2)) + beside


def measure_left(session: Session, chi2: float) -> float:
    """χ² per value, of one without the amplifier's share."""
    return chi2 / max(int(_is_asked(session).sum()), 1)


def _is_asked(session: Session) -> Bool:
    """(N,) features that are no matter of the amplifier."""
    return ~np.isin(session.kind, list(AMPLIFIER))


def miss(chi2: Float, size: Float, dispersion: float) -> Bool:
    """(R,) recordings whose χ² is beyond that of the noise, and clearly more per value than that of the others."""
    rules = RULES.fault
    per_value = chi2 / np.maximum(size, 1.0)
    noise = 1 + rules.misses * np.sqrt(2 / np.maximum(size, 1.0))
    return np.asarray((size > 0) & (per_value > noise * rules.misses_ratio * max(dispersion, 1.0)))


def agrees(left: float, before: float) -> bool:
    """Whether χ² per value says that recordings agree, where it was `before` without the fault that they are asked for.

    What is left may be noise that is louder than that of the rests, where it is next to nothing of what was wrong.
    """
    rules = RULES.fault
    return left <= rules.agrees or (left <= LOUDEST and left <= rules.form_error * before)


def find_agreement(session: Session, simulation: Simulation, plain: PlainFit) -> Agreement:
    """The fit that most recordings agree on, from the plain fit; where more than one misses that, from the films of single sweeps and of the
    session without what is roughest as well.
    """
    found = _reweigh(session, simulation, plain)
    if measure_left(session, count_chi2(session, plain.misfit)) > RULES.fault.astray:
        for make_starts in (_fit_sweeps, _fit_without_rough):
            if _find_missing(session, found[0]).sum() <= 1:
                break
            for start in make_starts(session):
                found = min(found, _reweigh(session, simulation, start), key=lambda pair: pair[1])
    chi2, size = sum_by_recording(session, found[0].misfit)
    return Agreement(found[0], chi2, size, _find_missing(session, found[0]))


def _find_missing(session: Session, fit: PlainFit) -> Bool:
    """(R,) recordings that miss a fit by more than the better half of them does."""
    chi2, size = sum_by_recording(session, fit.misfit)
    order = np.argsort(chi2 / np.maximum(size, 1.0))
    best = order[: max(len(order) // 2, 1)]
    return miss(chi2, size, float(chi2[best].sum() / max(size[best].sum(), 1.0)))


def leave_out(session: Session, simulation: Simulation, fit: PlainFit, outside: Bool) -> PlainFit:
    """The plain model fitted to the recordings inside alone, from a fit nearby; `misfit` is that of all."""
    weight = np.where(outside[session.recording_of], 0.0, 1.0)
    about = simulation.about(fit.model.physical(fit.theta))
    priors = int(np.isfinite(fit.model.prior_sd).sum())
    kept = np.concatenate([weight, np.ones(priors)])
    found = minimise(partial(_weigh, session, about, fit.model, kept), fit.theta, *make_bounds(fit.model))
    whole = compute_residuals(session, about, fit.model, found.x[None])[0]
    return PlainFit(fit.model, found.x, found, found.chi2, whole[: session.size])


def _weigh(session: Session, simulation: Simulation, model: BaseModel, weight: Float, several: Float) -> Float:
    """(B, M) weighted residuals and deviations from the prior."""
    return np.asarray(weight * compute_residuals(session, simulation, model, several))


def _reweigh(session: Session, simulation: Simulation, start: PlainFit) -> tuple[PlainFit, float]:
    """The fit with weights by recording, and its cost: −2 log likelihood under Student's t."""
    model, x = start.model, start.theta
    about = simulation.about(model.physical(x))
    low, high = make_bounds(model)
    solution = start.solution
    for _ in range(_ROUNDS):
        residual = compute_residuals(session, about, model, x[None])[0]
        chi2, size = sum_by_recording(session, residual[: session.size])
        weight = np.sqrt((_NU + size) / (_NU + chi2))[session.recording_of]
        whole = np.concatenate([weight, np.ones(residual.size - session.size)])
        solution = minimise(partial(_weigh, session, about, model, whole), x, low, high, most=8)
        moved, x = float(np.abs(solution.x - x).max()), solution.x
        if moved < _SETTLED:
            break
    misfit = compute_residuals(session, about, model, x[None])[0][: session.size]
    chi2, size = sum_by_recording(session, misfit)
    cost = float(np.sum((_NU + size) * np.log1p(chi2 / _NU)))
    return PlainFit(model, x, solution, float(misfit @ misfit), misfit), cost


def _fit_without_rough(session: Session) -> Iterator[PlainFit]:
    """Plain fits without the recording, and without the kind of test, without which the responses are most like those of a film; carried
    over to the whole session."""
    bearing = [p.recording for p in session.places if p.block.kind in (CHIRP_RESPONSE, CYCLIC_RESPONSE)]
    single = [frozenset({number}) for number in dict.fromkeys(bearing)]
    kinds: dict[tuple[str, str], set[int]] = {}
    for number in bearing:
        own = session.recordings[number]
        kinds.setdefault((own.protocol, own.loading), set()).add(number)
    several = [frozenset(numbers) for numbers in kinds.values() if len(numbers) > 1]
    for left_out in (single, several):
        rough = [_measure_roughness_without(session, numbers) for numbers in left_out]
        if not np.isfinite(rough).any():
            continue
        without = left_out[int(np.argmin(rough))]
        rest = session.part([p.recording not in without for p in session.places])
        try:
            yield _carry_over(fit_plain(rest, Simulation(rest)), session)
        except NotIdentifiableError:
            continue


def _measure_roughness_without(session: Session, numbers: frozenset[int]) -> float:
    """Roughness of the responses but those of some recordings; infinite where there are none."""
    try:
        return measure_roughness(session.part([p.recording not in numbers for p in session.places]))
    except NotIdentifiableError:
        return np.inf


def _carry_over(fit: PlainFit, session: Session) -> PlainFit:
    """A fit of a part of a session as a place of the plain model of all of it."""
    model = session.base_model(fit.model.arms)
    theta = model.theta(fit.model.physical(fit.theta).film)
    carry_entries(fit, model, theta)
    return PlainFit(model, theta, fit.solution, np.inf, np.zeros(session.size))


def _fit_sweeps(session: Session) -> Iterator[PlainFit]:
    """Plain fits of single sweeps, carried over to the whole session.

    With all arms that there may be: what is wrong with another recording decides nothing of their number here.
    """
    arms = RULES.plain.orders[-1]
    numbers = list(dict.fromkeys(p.recording for p in session.places if p.block.kind == CHIRP_RESPONSE))
    for number in numbers[:_STARTS]:
        own = session.part([p.recording == number for p in session.places])
        try:
            yield _carry_over(fit_from_ladders(own, Simulation(own), own.base_model(arms)), session)
        except NotIdentifiableError:
            continue


def refit_rest(session: Session, simulation: Simulation, near: PlainFit) -> PlainFit:
    """The plain model of a session that a fit of a larger one is near to, searched anew where that is astray."""
    found = refit_plain(session, simulation, near.model, near.theta)
    if found.chi2 < RULES.plain.sound * session.size:
        return found
    again = fit_plain(session, simulation)
    return again if again.chi2 < found.chi2 else found
