"""From the command to the voltage of the monitor and the voltage on the film, at half steps.

Voltages in kV, (n,) arrays. Each stage returns its input unchanged where its effect is absent.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from tests.helpers.truth_rig.jit import kernel

Float = NDArray[np.float64]

BLEED_MOHM = 33.0
_BLEND_KV = 0.05


@kernel
def lagged(wanted, step, rise_s, fall_s, slew):
    """Amplifier that rises and falls with different time constants, its rate bent by tanh towards `slew` kV/s.

    The constants blend over 50 V of the error; a second pole of a tenth of the first follows. Poles are exact for a command
    that is linear within a step, however fast they are.
    """
    out = np.empty(wanted.size)
    first, second = wanted[0], wanted[0]
    out[0] = second
    for i in range(1, wanted.size):
        error = wanted[i] - first
        rising = 0.5 * (1 + math.tanh(error * (1.0 if wanted[i] >= 0 else -1.0) / _BLEND_KV))
        tau = fall_s + (rise_s - fall_s) * rising
        behind = (wanted[i - 1] - first) * math.exp(-step / tau) - (
            wanted[i] - wanted[i - 1]
        ) * tau / step * math.expm1(-step / tau)
        reach = wanted[i] - behind - first
        limit = slew * step
        before = first
        first += limit * math.tanh(reach / limit)
        fast = 0.1 * tau
        behind = (before - second) * math.exp(-step / fast) - (first - before) * fast / step * math.expm1(-step / fast)
        second = first - behind
        out[i] = second
    return out


@kernel
def drooped(wanted, step, droop, highest, build_up_s):
    """Voltage behind a series resistance that carries the film's own current.

    The current is half ohmic and half sinh(3 V/V_max), scaled so that the voltage at V_max sags by the share `droop` once
    the current has built up from 60 % of it.
    """
    if not wanted.any():  # a session of mechanical tests alone has no largest voltage
        return wanted
    out = np.empty(wanted.size)
    built = 0.0
    for i in range(wanted.size):
        v = wanted[i]
        share = 0.6 + 0.4 * built
        for _ in range(6):
            r = abs(v) / highest
            shape = 1.0 if r < 1e-9 else 0.5 * (1 + math.sinh(3 * r) / (r * math.sinh(3.0)))
            v = wanted[i] / (1 + droop / (1 - droop) * shape * share)
        out[i] = v
        level = min(abs(v) / highest, 1.0)
        built += (level - built) * -math.expm1(-step / build_up_s)
    return out


def leakage_current(wanted: Float, film: Float) -> Float:
    """Current in µA through the series resistance."""
    return np.asarray((wanted - film) / BLEED_MOHM * 1e3)


def offset(voltage: Float, offset_kv: float, time_s: Float, middle_s: float) -> Float:
    """Film voltage with a trapped offset that creeps by ± 20 % around its value over the session."""
    return np.asarray(voltage + offset_kv * (1 + 0.2 * np.tanh((time_s - middle_s) / max(middle_s, 1.0))))


def dead_zone(voltage: Float, zone_kv: float) -> Float:
    """Rectified output: the film sees the voltage's size less a dead zone, softly."""
    size = np.abs(voltage)
    return np.asarray(np.sqrt(np.maximum(size - zone_kv, 0.0) ** 2 + (0.05 * zone_kv) ** 2) - 0.05 * abs(zone_kv))
