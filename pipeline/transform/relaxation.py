"""A step of displacement and the force while it is held: stress relaxation in log time.

The ramp is a ramp: its start, end and height are part of the result, so that a fit can use the exact response to it (a
pure dashpot has no response to a jump). Of several steps, up and down, all are taken: what the earlier ones left goes on under
the later ones. Steps of voltage belong to another module.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, final

import numpy as np

from pipeline.transform.channels import drive
from pipeline.transform.holds import Hold
from pipeline.transform.noise import mean_variances
from pipeline.transform.sampling import seconds
from pipeline.transform.staircase import LaterRamp, find_later_ramps, find_levels
from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.numbers import digits
from schemas.recording import Recording

_PER_DECADE = 12
_FEWEST_WINDOWS = 8
_FEWEST_REST = 8
_NORMAL_MEDIAN = 0.6745
"""Median of the size of a standard normal number."""
_CLEARLY, _MOVED = 6.0, 0.02
"""Standard deviations of its noise, and share of its whole travel, from which an input has clearly moved."""
_STILL, _HELD_WITHIN, _LOOKED_AT = 0.02, 0.2, 1000
"""Share of the whole travel within which an input stands still, share of a rise for which it does so where that holds a step of
its own, and samples of the rise that are looked at."""
_OF_A_RAMP = 0.05
"""Share of the whole travel from which a change of speed between two samples is a ramp, and no step of a converter."""
_AT_REST = 2.0
"""Standard deviation over its noise beyond which a beginning is a slow movement and no rest."""
_BEGINNING = 0.2
"""Part of a ramp from which the force at its beginning is read where there is no rest."""
_SPREAD = 2.0
"""Standard deviations of its own spread by which what is left of a parabola may exceed the noise."""
_RINGING = 3.0
"""A window whose samples scatter so many times more than the noise still holds the ringing of the clamp."""
_UNDERSHOOT = 0.5
"""Least part of what a held film has relaxed by which its force falls below that of its rest when it is brought back: a linear film does
so by all of it. Half of that tells film from slack whatever the noise and the drift of a load cell."""
SETTLED = 0.25
"""Windows closer to the end of a ramp than this share of its duration are not used: a ramp is a straight line by and large only."""


@final
@dataclass(frozen=True)
class RelaxationCurve:
    """Force over step height while the step is held, as means over windows equally wide in log time.

    Of a staircase all levels are there, each with windows of its own, as changes since before the first step over the height of
    the first step: what a linear film adds for each ramp is the response to the first, as much higher as that ramp is.

    Parameters
    ----------
    time_s : (n,) s since the start of the ramp, mean of the samples' times in the window
    window_s : (n, 2) s since the start of the ramp, first and last sample of the window: the value is the mean over it
    stiffness : (n,) N/mm, change of force over `step`; compliance of the load cell included
    variance : (n,) of `stiffness`: noise of the window and, where the ramp is faster than the clock, what the
        uncertain instant of the ramp does to it
    usable : (n,)
    ramp_s : duration of the ramp, which starts at 0 and is a straight line
    step : height of the ramp, mm
    rest_variance : variance of the rest level before the ramp over `step`²: the same error in every window
    step_sd : standard deviation of `step`, mm
    unusable_because : (n,) reason, "" where usable
    recording_id, specimen_id : what it belongs to
    quantity : `stiffness_n_per_mm`, or `output_per_input` for a system of another kind
    details : rest force, step strain, held time and the like; plain values only
    later : the ramps of a staircase after the first one
    """

    time_s: Float
    window_s: Float
    stiffness: Float
    variance: Float
    usable: Bool
    ramp_s: float
    step: float
    rest_variance: float
    step_sd: float
    unusable_because: tuple[str, ...]
    quantity: str
    recording_id: str | None = None
    specimen_id: str | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    later: tuple[LaterRamp, ...] = ()

    @property
    def step_number(self) -> Int:
        """(n,) from 1: the last ramp that is over when the window begins."""
        ends = np.array([ramp.end_s for ramp in self.later])
        return 1 + np.asarray((self.window_s[:, :1] >= ends).sum(axis=1), dtype=np.int64)

    def first_step(self) -> RelaxationCurve:
        """The curve of the first step alone."""
        if not self.later:
            return self
        kept = self.step_number == 1
        return replace(
            self,
            time_s=self.time_s[kept],
            window_s=self.window_s[kept],
            stiffness=self.stiffness[kept],
            variance=self.variance[kept],
            usable=self.usable[kept],
            unusable_because=tuple(why for why, k in zip(self.unusable_because, kept, strict=True) if k),
            later=(),
        )


@dataclass(frozen=True)
class _Step:
    """A ramp from `before` to `after` between `start_s` and `end_s`, held until `until_s`; `noise` of one sample of the input.

    `later` : the ramps that follow, the last of which leads to a level that is held until `ends_s`.
    """

    start_s: float
    end_s: float
    until_s: float
    before: float
    after: float
    noise: float
    later: tuple[LaterRamp, ...]
    ends_s: float

    @property
    def holds(self) -> tuple[tuple[float, float, float], ...]:
        """Start and end of each ramp, and the end of the hold after it, s of the record."""
        ramps = [(self.start_s, self.end_s)]
        ramps += [(self.start_s + ramp.start_s, self.start_s + ramp.end_s) for ramp in self.later]
        ends = [start for start, _ in ramps[1:]] + [self.ends_s]
        return tuple((start, end, until) for (start, end), until in zip(ramps, ends, strict=True))


@dataclass(frozen=True)
class _Level:
    """Force from which the film relaxes, its variance, and how many samples of rest it is the mean of (0: there is no rest)."""

    value: float
    variance: float
    samples: int


def relaxation_curve(recording: Recording) -> tuple[RelaxationCurve, tuple[str, ...]]:
    """Relaxation curve of a mechanical `step` (or one of loading `other`), and warnings.

    From the first ramp to the end of the last hold. A testing machine begins to record when it begins to move: where
    there is no rest, the force at the beginning of the ramp is the level from which it relaxes, and a warning says so.

    Raises `NotIdentifiableError` without a step or with a hold that is too short.
    """
    source, origin = drive(recording), recording.start_ns
    where = recording.metadata.recording_id
    t_x, x = seconds(source.input, origin)
    t_f, force = seconds(source.output, origin)
    step = _find_step(t_x, x, where)
    whole = step
    step = _end_before_slack(step, t_f, force)
    slack = step is not whole
    height = step.after - step.before
    rest = force[t_f < step.start_s]
    again = step.ends_s < t_f[-1]
    windows = _windows(t_f, step)
    if windows.shape[0] < _FEWEST_WINDOWS:
        raise _too_few(step, windows.shape[0], again, where)
    begin, end = windows[:, 0], windows[:, 1]
    time = t_f - step.start_s
    sums, clocks = (np.concatenate([[0.0], np.cumsum(v - v[0])]) for v in (force, time))
    counts = end - begin
    means = (sums[end] - sums[begin]) / counts + force[0]
    times = (clocks[end] - clocks[begin]) / counts + time[0]
    window = np.column_stack([time[begin], time[end - 1]])
    quiet, ramp_noise = _noise(rest, force[(t_f > step.end_s) & (t_f <= step.until_s)])
    variance = mean_variances(quiet, np.append(counts, max(rest.size, 1)))
    level = _rest_level(rest, float(variance[-1]), t_f, force, step, ramp_noise)
    coarse = _rounding_variance(source.output.resolution, ramp_noise)
    variance = np.maximum(variance, coarse)
    for start, stop, until in step.holds:
        interval = _interval_at(t_x, start, stop)
        rows = (window[:, 0] + step.start_s > stop) & (window[:, 0] + step.start_s <= until)
        if stop - start < 3 * interval and int(rows.sum()) > 1:
            variance[:-1][rows] += (np.gradient(means[rows], times[rows]) * interval) ** 2 / 12
    scatter = _scatter(time, force, begin, counts)
    ringing = scatter > _RINGING * max(ramp_noise, np.sqrt(coarse))
    x_before = x[t_x < step.start_s]
    x_after = x[(t_x > step.end_s) & (t_x <= step.until_s)]
    begins = x_before.var() / x_before.size if level.samples else step.noise**2
    step_sd = float(np.sqrt(begins + x_after.var() / x_after.size))
    curve = RelaxationCurve(
        time_s=times,
        window_s=window,
        stiffness=(means - level.value) / height,
        variance=variance[:-1] / height**2,
        usable=~ringing,
        ramp_s=step.end_s - step.start_s,
        step=height,
        rest_variance=max(level.variance, coarse) / height**2,
        step_sd=step_sd,
        unusable_because=tuple("ringing of the clamp" if r else "" for r in ringing),
        quantity=source.quantity,
        recording_id=where,
        specimen_id=recording.metadata.specimen_id,
        details={
            "rest_level": level.value,
            "rest_samples": level.samples,
            "ramp_start_s": step.start_s,
            "held_s": step.until_s - step.end_s,
            "samples": counts.tolist(),
            "input_unit": source.input_unit,
            "output_unit": source.output_unit,
        },
        later=step.later,
    )
    warnings = []
    if not level.samples:
        warnings.append(
            "the step begins with the record: the force at the beginning of its ramp is taken for the level from which it relaxes"
        )
    if slack:
        warnings.append(
            f"the film goes slack when it is brought back {step.ends_s - step.start_s:.3g} s after the step: its force is that of its rest, where "
            "a film under tension would fall below it by what it has relaxed; what comes then is not used: cut the recording into one for each step"
        )
    elif again:
        warnings.append(
            f"the film is moved again {step.ends_s - step.start_s:.3g} s after the step: what comes then is not used; a recording of its own "
            "would be"
        )
    if ringing.any():
        until = float(window[np.flatnonzero(ringing)[-1], 1])
        number = int(ringing.sum())
        verbs = "rings and is" if number == 1 else "ring and are"
        warnings.append(f"{digits(number, 'window')} up to {until:.3g} s after the step {verbs} not usable")
    if int(curve.usable.sum()) < _FEWEST_WINDOWS:
        raise NotIdentifiableError(
            f"only {int(curve.usable.sum())} of {digits(curve.usable.size, 'window')} of the hold can be used, the others ring with the clamp",
            where=where,
            expected=f"at least {_FEWEST_WINDOWS}",
        )
    return curve, tuple(warnings)


def _too_few(step: _Step, count: int, again: bool, where: str) -> NotIdentifiableError:
    steps = f"each of {len(step.holds)} steps" if step.later else "the step"
    longest = max(until - end for _, end, until in step.holds)
    return NotIdentifiableError(
        f"{steps} is held for {longest:.3g} s after a ramp of {step.end_s - step.start_s:.3g} s: "
        f"{digits(count, 'window')} in log time" + (", then the film is moved again" if again else ""),
        where=where,
        expected=f"at least {_FEWEST_WINDOWS} windows ({_PER_DECADE} per decade, from the end of the ramp on)",
        remedy="Cut the recording into one for each step" if again else "",
    )


def _windows(time: Float, step: _Step) -> Int:
    """First sample of each window and the one after its last (n, 2), hold by hold.

    They are equally wide in log time: since the start of the ramp where there is one, since the end of its own in a staircase,
    whose ramps are often as long as its holds.
    """
    found = []
    for start, end, until in step.holds:
        held = np.flatnonzero((time > end) & (time <= until))
        if not held.size:
            continue
        zero, first = (end, SETTLED * (end - start)) if step.later else (start, end - start)
        since = time[held] - zero
        begin = held[_window_starts(since, first)]
        found.append(np.column_stack([begin, np.append(begin[1:], held[-1] + 1)]))
    return np.concatenate(found) if found else np.zeros((0, 2), dtype=np.int64)


def _interval_at(time: Float, start_s: float, end_s: float) -> float:
    """Mean interval of the samples from before a ramp to after it: many machines take fewer while they hold."""
    first = max(int(np.searchsorted(time, start_s)) - 1, 0)
    near = time[first : int(np.searchsorted(time, end_s)) + 2]
    return float((near[-1] - near[0]) / (near.size - 1))


def _rest_level(rest: Float, variance: float, time: Float, force: Float, step: _Step, noise: float) -> _Level:
    """Mean of the rest, with the variance that it has; without rest the force at the beginning of the ramp.

    That is where a parabola begins that follows the first part of the ramp, as far as it does so within the noise.
    """
    if rest.size >= _FEWEST_REST:
        return _Level(float(rest.mean()), variance, rest.size)
    along = np.flatnonzero((time >= step.start_s) & (time <= step.start_s + _BEGINNING * (step.end_s - step.start_s)))
    found = _Level(float(force[0]), noise**2, 0)
    count = _FEWEST_REST
    while count <= along.size:
        part = along[:count]
        design = np.vander((time[part] - step.start_s) / (time[part[-1]] - step.start_s), 3, increasing=True)
        solution = np.linalg.lstsq(design, force[part], rcond=None)[0]
        left = float(np.sum((force[part] - design @ solution) ** 2)) / (count - 3)
        if left > (1 + _SPREAD * np.sqrt(2 / (count - 3))) * noise**2:
            break
        found = _Level(float(solution[0]), noise**2 * float(np.linalg.inv(design.T @ design)[0, 0]), 0)
        count *= 2
    return found


def _find_step(time: Float, x: Float, where: str) -> _Step:
    """First ramp and hold in the input: a line through its 10 and 90 % crossings, held until it leaves the level."""
    edge, noise = _begin(x)
    before = float(np.median(x[:edge]))
    away = np.abs(x - before)
    reach = float(away.max(initial=0.0))
    if x.size < 4 * _FEWEST_REST or reach <= _CLEARLY * noise:
        raise NotIdentifiableError(
            "the input holds no step above its noise", where=where, expected="a step and its hold"
        )
    after = _median_over_time(time, x, away > reach / 2)
    progress = (x - before) / (after - before)
    t10, t90 = _crossing(time, progress, 0.1), _crossing(time, progress, 0.9)
    levels = find_levels(time, x)
    first = _find_first_level(levels, before, t90, max(_CLEARLY * noise, _STILL * reach))
    if first is None:
        first = _find_hold_within(time, x, t10, t90, max(_CLEARLY * noise, _STILL * reach))
    if first is not None:
        after = first
        progress = (x - before) / (after - before)
        t10, t90 = _crossing(time, progress, 0.1), _crossing(time, progress, 0.9)
    duration = (t90 - t10) / 0.8
    start = max(t10 - 0.1 * duration, float(time[0]))
    end = t10 + 0.9 * duration
    tolerance = max(0.02, _CLEARLY * noise / abs(after - before))
    until = _leaves(time, (time > end + duration) & (np.abs(progress - 1) > tolerance))
    rest = x[time < start]
    held = x[(time > end) & (time <= until)]
    if held.size < _FEWEST_WINDOWS:
        raise NotIdentifiableError(
            f"{held.size} samples while the step is held", where=where, expected=f"at least {_FEWEST_WINDOWS}"
        )
    begin = float(rest.mean()) if rest.size >= _FEWEST_REST else before
    level = float(held.mean())
    later = find_later_ramps(time, x, levels, (start, end, level), noise)
    if not later:
        return _Step(start, end, until, begin, level, noise, (), until)
    last = level + sum(ramp.step for ramp in later)
    tolerance = max(tolerance * abs(after - before), _CLEARLY * noise)
    ends = _leaves(time, (time > start + later[-1].end_s + later[-1].ramp_s) & (np.abs(x - last) > tolerance))
    return _Step(start, end, start + later[0].start_s, begin, level, noise, later, ends)


def _end_before_slack(step: _Step, time: Float, force: Float) -> _Step:
    """The step without what comes after the film is brought back to where it began and goes slack: it cannot push.

    Slack is a force that is that of the rest where what the hold has relaxed should be missing from it. What was before is forgotten then,
    and the responses to the ramps no longer add up.
    """
    rest = force[time < step.start_s]
    at_rest = float(rest.mean() if rest.size >= _FEWEST_REST else force[0])
    reach, level = abs(step.after - step.before), step.after
    pairs = zip(step.later, pairwise(step.holds), strict=True)
    for number, (ramp, ((_, ended, left), (_, end, until))) in enumerate(pairs):
        level += ramp.step
        if abs(level - step.before) > _STILL * reach:
            continue
        held, back = force[(time > ended) & (time <= left)], force[(time > end) & (time <= until)]
        few = max(1, min(held.size, back.size) // _PER_DECADE)
        relaxed = abs(float(np.median(held[:few]) - np.median(held[-few:])))
        scatter = float(np.std(np.diff(held))) / np.sqrt(2)
        missing = abs(float(np.median(back[:few])) - at_rest)
        if relaxed > _CLEARLY * scatter and missing < _UNDERSHOOT * relaxed:
            return replace(step, later=step.later[:number], ends_s=left)
    return step


def _leaves(time: Float, left: Bool) -> float:
    """Last time before a level is left for good; one sample may be a spike: three in a row have left it."""
    run = left[:-2] & left[1:-1] & left[2:]
    return float(time[max(int(run.argmax()) - 1, 0)]) if run.any() else float(time[-1]) + 1e-9


def _find_first_level(levels: Sequence[Hold], before: float, last_s: float, tolerance: float) -> float | None:
    """The first level of a staircase that is held before its largest one is reached; None where there is none."""
    for hold in levels:
        if abs(hold.level - before) > tolerance and hold.end_s < last_s:
            return hold.level
    return None


def _median_over_time(time: Float, x: Float, chosen: Bool) -> float:
    """Level that the input has for half of the time: samples of a ramp may outnumber those of a hold that thins out."""
    values, lasting = x[chosen], np.gradient(time)[chosen]
    order = np.argsort(values)
    reached = np.cumsum(lasting[order])
    return float(values[order][np.searchsorted(reached, reached[-1] / 2)])


def _find_hold_within(time: Float, x: Float, first_s: float, last_s: float, tolerance: float) -> float | None:
    """Level at which the input stands still between two times, for the first time; None where it goes on all the way.

    What is held before the largest level is reached is the end of a first step, and not a part of its ramp.
    """
    inside = np.flatnonzero((time > first_s) & (time < last_s))
    if inside.size < _FEWEST_WINDOWS / _HELD_WITHIN:
        return None
    some = inside[:: max(1, inside.size // _LOOKED_AT)]
    length = int(np.ceil(_HELD_WITHIN * some.size))
    windows = np.lib.stride_tricks.sliding_window_view(x[some], length)
    still = np.flatnonzero(np.ptp(windows, axis=1) < tolerance)
    return float(np.median(windows[still[0]])) if still.size else None


def _begin(x: Float) -> tuple[int, float]:
    """Samples at the beginning that are rest beyond doubt, and the noise of one sample.

    The noise is that of second differences, in which neither rest nor ramp nor hold shows; of a rest long enough its own.
    """
    longest = int(np.clip(x.size // 200, _FEWEST_REST, 256))
    differences = np.abs(np.diff(x, 2))
    noise = float(np.median(differences)) / (np.sqrt(6) * _NORMAL_MEDIAN) if differences.size else 0.0
    if noise == 0 and differences.any():
        # A converter coarser than its noise: most neighbours are equal. Larger changes are the ramps of an input without noise.
        flickers = differences[(differences > 0) & (differences < _OF_A_RAMP * np.ptp(x))]
        noise = float(flickers.min()) / np.sqrt(12) if flickers.size else 0.0
    gone = np.abs(x[:longest] - np.median(x[:3])) > max(_CLEARLY * noise, _MOVED * float(np.ptp(x)))
    rest = int(gone.argmax()) if gone.any() else min(longest, x.size)
    if rest < _FEWEST_REST or (gone.any() and x[:rest].std() > _AT_REST * noise):
        return 1, noise
    return rest, float(x[:rest].std())


def _crossing(time: Float, progress: Float, level: float) -> float:
    """First time at which `progress` reaches the level, between samples."""
    i = int((progress >= level).argmax())
    if i == 0:
        return float(time[0])
    low, high = progress[i - 1], progress[i]
    return float(time[i - 1] + (level - low) / (high - low) * (time[i] - time[i - 1]))


def _window_starts(time: Float, ramp_s: float) -> Int:
    """First sample of each window; windows are equally wide in log time and hold at least one sample."""
    first = max(float(time[0]), ramp_s, np.finfo(float).tiny) if time.size else 1.0
    if time.size < 2 or time[-1] <= first:
        return np.zeros(min(time.size, 1), dtype=np.int64)
    decades = np.log10(time[-1] / first)
    edges = first * 10 ** np.linspace(0, decades, max(2, int(np.ceil(decades * _PER_DECADE)) + 1))
    starts = np.searchsorted(time, edges[:-1] * (1 - 1e-12))
    return np.unique(starts[starts < time.size])


def _noise(rest: Float, held: Float) -> tuple[Float, float]:
    """A stretch of noise alone and its standard deviation: the rest, or the end of the hold without its trend."""
    quiet = rest if rest.size >= 64 else held[held.size // 2 :]
    index = np.linspace(-1, 1, quiet.size)
    degree = 1 if rest.size >= 64 else 3
    quiet = quiet - np.polyval(np.polyfit(index, quiet, min(degree, quiet.size - 1)), index)
    return quiet, float(quiet.std())


def _rounding_variance(resolution: float | None, noise: float) -> float:
    """Rounding of the converter does not average out where the noise is below a third of its step."""
    return resolution**2 / 12 if resolution is not None and noise < 0.3 * resolution else 0.0


def _scatter(time: Float, values: Float, starts: Int, counts: Int) -> Float:
    """Standard deviation within each window about a parabola; 0 where there are too few samples to tell."""
    result = np.zeros(starts.size)
    for i, (first, count) in enumerate(zip(starts, counts, strict=True)):
        if count < 8:
            continue
        t, v = time[first : first + count], values[first : first + count]
        s = (t - t.mean()) / (np.ptp(t) or 1.0)
        residual = v - np.polyval(np.polyfit(s, v, 2), s)
        result[i] = np.sqrt((residual**2).sum() / (count - 3))
    return result
