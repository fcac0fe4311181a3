"""Capacitance held at a demand by a controller: how fast, how far beyond, how steady, and whether force keeps its relation.

One change of the demand and the hold after it. The steps of the same recording, as of any other, are in `step`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import special

from pipeline.transform.step_edges import on_phases, seconds_and_values, without_spikes
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.recording import Recording

BAND = 0.05
"""Settled within this share of the demanded step, or within what noise alone reaches where that is wider."""
SMOOTHED_S = 0.05
FINAL_SHARE, FINAL_S = 0.2, 5.0
"""The level reached: mean over the last fifth of the hold, at most 5 s."""
DRIFT_FROM_S, SHORTEST_DRIFT_S = 20.0, 60.0
"""The relation is followed from 20 s after the change on, in holds of a minute or more."""
_BLOCKS = 24


@dataclass(frozen=True)
class LoopResponse:
    """Response of a closed loop to one change of its demand. None where it cannot be computed, see `warnings`.

    Times in s since the change. Rise, overshoot and settling are those of the capacitance on its way to the demand;
    `force_overshoot_percent` is the largest drop of tension over the one held at the end. `error_rms_pf` is that of
    C − C_d once settled. `error_sign`: +1 where the voltage rose because C was above the demand. `relation_drift_percent`
    ± its standard deviation is the change of force at given capacitance from 20 s to the end, in percent of the step, by
    a straight line over the logarithm of time.
    """

    recording_id: str
    specimen_id: str
    proportional_gain: float | None
    integral_gain: float | None
    start_s: float
    hold_s: float
    demand_step_pf: float | None
    capacitance_rest_pf: float
    capacitance_step_pf: float
    rise_time_s: float | None
    overshoot_percent: float | None
    settling_time_s: float | None
    error_rms_pf: float | None
    force_step_n: float
    force_overshoot_percent: float | None
    peak_kv: float
    final_kv: float
    error_sign: int | None
    relation_drift_percent: float | None
    relation_drift_percent_sd: float | None
    warnings: tuple[str, ...] = ()


def measure_loop(recording: Recording) -> LoopResponse:
    """The loop's response to the first change of its demand.

    Without a `demand` channel the hold is taken from the voltage and the level that is reached stands for the demand: no
    error, no overshoot beyond it. Raises `NotIdentifiableError` without capacitance, without a change and for a hold that
    is too short to have a level.
    """
    about = recording.metadata
    where = about.recording_id
    if "capacitance" not in recording.channels:
        raise NotIdentifiableError("closed loop without a capacitance", where=where, expected="a capacitance channel")
    start = recording.start_ns
    tv, volts = seconds_and_values(recording.channels["voltage"], start)
    tf, force = seconds_and_values(recording.channels["force"], start)
    (tc, c), _ = without_spikes(*seconds_and_values(recording.channels["capacitance"], start), on_phases(tv, volts))
    warnings: list[str] = []
    begin, end, wanted = _hold(recording, tv, volts, warnings)
    if tc.size < 8 or end - begin < 20 * float(np.median(np.diff(tc))):
        raise NotIdentifiableError(f"the hold is {end - begin:.3g} s long", where=where, expected="20 samples or more")
    rest, noise = _level(tc, c, max(begin - 1.0, 0.0), begin)
    force_rest, _ = _level(tf, force, max(begin - 1.0, 0.0), begin)
    late = end - min(FINAL_S, FINAL_SHARE * (end - begin))
    reached, _ = _level(tc, c, late, end)
    drop = force_rest - _level(tf, force, late, end)[0]
    step = reached - rest if wanted is None else wanted
    if not math.isfinite(step) or abs(step) < 3 * noise / math.sqrt(50):
        raise NotIdentifiableError(
            f"the demand changes by {step:.3g} pF", where=where, expected="more than the noise of the capacitance"
        )
    t, y, relative = _smoothed(tc, (c - rest) / step, noise / abs(step), begin, end)
    rise, settling = _rise(t, y), _settling(t, y, relative)
    if settling is None:
        warnings.append("not settled: the capacitance still leaves the band around the demand at the end of the hold")
    peak = float(y.max()) - 1
    force_time, pulled, force_noise = _smoothed(
        tf,
        (force_rest - force) / drop if drop else np.zeros_like(force),
        _noise(tf, force, begin) / abs(drop or 1.0),
        begin,
        end,
    )
    force_peak = float(pulled.max()) - 1
    strong = drop > 5 * _noise(tf, force, begin) / math.sqrt(50)
    error = None
    if wanted is not None and settling is not None:
        settled = (tc >= begin + settling) & (tc < end)
        error = float(np.sqrt(np.mean((c[settled] - rest - step) ** 2))) if settled.any() else None
    inside = (tv >= begin) & (tv < end)
    before, final = _level(tv, volts, max(begin - 1.0, 0.0), begin)[0], _level(tv, volts, late, end)[0]
    drift, drift_sd = _relation_drift(tc, c, rest, tf, force, force_rest, begin, end)
    return LoopResponse(
        where,
        about.specimen_id,
        about.proportional_gain,
        about.integral_gain,
        begin,
        end - begin,
        wanted,
        rest,
        reached - rest,
        rise,
        100 * peak if peak > _reach(relative, y.size) else 0.0,
        settling,
        error,
        drop,
        (100 * force_peak if force_peak > _reach(force_noise, force_time.size) else 0.0) if strong else None,
        float(np.quantile(volts[inside], 0.999)) if inside.any() else math.nan,
        final,
        None if wanted is None or final == before else int(math.copysign(1, -wanted * (final - before))),
        drift,
        drift_sd,
        tuple(warnings),
    )


def _hold(recording: Recording, tv: Float, volts: Float, warnings: list[str]) -> tuple[float, float, float | None]:
    """Begin and end of the first hold, and by how much the demand changes (None without that channel)."""
    where = recording.metadata.recording_id
    demand = recording.channels.get("demand")
    if demand is None:
        warnings.append("no demand channel: the level that is reached stands for it, the loop's error is not known")
        phases = on_phases(tv, volts)
        if not phases:
            raise NotIdentifiableError("the voltage makes no step", where=where, expected="a change from off to on")
        return phases[0].on, phases[0].leaves, None
    td, wanted = seconds_and_values(demand, recording.start_ns)
    changes = np.flatnonzero(np.abs(np.diff(wanted)) > 1e-9 * max(float(np.max(np.abs(wanted), initial=0.0)), 1e-9))
    if not changes.size:
        raise NotIdentifiableError("the demand does not change", where=where, expected="one step of the demand")
    begin = float(td[changes[0] + 1])
    end = float(td[changes[1] + 1]) if changes.size > 1 else float(td[-1])
    return begin, end, float(wanted[changes[0] + 1] - wanted[changes[0]])


def _level(t: Float, x: Float, begin: float, end: float) -> tuple[float, float]:
    """Mean and noise of one sample within [begin, end)."""
    values = x[(t >= begin) & (t < end)]
    if values.size < 2:
        return math.nan, math.nan
    return float(values.mean()), float(np.std(np.diff(values))) / math.sqrt(2)


def _noise(t: Float, x: Float, begin: float) -> float:
    return _level(t, x, max(begin - 1.0, 0.0), begin)[1]


def _smoothed(t: Float, y: Float, noise: float, begin: float, end: float) -> tuple[Float, Float, float]:
    """Time since the change and means over 50 ms at most, as long as noise asks for it; noise of one value."""
    inside = (t >= begin) & (t < end)
    t, y = t[inside] - begin, y[inside]
    longest = max(1.0, SMOOTHED_S / float(np.median(np.diff(t)))) if t.size > 2 else 1.0
    width = int(min(max(1.0, (noise / 0.01) ** 2), longest))
    if width > 1:
        y = np.convolve(np.pad(y, (width // 2, width - 1 - width // 2), mode="edge"), np.ones(width) / width, "valid")
    return t, y, noise / math.sqrt(width)


def _reach(noise: float, count: int) -> float:
    """What noise alone reaches among so many values."""
    return 1.2 * noise * math.sqrt(2 * math.log(max(count, 2)))


def _rise(t: Float, y: Float) -> float | None:
    """10 to 90 % of the demanded step, first crossings."""
    first, last = np.flatnonzero(y >= 0.1), np.flatnonzero(y >= 0.9)
    return float(t[last[0]] - t[first[0]]) if first.size and last.size else None


def _settling(t: Float, y: Float, noise: float) -> float | None:
    """Last exit from the band; None where that is in the last tenth of the hold."""
    outside = np.flatnonzero(np.abs(y - 1) > max(BAND, _reach(noise, y.size)))
    if not outside.size:
        return 0.0
    last = int(outside[-1])
    return None if t[last] > 0.9 * t[-1] else float(t[min(last + 1, t.size - 1)])


def _relation_drift(
    tc: Float, c: Float, rest: float, tf: Float, force: Float, force_rest: float, begin: float, end: float
) -> tuple[float | None, float | None]:
    """Change of the drop of tension at given capacitance from 20 s on, percent of the drop, ± its standard deviation."""
    if end - begin < SHORTEST_DRIFT_S:
        return None, None
    edges = np.geomspace(DRIFT_FROM_S, end - begin, _BLOCKS + 1)
    drop, change = (
        np.array([float(np.mean(x[(t >= begin + a) & (t < begin + b)])) for a, b in pairwise(edges)])
        for t, x in ((tf, force_rest - force), (tc, c - rest))
    )
    if not np.isfinite(drop).all() or not np.isfinite(change).all() or not drop.mean() or not change.mean():
        return None, None
    # Brought to one capacitance by the relation itself, so that what the loop lets through does not count.
    given = drop - drop.mean() / change.mean() * (change - change.mean())
    x = np.log(np.sqrt(edges[1:] * edges[:-1]))
    x = x - x.mean()
    slope = float(x @ given / (x @ x))
    rest_of = given - given.mean() - slope * x
    sd = math.sqrt(float(rest_of @ rest_of) / (x.size - 2) / float(x @ x))
    scale = 100 * math.log(edges[-1] / edges[0]) / float(drop.mean())
    # Limits at ±1.96 of what is reported hold 95 %: Student's quantile goes into it.
    student = float(special.stdtrit(x.size - 2, 0.975) / special.ndtri(0.975))
    return scale * slope, abs(scale) * sd * student
