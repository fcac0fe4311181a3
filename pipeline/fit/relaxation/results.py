"""What an identification yields: estimates with intervals, a fit per order, and the choice between the orders.

Frozen values only. How they are computed is in `relaxation` and `electrical`; rows of the tables are made in
`pipeline.analyse.model_fits`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pipeline.physics.film import RelaxationModel, Shape, stiffness_and_slopes
from pipeline.physics.rig import RigPrior
from schemas.arrays import Complex, Float

MECHANICAL, ELECTRICAL, JOINT = "mechanical", "electrical", "joint"
FORWARD, CORRECTED, TIME_DOMAIN = "forward", "corrected", "time_domain"
LUMPED = "an arm slower than the data reach was taken into k0"
"""The warning of a fit whose main spring holds a slow arm as well."""
NOISE, UNIFORM, RELATIVE = "noise", "uniform", "relative"
"""Weights of the lines of a fit: by their noise, all alike in N/mm, all alike as a share of their magnitude."""


@dataclass(frozen=True)
class Estimate:
    """One parameter in its unit.

    `sd` is None where no symmetric number describes the uncertainty (at a bound, unresolved). `lower` and `upper` are
    95 % limits; None where the data set no limit on that side. `method` is `wald` (curvature of the log-likelihood in the
    log parameter), `profile` (profile likelihood) or `none`.
    """

    value: float
    sd: float | None = None
    lower: float | None = None
    upper: float | None = None
    method: str = "none"


@dataclass(frozen=True)
class Positivity:
    """Can relaxation of any order explain the response?

    The best non-negative spectrum on a dense grid of relaxation times is at least as good as a model of any order. If even
    that misses the data beyond their noise, arms cannot help: the cause is in the rig, the sensor or a nonlinearity.

    Parameters
    ----------
    chi2_per_line : χ² of that spectrum over the number of real data (near 1 when the response is a relaxation)
    p_value : probability of a χ² at least this large if the response is a relaxation and the variances are right
    raised : the alarm (p below 0.1 %); never raised where the variance was estimated from this very misfit
    statement : the result in words
    """

    chi2_per_line: float
    p_value: float
    raised: bool
    statement: str


@dataclass(frozen=True)
class Spread:
    """Differences between recordings of one specimen beyond their noise.

    `gain_sd` is the standard deviation of the logarithm of a common factor per recording; `relative_sd` the additional
    relative scatter per line that neither noise nor such factors explain. `gains` has the factor of each recording.
    """

    gain_sd: float = 0.0
    relative_sd: float = 0.0
    gains: Mapping[str, float] = field(default_factory=dict)


def find_slopes(theta: Float, shape: Shape, names: tuple[str, ...], c_inf: float, frequency_hz: ArrayLike) -> Complex:
    """∂k/∂θ (m, p) N/mm at (m,) Hz by the parameters called `names`, p in all; 0 for those of the rig.

    Parameters
    ----------
    theta : parameters, those of the material first
    shape : which of them are the material's
    names : of all parameters; a last "1/k…" is the spring of a pure dashpot, held at 0
    c_inf : N s/mm, that dashpot
    """
    omega = 2 * np.pi * np.atleast_1d(np.asarray(frequency_hz, dtype=float))
    slopes = np.zeros((omega.size, len(names)), dtype=complex)
    slopes[:, : shape.size] = stiffness_and_slopes(theta, shape, omega)[1]
    if names[-1].startswith("1/k"):
        slopes[:, -1] = (omega * c_inf) ** 2
    return slopes


@dataclass(frozen=True)
class RelaxationFit:
    """One model of one order.

    Parameters
    ----------
    order : number of arms that were asked for; the model has fewer where the data do not carry them (`warnings` say so)
    model : the fitted model
    estimates : by name: `k0`, `k1`…, `c1`…, `tau1`… in N/mm, N s/mm, s (arms longest first; a pure dashpot has no k and no
        tau), `clamp_mass_kg`, `load_cell_stiffness_n_per_mm`, `load_cell_damping_n_s_per_mm`,
        `force_per_voltage_squared_n_per_kv2`
    names : (p,) names of the parameters that `covariance` is about: logarithms of the material's parameters first, then nuisance
        parameters; last "1/k…" of an arm that was taken for a pure dashpot, held at 0 and free in the covariance
    covariance : (p, p), already widened by the dispersion
    chi2 : weighted sum of squares of data and priors; dispersion : max(1, χ² over degrees of freedom)
    data : number of independent real data; parameters : number of fitted material parameters
    held_out_error : root mean square error on data left out, in standard deviations of the noise
    order_p_value : p of this order against the next; None where the next was not fitted
    residual : (R,) residuals over their component standard deviation: per block real parts, then imaginary parts; then priors
    rigs : priors of the rigs that `names` refers to as "rig 1 direction 1" and so on
    """

    order: int
    model: RelaxationModel
    shape: Shape
    theta: Float
    names: tuple[str, ...]
    covariance: Float
    estimates: Mapping[str, Estimate]
    chi2: float
    dispersion: float
    data: float
    lines: int
    parameters: int
    bic: float
    residual: Float
    rigs: tuple[RigPrior, ...] = ()
    order_p_value: float | None = None
    held_out_error: float | None = None
    magnitude_error: float | None = None
    phase_error_deg: float | None = None
    modulus_mpa: float | None = None
    warnings: tuple[str, ...] = ()

    @property
    def reduced_chi2(self) -> float:
        """χ² over degrees of freedom; NaN where nothing is left over."""
        freedom = self.data - self.parameters
        return self.chi2 / freedom if freedom > 0 else float("nan")

    def constants(self, prior: RigPrior) -> Float:
        """Constants (M, kL, cL, gain) of a rig as this fit has them; the rig file's where the fit did not see that rig."""
        for r, own in enumerate(self.rigs):
            if own.matches(prior):
                places = [i for i, name in enumerate(self.names) if name.startswith(f"rig {r + 1} ")]
                return own.values(self.theta[places])
        return prior.nominal

    @property
    def resolved_arms(self) -> int:
        return self.model.order

    def slopes(self, frequency_hz: ArrayLike) -> Complex:
        """∂k/∂θ (m, p) at (m,) Hz, columns in the order of `names`; 0 for nuisance parameters."""
        return find_slopes(self.theta, self.shape, self.names, self.model.c_inf, frequency_hz)

    def band(self, frequency_hz: ArrayLike) -> Float:
        """√E|Δk|² of the fitted curve in N/mm at (m,) Hz, both components together: √(g C gᴴ)."""
        real, imag = self.component_band(frequency_hz)
        return np.asarray(np.hypot(real, imag))

    def component_band(self, frequency_hz: ArrayLike) -> tuple[Float, Float]:
        """Standard deviations of real and imaginary part of the fitted curve in N/mm at (m,) Hz."""
        slopes, c = self.slopes(frequency_hz), self.covariance
        real, imag = (np.sqrt(np.maximum(np.einsum("mi,ij,mj->m", g, c, g), 0.0)) for g in (slopes.real, slopes.imag))
        return np.asarray(real), np.asarray(imag)


@dataclass(frozen=True)
class SpecimenFits:
    """All orders fitted to one specimen by one method, and the order chosen.

    `weighting` is `noise`, `uniform` or `relative`; only with weights by noise is an order chosen by a test. `choices` has what each rule would choose: `test` (calibrated likelihood-ratio test at 1 %, the rule in force), `bic`,
    `held_out`.
    """

    specimen_id: str
    loading: str
    method: str
    fits: tuple[RelaxationFit, ...]
    selected_order: int
    choices: Mapping[str, int]
    positivity: Positivity | None
    spread: Spread
    frequency_low_hz: float
    frequency_high_hz: float
    warnings: tuple[str, ...] = ()
    weighting: str = NOISE

    @property
    def selected(self) -> RelaxationFit:
        return self.of_order(self.selected_order)

    def of_order(self, order: int) -> RelaxationFit:
        """The fit of that order; `KeyError` where it was not fitted."""
        for fit in self.fits:
            if fit.order == order:
                return fit
        raise KeyError(order)
