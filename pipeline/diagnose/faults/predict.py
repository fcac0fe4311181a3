"""What a recording would show with a fault, from a film and a rig that the others agree on, and how well it shows that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from pipeline.diagnose.faults.agreement import agrees
from pipeline.diagnose.faults.fitted import fit_session
from pipeline.diagnose.faults.undo import RESPONSES, follow_block, scale_of, turn, turned
from pipeline.diagnose.features.kinds import (
    AMPLIFIER,
    CAPACITANCE,
    CYCLIC_CAPACITANCE,
    REST_HUM,
    SENSED,
    SPHS_RESPONSE,
)
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.search.plain_fit import PlainFit, carry_entries, make_bounds
from pipeline.diagnose.simulation.effects import NONE, Effect, View
from pipeline.diagnose.simulation.families import dynamic, film_at, rig_of
from pipeline.diagnose.simulation.parameters import ACTUATION, PER_DISPLACEMENT, PER_FORCE, BaseModel, Physical
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import find_marginal_root, minimise
from schemas.arrays import Bool, Complex, Float
from schemas.errors import NotIdentifiableError
from schemas.protocols import ELECTRICAL, MECHANICAL

_OTHER_FILMS = (0.1, 10.0)
"""Least and largest stiffness of another film over that of the others at which its search begins."""
_OTHER_CLAMPS = (1.0, 0.4, 0.7, 1.4, 2.5)
"""Masses of another rig's clamp over that of the others at which its search begins."""
_ANY_RIG = 1e3
"""Standard deviations of its file within which another rig's constants are searched: as good as any."""
_STRIDE = 50.0
"""Standard deviations of its file in which those constants are searched as ones: they are as far as that from it."""
_FAR = 30.0
"""How far an entry of it may be from that of the others, in logarithms."""
_ANY_ACTUATION = float(np.log(1000.0))
"""Standard deviation of an actuation of which no sizes say anything, in logarithms: of units, a thousandfold is one step."""
_STEPS = 20
"""Steps of that search at most."""
_DIFFERENCE = 1e-4
"""Step of an entry by which slopes are taken."""


@dataclass(frozen=True)
class StretchedModel(BaseModel):
    """A plain model whose recordings claim `stretch` times the time that has passed.

    A response at a claimed frequency f is the true one at `stretch` × f: relaxation times and dampers grow by the
    factor, masses by its square.
    """

    stretch: float = 1.0

    def physical(self, theta: Float) -> Physical:
        """θ (P,) in physical terms, by the claimed clock."""
        true, c = super().physical(theta), self.stretch
        film = replace(true.film, tau=tuple(c * t for t in true.film.tau), c_inf=c * true.film.c_inf)
        rigs = tuple(replace(r, mass=c**2 * r.mass, extra=c**2 * r.extra, damping=c * r.damping) for r in true.rigs)
        return replace(true, film=film, rigs=rigs)


def stretch_model(model: BaseModel, stretch: float) -> StretchedModel:
    """The model by a clock that claims `stretch` times the time."""
    return StretchedModel(**{f.name: getattr(model, f.name) for f in fields(BaseModel)}, stretch=stretch)


def expect_actuation(fit: PlainFit, session: Session) -> PlainFit:
    """The fit of recordings none of which is under voltage, with the actuation as sizes and permittivity have it: a test under voltage that
    was left out of it is judged by that.

    Parameters
    ----------
    fit : returned as it is where it knows the actuation
    session : with the tests under voltage, where there are any
    """
    entry = next((e for e in session.base_model(fit.model.arms).entries if e.name == ACTUATION), None)
    if entry is None or ACTUATION in fit.model.names:
        return fit
    entry = replace(entry, sd=min(entry.sd, _ANY_ACTUATION))
    known = fit.solution.jacobian
    jacobian = np.zeros((known.shape[0] + 1, known.shape[1] + 1))
    jacobian[:-1, :-1], jacobian[-1, -1] = known, 1 / entry.sd
    theta, residual = np.append(fit.theta, entry.mean), np.append(fit.solution.residual, 0.0)
    solution = replace(fit.solution, x=theta, residual=residual, jacobian=jacobian)
    return replace(fit, model=replace(fit.model, entries=(*fit.model.entries, entry)), theta=theta, solution=solution)


def _list_unknown(model: BaseModel) -> tuple[str, ...]:
    """Kinds of features that depend on what a fit without such features knows nothing of."""
    under_voltage = () if PER_FORCE in model.names else tuple(SENSED)
    return under_voltage if PER_DISPLACEMENT in model.names else (*under_voltage, CYCLIC_CAPACITANCE)


@dataclass(frozen=True)
class Prediction:
    """Features (n,) of a recording, and their slopes (n, P) by the entries of θ; neither is whitened."""

    value: Float
    slope: Float


@dataclass(frozen=True)
class Suspect:
    """One recording of a session, or several of one protocol, beside the film and the rig that the others agree on.

    Parameters
    ----------
    session : with this recording among them
    number : of the recording, or of the first of several
    own : this recording alone, or these
    rig : number in the fit of the rig that it is simulated on
    simulation : of it
    fit : of the others; its covariance is how well they know what the recording should show
    """

    session: Session
    number: int
    own: Session
    rig: int
    simulation: Simulation
    fit: PlainFit

    @classmethod
    def of(cls, session: Session, numbers: Sequence[int], fit: PlainFit, rig: int) -> Suspect:
        """The suspect with that number, or those of one protocol, on the rig with the number `rig` in the fit.

        With what shows the film; where there is nothing of that, with what there is.
        """
        fit = expect_actuation(fit, session)
        theirs = [p.recording in numbers for p in session.places]
        silent = {REST_HUM, *AMPLIFIER, *_list_unknown(fit.model)}
        shows = [own and p.block.kind not in silent for own, p in zip(theirs, session.places, strict=True)]
        own = session.part(shows if any(shows) else theirs)
        states = replace(own.states, rig=np.full_like(own.states.rig, rig))
        on_rig = replace(own, rig=np.full_like(own.rig, rig), states=states)
        return cls(session, numbers[0], own, rig, Simulation(on_rig), fit)

    @property
    def size(self) -> int:
        """Number of its features."""
        return self.own.size

    @property
    def is_electrical(self) -> bool:
        """Whether it is a test under voltage."""
        return self.own.recordings[self.number].loading == ELECTRICAL

    @cached_property
    def sound(self) -> Prediction:
        """What it would show without a fault."""
        return self._simulate(self.fit.model, lambda _: NONE)

    def scale(self, factors: dict[str, float]) -> Prediction:
        """What it would show with samples of some channels multiplied by factors."""
        parts = [np.full(p.block.size, scale_of(p.block.kind, self.is_electrical, factors)) for p in self.own.places]
        factor = np.concatenate(parts)
        return Prediction(factor * self.sound.value, factor[:, None] * self.sound.slope)

    def delay(self, delay_s: float, drift: float) -> Prediction:
        """What it would show with its output stamped later, by a delay and by a share of the time since its start."""
        late = Effect(force=(lambda view: np.exp(-2j * np.pi * view.frequency_hz * delay_s),))
        theta = self.fit.theta
        value = self.sound.value if delay_s == 0 else self.simulation.predict(self.fit.model, theta, late)
        value, slope = value.copy(), self.sound.slope.copy()
        for p in self.own.places:
            if p.block.kind in RESPONSES:
                own = slice(p.first, p.stop)
                value[own] = turned(value[own], turn(p.block, 0.0, drift))
                slope[own] = turned(slope[own].T, turn(p.block, delay_s, drift)).T
        return Prediction(value, slope)

    def follow_drift(self, drift: float) -> Prediction:
        """What it would show with its output stamped later by a share of the time, its functionals included."""
        on_rig = self.simulation.session
        places = tuple(
            p
            if p.block.kind == SPHS_RESPONSE
            else replace(p, block=follow_block(p.block, self.own.recordings[p.recording].nodes, 0.0, drift))
            for p in on_rig.places
        )
        followed = replace(self, simulation=Simulation(replace(on_rig, places=places)))
        found = followed._simulate(self.fit.model, lambda _: NONE)
        for p in self.own.places:
            if p.block.kind == SPHS_RESPONSE:
                own, factor = slice(p.first, p.stop), turn(p.block, 0.0, drift)
                found.value[own] = turned(found.value[own], factor)
                found.slope[own] = turned(found.slope[own].T, factor).T
        return found

    def stretch(self, factor: float) -> Prediction:
        """What it would show by a clock that claims `factor` times the time."""
        return self._simulate(stretch_model(self.fit.model, factor), lambda _: NONE)

    def swap(self) -> Prediction | None:
        """What it would show with force and displacement in each other's place; None of tests under voltage."""
        if self.own.recordings[self.number].loading != MECHANICAL:
            return None
        found = self._simulate(self.fit.model, lambda physical: _swap(physical, self.rig))
        value, slope = found.value.copy(), found.slope.copy()
        for p in self.own.places:
            if p.block.kind in CAPACITANCE:  # of what is no displacement: it says nothing
                value[p.first : p.stop], slope[p.first : p.stop] = p.block.value, 0.0
        return Prediction(value, slope)

    def _simulate(self, model: BaseModel, effect: Callable[[Physical], Effect]) -> Prediction:
        theta = self.fit.theta
        moved = theta + np.concatenate([np.zeros((1, theta.size)), _DIFFERENCE * np.eye(theta.size)])
        rows = np.array([self.simulation.predict(model, x, effect(model.physical(x))) for x in moved])
        return Prediction(rows[0], (rows[1:] - rows[0]).T / _DIFFERENCE)

    def compute_chi2(self, prediction: Prediction) -> float:
        """χ² of the recording against a prediction as well as the others make it: eᵀ (I + J C Jᵀ)⁻¹ e, whitened."""
        e = self.own.whiten(self.own.value - prediction.value)
        j = self.own.whiten(prediction.slope)
        if not (np.isfinite(e).all() and np.isfinite(j).all()):
            return float("inf")
        known = self.fit.solution.information
        scale = np.sqrt(np.diag(known))
        shared = j / scale
        inner = known / np.outer(scale, scale) + shared.T @ shared
        along = shared.T @ e
        return max(float(e @ e - along @ np.linalg.solve(inner, along)), 0.0)

    def measure_scale(self, prediction: Prediction) -> float:
        """The recording's features over those predicted: the factor with which these come nearest; 0 where no response is predicted at all,
        and 1 where there are no features."""
        if not self.size:
            return 1.0
        y, f = self.own.whiten(self.own.value), self.own.whiten(prediction.value)
        power = float(f @ f)
        return float(y @ f) / power if power > 0 else 0.0

    @cached_property
    def own_film_chi2(self) -> float:
        """χ² with a film of its own on the rig of the others."""
        is_film = np.arange(self.fit.theta.size) < self.fit.model.film.stop
        ways = np.eye(is_film.size)[is_film | self._is_actuation]
        found = self._fit_film(ways)
        if agrees(found / max(self.size, 1), self.sound_chi2 / max(self.size, 1)):
            return found
        # A film of other relaxation times lies beyond what a search from that of the others reaches.
        start = self._start_alone()
        return (
            found if start is None else min(found, self._fit_moved(ways, [ways @ start], make_bounds(self.fit.model)))
        )

    def _start_alone(self) -> Float | None:
        """(P,) how far the entries of the fit are from where the recording by itself has them; None where it cannot be asked by itself."""
        numbers = sorted({p.recording for p in self.own.places})
        try:
            _, _, alone = fit_session([self.session.recordings[n] for n in numbers])
        except NotIdentifiableError:
            return None
        theta = self.fit.theta.copy()
        carry_entries(alone, self.fit.model, theta)
        return theta - self.fit.theta

    @cached_property
    def scaled_film_chi2(self) -> float:
        """χ² with the film of the others, softer or stiffer by one factor."""
        return self._fit_film((self._springs | self._is_actuation).astype(float)[None])

    @cached_property
    def own_rig_chi2(self) -> float:
        """χ² on a rig of its own, with the film of the others."""
        model, theta = self.fit.model, self.fit.theta
        is_rig = np.array([name.startswith(f"rig {self.rig} ") for name in model.names])
        clamps = [(model.with_clamps(theta, ratio) - theta)[is_rig] / _STRIDE for ratio in _OTHER_CLAMPS]
        low, high = (
            np.where(is_rig, side * _ANY_RIG, bound) for side, bound in zip((-1, 1), make_bounds(model), strict=True)
        )
        return self._fit_moved(_STRIDE * np.eye(is_rig.size)[is_rig], clamps, (low, high))

    @cached_property
    def _springs(self) -> Bool:
        return np.array([name.startswith("log k") for name in self.fit.model.names])

    @cached_property
    def _is_actuation(self) -> Bool:
        return np.array([name == ACTUATION for name in self.fit.model.names])

    def _fit_film(self, ways: Float) -> float:
        """χ² with the film moved along some ways (w, P) by any amount."""
        size = float(np.log(np.clip(abs(self.measure_scale(self.sound)), *_OTHER_FILMS)))
        along = (ways @ self._springs > 0).astype(float)
        return self._fit_moved(ways, [0.0 * along, size * along], make_bounds(self.fit.model))

    def _fit_moved(self, ways: Float, starts: Sequence[Float], bounds: tuple[Float, Float]) -> float:
        """χ² with entries moved along some ways (w, P) by any amount within bounds (P,), and along the others as far as these are known.

        Parameters
        ----------
        starts : (w,) amounts each at which the search begins
        """
        model, theta = self.fit.model, self.fit.theta
        beside = ~(ways != 0).any(axis=0)
        known = find_marginal_root(self.fit.solution.information, beside)
        every = np.concatenate([ways, np.eye(theta.size)[beside]])

        def residuals(several: Float) -> Float:
            moved = np.clip(theta + several @ every, *bounds)
            made = self.simulation.predict_several(model, moved)
            data = self.own.whiten((self.own.value - made).T).T
            return np.concatenate([data, (moved - theta)[:, beside] @ known.T], axis=1)

        far = np.full(len(every), max(_FAR, *(2 * float(np.abs(start).max(initial=0.0)) for start in starts)))
        begins = [np.concatenate([start, np.zeros(beside.sum())]) for start in starts]
        return min(minimise(residuals, begin, -far, far, most=_STEPS).chi2 for begin in begins)

    @cached_property
    def sound_chi2(self) -> float:
        """χ² without a fault."""
        return self.compute_chi2(self.sound)

    def temper(self, chi2: float) -> float:
        """−2 log likelihood of a χ², with every form wrong by a share of the misfit that asks for it."""
        excess = max(self.sound_chi2 / max(self.size, 1) - 1, 0.0)
        variance = 1 + RULES.fault.form_error**2 * excess
        return chi2 / variance + self.size * float(np.log(variance))


def _swap(physical: Physical, number: int) -> Effect:
    """1/G in place of G = F/x."""

    def inverse(view: View) -> Complex:
        rig = rig_of(physical, number, NONE)
        k = film_at(physical, NONE, view).k
        return np.asarray(1 / rig.mechanical(k, dynamic(rig, view, NONE, k)) ** 2)

    return Effect(force=(inverse,))
