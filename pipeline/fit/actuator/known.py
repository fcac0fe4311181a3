"""What is known of an actuator under voltage, and how well: its force and its spring with all that makes them
uncertain.

What is uncertain is a vector of logarithms: the parameters of the film's fit, the relative permittivity, a factor on
the stiffness (between laws of the film and between films) and the thickness. All quantities are smooth functions of it;
their standard deviations are linearised. Permittivity and fit are taken as independent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from pipeline.fit.force.permittivity import active_length, active_share, unit_force
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.results import LUMPED
from pipeline.fit.relaxation.varpro import SLOW
from pipeline.physics.actuator import Sizes, incremental_ratio, nominal_tangent, pull_in_number
from pipeline.physics.film import EPSILON_0_N_PER_KV2, RelaxationModel
from pipeline.physics.hyperelastic import CARPI_GEI
from schemas.arrays import Complex, Float
from schemas.metadata import RecordingMetadata

NEO_HOOKEAN = 2.0
"""Exponent of the other law that a pre-stretch is judged with."""
_N_PER_MM_PER_G_HZ2 = 1e-6


class Fitted(Protocol):
    """A fit of the film: its model, and the covariance of its parameters' logarithms with the slopes that go with
    it."""

    @property
    def model(self) -> RelaxationModel: ...

    @property
    def covariance(self) -> Float: ...

    def slopes(self, frequency_hz: ArrayLike, /) -> Complex:
        """∂k/∂θ (m, p)."""
        ...


@dataclass(frozen=True)
class FormedFit:
    """A fit whose form is uncertain as well: further parameters with a standard deviation of 1 lead from its curve to
    others.

    Parameters
    ----------
    fit : of the film
    following : of the next order: what the test for the order cannot tell apart may still differ at the ends of what
        was recorded
    slow_s : relaxation time in s of an arm that is part of the main spring; one as strong as that spring bends the
        curve by −k0/(1 + jωτ). None: the main spring holds no such arm
    """

    fit: Fitted
    following: RelaxationModel | None = None
    slow_s: float | None = None

    @property
    def model(self) -> RelaxationModel:
        return self.fit.model

    @property
    def covariance(self) -> Float:
        """(p + q, p + q)."""
        p = len(self.fit.covariance)
        whole = np.eye(p + (self.following is not None) + (self.slow_s is not None))
        whole[:p, :p] = self.fit.covariance
        return whole

    def slopes(self, frequency_hz: ArrayLike, /) -> Complex:
        """∂k/∂θ (m, p + q) at (m,) Hz."""
        f = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        ways = []
        if self.following is not None:
            ways.append(self.following.stiffness(f) - self.fit.model.stiffness(f))
        if self.slow_s is not None:
            ways.append(-self.fit.model.k0 / (1 + 2j * np.pi * f * self.slow_s))
        return np.concatenate([self.fit.slopes(f), *(way[:, None] for way in ways)], axis=1)


def allow_for_form(fit: Fitted, following: RelaxationModel | None, warnings: str, lowest_hz: float) -> Fitted:
    """The fit with what its form leaves open.

    Parameters
    ----------
    fit : of the order chosen
    following : of the next order; None where it was not fitted
    warnings : of the fit; a slow arm in the main spring is among them
    lowest_hz : lowest frequency that the fit rests on; that arm is the slowest that a fit tells from a spring
    """
    slow = SLOW / (2 * np.pi * lowest_hz) if LUMPED in warnings else None
    return FormedFit(fit, following, slow)


@dataclass(frozen=True)
class KnownFilm:
    """The film of a specimen as a material.

    Parameters
    ----------
    fit : its stiffness, at its own sizes
    stiffness_per_modulus_mm : stretched section over stretched length of that specimen
    stretch_1, stretch_2 : its pre-stretch; `stretch_2` None: its sides are free
    relative_permittivity, permittivity_sd : with the standard deviation of the logarithm
    lowest_hz : lowest frequency that the fit rests on
    """

    fit: Fitted
    stiffness_per_modulus_mm: float
    stretch_1: float
    stretch_2: float | None
    relative_permittivity: float
    permittivity_sd: float
    lowest_hz: float


@dataclass(frozen=True)
class Scatter:
    """Between this film and the next: standard deviations of the logarithms of modulus and thickness; 0: this film
    itself."""

    modulus_sd: float = 0.0
    thickness_sd: float = 0.0


@dataclass(frozen=True)
class Limit:
    """A largest field (voltage over stretched thickness) in MV/m, with the standard deviation of its logarithm."""

    field_mv_per_m: float
    sd: float


@dataclass(frozen=True)
class Driven:
    """An actuator under voltage, in numbers.

    Parameters
    ----------
    fit : of a film whose stiffness times `ratio` is that of the actuator
    ratio, ratio_sd : with the standard deviation of its logarithm
    force_per_voltage_squared, permittivity_sd : N/kV² at the ends, with the standard deviation of the permittivity's
        logarithm
    voltage_kv : across each layer
    lowest_hz : lowest frequency that the fit rests on
    thickness_sd : of the logarithm of the thickness
    mass_g : of what moves with the end
    capacitance_nf : of all films; None where it is not known
    field_mv_per_m : voltage over stretched thickness; None where it is not known
    pull_in : field of the loss of equilibrium at that frequency, without what the fit and the permittivity leave open;
        None: not known
    breakdown : field at which films of this kind fail; None: not known
    """

    fit: Fitted
    ratio: float
    ratio_sd: float
    force_per_voltage_squared: float
    permittivity_sd: float
    voltage_kv: float
    lowest_hz: float
    thickness_sd: float = 0.0
    mass_g: float = 0.0
    capacitance_nf: float | None = None
    field_mv_per_m: float | None = None
    pull_in: Limit | None = None
    breakdown: Limit | None = None

    @property
    def force_n(self) -> float:
        """Blocked force."""
        return self.force_per_voltage_squared * self.voltage_kv**2

    def spring(self, frequency_hz: ArrayLike) -> Complex:
        """Stiffness (m,) N/mm that the actuation force meets at (m,) Hz: film less the inertia of the mass."""
        f = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        return np.asarray(self.ratio * self.fit.model.stiffness(f) - self._inertia(f))

    def force_slopes(self) -> Float:
        """(p + 3,) slopes of ln F by all that is uncertain."""
        return np.concatenate([np.zeros(len(self.fit.covariance)), [1.0, 0.0, -1.0]])

    def spring_slopes(self, frequency_hz: ArrayLike) -> Complex:
        """(m, p + 3) slopes of ln K, complex, by all that is uncertain."""
        f = np.atleast_1d(np.asarray(frequency_hz, dtype=float))
        own = self.ratio * self.fit.model.stiffness(f)
        whole = (own - self._inertia(f))[:, None]
        films = own[:, None] * [0.0, 1.0, 1.0]
        return np.asarray(np.concatenate([self.ratio * self.fit.slopes(f), films], axis=1) / whole)

    def sd(self, slopes: Float) -> Float:
        """(m,) standard deviations of quantities whose slopes (m, p + 3) these are."""
        others = np.array([self.permittivity_sd, self.ratio_sd, self.thickness_sd])
        p = len(self.fit.covariance)
        own = np.einsum("...i,ij,...j->...", slopes[..., :p], self.fit.covariance, slopes[..., :p])
        return np.asarray(np.sqrt(np.maximum(own, 0.0) + (slopes[..., p:] ** 2) @ others**2))

    def _inertia(self, frequency_hz: Float) -> Float:
        return np.asarray(_N_PER_MM_PER_G_HZ2 * self.mass_g * (2 * np.pi * frequency_hz) ** 2)


def know_film(
    fit: Fitted, about: RecordingMetadata, permittivity: tuple[float, float], lowest_hz: float
) -> KnownFilm | None:
    """The film of a specimen as a material; None where the metadata lack a size or the pre-stretch.

    Parameters
    ----------
    fit : of the specimen
    about : its sizes
    permittivity : relative permittivity, and the standard deviation of its logarithm
    lowest_hz : lowest frequency that the fit rests on
    """
    geometry, stretch = Geometry.of(about), about.pre_stretch
    if geometry is None or stretch is None:
        return None
    return KnownFilm(fit, geometry.section_mm2 / geometry.length_mm, stretch, about.stretch_2, *permittivity, lowest_hz)


def drive_design(
    film: KnownFilm,
    sizes: Sizes,
    stretch: tuple[float, float | None],
    voltage_kv: float,
    *,
    scatter: Scatter | None = None,
    breakdown: Limit | None = None,
) -> Driven:
    """An actuator of a known film, of any sizes.

    Parameters
    ----------
    film : what is known
    sizes : stretched sizes of the actuator
    stretch : its pre-stretch along and across, None: free sides
    voltage_kv : across each layer
    scatter : of the films that it will be built of
    breakdown : field at which such films fail

    Notes
    -----
    Another pre-stretch changes the incremental modulus by `incremental_ratio`, anywhere between that of the thesis' law and
    that of the neo-Hookean.
    """
    scatter = scatter or Scatter()
    old, law, law_sd = (film.stretch_1, film.stretch_2), 1.0, 0.0
    if old != stretch:
        law, law_sd = _between(*(incremental_ratio(old, stretch, exponent) for exponent in (CARPI_GEI, NEO_HOOKEAN)))
    return Driven(
        fit=film.fit,
        ratio=law * sizes.stiffness_per_modulus / film.stiffness_per_modulus_mm,
        ratio_sd=float(np.hypot(law_sd, scatter.modulus_sd)),
        force_per_voltage_squared=film.relative_permittivity * sizes.force_per_permittivity,
        permittivity_sd=film.permittivity_sd,
        voltage_kv=voltage_kv,
        lowest_hz=film.lowest_hz,
        thickness_sd=scatter.thickness_sd,
        mass_g=sizes.mass_g,
        capacitance_nf=film.relative_permittivity * sizes.capacitance_per_permittivity_nf,
        field_mv_per_m=voltage_kv / sizes.thickness_mm,
        pull_in=pull_in_limit(
            law * slow_stiffness(film.fit, film.lowest_hz) / film.stiffness_per_modulus_mm,
            film.relative_permittivity,
            stretch,
        ),
        breakdown=breakdown,
    )


def drive_specimen(
    about: RecordingMetadata,
    fit: Fitted,
    force_per_voltage_squared: float,
    sd: float,
    voltage_kv: float,
    lowest_hz: float,
) -> Driven:
    """A specimen itself as an actuator.

    Parameters
    ----------
    about : its sizes
    fit : of its film
    force_per_voltage_squared, sd : N/kV² at its ends, as measured, with the standard deviation of the logarithm
    voltage_kv : across each layer
    lowest_hz : lowest frequency that the fit rests on

    Returns
    -------
    Without capacitance, field or pull-in where the metadata lack a size that it takes
    """
    layer, along, across, geometry = (
        about.layer_thickness_mm,
        about.pre_stretch,
        about.lateral_stretch,
        Geometry.of(about),
    )
    unit, active, share = unit_force(about), active_length(about), active_share(about)
    field = None if None in (layer, along, across) else voltage_kv * (along or 1) * (across or 1) / (layer or 1)
    limit = None
    if unit and geometry is not None and along is not None:
        modulus, permittivity = geometry.modulus_mpa(slow_stiffness(fit, lowest_hz)), force_per_voltage_squared / unit
        limit = pull_in_limit(modulus, permittivity, (along, about.stretch_2))
    return Driven(
        fit=fit,
        ratio=1.0,
        ratio_sd=0.0,
        force_per_voltage_squared=force_per_voltage_squared,
        permittivity_sd=sd,
        voltage_kv=voltage_kv,
        lowest_hz=lowest_hz,
        capacitance_nf=None if active is None else force_per_voltage_squared / share * active,
        field_mv_per_m=field,
        pull_in=limit,
    )


def slow_stiffness(fit: Fitted, lowest_hz: float) -> float:
    """|k| in N/mm at the lowest frequency in Hz that a fit rests on."""
    return float(np.abs(fit.model.stiffness(np.array([lowest_hz])))[0])


def pull_in_limit(modulus_mpa: float, relative_permittivity: float, stretch: tuple[float, float | None]) -> Limit:
    """Field over the stretched thickness at which a film pulls in under a constant pull.

    Parameters
    ----------
    modulus_mpa : incremental, k l/A at that pre-stretch
    relative_permittivity : of the film
    stretch : pre-stretch along and across, None: free sides

    Returns
    -------
    The field anywhere between that of the thesis' law and that of the neo-Hookean, both with that modulus
    """
    along, across = stretch[0], stretch[0] ** -0.5 if stretch[1] is None else stretch[1]

    def field(exponent: float) -> float:
        young = modulus_mpa / (along**2 * nominal_tangent(*stretch, exponent))
        nominal = pull_in_number(*stretch, exponent) * young / (EPSILON_0_N_PER_KV2 * relative_permittivity)
        return float(np.sqrt(nominal)) * along * across

    return Limit(*_between(field(CARPI_GEI), field(NEO_HOOKEAN)))


def _between(first: float, second: float) -> tuple[float, float]:
    """A value that may lie anywhere between those of two laws: the middle, and the standard deviation of its logarithm."""
    return float(np.sqrt(first * second)), abs(float(np.log(first / second))) / 12**0.5


def find_sizes(about: RecordingMetadata) -> Sizes | None:
    """Stretched sizes of a specimen as an actuator; None where one is not given, or the electrodes are larger than the
    film."""
    geometry, layer, along, across = (
        Geometry.of(about),
        about.layer_thickness_mm,
        about.pre_stretch,
        about.lateral_stretch,
    )
    if geometry is None or layer is None or along is None or across is None or about.film_width_mm is None:
        return None
    if about.active_length_mm is None or about.active_width_mm is None:
        return None
    drawn = (along, across) if about.active_drawn == "undeformed" else (1.0, 1.0)
    try:
        return Sizes(
            length_mm=geometry.length_mm,
            width_mm=about.film_width_mm * across,
            thickness_mm=layer / (along * across),
            active_length_mm=min(about.active_length_mm * drawn[0], geometry.length_mm),
            active_width_mm=about.active_width_mm * drawn[1],
            layers=about.layers or 1,
        )
    except ValueError:
        return None
