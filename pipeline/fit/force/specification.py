"""What a film can do as an actuator, held against what suppressing a tremor asks for (thesis, section 1.3).

    blocked force F = a V²,   free stroke x(f) = F/|k(j2πf)|,   bandwidth: |k| = √2 k0,   efficiency F x(f)/4 over ½ C V²

a = F_A/V² as the ends feel it and k(jω) are the specimen's own; V is the largest voltage it was driven with. A film gives its force
and its stroke at once only in part: on the line from F to x it gives most work at half of each. Layers side by side add their
forces, strips behind each other their strokes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from pipeline.fit.relaxation.results import RelaxationFit
from schemas.arrays import Float

FORCE_N, STROKE_MM, FREQUENCY_HZ = 0.4, 1.0, 10.0
"""What the tremor of a hand asks for: an amplitude up to 1 mm at up to 10 Hz, against a force up to 0.4 N."""
_NORMAL = 1.959964
_WIDEST_HZ = 1e4
"""Frequency up to which a bandwidth is looked for; the model says nothing beyond what was measured."""


@dataclass(frozen=True)
class Drive:
    """The force of a specimen over the square of the voltage, N/kV², with its standard deviation, and the largest voltage, kV."""

    force_per_voltage_squared: float
    sd: float
    voltage_kv: float


@dataclass(frozen=True)
class Requirement:
    """One quantity of a specimen with its 95 % limits, beside what is asked for.

    `meets`: the whole interval does. `multiple`: how many layers (force) or strips (stroke) would, each giving half of what it
    can so that both are there at once; counted from the unfavourable limit. None where nothing can be multiplied.
    """

    quantity: str
    value: float
    value_lower: float
    value_upper: float
    unit: str
    required: float | None
    meets: bool | None
    multiple: int | None
    multiplied: str | None
    note: str


def specify(
    drive: Drive, fit: RelaxationFit | None, active_mm: float | None, share: float, highest_hz: float
) -> list[Requirement]:
    """The sheet of one specimen.

    Parameters
    ----------
    drive : force under voltage
    fit : mechanical model; None: only the force is known
    active_mm : stretched length of the active region, mm; None: no efficiency
    share : of the active force that the ends feel, where passive film lies in series
    highest_hz : highest frequency that the model rests on

    Returns
    -------
    Force, and where a model is known stroke at rest and at 10 Hz, bandwidth and efficiency; limits from the covariance of the fit
    and the standard deviation of the force, taken as independent
    """
    a, relative = drive.force_per_voltage_squared, drive.sd / drive.force_per_voltage_squared
    force = a * drive.voltage_kv**2
    sheet = [_judge("force", force, relative, "N", FORCE_N, "layers", f"blocked, at {drive.voltage_kv:.3g} kV")]
    if fit is None:
        return sheet
    at = np.array([1e-6, FREQUENCY_HZ])
    k = np.abs(fit.model.stiffness(at))
    soft = np.hypot(relative, _relative_sd(fit, at))
    strokes = force / k
    beyond = "" if highest_hz >= FREQUENCY_HZ else f"; the model rests on frequencies up to {highest_hz:.3g} Hz"
    sheet.append(
        _judge("stroke at rest", float(strokes[0]), float(soft[0]), "mm", None, None, "free, once the film has relaxed")
    )
    sheet.append(
        _judge(
            "stroke",
            float(strokes[1]),
            float(soft[1]),
            "mm",
            STROKE_MM,
            "strips",
            f"free, at {FREQUENCY_HZ:g} Hz{beyond}",
        )
    )
    width = bandwidth(fit)
    if width is not None:
        value, sd = width
        note = "the stroke falls to 71 % of that at rest" + ("; beyond what was measured" if value > highest_hz else "")
        sheet.append(_judge("bandwidth", value, sd, "Hz", FREQUENCY_HZ, None, note))
    if active_mm:
        efficiency = float(strokes[1]) / (2 * active_mm) * share
        note = f"work into a matched load at {FREQUENCY_HZ:g} Hz over the electrical energy of a charge, losses of the film in it"
        sheet.append(_judge("efficiency", efficiency, float(soft[1]), "", None, None, note))
    return sheet


def bandwidth(fit: RelaxationFit) -> tuple[float, float] | None:
    """Frequency in Hz at which |k| = √2 k0, and its relative standard deviation; None where the film does not stiffen so far."""

    def rise(log_f: float) -> float:
        at = np.exp([-14.0, log_f])
        low, high = np.abs(fit.model.stiffness(at))
        return math.log(high / low) - 0.5 * math.log(2)

    low, high = math.log(1e-4), math.log(_WIDEST_HZ)
    if rise(low) >= 0 or rise(high) <= 0:
        return None
    root = float(brentq(rise, low, high))
    at = np.exp([-14.0, root])
    slopes = fit.slopes(at) / fit.model.stiffness(at)[:, None]
    gradient = slopes[1].real - slopes[0].real
    steepness = (rise(root + 1e-4) - rise(root - 1e-4)) / 2e-4
    return math.exp(root), float(np.sqrt(max(gradient @ fit.covariance @ gradient, 0.0))) / abs(steepness)


def _relative_sd(fit: RelaxationFit, frequency_hz: Float) -> Float:
    """(n,) standard deviation of ln |k| at frequencies (n,)."""
    slopes = (fit.slopes(frequency_hz) / fit.model.stiffness(frequency_hz)[:, None]).real
    return np.asarray(np.sqrt(np.maximum(np.einsum("fi,ij,fj->f", slopes, fit.covariance, slopes), 0.0)))


def _judge(
    quantity: str,
    value: float,
    relative_sd: float,
    unit: str,
    required: float | None,
    multiplied: str | None,
    note: str,
) -> Requirement:
    """Limits as of a quantity whose logarithm is normal."""
    reach = math.exp(_NORMAL * relative_sd)
    lower, upper = value / reach, value * reach
    multiple = math.ceil(2 * required / lower - 1e-9) if multiplied and required and lower > 0 else None
    meets = None if required is None else lower >= required
    return Requirement(
        quantity, value, lower, upper, unit, required, meets, multiple, multiplied if multiple else None, note
    )
