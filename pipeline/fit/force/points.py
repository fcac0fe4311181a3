"""Points of a force map: mean static force by specimen, pre-stretch and direction, and the permittivity it needs.

Film stretched to (λ1, λ2), its length fixed while the voltage acts (thesis, eq 3.7):

    f1 = ε0 εr V² (L2/Hf) λ1 λ2²,   f2 = ε0 εr V² (L1/Hf) λ1² λ2     active region L1 × L2 drawn on the undeformed film
    f1 = ε0 εr V² w λ1 λ2/Hf,       f2 = ε0 εr V² l λ1 λ2/Hf         l × w drawn on the stretched film

Belongs here: the equation and means of repeats. One permittivity for a map is in `force_map`, differences between
configurations in `force_comparisons`, readings come from `pipeline.transform.force_map`.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.fit.survival.kaplan_meier import LEVEL, UNKNOWN, Estimate
from pipeline.physics.film import EPSILON_0_N_PER_KV2
from pipeline.transform.force_map import ForceMapReadings, ForceReading

_SAME_VOLTAGE = 0.02
"""Readings at voltages that differ by less than this share belong to one point."""

_Reading = tuple[ForceReading, ForceMapReadings]


def force_per_permittivity(
    direction: int,
    voltage_kv: float,
    stretch_1: float,
    stretch_2: float,
    *,
    thickness_mm: float,
    active_length_mm: float,
    active_width_mm: float,
    drawn: str,
    layers: int = 1,
) -> float:
    """Drop of tension in N for a relative permittivity of 1, in direction 1 or 2 (thesis, eq 3.7).

    `thickness_mm` of one undeformed layer; the active sizes in the state in which they were `drawn`, `undeformed` or
    `stretched`: length along direction 1, width along direction 2.
    """
    across = active_width_mm if direction == 1 else active_length_mm
    if drawn == "undeformed":
        across *= stretch_2 if direction == 1 else stretch_1
    elif drawn != "stretched":
        raise ValueError(f"drawn {drawn!r} is neither undeformed nor stretched")
    return layers * EPSILON_0_N_PER_KV2 * voltage_kv**2 * across * stretch_1 * stretch_2 / thickness_mm


@dataclass(frozen=True)
class ForcePoint:
    """One specimen, pair of stretches, direction and voltage: mean force of its repeats.

    `force_sd_n` is the standard deviation of the repeats (NaN for one). `per_permittivity_n` is the force for εr = 1
    (NaN without geometry), `predicted_n` that for the stated permittivity. `relative_permittivity` has its 95 % interval
    from the repeats (Student's t); for a single reading from the noise of its levels. `forces_n`: the repeats, brought to
    `voltage_kv` by the square of their voltages; `cycles` (recording, cycle) of each.
    """

    specimen_id: str
    configuration: str | None
    campaign: str | None
    stretch_1: float
    stretch_2: float
    direction: int
    voltage_kv: float
    forces_n: tuple[float, ...]
    cycles: tuple[tuple[str, int], ...]
    force_n: float
    force_sd_n: float
    force_error_n: float
    per_permittivity_n: float
    predicted_n: float
    relative_permittivity: Estimate
    relative_permittivity_sd: float
    warnings: tuple[str, ...]

    @property
    def repeats(self) -> int:
        return len(self.forces_n)

    @property
    def area_stretch(self) -> float:
        return self.stretch_1 * self.stretch_2


def force_points(recordings: Sequence[ForceMapReadings]) -> tuple[ForcePoint, ...]:
    """Points of all specimens; repeats may be cycles of one recording or separate recordings.

    Recordings without `stretch_1` have no place on a map: they give no point.
    """
    grouped: dict[tuple[str, str | None, float, float, int], list[_Reading]]
    grouped = defaultdict(list)
    for recording in recordings:
        if recording.stretch_1 is None or recording.stretch_2 is None:
            continue
        for reading in recording.readings:
            key = (
                recording.specimen_id,
                recording.configuration,
                round(recording.stretch_1, 6),
                round(recording.stretch_2, 6),
                reading.direction,
            )
            grouped[key].append((reading, recording))
    points = []
    for key in sorted(grouped, key=lambda k: (k[0], k[1] or "", k[4], k[2], k[3])):
        rows = sorted(grouped[key], key=lambda row: row[0].voltage_kv)
        start = 0
        for i in range(len(rows)):
            if i + 1 == len(rows) or rows[i + 1][0].voltage_kv > rows[i][0].voltage_kv * (1 + _SAME_VOLTAGE):
                points.append(_point(key, rows[start : i + 1]))
                start = i + 1
    return tuple(points)


def _point(key: tuple[str, str | None, float, float, int], rows: Sequence[_Reading]) -> ForcePoint:
    specimen, configuration, stretch_1, stretch_2, direction = key
    voltages = np.array([reading.voltage_kv for reading, _ in rows])
    voltage = float(voltages.mean())
    forces = np.array([reading.force_n for reading, _ in rows]) * (voltage / voltages) ** 2
    recording = rows[0][1]
    n = forces.size
    mean = float(forces.mean())
    sd = float(forces.std(ddof=1)) if n > 1 else float("nan")
    error = sd / math.sqrt(n) if n > 1 else rows[0][0].force_sd_n
    warnings = [] if n > 1 else ["one reading: its scatter is only that of the noise"]
    unit, notes = _unit_force(recording, direction, voltage)
    warnings += notes
    quantile = float(special.stdtrit(n - 1, 0.5 + LEVEL / 2)) if n > 1 else float(special.ndtri(0.5 + LEVEL / 2))
    permittivity = UNKNOWN
    if math.isfinite(unit):
        permittivity = Estimate(*((mean + side * quantile * error) / unit for side in (0, -1, 1)))
    stated = recording.stated_permittivity
    return ForcePoint(
        specimen,
        configuration,
        recording.campaign,
        stretch_1,
        stretch_2,
        direction,
        voltage,
        tuple(forces.tolist()),
        tuple((source.recording_id, reading.cycle) for reading, source in rows),
        mean,
        sd,
        error,
        unit,
        float("nan") if stated is None else unit * stated,
        permittivity,
        error / unit,
        tuple(warnings),
    )


def _unit_force(recording: ForceMapReadings, direction: int, voltage: float) -> tuple[float, list[str]]:
    needed = {
        "film_thickness_mm": recording.film_thickness_mm,
        "active_length_mm": recording.active_length_mm,
        "active_width_mm": recording.active_width_mm,
    }
    missing = [name for name, value in needed.items() if value is None]
    if missing:
        return float("nan"), [f"no permittivity: {', '.join(missing)} missing"]
    warnings = [] if recording.active_drawn else ["active_drawn missing: taken as drawn on the undeformed film"]
    unit = force_per_permittivity(
        direction,
        voltage,
        float(recording.stretch_1 or math.nan),
        float(recording.stretch_2 or math.nan),
        thickness_mm=float(recording.film_thickness_mm or math.nan) / recording.layers,
        active_length_mm=float(recording.active_length_mm or math.nan),
        active_width_mm=float(recording.active_width_mm or math.nan),
        drawn=recording.active_drawn or "undeformed",
        layers=recording.layers,
    )
    return unit, warnings
