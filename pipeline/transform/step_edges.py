"""Edges of a voltage record, and a capacitance without the interference that the edges cause."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from schemas.arrays import Float
from schemas.recording import Channel

EDGE_S = 0.05
"""Time around an edge in which the converter disturbs the capacitance."""
LEVEL_S = 0.5
"""Longest stretch before an edge over which a level is averaged."""
_OFF_SHARE = 0.05
"""Share of the largest voltage of the record below which the voltage counts as off."""

_HELD = 0.05
"""Share of its level to which a voltage that is on holds it: the ripple and droop of laboratory supplies, whose square moves a force
by a tenth."""
_FEWEST_HELD = 8
"""Samples from which on that can be said."""
_LONGEST_EDGE = 0.2
"""Share of an on-phase from which on a rise or a fall is a part of it and no edge."""


@dataclass(frozen=True)
class Edges:
    """One on-phase in seconds: 50 % crossings, when 90 % was reached, when 98 % was left, the end of the rest after."""

    on: float
    reached: float
    leaves: float
    off: float
    off_end: float
    has_rest: bool
    has_fall: bool


def seconds_and_values(channel: Channel, start_ns: int) -> tuple[Float, Float]:
    """Seconds since the recording's start and values, lost samples left out."""
    keep = np.isfinite(channel.values)
    delay = channel.delay_s or 0.0
    seconds = ((channel.time_ns[keep] - start_ns) * 1e-9 - delay).astype(np.float64)
    return seconds, channel.values[keep]


def on_phases(t: Float, v: Float) -> list[Edges]:
    """On-phases of a voltage record."""
    if t.size < 4:
        return []
    top = float(np.quantile(np.abs(v), 0.999))
    noise = 1.4826 * float(np.median(np.abs(np.diff(v)))) / math.sqrt(2)
    limit = max(_OFF_SHARE * top, 8 * noise)
    if top < 3 * limit and top < 20 * noise:
        return []
    on = np.abs(v) > limit
    change = np.flatnonzero(np.diff(on.astype(np.int8)))
    bounds = np.concatenate([[0], change + 1, [t.size]])
    found = []
    last = len(bounds) - 2
    for i in range(len(bounds) - 1):
        low, high = int(bounds[i]), int(bounds[i + 1])
        if not on[low] or high - low < 3 or t[high - 1] - t[low] < 0.02:
            continue
        level = float(np.median(np.abs(v[low:high])))
        rising = _crossing(t, np.abs(v), low, high, 0.5 * level, rising=True)
        reached = _crossing(t, np.abs(v), low, high, 0.9 * level, rising=True)
        has_fall = i < last
        off = _crossing(t, np.abs(v), low, high, 0.5 * level, rising=False) if has_fall else float(t[-1])
        ending = (t >= off - min(LEVEL_S, 0.2 * (off - rising))) & (t <= off)
        final = float(np.quantile(np.abs(v[ending]), 0.8)) if ending.any() else level  # the fall is the lesser part
        leaves = _crossing(t, np.abs(v), low, high, 0.98 * final - 3 * noise, rising=False) if has_fall else off
        end = float(t[bounds[i + 2] - 1]) if has_fall else off
        found.append(Edges(rising, max(reached, rising), min(leaves, off), off, end, i > 0, has_fall))
    return found


def describe_unsteady(t: Float, v: Float, phase: Edges) -> str:
    """In words between what voltages an on-phase goes to and fro, noise aside; empty where it holds its level."""
    longest = _LONGEST_EDGE * (phase.off - phase.on)
    begin = phase.reached if phase.reached - phase.on < longest else phase.on
    end = phase.leaves if phase.off - phase.leaves < longest else phase.off
    inside = v[(t >= begin) & (t <= end)]
    if inside.size < _FEWEST_HELD:
        return ""
    low, high = (float(limit) for limit in np.quantile(inside, (0.05, 0.95)))
    noise = 1.4826 * float(np.median(np.abs(np.diff(inside)))) / math.sqrt(2)
    if high - low <= _HELD * max(abs(low), abs(high)) + 4 * noise:
        return ""
    return f"the voltage is not constant while it is on: {low:.3g} to {high:.3g} kV"


def _crossing(t: Float, v: Float, low: int, high: int, level: float, *, rising: bool) -> float:
    """Interpolated time at which v first exceeds (or last falls below) the level in an on-phase low … high."""
    above = np.flatnonzero(v[low:high] >= level) + low
    if rising:
        after = int(above[0])
        before = after - 1
    else:
        before = int(above[-1])
        after = before + 1
    if before < 0 or after >= t.size:
        return float(t[min(max(before, 0), t.size - 1)])
    share = (level - v[before]) / (v[after] - v[before]) if v[after] != v[before] else 0.5
    return float(t[before] + min(max(share, 0.0), 1.0) * (t[after] - t[before]))


def without_spikes(t: Float, c: Float, phases: Sequence[Edges]) -> tuple[tuple[Float, Float], list[int]]:
    """Capacitance without the converter's interference, and how many samples were left out per phase.

    Near an edge the capacitance lies between its values before and after it; what lies outside by more than a
    quarter of that change and six times the noise is interference.
    """
    noise = 1.4826 * float(np.median(np.abs(np.diff(c)))) / math.sqrt(2) if c.size > 2 else 0.0
    bad = np.zeros(t.size, bool)
    counts = []
    for phase in phases:
        count = 0
        for edge in (phase.on, phase.off) if phase.has_fall else (phase.on,):
            near = np.abs(t - edge) <= EDGE_S
            before = c[(t >= edge - 4 * EDGE_S) & (t < edge - EDGE_S)]
            after = c[(t > edge + EDGE_S) & (t <= edge + 4 * EDGE_S)]
            if not (near.any() and before.size and after.size):
                continue
            first, last = float(np.median(before)), float(np.median(after))
            margin = 6 * noise + 0.25 * abs(last - first)
            low, high = min(first, last) - margin, max(first, last) + margin
            spike = near & ((c < low) | (c > high))
            count += int(spike.sum())
            bad |= spike
        counts.append(count)
    return (t[~bad], c[~bad]), counts
