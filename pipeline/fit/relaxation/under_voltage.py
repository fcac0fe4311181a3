"""Models of each order against the force under voltage, with the clamp's resonance and without it (thesis, fig 4-14 to 4-17).

With H = −F/V², a = F_A/V² and c = 1 − Mω²/kL + jωcL/kL:

    recorded            H against a/(c + k/kL)
    without_resonance   a H/(a + (1 − c) H) against a/(1 + k/kL): the inertia of the clamp taken out, what the thesis calls F_DE/V²
    resonance_ignored   H against a/(1 + k/kL): what the clamp costs a model that knows nothing of it

Only the load cell's compliance shows k. Does not belong here: the fits (`electrical`), the blocked force (`transform.correction`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.fit.relaxation.metrics import errors
from pipeline.fit.relaxation.predict import AMPLITUDE
from pipeline.fit.relaxation.results import RelaxationFit, SpecimenFits
from pipeline.physics.rig import rig_of_constants, rig_prior
from pipeline.transform.response import FrequencyResponse
from schemas.arrays import Bool, Complex, Float
from schemas.metadata import RigConstants

RECORDED, WITHOUT_RESONANCE, RESONANCE_IGNORED = "recorded", "without_resonance", "resonance_ignored"


@dataclass(frozen=True)
class OrderUnderVoltage:
    """What the model of one order leaves of one recording, over its usable lines.

    Means of the magnitude's error in N/kV² and of the phase's in degrees (thesis, eq 4.14); `relative_error` is the root mean
    square of |model/measured − 1|.
    """

    recording_id: str | None
    voltage_kv: float | None
    model_order: int
    form: str
    magnitude_error_n_per_kv2: float
    relative_error: float
    phase_error_deg: float
    frequency_lines: int


@dataclass(frozen=True)
class CurveUnderVoltage:
    """Measured or modelled force per voltage squared (n,) N/kV² of one recording in one form; `model_order` None: measured."""

    recording_id: str | None
    voltage_kv: float | None
    form: str
    model_order: int | None
    frequency_hz: Float
    value: Complex
    standard_error: Float
    usable: Bool


def compare_orders(
    fits: SpecimenFits,
    responses: Sequence[FrequencyResponse],
    rigs: Sequence[RigConstants | None],
    voltages_kv: Sequence[float | None],
) -> tuple[tuple[OrderUnderVoltage, ...], tuple[CurveUnderVoltage, ...]]:
    """Errors of every order in the three forms, and the curves of the first two, recording by recording.

    Parameters
    ----------
    fits : electrical models, each with its F_A/V²
    responses : force per voltage squared, measured
    rigs, voltages_kv : rig and peak voltage of each response

    Returns
    -------
    Errors, and curves: measured ones are freed of the resonance with the constants of the chosen order
    """
    found: list[OrderUnderVoltage] = []
    curves: list[CurveUnderVoltage] = []
    ordered = sorted(fits.fits, key=lambda fit: fit.order == fits.selected_order)
    for response, rig, voltage in zip(responses, rigs, voltages_kv, strict=True):
        for fit in ordered:
            forms = _forms(fit, response, rig)
            if forms is None or not response.usable.any():
                continue
            good = response.usable
            for form, (measured, model, _) in forms.items():
                e = errors(model[good], measured[good])
                if e is None:
                    continue
                found.append(
                    OrderUnderVoltage(
                        response.recording_id, voltage, fit.order, form, e.magnitude, e.relative, e.phase_deg, e.lines
                    )
                )
            for form in (RECORDED, WITHOUT_RESONANCE):
                measured, model, slope = forms[form]
                curve = CurveUnderVoltage(
                    response.recording_id, voltage, form, fit.order, response.frequency_hz, model,
                    np.full(model.size, np.nan), good,
                )  # fmt: skip
                curves.append(curve)
                if fit.order == fits.selected_order:
                    error = np.abs(slope) * response.standard_error
                    curves.append(replace(curve, model_order=None, value=measured, standard_error=error))
    return tuple(found), tuple(curves)


def _forms(
    fit: RelaxationFit, response: FrequencyResponse, rig: RigConstants | None
) -> dict[str, tuple[Complex, Complex, Complex]] | None:
    """By form: measured and modelled values (n,), and the slope of the measured one in H; None without load cell or F_A/V²."""
    prior = rig_prior(rig)
    if prior is None or AMPLITUDE not in fit.estimates:
        return None
    a = fit.estimates[AMPLITUDE].value
    own = rig_of_constants(fit.constants(prior))
    clamp = own.clamp(2 * np.pi * response.frequency_hz)
    k, h = fit.model.stiffness(response.frequency_hz), response.value / own.gain
    still = a / (1 + k * own.compliance)
    inertia = a + (1 - clamp) * h
    return {
        RECORDED: (h, a * own.electrical(k, clamp) / own.gain, np.ones_like(h)),
        WITHOUT_RESONANCE: (a * h / inertia, still, a**2 / inertia**2),
        RESONANCE_IGNORED: (h, still, np.ones_like(h)),
    }
