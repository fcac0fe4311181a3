"""Static force of two configurations at one pair of stretches: difference and ratio with intervals.

Belongs here: which points can be compared, and Welch's intervals over specimens, or over repeats when each
configuration has one specimen. Points come from `force_points`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy import special

from pipeline.fit.force.points import ForcePoint
from pipeline.fit.survival.kaplan_meier import LEVEL, UNKNOWN, Estimate
from schemas.arrays import Float

_SAME_VOLTAGE = 0.02


@dataclass(frozen=True)
class ForceComparison:
    """Force of configuration b against a at one pair of stretches and one direction.

    `difference_n` is b − a in N, `ratio` b/a, both with 95 % limits (NaN where the data give none); `p_value` of equal
    forces. `specimens_a`, `specimens_b` count specimens; with one each, the repeats carry the interval and it speaks of
    these two specimens only.
    """

    configuration_a: str | None
    configuration_b: str | None
    stretch_1: float
    stretch_2: float
    direction: int
    voltage_kv: float
    specimens_a: int
    specimens_b: int
    difference_n: Estimate
    ratio: Estimate
    p_value: float
    warnings: tuple[str, ...]


def compare_forces(points: Sequence[ForcePoint]) -> tuple[ForceComparison, ...]:
    """All pairs of configurations that were measured at the same stretches, direction and voltage (within 2 %).

    Forces are brought to the mean voltage of the pair by the square of the voltage. Pairs are not corrected for their
    number.
    """
    grouped: dict[tuple[float, float, int], dict[str | None, list[ForcePoint]]] = defaultdict(lambda: defaultdict(list))
    for point in points:
        grouped[point.stretch_1, point.stretch_2, point.direction][point.configuration].append(point)
    found = []
    for place in sorted(grouped):
        by_configuration = grouped[place]
        for a, b in combinations(sorted(by_configuration, key=lambda name: name or ""), 2):
            found += _pairs(by_configuration[a], by_configuration[b])
    return tuple(found)


def _pairs(a: Sequence[ForcePoint], b: Sequence[ForcePoint]) -> list[ForceComparison]:
    levels = sorted({round(p.voltage_kv, 6) for p in a})
    pairs = []
    for i, level in enumerate(levels):
        if i and level <= levels[i - 1] * (1 + _SAME_VOLTAGE):
            continue
        near_a, near_b = ([p for p in side if abs(p.voltage_kv / level - 1) <= _SAME_VOLTAGE] for side in (a, b))
        if near_a and near_b:
            pairs.append(_compared(near_a, near_b))
    return pairs


def _compared(a: Sequence[ForcePoint], b: Sequence[ForcePoint]) -> ForceComparison:
    voltage = float(np.mean([p.voltage_kv for p in (*a, *b)]))
    warnings: tuple[str, ...] = ()
    samples = [_samples(side, voltage) for side in (a, b)]
    specimens = [len({p.specimen_id for p in side}) for side in (a, b)]
    if min(specimens) < 2:
        samples = [np.concatenate([_scaled(p, voltage) for p in side]) for side in (a, b)]
        warnings = ("one specimen in a configuration: the interval is that of repeats, not of specimens",)
    difference, p_value = _welch(samples[0], samples[1])
    ratio = UNKNOWN
    if min(float(s.min()) for s in samples) > 0:
        log_ratio, _ = _welch(np.log(samples[0]), np.log(samples[1]))
        ratio = Estimate(*(math.exp(x) for x in (log_ratio.value, log_ratio.lower, log_ratio.upper)))
    if math.isnan(difference.lower):
        warnings += ("single readings: no interval",)
    first = a[0]
    return ForceComparison(
        first.configuration,
        b[0].configuration,
        first.stretch_1,
        first.stretch_2,
        first.direction,
        voltage,
        specimens[0],
        specimens[1],
        difference,
        ratio,
        p_value,
        warnings,
    )


def _scaled(point: ForcePoint, voltage: float) -> Float:
    return np.array(point.forces_n) * (voltage / point.voltage_kv) ** 2


def _samples(points: Sequence[ForcePoint], voltage: float) -> Float:
    """Mean force of each specimen in N."""
    by_specimen: dict[str, list[Float]] = defaultdict(list)
    for point in points:
        by_specimen[point.specimen_id].append(_scaled(point, voltage))
    return np.array([float(np.concatenate(parts).mean()) for parts in by_specimen.values()])


def _welch(a: Float, b: Float) -> tuple[Estimate, float]:
    """Mean of b less mean of a with Welch's 95 % interval and two-sided p-value; NaN with fewer than two on a side."""
    difference = float(b.mean() - a.mean())
    if min(a.size, b.size) < 2:
        return Estimate(difference), float("nan")
    parts = np.array([a.var(ddof=1) / a.size, b.var(ddof=1) / b.size])
    total = float(parts.sum())
    if total == 0:
        return Estimate(difference, difference, difference), float("nan")
    freedom = total**2 / float((parts**2 / np.array([a.size - 1, b.size - 1])).sum())
    half = float(special.stdtrit(freedom, 0.5 + LEVEL / 2)) * math.sqrt(total)
    p_value = 2 * float(special.stdtr(freedom, -abs(difference) / math.sqrt(total)))
    return Estimate(difference, difference - half, difference + half), p_value
