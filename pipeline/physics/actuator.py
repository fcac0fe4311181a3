"""An actuator of strips of film: stiffness, force, capacitance and pull-in from its sizes, and how a pre-stretch
changes the film.

Layers lie side by side and add their forces; strips lie behind each other and add their strokes. All layers have the
same voltage. Sizes are those of the stretched film. Does not belong here: what is known of a film, and how well
(`pipeline.fit.actuator`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from pipeline.physics.film import EPSILON_0_N_PER_KV2
from pipeline.physics.hyperelastic import CARPI_GEI, principal_stress, principal_tangent

_FARTHEST = 8.0
"""Largest stretch, over the pre-stretch, at which an instability is looked for."""


@dataclass(frozen=True)
class Sizes:
    """An actuator's stretched sizes.

    Parameters
    ----------
    length_mm, width_mm, thickness_mm : one layer of one strip between its clamps
    layers, strips : layers side by side in a strip, strips behind each other
    active_length_mm, active_width_mm : the electrodes of a strip; the rest is passive film in series
    mass_g : of what moves with the end

    Raises
    ------
    ValueError
        A size is not positive, or the electrodes are larger than the film.
    """

    length_mm: float
    width_mm: float
    thickness_mm: float
    active_length_mm: float
    active_width_mm: float
    layers: int = 1
    strips: int = 1
    mass_g: float = 0.0

    def __post_init__(self) -> None:
        sizes = (self.length_mm, self.width_mm, self.thickness_mm, self.active_length_mm, self.active_width_mm)
        if min(sizes) <= 0 or self.layers < 1 or self.strips < 1 or self.mass_g < 0:
            raise ValueError("sizes and counts of an actuator are above 0")
        if self.active_length_mm > self.length_mm * (1 + 1e-9) or self.active_width_mm > self.width_mm * (1 + 1e-9):
            raise ValueError("the electrodes are larger than the film")

    @property
    def stiffness_per_modulus(self) -> float:
        """Stiffness in N/mm of a film of 1 MPa: section over length of all films together, mm."""
        return self.layers * self.width_mm * self.thickness_mm / (self.strips * self.length_mm)

    @property
    def force_per_permittivity(self) -> float:
        """Blocked force over V² in N/kV² for a relative permittivity of 1 (thesis, eq 4.8, times the active share of
        the length)."""
        share = self.active_length_mm / self.length_mm
        return EPSILON_0_N_PER_KV2 * self.layers * self.active_width_mm / self.thickness_mm * share

    @property
    def capacitance_per_permittivity_nf(self) -> float:
        """Capacitance of all films in nF, which is N mm/kV², for a relative permittivity of 1: ε0 w l/z."""
        area = self.layers * self.strips * self.active_length_mm * self.active_width_mm
        return EPSILON_0_N_PER_KV2 * area / self.thickness_mm

    @property
    def film_volume_mm3(self) -> float:
        """Volume of all film between the clamps."""
        return self.layers * self.strips * self.length_mm * self.width_mm * self.thickness_mm


def lateral_stretch(stretch_1: float, stretch_2: float | None) -> float:
    """The stretch across: as held, or 1/√λ1 of a film whose sides are free (`stretch_2` None)."""
    return stretch_1**-0.5 if stretch_2 is None else stretch_2


def nominal_tangent(stretch_1: float, stretch_2: float | None, exponent: float = CARPI_GEI) -> float:
    """Slope of the nominal stress along the film by its stretch, for a Young's modulus of 1.

    Parameters
    ----------
    stretch_1 : along the film
    stretch_2 : across it, where it is held; None: the sides are free, and no stress acts across
    exponent : of Ogden's law; 3/2 is the thesis' (eq 3.13), 2 the neo-Hookean

    Returns
    -------
    dP1/dλ1 = C11 with held sides, C11 − C12²/C22 with free ones
    """
    across = lateral_stretch(stretch_1, stretch_2)
    c11, c22, c12 = (float(c) for c in principal_tangent(stretch_1, across, 1.0, exponent))
    return c11 if stretch_2 is not None else c11 - c12**2 / c22


def incremental_ratio(
    old: tuple[float, float | None], new: tuple[float, float | None], exponent: float = CARPI_GEI
) -> float:
    """Incremental modulus k l/A at the new pre-stretch (λ1, λ2 or None) over that at the old one: (λ1² dP1/dλ1) of
    both."""
    return new[0] ** 2 * nominal_tangent(*new, exponent) / (old[0] ** 2 * nominal_tangent(*old, exponent))


@lru_cache(maxsize=256)
def pull_in_number(stretch_1: float, stretch_2: float | None, exponent: float = CARPI_GEI) -> float:
    """Largest ε0 εr E0²/Y that a film under a constant pull withstands, E0 the voltage over the undeformed thickness.

    Parameters
    ----------
    stretch_1 : along the film at rest, under the pull
    stretch_2 : across it, where it is held; None: the sides are free
    exponent : of Ogden's law

    Returns
    -------
    The largest value on the way of equilibria under a rising field; beyond it there is none, and the film thins until
    it breaks

    Notes
    -----
    With e = ε0 εr E0² the nominal stresses are P1 − e λ1 λ2² (constant: the pull) and P2 − e λ1² λ2 (0 with free
    sides), P of the law. Each λ1 above the rest gives one e; the first largest e along that way is where equilibrium is
    lost. The law does not stiffen at large stretches as films do, so a film may recover from this loss; it never comes
    earlier.
    """
    across = lateral_stretch(stretch_1, stretch_2)
    pull = float(principal_stress(stretch_1, across, 1.0, exponent)[0])

    def load(along: float) -> float:
        if stretch_2 is not None:
            return (float(principal_stress(along, across, 1.0, exponent)[0]) - pull) / (along * across**2)

        def unbalanced(side: float) -> float:
            p1, p2 = principal_stress(along, side, 1.0, exponent)
            return float(p1 - p2 * side / along) - pull

        low = along**-0.5
        high = low
        while unbalanced(high) > 0:
            high *= 1.2
        side = low if high == low else float(brentq(unbalanced, low, high))
        return float(principal_stress(along, side, 1.0, exponent)[1]) / (along**2 * side)

    way = stretch_1 * np.geomspace(1.0, _FARTHEST, 200)
    loads = np.array([load(float(along)) for along in way])
    peak = int(np.argmax(np.append(loads[:-1] > loads[1:], True)))
    low, high = way[max(peak - 1, 0)], way[min(peak + 1, way.size - 1)]
    best = minimize_scalar(lambda along: -load(float(along)), bounds=(low, high), method="bounded")
    return max(float(-best.fun), float(loads[peak]))
