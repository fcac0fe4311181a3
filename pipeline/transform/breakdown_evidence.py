"""What a fall of the voltage looks like, and what command, force and leakage current say about it.

Belongs here: the shape of a decay, the state of the command, steps of other channels at an instant. Does not belong
here: the voltage's own events (`breakdown_signal`) and the verdict (`breakdown`).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from pipeline.transform.breakdown_signal import FULL, Trace, finite_samples
from schemas.arrays import Float
from schemas.recording import Channel

SHORTEST_DISCHARGE_S = 1.6e-3
"""A 33 MΩ resistor across 50 pF of specimen and cable: no switched-off film discharges faster."""
LIKE_BREAKDOWN_S = 20e-3
"""A discharge time below this can look like a breakdown."""
_EXPONENTIAL_POINTS = 3
_NEAR_S = 0.1
_BEFORE_S = 1.0
_RESIDUAL = 0.02
_SIGNIFICANT = 6.0
_STEADY = 0.8
"""A residual voltage that still falls by a fifth while it is watched is a discharge cut short."""

ABRUPT, EXPONENTIAL, OTHER, UNRESOLVED = "abrupt", "exponential", "other", "unresolved"


@dataclass(frozen=True)
class Decay:
    """Shape of a fall that lasts.

    `kind`: `abrupt` (faster than any discharge through the resistor), `exponential` with `time_constant_s` to zero,
    `other` (resolved, but no exponential), `unresolved` (too few samples on the way down). `residual_kv` is what is left
    when all discharge is over; `holds` says that it differs from zero: a broken film on a live supply.
    """

    kind: str
    time_constant_s: float
    residual_kv: float
    holds: bool


def decay(trace: Trace, last: int, end: int, level: float) -> Decay:
    """Shape of the fall that follows sample `last`, judged up to sample `end` (exclusive), from `level` in kV."""
    noise = trace.noise(max(0, last - round(_BEFORE_S / trace.interval)), last + 1)
    off = trace.value[: int(np.argmax(trace.value >= 0.1 * trace.set_point))]
    zero = float(np.median(off)) if off.size >= 5 else 0.0
    time, value = trace.time[last:end] - trace.time[last], trace.value[last:end] - zero
    late = value[time >= 0.25] if (time >= 0.25).sum() >= 3 else value[-max(1, value.size // 3) :]
    residual = float(np.median(late))
    halves = float(np.median(late[: (late.size + 1) // 2])), float(np.median(late[late.size // 2 :]))
    steady = halves[1] >= _STEADY * halves[0]
    holds = steady and residual > max(_RESIDUAL * trace.set_point, _SIGNIFICANT * noise / np.sqrt(late.size))
    low = np.flatnonzero(value <= 0.1 * level)
    if low.size and time[low[0]] < np.log(FULL / 0.1) * SHORTEST_DISCHARGE_S:
        return Decay(ABRUPT, float("nan"), residual, holds)
    below = np.flatnonzero(value <= max(4 * noise, 0.03 * level))
    way = slice(1, int(below[0]) if below.size else value.size)
    t, v = time[way], value[way]
    if t.size < _EXPONENTIAL_POINTS or holds:
        return Decay(OTHER if holds and t.size >= _EXPONENTIAL_POINTS else UNRESOLVED, float("nan"), residual, holds)
    slope, offset = _weighted_line(t, np.log(v / level), v**2)
    fitted = level * np.exp(offset + slope * t)
    exponential = slope < 0 and float(np.sqrt(np.mean((v - fitted) ** 2))) <= max(3 * noise, 0.02 * level)
    if not exponential:
        return Decay(OTHER, float("nan"), residual, holds)
    return Decay(EXPONENTIAL, -1 / slope, residual, holds)


def _weighted_line(x: Float, y: Float, weight: Float) -> tuple[float, float]:
    total = weight.sum()
    mean_x, mean_y = float(weight @ x / total), float(weight @ y / total)
    spread = float(weight @ (x - mean_x) ** 2)
    slope = float(weight @ ((x - mean_x) * (y - mean_y))) / spread if spread > 0 else 0.0
    return slope, mean_y - slope * mean_x


ON, OFF_FIRST, OFF_AFTER, UNCLEAR = "on", "off first", "off after", "unclear"


@dataclass(frozen=True)
class Command:
    """The amplifier's input, finite samples: `time` (n,) s on the voltage's clock, `value` (n,) V."""

    time: Float
    value: Float

    @functools.cached_property
    def interval(self) -> float:
        return float(np.median(np.diff(self.time)))

    @functools.cached_property
    def largest(self) -> float:
        return float(np.max(np.abs(self.value)))

    def _between(self, begin: float, end: float) -> slice:
        return slice(int(np.searchsorted(self.time, begin)), int(np.searchsorted(self.time, end, side="right")))

    def around(self, before: float, after: float, until: float) -> tuple[str, float]:
        """Whether the command was on while the voltage fell, and when it went off in s (NaN while on).

        The voltage left its level between `before` and `after`. `off first`: the command had left its level by then.
        `off after`: it went later, up to `until`. `unclear`: its samples are too coarse to say, or it is not there.
        """
        steady = self.value[self._between(before - 1.25, before - 0.25)]
        if not steady.size:
            steady = self.value[self._between(-np.inf, before)][-3:]
        reference = float(np.median(np.abs(steady))) if steady.size else 0.0
        if reference <= 0.01 * self.largest or self.time[-1] < after - self.interval:
            return UNCLEAR, float("nan")
        window = self._between(before - 0.25, until)
        time, off = self.time[window], np.abs(self.value[window]) < FULL * reference
        if not off.any():
            return ON, float("nan")
        first = int(np.argmax(off))
        gone, seen = float(time[first]), float(time[first - 1]) if first else before - 0.25
        slack = 0.25 * (after - before)
        if gone <= after + slack:
            return OFF_FIRST, gone
        return (OFF_AFTER if seen >= before else UNCLEAR), gone


def command_of(channel: Channel | None, origin_ns: int) -> Command | None:
    """The command channel, or None where it is absent, constant at zero or has fewer than two samples."""
    if channel is None:
        return None
    time, value = finite_samples(channel, origin_ns)
    if time.size < 2 or not np.any(np.abs(value) > 0):
        return None
    return Command(time, value)


def leakage_jumps(channel: Channel | None, origin_ns: int) -> Float | None:
    """Instants in s at which the leakage current rises far above its usual value; None without the channel."""
    if channel is None:
        return None
    time, value = finite_samples(channel, origin_ns)
    if time.size < 3:
        return None
    usual = float(np.median(value))
    spread = 1.4826 * float(np.median(np.abs(value - usual)))
    threshold = usual + max(10 * spread, 2 * abs(usual), 1e-12)
    return time[value > threshold]


def leakage_confirms(channel: Channel | None, origin_ns: int, instant: float) -> bool | None:
    """Whether the leakage current jumps up within 0.1 s of `instant`; None where it is not recorded there."""
    if channel is None:
        return None
    time, value = finite_samples(channel, origin_ns)
    before = value[(time >= instant - _BEFORE_S) & (time <= instant - 0.02)]
    after = value[(time > instant) & (time <= instant + _NEAR_S)]
    if before.size < 3 or after.size == 0:
        return None
    usual = float(np.median(before))
    spread = 1.4826 * float(np.median(np.abs(before - usual)))
    found = float(np.median(after)) if after.size >= 3 else float(after.max())
    return bool(found > usual + max(_SIGNIFICANT * spread, 0.5 * abs(usual)))


def force_confirms(channel: Channel | None, origin_ns: int, instant: float) -> bool | None:
    """Whether the force steps, either way, within 0.1 s of `instant`; None where it is not recorded there."""
    if channel is None:
        return None
    time, value = finite_samples(channel, origin_ns)
    recent = (time >= instant - _BEFORE_S) & (time <= instant)
    before = value[recent & (time >= instant - _NEAR_S)]
    after = value[(time > instant) & (time <= instant + _NEAR_S)]
    if before.size < 2 or after.size < 2 or recent.sum() < 4:
        return None
    differences = np.diff(value[recent])
    noise = 1.4826 * float(np.median(np.abs(differences - np.median(differences)))) / np.sqrt(2)
    step = abs(float(np.median(after[after.size // 3 :])) - float(np.median(before)))
    limit = _SIGNIFICANT * noise * np.sqrt(1 / before.size + 1 / max(after.size - after.size // 3, 1))
    return bool(step > max(limit, 1e-9))
