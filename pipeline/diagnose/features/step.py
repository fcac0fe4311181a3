"""Features of voltage steps: drop of the force, change of the capacitance and the voltage itself in windows after the edges.

Cycles of one level are taken together in groups (1, 2 to 3, 4 to 6, 7 to last). Windows are equally wide in log time. The
square of the measured voltage is the input of force and capacitance, the command that of the voltage.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from pipeline.diagnose.features.blocks import (
    Signals,
    add_rounding,
    add_unit_noise,
    block,
    cycle_groups,
    log_windows,
)
from pipeline.diagnose.features.functionals import Component
from pipeline.diagnose.features.kinds import STEP_CAPACITANCE, STEP_FORCE, STEP_VOLTAGE, FeatureBlock, NoiseSample
from pipeline.diagnose.features.records import Record, clamp_hz, record, ringing_s
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.simulation.nodes import response_nodes
from pipeline.transform.sampling import runs
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.recording import Recording

_PER_DECADE = 5
"""Windows after an edge per decade of time."""
_HIGHEST_HZ = 50.0
"""Highest frequency of interest after an edge, Hz."""
_LONGEST = 40_000
"""Samples to which a long record is thinned."""
_DISTURBED_S = 0.05
"""Time after an edge in which the converter of the capacitance is disturbed."""
_SAME_EDGE_S = 0.25
"""Time within which an edge of the voltage belongs to one of the command, s."""
_SETTLED, _CREEP_DEGREE, _SLOW_HZ, _MOST_PLATEAUS = 0.4, 4, 20.0, 8
"""Share of a plateau after which its noise is taken, polynomial that creep follows, highest frequency, cycles that are enough."""


@dataclass(frozen=True)
class _Cycle:
    """Samples at which the voltage begins to rise, is up, begins to fall, is down, and the next cycle begins."""

    rise: int
    up: int
    fall: int
    down: int
    end: int
    level: float


@dataclass(frozen=True)
class _Group:
    """Cycles of one level, numbered from 1 within the recording; windows (cycle, first, stop) after on and off edges."""

    cycles: tuple[_Cycle, ...]
    first: int
    last: int

    @property
    def level(self) -> float:
        return float(np.mean([c.level for c in self.cycles]))

    @property
    def label(self) -> str:
        span = f"cycle {self.first}" if self.first == self.last else f"cycles {self.first} to {self.last}"
        return f"{span} at {self.level:.3g} kV"


def step_blocks(
    recording: Recording, nodes: Float
) -> tuple[list[FeatureBlock], list[NoiseSample], dict[str, float], list[str]]:
    """Blocks, noise, values, warnings of an electrical `step`. Raises `NotIdentifiableError` where nothing can be read."""
    where = recording.metadata.recording_id
    channels = {q: recording.channels[q] for q in ("voltage", "force") if q in recording.channels}
    if len(channels) < 2:
        raise NotIdentifiableError("voltage or force is missing", where=where)
    for q in ("capacitance", "command"):
        if q in recording.channels and recording.channels[q].values.size:
            channels[q] = recording.channels[q]
    highest = min(_HIGHEST_HZ, _LONGEST / max(recording.duration_s, 1e-9) / 10)
    found = record(channels, recording, highest_hz=highest)
    voltage = found.values["voltage"]
    cycles = _cycles(voltage, found.interval_s)
    if not cycles:
        raise NotIdentifiableError("the voltage makes no step", where=where)
    rest = cycles[0].rise - 2
    if rest < RULES.features.step_rest:
        raise NotIdentifiableError(
            f"{max(rest, 0)} samples before the first step",
            where=where,
            expected=f"at least {RULES.features.step_rest}",
        )
    groups = _groups(cycles)
    edge_s = float(np.median(np.diff(recording.channels["voltage"].time_ns))) * 1e-9 / np.sqrt(12)
    squared = voltage**2
    squared = squared - squared[:rest].mean()
    force = found.values["force"]
    noise = [found.noise(q, v[:rest]) for q, v in found.values.items()]
    noise += _plateau_noise(found, cycles)
    blocks: list[FeatureBlock] = []
    base = Signals(
        squared,
        force[:rest].mean() - force,
        found.interval_s,
        nodes,
        tuple(Component("force", e) for e in (0, 1, 2)) + found.mains,
        found.channel_factor("force", "voltage"),
        slow=True,
        noise_sd=float(force[:rest].std()),
        largest_response=float(np.ptp(force)) / float(squared.max()),
    )
    settled_s = ringing_s(recording.rig, found.interval_s)
    rounding = found.rounding("force", force[:rest])
    for group in groups:
        made = _windows(STEP_FORCE, group, base, rest, found, edge_s, least_s=settled_s, rounding=rounding)
        if made is not None:
            blocks.append(made)
    values = {
        "rest_force_n": float(force[:rest].mean()),
        "largest_voltage_kv": max(abs(c.level) for c in cycles),
        "exposure_kv2_s": float(np.sum(voltage**2) * found.interval_s),
    }
    if "capacitance" in channels:
        sensed = found.values["capacitance"]
        values["capacitance_rest_pf"] = float(sensed[:rest].mean())
        one = replace(
            base,
            output=_without_spikes(sensed, cycles, found.interval_s) - sensed[:rest].mean(),
            components=(Component("capacitance", 0), Component("capacitance", 1)),
            noise_sd=float(sensed[:rest].std()),
            largest_response=float(np.ptp(sensed)) / float(squared.max()),
            factor=found.channel_factor("capacitance", "voltage"),
        )
        least_s, rounding = max(_DISTURBED_S, settled_s), found.rounding("capacitance", sensed[:rest])
        for group in groups:
            made = _windows(STEP_CAPACITANCE, group, one, rest, found, edge_s, least_s=least_s, rounding=rounding)
            if made is not None:
                blocks.append(made)
    if "command" in channels and np.ptp(found.values["command"]) > 0:
        blocks += _voltage_blocks(found, groups, rest, edge_s)
    if not blocks:
        raise NotIdentifiableError("no plateau outlasts the ringing of the clamp", where=where)
    warnings = []
    if settled_s > 0:
        warnings.append(
            f"{1 / found.interval_s:.3g} samples per second do not follow the clamp's ringing at "
            f"{clamp_hz(recording.rig):.3g} Hz: the first {settled_s:.2g} s after each edge are left out"
        )
    return blocks, [n for n in noise if n is not None], values, warnings


def _plateau_noise(found: Record, cycles: list[_Cycle]) -> Iterator[NoiseSample | None]:
    """Slow noise in the later parts of the plateaus, where nothing but creep is left: the rest is too short to show it.

    Not of the force: the clamp rings longer.
    """
    for quantity in ("voltage", "command", "capacitance"):
        if quantity not in found.values:
            continue
        for c in cycles[:_MOST_PLATEAUS]:
            for begin, stop in ((c.up, c.fall), (c.down, c.end)):
                late = begin + int(_SETTLED * (stop - begin))
                if not found.lost[late : stop - 1].any():
                    values = found.values[quantity][late : stop - 1]
                    yield found.noise(quantity, values, degree=_CREEP_DEGREE, below_hz=_SLOW_HZ)


def _cycles(voltage: Float, interval_s: float) -> list[_Cycle]:
    """Cycles with their edges found at 2 % of the step; whole cycles only (the last may lack its rest)."""
    size = np.abs(voltage)
    reach = float(np.percentile(size, 99.5))
    if reach <= 0:
        return []
    noise = float(np.abs(np.diff(size)).mean())
    on = runs(size > 0.5 * reach * 0.3)
    on = [(a, b) for a, b in on if (b - a) * interval_s > 0.05 and b - a > 8]
    ends = [a for a, _ in on[1:]] + [voltage.size]
    cycles = []
    for (a, b), end in zip(on, ends, strict=True):
        level = float(np.median(voltage[a + (b - a) // 2 : b - (b - a) // 20 - 1]))
        margin = max(0.01 * abs(level), 4 * noise)
        reachable = max(0, a - int(_SAME_EDGE_S / interval_s))
        low = np.flatnonzero(size[reachable:a] <= margin)
        rise = reachable + int(low[-1]) if low.size else a
        high = np.flatnonzero(np.abs(voltage[a:b]) >= abs(level) - margin)
        up = a + int(high[0]) if high.size else a
        fall = a + int(high[-1]) if high.size else b
        gone = np.flatnonzero(size[b:end] <= margin)
        down = b + int(gone[0]) if gone.size else b
        cycles.append(_Cycle(rise, up, min(fall, b), down, end, level))
    for i, (this, after) in enumerate(itertools.pairwise(cycles)):
        cycles[i] = replace(this, end=after.rise)
    return cycles


def _groups(cycles: list[_Cycle]) -> list[_Group]:
    """Runs of cycles of one level, each cut into groups; at most 24, the rest of a long test is its last group."""
    starts = [0]
    for i in range(1, len(cycles)):
        if abs(cycles[i].level - cycles[i - 1].level) > RULES.features.same_level * abs(cycles[i - 1].level):
            starts.append(i)
    groups = []
    for a, b in zip(starts, [*starts[1:], len(cycles)], strict=True):
        groups += [_Group(tuple(cycles[a + p : a + q]), a + p + 1, a + q) for p, q in cycle_groups(b - a)]
    return groups[: RULES.features.most_groups]


def _spans(group: _Group, least: int) -> tuple[list[list[tuple[int, int]]], list[float], list[float]]:
    """Windows of the same place in every cycle, their time after the edge (samples), and 1 for on, −1 for off."""
    spans: list[list[tuple[int, int]]] = []
    since, side = [], []
    for sign, edges in (
        (1.0, [(c.rise, c.up, c.fall) for c in group.cycles]),
        (-1.0, [(c.fall, c.down, c.end) for c in group.cycles]),
    ):
        length = min(stop - begin for begin, _, stop in edges) - 2
        first = max(2, least)
        for a, b in log_windows(first, length, _PER_DECADE, 2):
            spans.append([(begin + a, begin + b) for begin, _, _ in edges])
            since.append((a + b) / 2)
            side.append(sign)
    return spans, since, side


def _windows(
    kind: str,
    group: _Group,
    signals: Signals,
    rest: int,
    found: Record,
    edge_s: float,
    *,
    least_s: float,
    rounding: float,
) -> FeatureBlock | None:
    """Means of the output in windows after the edges of a group. An edge is known to `edge_s`, for it lies between two samples."""
    spans, since, side = _spans(group, int(least_s / signals.interval_s) + 1)
    rows, kept = [], []
    stop = max(b for span in spans for _, b in span) if spans else 0
    for i, span in enumerate(spans):
        if any(found.lost[a:b].any() for a, b in span):
            continue
        row = np.zeros(stop)
        row[:rest] = -1 / rest
        for a, b in span:
            row[a:b] += 1 / (b - a) / len(span)
        rows.append(row)
        kept.append(i)
    if not rows:
        return None
    at = np.array([np.mean([(a + b) / 2 for a, b in spans[i]]) for i in kept]) * signals.interval_s
    after = np.array([since[i] for i in kept]) * signals.interval_s
    sides = np.array([side[i] for i in kept])
    made = block(
        kind,
        group.label,
        signals,
        np.array(rows),
        0,
        is_complex=False,
        frequency=1 / (2 * np.pi * after),
        voltage=abs(group.level),
        cycle=(group.first + group.last) / 2,
        time=at,
        support={
            "since_s": after,
            "side": sides,
            "level_kv": np.array([group.level]),
            "on_s": np.array([(group.cycles[0].fall - group.cycles[0].rise) * signals.interval_s]),
        },
        drifts=True,
    )
    made = add_rounding(made, rounding)
    return add_unit_noise(
        made, edge_covariance(np.array(rows), signals.output[:stop], sides, edge_s / signals.interval_s)
    )


def edge_covariance(rows: Float, output: Float, sides: Float, sd: float) -> Float:
    """(n, n) covariance of windows that edges bring whose time is known to `sd` samples, and their width to as much.

    Edges of one test lie alike between the samples: more cycles do not make it less. What rings answers an edge that is wider by its second
    derivative, half the mean square of the width.

    Parameters
    ----------
    rows : (n, T) weights of the samples in each window
    output : (T,) samples
    sides : (n,) 1 after edges that rise, −1 after those that fall
    """
    later = np.gradient(output)
    covariance = np.zeros((len(rows), len(rows)))
    for moved, by in ((later, sd), (np.gradient(later), 0.5 * sd**2)):
        changed = rows @ moved * by
        for side in (1.0, -1.0):
            own = np.where(sides == side, changed, 0.0)
            covariance += np.outer(own, own)
    return covariance


def _without_spikes(sensed: Float, cycles: list[_Cycle], interval_s: float) -> Float:
    """The capacitance with straight lines where an edge disturbs the converter."""
    calm = sensed.copy()
    width = max(1, int(_DISTURBED_S / interval_s))
    for c in cycles:
        for edge in (c.rise, c.fall):
            a, b = edge, min(edge + width, sensed.size - 1)
            calm[a:b] = np.linspace(sensed[a - 1] if a else sensed[a], sensed[b], b - a)
    return calm


def _voltage_blocks(found: Record, groups: list[_Group], rest: int, edge_s: float) -> list[FeatureBlock]:
    """Voltage in windows after the edges over the plateau of the command, answer to the command."""
    command = found.values["command"]
    voltage = found.values["voltage"]
    made, rounding = [], found.rounding("voltage", voltage[:rest])
    for group in groups:
        middle = [(c.up + c.fall) // 2 for c in group.cycles]
        plateau = float(np.mean([np.mean(command[m - 1 : m + 2]) for m in middle]) - command[:rest].mean())
        if abs(plateau) < RULES.features.step_command:
            continue
        per_volt, gain = _constant(1 / abs(plateau)), _constant(abs(group.level) / plateau**2)
        signals = Signals(
            (command - command[:rest].mean()) / plateau,
            (voltage - voltage[:rest].mean()) / plateau,
            found.interval_s,
            response_nodes(RigConstants()),
            (
                Component("voltage", 0, per_volt),
                Component("voltage", 1, per_volt),
                Component("command", 0, gain),
                Component("command", 1, gain),
            ),
            found.channel_factor("voltage", "command"),
            slow=True,
            noise_sd=float(voltage[:rest].std()),
            largest_response=float(np.abs(voltage).max()),
        )
        one = _windows(STEP_VOLTAGE, group, signals, rest, found, edge_s, least_s=0.0, rounding=rounding / plateau**2)
        if one is not None:
            made.append(one)
    return made


def _constant(value: float) -> Callable[[Float], Float]:
    return lambda frequency: np.full_like(frequency, value)
