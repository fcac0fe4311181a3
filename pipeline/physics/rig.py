"""Clamp and load cell as the analysis knows them: constants, and how well they are known.

Forward model of both loadings and its inverse (sign of the inertia term: thesis, eq 4.18 corrected). Frequencies in Hz,
forces in N, lengths in mm, the mass in tonnes (N s²/mm).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.arrays import Complex, Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants

TONNES_PER_KG = 1e-3
DEFAULT_MASS_SD, DEFAULT_STIFFNESS_SD = 0.03, 0.02
"""Relative standard deviations where the rig file gives none."""
DEFAULT_DAMPING_RATIO_SD = 0.01
"""Standard deviation of the damping ratio where neither damping nor its standard deviation is given."""


@dataclass(frozen=True)
class RigModel:
    """Constants of clamp and load cell.

    Parameters
    ----------
    mass : N s²/mm
    stiffness : N/mm
    damping : N s/mm
    covariance : (3, 3) prior covariance of (mass, stiffness, damping) in these units
    force_gain_sd : relative standard deviation of the force channel's gain
    assumed : which of the values were not in the rig file, in words
    """

    mass: float
    stiffness: float
    damping: float
    covariance: Float
    force_gain_sd: float = 0.0
    assumed: tuple[str, ...] = ()

    @classmethod
    def of(cls, rig: RigConstants) -> RigModel:
        """Model from the rig's constants.

        Standard deviations that are missing are taken as 3 % of the mass, 2 % of the stiffness, and for the damping as
        large as the damping itself or 1 % of critical, whichever is larger. A measured clamp-alone frequency ties mass
        and stiffness together. Raises `NotIdentifiableError` that names the key when mass or stiffness is missing.
        """
        missing = [key for key in ("clamp_mass_kg", "load_cell_stiffness_n_per_mm") if getattr(rig, key) is None]
        if missing or rig.clamp_mass_kg is None or rig.load_cell_stiffness_n_per_mm is None:
            raise NotIdentifiableError(
                f"{' and '.join(missing)} missing: the clamp's inertia and the load cell's compliance are not known",
                where=rig.rig_id or "rig",
                expected="both, for a correction of the clamp and load-cell resonance",
                remedy=f"Add {' and '.join(missing)} to the rig file, or record a tap of the clamp and weigh it",
            )
        assumed = []
        mass, stiffness = rig.clamp_mass_kg * TONNES_PER_KG, rig.load_cell_stiffness_n_per_mm
        if rig.clamp_mass_kg_sd is None:
            assumed.append(f"clamp mass taken as ± {100 * DEFAULT_MASS_SD:.0f} %")
        if rig.load_cell_stiffness_n_per_mm_sd is None:
            assumed.append(f"load-cell stiffness taken as ± {100 * DEFAULT_STIFFNESS_SD:.0f} %")
        mass_sd = DEFAULT_MASS_SD * mass if rig.clamp_mass_kg_sd is None else rig.clamp_mass_kg_sd * TONNES_PER_KG
        stiffness_sd = rig.load_cell_stiffness_n_per_mm_sd
        stiffness_sd = DEFAULT_STIFFNESS_SD * stiffness if stiffness_sd is None else stiffness_sd
        critical = 2 * np.sqrt(stiffness * mass)
        damping = rig.load_cell_damping_n_s_per_mm
        damping_sd = rig.load_cell_damping_n_s_per_mm_sd
        if damping is None:
            assumed.append("damping of the load cell taken as none")
        if damping_sd is None:
            assumed.append("load-cell damping taken as ± 100 %, at least 1 % of critical")
            damping_sd = max(damping or 0.0, DEFAULT_DAMPING_RATIO_SD * critical)
        pair = np.diag([mass_sd**2, stiffness_sd**2])
        if rig.clamp_frequency_hz is not None and rig.clamp_frequency_hz_sd is not None and mass > 0:
            mass, stiffness, pair = _with_frequency(
                mass, stiffness, pair, rig.clamp_frequency_hz, rig.clamp_frequency_hz_sd
            )
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = pair
        covariance[2, 2] = damping_sd**2
        return cls(mass, stiffness, damping or 0.0, covariance, rig.force_gain_sd or 0.0, tuple(assumed))

    def dynamic(self, frequency_hz: Float) -> Complex:
        """a = 1 − Mω²/kL + jωcL/kL, the clamp's own stiffness over the load cell's; shape of the input."""
        omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)
        return np.asarray(1 - self.mass * omega**2 / self.stiffness + 1j * omega * self.damping / self.stiffness)

    def measured_stiffness(self, frequency_hz: Float, film: Complex) -> Complex:
        """G = F/x0 = k kL/(k + kL − Mω² + jωcL) of a film of stiffness k (n,) N/mm."""
        return np.asarray(film / (film / self.stiffness + self.dynamic(frequency_hz)))

    def measured_ratio(self, frequency_hz: Float, film: Complex) -> Complex:
        """−F/F_A = kL/(k + kL − Mω² + jωcL): what the load cell shows of an actuation force, x0 held."""
        return np.asarray(1 / (film / self.stiffness + self.dynamic(frequency_hz)))

    def amplification(self, frequency_hz: Float, film: Complex) -> Float:
        """|1 + k/(kL − Mω² + jωcL)|: relative noise of k over relative noise of G, exact. Infinite where a = 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.abs(1 + film / (self.stiffness * self.dynamic(frequency_hz))))

    def factor(self) -> Float:
        """(3, 3) R with R Rᵀ = covariance; columns are independent directions of the prior."""
        scale = np.sqrt(np.diag(self.covariance))
        safe = np.where(scale > 0, scale, 1.0)
        correlation = self.covariance / np.outer(safe, safe)
        values, vectors = np.linalg.eigh(correlation)
        return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def tied_by_frequency(
    mass: float, stiffness: float, mass_sd: float, stiffness_sd: float, frequency_hz: float, frequency_sd: float
) -> tuple[float, float, Float]:
    """Mass, stiffness and their (2, 2) covariance after √(kL/M)/2π was measured; independent priors, in logarithms.

    The measurement is ln kL − ln M = 2 ln(2π f_c), with twice the relative standard deviation of the frequency.
    """
    prior = np.array([(mass_sd / mass) ** 2, (stiffness_sd / stiffness) ** 2])
    measured = (2 * frequency_sd / frequency_hz) ** 2
    miss = 2 * np.log(2 * np.pi * frequency_hz) - np.log(stiffness / mass)
    total = float(prior.sum()) + measured
    if total == 0:
        return mass, stiffness, np.zeros((2, 2))
    gain = np.array([-prior[0], prior[1]]) / total
    values = np.array([mass, stiffness]) * np.exp(gain * miss)
    relative = np.diag(prior) - total * np.outer(gain, gain)
    return float(values[0]), float(values[1]), np.asarray(relative * np.outer(values, values))


def _with_frequency(
    mass: float, stiffness: float, pair: Float, frequency_hz: float, frequency_sd: float
) -> tuple[float, float, Float]:
    """The same for constants that may hold the measurement already: two standard deviations that it would have left
    nearly equal are taken for its result, and only the correlation is put back."""
    a, b = np.sqrt(np.diag(pair)) / (mass, stiffness)
    known = (2 * frequency_sd / frequency_hz) ** 2
    if (a - b) ** 2 > known or a * b == 0:
        return tied_by_frequency(mass, stiffness, a * mass, b * stiffness, frequency_hz, frequency_sd)
    share = (a**2 + b**2 - known) / 2
    tied = pair.copy()
    tied[0, 1] = tied[1, 0] = max(share, 0.0) * mass * stiffness
    return mass, stiffness, tied
