"""Which test a trace shows, by its shape: step and hold, triangle, sinusoid, sweep, multisine, noise, constant voltage.

A guess for drafts alone, from the channel that drives (voltage, displacement, stretch, input). Each says in words what
was seen, and how sure it is: `sure` where one shape fits and no other does, `likely` where another might be meant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from schemas.arrays import Float, Int
from schemas.numbers import significant
from schemas.quantities import QUANTITIES

SURE, LIKELY, UNSURE = "sure", "likely", "a guess"
_POINTS = 200_000
"""Samples that are looked at: the first ones of a longer trace."""
_LEVEL_BINS = 50
_HELD = 0.55
"""Share of a trace at a few levels from which it is one of steps: a sinusoid has 18 % of its samples in any two bins."""
_OUTER = 0.25
"""Share at the lowest or highest level that a trace of steps has at least: a sweep rests in its middle."""
_HYSTERESIS = 0.1
_FEWEST_CROSSINGS = 8
_SETTLES, _GOES_ON = 0.02, 0.002
"""Share of a hold at both its ends that is left out, and share of its range by which a displacement goes on in creep."""
_ALIKE = 0.12
"""Spread of the periods of a sinusoid that a sampling of ten points a period leaves."""

_STRAIGHT, _SPEEDS = 0.85, 10
"""Median speed over a fast one, of ten to each half period: 0.72 in a sinusoid, above 0.95 in triangles with rounded turning points."""
_STAIR_PARTS, _LOWEST_STAIR, _FEWEST_STAIRS = 200, 0.05, 4
"""Parts of a record that are looked at, the lowest step of a staircase as a share of its range, and its fewest levels, rest included."""
_SLOW_S = 5.0
"""Shortest cycle of a voltage in which a film follows at rest: relaxation that is faster than a second is over on its flanks."""
_MOST_TRIANGLES = 50
"""More triangles than these are a cyclic test: a fit of the large cycle looks at a thousand samples, twenty to each."""


@dataclass(frozen=True)
class Trace:
    """One channel: `time_s` (n,) from its start, `values` (n,) in its canonical unit."""

    time_s: Float
    values: Float


@dataclass(frozen=True)
class Shape:
    """What a recording shows: protocol and loading, how sure that is, what was seen, and constants measured from it."""

    protocol: str
    loading: str
    certainty: str
    seen: str
    constants: Mapping[str, float | str] = field(default_factory=dict)


@dataclass(frozen=True)
class _Drive:
    """A driving signal reduced to what tells tests apart; times in s, levels in the unit of the signal."""

    time_s: Float
    values: Float
    low: float
    high: float
    held: float
    """Share of the samples at the most frequent levels, which reach from nearly the lowest to nearly the highest."""
    crossings_s: Float
    """Instants of passing the middle upwards."""
    halves_s: Float
    """From each passing of the middle to the next in the other direction."""
    turns: Int
    """Samples at which the direction changes for more than a tenth of the range."""

    @property
    def range(self) -> float:
        return self.high - self.low

    @property
    def periods_s(self) -> Float:
        return np.diff(self.crossings_s)

    @property
    def duration_s(self) -> float:
        return float(self.time_s[-1] - self.time_s[0])


def find_shape(traces: Mapping[str, Trace]) -> Shape:
    """The protocol that channels show, from their names and the shape of the one that drives."""
    usable = {name: found for name, trace in traces.items() if (found := _clean(trace)) is not None}
    if {"force_1", "force_2"} <= set(usable):
        return Shape("force_map", "electrical", SURE, "two forces of a biaxial rig", _steps_of(usable.get("voltage")))
    if "voltage" in usable:
        return _electrical(usable)
    for drive, answer in (("displacement", "force"), ("stretch", "stress")):
        if drive in usable:
            shape = _mechanical(drive, answer, usable)
            if answer in usable or "stress" in usable:
                return shape
            seen = f"{shape.seen}, without the {answer} that such a test needs"
            return replace(shape, certainty=UNSURE, seen=seen)
    if "input" in usable:
        return _of_another_kind(usable)
    if "capacitance" in usable:
        return Shape("coverage", "electrical", LIKELY, "a capacitance alone")
    if "force" in usable:
        return _calibration(usable["force"])
    return Shape("cycle", "mechanical", UNSURE, "no channel that drives a test was recognised")


def _electrical(traces: Mapping[str, Trace]) -> Shape:
    drive = _reduce(traces["voltage"])
    steps = _steps_of(traces["voltage"])
    if {"force", "displacement"}.isdisjoint(traces):
        known = {"voltage_setpoint_kv": _rounded(_plateau(traces["voltage"].values))}
        return Shape("lifetime", "electrical", SURE, "a voltage without force or displacement", known)
    if "leakage_current" in traces and drive.held > _HELD and len(drive.crossings_s) <= 1:
        known = {"voltage_setpoint_kv": _rounded(_plateau(traces["voltage"].values))}
        return Shape("lifetime", "electrical", SURE, f"one voltage held for {drive.duration_s:.3g} s", known)
    if "displacement" in traces and drive.held > _HELD and _follows(traces["displacement"], traces["voltage"]):
        seen = f"levels of voltage up to {drive.high:.3g} kV while a displacement is recorded"
        if "force" not in traces or _is_constant(traces["force"]):
            return Shape(
                "isotonic", "electrical", SURE, seen, {"drive_kv": _rounded(_plateau(traces["voltage"].values))}
            )
    if drive.held > _HELD and (stairs := _count_stairs(drive)) >= _FEWEST_STAIRS:
        seen = f"a staircase of the voltage with {stairs} levels on its way up"
        return Shape("cycle", "electrical", SURE, seen)
    if drive.held > _HELD:
        times = max(1, len(drive.crossings_s))
        return Shape("step", "electrical", SURE, f"{times} steps of voltage up to {drive.high:.3g} kV", steps)
    if (slow := _find_slow_cycles(drive)) is not None:
        return slow if "force" in traces else replace(slow, protocol="isotonic")
    if len(drive.crossings_s) >= 3 and drive.periods_s.std() < _ALIKE * drive.periods_s.mean():
        return Shape("sphs", "electrical", LIKELY, "a voltage that repeats with one frequency")
    if _is_smooth(drive) and not _period(drive):
        return _sweep("electrical", drive)
    seen = f"a voltage that passes its mean {len(drive.crossings_s)} times in changing intervals"
    return Shape("sphs", "electrical", SURE if _period(drive) else LIKELY, seen)


def _count_stairs(drive: _Drive) -> int:
    """Levels that follow each other upwards without going back between; 1 for steps that go on and off."""
    parts = np.array_split(drive.values, min(_STAIR_PARTS, drive.values.size))
    levels = np.array([float(np.median(part)) for part in parts])
    still = np.array([float(np.ptp(np.quantile(part, (0.1, 0.9)))) for part in parts]) < _LOWEST_STAIR * drive.range
    held = levels[still]
    most = count = 1
    for move in np.diff(held) / drive.range:
        count = count + 1 if move > _LOWEST_STAIR else 1 if move < -_LOWEST_STAIR else count
        most = max(most, count)
    return most


def _find_slow_cycles(drive: _Drive) -> Shape | None:
    """A voltage that goes up and down so slowly that the film follows it at rest, in triangles or not; None: another test."""
    count = (drive.turns.size + 1) // 2
    if count == 0 or drive.range <= 0 or drive.duration_s < _SLOW_S * count:
        return None
    if drive.turns.size == 1:
        return Shape("cycle", "electrical", SURE, "the voltage goes up and back once, slowly")
    if not _is_even(drive):
        return None
    straight = _is_straight(drive)
    seen = f"{count} slow {'triangles' if straight else 'cycles'} of the voltage"
    return Shape("cycle", "electrical", SURE if straight else LIKELY, seen)


def _say(name: str, value: float) -> str:
    """A value of a channel with its unit."""
    return f"{value:.4g} {QUANTITIES[name].unit}" if name in QUANTITIES else f"{value:.4g}"


def _mechanical(name: str, answer: str, traces: Mapping[str, Trace]) -> Shape:
    drive = _reduce(traces[name])
    if drive.range <= 0:
        return Shape("step", "mechanical", UNSURE, f"a {name} that never changes")
    if answer in traces and (crept := _find_creep(traces[name], traces[answer])) is not None:
        return Shape("creep", "mechanical", SURE, f"{answer} is held at {_say(answer, crept)} while the {name} goes on")
    if drive.held > _HELD:
        high, t = drive.high, drive.time_s
        moved = np.abs(drive.values - drive.values[0])
        reached = int(np.argmax(moved >= 0.98 * drive.range))
        begun = int(np.flatnonzero(moved[: reached + 1] <= 0.02 * drive.range)[-1])
        seen = (
            f"{name} goes to {_say(name, high)} within {t[reached] - t[begun]:.3g} s and is held"
            f" (record of {drive.duration_s:.4g} s)"
        )
        return Shape("step", "mechanical", SURE, seen)
    crossings = len(drive.crossings_s)
    if drive.turns.size <= 1 and answer in traces and (broken := _find_break(traces[name], traces[answer])) is not None:
        return Shape("pull", "mechanical", SURE, f"{name} rises to {_say(name, broken)}, where the {answer} is lost")
    if crossings < _FEWEST_CROSSINGS and drive.turns.size <= 1:
        return _one_cycle(name, answer, drive, traces)
    if drive.turns.size >= 3 and _is_even(drive) and _is_straight(drive):
        return Shape(
            "cycle",
            "mechanical",
            SURE,
            f"{(drive.turns.size + 1) // 2} triangles of {name} up to {_say(name, drive.high)}",
        )
    if drive.turns.size >= 3 and _is_even(drive):
        frequency = 0.5 / float(np.mean(drive.halves_s))
        known: dict[str, float | str] = {"frequency_hz": float(f"{frequency:.5g}")}
        return Shape("cyclic", "mechanical", SURE, f"a sinusoid of {frequency:.4g} Hz", known)
    if crossings >= _FEWEST_CROSSINGS and _is_smooth(drive):
        return _sweep("mechanical", drive)
    if crossings >= _FEWEST_CROSSINGS:
        return Shape("noise", "mechanical", LIKELY, "a broad band of frequencies that is no sweep")
    return Shape("cycle", "mechanical", LIKELY, f"{drive.turns.size} turning points")


def _is_constant(load: Trace) -> bool:
    """Whether a load is one that a weight or a controller keeps."""
    return float(np.ptp(np.quantile(load.values, (0.02, 0.98)))) < 0.1 * abs(float(np.median(load.values)))


def _follows(moved: Trace, voltage: Trace) -> bool:
    """Whether a displacement is another one while the voltage is on, beyond its noise."""
    level = np.interp(moved.time_s, voltage.time_s, np.abs(voltage.values))
    on = level > 0.5 * float(np.max(level))
    if on.all() or not on.any():
        return False
    noise = float(np.median(np.abs(np.diff(moved.values, 2))))
    return abs(float(np.median(moved.values[on]) - np.median(moved.values[~on]))) > 5 * noise


def _find_creep(drive: Trace, answer: Trace) -> float | None:
    """The level of a force that is put on and held while the displacement goes on; None: not.

    In a relaxation it is the displacement that stands still, and the force goes on.
    """
    load = _reduce(answer)
    if load.range <= 0 or load.held <= _HELD:
        return None
    level = load.low if abs(load.low) > abs(load.high) else load.high
    loaded = np.flatnonzero(np.abs(answer.values - level) < 0.5 * load.range)
    begin, end = answer.time_s[loaded[0]], answer.time_s[loaded[-1]]
    span = end - begin
    spreads = []
    for trace in (answer, drive):
        inside = (trace.time_s > begin + _SETTLES * span) & (trace.time_s < end - _SETTLES * span)
        reach = float(np.ptp(np.quantile(trace.values, (0.01, 0.99))))
        if inside.sum() < 2 * _FEWEST_CROSSINGS or reach <= 0:
            return None
        values = trace.values[inside]
        third = max(1, values.size // 3)
        noise = float(np.std(np.diff(values, 2))) / np.sqrt(6 * third)
        spreads.append((abs(float(np.median(values[-third:]) - np.median(values[:third]))) / reach, noise / reach))
    (stands, _), (goes_on, noise) = spreads
    return level if goes_on > max(_GOES_ON, 3 * stands, 4 * noise) else None


def _find_break(drive: Trace, answer: Trace) -> float | None:
    """Where a film breaks that is pulled: the answer falls below half of its largest while the drive goes on; None: not."""
    top = int(np.argmax(answer.values))
    fallen = np.flatnonzero(answer.values[top:] < 0.5 * answer.values[top])
    if not fallen.size or answer.values[top] <= 0:
        return None
    then, there = (float(np.interp(answer.time_s[i], drive.time_s, drive.values)) for i in (top, top + int(fallen[0])))
    return then if there >= then and then - drive.values[0] > 0.5 * np.ptp(drive.values) else None


def _one_cycle(name: str, answer: str, drive: _Drive, traces: Mapping[str, Trace]) -> Shape:
    certainty = SURE if drive.turns.size == 1 else LIKELY
    seen = f"{name} goes once up to {_say(name, drive.high)}" + (" and back" if drive.turns.size == 1 else "")
    return Shape("cycle", "mechanical", certainty, seen)


def _of_another_kind(traces: Mapping[str, Trace]) -> Shape:
    drive = _reduce(traces["input"])
    if drive.held > _HELD:
        return Shape("step", "other", SURE, f"an input that steps to {drive.high:.3g}")
    if _is_smooth(drive) and not _period(drive):
        return _sweep("other", drive)
    return Shape("sphs", "other", LIKELY, "an input with many frequencies that repeats")


def _calibration(force: Trace) -> Shape:
    drive = _reduce(force)
    if drive.held > _HELD or len(drive.crossings_s) < _FEWEST_CROSSINGS:
        return Shape("weight", "calibration", LIKELY, "a force alone, at a few levels")
    return Shape("tap", "calibration", LIKELY, f"a force alone that rings {len(drive.crossings_s)} times")


def _sweep(loading: str, drive: _Drive) -> Shape:
    periods = drive.periods_s
    first, last = (float(np.median(periods[part])) for part in (slice(0, 2), slice(-5, None)))
    low, high = sorted((1 / first, 1 / last))
    seen = f"a sweep, from about {significant(low, 2)} to {significant(high, 2)} Hz as its periods show; what was commanded is better"
    return Shape("chirp", loading, SURE, seen)


def _clean(trace: Trace) -> Trace | None:
    """The finite samples in the order of time; None where fewer than four are left."""
    finite = np.isfinite(trace.time_s) & np.isfinite(trace.values)
    time_s, values = trace.time_s[finite][:_POINTS], trace.values[finite][:_POINTS]
    order = np.argsort(time_s, kind="stable")
    return Trace(time_s[order], values[order]) if time_s.size >= 4 else None


def _reduce(trace: Trace) -> _Drive:
    time_s, values = trace.time_s, trace.values
    spare = min(values.size // 10, max(2, values.size // 5000))
    ordered = np.partition(values, (spare, values.size - 1 - spare))
    low, high = float(ordered[spare]), float(ordered[-1 - spare])
    span = high - low
    if span <= 0:
        return _Drive(time_s, values, low, high, 1.0, np.empty(0), np.empty(0), np.empty(0, np.int64))
    step_s = np.median(np.diff(time_s)) if time_s.size > 1 else 0.0
    weights = np.clip(np.gradient(time_s), step_s * 1e-3, None) if time_s.size > 1 else np.ones(1)
    counts, edges = np.histogram(np.clip(values, low, high), bins=_LEVEL_BINS, weights=weights)
    if not counts.sum() > 0:
        weights = np.ones_like(weights)
        counts, edges = np.histogram(np.clip(values, low, high), bins=_LEVEL_BINS)
    counts = counts / counts.sum()
    pairs = counts[:-1] + counts[1:]
    levels: list[int] = []
    for place in np.argsort(pairs)[::-1]:
        if pairs[place] < 0.05 or len(levels) == 4:
            break
        if all(abs(place - other) > 2 for other in levels):
            levels.append(int(place))
    outer = max((pairs[p] for p in levels if p <= 1 or p >= _LEVEL_BINS - 3), default=0.0)
    held = float(sum(pairs[p] for p in levels)) if outer > _OUTER else 0.0
    middle = 0.5 * (edges[0] + edges[-1])
    up, every = _crossings(time_s, values, middle, span)
    return _Drive(time_s, values, low, high, held, up, np.diff(every), _turns(values, span))


def _crossings(time_s: Float, values: Float, middle: float, span: float) -> tuple[Float, Float]:
    """Instants of passing the middle upwards, and in either direction; noise is less than a tenth of the range."""
    state = np.zeros(values.size, dtype=np.int8)
    state[values > middle + _HYSTERESIS * span] = 1
    state[values < middle - _HYSTERESIS * span] = -1
    told = np.flatnonzero(state)
    up = told[1:][(state[told[1:]] == 1) & (state[told[:-1]] == -1)]
    every = told[1:][state[told[1:]] != state[told[:-1]]]
    return np.asarray(time_s[up]), np.asarray(time_s[every])


def _turns(values: Float, span: float) -> Int:
    """Samples of the turning points that lie more than a tenth of the range apart, ends left out."""
    step = max(1, values.size // 4000)
    coarse = values[::step]
    turns: list[int] = []
    top = bottom = 0
    direction = 0
    for i, value in enumerate(coarse):
        top = i if value > coarse[top] else top
        bottom = i if value < coarse[bottom] else bottom
        if direction >= 0 and coarse[top] - value > _HYSTERESIS * span:
            if direction > 0:
                turns.append(top * step)
            direction, bottom = -1, i
        elif direction <= 0 and value - coarse[bottom] > _HYSTERESIS * span:
            if direction < 0:
                turns.append(bottom * step)
            direction, top = 1, i
    return np.array(turns, dtype=np.int64)


def _is_even(drive: _Drive) -> bool:
    if drive.periods_s.size >= 2:
        return float(np.std(drive.periods_s)) < _ALIKE * float(np.mean(drive.periods_s))
    halves = drive.halves_s
    return halves.size >= 2 and float(np.std(halves)) < 2 * _ALIKE * float(np.mean(halves))


def _is_straight(drive: _Drive) -> bool:
    """Whether a trace that repeats itself goes up and down at one speed: triangles, few enough to be looked at one by one.

    Speeds are those over a twentieth of a period, so that noise and the rounding of turning points do not count.
    """
    halves = drive.turns.size
    if halves > 2 * _MOST_TRIANGLES:
        return False
    inside = slice(int(drive.turns[0]), int(drive.turns[-1]) + 1)
    time_s, values = drive.time_s[inside], drive.values[inside]
    count = _SPEEDS * (halves - 1)
    speeds = np.abs(np.diff(np.interp(np.linspace(time_s[0], time_s[-1], count + 1), time_s, values)))
    fast = float(np.quantile(speeds, 0.9))
    return fast > 0 and float(np.median(speeds)) > _STRAIGHT * fast


def _is_smooth(drive: _Drive) -> bool:
    """Whether the periods change little from one to the next, over all by much: a sweep, once or several times."""
    periods = drive.periods_s
    if periods.size < _FEWEST_CROSSINGS - 1:
        return False
    step_s = float(np.median(np.diff(drive.time_s)))
    change = np.abs(np.diff(periods)) / np.minimum(periods[1:], periods[:-1])
    allowed = 0.25 + 2 * step_s / np.minimum(periods[1:], periods[:-1])
    return float(np.mean(change < allowed)) > 0.8


def _period(drive: _Drive) -> bool:
    """Whether a trace repeats itself, by its autocorrelation at an interval of at most half its length."""
    count = min(4096, drive.values.size)
    even = np.interp(np.linspace(drive.time_s[0], drive.time_s[-1], count), drive.time_s, drive.values)
    even = even - even.mean()
    spectrum = np.abs(np.fft.rfft(even, 2 * count)) ** 2
    correlation = np.fft.irfft(spectrum)[:count]
    norm = correlation[0] * (1 - np.arange(count) / count)
    share = correlation[count // 20 : count // 2 + 1] / norm[count // 20 : count // 2 + 1]
    return bool(share.max() > 0.9)


def _plateau(values: Float) -> float:
    """The level held: the median of the samples above half of the largest."""
    high = float(np.percentile(values, 99.5))
    return float(np.median(values[values > 0.5 * high])) if high > 0 else high


def _steps_of(voltage: Trace | None) -> dict[str, float | str]:
    """Peak voltage and the times on and off of a sequence of steps, where it is one."""
    if voltage is None:
        return {}
    drive = _reduce(voltage)
    if drive.held <= _HELD or drive.range <= 0:
        return {}
    known: dict[str, float | str] = {"drive_kv": _rounded(_plateau(voltage.values))}
    on = np.asarray(voltage.values > 0.5 * (drive.low + drive.high))
    edges = np.flatnonzero(np.diff(on.astype(np.int8)))
    inner = np.diff(voltage.time_s[edges])
    if inner.size >= 2:
        first_is_on = bool(on[edges[0] + 1])
        on_s, off_s = inner[0 if first_is_on else 1 :: 2], inner[1 if first_is_on else 0 :: 2]
        known |= {"on_s": _rounded(float(np.median(on_s))), "off_s": _rounded(float(np.median(off_s)))}
    return known


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")
