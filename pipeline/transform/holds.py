"""A drive that is held at levels, and the displacement that goes on meanwhile, as means over windows in log time.

The drive is a load (creep and its recovery) or a voltage (a film that lifts a constant load). Samples may be as uneven as a
machine likes: a window is a mean over its samples, and what is fitted to it is a mean over the same instants. Does not belong
here: models of the displacement (`pipeline.fit.retardation`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_matrix

from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError

PER_DECADE, _FEWEST_PER_DECADE, _HOLDS = 16, 5, 3
"""Windows to a decade of time; fewer where there are more holds than a rest, a load and a recovery."""
FEWEST_WINDOWS = 8
_REST_WINDOWS = 6
_PER_WINDOW = 24
"""Instants of a window at which what is fitted to it is computed."""
_PER_RAMP = 200
_LOOKED_AT = 20_000
"""Samples of the drive that are looked at for levels."""
_LEVEL, _CLEARLY = 0.02, 6.0
"""Share of the largest change, and standard deviations of its noise, within which a drive is held."""
_FEWEST_HELD, _GAP = 6, 3
"""Samples that a level has at least, and samples off it that do not end it."""
_MIDDLE = 0.1
"""Share of a ramp at each end that is not taken for its straight part."""
_MOSTLY = 0.5
"""Share of a record over which the drive is held: a sinusoid stays near its turning points for a fifth of its time."""
_NEAR = 0.65
"""Share of the samples of a level within the inner half of its width: along a ramp it is a half."""
_WANDERS = 4.0
"""Standard deviations of its χ² from which a held drive is followed from window to window instead of taken for constant."""
_NORMAL_MEDIAN = 0.6745
_RINGING = 3.0
"""A window whose samples scatter so many times more than is usual still rings."""


@dataclass(frozen=True)
class Hold:
    """A level of the drive between two instants; the ramp to it began at `begins_s`."""

    begins_s: float
    start_s: float
    end_s: float
    level: float


@dataclass(frozen=True)
class HeldRecord:
    """Windows of the displacement, and the course of the drive that led to it.

    Parameters
    ----------
    time_s : (n,) mean of the samples' times in each window, s
    width_s : (n,) from its first sample to its last, s
    displacement : (n,) mean over the window, mm
    count : (n,) samples in it
    scatter : (n,) standard deviation of one sample within it, 0 where there are too few to tell
    jump : (n,) standard deviation that comes from the unknown instant of an edge that is faster than the clock, mm
    hold : (n,) number of the hold that it belongs to
    usable : (n,)
    history_s, drive : (m,) course of the drive from rest, as change from its first level
    mean : (n, m) takes values at the instants of `history_s` to means over the windows
    holds : in order, those in which the displacement has samples
    rests : the first hold is a rest before the first load; without it the windows begin with the load on
    offset : the displacement has a zero of its own; without it it counts from before the load
    step : one step of the converter over √12, mm; 0 where unknown
    drive_error : relative standard deviation of the levels of the drive, the same for all that is found
    """

    time_s: Float
    width_s: Float
    displacement: Float
    count: Int
    scatter: Float
    jump: Float
    hold: Int
    usable: Bool
    history_s: Float
    drive: Float
    mean: csr_matrix
    holds: tuple[Hold, ...]
    rests: bool
    offset: bool
    step: float
    drive_error: float
    warnings: tuple[str, ...] = ()

    @property
    def end_s(self) -> float:
        return self.holds[-1].end_s


def find_holds(
    time_s: Float, drive: Float, *, where: str = "", name: str = "load", least_held: float = _MOSTLY
) -> tuple[Hold, ...]:
    """The levels at which a drive (m,) is held, first to last.

    A drive that never changes is one level. Raises `NotIdentifiableError` where it is held for less than the share `least_held` of
    the record.
    """
    every = max(1, time_s.size // _LOOKED_AT)
    t, u = time_s[::every], drive[::every]
    noise = _noise(drive)
    width = max(_LEVEL * float(np.max(np.abs(u - u[0]), initial=0.0)), _CLEARLY * noise, 1e-12)
    parts = [part for part in _split(u, 2 * width) if _stands(u[part[0] : part[1]], width)]
    merged: list[tuple[int, int]] = []
    for low, high in parts:
        if (
            merged
            and low - merged[-1][1] <= _GAP
            and abs(np.median(u[slice(*merged[-1])]) - np.median(u[low:high])) < width
        ):
            merged[-1] = (merged[-1][0], high)
        else:
            merged.append((low, high))
    held_s = sum(t[high - 1] - t[low] for low, high in merged)
    if held_s < least_held * (t[-1] - t[0]) or not merged:
        raise NotIdentifiableError(
            f"the {name} is held nowhere", where=where, expected=f"a {name} that steps to a level and stays there"
        )
    holds: list[Hold] = []
    for low, high in merged:
        level = float(np.median(u[low:high]))
        inside = (time_s >= t[low]) & (time_s <= t[high - 1]) & (np.abs(drive - level) <= width)
        at = np.flatnonzero(inside)
        begins = holds[-1].end_s if holds else float(time_s[at[0]])
        exact = float(drive[inside].mean())
        holds.append(Hold(begins, float(time_s[at[0]]), float(time_s[at[-1]]), exact))
    return tuple(holds)


def _split(u: Float, reach: float) -> list[tuple[int, int]]:
    """Stretches in which a drive stays within `reach`, each as long as it can be; three samples beyond it end one."""
    found, low = [], 0
    while low < u.size:
        bottom = top = float(u[low])
        last, out = low, 0
        for i in range(low + 1, u.size):
            value = float(u[i])
            if max(top, value) - min(bottom, value) > reach:
                out += 1
                if out == 3:
                    break
                continue
            bottom, top, last, out = min(bottom, value), max(top, value), i, 0
        found.append((low, last + 1))
        low = last + 1
    return found


def _stands(u: Float, width: float) -> bool:
    near = np.abs(u - np.median(u)) <= width / 2
    return u.size >= _FEWEST_HELD and float(near.mean()) >= _NEAR


def _noise(values: Float) -> float:
    differences = np.abs(np.diff(values, 2))
    return float(np.median(differences)) / (np.sqrt(6) * _NORMAL_MEDIAN) if differences.size else 0.0


def reduce_record(
    drive_s: Float,
    drive: Float,
    time_s: Float,
    displacement: Float,
    holds: tuple[Hold, ...],
    *,
    rests: bool,
    squared: bool = False,
    step: float = 0.0,
    where: str = "",
) -> HeldRecord:
    """Windows of a displacement (n,) mm at times (n,) s under a drive (m,) at times (m,) s.

    `squared`: it is the square of the drive that acts. Without a rest the drive is taken to be put on at the first sample, and the
    displacement to count from before it. Holds in which the displacement has no samples are left out, with a warning.
    Raises `NotIdentifiableError` for holds too short to tell anything.
    """
    _check_order(drive_s, time_s, where)
    zero = holds[0].level if rests else 0.0
    if max(abs(hold.level - zero) for hold in holds) <= _CLEARLY * _noise(drive):
        raise NotIdentifiableError("the drive does not change", where=where, expected="a drive that is put on and held")
    per_decade = max(_FEWEST_PER_DECADE, PER_DECADE * _HOLDS // max(len(holds), _HOLDS))
    starts: list[int] = []
    stops: list[int] = []
    numbers: list[int] = []
    inside = [np.flatnonzero((time_s >= hold.start_s) & (time_s <= hold.end_s)) for hold in holds]
    seen = tuple(hold for hold, rows in zip(holds, inside, strict=True) if rows.size)
    seen_rest = rests and inside[0].size > 0
    if rests and not seen_rest and len(seen) < 2:
        raise NotIdentifiableError(
            "the displacement is recorded at one level of the drive alone",
            where=where,
            expected="samples of it also before the drive is put on, or after it is taken off",
        )
    for number, (hold, rows) in enumerate(zip(seen, (r for r in inside if r.size), strict=True)):
        first, last = int(rows[0]), int(rows[-1]) + 1
        edges = _edges(time_s[first:last], None if seen_rest and number == 0 else hold, per_decade)
        starts += [first + int(e) for e in edges]
        stops += [first + int(e) for e in edges[1:]] + [last]
        numbers += [number] * len(edges)
    hold_of = np.array(numbers, dtype=np.int64)
    loaded = int(np.sum(hold_of > 0)) if seen_rest else len(numbers)
    if loaded < FEWEST_WINDOWS:
        raise NotIdentifiableError(
            f"{loaded} windows of the displacement while the drive is held",
            where=where,
            expected=f"at least {FEWEST_WINDOWS}, {PER_DECADE} to a decade of time",
        )
    begin, end = np.array(starts), np.array(stops)
    count = end - begin
    sums = np.concatenate([[0.0], np.cumsum(displacement - displacement[0])])
    means = (sums[end] - sums[begin]) / count + displacement[0]
    clocks = np.concatenate([[0.0], np.cumsum(time_s - time_s[0])])
    times = (clocks[end] - clocks[begin]) / count + time_s[0]
    within = [
        np.unique(np.linspace(b, e - 1, min(e - b, _PER_WINDOW)).round().astype(int))
        for b, e in zip(begin, end, strict=True)
    ]
    instants = np.concatenate([time_s[w] for w in within])
    sizes = [w.size for w in within]
    held = _smoothed(
        drive_s, drive, (time_s[begin], time_s[end - 1]), times, hold_of, instants, np.repeat(hold_of, sizes)
    )
    ramps_s, ramps = _ramps(drive_s, drive, holds)
    for hold in holds:
        if hold not in seen:
            ramps_s = np.append(ramps_s, [hold.start_s, hold.end_s])
            ramps = np.append(ramps, [hold.level, hold.level])
    if not rests:
        ramps_s, ramps = np.append(holds[0].start_s, ramps_s), np.append(0.0, ramps)
    all_s = np.concatenate([ramps_s, instants])
    order = np.argsort(all_s, kind="stable")
    course = np.concatenate([ramps, held])[order]
    course = course**2 - zero**2 if squared else course - zero
    place = np.empty(order.size, dtype=np.int64)
    place[order] = np.arange(order.size)
    rows = np.repeat(np.arange(count.size), sizes)
    mean = csr_matrix(
        (np.repeat(1 / np.array(sizes, dtype=float), sizes), (rows, place[ramps_s.size :])),
        shape=(count.size, order.size),
    )
    scatter = _scatter(time_s, displacement, begin, end)
    told = scatter[scatter > 0]
    usual = float(np.median(told)) if told.size else 0.0
    usable = scatter <= _RINGING * max(usual, step) if usual else np.ones(count.size, dtype=bool)
    return HeldRecord(
        times, time_s[end - 1] - time_s[begin], means, count, scatter, _jump(time_s, times, means, seen, hold_of), hold_of, usable,
        all_s[order], course, mean, seen, seen_rest, rests, step,
        (2 if squared else 1) * _level_error(drive_s, drive, holds, rests), _missed(len(holds), len(seen)),
    )  # fmt: skip


def _missed(held: int, seen: int) -> tuple[str, ...]:
    if held == seen:
        return ()
    return (f"the displacement has no sample in {held - seen} of the {held} levels of the drive: these are left out",)


def _check_order(drive_s: Float, time_s: Float, where: str) -> None:
    for times in (drive_s, time_s):
        if times.size < FEWEST_WINDOWS or not (np.diff(times) > 0).all():
            raise NotIdentifiableError(
                f"{times.size} samples" if times.size < FEWEST_WINDOWS else "times do not rise",
                where=where,
                expected=f"at least {FEWEST_WINDOWS} samples at ascending times",
            )


def _edges(time_s: Float, hold: Hold | None, per_decade: int) -> Int:
    """First sample of each window of a hold: equally wide in log time since the drive began to change, of a rest in time."""
    if hold is None:
        edges = np.linspace(time_s[0], time_s[-1], _REST_WINDOWS + 1)[:-1]
    else:
        zero = hold.begins_s
        first = max(time_s[0] - zero, hold.start_s - zero, 1e-9 * max(time_s[-1] - zero, 1e-9))
        if time_s[0] <= zero and time_s.size > 1:
            first = max(first, time_s[1] - zero)
        decades = max(0.0, float(np.log10(max(time_s[-1] - zero, first) / first)))
        edges = zero + first * 10 ** np.linspace(0, decades, int(np.ceil(decades * per_decade)) + 1)[:-1]
        edges = np.append(time_s[0], edges[1:])
    return np.unique(np.searchsorted(time_s, edges * (1 - 1e-12)).clip(0, time_s.size - 1))


def _smoothed(
    drive_s: Float,
    drive: Float,
    windows: tuple[Float, Float],
    times: Float,
    hold_of: Int,
    instants: Float,
    hold_of_instant: Int,
) -> Float:
    """The drive at instants of holds without its noise: the level of each, or where that wanders its means over the windows."""
    noise = _noise(drive)
    sums = np.concatenate([[0.0], np.cumsum(drive)])
    low, high = np.searchsorted(drive_s, windows[0]), np.searchsorted(drive_s, windows[1], side="right")
    count = high - low
    means = np.interp(times, drive_s, drive)
    means[count > 0] = (sums[high] - sums[low])[count > 0] / count[count > 0]
    weight = np.maximum(count, 1)
    found = np.empty(instants.size)
    for number in np.unique(hold_of):
        there, rows = hold_of_instant == number, hold_of == number
        level = float(weight[rows] @ means[rows] / weight[rows].sum())
        chi2 = float(weight[rows] @ (means[rows] - level) ** 2)
        freedom = int(rows.sum()) - 1
        if chi2 <= (freedom + _WANDERS * np.sqrt(2 * freedom)) * noise**2:
            found[there] = level
        else:
            found[there] = np.interp(instants[there], times[rows], means[rows])
    return found


def _level_error(drive_s: Float, drive: Float, holds: tuple[Hold, ...], rests: bool) -> float:
    """Standard deviation of the largest change of level over that change, by the noise of the drive."""
    counts = [int(np.sum((drive_s >= h.start_s) & (drive_s <= h.end_s))) for h in holds]
    zero = holds[0].level if rests else 0.0
    largest = max(range(len(holds)), key=lambda i: abs(holds[i].level - zero))
    change = abs(holds[largest].level - zero)
    variance = 1 / max(counts[largest], 1) + (1 / max(counts[0], 1) if rests else 0.0)
    return _noise(drive) * float(np.sqrt(variance)) / change if change else 0.0


def _ramps(drive_s: Float, drive: Float, holds: tuple[Hold, ...]) -> tuple[Float, Float]:
    """The course of the drive between its holds, thinned, with the instants at which it leaves one level and reaches the next."""
    times, values = [], []
    for before, after in pairwise(holds):
        inside = np.flatnonzero((drive_s > before.end_s) & (drive_s < after.start_s))
        if not inside.size:
            continue
        some = inside[np.unique(np.linspace(0, inside.size - 1, min(inside.size, _PER_RAMP)).astype(int))]
        t, u = drive_s[some], drive[some]
        leaves, reaches = _corners(drive_s[inside], drive[inside], before.level, after.level)
        if before.end_s < leaves < t[0]:
            t, u = np.append(leaves, t), np.append(before.level, u)
        if t[-1] < reaches < after.start_s:
            t, u = np.append(t, reaches), np.append(u, after.level)
        times.append(t)
        values.append(u)
    return (np.concatenate(times), np.concatenate(values)) if times else (np.zeros(0), np.zeros(0))


def _corners(time_s: Float, values: Float, before: float, after: float) -> tuple[float, float]:
    """Where a line through the middle of a ramp meets the levels on both sides; a machine that rests samples seldom."""
    share = (values - before) / (after - before)
    middle = (share > _MIDDLE) & (share < 1 - _MIDDLE)
    if int(middle.sum()) < 3:
        return float("nan"), float("nan")
    slope, start = np.polyfit(time_s[middle], share[middle], 1)
    return (float(-start / slope), float((1 - start) / slope)) if slope > 0 else (float("nan"), float("nan"))


def _jump(time_s: Float, times: Float, means: Float, holds: tuple[Hold, ...], hold_of: Int) -> Float:
    """What the instant of an edge, known to one sample, does to the windows after it: their slope × interval/√12."""
    found = np.zeros(times.size)
    for number, hold in enumerate(holds):
        rows = np.flatnonzero(hold_of == number)
        inside = int(np.sum((time_s > hold.begins_s) & (time_s < hold.start_s)))
        if number == 0 or rows.size < 3 or inside >= 3:
            continue
        found[rows] = np.abs(np.gradient(means[rows], times[rows])) * (hold.start_s - hold.begins_s) / np.sqrt(12)
    return found


def _scatter(time_s: Float, values: Float, begin: Int, end: Int) -> Float:
    """Standard deviation of a sample within each window about a parabola; 0 where there are too few to tell."""
    result = np.zeros(begin.size)
    for i, (first, last) in enumerate(zip(begin, end, strict=True)):
        if last - first < 8:
            continue
        every = max(1, (last - first) // 2000)
        t, v = time_s[first:last:every], values[first:last:every]
        s = (t - t.mean()) / (float(np.ptp(t)) or 1.0)
        rest = v - np.polyval(np.polyfit(s, v, 2), s)
        result[i] = np.sqrt(float(rest @ rest) / (v.size - 3))
    return result
