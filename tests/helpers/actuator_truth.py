"""Actuators of a relaxing film as they truly are: integrated in time, as a state space, and by the energy of a large
strain.

Shares no code with `pipeline.fit.actuator` or `pipeline.physics`. A film has springs and relaxation times per modulus
(MPa, s), an actuator sizes in mm; forces are N, voltages kV, masses g.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import minimize

from schemas.arrays import Complex, Float

VACUUM = 8.8541878128e-12
"""F/m."""


@dataclass(frozen=True)
class TrueActuator:
    """Moduli E0, Ei in MPa with times in s, permittivity, stretched sizes in mm of one layer of one strip, counts,
    mass, voltage."""

    rest_mpa: float
    arms_mpa: tuple[float, ...]
    tau_s: tuple[float, ...]
    permittivity: float
    length_mm: float
    width_mm: float
    thickness_mm: float
    active_length_mm: float
    active_width_mm: float
    layers: int
    strips: int
    mass_g: float
    voltage_kv: float

    @property
    def force_n(self) -> float:
        """ε E² over the section under the electrodes of all layers, felt at the ends through the passive rest of the
        strip."""
        field = self.voltage_kv * 1e3 / (self.thickness_mm * 1e-3)
        section = self.layers * self.active_width_mm * self.thickness_mm * 1e-6
        return VACUUM * self.permittivity * field**2 * section * self.active_length_mm / self.length_mm

    @property
    def capacitance_f(self) -> float:
        area = self.active_length_mm * self.active_width_mm * 1e-6
        return VACUUM * self.permittivity * area / (self.thickness_mm * 1e-3) * self.layers * self.strips

    def stiffness(self, modulus_mpa: float) -> float:
        """N/mm: strips of layers, one after the other."""
        layer = modulus_mpa * self.width_mm * self.thickness_mm / self.length_mm
        return 1 / sum(1 / (self.layers * layer) for _ in range(self.strips))

    def free_stroke(self, hz: float, periods: int = 12) -> float:
        """Swing in mm between off and on, of a force that goes as a sinusoid between 0 and its full value: integrated
        in time."""
        omega = 2 * math.pi * hz
        k0, k = self.stiffness(self.rest_mpa), [self.stiffness(e) for e in self.arms_mpa]
        tau, mass = np.array(self.tau_s), 1e-6 * self.mass_g
        springs = np.array(k)

        def rate(t: float, y: Float) -> Float:
            x, v, arms = y[0], y[1], y[2:]
            push = self.force_n * math.cos(omega * t) / 2
            return np.concatenate([[v, (push - k0 * x - arms.sum()) / mass], springs * v - arms / tau])

        until = max(periods / hz, 8 * max(self.tau_s))
        until = math.ceil(until * hz) / hz
        t = np.linspace(until - 1 / hz, until, 401)
        y = solve_ivp(rate, (0, until), np.zeros(2 + len(k)), "Radau", t, rtol=1e-6, atol=1e-9 * self.force_n / k0).y[0]
        return float(4 * abs(np.mean((y * np.exp(-1j * omega * t))[:-1])))

    def compliance(self, hz: float) -> Complex:
        """x/F at one frequency, by the matrices of the equations of motion."""
        k0, k = self.stiffness(self.rest_mpa), [self.stiffness(e) for e in self.arms_mpa]
        n, mass = len(k), 1e-6 * self.mass_g
        a = np.zeros((2 + n, 2 + n))
        a[0, 1], a[1, 0], a[1, 2:] = 1, -k0 / mass, -1 / mass
        for i, (spring, tau) in enumerate(zip(k, self.tau_s, strict=True)):
            a[2 + i, 1], a[2 + i, 2 + i] = spring, -1 / tau
        b = np.zeros(2 + n)
        b[1] = 1 / mass
        return np.asarray(np.linalg.solve(2j * math.pi * hz * np.eye(2 + n) - a, b)[0])

    def bandwidth(self, slow_hz: float, highest_hz: float = 1e4) -> float | None:
        """First frequency at which the stroke has fallen to 71 % of that at a slow one, by steps of 0.5 % and a
        chord."""
        slow = 1 / float(abs(self.compliance(slow_hz)))
        before, hz = 1.0, slow_hz
        while hz < highest_hz:
            now = float(abs(self.compliance(hz * 1.005))) * slow
            if now < 0.5**0.5:
                return hz * (1 + 0.005 * (before - 0.5**0.5) / (before - now))
            before, hz = now, hz * 1.005
        return None

    def modulus(self, hz: float) -> float:
        """|E| in MPa of the film at one frequency, by storage and loss."""
        x = [2 * math.pi * hz * tau for tau in self.tau_s]
        storage = self.rest_mpa + sum(e * w**2 / (1 + w**2) for e, w in zip(self.arms_mpa, x, strict=True))
        loss = sum(e * w / (1 + w**2) for e, w in zip(self.arms_mpa, x, strict=True))
        return math.hypot(storage, loss)

    def efficiency(self, hz: float) -> float:
        """Work at half of force and half of stroke over the energy of a charge."""
        work = self.force_n / 2 * float(abs(self.compliance(hz))) * self.force_n / 2 * 1e-3
        return work / (self.capacitance_f * (self.voltage_kv * 1e3) ** 2 / 2)


def energy(x: Sequence[float] | Float, field: float, pull: float, exponent: float, across: float | None) -> float:
    """Energy of a film of Y = 1 under a dead pull and a squared nominal field, per undeformed volume; x are logarithms
    of stretches."""
    x = np.clip(x, -3, 3)  # a film that runs away ends there
    along, side = np.exp(x[0]), np.exp(x[1]) if across is None else across
    law = along**exponent + side**exponent + (along * side) ** -exponent
    return float(2 / (3 * exponent**2) * law - pull * along - 0.5 * field * (along * side) ** 2)


def find_loss(pre: float, across: float | None, exponent: float) -> float:
    """Squared nominal field over Y at which the minimum of the energy runs away, by raising the field little by
    little."""
    step, field = 1e-3, 0.0
    side = pre**-0.5 if across is None else across
    pull = 2 / (3 * exponent) * (pre ** (exponent - 1) - pre ** (-exponent - 1) * side**-exponent)
    x = np.array([math.log(pre), math.log(side)])
    options = {"xatol": 1e-7, "fatol": 1e-13}
    while step > 1e-6:
        found = minimize(energy, x, (field + step, pull, exponent, across), method="Nelder-Mead", options=options)
        if np.all(np.abs(found.x - x) < 0.4) and found.x[0] < math.log(8 * pre):
            x, field = found.x, field + step
        else:
            step /= 4
    return field
