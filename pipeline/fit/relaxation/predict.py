"""Cross-prediction: the model of one loading or protocol against recordings of another.

No shape parameter is fitted. The mechanical model predicts an electrical response up to one factor F_A/V², which is taken from
the fit where it has it, from a value that is given (ε0 εr w/z), or as the one common factor that fits best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.fit.relaxation.metrics import Errors, errors
from pipeline.fit.relaxation.results import RelaxationFit, SpecimenFits
from pipeline.physics.rig import rig_of_constants, rig_prior
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, FrequencyResponse
from schemas.arrays import Complex
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants

AMPLITUDE = "force_per_voltage_squared_n_per_kv2"


@dataclass(frozen=True)
class Prediction:
    """A row of `predictions`: mean absolute errors of magnitude (unit of the response) and phase, and the relative error."""

    specimen_id: str
    fitted_on: str
    predicted: str
    magnitude_error: float
    phase_error_deg: float
    relative_error: float
    lines: int


def predict_response(
    fit: RelaxationFit, response: FrequencyResponse, rig: RigConstants | None, amplitude: float | None = None
) -> Complex:
    """What film and rig would show at the lines of `response` (m,). Electrical responses need `amplitude` in N/kV².

    Rig constants are the fitted ones where the fit saw the same rig. Raises `NotIdentifiableError` for an electrical response
    without load-cell stiffness.
    """
    k = fit.model.stiffness(response.frequency_hz)
    prior = rig_prior(rig)
    electrical = response.quantity == FORCE_PER_VOLTAGE_SQUARED
    if prior is None:
        if electrical:
            raise NotIdentifiableError(
                "an electrical response without the load cell's stiffness cannot be predicted",
                where=response.recording_id or "",
                expected="load_cell_stiffness_n_per_mm in the rig file",
                remedy="Add the clamp and load-cell constants to the rig file",
            )
        return k
    own = rig_of_constants(fit.constants(prior))
    clamp = own.clamp(2 * np.pi * response.frequency_hz)
    return (amplitude or 1.0) * own.electrical(k, clamp) if electrical else own.mechanical(k, clamp)


def prediction_errors(
    fit: RelaxationFit,
    responses: Sequence[FrequencyResponse],
    rigs: Sequence[RigConstants | None],
    amplitude: float | None = None,
) -> Errors | None:
    """Errors over the usable lines of all responses together (of one quantity); None where there is none."""
    pairs = [(r.only_usable(), rig) for r, rig in zip(responses, rigs, strict=True) if r.usable.any()]
    if not pairs:
        return None
    measured = np.concatenate([r.value for r, _ in pairs])
    electrical = pairs[0][0].quantity == FORCE_PER_VOLTAGE_SQUARED
    if electrical and amplitude is None and AMPLITUDE in fit.estimates:
        amplitude = fit.estimates[AMPLITUDE].value
    unit = np.concatenate([predict_response(fit, r, rig, 1.0 if electrical else None) for r, rig in pairs])
    if electrical:
        weight = 1 / np.abs(measured) ** 2
        if amplitude is None:
            fitted = (weight * (unit.conj() * measured).real).sum() / (weight * np.abs(unit) ** 2).sum()
            amplitude = float(fitted)
        unit = unit * amplitude
    return errors(unit, measured)


def predict(
    fits: SpecimenFits,
    responses: Sequence[FrequencyResponse],
    rigs: Sequence[RigConstants | None],
    *,
    predicted: str,
    fitted_on: str | None = None,
    amplitude: float | None = None,
) -> Prediction | None:
    """The chosen model against recordings that it was not fitted on; None where they have no usable line.

    `predicted` and `fitted_on` are labels (loading or protocol; default the fit's loading).
    """
    found = prediction_errors(fits.selected, responses, rigs, amplitude)
    if found is None:
        return None
    return Prediction(
        fits.specimen_id,
        fitted_on or fits.loading,
        predicted,
        found.magnitude,
        found.phase_deg,
        found.relative,
        found.lines,
    )
