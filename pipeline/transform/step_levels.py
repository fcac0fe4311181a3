"""Levels of a channel around its steps, the course of one step, and the slow change beside all of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.transform.step_edges import LEVEL_S, Edges
from schemas.arrays import Float

FEWEST_RESTS = 5
"""Rest levels from which a slow change and what a film has not recovered are told apart."""
_LINE, _LOGARITHM, _EXPONENTIAL = "line", "logarithm", "exponential"
_SHAPES = (
    (_LINE, 1.0),
    *((_LOGARITHM, float(share)) for share in np.geomspace(1 / 300, 1.5, 16)),
    *((_EXPONENTIAL, float(share)) for share in np.geomspace(1 / 30, 1.0, 10)),
)
"""Shapes of a slow change and the share of the record in which it bends."""


@dataclass(frozen=True)
class Level:
    """Mean of a channel over a stretch whose middle is `time_s`, with its standard deviation and that of one sample."""

    time_s: float
    value: float
    sd: float
    noise: float


def level(t: Float, x: Float, begin: float, end: float, span: float, memory: float = 0.0) -> Level:
    """Level over the last `span` s before `end`, not before `begin`; NaN with fewer than two samples.

    `memory` is the correlation of the noise from one sample to the next.
    """
    first = max(begin, end - span)
    values = x[(t >= first) & (t < end)]
    if values.size < 2:
        return Level((first + end) / 2, math.nan, math.nan, math.nan)
    noise = float(np.std(np.diff(values))) / math.sqrt(2) if values.size > 2 else float(np.std(values))
    noise /= math.sqrt(1 - memory)
    sd = noise * math.sqrt((1 + memory) / (1 - memory) / values.size)
    return Level((first + end) / 2, float(values.mean()), sd, noise)


def noise_memory(t: Float, x: Float, phases: Sequence[Edges]) -> float:
    """Correlation of a channel's noise from one sample to the next, from all stretches that give a level.

    A straight line is taken out of each first, and what that takes from the correlation is given back. 0 where it is not
    significant.
    """
    products = squares = pairs = 0.0
    for phase in phases:
        for end in (phase.on - 0.01, phase.leaves - 0.01):
            inside = (t >= end - LEVEL_S) & (t < end)
            values = x[inside]
            if values.size < 8:
                continue
            rest = values - np.polyval(np.polyfit(t[inside] - end, values, 1), t[inside] - end)
            products += float(rest[1:] @ rest[:-1]) / (values.size - 1) * values.size
            squares += float(rest @ rest)
            # Two coefficients of the line take 2/n of the variance and as much from the neighbours' product.
            products += 2 / values.size * float(rest @ rest)
            pairs += values.size
    if squares <= 0 or pairs < 30:
        return 0.0
    found = products / squares
    return float(min(max(found, 0.0), 0.9)) if found > 2 / math.sqrt(pairs) else 0.0


def on_span(phase: Edges) -> float:
    """Averaging span while on: at most 0.5 s and at most a fifth of the phase."""
    return min(LEVEL_S, 0.2 * (phase.off - phase.on))


def rest_level(t: Float, x: Float, phase: Edges, memory: float = 0.0) -> Level:
    """Level before an on-edge."""
    return level(t, x, phase.on - LEVEL_S, phase.on - 0.01, LEVEL_S, memory)


def final_level(t: Float, x: Float, phase: Edges, memory: float = 0.0) -> Level:
    """Level before the voltage falls."""
    return level(t, x, phase.on, phase.leaves - 0.01, on_span(phase), memory)


@dataclass(frozen=True)
class SlowChange:
    """Slow change of a channel beside its steps: d(t) = b log10(1 + t/T), b (1 − e^(−t/T)) or b t/T, by its `shape`.

    `change` ± `change_sd` is what it amounts to from the first to the last rest level, over `duration_s`; `scale` is b,
    `bend_s` T. `unrecovered` is the share of a step that is still there at the rest level after it; `fading` the share
    that goes in the second half of the rest: what has stopped fading is no step that has not recovered.
    """

    change: float
    change_sd: float
    duration_s: float
    shape: str
    scale: float
    scale_sd: float
    bend_s: float
    unrecovered: float
    unrecovered_sd: float
    fading: float = 0.0

    def at(self, t: Float) -> Float:
        """d at the times t (n,) in s, 0 at the record's first sample."""
        return self.scale * _shape(np.maximum(t, 0.0), self.shape, self.bend_s)

    def between_sd(self, first: float, last: float) -> float:
        """Standard deviation of d(last) − d(first)."""
        ends = _shape(np.array([first, last]), self.shape, self.bend_s)
        return self.scale_sd * abs(float(ends[1] - ends[0]))


def _shape(t: Float, shape: str, bend_s: float) -> Float:
    if shape == _LOGARITHM:
        return np.asarray(np.log10(1 + t / bend_s))
    return np.asarray(-np.expm1(-t / bend_s) if shape == _EXPONENTIAL else t / bend_s)


def slow_change(t: Float, x: Float, phases: Sequence[Edges], memory: float) -> SlowChange | None:
    """Slow change of a channel from its rest levels; None with fewer than five of them.

    Rest level i is c + d(t_i) + ρ (step before it): what the film has not recovered yet goes with the size of the step and
    is not taken for a slow change. The bend T is the likeliest of a few.
    """
    rests = [rest_level(t, x, phase, memory) for phase in phases if phase.has_rest]
    steps = [0.0]
    for phase, rest in zip((p for p in phases if p.has_rest), rests, strict=True):
        steps.append(final_level(t, x, phase).value - rest.value)
    last = phases[-1]
    if last.has_fall and last.off_end - last.off > 2 * LEVEL_S:
        rests.append(level(t, x, last.off, last.off_end, LEVEL_S, memory))
    previous = np.array(steps[: len(rests)])
    times, values = np.array([r.time_s for r in rests]), np.array([r.value for r in rests])
    good = np.isfinite(values) & np.isfinite(previous)
    if good.sum() < FEWEST_RESTS:
        return None
    times, values, previous = times[good], values[good], previous[good]
    noise = float(np.sqrt(np.mean([r.sd**2 for r, kept in zip(rests, good, strict=True) if kept])))
    found = _likeliest(times, values, previous, noise)
    return None if found is None else replace(found, fading=_fading(t, x - found.at(t), phases))


def _fading(t: Float, x: Float, phases: Sequence[Edges]) -> float:
    """Mean share of the steps that goes between the middle and the end of the rests after them."""
    shares = []
    for phase in phases:
        length = phase.off_end - phase.off
        if not (phase.has_rest and phase.has_fall and length > 4 * LEVEL_S):
            continue
        step = final_level(t, x, phase).value - rest_level(t, x, phase).value
        middle = level(t, x, phase.off, phase.off + length / 2, LEVEL_S)
        end = level(t, x, phase.off, phase.off_end - 0.01, LEVEL_S)
        if step and math.isfinite(step):
            shares.append((middle.value - end.value) / step)
    return float(np.mean(shares)) if shares else 0.0


def _likeliest(times: Float, values: Float, previous: Float, noise: float) -> SlowChange | None:
    """The likeliest shape, none at all among them; what the choice changes goes into the standard deviation."""
    tried = [_fitted(times, values, previous, noise, shape, share * float(times[-1])) for shape, share in _SHAPES]
    found = [f for f in tried if f is not None]
    still = _fitted(times, values, previous, noise, None, float(times[-1]))
    if not found or still is None:
        return None
    variance = max(min(left for left, _ in found) / max(times.size - 4, 1), noise**2, 1e-300)
    # BIC: size and bend are two parameters more than none has, a line has one.
    price = [math.log(times.size) * (1 if one.shape == _LINE else 2) for _, one in found]
    left = np.array([rest / variance + p for (rest, _), p in zip(found, price, strict=True)] + [still[0] / variance])
    likely = np.exp(-(left - left.min()) / 2)
    likely /= likely.sum()
    candidates = [one for _, one in found] + [still[1]]
    best = candidates[int(left.argmin())]
    changes, sds = np.array([c.change for c in candidates]), np.array([c.change_sd for c in candidates])
    sd = math.sqrt(float(likely @ (sds**2 + (changes - best.change) ** 2)))
    left_over, left_sds = (
        np.array([c.unrecovered for c in candidates]),
        np.array([c.unrecovered_sd for c in candidates]),
    )
    left_sd = math.sqrt(float(likely @ (left_sds**2 + (left_over - best.unrecovered) ** 2)))
    reach = float(np.diff(_shape(times[[0, -1]], best.shape, best.bend_s))[0])
    return replace(best, change_sd=sd, scale_sd=sd / reach, unrecovered_sd=left_sd)


def _fitted(
    times: Float, values: Float, previous: Float, noise: float, shape: str | None, bend_s: float
) -> tuple[float, SlowChange] | None:
    """Sum of squares that a shape leaves and the change it gives; `shape` None: no change at all."""
    drawn = _shape(times, shape or _LINE, bend_s)
    columns = [np.ones_like(times), previous] + ([] if shape is None else [drawn])
    design = np.column_stack(columns)
    scale = np.linalg.norm(design, axis=0)
    if not scale.all() or np.linalg.cond(design / scale) > 1e6:
        return None
    solution = np.linalg.lstsq(design / scale, values, rcond=None)[0] / scale
    rest = float(np.sum((values - design @ solution) ** 2))
    # Noise of the levels alone is the least there is; what the shape does not follow comes on top.
    variance = max(rest / max(times.size - len(columns), 1), noise**2)
    covariance = variance * np.linalg.inv((design / scale).T @ (design / scale)) / np.outer(scale, scale)
    sd = np.sqrt(np.diag(covariance))
    reach, duration = float(drawn[-1] - drawn[0]), float(times[-1] - times[0])
    size, size_sd = (0.0, 0.0) if shape is None else (float(solution[2]), float(sd[2]))
    return rest, SlowChange(
        size * reach,
        size_sd * abs(reach),
        duration,
        shape or _LINE,
        size,
        size_sd,
        bend_s,
        float(solution[1]),
        float(sd[1]),
    )


@dataclass(frozen=True)
class Course:
    """A channel through one step: the change over the step `y` (n,) at times `t` since the on-edge, smoothed.

    `noise` is the standard deviation of one value of y.
    """

    rest: float
    step: float
    step_sd: float
    t: Float
    y: Float
    noise: float


def course(t: Float, x: Float, phase: Edges, slow: SlowChange | None, memory: float) -> Course | None:
    """The course of one step, the slow change taken out; None with too few samples around it."""
    rest = rest_level(t, x, phase, memory)
    steady = x if slow is None else x - (slow.at(t) - float(slow.at(np.array([rest.time_s]))[0]))
    final = final_level(t, steady, phase, memory)
    step = final.value - rest.value
    if not math.isfinite(step):
        return None
    sd = math.hypot(rest.sd, final.sd, 0.0 if slow is None else slow.between_sd(rest.time_s, final.time_s))
    during = (t >= phase.on - 0.2) & (t <= phase.off_end)
    relative = rest.noise / abs(step) if step else math.inf
    dt = float(np.median(np.diff(t[during]))) if during.sum() > 2 else math.inf
    width = int(min(max(1.0, (relative / 0.01) ** 2), max(1.0, 0.05 / dt)))
    y = (steady[during] - rest.value) / step if step else np.zeros(int(during.sum()))
    if width > 1:
        kernel = np.ones(width) / width
        y = np.convolve(np.pad(y, (width // 2, width - 1 - width // 2), mode="edge"), kernel, mode="valid")
    return Course(rest.value, step, sd, t[during] - phase.on, y, relative / math.sqrt(width))


def baseline_misfit(
    t: Float, x: Float, phase: Edges, rest_from: float, slow: SlowChange | None, memory: float, explained: float = 0.0
) -> float:
    """What a channel's level may have moved over one step beside it that the slow change does not account for.

    Parameters
    ----------
    t, x : (n,) s and values of the channel
    phase : of the step
    rest_from : s, when the rest before it began
    slow : slow change of the channel, None where there are too few rests for one
    memory : correlation of the noise from one sample to the next
    explained : how much of the change from the rest before to the rest after is what the film has not recovered

    Returns
    -------
    In the unit of the channel, not negative: the larger of two. By how much the rest level after the step is another
    than before it, of which without a slow change one half falls into the step; and how far the level runs in the
    second half of these rests, over the time from one level to the other. Without a slow change only the rest at the
    beginning of the record counts for the second: what runs in later ones is the film's own recovery. Of both only what
    goes beyond the noise.
    """
    steady = x if slow is None else x - slow.at(t)
    before, final = rest_level(t, steady, phase, memory), final_level(t, steady, phase, memory)
    spans = [((rest_from + phase.on) / 2, phase.on - 0.01)]
    moved = [0.0]
    if phase.has_fall and phase.off_end - phase.off > 2 * LEVEL_S:
        after = level(t, steady, phase.off, phase.off_end - 0.01, LEVEL_S, memory)
        change = _beyond_noise(after.value - before.value - explained, math.hypot(after.sd, before.sd))
        moved.append(change if slow is not None else change / 2)
        spans.append(((phase.off + phase.off_end) / 2, phase.off_end - 0.01))
    if slow is None:
        spans = spans[:1] if rest_from <= t[0] else []
    for begin, end in spans:
        first = level(t, steady, begin, begin + LEVEL_S, LEVEL_S, memory)
        last = level(t, steady, end - LEVEL_S, end, LEVEL_S, memory)
        apart = last.time_s - first.time_s
        if apart > LEVEL_S:
            run = _beyond_noise(last.value - first.value, math.hypot(first.sd, last.sd))
            moved.append(run * (final.time_s - before.time_s) / apart)
    return max(moved)


def _beyond_noise(change: float, sd: float) -> float:
    """How far a change goes beyond three standard deviations; 0 where it is not known."""
    return max(abs(change) - 3 * sd, 0.0) if math.isfinite(change) else 0.0
