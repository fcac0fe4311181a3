"""The plain model with mechanisms added: one vector of entries for both, its fit, and the evidence for it.

Entries of a mechanism are logarithms where its parameter is searched in the logarithm, else parts of its plausible
range, so that steps and priors mean the same for all. Belongs here: parameters and fits. Which mechanisms are fitted is
in `screen` and `fit_mechanisms`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import takewhile

import numpy as np

from pipeline.diagnose.mechanisms import MECHANISMS, SEVERITY, Mechanism, Parameter
from pipeline.diagnose.mechanisms.drive import DRIVE_LAG, FURTHER, MONITORED
from pipeline.diagnose.search.plain_fit import compute_deviations, make_bounds
from pipeline.diagnose.simulation.effects import NONE, Effect
from pipeline.diagnose.simulation.parameters import BaseModel
from pipeline.diagnose.simulation.session import Session
from pipeline.diagnose.simulation.simulation import Simulation
from pipeline.physics.least_squares import LEAST_DAMPING, Solution, central, minimise
from schemas.arrays import Float

_BEYOND = np.log(20.0)
"""How far a severity is searched beyond its plausible range, which is no limit."""
_SHAPE_BEYOND = np.log(4.0)
"""How far a shape is searched beyond its plausible range."""
_LEAST_DENSITY = 1e-12
"""Least size of a severity in its prior's density."""
_TAILS = 2.0
"""Integral of both tails of that density over the logarithm, where it is 1 within the range."""
_LARGEST_LOG = 600.0
"""An entry that the data do not hold may be anywhere."""


@dataclass(frozen=True)
class Chosen:
    """A mechanism in one of its variants."""

    id: str
    variant: str

    @property
    def mechanism(self) -> Mechanism:
        """The entry of the list."""
        return MECHANISMS[self.id]

    @property
    def is_of_amplifier(self) -> bool:
        """Whether it is the lag of the amplifier, as far as the monitor shows it."""
        return (self.id, self.variant) == (DRIVE_LAG.id, MONITORED)

    @property
    def is_monitored_lag(self) -> bool:
        """Whether it is a lag that the monitor shows, in part at least."""
        return self.id == DRIVE_LAG.id and self.variant in (MONITORED, FURTHER)


@dataclass(frozen=True)
class Coordinate:
    """How a parameter of a mechanism is searched, as an entry x: value = exp(x), `scale` × x, or exp(`scale` × x) − 1.

    Parameters
    ----------
    owner : number of the mechanism in the model
    parameter : what is searched
    """

    owner: int
    parameter: Parameter

    @property
    def logarithmic(self) -> bool:
        """Whether x is the logarithm of the value."""
        return self.parameter.log and not self.parameter.signed

    @property
    def fixed(self) -> bool:
        """Whether it is not searched: it only says in which unit another parameter counts."""
        return self.parameter.low == self.parameter.high

    @property
    def scale(self) -> float:
        """Value of an entry 1, where x is no logarithm."""
        p = self.parameter
        return p.start if p.signed else max(abs(p.low), abs(p.high))

    def value(self, x: float) -> float:
        """The value at an entry."""
        if self.parameter.factor:
            return float(np.expm1(min(self.scale * x, _LARGEST_LOG)))
        return float(np.exp(min(x, _LARGEST_LOG))) if self.logarithmic else self.scale * float(x)

    def entry(self, value: float) -> float:
        """The entry of a value."""
        if self.parameter.factor:
            return float(np.log1p(value)) / self.scale
        return float(np.log(max(value, 1e-300))) if self.logarithmic else value / self.scale

    @property
    def limits(self) -> tuple[float, float]:
        """Least and largest entry: beyond the plausible range, which is no limit, and within the hard limits."""
        p = self.parameter
        if self.fixed:
            return self.entry(p.low), self.entry(p.low)
        beyond = _BEYOND if p.role == SEVERITY else _SHAPE_BEYOND
        if self.logarithmic:
            low, high = np.log(p.low) - beyond, np.log(p.high) + beyond
            if p.role == SEVERITY:
                low -= _BEYOND
            least = np.log(p.least) if p.least > 0 else -np.inf
            return max(low, least), min(high, np.log(p.most))
        if p.signed:
            far = float(np.exp(_BEYOND)) * p.high
            return self.entry(max(-far, p.least if p.least else -far)), self.entry(min(far, p.most))
        room = 0.5 * (p.high - p.low)
        return max(p.low - room, p.least) / self.scale, min(p.high + room, p.most) / self.scale

    @property
    def prior(self) -> tuple[float, float]:
        """Mean and standard deviation of the entry of a shape: its plausible range is two standard deviations wide.
        Severities have none."""
        p = self.parameter
        if p.role == SEVERITY or self.fixed:
            return 0.0, np.inf
        low, high = self.entry(p.low), self.entry(p.high)
        return (low + high) / 2, max((high - low) / 2, 1e-6)

    def log_density(self, x: float) -> float:
        """Logarithm of the prior density of a severity at an entry, either sign alike: uniform in the logarithm over its plausible
        range; below that uniform in the value, above it falling with its square."""
        p = self.parameter
        density = -np.log(np.log(p.high / p.low) + _TAILS)
        if self.logarithmic:
            return float(density - max(np.log(p.low) - float(x), float(x) - np.log(p.high), 0.0))
        # Of a value with a sign the density is over the value itself: constant below the range.
        size = max(abs(float(x)), p.low / self.scale, _LEAST_DENSITY)
        return float(density - np.log(2 * size) - max(np.log(size * self.scale / p.high), 0.0))


@dataclass(frozen=True)
class Extended:
    """A plain model with mechanisms, over a session and its simulation.

    Parameters
    ----------
    session, simulation : what it is fitted to, and by what it predicts
    model : the plain model, P₀ entries θ
    chosen : mechanisms in their variants; none: the plain model
    weight : (N,) of whitened residuals: 1 for the noise alone, smaller where the form may be wrong
    quiet : (G,) sums of squares that are noise in the groups of features of `likelihood`; None: as many as are expected
    """

    session: Session
    simulation: Simulation
    model: BaseModel
    chosen: tuple[Chosen, ...]
    weight: Float
    quiet: Float | None = None

    @property
    def mechanism_ids(self) -> tuple[str, ...]:
        """Ids of the mechanisms, in their order."""
        return tuple(c.id for c in self.chosen)

    @property
    def leaves_film(self) -> bool:
        """Whether none of its mechanisms may have to do with film and rig, which are then as in the plain model."""
        return all(c.is_of_amplifier for c in self.chosen)

    def is_lag(self, number: int) -> bool:
        """Whether one of its mechanisms is a lag of the amplifier, which has nothing to do with film and rig."""
        return self.chosen[number].is_of_amplifier

    @property
    def settled(self) -> int:
        """Entries, from the first on, whose slopes a fit that begins near an optimum need not know anew at every step: film and rig, which
        hardly bend, and a lag of the amplifier before other mechanisms. That is read off command and measured voltage alone, whatever the
        others do.
        """
        first = sum(1 for _ in takewhile(lambda c: c.is_of_amplifier, self.chosen))
        of_lag = sum(c.owner < first for c in self.coordinates) if first < len(self.chosen) else 0
        return self.model.size + of_lag

    @cached_property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """The mechanisms' parameters, (Q,) in the order of the entries after θ."""
        return tuple(
            Coordinate(i, p) for i, c in enumerate(self.chosen) for p in c.mechanism.list_parameters(c.variant)
        )

    @cached_property
    def limits(self) -> tuple[Float, Float]:
        """Least and largest entries, (P,) each; P = P₀ + Q."""
        low, high = make_bounds(self.model)
        own = [c.limits for c in self.coordinates]
        return np.concatenate([low, [a for a, _ in own]]), np.concatenate([high, [b for _, b in own]])

    @cached_property
    def _priors(self) -> tuple[Float, Float]:
        pairs = np.array([c.prior for c in self.coordinates]).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def values(self, x: Float) -> tuple[dict[str, float], ...]:
        """Parameters of each mechanism by name at entries x (P,)."""
        found: list[dict[str, float]] = [{} for _ in self.chosen]
        for c, entry in zip(self.coordinates, x[self.model.size :], strict=True):
            found[c.owner][c.parameter.name] = c.value(entry)
        return tuple(found)

    def make_entries(self, theta: Float, values: Sequence[Mapping[str, float]]) -> Float:
        """(P,) entries from θ and the parameters of each mechanism; parameters not given are at their start."""
        own = [c.entry(float(values[c.owner].get(c.parameter.name, c.parameter.start))) for c in self.coordinates]
        return np.concatenate([theta, own])

    def effect(self, x: Float) -> Effect:
        """What all mechanisms change in the simulation at entries x (P,)."""
        return compose_chosen(self.chosen, self.values(x))

    def predict(self, x: Float) -> Float:
        """(N,) features."""
        return self.simulation.predict(self.model, x[: self.model.size], self.effect(x))

    def predict_several(self, several: Float) -> Float:
        """(B, N) features of several x (B, P)."""
        model, found = self.model.size, np.empty((len(several), self.session.size))
        alike: dict[bytes, list[int]] = {}
        for i, x in enumerate(several):
            alike.setdefault(x[model:].tobytes(), []).append(i)
        for rows in alike.values():
            effect = self.effect(several[rows[0]])
            found[rows] = self.simulation.predict_several(self.model, several[rows, :model], effect)
        return found

    def compute_data_residual(self, x: Float) -> Float:
        """(N,) measured less predicted features at x (P,), whitened and not weighted."""
        return np.asarray(self.compute_data_residuals(x[None])[0])

    def compute_data_residuals(self, several: Float) -> Float:
        """(B, N) the same of several x (B, P)."""
        return self.session.whiten((self.session.value - self.predict_several(several)).T).T

    def residuals(self, several: Float) -> Float:
        """(B, N + priors) what a fit makes small, of several x (B, P): weighted residuals and deviations from priors."""
        data = self.weight * self.compute_data_residuals(several)
        return np.concatenate([data, np.array([self.compute_deviations(x) for x in several])], axis=1)

    def compute_deviations(self, x: Float) -> Float:
        """(priors,) deviations of entries x (P,) from what is known beforehand, in standard deviations."""
        own = x[self.model.size :]
        mean, sd = self._priors
        shaped = np.isfinite(sd)
        return np.concatenate([compute_deviations(self.model, x), (own[shaped] - mean[shaped]) / sd[shaped]])

    def fit(
        self,
        start: Float | ExtendedFit,
        *,
        most: int = 15,
        near: ExtendedFit | None = None,
        jacobian: Float | None = None,
        thorough: bool = True,
    ) -> ExtendedFit:
        """The optimum from a start.

        Parameters
        ----------
        start : entries (P,), or a fit of this model whose search goes on
        most : steps at most
        near : a fit of the same model with fewer mechanisms, elsewhere or under other weights, whose Jacobian is a first guess
        jacobian : (M, P) a first guess itself
        thorough : whether the end is confirmed with a Jacobian of its own
        """
        if near is not None:
            jacobian = self.lend(near)
        begin = start.solution if isinstance(start, ExtendedFit) else start
        found = minimise(
            self.residuals, begin, *self.limits, most=most, jacobian=jacobian, moving=self.settled, thorough=thorough
        )
        return ExtendedFit(self, found)

    def refine(self, fit: ExtendedFit) -> ExtendedFit:
        """The same optimum with a Jacobian by central differences."""
        jacobian = central(self.residuals, fit.x, *self.limits)
        return ExtendedFit(self, replace(fit.solution, jacobian=jacobian, fresh=True))

    def continue_fit(self, fit: ExtendedFit, *, most: int) -> ExtendedFit:
        """On from a fit with the Jacobian that it has, and next to no damping.

        Entries that can change places (a mass and its error) are parted by priors that are 10⁸ times weaker than the
        data: forward differences see a slope there that is none, and damping in proportion to the data holds the
        entries where they are.
        """
        own = fit.x.size
        found = minimise(
            self.residuals, fit.solution, *self.limits, most=most, moving=own, thorough=False, damping=LEAST_DAMPING
        )
        return ExtendedFit(self, found)

    def fit_material(self, start: Float, most: int, near: ExtendedFit) -> Solution:
        """Where film and rig are at their best for the mechanisms as they stand in the entries `start` (P,)."""
        low, high = (bound.copy() for bound in self.limits)
        low[self.model.size :] = high[self.model.size :] = start[self.model.size :]
        lent, own = self.lend(near), self.model.size
        return minimise(self.residuals, start, low, high, most=most, jacobian=lent, moving=own, thorough=False)

    def lend(self, near: ExtendedFit) -> Float:
        """(M, P) Jacobian of another fit in what both share, film and rig and the mechanisms that both begin with, 0 elsewhere."""
        lent = near.solution.jacobian
        if near.of.weight is not self.weight:
            lent = lent.copy()
            lent[: self.session.size] *= (self.weight / near.of.weight)[:, None]
        if near.of.chosen == self.chosen:
            return lent
        alike = sum(
            1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(self.chosen, near.of.chosen, strict=False))
        )
        own = sum(c.owner < alike for c in self.coordinates)
        shared = self.model.size + own
        rows = self.session.size + int(np.isfinite(self.model.prior_sd).sum())
        rows += int(np.isfinite(self._priors[1][:own]).sum())
        jacobian = np.zeros((rows + int(np.isfinite(self._priors[1][own:]).sum()), self.limits[0].size))
        jacobian[:rows, :shared] = lent[:rows, :shared]
        return jacobian

    def reweigh(self, weight: Float) -> Extended:
        """The same model with other weights (N,)."""
        return replace(self, weight=weight)

    def move_to(self, session: Session, simulation: Simulation, weight: Float) -> Extended:
        """The same model over another session."""
        quiet = self.quiet if session is self.session else None
        return replace(self, session=session, simulation=simulation, weight=weight, quiet=quiet)


@dataclass(frozen=True)
class ExtendedFit:
    """An extended model at its optimum."""

    of: Extended
    solution: Solution

    def allow_quiet(self, quiet: Float) -> ExtendedFit:
        """The fit in which as much of each group of features as (G,) `quiet` is noise."""
        return replace(self, of=replace(self.of, quiet=quiet))

    @property
    def x(self) -> Float:
        """(P,) entries."""
        return self.solution.x

    @property
    def theta(self) -> Float:
        """(P₀,) those of the plain model."""
        return self.solution.x[: self.of.model.size]

    @property
    def values(self) -> tuple[dict[str, float], ...]:
        """Parameters of each mechanism by name."""
        return self.of.values(self.solution.x)

    @property
    def chi2(self) -> float:
        """Weighted χ² with the priors' terms."""
        return self.solution.chi2

    @property
    def misfit(self) -> Float:
        """(N,) weighted whitened residual of the features."""
        return self.solution.residual[: self.of.session.size]

    @cached_property
    def covariance(self) -> Float:
        """(P, P) of the entries."""
        return self.solution.covariance

    @cached_property
    def trace(self) -> Float:
        """(B,) what shows of the mechanisms in each block, beyond what the entries of the plain model absorb: χ² in
        units of the noise."""
        of = self.of
        alone = of.simulation.predict(of.model, self.theta)
        change = of.weight * of.session.whiten(of.predict(self.x) - alone)
        absorbed = orthonormalise(self.solution.jacobian[:, : of.model.size])[: of.session.size]
        change = change - absorbed @ (absorbed.T @ change)
        return np.array([float(np.sum(change[p.first : p.stop] ** 2)) for p in of.session.places])

    def estimate_spread(self, without_parts: Float | None = None) -> Float:
        """(Q,) standard deviations of the mechanisms' entries.

        Parameters
        ----------
        without_parts : (G, Q) the entries fitted without each of G parts of the data. Where these differ by more than
            noise explains, the form is not quite right, and their delete-a-group jackknife counts.
        """
        variance = np.maximum(np.diag(self.covariance), 0.0)[self.of.model.size :]
        if without_parts is not None and len(without_parts) > 1:
            variance = np.maximum(variance, (len(without_parts) - 1) * np.var(without_parts, axis=0))
        return np.asarray(np.sqrt(variance))

    def move_values(self, number: int, changes: Float) -> list[dict[str, float]]:
        """Parameters of mechanism `number` with each of its searched entries changed in turn.

        Parameters
        ----------
        number : of the mechanism in the model
        changes : (Q,) of the entries
        """
        values, own, found = self.values[number], self.x[self.of.model.size :], []
        for c, x, change in zip(self.of.coordinates, own, changes, strict=True):
            if c.owner == number and not c.fixed:
                found.append({**values, c.parameter.name: c.value(x + change)})
        return found

    @cached_property
    def log_evidence(self) -> float:
        """Logarithm of ∫ likelihood × prior over the mechanisms' parameters, with θ at its best, in Laplace's
        approximation.

        Without the constants that all models of one session share: −χ²/2 for the plain model.
        """
        return -0.5 * self.chi2 + self.integrate_mechanisms(self.covariance)

    def integrate_mechanisms(self, covariance: Float) -> float:
        """Logarithm of prior density times volume of the mechanisms' entries about the optimum: what the likelihood there is
        multiplied with.

        Parameters
        ----------
        covariance : (P, P) of the entries
        """
        total, own, searched = 0.0, self.x[self.of.model.size :], self._searched
        for i in searched:
            c = self.of.coordinates[i]
            if c.parameter.role == SEVERITY:
                total += c.log_density(own[i])
            else:
                total -= float(np.log(c.prior[1])) + 0.5 * np.log(2 * np.pi)
        if searched:
            total += self.log_volume(covariance) + 0.5 * len(searched) * np.log(2 * np.pi)
        return float(total)

    def log_volume(self, covariance: Float) -> float:
        """Logarithm of the volume that a covariance (P, P) leaves to the mechanisms' entries that are searched.

        A direction that the data leave open is as wide as its plausible range, not wider.
        """
        places = self.of.model.size + np.array(self._searched, dtype=np.int64)
        widest = np.array([self._widest(self.of.coordinates[i]) for i in self._searched])
        volumes = np.linalg.eigvalsh(covariance[np.ix_(places, places)] / np.outer(widest, widest))
        return 0.5 * float(np.sum(np.log(np.clip(volumes, 1e-30, 1.0)))) + float(np.sum(np.log(widest)))

    @property
    def _searched(self) -> list[int]:
        """Numbers of the mechanisms' entries that are searched."""
        return [i for i, c in enumerate(self.of.coordinates) if not c.fixed]

    @staticmethod
    def _widest(c: Coordinate) -> float:
        p = c.parameter
        if c.logarithmic:
            return float(max(np.log(p.high / p.low), 1e-3) / np.sqrt(2 * np.pi))
        return float(max((p.high - p.low) / c.scale, 1e-3) / np.sqrt(2 * np.pi))


def orthonormalise(jacobian: Float) -> Float:
    """(M, R) orthonormal columns that span those of a Jacobian which are not 0."""
    length = np.sqrt(np.sum(jacobian**2, axis=0))
    return np.asarray(np.linalg.qr(jacobian[:, length > 0] / length[length > 0])[0])


def compose_chosen(chosen: Sequence[Chosen], values: Sequence[Mapping[str, float]]) -> Effect:
    """The composed effect of mechanisms in their variants, in the order of the stages.

    Parameters
    ----------
    chosen, values : mechanisms, and the parameters of each by name
    """
    total = NONE
    order = list(MECHANISMS)
    for c, own in sorted(zip(chosen, values, strict=True), key=lambda pair: order.index(pair[0].id)):
        total = total | _make_effect(c, tuple(own.items()))
    return total


@lru_cache(maxsize=256)
def _make_effect(chosen: Chosen, values: tuple[tuple[str, float], ...]) -> Effect:
    """The effect of one mechanism: the same object for the same parameters, so that predictions from it are known
    again."""
    return chosen.mechanism.effect(dict(values), chosen.variant)
