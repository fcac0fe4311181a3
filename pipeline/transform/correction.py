"""The clamp on its load cell taken out of a measured response: film stiffness, and blocked force under voltage.

For display and for comparison with the thesis; a fit puts clamp and load cell into its model instead. The noise goes
into `variance`; errors of the constants move all frequencies together and go into `systematic`. The equations are those
of `pipeline.physics.rig`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from pipeline.physics.rig import RigPrior
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, STIFFNESS, FrequencyResponse
from schemas.arrays import Complex, Float
from schemas.metadata import RigConstants

Response = TypeVar("Response", FrequencyResponse, RelaxationCurve)

HIGHEST_AMPLIFICATION = 5.0
"""Beyond it the recording holds too little about the film: near the clamp's own frequency the clamp moves with the
driven end and the film is hardly deformed."""
LARGEST_OWN_DEFORMATION = 1.0
"""Deformation of a machine's transducer over the specimen's beyond which the difference of the two, which is the
specimen, is mostly the transducer: its phase error decides the loss."""
LARGEST_SYSTEMATIC = 0.3
"""Relative error by the rig's constants beyond which a corrected line is not usable."""


def correct_mechanical(
    response: FrequencyResponse, rig: RigConstants, *, thesis_sign: bool = False
) -> FrequencyResponse:
    """Dynamic stiffness of the film from G = F/x0.

    Parameters
    ----------
    response : measured stiffness G, n lines
    rig : what the rig file says
    thesis_sign : the printed eq 4.21, whose inertia term has the wrong sign: for comparison only

    Returns
    -------
    Response k in N/mm. `variance` is the noise alone, |∂k/∂G|² σ_G²; `systematic` (n, r) the prior of the rig's
    constants, fully correlated over frequency; `amplification` |1 + k/(kL − Mω² + jωcL)|. Lines with an amplification
    above 5 are not usable.

    Raises
    ------
    NotIdentifiableError
        A constant of the rig is missing; it names the key.
    ValueError
        The response is no stiffness.
    """
    if response.quantity != STIFFNESS:
        raise ValueError(f"a {response.quantity} is not a measured stiffness")
    prior = _printed_sign(RigPrior.of(rig)) if thesis_sign else RigPrior.of(rig)
    response = calibrated(response, rig)
    omega, g, own = 2 * np.pi * response.frequency_hz, response.value, prior.rig
    k = own.film_stiffness(g, own.clamp(omega))
    derivative, by_constants = own.film_stiffness_slopes(g, omega)
    amplification = 1 / np.maximum(np.abs(1 - g * own.compliance), np.finfo(float).tiny)
    corrected = _corrected(response, k, np.abs(derivative) ** 2, by_constants @ prior.factor, prior)
    corrected = replace(
        corrected, amplification=amplification, details={**corrected.details, "thesis_sign": thesis_sign}
    )
    return _marked(corrected)


def blocked_force(
    response: FrequencyResponse,
    stiffness: Complex,
    rig: RigConstants,
    *,
    stiffness_systematic: Complex | None = None,
) -> FrequencyResponse:
    """Blocked force F_A/V² in N/kV² from H = −F/V² and the film's stiffness k (n,) N/mm at the lines of `response`.

    Parameters
    ----------
    response : measured force per voltage squared, n lines
    stiffness : (n,) N/mm, film stiffness at these lines
    rig : what the rig file says
    stiffness_systematic : (n, m) factor of the covariance of k (k = k̂ + S z, z standard normal)

    Returns
    -------
    Blocked force: flat, ε0 εr w/z, when drive, permittivity and k are right. The relative noise does not change:
    amplification is 1.

    Raises
    ------
    NotIdentifiableError
        A constant of the rig is missing; it names the key.
    ValueError
        The response is no force per voltage squared, or not as long as `stiffness`.
    """
    if response.quantity != FORCE_PER_VOLTAGE_SQUARED:
        raise ValueError(f"a {response.quantity} is not a measured force per voltage squared")
    if stiffness.shape != response.frequency_hz.shape:
        raise ValueError(f"stiffness has shape {stiffness.shape}, frequency_hz {response.frequency_hz.shape}")
    prior = RigPrior.of(rig)
    response = calibrated(response, rig)
    omega, h, own = 2 * np.pi * response.frequency_hz, response.value, prior.rig
    derivative, by_constants = own.blocked_force_slopes(h, stiffness, omega)
    systematic = by_constants @ prior.factor
    if stiffness_systematic is not None:
        systematic = np.column_stack([systematic, stiffness_systematic * (h * own.compliance)[:, None]])
    blocked = own.blocked_force(h, stiffness, own.clamp(omega))
    corrected = _corrected(response, blocked, np.abs(derivative) ** 2, systematic, prior)
    return _marked(replace(corrected, amplification=np.ones_like(omega)))


def judged_machine(response: FrequencyResponse, own_deformation: Float | None) -> FrequencyResponse:
    """A film's response that a machine corrected for its own compliance itself, with what that leaves unusable.

    `own_deformation` (n,): displacement of the transducer over that of the specimen, NaN or None where unknown. The
    transducer is a spring in series, so that `amplification` is |1 + k/kT| with |k/kT| this ratio and the phase of k. A
    loss below zero by more than two standard errors (by anything where none is known) is no film's.
    """
    if own_deformation is not None:
        size = np.maximum(np.abs(response.value), np.finfo(float).tiny)
        amplification = np.abs(1 + np.nan_to_num(own_deformation) * response.value / size)
        response = replace(response, amplification=np.where(np.isfinite(own_deformation), amplification, np.nan))
        for line in np.flatnonzero(own_deformation > LARGEST_OWN_DEFORMATION):
            reason = f"the transducer deforms {own_deformation[line]:.2g} times as much as the specimen"
            response = response.mark(np.arange(own_deformation.size) == line, reason)
    error = np.nan_to_num(response.standard_error) / np.sqrt(2)
    return response.mark(response.value.imag < -2 * error, "negative loss: no film gives energy back")


def calibrated(response: Response, rig: RigConstants) -> Response:
    """The response with the calibrated gain of the force channel taken out, `rig.force_gain` (recorded over true
    force).

    Doing it twice does it once: the gain that was taken out stands in `details`. The gain's own uncertainty belongs to
    `systematic`, which the corrections fill.
    """
    gain = rig.force_gain or 1.0
    factor = float(response.details.get("force_gain", 1.0)) / gain
    if factor == 1.0:
        return response
    details = {**response.details, "force_gain": gain}
    if isinstance(response, RelaxationCurve):
        return replace(
            response,
            stiffness=response.stiffness * factor,
            variance=response.variance * factor**2,
            rest_variance=response.rest_variance * factor**2,
            details=details,
        )
    noise, systematic = response.noise_variance, response.systematic
    return replace(
        response,
        value=response.value * factor,
        variance=response.variance * factor**2,
        noise_variance=None if noise is None else noise * factor**2,
        systematic=None if systematic is None else systematic * factor,
        details=details,
    )


def resonance_free(ratio: Complex, frequency_hz: Float, rig: RigConstants, *, thesis_sign: bool = False) -> Complex:
    """−F/(F_A − Mÿ − cLẏ) with y = −x′ from the ratio −F/F_A (n,): kL/(kL + k), as thesis fig 4-17 means to show it.

    Parameters
    ----------
    ratio : (n,) −F/F_A
    frequency_hz : (n,) Hz
    rig : what the rig file says
    thesis_sign : the printed eq 4.22, whose inertia terms have the wrong sign and no damping: for comparison only

    Returns
    -------
    (n,); it still depends on the rig through k/kL

    Raises
    ------
    NotIdentifiableError
        A constant of the rig is missing; it names the key.
    """
    prior = _printed_sign(RigPrior.of(rig)) if thesis_sign else RigPrior.of(rig)
    clamp = prior.rig.clamp(2 * np.pi * frequency_hz)
    # The printed numerator holds the inertia as well.
    return np.asarray((clamp if thesis_sign else 1.0) * ratio / (1 + (1 - clamp) * ratio))


def _printed_sign(prior: RigPrior) -> RigPrior:
    """The rig as the printed eq 4.18 has it: no damping, and the clamp's inertia with the sign of a negative mass."""
    sign = np.array([-1.0, 1.0, 0.0, 1.0])
    return RigPrior(prior.nominal * sign, prior.factor * sign[:, None], prior.presumed)


def _corrected(
    response: FrequencyResponse, value: Complex, factor: Float, systematic: Complex, prior: RigPrior
) -> FrequencyResponse:
    noise = response.noise_variance
    return replace(
        response,
        value=value,
        variance=response.variance * factor,
        noise_variance=None if noise is None else noise * factor,
        systematic=systematic,
        details={**response.details, "assumed": list(prior.assumed)},
    )


def _marked(response: FrequencyResponse) -> FrequencyResponse:
    if response.amplification is not None:
        response = response.mark(
            ~(response.amplification <= HIGHEST_AMPLIFICATION),
            f"clamp and load-cell resonance: relative noise grows more than {HIGHEST_AMPLIFICATION:g} times",
        )
    size = np.maximum(np.abs(response.value), np.finfo(float).tiny)
    if response.systematic is not None:
        spread = np.sqrt((np.abs(response.systematic) ** 2).sum(axis=1))
        response = response.mark(
            spread > LARGEST_SYSTEMATIC * size, f"constants of the rig: error above {LARGEST_SYSTEMATIC:.0%}"
        )
    return response.mark(
        response.standard_error > LARGEST_SYSTEMATIC * size, "noise: standard error above 30 % of the response"
    )
