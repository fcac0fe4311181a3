"""The data of a fit: blocks of frequency lines and relaxation curves, each with its variance, rig and gain.

A block predicts its own values and their derivatives from a material and the nuisance parameters q (rig constants, gains,
actuation amplitude, systematic columns). Everything is in base units. Does not belong here: searching, selecting.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.physics.film import Shape, stiffness_and_slopes
from pipeline.physics.held_step import Hold, hold_stiffness, series_hold_stiffness
from pipeline.physics.rig import RigPrior, rig_of_constants
from schemas.arrays import Complex, Float, Int

FILM, MECHANICAL, ELECTRICAL = "film", "mechanical", "electrical"


@dataclass(frozen=True)
class Nuisance:
    """Places of the nuisance parameters in q, and their priors.

    `prior` (r, Q) and `target` (r,): residual rows prior @ q − target, of unit variance.
    `rigs` maps a rig's number to the places of its prior's directions, `gains` a group's number to its place, `amplitude` is
    the place of log a; `calibration` maps a block's number to the places of what is common to all its values: the columns
    of a response's `systematic`, or offset and step height of a relaxation curve.
    """

    names: tuple[str, ...] = ()
    prior: Float = field(default_factory=lambda: np.zeros((0, 0)))
    target: Float = field(default_factory=lambda: np.zeros(0))
    rigs: Mapping[int, tuple[int, ...]] = field(default_factory=dict)
    gains: Mapping[int, int] = field(default_factory=dict)
    amplitude: int | None = None
    calibration: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    @property
    def size(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class Lines:
    """Frequency lines of one kind and one rig.

    `omega` (m,) rad/s; `value` (m,) complex; `weight` (m,) 1/(standard deviation of one component), effective number of
    lines included; `group` (m,) number of the recording group whose gain applies; `systematic` (m, s) or None.
    """

    kind: str
    omega: Float
    value: Complex
    weight: Float
    group: Int
    rig: int | None = None
    systematic: Complex | None = None
    number: int = 0

    @property
    def rows(self) -> int:
        return 2 * self.omega.size


@dataclass(frozen=True)
class Curve:
    """A relaxation curve: `value` (p,) force over the displacement of the (first) step in N/mm.

    `hold` says when; `offset` is the standard deviation of an error common to all values in N/mm, `height` the relative standard
    deviation of the step's height; `unequal` that of what the further steps of a staircase add, over what they would in a linear
    film: 0 where the data are those of one.
    """

    hold: Hold
    value: Float
    weight: Float
    group: int
    rig: int | None = None
    offset: float = 0.0
    height: float = 0.0
    unequal: float = 0.0
    number: int = 0

    @property
    def rows(self) -> int:
        return self.value.size

    @property
    def own_gains(self) -> int:
        """Steps that have a factor of their own."""
        return len(self.hold.further) if self.unequal else 0

    def hold_at(self, nuisance: Nuisance, q: Float) -> Hold:
        """When it was measured, its further ramps as high as their factors make them."""
        if not self.own_gains:
            return self.hold
        return self.hold.scaled(1 + self.unequal * q[list(nuisance.calibration[self.number][2:])])

    def gain(self, nuisance: Nuisance, q: Float) -> float:
        """Factor of the group and of the step's height on the curve."""
        factor = float(np.exp(q[nuisance.gains[self.group]])) if nuisance.gains else 1.0
        if self.number in nuisance.calibration:
            factor *= 1 + self.height * float(q[nuisance.calibration[self.number][1]])
        return factor

    @property
    def omega(self) -> Float:
        """(p,) rad/s: 1/t of the values, t from the middle of the last ramp."""
        return np.asarray(1 / (self.hold.since_last + self.hold.width / 2 + self.hold.last_ramp / 2))


Block = Lines | Curve


@dataclass(frozen=True)
class Observations:
    """Everything one fit is made from.

    `data` is the number of independent real values; `lines` the number of values fitted; `groups` the names of the groups
    in the order of their numbers; `variance_estimated` says that no variance was given, so that weights are relative.
    """

    blocks: tuple[Block, ...]
    rigs: tuple[RigPrior, ...]
    nuisance: Nuisance
    groups: tuple[str, ...]
    data: float
    lines: int
    variance_estimated: bool = False

    @property
    def rows(self) -> int:
        return sum(b.rows for b in self.blocks)

    @property
    def omega_range(self) -> tuple[float, float]:
        """Least and largest angular frequency that the data carry; times count as 1/t."""
        low, high = np.inf, 0.0
        for block in self.blocks:
            low, high = min(low, float(block.omega.min())), max(high, float(block.omega.max()))
        return low, high

    def reweighted(self, factors: Sequence[Float]) -> Observations:
        """The same data with each block's weights multiplied by (rows,) factors."""
        blocks = tuple(replace(b, weight=b.weight * f) for b, f in zip(self.blocks, factors, strict=True))
        return replace(self, blocks=blocks)

    def with_gains(self, sd: float | None) -> Observations:
        """The same data with a gain per group: prior standard deviation of its logarithm `sd`; None takes gains out."""
        kept = [i for i in range(self.nuisance.size) if i not in self.nuisance.gains.values()]
        rows = ~self.nuisance.prior[:, list(self.nuisance.gains.values())].any(axis=1)
        new = {old: i for i, old in enumerate(kept)}
        count = len(self.groups) if sd is not None else 0
        prior = np.zeros((int(rows.sum()) + count, len(kept) + count))
        prior[: int(rows.sum()), : len(kept)] = self.nuisance.prior[rows][:, kept]
        if sd is not None:
            prior[int(rows.sum()) :, len(kept) :] = np.eye(count) / sd
        nuisance = Nuisance(
            names=tuple(self.nuisance.names[i] for i in kept) + tuple(f"log gain {g}" for g in self.groups[:count]),
            prior=prior,
            target=np.concatenate([self.nuisance.target[rows], np.zeros(count)]),
            rigs={r: tuple(new[p] for p in places) for r, places in self.nuisance.rigs.items()},
            gains={g: len(kept) + g for g in range(count)},
            amplitude=None if self.nuisance.amplitude is None else new[self.nuisance.amplitude],
            calibration={b: tuple(new[p] for p in places) for b, places in self.nuisance.calibration.items()},
        )
        return replace(self, nuisance=nuisance)

    def of_group(self, group: int) -> Observations:
        """The data of one group alone; nuisance parameters keep their places."""
        blocks: list[Block] = []
        data = 0.0
        share = self.data / max(self.rows, 1)
        for block in self.blocks:
            if isinstance(block, Curve):
                if block.group == group:
                    blocks.append(block)
                    data += block.rows
                continue
            mask = block.group == group
            if mask.any():
                systematic = None if block.systematic is None else block.systematic[mask]
                blocks.append(
                    replace(
                        block,
                        omega=block.omega[mask],
                        value=block.value[mask],
                        weight=block.weight[mask],
                        group=block.group[mask],
                        systematic=systematic,
                    )
                )
                data += 2 * share * int(mask.sum())
        return replace(self, blocks=tuple(blocks), data=data, groups=(self.groups[group],))

    def constants(self, rig: int, q: Float) -> Float:
        """M, kL, cL, gain of a rig at q."""
        return self.rigs[rig].values(q[list(self.nuisance.rigs[rig])])

    def predict_lines(self, block: Lines, k: Complex, q: Float) -> tuple[Complex, Complex, Complex]:
        """Response (m,) of film stiffness k (m,), its derivative by k (m,) and by q (m, Q)."""
        n = self.nuisance
        by_q = np.zeros((block.omega.size, n.size), dtype=complex)
        amplitude = float(np.exp(q[n.amplitude])) if block.kind == ELECTRICAL and n.amplitude is not None else None
        if block.kind == FILM or block.rig is None:
            value, by_k = k, np.ones_like(k)
        else:
            constants = self.constants(block.rig, q)
            value, by_k, by_constants = rig_of_constants(constants).response_slopes(k, block.omega, amplitude)
            by_q[:, list(n.rigs[block.rig])] = by_constants @ self.rigs[block.rig].slopes(constants)
        if n.gains:
            gain = np.exp(q[[n.gains[g] for g in range(len(self.groups))]])[block.group]
            value, by_k, by_q = value * gain, by_k * gain, by_q * gain[:, None]
            by_q[np.arange(block.omega.size), [n.gains[int(g)] for g in block.group]] += value
        if amplitude is not None and n.amplitude is not None:
            by_q[:, n.amplitude] = value
        if block.systematic is not None:
            places = list(n.calibration[block.number])
            value = value + block.systematic @ q[places]
            by_q[:, places] += block.systematic
        return value, by_k, by_q

    def predict_curve(self, block: Curve, theta: Float, shape: Shape, q: Float) -> tuple[Float, Float, Float]:
        """Force over final displacement (p,), its derivative by θ (p, size) and by q (p, Q)."""
        n = self.nuisance
        by_q = np.zeros((block.rows, n.size))
        hold = block.hold_at(n, q)
        gain, cell = 1.0, None
        if block.rig is None:
            value, by_theta = hold_stiffness(theta, shape, hold)
        else:
            constants = self.constants(block.rig, q)
            _, cell, _, gain = constants
            value, by_theta, by_cell = (gain * x for x in series_hold_stiffness(theta, shape, hold, cell))
            factor = self.rigs[block.rig].slopes(constants)
            by_q[:, list(n.rigs[block.rig])] = np.outer(by_cell / cell, factor[1]) + np.outer(value / gain, factor[3])
        for i, place in enumerate(n.calibration[block.number][2:] if block.own_gains else ()):
            more = hold.with_more(i, block.hold)
            if cell is None:
                more_value = hold_stiffness(theta, shape, more)[0]
            else:
                more_value = gain * series_hold_stiffness(theta, shape, more, cell)[0]
            by_q[:, place] = block.unequal * (more_value - value)
        if n.gains:
            place = n.gains[block.group]
            own = np.exp(q[place])
            value, by_theta, by_q = value * own, by_theta * own, by_q * own
            by_q[:, place] += value
        if block.number in n.calibration:
            level, height = n.calibration[block.number][:2]
            by_q[:, level], by_q[:, height] = block.offset, value * block.height
            value = value * (1 + block.height * q[height])
            by_theta *= 1 + block.height * q[height]
            value = value + block.offset * q[level]
        return value, by_theta, by_q

    def evaluate(self, theta: Float, shape: Shape) -> tuple[Float, Float]:
        """Weighted residuals model − data and prior rows (R,), and their Jacobian (R, P), at θ = (material, q)."""
        size, count = shape.size, self.nuisance.size
        q = theta[size:]
        rows = self.rows
        residual = np.empty(rows + self.nuisance.target.size)
        jacobian = np.zeros((residual.size, size + count))
        at = 0
        for block in self.blocks:
            m = block.weight.size
            if isinstance(block, Lines):
                k, slope = stiffness_and_slopes(theta, shape, block.omega)
                value, by_k, by_q = self.predict_lines(block, k, q)
                difference = (value - block.value) * block.weight
                slope *= (by_k * block.weight)[:, None]
                by_q *= block.weight[:, None]
                residual[at : at + m], residual[at + m : at + 2 * m] = difference.real, difference.imag
                jacobian[at : at + m, :size], jacobian[at + m : at + 2 * m, :size] = slope.real, slope.imag
                jacobian[at : at + m, size:], jacobian[at + m : at + 2 * m, size:] = by_q.real, by_q.imag
            else:
                level, by_theta, by_nuisance = self.predict_curve(block, theta, shape, q)
                residual[at : at + m] = (level - block.value) * block.weight
                jacobian[at : at + m, :size] = by_theta * block.weight[:, None]
                jacobian[at : at + m, size:] = by_nuisance * block.weight[:, None]
            at += block.rows
        residual[rows:] = self.nuisance.prior @ q - self.nuisance.target
        jacobian[rows:, size:] = self.nuisance.prior
        return residual, jacobian
