"""Clamp and load cell as a fit sees them: constants with priors, and the response of film and rig together.

    mechanical   G = F/x0   = g k kL/(k + D)
    electrical   H = −F/V²  = g a kL/(k + D)        D = kL − Mω² + jωcL,  a = F_A/V²,  g error of the force channel's gain

from M ẍ′ = T − kL x′ − cL ẋ′, F = kL x′, T = k (x0 − x′) − F_A (thesis, eq 4.16 to 4.22 with the sign of the inertia
corrected). Units: N s²/mm, N/mm, N s/mm. The constants and what is assumed where a rig file is silent are
`pipeline.physics.rig.RigModel`'s. Does not belong here: division by the resonance (`pipeline.transform.correction`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from pipeline.physics.rig import TONNES_PER_KG, RigModel
from schemas.arrays import Bool, Complex, Float
from schemas.metadata import RigConstants

CONSTANTS = ("clamp_mass_kg", "load_cell_stiffness_n_per_mm", "load_cell_damping_n_s_per_mm")
CONSTANT_WORDS = dict(
    zip(
        CONSTANTS,
        (("the clamp's mass", "kg"), ("the load cell's stiffness", "N/mm"), ("the load cell's damping", "N s/mm")),
        strict=True,
    )
)
"""What each constant is called in a sentence, and its unit."""


_LEAST_RATIO = 0.004


@dataclass(frozen=True)
class RigPrior:
    """Constants (M, kL, cL, g) about `nominal` with q standard normal a priori.

    `nominal` (4,), `factor` (4, r): independent directions of the prior covariance, r = 0 where everything is exact. Mass,
    stiffness and gain stay positive, nominal · exp((factor q)/nominal), which is nominal + factor q for small errors; damping
    is nominal + factor q.
    `assumed` says which values the rig file does not give.
    """

    nominal: Float
    factor: Float
    assumed: tuple[str, ...] = ()

    @property
    def size(self) -> int:
        return int(self.factor.shape[1])

    def matches(self, other: RigPrior) -> bool:
        """Whether both come from the same rig file."""
        return np.array_equal(self.nominal, other.nominal) and np.array_equal(self.factor, other.factor)

    def values(self, q: Float) -> Float:
        """Constants (4,) at q (r,)."""
        moved = self.factor @ q
        values = self.nominal + moved
        positive = self._positive
        with np.errstate(over="ignore"):
            values[positive] = self.nominal[positive] * np.exp(moved[positive] / self.nominal[positive])
        return values

    def slopes(self, values: Float) -> Float:
        """Derivatives (4, r) of the constants by q at these constants (4,)."""
        share = np.ones(4)
        share[self._positive] = values[self._positive] / self.nominal[self._positive]
        return np.asarray(self.factor * share[:, None])

    @property
    def lightest_ratio(self) -> float:
        """Damping ratio of the clamp alone that is two standard deviations below the stated one, at least 0.004.

        What rings longest and stands narrowest: files state a damping two times too high as easily as one too low.
        """
        mass, stiffness, damping, _ = self.nominal
        lightest = damping - 2 * float(np.linalg.norm(self.factor[2]))
        return float(max(lightest / (2 * np.sqrt(stiffness * mass)), _LEAST_RATIO))

    @property
    def _positive(self) -> Bool:
        positive = self.nominal > 0
        positive[2] = False
        return positive


def rig_prior(rig: RigConstants | None) -> RigPrior | None:
    """Prior from a rig file; None where the response can only be taken as the film's own (see `missing_constants`).

    A measured clamp-alone frequency replaces a missing mass or stiffness. Where only the mass is missing, inertia is
    neglected.
    """
    if rig is None:
        return None
    rig, assumed = _completed(rig)
    if rig.load_cell_stiffness_n_per_mm is None:
        return None
    model = RigModel.of(rig)
    factor = np.zeros((4, 4))
    factor[:3, :3] = model.factor()
    factor[3, 3] = model.force_gain_sd
    factor = factor[:, np.abs(factor).max(axis=0) > 0]
    return RigPrior(np.array([model.mass, model.stiffness, model.damping, 1.0]), factor, assumed + model.assumed)


def missing_constants(rig: RigConstants | None) -> str | None:
    """What a rig file lacks for the clamp–load-cell model, in words; None when nothing, or without a rig file."""
    if rig is None or rig_prior(rig) is not None:
        return None
    return "load-cell stiffness missing in the rig file: the response is taken as the film's own"


def _completed(rig: RigConstants) -> tuple[RigConstants, tuple[str, ...]]:
    stiffness, mass, f_c = rig.load_cell_stiffness_n_per_mm, rig.clamp_mass_kg, rig.clamp_frequency_hz
    if f_c is not None and (stiffness is None) != (mass is None):
        spread = 2 * (rig.clamp_frequency_hz_sd or 0.02 * f_c) / f_c
        if mass is None and stiffness is not None:
            mass = stiffness / (2 * math.pi * f_c) ** 2 / TONNES_PER_KG
            own = (rig.load_cell_stiffness_n_per_mm_sd or 0.02 * stiffness) / stiffness
            sd = mass * math.hypot(own, spread)
            new = replace(rig, clamp_mass_kg=mass, clamp_mass_kg_sd=sd, clamp_frequency_hz_sd=None)
            return new, ("clamp mass from the clamp-alone frequency",)
        if mass:
            stiffness = TONNES_PER_KG * mass * (2 * math.pi * f_c) ** 2
            own = (rig.clamp_mass_kg_sd or 0.03 * mass) / mass
            sd = stiffness * math.hypot(own, spread)
            new = replace(
                rig,
                load_cell_stiffness_n_per_mm=stiffness,
                load_cell_stiffness_n_per_mm_sd=sd,
                clamp_frequency_hz_sd=None,
            )
            return new, ("load-cell stiffness from the clamp-alone frequency",)
    if stiffness is not None and mass is None:
        new = replace(rig, clamp_mass_kg=0.0, clamp_mass_kg_sd=0.0, load_cell_damping_n_s_per_mm=0.0)
        return new, ("clamp mass missing in the rig file: inertia neglected",)
    return rig, ()


def combined(k: Complex, omega: Float, constants: Float, amplitude: float | None) -> tuple[Complex, Complex, Complex]:
    """Response of film and rig, its derivative by k (m,), and by M, kL, cL, g (m, 4).

    `amplitude` is a = F_A/V² for the electrical response and None for the mechanical one.
    """
    mass, cell, damping, gain = constants
    dynamic = cell - mass * omega**2 + 1j * omega * damping
    share = 1 / (k + dynamic)
    if amplitude is None:
        value = gain * cell * k * share
        by_k = gain * cell * dynamic * share**2
    else:
        value = gain * amplitude * cell * share
        by_k = -value * share
    by_dynamic = -value * share
    by_constants = np.empty((omega.size, 4), dtype=complex)
    by_constants[:, 0] = -(omega**2) * by_dynamic
    by_constants[:, 1] = value / cell + by_dynamic
    by_constants[:, 2] = 1j * omega * by_dynamic
    by_constants[:, 3] = value / gain
    return value, by_k, by_constants


def divided(response: Complex, omega: Float, constants: Float) -> Complex:
    """Film stiffness from a mechanical response, k = a G/(1 − G/kL) with a = 1 − Mω²/kL + jωcL/kL."""
    mass, cell, damping, gain = constants
    a = 1 + (-mass * omega**2 + 1j * omega * damping) / cell
    true = response / gain
    return np.asarray(a * true / (1 - true / cell))
