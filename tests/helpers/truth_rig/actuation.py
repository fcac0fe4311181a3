"""From the voltage on the film to the squared voltage that acts, at half steps.

The plain rig: V². Everything here returns a squared voltage in kV², (n,), or a factor. Does not belong here: the force
constant, which the specimen has.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.helpers.truth_rig.jit import kernel

Float = NDArray[np.float64]

DEBYE_TIMES_S = np.logspace(-3, 1, 8)
_REFERENCE_HZ = 10.0


def saturating(voltage: Float, fraction: float, highest: float, form: str) -> Float:
    """Share of the permittivity left at each voltage, 1 − `fraction` at `highest`."""
    x = (voltage / highest) ** 2
    fall = np.tanh(x) / math.tanh(1.0) if form == "saturating" else x * x
    return np.asarray(1 - fraction * fall)


def dispersed(squared: Float, step: float, per_decade: float) -> Float:
    """Squared voltage through a ladder of Debye relaxations, 1 at 10 Hz, falling by `per_decade` per decade."""
    each = per_decade * (np.log10(DEBYE_TIMES_S[-1] / DEBYE_TIMES_S[0])) / (DEBYE_TIMES_S.size - 1)
    slow = each / (1 + (2 * np.pi * _REFERENCE_HZ * DEBYE_TIMES_S) ** 2)
    out = squared * (1 - slow.sum())
    for tau in DEBYE_TIMES_S:
        decay = math.exp(-step / tau)
        out += each * lfilter([1 - decay], [1, -decay], squared)
    return np.asarray(out)


def exposure(squared: Float, step: float, highest: float, before_s: float) -> Float:
    """Seconds at the highest voltage of the session that the electrodes have seen, ∫(V/V_max)²dt."""
    return np.asarray(before_s + np.cumsum(squared) * (step / highest**2))


def degraded(exposure_s: Float, loss: float, scale_s: float, stretch: float) -> Float:
    """Share of the electrodes left after an exposure."""
    return np.asarray(1 - loss * -np.expm1(-((exposure_s / scale_s) ** stretch)))


@kernel
def wrinkled(squared, step, onset, rise_s, recovery_s, hysteresis, held):
    """Squared voltage that acts once the film wrinkles above the `onset` voltage, and the wrinkling left at the end.

    Wrinkles take three quarters of what V² grows by at the onset and nearly all of it well above, with delay `rise_s`, and
    go back with `recovery_s`; they begin at the onset and end at a voltage lower by `hysteresis`. `held` kV² is what the
    last recording left.
    """
    out = np.empty(squared.size)
    begin, end = onset**2, (onset * (1 - hysteresis)) ** 2
    inside = held > 0.0
    for i in range(squared.size):
        if squared[i] > begin:
            inside = True
        elif squared[i] < end:
            inside = False
        excess = max(squared[i] - begin, 0.0) if inside else 0.0
        target = excess * (1 - 0.25 * math.exp(-excess / (0.3 * begin)))
        held += (target - held) * -math.expm1(-step / (rise_s if target > held else recovery_s))
        out[i] = max(squared[i] - held, 0.0)
    return out, held


@kernel
def attracted(squared, step, share, highest, charge_s):
    """Further squared voltage by attraction to the frame: V⁴ times a charge that builds up while the voltage is on."""
    out = np.empty(squared.size)
    charge = 0.0
    for i in range(squared.size):
        level = squared[i] / highest**2
        charge += (min(level, 1.0) - charge) * -math.expm1(-step / charge_s)
        out[i] = share * squared[i] * level * charge
    return out
