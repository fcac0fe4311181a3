"""The film: generalised Maxwell (Wiechert) model, in frequency, in time, and with derivatives by its parameters.

    k(jω) = k0 + Σ kᵢ jωτᵢ/(1 + jωτᵢ) + jω c_inf,      ḟᵢ = kᵢ ė − fᵢ/τᵢ        (thesis, eq 4.1 and 4.11 corrected)

with the extension e of the film and the force fᵢ of an arm. Films that are held after a ramp: `held_step`. Does not
belong here: how the parameters are found or how sure they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dtbtrs

from schemas.arrays import Complex, Float

EPSILON_0_N_PER_KV2 = 8.8541878e-6
"""Permittivity of the vacuum: 1 kV²/mm² × mm² gives so many N."""


@dataclass(frozen=True)
class RelaxationModel:
    """One main spring, arms of a spring and a damper in series, and perhaps a dashpot, all in parallel.

    Parameters
    ----------
    k0 : N/mm, main spring
    k : (n,) N/mm, springs of the arms
    tau : (n,) s, relaxation times, longest first; the dampers are c = k τ in N s/mm
    c_inf : N s/mm, a pure dashpot beside the arms (an arm whose spring is rigid); 0 when there is none

    Raises
    ------
    ValueError
        There are not as many springs as relaxation times.
    """

    k0: float
    k: tuple[float, ...]
    tau: tuple[float, ...]
    c_inf: float = 0.0

    def __post_init__(self) -> None:
        if len(self.k) != len(self.tau):
            raise ValueError(f"{len(self.k)} springs but {len(self.tau)} relaxation times")

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        """Made once: films are looked up far more often than they are made."""
        return hash((self.k0, self.k, self.tau, self.c_inf))

    @property
    def order(self) -> int:
        """Number of arms, the pure dashpot included."""
        return len(self.k) + (self.c_inf > 0)

    @property
    def c(self) -> tuple[float, ...]:
        """(n,) N s/mm, dampers of the arms."""
        return tuple(k * t for k, t in zip(self.k, self.tau, strict=True))

    def stiffness(self, frequency_hz: ArrayLike) -> Complex:
        """Complex dynamic stiffness in N/mm at frequencies in Hz; shape of the input."""
        return np.asarray(stiffnesses((self,), frequency_hz)[0])

    def relaxation(self, time_s: ArrayLike) -> Float:
        """Relaxation function k0 + Σ kᵢ e^{−t/τᵢ} in N/mm.

        Parameters
        ----------
        time_s : s after a step of the extension, above 0

        Returns
        -------
        Force over the height of the step, shape of the input

        Raises
        ------
        ValueError
            The film has a pure dashpot, which answers a step with an impulse.
        """
        if self.c_inf:
            raise ValueError("a model with a pure dashpot has no relaxation function")
        t = np.asarray(time_s, dtype=float)
        total = np.full(t.shape, self.k0)
        for k, tau in zip(self.k, self.tau, strict=True):
            total = total + k * np.exp(-t / tau)
        return np.asarray(total)


def stiffnesses(models: Sequence[RelaxationModel], frequency_hz: ArrayLike) -> Complex:
    """Dynamic stiffness of several films with as many arms each.

    Parameters
    ----------
    models : F films
    frequency_hz : (…) Hz

    Returns
    -------
    (F, …) N/mm
    """
    omega = 2 * np.pi * np.asarray(frequency_hz, dtype=float)

    def column(values: Iterable[float]) -> Float:
        return np.array(list(values)).reshape(-1, *[1] * omega.ndim)

    first = models[0]
    k0: Float | float = first.k0
    c_inf: Float | float = first.c_inf
    arms: list[tuple[Float | float, Float | float]] = list(zip(first.k, first.tau, strict=True))
    if len(models) > 1:  # a single film has numbers in place of columns, which is quicker
        k0, c_inf = column(m.k0 for m in models), column(m.c_inf for m in models)
        arms = [(column(m.k[i] for m in models), column(m.tau[i] for m in models)) for i in range(len(first.k))]
    total = np.empty((len(models), *omega.shape), dtype=complex)
    total.real, total.imag = k0, omega * c_inf
    for k, tau in arms:
        # In parts, for a complex division costs more than all the rest of it.
        turn = omega * tau
        loss = k * turn / (1 + turn**2)
        total.real += loss * turn
        total.imag += loss
    return total


@dataclass(frozen=True)
class Shape:
    """Which material parameters a vector θ has: [log k0] + log kᵢ + log τᵢ + [log c_inf], bracketed ones if at all."""

    arms: int
    spring: bool = True
    dashpot: bool = False

    @property
    def size(self) -> int:
        return self.spring + 2 * self.arms + self.dashpot

    @property
    def order(self) -> int:
        return self.arms + self.dashpot

    @property
    def names(self) -> tuple[str, ...]:
        n = range(1, self.arms + 1)
        head = ("log k0",) if self.spring else ()
        tail = (f"log c{self.arms + 1}",) if self.dashpot else ()
        return head + tuple(f"log k{i}" for i in n) + tuple(f"log tau{i}" for i in n) + tail

    def split(self, theta: Float) -> tuple[float, Float, Float, float]:
        """k0, k (n,), τ (n,), c_inf from the first `size` entries of θ."""
        x = np.exp(theta[: self.size])
        a, n = int(self.spring), self.arms
        k0 = float(x[0]) if self.spring else 0.0
        c = float(x[-1]) if self.dashpot else 0.0
        return k0, x[a : a + n], x[a + n : a + 2 * n], c

    def join(self, k0: float, k: Float, tau: Float, c: float) -> Float:
        """θ from the parameters, all of which must be positive where the shape has them."""
        parts = [[k0] if self.spring else [], k, tau, [c] if self.dashpot else []]
        return np.asarray(np.log(np.concatenate([np.asarray(p, dtype=float) for p in parts])))

    def model(self, theta: Float) -> RelaxationModel:
        """The film of the first `size` entries of θ, its arms longest first."""
        k0, k, tau, c = self.split(theta)
        order = np.argsort(-tau)
        return RelaxationModel(k0, tuple(k[order].tolist()), tuple(tau[order].tolist()), c)

    def theta(self, film: RelaxationModel) -> Float:
        """θ (size,) of a film with as many arms."""
        return self.join(film.k0, np.array(film.k), np.array(film.tau), film.c_inf)


def arm_response(z: Complex) -> Complex:
    """z/(1 + z): an arm of unit stiffness at z = jωτ, a stretched one at z = (jωτ)^β (Cole and Cole, 1941)."""
    return np.asarray(z / (1 + z))


def debye(omega: Float, tau: Float) -> Complex:
    """jωτ/(1 + jωτ), (m, n) for (m,) rad/s and (n,) s: columns of a fit that is linear in the springs."""
    return arm_response(1j * np.multiply.outer(omega, tau))


def stiffness_and_slopes(theta: Float, shape: Shape, omega: Float) -> tuple[Complex, Complex]:
    """Dynamic stiffness and its derivatives.

    Parameters
    ----------
    theta : (size, …) logarithms of the parameters, in the order of `shape`; further entries are not looked at
    shape : which parameters these are
    omega : (m,) rad/s

    Returns
    -------
    k(jω) (m,) N/mm and ∂k/∂θ (m, size) N/mm

    Notes
    -----
    ∂/∂log τ of an arm is k jωτ/(1 + jωτ)² (thesis, eq 4.11 corrected, differentiated).
    """
    k0, k, tau, c = shape.split(theta)
    a, n = int(shape.spring), shape.arms
    slope = np.empty((omega.size, shape.size), dtype=complex)
    z = 1j * np.multiply.outer(omega, tau)
    inverse = 1 / (1 + z)
    arm = z * inverse * k
    slope[:, a : a + n] = arm
    slope[:, a + n : a + 2 * n] = arm * inverse
    total = arm.sum(axis=1) + k0
    if shape.spring:
        slope[:, 0] = k0
    if shape.dashpot:
        slope[:, -1] = 1j * omega * c
        total = total + slope[:, -1]
    return total, slope


def series_share(k: Complex, other: Complex) -> Complex:
    """Share of a film's force that reaches the ends through another film in series (thesis, section 5.2).

    Parameters
    ----------
    k, other : N/mm, stiffness of the film and of the other; they broadcast

    Returns
    -------
    k₂/(k + k₂); times k it is the stiffness of both together
    """
    return np.asarray(other / (k + other), dtype=complex)


def mean_decay(x: Float) -> Float:
    """(1 − e^{−x})/x, 1 at 0: mean of e^{−t/τ} over a duration x τ."""
    safe = np.where(x > 1e-12, x, 1.0)
    return np.asarray(np.where(x > 1e-12, -np.expm1(-safe) / safe, 1.0))


def arm_step(passed: Float) -> tuple[Float, Float]:
    """One step of an arm in time, exact for an extension that is linear within it.

    Parameters
    ----------
    passed : h/τ, duration of the step over the relaxation time; any shape

    Returns
    -------
    decay e^{−h/τ} and gain (1 − e^{−h/τ}) τ/h of the shape of `passed`, f ← decay f + gain k Δe

    Notes
    -----
    Solution of ḟ = k ė − f/τ (thesis, eq 4.3 corrected); stable for any step.
    """
    return np.exp(-passed), mean_decay(passed)


def integrate_arms(time_s: Float, extension: Float, tau: Float) -> Float:
    """Forces of arms of unit stiffness along a course, from rest.

    Parameters
    ----------
    time_s : (m,) s, rising
    extension : (m,) extension or stretch, linear between the samples
    tau : (n,) s

    Returns
    -------
    (m, n) forces over the arms' stiffness, in the unit of the extension

    Notes
    -----
    `arm_step` from sample to sample: f[i + 1] − decay f[i] = gain Δe is a system with two diagonals; those of all arms,
    one after the other, are one system, solved in one call.
    """
    decay, gain = arm_step(np.diff(time_s) / tau[:, None])
    gain = gain * np.diff(extension)
    diagonals = np.ones((gain.size, 2))
    below = diagonals[:, 1].reshape(gain.shape)
    below[:, :-1], below[:, -1] = -decay[:, 1:], 0.0
    forces = dtbtrs(diagonals.T, gain.ravel(), uplo="L", diag="U")[0] if gain.size else gain
    found = np.zeros((time_s.size, tau.size))
    found[1:] = forces.reshape(gain.shape).T
    return found
