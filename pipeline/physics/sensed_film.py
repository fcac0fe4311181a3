"""Capacitance and tension of self-sensing films under voltage, many films at once, and their exact solution in time.

With v = V² a film of rest stiffness k0 moves by e = v/κ(s), κ(s) = 1 + Σ (kᵢ/k0) sτᵢ/(1 + sτᵢ) its stiffness over that
at rest: e is the v that would hold it there at rest. Its capacitance changes by g e, and the tension falls by d v at
once. That is a film of one relaxation everywhere, small strains (thesis, eq 5.1 to 5.6 and 5.16, with the film of eq
4.11). Does not belong here: what decides the voltage (`controllers`), how sure the numbers are
(`pipeline.fit.control`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from pipeline.physics.film import RelaxationModel
from schemas.arrays import Complex, Float

_STIFFEST_S = 1e-3
"""A pure dashpot is an arm of this relaxation time: far below what a loop can follow."""


@dataclass(frozen=True)
class SensedFilms:
    """n films with a arms each.

    Parameters
    ----------
    springs : (n, a) of the arms over the main spring
    tau_s : (n, a) their relaxation times
    gain_pf_per_kv2 : (n,) change of the capacitance at rest per V²; negative where a voltage lowers it
    force_n_per_kv2 : (n,) drop of tension per V²
    """

    springs: Float
    tau_s: Float
    gain_pf_per_kv2: Float
    force_n_per_kv2: Float

    def __len__(self) -> int:
        return self.gain_pf_per_kv2.size

    def one(self, index: int) -> SensedFilms:
        """The film of that place alone."""
        at = slice(index, index + 1)
        return SensedFilms(self.springs[at], self.tau_s[at], self.gain_pf_per_kv2[at], self.force_n_per_kv2[at])

    def response(self, frequency_hz: ArrayLike) -> Complex:
        """(n, m) pF per kV² at (m,) Hz: g/κ(jω)."""
        z = 2j * np.pi * np.asarray(frequency_hz, dtype=float) * self.tau_s[..., None]
        relative = 1 + np.sum(self.springs[..., None] * z / (1 + z), axis=1)
        return np.asarray(self.gain_pf_per_kv2[:, None] / relative)

    @cached_property
    def _instant(self) -> Float:
        """(n,) stiffness at once over that at rest."""
        return np.asarray(1 + self.springs.sum(axis=-1))

    def extend(self, points: Float, squared_kv2: Float) -> Float:
        """(…, n) extensions e in kV² for internal points (…, n, a) and V² (…, n)."""
        return np.asarray((squared_kv2 + (self.springs * points).sum(axis=-1)) / self._instant)

    def hold(self, points: Float, extension_kv2: Float) -> Float:
        """(…, n) V² that holds the films at these extensions just now."""
        return np.asarray(extension_kv2 * self._instant - (self.springs * points).sum(axis=-1))

    def propagate(self, interval_s: float) -> tuple[Float, Float]:
        """Matrices (n, a, a), (n, a) that take the internal points over an interval of constant V²: q' = Φ q + Γ v."""
        n, a = self.springs.shape
        block = np.zeros((n, a + 1, a + 1))
        rate, instant = 1 / self.tau_s, self._instant
        block[:, :a, :a] = rate[:, :, None] * self.springs[:, None, :] / instant[:, None, None]
        block[:, range(a), range(a)] -= rate
        block[:, :a, a] = rate / instant[:, None]
        whole = expm(block * interval_s)
        return np.asarray(whole[:, :a, :a]), np.asarray(whole[:, :a, a])


def sense_films(models: list[RelaxationModel], gain_pf_per_kv2: Float, force_n_per_kv2: Float) -> SensedFilms:
    """Films of relaxation models (n) with a main spring, all with as many arms.

    Parameters
    ----------
    models : of the films' stiffness
    gain_pf_per_kv2, force_n_per_kv2 : (n,) see `SensedFilms`

    Raises
    ------
    ValueError
        A model has no main spring: under a voltage that stays on, it never comes to rest.
    """
    if any(model.k0 <= 0 for model in models):
        raise ValueError("a film without a main spring has no rest under voltage")
    arms = [
        [*zip(m.k, m.tau, strict=True)] + ([(m.c_inf / _STIFFEST_S, _STIFFEST_S)] if m.c_inf else []) for m in models
    ]
    rest = np.array([m.k0 for m in models])
    numbers = np.array(arms, dtype=float).reshape(len(models), -1, 2)
    return SensedFilms(
        numbers[..., 0] / rest[:, None], numbers[..., 1], np.asarray(gain_pf_per_kv2), np.asarray(force_n_per_kv2)
    )
