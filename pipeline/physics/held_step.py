"""Films that are held after a ramp: force over the height of the step, behind a load cell that is rigid or gives way.

Pure formulas, with their derivatives. Does not belong here: data and weights.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pipeline.physics.film import Shape, mean_decay
from schemas.arrays import Float

OVER = 1e-4
"""A dashpot faster than this share of the first window's time shows nothing in a relaxation curve."""


@dataclass(frozen=True)
class FurtherRamp:
    """A further ramp of a staircase.

    Parameters
    ----------
    delay : s from the end of the first ramp to the end of this one
    duration : s, 0 for a jump
    share : its height over that of the first ramp, negative where it goes down
    """

    delay: float
    duration: float
    share: float


@dataclass(frozen=True)
class Hold:
    """When a held step was measured: values are means over windows after a linear ramp, or after several.

    Parameters
    ----------
    start : (p,) s from the end of the (first) ramp to the start of the window, ≥ 0
    width : (p,) s of the window, 0 for a single instant
    ramp : s, duration of the ramp, 0 for a jump
    further : ramps after the first one; a window lies after the end of one or before its start
    """

    start: Float
    width: Float
    ramp: float
    further: tuple[FurtherRamp, ...] = ()

    @property
    def count(self) -> int:
        return int(self.start.size)

    @property
    def ramps(self) -> tuple[FurtherRamp, ...]:
        """All ramps, the first one among them."""
        return (FurtherRamp(0.0, self.ramp, 1.0), *self.further)

    def since(self, ramp: FurtherRamp) -> Float:
        """(p,) s from the end of a ramp to the start of the window, negative before it."""
        return np.asarray(self.start - ramp.delay)

    @property
    def since_last(self) -> Float:
        """(p,) s from the end of the last ramp before the window to its start."""
        found = self.start
        for ramp in self.further:
            found = np.where(self.since(ramp) >= 0, self.since(ramp), found)
        return found

    @property
    def last_ramp(self) -> Float:
        """(p,) s, duration of the last ramp before the window."""
        found = np.full(self.count, self.ramp)
        for ramp in self.further:
            found = np.where(self.since(ramp) >= 0, ramp.duration, found)
        return found

    @property
    def level(self) -> Float:
        """(p,) sum of the heights of all ramps before the window, over that of the first."""
        return np.asarray(sum(np.where(self.since(ramp) >= 0, ramp.share, 0.0) for ramp in self.ramps))

    def scaled(self, factors: Float) -> Hold:
        """The same with the heights of the further ramps (r,) multiplied."""
        pairs = zip(self.further, factors, strict=True)
        return replace(self, further=tuple(replace(ramp, share=ramp.share * float(by)) for ramp, by in pairs))

    def with_more(self, number: int, other: Hold) -> Hold:
        """The same with the height of one of its further ramps (from 0) added as it is in another."""
        shares = [
            r.share + (o.share if i == number else 0.0)
            for i, (r, o) in enumerate(zip(self.further, other.further, strict=True))
        ]
        return replace(self, further=tuple(replace(r, share=s) for r, s in zip(self.further, shares, strict=True)))


def hold_kernel(hold: Hold, tau: Float) -> tuple[Float, Float]:
    """Force of arms of unit stiffness over the height of a step.

    Parameters
    ----------
    hold : p windows
    tau : (n,) s

    Returns
    -------
    Force (p, n) and its derivative by log τ (p, n)

    Notes
    -----
    τ/T (1 − e^{−T/τ}) for the ramp times the mean of e^{−t/τ} over the window, τ/w (1 − e^{−w/τ}) e^{−start/τ}:
    superposition of steps (Boltzmann).
    """
    width = hold.width[:, None] / tau

    def of_ramp(since: Float, duration: float) -> Float:
        ramp, start = duration / tau, since[:, None] / tau
        value = mean_decay(ramp) * mean_decay(width) * np.exp(-start)
        slope = (1 - _bernoulli(ramp)) + (1 - _bernoulli(width)) + start
        return np.stack([value, value * slope])

    value, slope = _superpose(hold, of_ramp)
    return value, slope


def _superpose(hold: Hold, of_ramp: Callable[[Float, float], Float]) -> Float:
    """Sum (…, p, n) of the responses to all ramps of a hold.

    `of_ramp` makes them (…, p, n) of times since the end of a ramp (p,) s and its duration, s.
    """
    if not hold.further:
        return of_ramp(hold.start, hold.ramp)
    total: Float = np.zeros(())
    for ramp in hold.ramps:
        since = hold.since(ramp)
        weight = np.where(since >= 0, ramp.share, 0.0)[:, None]
        total = total + weight * of_ramp(np.maximum(since, 0.0), ramp.duration)
    return total


def _bernoulli(x: Float) -> Float:
    """x/(eˣ − 1), 1 at 0."""
    safe = np.clip(x, 1e-12, 700.0)
    return np.asarray(np.where(x > 1e-12, safe / np.expm1(safe), 1.0))


def hold_stiffness(theta: Float, shape: Shape, hold: Hold) -> tuple[Float, Float]:
    """Force of a film over the height of a step, behind a rigid load cell.

    Parameters
    ----------
    theta, shape : as in `film.stiffness_and_slopes`
    hold : p windows

    Returns
    -------
    N/mm (p,), and the derivative by θ (p, size)

    Notes
    -----
    A pure dashpot pulls during the ramp only.
    """
    k0, k, tau, _ = shape.split(theta)
    a, n = int(shape.spring), shape.arms
    slope = np.zeros((hold.count, shape.size))
    value, by_tau = hold_kernel(hold, tau)
    slope[:, a : a + n] = value * k
    slope[:, a + n : a + 2 * n] = by_tau * k
    if shape.spring:
        slope[:, 0] = k0 * hold.level
    return slope[:, : a + n].sum(axis=1), slope


def series_hold_stiffness(theta: Float, shape: Shape, hold: Hold, cell: float) -> tuple[Float, Float, Float]:
    """Force of a film in series with a load cell over the height of a step of both, masses at rest.

    Parameters
    ----------
    theta, shape : as in `film.stiffness_and_slopes`
    hold : p windows
    cell : N/mm, stiffness of the load cell

    Returns
    -------
    N/mm (p,), the derivative by θ (p, size), and that by log cell (p,)

    Notes
    -----
    The series of a Maxwell-Wiechert film and a spring, k_eff(s) = cell − cell²/D(s) with D(s) = k(s) + cell, is again a
    relaxation: its poles are the zeros s_j of D, its springs K_j = −cell²/(s_j D′(s_j)).
    """
    k0, k, tau, c = shape.split(theta)
    a, n = int(shape.spring), shape.arms
    s, residue = (x[0] for x in _series_poles(np.array([k0]), k[None], tau[None], c, cell))
    # A zero lies slower than the pole it belongs to; rounding may put it on the pole where the arm is weak.
    s = np.where((np.abs(1 + np.multiply.outer(s, tau)) < 1e-13).any(axis=1), s * (1 - 1e-12), s)
    residue = np.maximum(residue, 1e-200)
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
        slope[:, 0] += k0 * (cell / (k0 + cell)) ** 2 * hold.level
    slope[:, -1] += cell * (k0 / (k0 + cell)) ** 2 * hold.level
    return kernel @ spring + static * hold.level, slope[:, :-1], slope[:, -1]


def series_hold_values(k0: Float, k: Float, tau: Float, c: float, hold: Hold, cell: float) -> Float:
    """`series_hold_stiffness` of several films at once, values only.

    Parameters
    ----------
    k0 : (S,) N/mm
    k, tau : (S, n) N/mm and s
    c : N s/mm, the dashpot of all
    hold : p windows
    cell : N/mm

    Returns
    -------
    (S, p) N/mm

    Notes
    -----
    A dashpot whose effect is over long before the first window is left out.
    """
    total = k0 + k.sum(axis=1) + cell
    seen = c / float(total.min()) > OVER * float((hold.start + hold.width + hold.ramp).min())
    s, residue = _series_poles(k0, k, tau, c if seen else 0.0, cell)
    spring = -(cell**2) * residue / s
    windows = mean_decay(-hold.width[None, :, None] * s[:, None, :])

    def of_ramp(since: Float, duration: float) -> Float:
        kernel = np.exp(since[None, :, None] * s[:, None, :])
        kernel *= mean_decay(-duration * s)[:, None, :] * windows
        return np.asarray(kernel)

    static = (k0 * cell / (k0 + cell))[:, None] * hold.level
    return np.asarray(np.einsum("spn,sn->sp", _superpose(hold, of_ramp), spring) + static)


def _series_poles(k0: Float, k: Float, tau: Float, c: float, cell: float) -> tuple[Float, Float]:
    """Zeros (S, m) of D(s) = k(s) + cell, all negative, and 1/D′ there, of S films.

    From the eigenvectors of a symmetric matrix, 1/D(s) = 1/D(∞) + Σ rⱼ/(s − sⱼ): stable however weak or close together
    the arms are.
    """
    count, arms = k.shape
    total = k0 + k.sum(axis=1) + cell
    u, place = np.sqrt(k / tau), np.arange(arms)
    if c > 0:
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
    return np.minimum(s, -1e-300), residue
