"""Responses of one relaxation arm, in frequency and in time, with their derivatives.

Pure formulas of the generalised Maxwell model. Does not belong here: data, weights, rigs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.arrays import Complex, Float

OVER = 1e-4
"""A dashpot faster than this share of the first window's time shows nothing in a relaxation curve."""


@dataclass(frozen=True)
class Shape:
    """Which material parameters a vector θ has: [log k0] + log kᵢ + log τᵢ + [log c_inf]; bracketed ones are optional."""

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


def debye(omega: Float, tau: Float) -> Complex:
    """jωτ/(1 + jωτ), (m, n) for (m,) rad/s and (n,) s."""
    z = 1j * np.multiply.outer(omega, tau)
    return np.asarray(z / (1 + z))


def stiffness_and_slopes(theta: Float, shape: Shape, omega: Float) -> tuple[Complex, Complex]:
    """k(jω) (m,) and ∂k/∂θ (m, size) at (m,) rad/s."""
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


@dataclass(frozen=True)
class Hold:
    """When a held step was measured: values are means over windows after a linear ramp of duration `ramp` s (0: a jump).

    `start` (p,) s from the end of the ramp to the start of the window, ≥ 0; `width` (p,) s of the window, 0 for a single
    instant.
    """

    start: Float
    width: Float
    ramp: float

    @property
    def count(self) -> int:
        return int(self.start.size)


def hold_kernel(hold: Hold, tau: Float) -> tuple[Float, Float]:
    """Force of arms of unit stiffness over the height of the step, and its derivative by log τ; both (p, n) for (n,) s.

    τ/T (1 − e^{−T/τ}) for the ramp times the mean of e^{−t/τ} over the window, τ/w (1 − e^{−w/τ}) e^{−start/τ}.
    """
    ramp, width = hold.ramp / tau, hold.width[:, None] / tau
    start = hold.start[:, None] / tau
    value = _mean_decay(ramp) * _mean_decay(width) * np.exp(-start)
    slope = (1 - _bernoulli(ramp)) + (1 - _bernoulli(width)) + start
    return value, value * slope


def _mean_decay(x: Float) -> Float:
    """(1 − e^{−x})/x, 1 at 0."""
    safe = np.where(x > 1e-12, x, 1.0)
    return np.asarray(np.where(x > 1e-12, -np.expm1(-safe) / safe, 1.0))


def _bernoulli(x: Float) -> Float:
    """x/(eˣ − 1), 1 at 0."""
    safe = np.clip(x, 1e-12, 700.0)
    return np.asarray(np.where(x > 1e-12, safe / np.expm1(safe), 1.0))


def hold_stiffness(theta: Float, shape: Shape, hold: Hold) -> tuple[Float, Float]:
    """Force over the height of the step (p,), and its derivative by θ (p, size). Rigid load cell.

    A pure dashpot pulls during the ramp only.
    """
    k0, k, tau, _ = shape.split(theta)
    a, n = int(shape.spring), shape.arms
    slope = np.zeros((hold.count, shape.size))
    value, by_tau = hold_kernel(hold, tau)
    slope[:, a : a + n] = value * k
    slope[:, a + n : a + 2 * n] = by_tau * k
    if shape.spring:
        slope[:, 0] = k0
    return slope[:, : a + n].sum(axis=1), slope


def series_hold_stiffness(theta: Float, shape: Shape, hold: Hold, cell: float) -> tuple[Float, Float, Float]:
    """As `hold_stiffness` for a film in series with a load cell of stiffness `cell` (N/mm), masses at rest.

    The series of a Maxwell-Wiechert film and a spring, k_eff(s) = cell − cell²/D(s) with D(s) = k(s) + cell, is again a
    relaxation: its poles are the zeros s_j of D, its springs K_j = −cell²/(s_j D′(s_j)). Returns the value (p,), its
    derivative by θ (p, size) and by log cell (p,).
    """
    k0, k, tau, c = shape.split(theta)
    a, n = int(shape.spring), shape.arms
    s, residue = _series_poles(k0, k, tau, c, cell)
    y = 1 / (1 + np.multiply.outer(s, tau))
    slope_d = 1 / residue
    curve_d = -2 * (k * tau**2 * y**3).sum(axis=1)
    spring = -(cell**2) / (slope_d * s)
    # derivatives of D and D' by the parameters, at the poles
    d = np.zeros((s.size, shape.size + 1))
    e = np.zeros_like(d)
    st = np.multiply.outer(s, tau)
    d[:, a : a + n] = k * st * y
    e[:, a : a + n] = k * tau * y**2
    d[:, a + n : a + 2 * n] = k * st * y**2
    e[:, a + n : a + 2 * n] = k * tau * (1 - st) * y**3
    if shape.spring:
        d[:, 0] = k0
    if shape.dashpot:
        d[:, shape.size - 1] = s * c
        e[:, shape.size - 1] = c
    d[:, -1] = cell
    shift = -d / slope_d[:, None]
    by_spring = spring[:, None] * (-(curve_d[:, None] * shift + e) / slope_d[:, None] - shift / s[:, None])
    by_spring[:, -1] += 2 * spring
    kernel, by_tau = hold_kernel(hold, -1 / s)
    slope = kernel @ by_spring + (by_tau * spring) @ (-shift / s[:, None])
    static = k0 * cell / (k0 + cell)
    if shape.spring:
        slope[:, 0] += k0 * (cell / (k0 + cell)) ** 2
    slope[:, -1] += cell * (k0 / (k0 + cell)) ** 2
    return kernel @ spring + static, slope[:, :-1], slope[:, -1]


def _series_poles(k0: float, k: Float, tau: Float, c: float, cell: float) -> tuple[Float, Float]:
    """Zeros of D(s) = k(s) + cell, all negative, and 1/D′ there, from the eigenvectors of a symmetric matrix.

    1/D(s) = 1/D(∞) + Σ rⱼ/(s − sⱼ): stable however weak or close together the arms are.
    """
    total = k0 + k.sum() + cell
    u = np.sqrt(k / tau)
    if c > 0:
        matrix = np.diag(np.concatenate([-1 / tau, [-total / c]]))
        matrix[-1, :-1] = matrix[:-1, -1] = u / np.sqrt(c)
        s, vectors = np.linalg.eigh(matrix)
        residue = vectors[-1] ** 2 / c
    else:
        s, vectors = np.linalg.eigh(np.diag(-1 / tau) + np.multiply.outer(u, u) / total)
        residue = (u @ vectors / total) ** 2
    s = np.minimum(s, -1e-300)
    # a zero lies slower than the pole it belongs to; rounding may put it on the pole where the arm is weak
    s = np.where((np.abs(1 + np.multiply.outer(s, tau)) < 1e-13).any(axis=1), s * (1 - 1e-12), s)
    return s, np.maximum(residue, 1e-200)


def series_hold_values(k0: Float, k: Float, tau: Float, c: float, hold: Hold, cell: float) -> Float:
    """`series_hold_stiffness` of S films at once, values only: k0 (S,), k and τ (S, n), one dashpot c for all → (S, p).

    Springs from the eigenvectors, 1/D(s) = 1/D(∞) + Σ rⱼ/(s − sⱼ): stable however weak or close the arms are. A dashpot whose
    effect is over long before the first window is left out.
    """
    count, arms = k.shape
    total = k0 + k.sum(axis=1) + cell
    u = np.sqrt(k / tau)
    place = np.arange(arms)
    if c / float(total.min()) > OVER * float((hold.start + hold.width + hold.ramp).min()):
        matrix = np.zeros((count, arms + 1, arms + 1))
        matrix[:, place, place] = -1 / tau
        matrix[:, -1, -1] = -total / c
        matrix[:, -1, :-1] = matrix[:, :-1, -1] = u / np.sqrt(c)
        s, vectors = np.linalg.eigh(matrix)
        residue = vectors[:, -1, :] ** 2 / c
    else:
        matrix = u[:, :, None] * u[:, None, :] / total[:, None, None]
        matrix[:, place, place] -= 1 / tau
        s, vectors = np.linalg.eigh(matrix)
        residue = (np.einsum("sn,snj->sj", u, vectors) / total[:, None]) ** 2
    s = np.minimum(s, -1e-300)
    spring = -(cell**2) * residue / s
    kernel = np.exp(hold.start[None, :, None] * s[:, None, :])
    kernel *= _mean_decay(-hold.ramp * s)[:, None, :] * _mean_decay(-hold.width[None, :, None] * s[:, None, :])
    static = k0 * cell / (k0 + cell)
    return np.asarray(np.einsum("spn,sn->sp", kernel, spring) + static[:, None])
