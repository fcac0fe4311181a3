"""Permittivity of a force map: one value for all pre-stretches and directions, and whether one value serves.

Belongs here: the common permittivity with its interval, tests of constancy over stretches and directions, the words for
the report. Points and the equation are in `force_points`, differences between configurations in `force_comparisons`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.fit.force.points import ForcePoint, force_points
from pipeline.fit.survival.kaplan_meier import LEVEL, UNKNOWN, Estimate
from pipeline.transform.force_map import ForceMapReadings
from schemas.arrays import Float
from schemas.numbers import bounds, digits, p_equals, significant

_ALARM = 0.05


@dataclass(frozen=True)
class Constancy:
    """F test of one permittivity for all stretches against one for each, and the trend over the area stretch λ1λ2.

    NaN with one pair of stretches. `slope` per unit of area stretch with its 95 % interval. `direction_p_value`: of equal
    permittivity in both directions, NaN with one direction.
    """

    statistic: float
    degrees_of_freedom: tuple[int, int]
    p_value: float
    slope: Estimate
    direction_p_value: float

    @property
    def holds(self) -> bool:
        return not self.p_value < _ALARM and not self.direction_p_value < _ALARM


@dataclass(frozen=True)
class ForceMapFit:
    """One permittivity for the map of a specimen, 95 % interval, and whether it is one.

    Where the points do not agree on one value the interval is that of their mean with the spread between points.
    """

    specimen_id: str
    configuration: str | None
    campaign: str | None
    points: int
    relative_permittivity: Estimate
    stated_permittivity: float | None
    constancy: Constancy | None
    statement: str
    warnings: tuple[str, ...]


def fit_force_map(points: Sequence[ForcePoint], *, stated_permittivity: float | None = None) -> ForceMapFit:
    """One permittivity for the points of one specimen, with a test of constancy.

    Repeats scatter either by the same force at all points or by the same share of the force; the likelihood of their
    residuals decides, and the points are weighted accordingly. The F test compares one permittivity for all points with
    one for each. Without repeats there is no test.

    `points` : of one specimen and configuration, at least one with geometry (`ValueError` without).
    """
    usable = [p for p in points if math.isfinite(p.per_permittivity_n)]
    if not usable:
        raise ValueError("no point has the geometry that a permittivity needs")
    first = usable[0]
    rows = _Rows.of(usable)
    common, error, freedom = rows.common()
    warnings = tuple(dict.fromkeys(text for p in usable for text in p.warnings))
    constancy = rows.constancy() if rows.scatter_known and len(usable) > 1 else None
    if constancy is None:
        quantile = float(special.ndtri(0.5 + LEVEL / 2)) if freedom < 1 else float(special.stdtrit(freedom, 0.975))
        estimate = Estimate(common, common - quantile * error, common + quantile * error)
        warnings += ("fewer than two points or no repeats: constancy cannot be tested",)
    elif constancy.holds:
        quantile = float(special.stdtrit(freedom, 0.5 + LEVEL / 2))
        estimate = Estimate(common, common - quantile * error, common + quantile * error)
    else:
        values = np.array([p.relative_permittivity.value for p in usable])
        spread = float(values.std(ddof=1)) / math.sqrt(values.size)
        quantile = float(special.stdtrit(values.size - 1, 0.5 + LEVEL / 2))
        estimate = Estimate(*(float(values.mean()) + side * quantile * spread for side in (0, -1, 1)))
    statement = _statement(usable, estimate, constancy, stated_permittivity)
    return ForceMapFit(
        first.specimen_id,
        first.configuration,
        first.campaign,
        len(usable),
        estimate,
        stated_permittivity,
        constancy,
        statement,
        warnings,
    )


def fit_force_maps(
    recordings: Sequence[ForceMapReadings],
) -> tuple[tuple[ForcePoint, ...], tuple[ForceMapFit, ...]]:
    """Points of all specimens, and a fit for each specimen and configuration that has the geometry for one."""
    points = force_points(recordings)
    stated = {(r.specimen_id, r.configuration): r.stated_permittivity for r in recordings}
    by_specimen: dict[tuple[str, str | None], list[ForcePoint]] = defaultdict(list)
    for point in points:
        if math.isfinite(point.per_permittivity_n):
            by_specimen[point.specimen_id, point.configuration].append(point)
    fits = tuple(fit_force_map(members, stated_permittivity=stated[key]) for key, members in by_specimen.items())
    return points, fits


@dataclass(frozen=True)
class _Rows:
    """Permittivities of a map, one per repeat: `value` (n,), mean over the directions read together, as they share an
    electrode and its scatter; `place` (n,) index of stretches and voltage; `weight` (n,) 1/variance up to a factor;
    `noise` (n,) standard deviation from the levels alone.
    """

    value: Float
    place: np.ndarray
    weight: Float
    noise: Float
    points: Sequence[ForcePoint]

    @classmethod
    def of(cls, points: Sequence[ForcePoint]) -> _Rows:
        by_place: dict[tuple[float, float, float], list[ForcePoint]] = defaultdict(list)
        for point in points:
            by_place[point.stretch_1, point.stretch_2, round(point.voltage_kv, 1)].append(point)
        shared = set.intersection(*({p.direction for p in members} for members in by_place.values()))
        value, place, absolute, noise = [], [], [], []
        for index, members in enumerate(by_place.values()):
            used = [p for p in members if p.direction in shared] or members
            for cycle in dict.fromkeys(c for p in used for c in p.cycles):
                read = [(p, p.forces_n[p.cycles.index(cycle)]) for p in used if cycle in p.cycles]
                value.append(float(np.mean([force / p.per_permittivity_n for p, force in read])))
                place.append(index)
                absolute.append(1 / sum(p.per_permittivity_n**-2 for p, _ in read))
                errors = [p.force_error_n / p.per_permittivity_n for p, _ in read]
                noise.append(math.hypot(*errors) / len(errors))
        weight = _weights(np.array(value), np.array(place), np.array(absolute))
        return cls(np.array(value), np.array(place), weight, np.array(noise), points)

    @property
    def places(self) -> int:
        return int(self.place[-1]) + 1

    @property
    def scatter_known(self) -> bool:
        return self.value.size > self.places

    def _pure_error(self) -> tuple[float, int]:
        """Weighted sum of squares of the repeats about their places, and its degrees of freedom."""
        means = _means(self.value, self.place)
        return float((self.weight * (self.value - means) ** 2).sum()), self.value.size - self.places

    def common(self) -> tuple[float, float, int]:
        """The common permittivity, its standard error and the degrees of freedom of that (0: from the levels' noise)."""
        total = float(self.weight.sum())
        value = float((self.weight * self.value).sum()) / total
        if self.scatter_known:
            squares, freedom = self._pure_error()
            return value, math.sqrt(squares / freedom / total), freedom
        return value, math.sqrt(float((self.weight**2 * self.noise**2).sum())) / total, 0

    def constancy(self) -> Constancy:
        """Over the places by an F test on weighted repeats, over the directions by `_directions`."""
        squares, freedom = self._pure_error()
        between = self.places - 1
        statistic, p_value = float("nan"), float("nan")
        if between:
            common = float((self.weight * (self.value - self.common()[0]) ** 2).sum())
            statistic = max(common - squares, 0.0) / between / (squares / freedom) if squares > 0 else math.inf
            p_value = float(special.fdtrc(between, freedom, statistic)) if math.isfinite(statistic) else 0.0
        return Constancy(statistic, (between, freedom), p_value, self._slope(), self._directions())

    def _slope(self) -> Estimate:
        """Slope of the points' permittivity over the area stretch, ordinary least squares over the places."""
        areas = {(p.stretch_1, p.stretch_2, round(p.voltage_kv, 1)): p.area_stretch for p in self.points}
        area = np.array(list(areas.values()))
        value = np.asarray(np.bincount(self.place, self.value) / np.bincount(self.place))
        if np.unique(area).size < 3:
            return UNKNOWN
        centred = area - area.mean()
        slope = float(centred @ value / (centred @ centred))
        residual = value - value.mean() - slope * centred
        freedom = area.size - 2
        error = math.sqrt(float(residual @ residual) / freedom / float(centred @ centred))
        half = float(special.stdtrit(freedom, 0.5 + LEVEL / 2)) * error
        return Estimate(slope, slope - half, slope + half)

    def _directions(self) -> float:
        """Paired t test of equal permittivity in both directions over all repeats that read both."""
        found: dict[tuple[str, int], dict[int, float]] = defaultdict(dict)
        for p in self.points:
            for cycle, force in zip(p.cycles, p.forces_n, strict=True):
                found[cycle][p.direction] = force / p.per_permittivity_n
        pairs = np.array([both[1] - both[2] for both in found.values() if len(both) == 2])
        if pairs.size < 2 or pairs.std(ddof=1) == 0:
            return float("nan")
        t = abs(float(pairs.mean())) / (float(pairs.std(ddof=1)) / math.sqrt(pairs.size))
        return 2 * float(special.stdtr(pairs.size - 1, -t))


def _means(value: Float, place: np.ndarray) -> Float:
    return np.asarray((np.bincount(place, value) / np.bincount(place))[place])


def _weights(value: Float, place: np.ndarray, absolute: Float) -> Float:
    """Weights for scatter by the same force everywhere (`absolute`) or by the same share of it, whichever is likelier."""
    residual = value - _means(value, place)
    if not np.any(residual != 0):
        return np.asarray(absolute / absolute.mean())
    likelihoods = [
        0.5 * float(np.log(w).sum()) - 0.5 * value.size * math.log(float(np.mean(w * residual**2)))
        for w in (absolute, np.ones_like(value))
    ]
    chosen = absolute if likelihoods[0] >= likelihoods[1] else np.ones_like(value)
    return np.asarray(chosen / chosen.mean())


def _statement(
    points: Sequence[ForcePoint], estimate: Estimate, constancy: Constancy | None, stated: float | None
) -> str:
    if estimate.lower > 0:
        text = f"relative permittivity {_interval(estimate)} over {digits(len(points), 'point')}"
    else:
        text = f"{digits(len(points), 'point')}, too far apart for one relative permittivity"
    if constancy is not None:
        proofs = []
        if not math.isnan(constancy.p_value):
            between, within = constancy.degrees_of_freedom
            proofs.append(
                f"stretches: F({between}, {within}) = {significant(constancy.statistic, 2)}, {p_equals(constancy.p_value)}"
            )
        if not math.isnan(constancy.direction_p_value):
            proofs.append(f"directions: {p_equals(constancy.direction_p_value)}")
        proof = "; ".join(proofs)
        if constancy.holds:
            text += f"; one value serves the map ({proof})"
        else:
            lowest = min(points, key=lambda p: p.relative_permittivity.value)
            highest = max(points, key=lambda p: p.relative_permittivity.value)
            text += f"; no one value serves the map ({proof}): from {_place(lowest)} to {_place(highest)}"
            if constancy.slope.upper < 0 or constancy.slope.lower > 0:
                text += f", {_interval(constancy.slope)} per unit of area stretch"
    limits = [(p.relative_permittivity.lower, p.relative_permittivity.upper) for p in points]
    missed = stated is not None and (
        not estimate.lower <= stated <= estimate.upper
        or all(upper < stated for _, upper in limits)
        or all(lower > stated for lower, _ in limits)
    )
    if stated is not None and missed:
        text += f"; the {stated:g} that the metadata state predicts {significant(stated / estimate.value)} times the measured force"
    return text


def _place(point: ForcePoint) -> str:
    return (
        f"{point.relative_permittivity.value:.3g} (direction {point.direction}, "
        f"{point.stretch_1:g} × {point.stretch_2:g})"
    )


def _interval(estimate: Estimate) -> str:
    if math.isnan(estimate.lower):
        return significant(estimate.value)
    return bounds(estimate.value, estimate.lower, estimate.upper)
