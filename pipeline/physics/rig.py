"""Clamp and load cell: their constants, how well they are known, and what they make of a film's response.

    M ẍ′ = T − kL x′ − cL ẋ′,   F = g kL x′,   T = k (x0 − x′) − F_A

(thesis, eq 4.16 to 4.18 with the sign of the inertia corrected, and with damping and actuation).

With the clamp's own a = 1 + (−Mω² + jωcL)/kL, a film of stiffness k(jω) shows under either loading

    mechanical   G = F/x0  = g k/(a + k/kL)
    electrical   H = −F/V² = g (F_A/V²)/(a + k/kL)

Units: N, mm, s, kV; the mass in tonnes (N s²/mm). What a rig file says is `schemas.metadata.RigConstants`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from schemas.arrays import Bool, Complex, Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants

TONNES_PER_KG = 1e-3
DEFAULT_MASS_SD, DEFAULT_STIFFNESS_SD = 0.03, 0.02
"""Relative standard deviations where the rig file gives none."""
DEFAULT_DAMPING_RATIO_SD = 0.01
"""Standard deviation of the damping ratio where neither damping nor its standard deviation is given."""
_LEAST_RATIO = 0.004
"""Damping ratio of the clamp that is expected at least."""


@dataclass(frozen=True)
class Rig:
    """Constants of clamp and load cell; numbers, or arrays that broadcast against the frequencies.

    Parameters
    ----------
    mass : N s²/mm, clamp
    stiffness : N/mm, load cell; infinite for a rigid one
    damping : N s/mm, load cell
    gain : gain of the force channel, recorded over true force
    extra : N s²/mm, known mass on the clamp beside its own; not part of the equations until it is added to `mass`

    Notes
    -----
    Methods that take `clamp` want a(jω) as `clamp` returns it, or as something else has changed it.
    Stiffnesses k and a broadcast against each other.
    """

    mass: Float | float
    stiffness: Float | float
    damping: Float | float
    gain: Float | float = 1.0
    extra: float = 0.0

    @cached_property
    def compliance(self) -> Float | float:
        """mm/N, 1/kL; 0 for a rigid load cell."""
        return 1 / self.stiffness

    @cached_property
    def numbers(self) -> tuple[float, float, float, float]:
        """M, kL, cL, g of one rig."""
        return (
            np.asarray(self.mass).item(),
            np.asarray(self.stiffness).item(),
            np.asarray(self.damping).item(),
            np.asarray(self.gain).item(),
        )

    @property
    def clamp_omega(self) -> Float:
        """rad/s, √(kL/M): natural frequency of the clamp without a film; infinite without mass or compliance."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / np.sqrt(np.asarray(self.mass * self.compliance)))

    @property
    def critical_damping(self) -> Float:
        """N s/mm, 2√(kL M) of the clamp without a film."""
        return np.asarray(2 * np.sqrt(self.mass / np.maximum(self.compliance, 1e-300)))

    @property
    def damping_ratio(self) -> Float:
        """cL/(2√(kL M)) of the clamp without a film; 0 for a rigid load cell."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(self.damping * np.sqrt(np.divide(self.compliance, self.mass)) / 2)

    def clamp(self, omega: Float) -> Complex:
        """Dynamic stiffness of clamp and load cell over kL.

        Parameters
        ----------
        omega : rad/s

        Returns
        -------
        a = 1 + (−Mω² + jωcL)/kL, shape of `omega` broadcast against the constants
        """
        return np.asarray(1 + self.compliance * (-self.mass * omega**2 + 1j * omega * self.damping), dtype=complex)

    def loaded(self, k: Complex, clamp: Complex | float) -> Complex:
        """a + k/kL: dynamic stiffness of the clamp with a film of stiffness k N/mm on it, over kL."""
        return np.asarray(clamp + k * self.compliance)

    def at_rest(self, k: Float | float) -> Float:
        """1 + k/kL of a film that moves slowly: displacement of the driven end over the film's extension."""
        return np.asarray(1 + k * self.compliance)

    def mechanical(self, k: Complex, clamp: Complex | float) -> Complex:
        """G = F/x0 in N/mm that the load cell shows of a film of stiffness k N/mm (thesis, eq 4.19 corrected)."""
        return np.asarray(self.gain * k / self.loaded(k, clamp))

    def electrical(self, k: Complex, clamp: Complex | float) -> Complex:
        """−F/F_A that the load cell shows of an actuation force with a film of stiffness k N/mm, the driven end held."""
        return np.asarray(self.gain / self.loaded(k, clamp))

    def extension(self, k: Complex, clamp: Complex | float) -> Complex:
        """(x0 − x′)/x0: share of the displacement that strains a film of stiffness k N/mm (thesis, eq 4.17)."""
        return np.asarray(clamp / self.loaded(k, clamp))

    def film_stiffness(self, response: Complex, clamp: Complex | float) -> Complex:
        """Film stiffness k = a G/(1 − G/kL) in N/mm from G = F/x0 in N/mm (thesis, eq 4.21 corrected)."""
        true = response / self.gain
        return np.asarray(clamp * true / (1 - true * self.compliance))

    def film_stiffness_of_actuation(self, response: Complex, actuation: float, clamp: Complex | float) -> Complex:
        """Film stiffness k = kL (g (F_A/V²)/H − a) in N/mm from H = −F/V² and F_A/V², both in N/kV²."""
        return np.asarray((self.gain * actuation / response - clamp) / self.compliance)

    def blocked_force(self, response: Complex, k: Complex, clamp: Complex | float) -> Complex:
        """F_A/V² = (a + k/kL) H in N/kV² from H = −F/V² (in place of thesis, eq 4.22)."""
        return np.asarray(self.loaded(k, clamp) * response / self.gain)

    def clamp_slopes(self, omega: Float) -> Complex:
        """Derivatives of a(jω) by (M, kL, cL), (m, 3), at (m,) rad/s; constants are numbers."""
        slopes = np.empty((omega.size, 3), dtype=complex)
        slopes[:, 0] = -(omega**2) * self.compliance
        slopes[:, 1] = (1 - self.clamp(omega)) * self.compliance
        slopes[:, 2] = 1j * omega * self.compliance
        return slopes

    def response_slopes(
        self, k: Complex, omega: Float, actuation: float | None = None
    ) -> tuple[Complex, Complex, Complex]:
        """Response of film and rig, and its derivatives; constants are numbers.

        Parameters
        ----------
        k : (m,) N/mm, film stiffness
        omega : (m,) rad/s
        actuation : F_A/V² in N/kV² for the electrical response H, None for the mechanical one G

        Returns
        -------
        value (m,), its derivative by k (m,), and by (M, kL, cL, g) (m, 4)
        """
        clamp = self.clamp(omega)
        share = 1 / self.loaded(k, clamp)
        if actuation is None:
            value = self.gain * k * share
            by_k = self.gain * clamp * share**2
        else:
            value = self.gain * actuation * share
            by_k = -value * share * self.compliance
        by_constants = np.empty((omega.size, 4), dtype=complex)
        by_constants[:, :3] = self.clamp_slopes(omega)
        by_constants[:, 1] -= k * self.compliance**2
        by_constants[:, :3] *= (-value * share)[:, None]
        by_constants[:, 3] = value / self.gain
        return value, by_k, by_constants

    def film_stiffness_slopes(self, response: Complex, omega: Float) -> tuple[Complex, Complex]:
        """Derivatives of the film's stiffness k = a G/(1 − G/kL); constants are numbers, the gain 1.

        Parameters
        ----------
        response : (m,) N/mm, G = F/x0
        omega : (m,) rad/s

        Returns
        -------
        ∂k/∂G = a/(1 − G/kL)² (m,), and the derivatives by (M, kL, cL, g) (m, 4)
        """
        clamp, rest = self.clamp(omega), 1 - response * self.compliance
        moved = response / rest
        by_response = clamp / rest**2
        by_constants = np.column_stack([self.clamp_slopes(omega) * moved[:, None], -by_response * response])
        by_constants[:, 1] -= clamp * (moved * self.compliance) ** 2
        return by_response, by_constants

    def blocked_force_slopes(self, response: Complex, k: Complex, omega: Float) -> tuple[Complex, Complex]:
        """Derivatives of the blocked force (a + k/kL) H; constants are numbers, the gain 1.

        Parameters
        ----------
        response : (m,) N/kV², H = −F/V²
        k : (m,) N/mm, film stiffness
        omega : (m,) rad/s

        Returns
        -------
        ∂(F_A/V²)/∂H = a + k/kL (m,), and the derivatives by (M, kL, cL, g) (m, 4)
        """
        by_response = self.loaded(k, self.clamp(omega))
        by_constants = np.column_stack([self.clamp_slopes(omega) * response[:, None], -by_response * response])
        by_constants[:, 1] -= k * self.compliance**2 * response
        return by_response, by_constants


RIGID = Rig(0.0, math.inf, 0.0)
"""Where nothing is known of clamp and load cell: the response is the film's own."""


@dataclass(frozen=True)
class Presumed:
    """A constant that a rig file does not give.

    Parameters
    ----------
    what, value : the constant, and what stands in its place
    text : both in words
    """

    what: str
    value: str
    text: str

    @classmethod
    def taken(cls, what: str, value: str) -> Presumed:
        """One that is taken as something."""
        return cls(what, value, f"{what} taken as {value}")


@dataclass(frozen=True)
class RigPrior:
    """Constants (M, kL, cL, g) of a rig about `nominal`, with q standard normal a priori.

    Parameters
    ----------
    nominal : (4,) N s²/mm, N/mm, N s/mm, and 1 for the gain of the force channel
    factor : (4, r) independent directions of the prior covariance, factor @ factor.T; r = 0 where everything is exact
    presumed : which constants the rig file does not give, and what stands in their place

    Notes
    -----
    Mass, stiffness and gain stay positive: nominal · exp((factor q)/nominal), which is nominal + factor q for small
    errors. The damping is nominal + factor q.
    """

    nominal: Float
    factor: Float
    presumed: tuple[Presumed, ...] = ()

    @property
    def assumed(self) -> tuple[str, ...]:
        """What is presumed, in words."""
        return tuple(p.text for p in self.presumed)

    @classmethod
    def of(cls, rig: RigConstants) -> RigPrior:
        """Prior from what a rig file says of mass and stiffness.

        Standard deviations that are missing are taken as 3 % of the mass, 2 % of the stiffness, and for the damping as
        large as the damping itself or 1 % of critical, whichever is larger. A measured clamp-alone frequency ties mass
        and stiffness together.

        Raises
        ------
        NotIdentifiableError
            Mass or stiffness is missing; it names the key.
        """
        missing = [key for key in ("clamp_mass_kg", "load_cell_stiffness_n_per_mm") if getattr(rig, key) is None]
        if missing or rig.clamp_mass_kg is None or rig.load_cell_stiffness_n_per_mm is None:
            raise NotIdentifiableError(
                f"{' and '.join(missing)} missing: the clamp's inertia and the load cell's compliance are not known",
                where=rig.rig_id or "rig",
                expected="both, for a correction of the clamp and load-cell resonance",
                remedy=f"Add {' and '.join(missing)} to the rig file, or record a tap of the clamp and weigh it",
            )
        presumed = []
        mass, stiffness = rig.clamp_mass_kg * TONNES_PER_KG, rig.load_cell_stiffness_n_per_mm
        if rig.clamp_mass_kg_sd is None:
            presumed.append(Presumed.taken("clamp mass", f"± {100 * DEFAULT_MASS_SD:.0f} %"))
        if rig.load_cell_stiffness_n_per_mm_sd is None:
            presumed.append(Presumed.taken("load-cell stiffness", f"± {100 * DEFAULT_STIFFNESS_SD:.0f} %"))
        mass_sd = DEFAULT_MASS_SD * mass if rig.clamp_mass_kg_sd is None else rig.clamp_mass_kg_sd * TONNES_PER_KG
        stiffness_sd = rig.load_cell_stiffness_n_per_mm_sd
        stiffness_sd = DEFAULT_STIFFNESS_SD * stiffness if stiffness_sd is None else stiffness_sd
        damping = rig.load_cell_damping_n_s_per_mm
        damping_sd = rig.load_cell_damping_n_s_per_mm_sd
        if damping is None:
            presumed.append(Presumed.taken("damping of the load cell", "none"))
        if damping_sd is None:
            presumed.append(Presumed.taken("load-cell damping", "± 100 %, at least 1 % of critical"))
            damping_sd = max(damping or 0.0, DEFAULT_DAMPING_RATIO_SD * 2 * math.sqrt(stiffness * mass))
        covariance = np.diag([mass_sd**2, stiffness_sd**2, damping_sd**2])
        if rig.clamp_frequency_hz is not None and rig.clamp_frequency_hz_sd is not None and mass > 0:
            mass, stiffness, covariance[:2, :2] = _with_frequency(
                mass, stiffness, covariance[:2, :2], rig.clamp_frequency_hz, rig.clamp_frequency_hz_sd
            )
        factor = np.zeros((4, 4))
        factor[:3, :3], factor[3, 3] = _directions(covariance), rig.force_gain_sd or 0.0
        factor = factor[:, np.abs(factor).max(axis=0) > 0]
        return cls(np.array([mass, stiffness, damping or 0.0, 1.0]), factor, tuple(presumed))

    @property
    def size(self) -> int:
        """r, number of independent directions."""
        return int(self.factor.shape[1])

    @property
    def rig(self) -> Rig:
        """The nominal constants."""
        return rig_of_constants(self.nominal)

    @property
    def sd(self) -> Float:
        """(4,) standard deviations of the constants."""
        return np.asarray(np.sqrt((self.factor**2).sum(axis=1)))

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


def rig_of_constants(constants: Float) -> Rig:
    """Rig of constants (M, kL, cL, g) (4,), as a `RigPrior` has them."""
    mass, stiffness, damping, gain = constants.tolist()
    return Rig(mass, stiffness, damping, gain)


def rig_prior(rig: RigConstants | None) -> RigPrior | None:
    """Prior from a rig file as far as it goes.

    A measured clamp-alone frequency replaces a missing mass or stiffness. Where only the mass is missing, inertia is
    neglected. None where the response can only be taken as the film's own: without a rig file, or without stiffness
    (see `missing_constants`).
    """
    if rig is None:
        return None
    rig, presumed = _completed(rig)
    if rig.load_cell_stiffness_n_per_mm is None:
        return None
    prior = RigPrior.of(rig)
    return replace(prior, presumed=presumed + prior.presumed)


def missing_constants(rig: RigConstants | None) -> str | None:
    """What a rig file lacks for the clamp–load-cell model, in words; None when nothing, or without a rig file."""
    if rig is None or rig_prior(rig) is not None:
        return None
    return "load-cell stiffness missing in the rig file: the response is taken as the film's own"


def _completed(rig: RigConstants) -> tuple[RigConstants, tuple[Presumed, ...]]:
    """The constants with what follows from the clamp-alone frequency, and what that assumes."""
    stiffness, mass, f_c = rig.load_cell_stiffness_n_per_mm, rig.clamp_mass_kg, rig.clamp_frequency_hz
    if f_c is not None and (stiffness is None) != (mass is None):
        spread = 2 * (rig.clamp_frequency_hz_sd or 0.02 * f_c) / f_c
        if mass is None and stiffness is not None:
            mass = stiffness / (2 * math.pi * f_c) ** 2 / TONNES_PER_KG
            own = (rig.load_cell_stiffness_n_per_mm_sd or DEFAULT_STIFFNESS_SD * stiffness) / stiffness
            sd = mass * math.hypot(own, spread)
            new = replace(rig, clamp_mass_kg=mass, clamp_mass_kg_sd=sd, clamp_frequency_hz_sd=None)
            return new, (_of_frequency("clamp mass"),)
        if mass:
            stiffness = TONNES_PER_KG * mass * (2 * math.pi * f_c) ** 2
            own = (rig.clamp_mass_kg_sd or DEFAULT_MASS_SD * mass) / mass
            sd = stiffness * math.hypot(own, spread)
            new = replace(
                rig,
                load_cell_stiffness_n_per_mm=stiffness,
                load_cell_stiffness_n_per_mm_sd=sd,
                clamp_frequency_hz_sd=None,
            )
            return new, (_of_frequency("load-cell stiffness"),)
    if stiffness is not None and mass is None:
        new = replace(rig, clamp_mass_kg=0.0, clamp_mass_kg_sd=0.0, load_cell_damping_n_s_per_mm=0.0)
        neglected = "inertia neglected"
        return new, (Presumed("clamp mass", neglected, f"clamp mass missing in the rig file: {neglected}"),)
    return rig, ()


def _of_frequency(what: str) -> Presumed:
    """A constant that follows from the measured clamp-alone frequency and the other one."""
    value = "from the clamp-alone frequency"
    return Presumed(what, value, f"{what} {value}")


def _directions(covariance: Float) -> Float:
    """(n, n) R with R Rᵀ = covariance (n, n)."""
    scale = np.sqrt(np.diag(covariance))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(safe, safe))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def tied_by_frequency(
    mass: float, stiffness: float, mass_sd: float, stiffness_sd: float, frequency_hz: float, frequency_sd: float
) -> tuple[float, float, Float]:
    """Mass and stiffness after the clamp-alone frequency √(kL/M)/2π was measured.

    Parameters
    ----------
    mass, mass_sd : N s²/mm, before
    stiffness, stiffness_sd : N/mm, before, independent of the mass
    frequency_hz, frequency_sd : Hz

    Returns
    -------
    mass, stiffness, and their covariance (2, 2)

    Notes
    -----
    Conditioning in logarithms: the measurement is ln kL − ln M = 2 ln(2π f_c), with twice the relative standard
    deviation of the frequency.
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
