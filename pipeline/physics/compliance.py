"""The compliance of a film: what a Maxwell-Wiechert solid does under a load that is given, exactly and both ways.

    J(s) = J0 + Σ Jᵢ/(1 + sλᵢ) + φ/s = 1/k(s),      k(s) the stiffness of `pipeline.physics.film`

A solid of n arms has n retardation times λᵢ, which lie between its relaxation times (Tschoegl, Phenomenological Theory of
Linear Viscoelastic Behavior, 1989, ch. 3); without main spring one of them is the flow φ. Does not belong here: how the
parameters are found.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pipeline.physics.film import RelaxationModel, integrate_arms
from schemas.arrays import Float

_FLOWS = 1e-12
"""Rate over the fastest one below which a retardation is a flow: the rounding of the eigenvalues."""


@dataclass(frozen=True)
class Compliance:
    """An elastic part at once, retarded parts, and perhaps a flow.

    Parameters
    ----------
    instant : J0, mm/N (of a film under voltage mm/kV², and so on)
    retarded : (n,) Jᵢ ≥ 0, in the unit of `instant`
    times_s : (n,) λᵢ, s, longest first
    flow : φ, unit of `instant` per s; 0 for a solid
    """

    instant: float
    retarded: tuple[float, ...]
    times_s: tuple[float, ...]
    flow: float = 0.0

    @classmethod
    def of(cls, model: RelaxationModel) -> Compliance:
        """The compliance of a Maxwell-Wiechert model.

        Raises
        ------
        ValueError
            The model has a pure dashpot: it does not give way at once.

        Notes
        -----
        k(s) = K(1 − vᵀ(s + D)⁻¹v) with D = diag(1/τ), vᵢ² = kᵢ/(τᵢK), K = k0 + Σkᵢ; hence
        1/k(s) = (1 + vᵀ(s + D − vvᵀ)⁻¹v)/K, whose poles are the eigenvalues of a symmetric matrix.
        """
        if model.c_inf:
            raise ValueError("a model with a pure dashpot has no instantaneous compliance")
        total = model.k0 + sum(model.k)
        k, tau = np.array(model.k), np.array(model.tau)
        v = np.sqrt(k / (tau * total))
        rates, vectors = np.linalg.eigh(np.diag(1 / tau) - np.outer(v, v))
        weights = (vectors.T @ v) ** 2 / total
        flows = rates <= _FLOWS * rates.max(initial=0.0)
        flow = float(weights[flows].sum())
        rates, weights = rates[~flows], weights[~flows]
        return cls(1 / total, tuple((weights / rates).tolist()), tuple((1 / rates).tolist()), flow)

    @property
    def is_real(self) -> bool:
        """Whether a film can have it, so that it has a solid: gives way at once, nothing is negative, no time is 0 or endless."""
        times = np.array(self.times_s)
        return (
            self.instant > 0
            and self.flow >= 0
            and min(self.retarded, default=0.0) >= 0
            and bool(((times > 0) & (times < np.inf)).all())
        )

    def solid(self) -> RelaxationModel:
        """The Maxwell-Wiechert model of this compliance; its main spring is 0 where it flows.

        Notes
        -----
        `of` turned round: k(s) = (1 − wᵀ(s + X + wwᵀ)⁻¹w)/J0 with X = diag(1/λ), wᵢ² = Jᵢ/(λᵢJ0), and a rate of 0 for the flow.
        """
        rates = [1 / t for t in self.times_s]
        weights = [j / t for j, t in zip(self.retarded, self.times_s, strict=True)]
        if self.flow:
            rates, weights = [0.0, *rates], [self.flow, *weights]
        w = np.sqrt(np.array(weights) / self.instant)
        found, vectors = np.linalg.eigh(np.diag(np.array(rates)) + np.outer(w, w))
        springs = (vectors.T @ w) ** 2 / self.instant / found
        main = 0.0 if self.flow else 1 / (self.instant + sum(self.retarded))
        return RelaxationModel(main, tuple(springs.tolist()), tuple((1 / found).tolist()))

    def stiffer_by(self, series: float) -> Compliance:
        """The same without an elastic part of that compliance that was in series with it."""
        return replace(self, instant=self.instant - series)

    def at(self, time_s: Float) -> Float:
        """Creep compliance J0 + Σ Jᵢ(1 − e^{−t/λᵢ}) + φt at the times (m,) s after a step of the load."""
        total = np.full(np.shape(time_s), self.instant) + self.flow * time_s
        for j, t in zip(self.retarded, self.times_s, strict=True):
            total = total - j * np.expm1(-time_s / t)
        return np.asarray(total)

    def response(self, time_s: Float, load: Float) -> Float:
        """Extension (m,) under a load (m,) that runs in straight lines between the times (m,) s, from rest under the first one."""
        change = load - load[0]
        total = (self.instant + sum(self.retarded)) * change
        if self.retarded:
            total = total - integrate_arms(time_s, change, np.array(self.times_s)) @ np.array(self.retarded)
        if self.flow:
            total = total + self.flow * integral(time_s, change)
        return np.asarray(total)


def integral(time_s: Float, load: Float) -> Float:
    """∫ load dt (m,) up to each of the times (m,) s."""
    steps = 0.5 * (load[1:] + load[:-1]) * np.diff(time_s)
    return np.concatenate([[0.0], np.cumsum(steps)])
