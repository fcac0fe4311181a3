"""Models of a large cycle: one branch beside an equilibrium stress, with one mechanism more.

    P = P_eq(λ) + Q,   dQ/dt + Q/τ = γ dλ/dt        (`pipeline.fit.relaxation.time_domain`)

A triangle at one rate shows relaxation and the law of equilibrium in one curve. Both can be bent to follow the half
that is fitted, so that only what they predict of the other half speaks. Belongs here: the models. What follows from
them is in `cycle_diagnosis`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import OptimizeResult, least_squares

from pipeline.diagnose.adequacy import is_at_end
from pipeline.diagnose.mechanisms.drift import BASELINE_DRIFT
from pipeline.diagnose.mechanisms.film_amplitude import AMPLITUDE_SOFTENING, CYCLIC_SOFTENING, STRAIN_STIFFENING
from pipeline.diagnose.mechanisms.film_time import MISSING_RELAXATION, POWER_LAW_RELAXATION
from pipeline.diagnose.mechanisms.sensor import GAIN_ERROR
from pipeline.diagnose.rules import RULES
from pipeline.fit.relaxation.time_domain import GONE, CycleFits, fit_cycle
from pipeline.physics.film import integrate_arms
from pipeline.physics.hyperelastic import LAWS
from pipeline.physics.least_squares import differ_at_once
from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError

_MOST_STEPS = 100
"""Evaluations of a fit at most."""
_PER_SPAN = 30.0
"""Times of branches are searched from a sample's interval to so many times the length of the cycle."""
_LADDER = 25
"""Branches that stand for a power law, spaced evenly in log time beyond both ends of what a cycle can show."""
_LADDER_SPAN = 1e-3, 1e3
"""Ends of the ladder over the length of the cycle."""
_FAR = 12.0
"""Largest change of a logarithm that is searched."""
_AT_ONCE = 50_000
"""Values of stress that are simulated in one pass, so that they stay in the processor's cache."""
_AROUND = 1e-5
"""Stretch to both sides of rest from which the slope there is taken."""


@dataclass(frozen=True)
class LargeCycle:
    """A cycle as it was measured.

    Parameters
    ----------
    time_s, stretch, stress : (m,) s, stretch, and nominal stress in kPa
    fits : with one branch and more, on the law that the recording gives, else on a fitted one
    """

    time_s: Float
    stretch: Float
    stress: Float
    fits: CycleFits

    @property
    def top(self) -> int:
        """Number of the sample at the largest stretch."""
        return int(np.argmax(self.stretch))

    @property
    def loading(self) -> Bool:
        """(m,) whether a sample lies on the way up."""
        return np.arange(self.time_s.size) <= self.top

    @cached_property
    def strain(self) -> Float:
        """(m,) over the largest."""
        return np.asarray(np.clip((self.stretch - 1) / (self.stretch.max() - 1), 1e-9, None))

    @cached_property
    def highest(self) -> Float:
        """(m,) largest stretch so far."""
        return np.asarray(np.maximum.accumulate(self.stretch))


@dataclass(frozen=True)
class Ladder:
    """Branches that stand for a power law.

    Parameters
    ----------
    tau : (n,) their times, s
    stress : (m, n) their stresses with γ = 1
    """

    tau: Float
    stress: Float

    @classmethod
    def of(cls, cycle: LargeCycle) -> Ladder:
        span = cycle.time_s[-1] - cycle.time_s[0]
        tau = np.geomspace(_LADDER_SPAN[0] * span, _LADDER_SPAN[1] * span, _LADDER)
        return cls(tau, integrate_arms(cycle.time_s, cycle.stretch, tau))


@dataclass(frozen=True)
class Parts:
    """What B models of a cycle are made of.

    Parameters
    ----------
    cycle : the cycle, of m samples
    equilibrium, viscous : (B, m) equilibrium stress, and that of the branch, kPa
    k0 : (B,) slope of the equilibrium stress at rest, kPa
    ladder : branches that stand for a power law
    """

    cycle: LargeCycle
    equilibrium: Float
    viscous: Float
    k0: Float
    ladder: Ladder

    @property
    def total(self) -> Float:
        """(B, m) stress of the plain model, kPa."""
        return np.asarray(self.equilibrium + self.viscous)

    def add_arms(self, gamma: Float, tau: Float) -> Float:
        """(B, m) stress of branches of (B, n) moduli over k0, and times in s, beside the plain model's."""
        cycle = self.cycle
        arms = integrate_arms(cycle.time_s, cycle.stretch, tau.ravel()).reshape(-1, *tau.shape)
        return np.asarray(self.total + np.einsum("mbn,bn->bm", arms, self.k0[:, None] * gamma))


@dataclass(frozen=True)
class CycleMechanism:
    """A mechanism of the list, in one variant, as it acts on a cycle.

    Parameters
    ----------
    id, variant, equation : of the mechanism, in words, and with the term
    starts : values from which it is searched
    low, high : limits of its values
    neutral : values at which it does nothing
    stress : parts of B models, values (B, V) → (B, m) kPa
    severity : values (…, V), largest strain of the cycle → severity by key, (…) each
    """

    id: str
    variant: str
    equation: str
    starts: tuple[tuple[float, ...], ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    neutral: tuple[float, ...]
    stress: Callable[[Parts, Float], Float]
    severity: Callable[[Float, float], Mapping[str, Float]]


def _add_branches(parts: Parts, values: Float) -> Float:
    return parts.add_arms(np.exp(values[:, ::2]), np.exp(values[:, 1::2]))


def _add_power_law(parts: Parts, values: Float) -> Float:
    """K (s · 1 s)^α as branches: G(t) = K t^−α/Γ(1−α) = (K sin πα/π) ∫ τ^−α e^(−t/τ) d ln τ."""
    ratio, exponent = np.exp(values[:, :1]), values[:, 1:]
    tau = parts.ladder.tau
    weight = tau**-exponent * np.log(tau[1] / tau[0]) * np.sin(np.pi * exponent) / np.pi
    return np.asarray(parts.total + (parts.k0[:, None] * ratio * weight) @ parts.ladder.stress.T)


def _stiffen(parts: Parts, values: Float) -> Float:
    strain = parts.cycle.strain ** np.exp(values[:, 1:])
    return np.asarray(parts.total + values[:, :1] * parts.equilibrium * strain)


def _soften(parts: Parts, values: Float) -> Float:
    less = np.exp(values[:, :1]) * parts.cycle.strain ** np.exp(values[:, 1:])
    return np.asarray(parts.total / (1 + less))


def _apply_damage(parts: Parts, values: Float) -> Float:
    below = (parts.cycle.highest - parts.cycle.stretch) / np.exp(values[:, 1:])
    return np.asarray(parts.total * (1 + values[:, :1] * np.expm1(-below)))


def _apply_gain(parts: Parts, values: Float) -> Float:
    return np.asarray(parts.total * (1 + values))


def _add_drift(parts: Parts, values: Float) -> Float:
    since, total = parts.cycle.time_s - parts.cycle.time_s[0], parts.total
    mean = total.mean(axis=1, keepdims=True)
    return np.asarray(total + values[:, :1] * mean * np.log10(1 + since / np.exp(values[:, 1:])))


def _report_relaxation(values: Float, strain: float) -> Mapping[str, Float]:
    return {"stiffness_ratio": np.exp(values[..., 0]), "time_constant_s": np.exp(values[..., 1])}


def _report_softening(values: Float, strain: float) -> Mapping[str, Float]:
    return {
        "drop": 1 - 1 / (1 + np.exp(values[..., 0])),
        "strain_scale": strain * np.exp(-values[..., 0] / np.exp(values[..., 1])),
    }


def list_mechanisms(span_s: float, interval_s: float) -> tuple[CycleMechanism, ...]:
    """The mechanisms that one cycle can be asked for.

    Parameters
    ----------
    span_s, interval_s : length of the cycle, and time between its samples
    """
    shortest, longest = float(np.log(interval_s)), float(np.log(_PER_SPAN * span_s))
    fast, middle, slow = (float(np.log(share * span_s)) for share in (0.02, 0.2, 3.0))
    weak, bent = -_FAR, (np.log(0.2), np.log(6.0))
    return (
        CycleMechanism(
            MISSING_RELAXATION.id, "a second branch", "+ Q₂, dQ₂/dt + Q₂/τ₂ = γ₂ dλ/dt",
            ((0.0, fast), (0.0, middle), (0.0, slow)),
            (weak, shortest), (_FAR, longest), (weak, middle), _add_branches, _report_relaxation,
        ),
        CycleMechanism(
            MISSING_RELAXATION.id, "a second and a third branch", "+ Q₂ + Q₃, dQᵢ/dt + Qᵢ/τᵢ = γᵢ dλ/dt",
            ((0.0, fast, 0.0, middle), (0.0, middle, 0.0, slow)),
            (weak, shortest) * 2, (_FAR, longest) * 2, (weak, middle) * 2, _add_branches, _report_relaxation,
        ),
        CycleMechanism(
            POWER_LAW_RELAXATION.id, "", "+ ∫ K (t − s)^−α/Γ(1 − α) dλ",
            ((0.0, 0.2), (0.0, 0.6)), (weak, 0.02), (_FAR, 0.95), (weak, 0.2), _add_power_law,
            lambda values, strain: {"stiffness_ratio": np.exp(values[..., 0]), "exponent": values[..., 1]},
        ),
        CycleMechanism(
            STRAIN_STIFFENING.id, "beyond the law", "P_eq (1 + s (ε/ε_max)^m)",
            ((0.1, 0.0), (0.1, 1.0)), (0.0, bent[0]), (20.0, bent[1]), (0.0, 0.0), _stiffen,
            lambda values, strain: {"stiffening": values[..., 0]},
        ),
        CycleMechanism(
            AMPLITUDE_SOFTENING.id, "with the strain, reversible", "P/(1 + (ε/ε_c)^m)",
            ((-2.0, 0.0), (-2.0, 1.0)), (weak, bent[0]), (3.0, bent[1]), (weak, 0.0), _soften, _report_softening,
        ),
        CycleMechanism(
            CYCLIC_SOFTENING.id, "damage below the largest stretch so far", "P (1 − d (1 − e^(−(λ_max − λ)/a)))",
            ((0.1, 0.0),), (0.0, -3.0), (0.95, 3.0), (0.0, 0.0), _apply_damage,
            lambda values, strain: {"loss": values[..., 0], "strain_scale": np.exp(values[..., 1])},
        ),
        CycleMechanism(
            GAIN_ERROR.id, "", "P (1 + g)", ((0.1,), (1.0,)), (-0.9,), (20.0,), (0.0,), _apply_gain,
            lambda values, strain: {"gain": values[..., 0]},
        ),
        CycleMechanism(
            BASELINE_DRIFT.id, "", "P + b log₁₀(1 + t/t₀)",
            ((0.05, fast), (0.05, middle)), (-5.0, shortest), (5.0, longest), (0.0, middle), _add_drift,
            lambda values, strain: {"per_decade": values[..., 0], "onset_s": np.exp(values[..., 1])},
        ),
    )  # fmt: skip


@dataclass(frozen=True)
class Fitted:
    """A model fitted to a part of a cycle.

    Parameters
    ----------
    model : the model
    seen : (m,) the part
    x : (P,) log γ, log τ, those of the law where it is not given, and the mechanism's values; γ and moduli in units of the stress's scatter
    residual, jacobian : (n,) kPa and (n, P) on the part
    unseen : whether the part does not show the mechanism
    """

    model: CycleModel
    seen: Bool
    x: Float
    residual: Float
    jacobian: Float
    unseen: bool

    def stress(self, x: Float | None = None) -> Float:
        """(…, m) kPa over the whole cycle, of x (…, P) instead of the fitted one where it is given."""
        return self.model.stress(self.x if x is None else x)

    def misfit(self, x: Float) -> Float:
        """(…) sum of squares over the fitted part, kPa², above that of the optimum; x (…, P)."""
        left = self.stress(x)[..., self.seen] - self.model.cycle.stress[self.seen]
        return np.asarray(np.sum(left**2, axis=-1) - self.residual @ self.residual)

    @property
    def is_at_limit(self) -> bool:
        """Whether the mechanism's severity, the first of its values, has ended where it is searched no further."""
        mechanism = self.model.mechanism
        if mechanism is None or self.unseen:
            return False
        return is_at_end(
            float(self.x[-len(mechanism.neutral)]), mechanism.neutral[0], mechanism.low[0], mechanism.high[0]
        )


class CycleModel:
    """One branch on an equilibrium stress, with a mechanism or none, over a cycle."""

    def __init__(self, cycle: LargeCycle, mechanism: CycleMechanism | None) -> None:
        self.mechanism, self._law = mechanism, LAWS[cycle.fits.law]
        first = next(fit for fit in cycle.fits.fits if fit.order == 1)
        self._given = first.equilibrium if cycle.fits.fixed else None
        self._put_on(cycle)
        # What is far and what is small must not depend on the unit of the stress.
        self.unit = float(np.std(cycle.stress)) or 1.0
        start = [*np.log(np.array(first.gamma[:1]) / self.unit), *np.log(first.tau[:1])] or [0.0, 0.0]
        span, interval = float(np.ptp(cycle.time_s)), float(np.median(np.diff(cycle.time_s)))
        low, high = [-_FAR, np.log(interval)], [_FAR, np.log(_PER_SPAN * span)]
        if self._given is None:
            names, moduli = self._law.names, self._law.moduli
            law = self._law.in_units(first.equilibrium, 1 / self.unit)
            start += [float(np.log(max(law[name], GONE))) for name in names]
            lowest, highest = np.log(self._law.range(float(cycle.stretch.max())))
            low += [-_FAR if name in moduli else lowest for name in names]
            high += [_FAR if name in moduli else highest for name in names]
        self._own = len(start)
        self._start, self._low, self._high = np.array(start), np.array(low), np.array(high)

    @property
    def limits(self) -> tuple[Float, Float]:
        """Lowest and highest x, (P,) each."""
        mechanism = self.mechanism
        low, high = ((), ()) if mechanism is None else (mechanism.low, mechanism.high)
        return np.concatenate([self._low, low]), np.concatenate([self._high, high])

    def _put_on(self, cycle: LargeCycle) -> None:
        self.cycle, self._ladder = cycle, Ladder.of(cycle)
        # Its stretches, and those around rest, by which the slope there is told.
        self._stretches = np.append(cycle.stretch, [1 - _AROUND, 1 + _AROUND])
        self._known = None if self._given is None else self._law.stress(self._stretches, self._given)

    def _simulate(self, x: Float) -> Float:
        """(B, m) kPa, of x (B, P)."""
        cycle, law = self.cycle, self._stretch_law(x)
        viscous = self.gamma(x)[:, None] * integrate_arms(cycle.time_s, cycle.stretch, np.exp(x[:, 1])).T
        parts = Parts(cycle, law[:, :-2], viscous, _take_slope(law), self._ladder)
        return parts.total if self.mechanism is None else self.mechanism.stress(parts, x[:, self._own :])

    def _stretch_law(self, x: Float) -> Float:
        """(…, m + 2) equilibrium stress of the cycle and around rest, kPa, of x (…, P)."""
        if self._known is not None:
            return np.broadcast_to(self._known, (*x.shape[:-1], self._known.size))
        units = [self.unit if name in self._law.moduli else 1.0 for name in self._law.names]
        return self._law.stress_of(self._stretches, np.exp(x[..., 2 : self._own]) * units)

    def slope_at_rest(self, x: Float) -> Float:
        """(…) slope of the equilibrium stress at rest, kPa, of x (…, P)."""
        return _take_slope(self._stretch_law(x))

    def gamma(self, x: Float) -> Float:
        """(…) modulus of the branch, kPa, of x (…, P)."""
        return np.asarray(self.unit * np.exp(x[..., 0]))

    def severity(self, x: Float) -> Mapping[str, Float]:
        """(…) severity by key, of x (…, P)."""
        if self.mechanism is None:
            return {}
        return self.mechanism.severity(x[..., self._own :], float(self.cycle.stretch.max() - 1))

    def elsewhere(self, time_s: Float, stretch: Float) -> CycleModel:
        """The same model over another test of the same film, (m,) s and stretch, whose largest stretch is the same."""
        other = copy(self)
        other._put_on(replace(self.cycle, time_s=time_s, stretch=stretch, stress=np.zeros(time_s.size)))
        return other

    def stress(self, x: Float) -> Float:
        """(…, m) kPa, of x (…, P)."""
        rows, samples = x.reshape(-1, x.shape[-1]), self.cycle.time_s.size
        each = max(_AT_ONCE // samples, 1)
        parts = [self._simulate(rows[first : first + each]) for first in range(0, len(rows), each)]
        return np.concatenate(parts).reshape(*x.shape[:-1], samples)

    def fit(self, seen: Bool) -> Fitted:
        """The least squares over a part of the cycle.

        Parameters
        ----------
        seen : (m,) the part

        Raises
        ------
        NotIdentifiableError
            where no start leads anywhere
        """
        mechanism, (low, high) = self.mechanism, self.limits
        extra = ((),) if mechanism is None else mechanism.starts
        measured = self.cycle.stress[seen]

        def residual(x: Float) -> Float:
            return np.asarray(self.stress(x)[..., seen] - measured) / self.unit

        ends: list[OptimizeResult] = []
        for own in extra:
            start = np.clip(np.concatenate([self._start, own]), low + 1e-6, high - 1e-6)
            end = least_squares(
                residual,
                start,
                bounds=(low, high),
                x_scale="jac",
                max_nfev=_MOST_STEPS,
                workers=differ_at_once(residual),
            )
            if np.isfinite(end.cost):
                ends.append(end)
        if not ends:
            raise NotIdentifiableError("the cycle's model has no finite fit", where=self.cycle.fits.recording_id)
        best = min(ends, key=lambda end: float(end.cost))
        length = np.linalg.norm(best.jac, axis=0)
        unseen = mechanism is not None and bool((length[self._own :] < RULES.single.unseen * length.max()).all())
        x = best.x.copy()
        if unseen and mechanism is not None:
            x[self._own :] = mechanism.neutral
        return Fitted(self, seen, x, residual(x) * self.unit, best.jac * self.unit, unseen)


def _take_slope(law: Float) -> Float:
    """(…) slope at rest from stresses (…, m + 2), of which the last two are around it."""
    return np.asarray((law[..., -1] - law[..., -2]) / (2 * _AROUND))


def make_cycle(
    time_s: Float,
    stretch: Float,
    stress: Float,
    equilibrium: Mapping[str, float] | None,
    recording_id: str,
    specimen_id: str,
    orders: Sequence[int] = (1,),
    section_over_length_mm: float | None = None,
) -> LargeCycle:
    """A cycle with its plain fits.

    Parameters
    ----------
    time_s, stretch, stress : (m,) s, stretch, and nominal stress in kPa
    equilibrium : parameters of the law of equilibrium by name; None: it is fitted
    recording_id, specimen_id : where it is from
    orders : numbers of branches that are fitted
    section_over_length_mm : of the undeformed film, None where its sizes are not known

    Raises
    ------
    NotIdentifiableError
        as `fit_cycle`, and where there is no way back
    """
    good = np.isfinite(time_s) & np.isfinite(stretch) & np.isfinite(stress)
    t, lam, p = time_s[good], stretch[good], stress[good]
    fits = fit_cycle(
        t,
        lam,
        p,
        equilibrium=equilibrium,
        orders=orders,
        recording_id=recording_id,
        specimen_id=specimen_id,
        section_over_length_mm=section_over_length_mm,
    )
    found = LargeCycle(t, lam, p, fits)
    up = found.loading
    rules = RULES.single
    if min(up.sum(), (~up).sum()) < rules.way_back * t.size or np.ptp(lam[~up]) < rules.way_back_span * np.ptp(lam):
        raise NotIdentifiableError(
            "the cycle has no way back of a tenth of its samples", where=recording_id, expected="loading and unloading"
        )
    return found
