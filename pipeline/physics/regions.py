"""Capacitance of a sensing region by where it lies and how it is held (thesis, section 5.2, eq 5.1 to 5.12).

λ_AR is the stretch of the active region against rest, 1 at rest; l_tot and l_AR stretched lengths. What is held rigid counts neither
as total nor as rest.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pipeline.physics.film import EPSILON_0_N_PER_KV2
from schemas.arrays import Float


def apart(active_stretch: ArrayLike, total_mm: float, active_mm: float) -> Float:
    """C/C0 of a region behind the active one: λ_SR = (l_tot − l_AR λ_AR)/(l_tot − l_AR) (eq 5.6)."""
    return np.asarray((total_mm - active_mm * np.asarray(active_stretch, dtype=float)) / (total_mm - active_mm))


def beside(active_stretch: ArrayLike, total_mm: float, active_mm: float) -> Float:
    """C/C0 of a region directly beside the active one, which takes over its lateral expansion: (λ_SR λ_L)², λ_L = λ_AR (eq 5.11)."""
    stretch = np.asarray(active_stretch, dtype=float)
    return np.asarray((apart(stretch, total_mm, active_mm) * stretch) ** 2)


def shared(active_stretch: ArrayLike) -> Float:
    """C/C0 of one region for both whose width is held: λ_A², with λ_A = λ_AR (eq 5.12 corrected)."""
    return np.asarray(np.asarray(active_stretch, dtype=float) ** 2)


def circular(radial_stretch: ArrayLike) -> Float:
    """C/C0 of a circular actuator that grows by λ in every direction of its plane: its area by λ², its thickness by 1/λ², C by λ⁴."""
    return np.asarray(np.asarray(radial_stretch, dtype=float) ** 4)


def pull_in_field(modulus_mpa: float, relative_permittivity: float) -> float:
    """Nominal field in MV/m (voltage over undeformed thickness) at which a film that is free in its plane pulls in.

    Notes
    -----
    Equal stretches of a neo-Hookean film of shear modulus μ = Y/3: εE₀² = μ (λ⁻² − λ⁻⁸), E₀ the nominal field; its largest value, at
    λ = 4^(1/6), is 0.4725 μ.
    """
    return float(np.sqrt(0.4725 * modulus_mpa / 3 / (EPSILON_0_N_PER_KV2 * relative_permittivity)))
