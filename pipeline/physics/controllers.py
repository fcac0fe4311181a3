"""Controllers that hold the capacitance of a self-sensing film at a demand: what voltage, from what is seen so far.

Each decides once per sample for n loops at once, so that one controller meets many films that it may be on. What the
loop is closed over (a virtual rig, a model with its uncertainty) is not their matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from pipeline.physics.sensed_film import SensedFilms
from schemas.arrays import Float

_ITERATIONS = 80
"""Of the bounded least squares of a predictive controller; its tests hold them against an exact solver."""
_FIRST_S, _GROWTH, _BLOCKS = 0.1, 1.35, 16
"""A plan of constant voltages: its first block, how much longer each next one is, how many there are; 34 s in all."""


class Loop(Protocol):
    """A controller at work in n loops."""

    def decide(self, deviation_pf: Float, demand_pf: float) -> Float:
        """Voltages (n,) in kV until the next sample, from deviations (n,) of the capacitance from rest."""
        ...


class Controller(Protocol):
    """Something that can be put to work."""

    def start(self, loops: int, interval_s: float) -> Loop:
        """n loops at rest, which decide once per interval."""
        ...


@dataclass(frozen=True)
class ProportionalIntegral:
    """u = Kp e + Ki ∫e dt in V of command, e the error in pF; at the limits of the voltage the integral stands still.

    Parameters
    ----------
    proportional_gain, integral_gain : V/pF and V/pF/s; (n,) for loops of different gains
    lowers : the voltage lowers the capacitance, e = C − C_d; else e = C_d − C
    gain_kv_per_v : of the amplifier
    largest_kv, bias_kv : largest voltage, and the one at rest
    square_root_drive : V² = u V_largest, so that the force follows u; else V = u
    """

    proportional_gain: float | Float
    integral_gain: float | Float
    lowers: bool
    gain_kv_per_v: float
    largest_kv: float
    bias_kv: float = 0.0
    square_root_drive: bool = False

    def start(self, loops: int, interval_s: float) -> Loop:
        return _Integrating(self, np.zeros(loops), interval_s)


@dataclass
class _Integrating:
    given: ProportionalIntegral
    integral: Float
    interval_s: float

    def decide(self, deviation_pf: Float, demand_pf: float) -> Float:
        own = self.given
        error = (1.0 if own.lowers else -1.0) * (deviation_pf - demand_pf)
        step = own.integral_gain * error * self.interval_s
        free = own.bias_kv / own.gain_kv_per_v + own.proportional_gain * error + self.integral + step
        wanted = free * own.gain_kv_per_v
        asked = np.minimum(np.maximum(wanted, 0.0), own.largest_kv)
        inside = ((wanted > 0) & (wanted < own.largest_kv)) | (step * free < 0)
        self.integral = np.where(inside, self.integral + step, self.integral)
        return np.asarray(np.sqrt(asked * own.largest_kv) if own.square_root_drive else asked)


@dataclass(frozen=True)
class FilmInverse:
    """The film's model run backwards: the voltage that takes the capacitance to its demand as quickly as a limit of the
    force allows, and a PI controller on what the capacitance does otherwise.

    Parameters
    ----------
    film : one film, as identified
    trim : PI controller with a square-root drive; it sees the capacitance less that of the model
    force_limit : largest V² over that which holds the demand at rest; force goes with V²
    lag_s : how much later than in the model the capacitance is seen (amplifier and filter)

    Notes
    -----
    While the film is short of the demand V² stands at its limit; from then on it is the V² that holds it there, which
    falls as the film relaxes. No other V² below that limit gets there sooner, because the film's response to V² never
    falls.
    """

    film: SensedFilms
    trim: ProportionalIntegral
    force_limit: float
    lag_s: float = 0.0

    def start(self, loops: int, interval_s: float) -> Loop:
        advance, gather = self.film.propagate(interval_s)
        keep = math.exp(-interval_s / self.lag_s) if self.lag_s else 0.0
        slowest = math.exp(-interval_s / max(interval_s, float(self.film.tau_s.max(initial=0.0))))
        a, zero = self.film.springs.shape[1], np.zeros(loops)
        return _Inverting(
            self,
            advance,
            gather,
            np.zeros((1, a)),
            np.zeros((loops, a)),
            zero,
            zero,
            zero,
            0.0,
            keep,
            slowest,
            interval_s,
        )


@dataclass
class _Inverting:
    given: FilmInverse
    advance: Float
    gather: Float
    points: Float
    """(1, a) internal points of the model on its way to the demand."""
    applied: Float
    """(n, a) those of the model under the voltages that were decided."""
    integral: Float
    """(n,) kV²: what the trim has found the model to lack."""
    modelled_pf: Float
    lasting_pf: Float
    """(n,) capacitance less that of the model under the same voltage, over the film's slowest relaxation: for the limit."""
    seen_pf: float
    keep: float
    slowest: float
    interval_s: float

    def decide(self, deviation_pf: Float, demand_pf: float) -> Float:
        own, trim = self.given, self.given.trim
        rest = demand_pf / float(own.film.gain_pf_per_kv2[0])
        held = np.minimum(np.maximum(own.film.hold(self.points, np.array([rest])), 0.0), own.force_limit * rest)
        modelled = float((own.film.gain_pf_per_kv2 * own.film.extend(self.points, held))[0])
        self.seen_pf = self.keep * self.seen_pf + (1 - self.keep) * modelled
        scale = trim.gain_kv_per_v * trim.largest_kv
        error = (1.0 if trim.lowers else -1.0) * (deviation_pf - self.seen_pf)
        step = scale * trim.integral_gain * error * self.interval_s
        free = held[0] + scale * trim.proportional_gain * error + self.integral + step
        gain = float(own.film.gain_pf_per_kv2[0])
        self.lasting_pf = self.slowest * self.lasting_pf + (1 - self.slowest) * (deviation_pf - self.modelled_pf)
        at_rest = np.maximum((demand_pf - self.lasting_pf) / gain, 0.0)
        asked = np.minimum(np.maximum(free, 0.0), np.minimum(trim.largest_kv**2, own.force_limit * at_rest))
        self.integral = np.where((free == asked) | (step * (free - asked) < 0), self.integral + step, self.integral)
        there = gain * own.film.extend(self.applied, asked)
        self.modelled_pf = self.keep * self.modelled_pf + (1 - self.keep) * there
        self.points = self.points @ self.advance[0].T + self.gather * held[:, None]
        self.applied = self.applied @ self.advance[0].T + self.gather * asked[:, None]
        return np.asarray(np.sqrt(asked))


@dataclass(frozen=True)
class Predictive:
    """A plan at each decision: the V² to come, within limits, for which the film's model leaves the least squared
    error.

    Parameters
    ----------
    film : one film, as identified (or the true one, which no other controller can better)
    largest_kv : largest voltage
    force_limit : largest V² over that which holds the demand at rest
    lag_s : how much later than in the model the capacitance is seen
    observe_s : time within which a difference from the model is taken for lasting; the limit follows it no faster than
        the film's slowest relaxation, for a model that is wrong only at first must not lift it
    """

    film: SensedFilms
    largest_kv: float
    force_limit: float
    lag_s: float = 0.0
    observe_s: float = 0.5

    def start(self, loops: int, interval_s: float) -> Loop:
        every = max(1, round(_FIRST_S / interval_s))
        plan = Plan.of(self.film, every * interval_s)
        advance, gather = self.film.propagate(interval_s)
        a = self.film.springs.shape[1]
        zero = np.zeros(loops)
        keep = math.exp(-interval_s / self.lag_s) if self.lag_s else 0.0
        slow = math.exp(-interval_s / self.observe_s)
        slowest = math.exp(-interval_s / max(self.observe_s, float(self.film.tau_s.max(initial=0.0))))
        return _Planning(
            self, plan, advance, gather, np.zeros((loops, a)), zero, zero, zero, zero, np.zeros((loops, _BLOCKS)),
            keep, slow, slowest, every,
        )  # fmt: skip


@dataclass(frozen=True)
class Plan:
    """What a film's capacitance, over its gain, does for V² that is constant in blocks: e = `free` q + `forced` v.

    `forced` is (m, b) at m moments of equal distance, `free` (m, a); `weight` (m,) counts each moment by the time it
    stands for.
    """

    free: Float
    forced: Float
    weight: Float

    @classmethod
    def of(cls, film: SensedFilms, first_s: float) -> Plan:
        """The plan of one film whose first block lasts `first_s`."""
        lengths = np.maximum(1, np.round(_GROWTH ** np.arange(_BLOCKS))).astype(int)
        advance, gather = (m[0] for m in film.propagate(first_s))
        a, instant, springs = film.springs.shape[1], 1 + float(film.springs.sum()), film.springs[0]
        free_q, forced_q = np.eye(a), np.zeros((a, _BLOCKS))
        free, forced = [], []
        for block, length in enumerate(lengths):
            for _ in range(length):
                free_q, forced_q = advance @ free_q, advance @ forced_q
                forced_q[:, block] += gather
                free.append(springs @ free_q / instant)
                row = springs @ forced_q / instant
                row[block] += 1 / instant
                forced.append(row)
        return cls(np.array(free), np.array(forced), np.full(int(lengths.sum()), first_s))

    def solve(self, points: Float, target: Float, most: Float, start: Float) -> Float:
        """V² of the blocks (n, b) between 0 and `most` (n,) with the least squared distance of e from `target` (n,).

        Parameters
        ----------
        points : (n, a) internal points now
        target : (n,) e that is wanted, kV²
        most : (n,) largest V²
        start : (n, b) where the search begins

        Notes
        -----
        Alternating directions (Boyd et al. 2011) with one factored matrix for all loops. A weak pull on changes from
        block to block makes the optimum unique.
        """
        weighted, stiffness, solver = self._factored
        pull = (target[:, None] - points @ self.free.T) @ weighted
        high = most[:, None]
        x, u = np.clip(start, 0.0, high), np.zeros_like(start)
        pulled, z = np.empty_like(u), np.empty_like(u)
        for _ in range(_ITERATIONS):
            # z = (pull + stiffness (x − u)) @ solver, x = z + u within its limits, u = u + z − x; in place, for there are many.
            np.subtract(x, u, out=pulled)
            pulled *= stiffness
            pulled += pull
            np.matmul(pulled, solver, out=z)
            np.add(z, u, out=x)
            np.maximum(x, 0.0, out=x)
            np.minimum(x, high, out=x)
            z -= x
            u += z
        return np.asarray(x)

    @cached_property
    def _factored(self) -> tuple[Float, float, Float]:
        """`forced` by its weights (m, b), the stiffness of the alternating directions, and their inverse matrix (b, b)."""
        b = self.forced.shape[1]
        weighted = self.forced * self.weight[:, None]
        changes = np.diff(np.eye(b), axis=0)
        hessian = self.forced.T @ weighted + 1e-4 * float(self.weight.sum()) / b * changes.T @ changes
        stiffness = float(np.sqrt(np.prod(np.linalg.eigvalsh(hessian)[[0, -1]])))
        return weighted, stiffness, np.linalg.inv(hessian + stiffness * np.eye(b))


@dataclass
class _Planning:
    given: Predictive
    plan: Plan
    advance: Float
    gather: Float
    points: Float
    """(n, a) internal points of the model under the voltages that were decided."""
    seen_pf: Float
    lacking_pf: Float
    """(n,) capacitance seen less that of the model, smoothed: what is taken for lasting."""
    lasting_pf: Float
    """(n,) the same over the film's slowest relaxation, for the limit."""
    squared: Float
    planned: Float
    keep: float
    slow: float
    slowest: float
    every: int
    tick: int = 0

    def decide(self, deviation_pf: Float, demand_pf: float) -> Float:
        own = self.given
        gain = float(own.film.gain_pf_per_kv2[0])
        lacking = deviation_pf - self.seen_pf
        self.lacking_pf = self.slow * self.lacking_pf + (1 - self.slow) * lacking
        self.lasting_pf = self.slowest * self.lasting_pf + (1 - self.slowest) * lacking
        if self.tick % self.every == 0:
            target = (demand_pf - self.lacking_pf) / gain
            at_rest = np.maximum((demand_pf - self.lasting_pf) / gain, 0.0)
            most = np.minimum(own.largest_kv**2, own.force_limit * at_rest)
            self.planned = self.plan.solve(self.points, target, most, self.planned)
            self.squared = self.planned[:, 0]
        self.tick += 1
        modelled = gain * own.film.extend(self.points, self.squared)
        self.seen_pf = self.keep * self.seen_pf + (1 - self.keep) * modelled
        self.points = self.points @ self.advance[0].T + self.squared[:, None] * self.gather[0]
        return np.sqrt(self.squared)
