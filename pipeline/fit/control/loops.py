"""Closed loops over films of a model, many at once: what a step of the demand does to voltage, capacitance and force.

The loop is that of a laboratory: an amplifier with a rise and a fall of its own, a filter before the controller, a
decision per sample. Without noise; the virtual rig (`pipeline.simulate`) has noise, clamp and load cell as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pipeline.physics.controllers import Controller
from pipeline.physics.sensed_film import SensedFilms
from pipeline.transform.loop import BAND, FINAL_S, FINAL_SHARE
from schemas.arrays import Bool, Float

_UNSETTLED = 0.9
"""A response that leaves the band after this share of the hold has not settled."""


@dataclass(frozen=True)
class Electronics:
    """What closes the loop around a film.

    Parameters
    ----------
    largest_kv : largest voltage
    gain_kv_per_v : of the amplifier
    time_constant_s : of the amplifier; it follows a command as a first-order lag
    filter_hz : cut-off of the controller's single-pole filter
    interval_s : from one decision to the next
    """

    largest_kv: float
    gain_kv_per_v: float = 1.5
    time_constant_s: float = 0.02
    filter_hz: float = 10.0
    interval_s: float = 0.01

    @property
    def lag_s(self) -> float:
        """All lags together."""
        return self.time_constant_s + 1 / (2 * math.pi * self.filter_hz)


@dataclass(frozen=True)
class Courses:
    """Courses after a step of the demand in n loops, at (t,) s.

    `voltage_kv`, `capacitance_pf` (change from rest) and `force_n` (drop of tension) are (n, t); `demand_pf` is the
    step.
    """

    time_s: Float
    voltage_kv: Float
    capacitance_pf: Float
    force_n: Float
    demand_pf: float


@dataclass(frozen=True)
class Performance:
    """What n loops did, (n,) each, by the definitions of measured loops (`pipeline.transform.loop`). NaN: never rose,
    or not settled at the end of the hold. Overshoots in percent: of the capacitance over the demand, of the force over
    the one that is held at the end.
    """

    rise_time_s: Float
    settling_time_s: Float
    overshoot_percent: Float
    force_overshoot_percent: Float
    peak_kv: Float


def simulate_loops(
    films: SensedFilms, controller: Controller, demand_pf: float, hold_s: float, electronics: Electronics
) -> Courses:
    """A step of the demand, from rest, for each film.

    Parameters
    ----------
    films : (n) that the controller may be on
    controller : what decides
    demand_pf : step of the capacitance, of the sign that a voltage gives it
    hold_s : how long the demand is held
    electronics : the rest of the loop

    Returns
    -------
    Courses at the moments of decision
    """
    n, own = len(films), electronics
    h, ticks = own.interval_s, round(hold_s / own.interval_s)
    loop = controller.start(n, h)
    advance, gather = films.propagate(h)
    points, voltage, seen = np.zeros_like(films.springs), np.zeros(n), np.zeros(n)
    keep = math.exp(-2 * math.pi * own.filter_hz * h)
    tau = max(own.time_constant_s, 1e-9)
    stay = math.exp(-h / tau)
    courses = np.empty((3, ticks, n))
    for tick in range(ticks):
        extension = films.extend(points, voltage**2)
        capacitance = films.gain_pf_per_kv2 * extension
        courses[:, tick] = voltage, capacitance, films.force_n_per_kv2 * voltage**2
        seen = keep * seen + (1 - keep) * capacitance
        wanted = np.minimum(np.maximum(loop.decide(seen, demand_pf), 0.0), own.largest_kv)
        gap = voltage - wanted
        # Mean of V² over the interval, with V = wanted + gap e^(-t/τ).
        squared = wanted**2 + (2 * wanted * gap * (1 - stay) + gap**2 * (1 - stay**2) / 2) * tau / h
        points = np.einsum("nij,nj->ni", advance, points) + gather * squared[:, None]
        voltage = wanted + gap * stay
    volts, capacitance, force = courses.transpose(0, 2, 1)
    return Courses(np.arange(ticks, dtype=float) * h, volts, capacitance, force, demand_pf)


def measure_performance(courses: Courses) -> Performance:
    """Rise, settling and overshoots of each loop."""
    t, y = courses.time_s, courses.capacitance_pf / courses.demand_pf
    hold = float(t[-1])
    late = t >= hold - min(FINAL_S, FINAL_SHARE * hold)
    held = courses.force_n[:, late].mean(axis=1)
    outside = np.abs(y - 1) > BAND
    last = y.shape[1] - 1 - np.argmax(outside[:, ::-1], axis=1)
    settling = np.where(outside.any(axis=1), t[np.minimum(last + 1, t.size - 1)], 0.0)
    settling = np.where((settling > _UNSETTLED * hold) | ~np.isfinite(y).all(axis=1), np.nan, settling)
    with np.errstate(invalid="ignore", divide="ignore"):
        force = np.where(held > 0, 100 * (courses.force_n.max(axis=1) / held - 1), np.nan)
    return Performance(
        _first(y >= 0.9, t) - _first(y >= 0.1, t),
        settling,
        np.maximum(100 * (y.max(axis=1) - 1), 0.0),
        np.maximum(force, 0.0),
        courses.voltage_kv.max(axis=1),
    )


def _first(there: Bool, t: Float) -> Float:
    return np.where(there.any(axis=1), t[np.argmax(there, axis=1)], np.nan)
