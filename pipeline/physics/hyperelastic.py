"""Equilibrium stress of an incompressible film under uniaxial stretch, as nominal stress: bases of the large-cycle fit.

Each law is linear in its moduli for a given shape parameter. Does not belong here: relaxation (`time_domain`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from schemas.arrays import Float


@dataclass(frozen=True)
class Law:
    """A law P(λ) = Σ modulus_i column_i(λ; shape).

    `columns` (stretch (m,), shape) → (m, p); `moduli` names of the p moduli (unit of the stress); `shape` the name of the shape
    parameter, None without; `range` of the shape parameter for a largest stretch λ.
    """

    name: str
    moduli: tuple[str, ...]
    columns: Callable[[Float, float], Float]
    shape: str | None = None
    range: Callable[[float], tuple[float, float]] = lambda largest: (1.0, 1.0)

    def stress(self, stretch: Float, parameters: Mapping[str, float]) -> Float:
        """Nominal stress (m,) in the unit of the moduli."""
        shape = parameters[self.shape] if self.shape else 1.0
        return np.asarray(self.columns(stretch, shape) @ np.array([parameters[m] for m in self.moduli]))


def _non_affine(stretch: Float, limit: float) -> Float:
    """Davidson and Goulbourne (2013): crosslinks with limited extension, and entanglements."""
    first = stretch**2 + 2 / stretch
    room = np.maximum(3 * limit**2 - first, 1e-9)
    crosslinks = (stretch - stretch**-2) / 3 * (9 * limit**2 - first) / room
    entanglements = 1 - stretch**-1.5 - stretch**-2 + stretch**-0.5
    return np.stack([crosslinks, entanglements], 1)


def _neo_hookean(stretch: Float, _: float) -> Float:
    return (stretch - stretch**-2)[:, None]


def _ogden(stretch: Float, exponent: float) -> Float:
    return (2 / exponent * (stretch ** (exponent - 1) - stretch ** (-exponent / 2 - 1)))[:, None]


NON_AFFINE = Law(
    "non-affine",
    ("crosslink_modulus", "entanglement_modulus"),
    _non_affine,
    "largest_stretch",
    lambda largest: (1.001 * np.sqrt((largest**2 + 2 / largest) / 3), 10.0 * largest),
)
NEO_HOOKEAN = Law("neo-Hookean", ("shear_modulus",), _neo_hookean)
OGDEN = Law("Ogden, one term", ("shear_modulus",), _ogden, "exponent", lambda largest: (0.5, 8.0))
LAWS = {law.name: law for law in (NON_AFFINE, NEO_HOOKEAN, OGDEN)}
