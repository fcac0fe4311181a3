"""The fit, linearised: for given relaxation times the data are linear in the springs, so that they can be found by NNLS.

The response of film and rig, v(k, q), is expanded about a stiffness curve and nuisance parameters q; the nuisance
parameters (rig constants and gains with their priors) are projected out. What remains is  min ‖A(τ) x − b‖, x ≥ 0, with
one column per arm, one for the spring and one for a pure dashpot. Does not belong here: the search over τ (`varpro`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from pipeline.fit.relaxation.observations import ELECTRICAL, Curve, Lines, Observations
from pipeline.physics.film import Shape, debye
from pipeline.physics.held_step import hold_kernel, series_hold_values
from pipeline.physics.rig import rig_of_constants
from schemas.arrays import Complex, Float

DIFFERENCE = 1e-4
NEXT_TO_NOTHING = 1e-9
"""Step of the finite differences for relaxation curves behind a compliant load cell, relative to the total stiffness."""


@dataclass(frozen=True)
class Expansion:
    """Point about which the response is expanded.

    `k` per block: the film's stiffness at the block's lines (complex), None for blocks that are left out (and for curves);
    `material` (θ, shape) for curves behind a compliant load cell, None for the first pass, where a curve is corrected for the
    load cell as if the film were elastic; `q` (Q,) nuisance parameters.
    """

    k: tuple[Complex | None, ...]
    q: Float
    material: tuple[Float, Shape] | None = None


class Linearisation:
    """Weighted, projected rows of the linear problem; `columns(tau)` makes one column per relaxation time."""

    def __init__(self, observations: Observations, at: Expansion) -> None:
        self.observations = observations
        self.at = at
        rows = observations.rows + observations.nuisance.target.size
        target = np.zeros(rows)
        nuisance = np.zeros((rows, observations.nuisance.size))
        self._gains: list[Complex | Float | None] = []
        start = 0
        for block, k in zip(observations.blocks, at.k, strict=True):
            stop = start + block.rows
            if isinstance(block, Lines):
                if k is None:
                    self._gains.append(None)
                else:
                    value, by_k, by_q = observations.predict_lines(block, k, at.q)
                    self._gains.append(block.weight * by_k)
                    rest = block.weight * (block.value - value + by_k * k + by_q @ at.q)
                    target[start:stop] = _real(rest)
                    nuisance[start:stop] = _real(by_q * block.weight[:, None])
            else:
                gain, level, by_nuisance = self._curve(block)
                self._gains.append(gain)
                target[start:stop], nuisance[start:stop] = level, by_nuisance
            start = stop
        target[start:] = observations.nuisance.target
        nuisance[start:] = observations.nuisance.prior
        self.nuisance = nuisance
        self.basis = _orthonormal(nuisance)
        self.raw_target = target
        self.target = self.project(target)

    def project(self, rows: Float) -> Float:
        """Rows with what the nuisance parameters can explain taken out."""
        return np.asarray(rows - self.basis @ (self.basis.T @ rows))

    def columns(self, tau: Float) -> Float:
        """(R, n) projected columns of arms of unit stiffness with relaxation times (n,) s."""
        return self.project(self._stack(tau))

    def ends(self) -> Float:
        """(R, 2) projected columns of the spring k0 and of a pure dashpot (N s/mm)."""
        return self.project(self._stack(None))

    def nuisance_at(self, raw_columns: Float, x: Float) -> Float:
        """q (Q,) that goes with coefficients x of unprojected columns."""
        if not self.nuisance.shape[1]:
            return np.zeros(0)
        return np.asarray(np.linalg.lstsq(self.nuisance, self.raw_target - raw_columns @ x, rcond=None)[0])

    def raw_columns(self, tau: Float) -> Float:
        """(R, n + 2) columns before projection: spring, arms, dashpot."""
        ends = self._stack(None)
        return np.hstack([ends[:, :1], self._stack(tau), ends[:, 1:]])

    def _stack(self, tau: Float | None) -> Float:
        count = 2 if tau is None else tau.size
        rows = np.zeros((self.raw_target.size, count))
        start = 0
        for block, gain in zip(self.observations.blocks, self._gains, strict=True):
            stop = start + block.rows
            if gain is None:
                pass
            elif isinstance(block, Lines):
                unit = (
                    np.stack([np.ones_like(block.omega), 1j * block.omega], 1)
                    if tau is None
                    else debye(block.omega, tau)
                )
                unit = unit * gain[:, None]
                middle = start + block.omega.size
                rows[start:middle], rows[middle:stop] = unit.real, unit.imag
            else:
                rows[start:stop] = self._curve_columns(block, tau) * np.real(gain)[:, None]
            start = stop
        return rows

    def _curve(self, block: Curve) -> tuple[Float, Float, Float]:
        """Row factors, target rows and nuisance rows of a relaxation curve."""
        obs, q = self.observations, self.at.q
        blank = np.zeros((block.rows, obs.nuisance.size))
        if block.number in obs.nuisance.calibration:
            level, height, *factors = obs.nuisance.calibration[block.number]
            blank[:, level], blank[:, height] = block.weight * block.offset, block.weight * block.value * block.height
            for place, ramp in zip(factors, block.hold.further, strict=False):
                # As if the film were elastic, as stiff as at the first window.
                reached = np.where(block.hold.since(ramp) >= 0, ramp.share, 0.0)
                blank[:, place] = block.weight * block.unequal * block.value[0] * reached
        if self.at.material is not None:
            theta, shape = self.at.material
            value, _, by_q = obs.predict_curve(block, theta, shape, q)
            tangent = self._tangent(block, theta, shape)
            rest = block.value - value + tangent + by_q @ q
            return block.weight, block.weight * rest, by_q * block.weight[:, None]
        if block.rig is None:
            return block.weight, block.weight * block.value, blank
        _, cell, _, gain = obs.constants(block.rig, q)
        moved = block.hold.level
        secant = np.divide(block.value, moved, out=np.zeros(block.rows), where=moved != 0)
        share = np.maximum(1 - secant / (gain * cell), 0.05)
        return block.weight * gain * share**2, block.weight * block.value * share, blank

    def _tangent(self, block: Curve, theta: Float, shape: Shape) -> Float:
        """Derivative of the curve along the material itself, Σ x ∂y/∂x: what the columns give at the expansion point."""
        k0, k, tau, c = shape.split(theta)
        ends = self._curve_columns(block, None)
        return np.asarray(self._curve_columns(block, tau) @ k + ends @ np.array([k0, c]))

    def _curve_columns(self, block: Curve, tau: Float | None) -> Float:
        """Columns of a relaxation curve: exact for a rigid load cell, finite differences behind a compliant one."""
        obs = self.observations
        hold = block.hold_at(obs.nuisance, self.at.q)
        if self.at.material is None or block.rig is None:
            if tau is None:
                columns = np.stack([hold.level, np.zeros(block.rows)], 1)
            else:
                columns = hold_kernel(hold, tau)[0]
            if self.at.material is not None:
                columns = columns * block.gain(obs.nuisance, self.at.q)
            return columns
        return self._differences(block, tau)

    def _differences(self, block: Curve, tau: Float | None) -> Float:
        """Columns (p, n) behind a compliant load cell: each arm added to the material with a small spring."""
        assert self.at.material is not None
        assert block.rig is not None
        theta, shape = self.at.material
        k0, k, taus, c = shape.split(theta)
        _, cell, _, gain = self.observations.constants(block.rig, self.at.q)
        factor = gain * block.gain(self.observations.nuisance, self.at.q)
        step = DIFFERENCE * (k0 + k.sum())
        hold = block.hold_at(self.observations.nuisance, self.at.q)
        longest = float((hold.start + hold.width).max()) + hold.ramp

        def values(k0s: Float, ks: Float, all_tau: Float, c: float) -> Float:
            return np.asarray(factor * series_hold_values(k0s, ks, all_tau, c, hold, cell).T)

        if tau is None:
            small = step / float(block.omega.max())
            pair = np.tile(k, (2, 1)), np.tile(taus, (2, 1))
            by_spring = values(np.array([k0, k0 + step]), *pair, c)
            by_dashpot = values(np.array([k0]), k[None], taus[None], c + small)
            columns = [(by_spring[:, 1] - by_spring[:, 0]) / step, (by_dashpot[:, 0] - by_spring[:, 0]) / small]
            return np.stack(columns, axis=1)
        if not tau.size:
            return np.zeros((block.rows, 0))
        # one more arm everywhere, so that all films have the same shape: of next to no stiffness where none is added
        count = tau.size + 1
        ks, all_tau = (
            np.tile(np.append(k, NEXT_TO_NOTHING * (k0 + k.sum())), (count, 1)),
            np.tile(np.append(taus, 1e3 * longest), (count, 1)),
        )
        for i, t in enumerate(tau):
            same = np.flatnonzero(np.abs(taus / t - 1) < 1e-6)
            if same.size:
                ks[i + 1, same[0]] += step
            else:
                ks[i + 1, -1], all_tau[i + 1, -1] = step, t
        found = values(np.full(count, k0), ks, all_tau, c)
        return np.asarray((found[:, 1:] - found[:, :1]) / step)


def solve(columns: Float, target: Float) -> tuple[Float, float]:
    """x ≥ 0 minimising ‖columns x − target‖, and the norm. Columns are scaled; empty ones get 0."""
    scale = np.sqrt(np.einsum("ij,ij->j", columns, columns))
    scale[scale == 0] = np.inf
    x, norm = nnls(columns / scale, target, maxiter=50 * columns.shape[1])
    return x / scale, float(norm)


def first_expansion(observations: Observations) -> Expansion:
    """Expansion about the response itself: film stiffness from each line by inverting the rig at its nominal constants.

    Electrical lines take part only where there is nothing else; then a = F_A/V² comes from kL/H = (k + D)/a, which is linear
    in k/a ≥ 0 and 1/a ≥ 0.
    """
    q = np.zeros(observations.nuisance.size)
    electrical_only = all(isinstance(b, Lines) and b.kind == ELECTRICAL for b in observations.blocks)
    if electrical_only and observations.nuisance.amplitude is not None:
        q[observations.nuisance.amplitude] = np.log(_amplitude(observations, q))
    k: list[Complex | None] = []
    for block in observations.blocks:
        if not isinstance(block, Lines):
            k.append(None)
        elif block.rig is None:
            k.append(block.value)
        elif block.kind != ELECTRICAL:
            rig = rig_of_constants(observations.constants(block.rig, q))
            k.append(rig.film_stiffness(block.value, rig.clamp(block.omega)))
        elif electrical_only and observations.nuisance.amplitude is not None:
            rig, actuation = (
                rig_of_constants(observations.constants(block.rig, q)),
                np.exp(q[observations.nuisance.amplitude]),
            )
            k.append(rig.film_stiffness_of_actuation(block.value, actuation, rig.clamp(block.omega)))
        else:
            k.append(None)
    return Expansion(tuple(k), q)


def amplitude_given(observations: Observations, k: Sequence[Complex], q: Float) -> float:
    """a = F_A/V² in N/kV² by weighted least squares for given film stiffness at the electrical lines."""
    place = observations.nuisance.amplitude
    trial = q.copy()
    if place is not None:
        trial[place] = 0.0
    above = below = 0.0
    for block, stiffness in zip(observations.blocks, k, strict=True):
        if isinstance(block, Lines) and block.kind == ELECTRICAL:
            unit = observations.predict_lines(block, stiffness, trial)[0] * block.weight
            above += float((unit.conj() * block.value * block.weight).real.sum())
            below += float((np.abs(unit) ** 2).sum())
    return max(above / below, 1e-12) if below > 0 else 1.0


def _amplitude(observations: Observations, q: Float) -> float:
    rows, targets = [], []
    omega = np.concatenate([b.omega for b in observations.blocks if isinstance(b, Lines)])
    tau = np.logspace(-np.log10(omega.max()) - 2, -np.log10(omega.min()) + 1, 30)
    for block in observations.blocks:
        if not isinstance(block, Lines) or block.rig is None:
            continue
        rig = rig_of_constants(observations.constants(block.rig, q))
        dynamic = rig.stiffness * rig.clamp(block.omega)
        weight = block.weight * np.abs(block.value) ** 2 * rig.compliance
        columns = np.hstack(
            [np.ones((block.omega.size, 1)), debye(block.omega, tau), 1j * block.omega[:, None], dynamic[:, None]]
        )
        rows.append(_real(columns * weight[:, None]))
        targets.append(_real(rig.gain * rig.stiffness / block.value * weight))
    x, _ = solve(np.concatenate(rows), np.concatenate(targets))
    largest = max(float(np.abs(b.value).max()) for b in observations.blocks if isinstance(b, Lines))
    return 1 / x[-1] if x[-1] * largest > 1e-3 else 2 * largest


def _real(rows: Complex) -> Float:
    return np.concatenate([rows.real, rows.imag])


def _orthonormal(columns: Float) -> Float:
    if not columns.shape[1]:
        return np.zeros((columns.shape[0], 0))
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > 1e-12 * s[0]])
