"""The monitored voltage of a lifetime test as a trace: cleaned samples, running level, start of life, raised voltage.

Belongs here: what can be said from the voltage alone before any verdict. Does not belong here: other channels
(`breakdown_evidence`) and the verdict (`breakdown`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from schemas.arrays import Bool, Float
from schemas.errors import NotIdentifiableError
from schemas.recording import Channel

FULL, HALF, START = 0.90, 0.50, 0.95
"""Shares of the level: up, down, and of the set point where life begins."""
LONGEST_GAP_S = 0.5
_MISSING = 3.5
"""Two missing rows of a slow clock are no gap."""
_BLOCK_S = 0.1
_LEVEL_S = 1.0
_PLATEAU = 0.02
_RAISED = 1.05
_SUSTAINED_S = 0.5
_REACHED = 0.80
"""A plateau at this share of the set point or above is the test voltage, though 95 % were never reached."""
_ZERO = 0.02
_RETURNS, _AWAY = 3, 0.2
"""So often back, and so much of the time down: the voltage is not constant."""
_REGULAR = 0.02
"""Scatter of the distances of falls, over their mean, up to which a clock makes them and no film."""
_ELSEWHERE = 20.0
"""A voltage that is so many times the set point, or its inverse, has been given in other units than kV."""
_CLEARLY, _OFF, _PER_DIFFERENCE = 10.0, 0.02, 1.4826 / math.sqrt(2)
"""No voltage: less than so many standard deviations of its noise (one for the median difference of neighbours), and than so much of the set
point. The largest median of a test that was never switched on is four of them."""
_STEP = 0.075
"""A rise by this share of the set point from one sample to the next is a step, not a ramp."""


@dataclass(frozen=True)
class Trace:
    """Finite samples of the voltage, positive when on.

    Parameters
    ----------
    time : (n,) s since the first sample of the channel, its known delay taken off
    value : (n,) kV
    interval : s, median distance of samples
    set_point : kV
    level : (n,) kV, median of the last second (samples above half the set point) before each sample's tenth of a second
    dropouts : single samples lost or at zero between two that are up; they are not in `value`
    notes : what was assumed
    """

    time: Float
    value: Float
    interval: float
    set_point: float
    level: Float
    dropouts: int
    notes: tuple[str, ...]

    @property
    def longest_gap(self) -> float:
        """Distance of two samples above which the record has a gap, in s."""
        return max(LONGEST_GAP_S, _MISSING * self.interval)

    def until(self, stop: int) -> Trace:
        """The first `stop` samples."""
        return replace(self, time=self.time[:stop], value=self.value[:stop], level=self.level[:stop])


def finite_samples(channel: Channel, origin_ns: int) -> tuple[Float, Float]:
    """(time in s since `origin_ns` with the channel's delay taken off, value) of the finite samples."""
    time = np.empty(channel.time_ns.shape)
    np.subtract(channel.time_ns, origin_ns, out=time)  # of whole ns, exact
    time *= 1e-9
    time -= channel.delay_s or 0.0
    finite = np.isfinite(channel.values)
    return (time, channel.values) if finite.all() else (time[finite], channel.values[finite])


def voltage_trace(channel: Channel, set_point: float | None, *, leakage_times: Float | None = None) -> Trace:
    """The trace of a voltage channel.

    `set_point` in kV; None takes the first plateau. `leakage_times` are instants in s at which the leakage current
    jumps: a lost sample there is a discharge, not a drop-out of the monitor. Raises `NotIdentifiableError` when there
    are fewer than three finite samples or no voltage.
    """
    time, value = finite_samples(channel, int(channel.time_ns[0]) if channel.time_ns.size else 0)
    if time.size < 3:
        raise NotIdentifiableError("the voltage has fewer than three usable samples", where=channel.quantity)
    interval = float(np.median(np.diff(time), overwrite_input=True))
    notes: list[str] = []
    if abs(float(value.min())) > abs(float(value.max())) and _median_on(-value) > _median_on(value):
        value = -value
        notes.append("the monitored voltage is negative: its magnitude is taken")
    plateau = _first_plateau(value, interval)
    differences = np.diff(value)
    np.abs(differences, out=differences)
    noise = float(np.median(differences, overwrite_input=True)) * _PER_DIFFERENCE
    del differences
    if plateau < min(_CLEARLY * noise, _OFF * set_point if set_point else np.inf):
        raise NotIdentifiableError(
            f"the monitor shows no voltage above its noise of {noise:.2g} kV",
            where=channel.quantity,
            expected=f"a test at {set_point:g} kV" if set_point else "the voltage of a test",
            remedy="Look whether the amplifier was on and its monitor connected",
        )
    if set_point is None:
        set_point = plateau
        notes.append(f"no voltage_setpoint_kv: {set_point:.3g} kV taken from the record")
    if set_point > 0 and plateau > 0 and max(plateau / set_point, set_point / plateau) > _ELSEWHERE:
        notes.append(f"the voltage settles at {plateau:.3g} kV, the set point is {set_point:g} kV: look at the unit")
        set_point = plateau
    if not set_point > 0 or float(value.max()) <= 0:
        raise NotIdentifiableError("the monitor shows no voltage", where=channel.quantity)
    if plateau >= _REACHED * set_point and not (value >= START * set_point).any():
        notes.append(f"the voltage settles at {plateau:.3g} kV, below 95 % of the set point {set_point:g} kV")
        set_point = plateau
    level = _running_level(value, interval, set_point)
    lost = _dropouts(time, value, level, set_point, leakage_times)
    dropouts = int(lost.sum()) + _isolated_missing(channel)
    if lost.any():
        time, value, level = time[~lost], value[~lost], level[~lost]
    return Trace(time, value, interval, set_point, level, dropouts, tuple(notes))


def _median_on(value: Float) -> float:
    on = value[value > 0.5 * value.max()] if value.max() > 0 else value[:0]
    return float(np.median(on)) if on.size else 0.0


def block_medians(value: Float, interval: float) -> tuple[Float, int]:
    """Medians of successive tenths of a second (at least one sample each), and the samples in one."""
    size = max(1, round(_BLOCK_S / interval)) if interval > 0 else 1
    blocks = max(value.size // size, 1)
    used = value[: blocks * size].reshape(blocks, -1) if value.size >= size else value[None, :]
    return np.asarray(np.median(used, axis=1) if size > 1 else used[:, 0]), size


def _first_plateau(value: Float, interval: float) -> float:
    """Level of the first second in which the voltage is constant to 2 %; the largest tenth of a second without one."""
    medians, size = block_medians(value, interval)
    window = max(2, round(_LEVEL_S / (size * interval)))
    if medians.size >= window:
        views = sliding_window_view(medians, window)
        low, high = views.min(axis=1), views.max(axis=1)
        flat = (high - low <= _PLATEAU * high) & (low >= 0.2 * medians.max())
        if flat.any():
            return float(np.median(views[np.argmax(flat)]))
    return float(medians.max())


def _running_level(value: Float, interval: float, set_point: float) -> Float:
    """(n,) median of the last second's samples that are above half the set point, up to the tenth before each sample."""
    medians, size = block_medians(value, interval)
    window = max(1, round(_LEVEL_S / (size * interval)))
    on = np.where(medians >= HALF * set_point, medians, np.nan)
    padded = np.concatenate((np.full(window, np.nan), on))
    ordered = np.sort(sliding_window_view(padded, window)[: medians.size + 1], axis=1)
    known = np.count_nonzero(~np.isnan(ordered), axis=1)
    level = np.where(known > 0, ordered[np.arange(ordered.shape[0]), np.maximum(known - 1, 0) // 2], np.nan)
    level[0] = set_point if np.isnan(level[0]) else level[0]
    filled = np.maximum.accumulate(np.where(np.isnan(level), 0, np.arange(level.size)))
    return np.repeat(level[filled], size)[: value.size]  # one block more than there are samples


def _dropouts(time: Float, value: Float, level: Float, set_point: float, leakage_times: Float | None) -> Bool:
    """(n,) single samples at zero between two that are up."""
    lost = np.zeros(value.size, dtype=np.bool_)
    up = value >= FULL * level
    lost[1:-1] = (np.abs(value[1:-1]) <= _ZERO * set_point) & up[:-2] & up[2:]
    if leakage_times is not None and leakage_times.size:
        for row in np.flatnonzero(lost):
            lost[row] = not np.any(np.abs(leakage_times - time[row]) <= _BLOCK_S)
    return lost


def _isolated_missing(channel: Channel) -> int:
    missing = ~np.isfinite(channel.values)
    return int(np.count_nonzero(missing[1:-1] & ~missing[:-2] & ~missing[2:])) if missing.size > 2 else 0


def application(trace: Trace) -> float:
    """Time in s at which the voltage first exceeds a tenth of the set point."""
    return float(trace.time[int(np.argmax(trace.value >= 0.1 * trace.set_point))])


def start_of_life(trace: Trace) -> tuple[int, float] | None:
    """Sample and time in s at which the voltage first reaches 95 % of the set point; None when it never does.

    A lone spike does not count. In a slow ramp noise would carry single samples over the limit too early, so the
    crossing is taken from a running mean that is short against the climb from 80 to 95 %.
    """
    limit = START * trace.set_point
    reached = np.flatnonzero(trace.value >= limit)
    first = next((int(i) for i in reached[:1000] if not _lone(trace.value, int(i), trace.set_point)), None)
    if first is None:
        return None
    climb = first - int(np.argmax(trace.value[: first + 1] >= _REACHED * trace.set_point))
    half = climb // 8
    begin, end = max(first - climb - half, 0), min(first + 2 * climb + half + 1, trace.value.size)
    around = trace.value[begin:end]
    width = 2 * half + 1
    stepped = climb > 0 and float(np.diff(around[: first - begin + 1]).max(initial=0.0)) > _STEP * trace.set_point
    if half < 2 or stepped or around.size < width:
        return first, float(trace.time[first])
    sums = np.concatenate(([0.0], np.cumsum(around)))
    crossed = np.flatnonzero(sums[width:] - sums[:-width] >= width * limit)
    index = begin + half + int(crossed[0]) if crossed.size else first
    return index, float(trace.time[index])


def _lone(value: Float, i: int, set_point: float) -> bool:
    neighbours = value[max(i - 1, 0) : i + 2 : 2] if i > 0 else value[1:2]
    return bool(neighbours.size and np.all(neighbours < HALF * set_point))


@dataclass(frozen=True)
class Raise:
    """The voltage was raised above its set point: `time` in s when it left the set point, number of `steps` seen."""

    time: float
    steps: int


def raised_voltage(trace: Trace, start: int) -> Raise | None:
    """When the voltage left the set point upwards for half a second or more; None when it did not.

    `steps` counts the different plateaus (constant to 2 % for a second) from the start on.
    """
    medians, size = block_medians(trace.value[start:], trace.interval)
    times = trace.time[start:][np.minimum(np.arange(medians.size) * size, trace.time.size - start - 1)]
    needed = max(1, round(_SUSTAINED_S / (size * trace.interval)))
    above = medians > _RAISED * trace.set_point
    if np.count_nonzero(above) < needed:
        return None
    runs = sliding_window_view(above, needed).all(axis=1)
    if not runs.any():
        return None
    first = int(np.argmax(runs))
    held = medians[:first][medians[:first] >= FULL * trace.set_point]
    usual = float(np.median(held)) if held.size else trace.set_point
    at_rest = np.flatnonzero(medians[:first] <= usual * (1 + _PLATEAU / 2))
    left = int(at_rest[-1]) + 1 if at_rest.size else 0
    return Raise(float(times[min(left, times.size - 1)]), plateaus(medians, size * trace.interval).size)


def plateaus(medians: Float, block_s: float) -> Float:
    """Different levels, in kV and in order, at which block medians stay constant to 2 % for a second."""
    window = max(2, round(_LEVEL_S / block_s))
    if medians.size < window or medians.max() <= 0:
        return np.empty(0)
    views = sliding_window_view(medians, window)
    low, high = views.min(axis=1), views.max(axis=1)
    flat = views.mean(axis=1)[(high - low <= _PLATEAU * high) & (low >= 0.1 * medians.max())]
    levels: list[float] = []
    while flat.size:
        levels.append(float(flat[0]))
        other = np.abs(flat - flat[0]) > _PLATEAU * flat[0]
        flat = flat[int(np.argmax(other)) :] if other.any() else flat[:0]
    return np.array(levels)


def check_constant(trace: Trace, start: int) -> None:
    """Raises `NotIdentifiableError` when the voltage alternates, swings, or is switched by a clock, from its start of life on.

    A life belongs to one voltage. Self-healing discharges and sags that recover leave the voltage up for most of the time,
    and come when they come.
    """
    problem = _find_switching(trace, start) or _find_swings(trace, start)
    if problem:
        raise NotIdentifiableError(
            problem, expected="constant voltage for a life", remedy="Give tests in cycles as a table of lives"
        )


def _find_switching(trace: Trace, start: int) -> str:
    """In words how the voltage goes off and comes back as no film makes it; empty where it does not."""
    value, time = trace.value[start:], trace.time[start:]
    state = _state(value, FULL * trace.set_point, HALF * trace.set_point)
    last = np.flatnonzero(state == 1)
    state = state[: int(last[-1]) + 1 if last.size else 0]
    away = np.count_nonzero(state == -1) / state.size if state.size else 0.0
    changes = np.concatenate(([0], np.flatnonzero(np.diff(state)) + 1)) if state.size else np.empty(0, dtype=np.int64)
    known = changes[state[changes] != 0]
    turns = np.diff(state[known])
    returns, falls = int(np.count_nonzero(turns > 0)), time[known[1:][turns < 0]]
    below = float(value.min())
    if below < -HALF * trace.set_point and np.count_nonzero(value < -HALF * trace.set_point) >= 2 and returns:
        return f"the voltage alternates between {below:.3g} and {float(value.max()):.3g} kV: not constant"
    if returns >= _RETURNS and away > _AWAY:
        return f"the voltage came back {returns} times and was down for {100 * away:.0f} % of the time: not constant"
    apart = np.diff(falls)
    if apart.size >= _RETURNS and np.ptp(apart) < _REGULAR * apart.mean() + 2 * trace.interval < 0.5 * apart.mean():
        return f"the voltage went off every {apart.mean():.3g} s and came back {returns} times: not constant"
    return ""


def _state(value: Float, up: float, down: float) -> NDArray[np.int8]:
    """(n,) 1 from `up` on, −1 below `down`, 0 between."""
    state = (value >= up).astype(np.int8)
    state[value < down] = -1
    return state


def _find_swings(trace: Trace, start: int) -> str:
    """In words how the voltage goes to and fro about its set point; empty where it does not."""
    medians, _ = block_medians(trace.value[start:], trace.interval)
    up = medians[medians >= HALF * trace.set_point]
    state = np.where(up > _RAISED * trace.set_point, 1, np.where(up < trace.set_point / _RAISED, -1, 0))
    returns = int(np.count_nonzero(np.diff(state[state != 0]) > 0))
    if returns < _RETURNS or min(float(np.mean(state == 1)), float(np.mean(state == -1))) < _AWAY:
        return ""
    return f"the voltage goes to and fro between {up.min():.3g} and {up.max():.3g} kV: not constant"


def current_jumps(channel: Channel | None, origin_ns: int) -> Float | None:
    """Instants in s at which the leakage current rises far above its usual value; None without the channel."""
    if channel is None:
        return None
    time, value = finite_samples(channel, origin_ns)
    if time.size < 3:
        return None
    usual = float(np.median(value))
    spread = 1.4826 * float(np.median(np.abs(value - usual)))
    return time[value > usual + max(10 * spread, 2 * abs(usual), 1e-12)]


def first_gap(trace: Trace, start: int) -> int | None:
    """Last sample before the first gap after `start`; None without a gap."""
    gaps = np.flatnonzero(np.diff(trace.time[start:]) > trace.longest_gap)
    return start + int(gaps[0]) if gaps.size else None
