"""One-term Ogden law in plane stress for incompressible films (Carpi and Gei; thesis, eq 3.13 with 8/27 for 2³/3).

    W = (8/27) Y (λ1^{3/2} + λ2^{3/2} + λ3^{3/2} − 3),   λ3 = 1/(λ1 λ2)

Valid up to the inflection of the nominal stress, about λ = 3.3 for VHB 4910. All stresses are nominal (first
Piola-Kirchhoff), per undeformed area, in the unit of Y.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from schemas.arrays import Float


def energy(l1: ArrayLike, l2: ArrayLike, young: float = 1.0) -> Float:
    """Strain energy per undeformed volume at in-plane principal stretches; broadcast shape."""
    a, b = np.asarray(l1, dtype=float), np.asarray(l2, dtype=float)
    return np.asarray(8 / 27 * young * (a**1.5 + b**1.5 + (a * b) ** -1.5 - 3))


def principal_stress(l1: ArrayLike, l2: ArrayLike, young: float = 1.0) -> tuple[Float, Float]:
    """Nominal stresses P1, P2 at in-plane principal stretches (thesis, eq 3.14)."""
    a, b = np.asarray(l1, dtype=float), np.asarray(l2, dtype=float)
    factor = 4 / 9 * young
    return factor * (a**0.5 - a**-2.5 * b**-1.5), factor * (b**0.5 - b**-2.5 * a**-1.5)


def principal_tangent(l1: ArrayLike, l2: ArrayLike, young: float = 1.0) -> tuple[Float, Float, Float]:
    """C11 = ∂P1/∂λ1, C22 = ∂P2/∂λ2 and C12 = C21 (thesis, eq 3.15 and the missing off-diagonal)."""
    a, b = np.asarray(l1, dtype=float), np.asarray(l2, dtype=float)
    c11 = young * (2 / 9 * a**-0.5 + 10 / 9 * a**-3.5 * b**-1.5)
    c22 = young * (2 / 9 * b**-0.5 + 10 / 9 * b**-3.5 * a**-1.5)
    return c11, c22, 2 / 3 * young * (a * b) ** -2.5


def stress_and_tangent(gradient: Float, young: float = 1.0) -> tuple[Float, Float]:
    """Nominal stress and its tangent for any in-plane deformation gradient.

    Parameters
    ----------
    gradient : (..., 2, 2) deformation gradient F, det F > 0
    young : Young's modulus of the undeformed film

    Returns
    -------
    stress (..., 2, 2) P_iJ = ∂W/∂F_iJ, tangent (..., 2, 2, 2, 2) A_iJkL = ∂P_iJ/∂F_kL. In principal axes the shear block
    has (λ1P1 − λ2P2)/(λ1² − λ2²) on its diagonal and (λ2P1 − λ1P2)/(λ1² − λ2²) beside it.
    """
    left, stretch, right = np.linalg.svd(gradient)
    l1, l2 = stretch[..., 0], stretch[..., 1]
    p1, p2 = principal_stress(l1, l2, young)
    c11, c22, c12 = principal_tangent(l1, l2, young)
    equal = np.abs(l1 - l2) < 1e-6 * l1
    gap = np.where(equal, 1.0, l1 - l2)
    both = np.where(equal, 0.5 * (c11 + c22) - c12, (p1 - p2) / gap)  # symmetric shear
    turn = (p1 + p2) / (l1 + l2)  # rotation
    local = np.zeros((*l1.shape, 2, 2, 2, 2))
    local[..., 0, 0, 0, 0], local[..., 1, 1, 1, 1] = c11, c22
    local[..., 0, 0, 1, 1] = local[..., 1, 1, 0, 0] = c12
    local[..., 0, 1, 0, 1] = local[..., 1, 0, 1, 0] = 0.5 * (both + turn)
    local[..., 0, 1, 1, 0] = local[..., 1, 0, 0, 1] = 0.5 * (both - turn)
    stress = (left * np.stack([p1, p2], -1)[..., None, :]) @ right
    # A = (left ⊗ rightᵀ) local (left ⊗ rightᵀ)ᵀ as one 4 × 4 product per point
    turned = (left[..., :, None, :, None] * np.swapaxes(right, -1, -2)[..., None, :, None, :]).reshape(*l1.shape, 4, 4)
    tangent = turned @ local.reshape(*l1.shape, 4, 4) @ np.swapaxes(turned, -1, -2)
    return stress, tangent.reshape(*l1.shape, 2, 2, 2, 2)
