"""Steps in a channel that drifts, where there are too few rests to know the drift from them: everything fitted at once.

    x(t) = x0 + b d(t) + Σ (A_c − B_c e^{−(t − on)/τ})   while the voltage is on, and B_c (1 − e^{−(off − on)/τ}) e^{−(t − off)/τ} after it

d is the course of a film that relaxes or recovers: quicker first, a logarithm of time or an exponential. A load that itself moves follows
no such course, and is refused. Belongs here: one to four steps of a record. Does not belong here: the slow change of many rest levels
(`step_levels`), static forces whose drift may have any smooth course (`static_force`).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from pipeline.transform.step_edges import EDGE_S, Edges
from pipeline.transform.step_levels import on_span
from schemas.arrays import Float, Int

_WINDOWS = 14
"""Means into which each part of the record is taken together, shorter ones first: what comes after an edge is quickest there."""
_SHORTEST = 1 / 200
"""Share of its part that the first of them takes."""
_FEWEST_SAMPLES = 4
_BENDS = tuple(float(share) for share in np.geomspace(1 / 300, 1.0, 14))
"""Shares of the record in which a logarithm bends that are tried, from what looks like a step to what is nearly straight."""
_TIMES = tuple(float(share) for share in np.geomspace(1 / 60, 0.6, 12))
"""Shares of the record after which an exponential has gone to 1/e; of one that takes longer the end cannot be told."""
_SLOW = tuple(float(share) for share in np.geomspace(1 / 100, 0.5, 8))
"""Shares of a time of voltage after which the slow part of a step has gone to 1/e; a slower one cannot be told from drift."""
_OPEN = 1e6
"""Condition of a design from which one of its parameters is left open."""
_MOVED = 1e-3
"""Change of the logarithm of a time by which derivatives are taken."""
_DESCRIBED = 0.03
"""Share of the step that the course may leave beside its noise: over steps of 10 % that come with 2 s and 1 to 20 times their size of
drift it leaves 0.01 at most, with a load that swings or climbs by a step 0.2 and more."""
_KNOWN = 0.1
"""Standard deviation of a step, over the step, up to which it is known."""


@dataclass(frozen=True)
class DriftingStep:
    """A step as it ends, positive where the channel rises, the level it would come back to then, and its standard deviation."""

    rest: float
    step: float
    step_sd: float


@dataclass(frozen=True)
class _Windows:
    """Samples taken together: where each window begins, of which part it is, its mean and standard deviation."""

    time: Float
    starts: Int
    mean: Float
    sd: Float


def fit_drifting_steps(t: Float, x: Float, phases: Sequence[Edges], memory: float) -> list[DriftingStep] | None:
    """The steps of a channel, fitted together with the drift of what they stand on.

    Parameters
    ----------
    t, x : (n,) s and values of the channel
    phases : times of voltage, in their order; the first may begin with the record, and is then known by its fall alone
    memory : correlation of the noise from one sample to the next

    Returns
    -------
    One step for each phase. None where the record is none of a drift that slows down with steps on it, or leaves one of them open.
    """
    windows = _take_windows(t, x, phases, memory)
    if windows is None:
        return None
    kinds = [(False, False), (True, False), *([] if phases[0].has_rest else [(True, True)])]
    forms = [_Form(windows, tuple(phases), drift, *kind) for drift in (True, False) for kind in kinds]
    fits = [fit for form in forms if (fit := form.fit()) is not None]
    if not fits:
        return None
    best = min(fits, key=lambda fit: fit.squares + fit.price)
    variance = max(best.squares / best.freedom, 1.0)
    losses = np.array([fit.squares / variance + fit.price for fit in fits])
    share = np.exp(-(losses - losses.min()) / 2)
    share /= share.sum()
    steps, rests = (np.array([getattr(fit, name) for fit in fits]) for name in ("steps", "rests"))
    mean = share @ steps
    sd = np.sqrt(share @ (variance * np.array([fit.variance for fit in fits]) + (steps - mean) ** 2))
    left = float(np.sqrt(np.mean(best.left**2)))
    allowed = max(3 * float(np.sqrt(np.mean(windows.sd**2))), _DESCRIBED * float(np.abs(mean).min()))
    if left > allowed or (sd > _KNOWN * np.abs(mean)).any():
        return None
    return [
        DriftingStep(float(rest), float(step), float(one))
        for rest, step, one in zip(share @ rests, mean, sd, strict=True)
    ]


def _take_windows(t: Float, x: Float, phases: Sequence[Edges], memory: float) -> _Windows | None:
    """Windows of all parts, without what the edges take; None where a part has too few samples."""
    parts = []
    for number, phase in enumerate(phases):
        if phase.has_rest:
            parts.append((phases[number - 1].off if number else float(t[0]), phase.on - EDGE_S))
        parts.append((phase.reached + EDGE_S if phase.has_rest else float(t[0]), phase.leaves - EDGE_S))
    if phases[-1].has_fall:
        parts.append((phases[-1].off, phases[-1].off_end))
    groups: list[Int] = []
    for number, (begin, end) in enumerate(parts):
        begins = begin if number == 0 else begin + EDGE_S
        inside = np.flatnonzero((t >= begins) & (t < end))
        if inside.size < _FEWEST_SAMPLES:
            return None
        edges = np.unique(
            np.round(inside.size * np.concatenate([[0], np.geomspace(_SHORTEST, 1, _WINDOWS)])).astype(int)
        )
        groups += [inside[low:high] for low, high in itertools.pairwise(edges) if high - low >= 1]
    chosen = np.concatenate(groups)
    sizes = np.array([group.size for group in groups])
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    steps = np.diff(x[chosen])
    inner = np.setdiff1d(np.arange(steps.size), starts[1:] - 1)
    noise = float(np.std(steps[inner])) / math.sqrt(2 * (1 - memory)) if inner.size > 1 else 0.0
    sd = np.maximum(noise * np.sqrt((1 + memory) / (1 - memory) / sizes), np.finfo(float).eps * float(np.abs(x).max()))
    return _Windows(t[chosen], starts, np.add.reduceat(x[chosen], starts) / sizes, np.maximum(sd, np.finfo(float).tiny))


@dataclass(frozen=True)
class _Fit:
    """Weighted squares that a form leaves, of how many numbers, its price in parameters, what it leaves, steps with variance, levels beside them."""

    squares: float
    freedom: int
    price: float
    left: Float
    steps: Float
    variance: Float
    rests: Float


@dataclass(frozen=True)
class _Solved:
    """Linear parameters of a form at given times, whitened residual and design, and whether the design leaves none of them open."""

    solution: Float
    residual: Float
    design: Float
    is_told: bool


@dataclass(frozen=True)
class _Form:
    """One form: a drift by the logarithm of time or an exponential, steps with a slow part or at once.

    `from_start`: a voltage that is on from the first sample came on just before it, and its slow part comes in the record.
    """

    windows: _Windows
    phases: tuple[Edges, ...]
    is_logarithm: bool
    is_slow: bool
    from_start: bool

    def fit(self) -> _Fit | None:
        """The optimum over the times of drift and slow part, begun at the best of a grid; None where nothing can be told."""
        shortest = min(phase.off - phase.on for phase in self.phases)
        shares = [_BENDS if self.is_logarithm else _TIMES, *([_SLOW] if self.is_slow else [])]
        scales = np.array([self._record_s, *([shortest] if self.is_slow else [])])
        grid = [np.log(scales * np.array(point)) for point in itertools.product(*shares)]
        solved = [(self._solve(point), point) for point in grid]
        told = [(one.residual, point) for one, point in solved if one.is_told]
        if not told:
            return None
        start = min(told, key=lambda one: float(one[0] @ one[0]))[1]
        low, high = (np.log(scales * [share[end] for share in shares]) for end in (0, -1))
        searched = least_squares(
            lambda point: self._solve(point).residual,
            np.clip(start, low + 1e-9, high - 1e-9),
            bounds=(low, high),
            xtol=1e-6,
            ftol=1e-8,
            diff_step=1e-4,
        )
        return self._read(searched.x, self._solve(searched.x))

    @property
    def _record_s(self) -> float:
        return float(self.windows.time[-1] - self.windows.time[0])

    def _solve(self, point: Float) -> _Solved:
        time, windows = self.windows.time, self.windows
        columns = [np.ones_like(time), self._drift(time, point), *(_held(time, phase) for phase in self.phases)]
        if self.is_slow:
            columns += [self._slow_part(time, phase, math.exp(point[1])) for phase in self.phases]
        sizes = np.diff([*windows.starts, time.size])
        means = np.add.reduceat(np.column_stack(columns), windows.starts, axis=0) / sizes[:, None]
        design = means / windows.sd[:, None]
        norm = np.linalg.norm(design, axis=0)
        norm[norm == 0] = 1.0
        enough = design.shape[0] > design.shape[1] + point.size
        is_told = bool(enough and np.linalg.cond(design / norm) <= _OPEN)
        seen = windows.mean / windows.sd
        solution = np.linalg.lstsq(design / norm, seen, rcond=None)[0] / norm
        return _Solved(solution, seen - design @ solution, design, is_told)

    def _drift(self, time: Float, point: Float) -> Float:
        since = (time - self.windows.time[0]) / math.exp(point[0])
        return np.asarray(np.log1p(since) if self.is_logarithm else -np.expm1(-since))

    def _comes(self, phase: Edges) -> bool:
        """Whether the slow part of a step comes within the record."""
        return phase.has_rest or self.from_start

    def _slow_part(self, time: Float, phase: Edges, slow: float) -> Float:
        """What has not yet come while the voltage is on, negative, and what has not yet gone after it."""
        on, off = time - phase.on, time - phase.off
        come = -np.exp(-np.maximum(on, 0) / slow) if self._comes(phase) else np.zeros_like(time)
        lasted = -math.expm1(-(phase.off - phase.on) / slow) if self._comes(phase) else 1.0
        gone = lasted * np.exp(-np.maximum(off, 0) / slow)
        return np.asarray(np.where(off >= 0, gone, np.where(on >= 0, come, 0.0)))

    def _read(self, point: Float, solved: _Solved) -> _Fit:
        solution, residual, design = solved.solution, solved.residual, solved.design
        count, linear = len(self.phases), solution.size
        whole = np.column_stack([design, self._by_times(point, solution)])
        norm = np.linalg.norm(whole, axis=0)
        norm[norm == 0] = 1.0
        covariance = np.linalg.pinv((whole / norm).T @ (whole / norm), rcond=1e-10, hermitian=True) / np.outer(
            norm, norm
        )
        read = np.zeros((count, whole.shape[1]))
        for i, phase in enumerate(self.phases):
            read[i, 2 + i] = 1.0
            if self.is_slow and self._comes(phase):
                read[i, 2 + count + i] = -_at_end(phase, math.exp(point[1]))
                moved = _at_end(phase, math.exp(point[1] + _MOVED)) - _at_end(phase, math.exp(point[1]))
                read[i, linear + 1] = -solution[2 + count + i] * moved / _MOVED
        ends = np.array([float(self._drift(np.array([phase.leaves]), point)[0]) for phase in self.phases])
        freedom = max(residual.size - linear - point.size, 1)
        return _Fit(
            squares=float(residual @ residual),
            freedom=freedom,
            price=math.log(residual.size) * (linear + point.size),
            left=residual * self.windows.sd,
            steps=read[:, :linear] @ solution,
            variance=np.einsum("ij,jk,ik->i", read, covariance, read),
            rests=solution[0] + solution[1] * ends,
        )

    def _by_times(self, point: Float, solution: Float) -> Float:
        """(m, k) change of the whitened course with the logarithm of each time, the linear parameters held."""
        columns = []
        for i in range(point.size):
            up, down = (self._solve(point + sign * _MOVED * np.eye(point.size)[i]).design for sign in (1, -1))
            columns.append((up - down) @ solution / (2 * _MOVED))
        return np.column_stack(columns)


def _held(time: Float, phase: Edges) -> Float:
    return ((time >= phase.on) & (time < phase.off)).astype(float)


def _at_end(phase: Edges, slow: float) -> float:
    """Mean of what has not yet come over the span in which the level before the fall is read."""
    span = on_span(phase)
    begin = phase.leaves - span - phase.on
    return slow / span * (math.exp(-begin / slow) - math.exp(-(begin + span) / slow))
