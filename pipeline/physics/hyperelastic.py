"""Large strain of incompressible films: Ogden's law in plane stress, and the laws of large uniaxial cycles.

    W = 2Y/(3α²) (λ1^α + λ2^α + λ3^α − 3),   λ3 = 1/(λ1 λ2)

α = 3/2 is Carpi and Gei's law of the thesis (eq 3.13 with 8/27 for 2³/3), valid up to the inflection of the nominal
stress, about λ = 3.3 for VHB 4910. All stresses are nominal (first Piola-Kirchhoff), per undeformed area, in the unit
of Y. Does not belong here: relaxation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from schemas.arrays import Float

CARPI_GEI = 1.5
"""Exponent of the thesis' law."""


def energy(l1: ArrayLike, l2: ArrayLike, young: float = 1.0, exponent: float = CARPI_GEI) -> Float:
    """Strain energy per undeformed volume.

    Parameters
    ----------
    l1, l2 : in-plane principal stretches
    young : Young's modulus of the undeformed film
    exponent : α

    Returns
    -------
    W in the unit of `young`, broadcast shape (thesis, eq 3.13 corrected)
    """
    a, b = np.asarray(l1, dtype=float), np.asarray(l2, dtype=float)
    total = a**exponent + b**exponent + (a * b) ** -exponent - 3
    return np.asarray(2 / (3 * exponent**2) * young * total)


def principal_stress(
    l1: ArrayLike, l2: ArrayLike, young: float = 1.0, exponent: float | Float = CARPI_GEI
) -> tuple[Float, Float]:
    """Nominal stresses P1 and P2; parameters as in `energy` (thesis, eq 3.14)."""
    a, b = np.asarray(l1, dtype=float), np.asarray(l2, dtype=float)
    factor, up, down = 2 / (3 * exponent) * young, exponent - 1, -exponent - 1
    return factor * (a**up - a**down * b**-exponent), factor * (b**up - b**down * a**-exponent)


def principal_tangent(
    l1: ArrayLike, l2: ArrayLike, young: float = 1.0, exponent: float = CARPI_GEI
) -> tuple[Float, Float, Float]:
    """C11 = ∂P1/∂λ1, C22 = ∂P2/∂λ2 and C12 = C21; parameters as in `energy` (thesis, eq 3.15 and the missing
    off-diagonal)."""
    a, b = np.asarray(l1, dtype=float), np.asarray(l2, dtype=float)
    factor, up, down = 2 / (3 * exponent) * young, exponent - 1, -exponent - 1
    c11 = factor * (up * a ** (up - 1) - down * a ** (down - 1) * b**-exponent)
    c22 = factor * (up * b ** (up - 1) - down * b ** (down - 1) * a**-exponent)
    return c11, c22, factor * exponent * (a * b) ** down


def stress_and_tangent(gradient: Float, young: float = 1.0) -> tuple[Float, Float]:
    """Nominal stress of the thesis' law and its tangent for any in-plane deformation gradient.

    Parameters
    ----------
    gradient : (..., 2, 2) deformation gradient F, det F > 0
    young : Young's modulus of the undeformed film

    Returns
    -------
    stress (..., 2, 2) P_iJ = ∂W/∂F_iJ, tangent (..., 2, 2, 2, 2) A_iJkL = ∂P_iJ/∂F_kL

    Notes
    -----
    In principal axes the shear block has (λ1P1 − λ2P2)/(λ1² − λ2²) on its diagonal and (λ2P1 − λ1P2)/(λ1² − λ2²) beside
    it.
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


@dataclass(frozen=True)
class Law:
    """Equilibrium stress under uniaxial stretch, P(λ) = Σ modulusᵢ columnᵢ(λ; shape): linear in its moduli.

    Parameters
    ----------
    name : of the law
    moduli : names of the p moduli, which have the unit of the stress
    columns : (stretch (m,), shape parameter, or several at once as (…, 1)) → (…, m, p)
    shape : name of the shape parameter, None without
    range : least and largest shape parameter for a largest stretch λ
    signed : the moduli that may be negative
    """

    name: str
    moduli: tuple[str, ...]
    columns: Callable[[Float, float | Float], Float]
    shape: str | None = None
    range: Callable[[float], tuple[float, float]] = lambda largest: (1.0, 1.0)
    signed: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Of all parameters, the shape last."""
        return (*self.moduli, *([self.shape] if self.shape else []))

    def stress(self, stretch: Float, parameters: Mapping[str, float]) -> Float:
        """Nominal stress (m,) in the unit of the moduli."""
        return self.stress_of(stretch, np.array([parameters[name] for name in self.names]))

    def stress_of(self, stretch: Float, entries: Float) -> Float:
        """The same of parameters (…, P), ordered as their names: (…, m)."""
        shape: float | Float = entries[..., -1:] if self.shape else 1.0
        return np.asarray((self.columns(stretch, shape) @ entries[..., : len(self.moduli), None])[..., 0])

    def in_units(self, parameters: Mapping[str, float], factor: float) -> dict[str, float]:
        """The parameters with moduli `factor` times as large: of a stress that is so in all."""
        return {name: value * factor if name in self.moduli else value for name, value in parameters.items()}


def _non_affine(stretch: Float, limit: float | Float) -> Float:
    """Davidson and Goulbourne (2013): crosslinks with limited extension, and entanglements."""
    first = stretch**2 + 2 / stretch
    room = np.maximum(3 * limit**2 - first, 1e-9)
    crosslinks = (stretch - stretch**-2) / 3 * (9 * limit**2 - first) / room
    entanglements = 1 - stretch**-1.5 - stretch**-2 + stretch**-0.5
    return np.stack(np.broadcast_arrays(crosslinks, entanglements), -1)


def _neo_hookean(stretch: Float, _: float | Float) -> Float:
    return (stretch - stretch**-2)[:, None]


def _ogden(stretch: Float, exponent: float | Float) -> Float:
    return principal_stress(stretch, stretch**-0.5, 3.0, exponent)[0][..., None]


NON_AFFINE = Law(
    "non-affine",
    ("crosslink_modulus", "entanglement_modulus"),
    _non_affine,
    "largest_stretch",
    lambda largest: (1.001 * np.sqrt((largest**2 + 2 / largest) / 3), 10.0 * largest),
)
LINEAR = Law(
    "linear",
    ("modulus", "stress_at_1"),
    lambda stretch, _: np.stack([stretch - 1, np.ones_like(stretch)], -1),
    signed=("stress_at_1",),
)
"""A spring about any level: of a film whose length is not known, so that its stretch is not either."""
NEO_HOOKEAN = Law("neo-Hookean", ("shear_modulus",), _neo_hookean)
OGDEN = Law("Ogden, one term", ("shear_modulus",), _ogden, "exponent", lambda largest: (0.5, 8.0))
LAWS = {law.name: law for law in (NON_AFFINE, NEO_HOOKEAN, OGDEN, LINEAR)}
