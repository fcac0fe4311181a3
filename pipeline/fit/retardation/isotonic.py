"""A film that moves a constant load under a voltage: stroke by level, at once and slowly, and the law that strokes follow.

Every level of the voltage has an elastic and retarded parts of its own; the retardation times are those of the whole record, driven by
the strokes as they are read off, whatever law these follow. So the slow part of one level does not count as the rest of the next, and a
stroke that does not go with V² shows. Windows in which the load rings after an edge are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi2 as chi2_distribution

from pipeline.fit.retardation.creep import Estimate, bounds, contradict_load
from pipeline.fit.retardation.fit import Retardation, fit_retardation, nuisance_columns, slopes_by_log_time
from pipeline.physics.compliance import integral
from pipeline.physics.film import integrate_arms
from pipeline.transform.holds import HeldRecord, Hold, find_holds, reduce_record
from pipeline.transform.sampling import seconds
from schemas.arrays import Bool, Float, Int
from schemas.errors import NotIdentifiableError
from schemas.metadata import RecordingMetadata
from schemas.recording import Recording

_OFF = 0.05
"""Share of the largest voltage below which it is off."""
_ALIKE = 0.02
"""Share of the largest voltage within which two levels are one."""
_CONSTANT = 0.05
"""Share of the load by which it may change with the voltage and still be called constant."""
_PIECES = 20
"""Pieces of the time without voltage whose medians tell whether the load moves by itself."""
_LAW = 0.01
_LATE, _RINGS = 0.2, 6.0
"""Share of a level after which nothing rings any more, and times its noise by which a window is off while it does."""


@dataclass(frozen=True)
class Stroke:
    """One level: voltage in kV, strokes in mm (extension positive), how often and how long it was on."""

    voltage_kv: float
    repeats: int
    on_s: float
    stroke_mm: Estimate
    instant_mm: Estimate
    slow_mm: Estimate


@dataclass(frozen=True)
class Isotonic:
    """What one test tells.

    Parameters
    ----------
    strokes : by level, lowest voltage first
    mm_per_kv2 : stroke at the end of a level over V², `exponent` the power of V that strokes follow (None for one level)
    p_value : of strokes that go with V²; None for one level
    load_n : constant load and what it changes by while the voltage is on; None where neither channel nor metadata say
    free_strain : largest stroke over the length of the film; None where that is not known
    strain_per_field_squared : (m/MV)², by `mm_per_kv2`, length and thickness under load; None without sizes
    instant_within_s : what is faster than this counts as at once
    """

    retardation: Retardation
    strokes: tuple[Stroke, ...]
    mm_per_kv2: Estimate
    exponent: Estimate | None
    p_value: float | None
    load_n: float | None
    load_change_n: float | None
    free_strain: Estimate | None
    strain_per_field_squared: Estimate | None
    instant_within_s: float
    drift_mm_per_h: Estimate | None
    modelled: Float
    warnings: tuple[str, ...] = ()


def measure_isotonic(recording: Recording) -> Isotonic:
    """Strokes by level of the voltage.

    Raises `NotIdentifiableError` where the voltage is held nowhere, or for too short a time.
    """
    about, where = recording.metadata, recording.metadata.recording_id
    v_s, voltage = seconds(recording.channels["voltage"], recording.start_ns)
    moved = recording.channels["displacement"]
    x_s, x = seconds(moved, recording.start_ns)
    holds = find_holds(v_s, voltage, where=where, name="voltage")
    top = max(abs(h.level) for h in holds)
    rests = len(holds) > 1 and abs(holds[0].level) <= _OFF * top
    record = reduce_record(
        v_s,
        voltage,
        x_s,
        x,
        holds,
        rests=rests,
        squared=True,
        step=(moved.resolution or 0.0) / math.sqrt(12),
        where=where,
    )
    levels, level_of = _group(holds, top)
    parts = _split(record.history_s, record.drive, holds, len(levels), level_of) / np.array(levels) ** 2
    lasting = [_duration(holds, level_of, i) for i in range(len(levels))]
    level_of = level_of[[holds.index(hold) for hold in record.holds]]
    _check_recorded(record, level_of, where)
    goes_off = bool((level_of[np.argmax(level_of >= 0) :] < 0).any())
    driven = replace(record, drive=parts @ _rough_strokes(record, levels, level_of))
    usable = driven.usable
    found = fit_retardation(driven, drifts=goes_off)
    rings = _find_ringing(found)
    if rings > 0:
        usable = driven.usable & (_since_s(driven) > rings)
    shown = sorted(set(level_of[np.unique(record.hold[usable])].tolist()) - {-1})
    if not shown:
        raise NotIdentifiableError(
            f"the film rings with its load for {rings:.2g} s after an edge, or is not recorded: no level is seen at rest",
            where=where,
            expected="levels of voltage that last until the film has come to rest",
        )
    if rings > 0:
        found = fit_retardation(replace(driven, usable=usable), drifts=goes_off)
    values, covariance, modelled = _fit_levels(found, parts, [on_s for _, on_s in lasting])
    strokes = tuple(
        Stroke(
            levels[i],
            *lasting[i],
            *(bounds(float(v), math.sqrt(c)) for v, c in _parts(values, covariance, i)),
        )
        for i in shown
    )
    seen = np.array([levels[i] for i in shown])
    total = values[0::3][shown]
    spread = covariance[0::3, 0::3][np.ix_(shown, shown)]
    warnings = [*found.selected.warnings, *record.warnings]
    coefficient, misfit = _proportional(seen**2, total, spread)
    p_value = float(chi2_distribution.sf(misfit, seen.size - 1)) if seen.size > 1 else None
    exponent = _exponent(seen, total, spread)
    if p_value is not None and p_value < _LAW:
        instead = "" if exponent is None else (
            f" but with V^{exponent.value:.2f} (95 %: {exponent.lower:.2f} to {exponent.upper:.2f})"
        )  # fmt: skip
        warnings.append(f"the strokes do not go with V²{instead}")
    if lost := [f"{level:.3g}" for i, level in enumerate(levels) if i not in shown]:
        warnings.append(f"no window in which the film is at rest at {', '.join(lost)} kV: no stroke is told there")
    if rings > 0:
        warnings.append(f"the film rings with its load for {rings:.2g} s after an edge: that counts as at once")
    if not goes_off:
        warnings.append(
            "the voltage is not taken off: a drift of the displacement cannot be told from creep, and counts as creep"
        )
    load, change = _load(recording, v_s, voltage, top)
    if load is not None and change is not None:
        warnings += contradict_load(about.load_n, [load])
    if load is None:
        warnings.append("neither a force channel nor load_n in the metadata says which load the film moves")
    elif change is not None and abs(change) > _CONSTANT * abs(load):
        warnings.append(f"the load changes by {change:.3g} N while the voltage is on: it is not constant")
    if load is not None and "force" in recording.channels:
        low, high = _load_at_rest(recording, v_s, voltage, top)
        if high - low > _CONSTANT * abs(load):
            warnings.append(f"the load goes from {low:.3g} to {high:.3g} N without voltage: it is not constant")
    length, thickness = about.stretched_length_mm, _thickness(about)
    largest = strokes[-1].stroke_mm
    drift, drift_sd = found.selected.drift
    return Isotonic(
        retardation=found,
        strokes=strokes,
        mm_per_kv2=coefficient,
        exponent=exponent,
        p_value=p_value,
        load_n=load,
        load_change_n=change,
        free_strain=None if length is None else _scaled(largest, 1 / length),
        strain_per_field_squared=None
        if length is None or thickness is None
        else _scaled(coefficient, thickness**2 / length),
        instant_within_s=max(rings, math.exp(found.fastest_log_s)),
        drift_mm_per_h=bounds(3600 * found.sign * drift, 3600 * drift_sd) if goes_off else None,
        modelled=modelled,
        warnings=tuple(warnings),
    )


def _group(holds: tuple[Hold, ...], top: float) -> tuple[list[float], Int]:
    """Levels in kV, lowest first, and the one of each hold; −1 where the voltage is off."""
    groups: list[list[int]] = []
    for i in sorted(range(len(holds)), key=lambda i: abs(holds[i].level)):
        size = abs(holds[i].level)
        if size <= _OFF * top:
            continue
        if groups and size - abs(holds[groups[-1][0]].level) <= _ALIKE * top:
            groups[-1].append(i)
        else:
            groups.append([i])
    level_of = np.full(len(holds), -1, dtype=np.int64)
    for number, members in enumerate(groups):
        level_of[members] = number
    return [float(np.sqrt(np.mean([holds[i].level ** 2 for i in g]))) for g in groups], level_of


def _check_recorded(record: HeldRecord, level_of: Int, where: str) -> None:
    """The displacement has to be recorded while the voltage is on, and while it is off, if its zero is its own."""
    on = level_of >= 0
    if not on.any() or (record.offset and on.all()):
        raise NotIdentifiableError(
            f"the displacement has no sample while the voltage is {'off' if on.any() else 'on'}",
            where=where,
            expected="samples of it with and without voltage",
        )


def _split(t: Float, drive: Float, holds: tuple[Hold, ...], levels: int, level_of: Int) -> Float:
    """The drive (m, levels) of each level alone; a ramp belongs to the higher of the levels between which it is."""
    after = np.searchsorted([h.start_s for h in holds], t, side="right") - 1
    inside = (after >= 0) & (t <= np.array([h.end_s for h in holds])[np.maximum(after, 0)])
    size = np.array([abs(h.level) for h in holds])
    following = np.minimum(after + 1, len(holds) - 1)
    owner = np.where(inside | (size[np.maximum(after, 0)] >= size[following]), np.maximum(after, 0), following)
    parts = np.zeros((t.size, levels))
    of = level_of[owner]
    rows = np.flatnonzero(of >= 0)
    parts[rows, of[rows]] = drive[rows]
    return parts


def _since_s(record: HeldRecord) -> Float:
    """(n,) s since the drive changed to the level of each window; infinite in the rest before the first."""
    begins = np.array([-math.inf if record.rests and i == 0 else h.begins_s for i, h in enumerate(record.holds)])
    return np.asarray(record.time_s - begins[record.hold])


def _since(record: HeldRecord) -> Float:
    """The same as share of the level's length."""
    lengths = np.array([h.end_s - h.begins_s for h in record.holds])
    return np.asarray(_since_s(record) / lengths[record.hold])


def _rough_strokes(record: HeldRecord, levels: list[float], level_of: Int) -> Float:
    """(L,) strokes in mm as read off the last windows: what makes the retardation of all levels one, whatever law they follow.

    A level without samples of the displacement has the one that is usual by V².
    """
    last = np.array([np.flatnonzero(record.hold == i)[-1] for i in range(len(record.holds))])
    ends = record.displacement[last]
    strokes: list[list[float]] = [[] for _ in levels]
    rests = np.flatnonzero(level_of < 0)
    for i, level in enumerate(level_of):
        if level >= 0:
            before = rests[rests < i]
            zero = ends[before[-1] if before.size else rests[0]] if before.size or record.offset else 0.0
            strokes[level].append(float(ends[i] - zero))
    usual = float(np.mean([np.mean(own) / v**2 for own, v in zip(strokes, levels, strict=True) if own]))
    return np.array([np.mean(own) if own else usual * v**2 for own, v in zip(strokes, levels, strict=True)])


def _find_ringing(found: Retardation) -> float:
    """s after an edge until which a film with a load on it rings; 0 where it does not.

    It rings where the windows soon after an edge are off to one side, to the other and to the first again, by more than noise could be.
    """
    record = found.record
    off = record.displacement - found.modelled(found.selected)
    since, share = _since_s(record), _since(record)
    told = record.scatter[(record.scatter > 0) & (share > _LATE)]
    noise = float(np.median(told)) if told.size else found.noise.sample_sd
    wander = float(np.median(np.abs(off[share > _LATE])))
    far = (share <= _LATE) & (np.abs(off) > _RINGS * noise / np.sqrt(record.count) + wander)
    until = 0.0
    for i in range(len(record.holds)):
        rows = np.flatnonzero(far & (record.hold == i))
        turns = np.flatnonzero(np.diff(np.sign(off[rows])) != 0)
        if turns.size >= 2:
            until = max(until, float(since[rows[turns[-1] + 1]]))
    return until


def _fit_levels(found: Retardation, parts: Float, lasting_s: list[float]) -> tuple[Float, Float, Float]:
    """Stroke, instantaneous and slow part of each level one after the other (3 L,), their covariance, and the course (n,) mm.

    `parts` (m, L) is the course of each level alone, 1 while it is on; `lasting_s` (L,) how long that is.
    """
    record, fit = found.record, found.selected
    times = np.array(fit.compliance.times_s)
    columns = [nuisance_columns(record, fit.drifts)]
    levels = range(parts.shape[1])
    weights = np.zeros((3 * len(levels), columns[0].shape[1]))
    for i in levels:
        u = parts[:, i]
        slow = [u[:, None] - integrate_arms(record.history_s, u, times)] if times.size else []
        slow += [integral(record.history_s, u)[:, None]] if fit.compliance.flow else []
        own = np.hstack([u[:, None], *slow])
        columns.append(record.mean @ own)
        on_s = lasting_s[i]
        grown = np.concatenate([-np.expm1(-on_s / times), [on_s] if fit.compliance.flow else []])
        more = np.zeros((3 * len(levels), own.shape[1]))
        more[3 * i] = [1.0, *grown]
        more[3 * i + 1, 0] = 1.0
        more[3 * i + 2, 1:] = grown
        weights = np.hstack([weights, more])
    columns.append(slopes_by_log_time(record, times) * np.array(fit.compliance.retarded))
    weights = np.hstack([weights, np.zeros((weights.shape[0], times.size))])
    design, rows = np.hstack(columns), record.usable
    root = cholesky(found.noise.covariance(record)[np.ix_(rows, rows)], lower=True)
    white = solve_triangular(root, np.column_stack([design, record.displacement])[rows], lower=True)
    a, y = white[:, :-1], white[:, -1]
    scale = np.where((size := np.linalg.norm(a, axis=0)) > 0, size, 1.0)
    u_, s, vt = np.linalg.svd(a / scale, full_matrices=False)
    keep = s > 1e-9 * s[0]
    half = (vt.T[:, keep] / s[keep]) / scale[:, None]
    solution = half @ (u_.T[keep] @ y)
    rest = y - a @ solution
    dispersion = max(float(rest @ rest) / max(y.size - int(keep.sum()), 1), 1.0)
    covariance = weights @ half @ half.T @ weights.T * dispersion
    values = weights @ solution
    covariance += record.drive_error**2 * np.outer(values, values)
    return values, covariance, np.asarray(design @ solution)


def _parts(values: Float, covariance: Float, level: int) -> list[tuple[float, float]]:
    return [(float(values[3 * level + i]), max(float(covariance[3 * level + i, 3 * level + i]), 0.0)) for i in range(3)]


def _duration(holds: tuple[Hold, ...], level_of: Int, level: int) -> tuple[int, float]:
    """How often a level was on, and how long (s, the median)."""
    own = [holds[i] for i in np.flatnonzero(level_of == level)]
    return len(own), float(np.median([h.end_s - h.begins_s for h in own]))


def _proportional(squares: Float, strokes: Float, covariance: Float) -> tuple[Estimate, float]:
    """Stroke over V² in mm/kV², and the χ² that strokes leave about it."""
    weight = np.linalg.pinv(covariance)
    information = float(squares @ weight @ squares)
    slope = float(squares @ weight @ strokes) / information
    rest = strokes - slope * squares
    misfit = float(rest @ weight @ rest)
    widened = max(misfit / max(strokes.size - 1, 1), 1.0)
    return bounds(slope, math.sqrt(widened / information)), misfit


def _exponent(levels: Float, strokes: Float, covariance: Float) -> Estimate | None:
    """Power of V that strokes follow, from their logarithms; None for one level or strokes that are lost in their errors."""
    clear = np.abs(strokes) > 3 * np.sqrt(np.diag(covariance))
    if clear.sum() < 2 or np.ptp(np.sign(strokes[clear])) > 0:
        return None
    s, v = strokes[clear], levels[clear]
    weight = np.linalg.pinv(covariance[np.ix_(clear, clear)] / np.outer(s, s))
    design = np.column_stack([np.ones(v.size), np.log(v)])
    inverse = np.linalg.inv(design.T @ weight @ design)
    solution = inverse @ design.T @ weight @ np.log(np.abs(s))
    rest = np.log(np.abs(s)) - design @ solution
    widened = max(float(rest @ weight @ rest) / max(v.size - 2, 1), 1.0)
    return bounds(float(solution[1]), math.sqrt(widened * float(inverse[1, 1])))


def _load(recording: Recording, v_s: Float, voltage: Float, top: float) -> tuple[float | None, float | None]:
    """The load in N, by the force channel or the metadata, and what it changes by while the voltage is on."""
    if "force" not in recording.channels:
        return recording.metadata.load_n, None
    force, on = _force_under(recording, v_s, voltage, top)
    off = float(np.median(force[~on])) if (~on).any() else float(np.median(force))
    return off, float(np.median(force[on])) - off if on.any() and (~on).any() else None


def _load_at_rest(recording: Recording, v_s: Float, voltage: Float, top: float) -> tuple[float, float]:
    """Lowest and highest load in N without voltage, medians of pieces; a load that rings about its own is constant."""
    force, on = _force_under(recording, v_s, voltage, top)
    rest = force[~on] if (~on).any() else force
    medians = [float(np.median(piece)) for piece in np.array_split(rest, min(_PIECES, rest.size))]
    return min(medians), max(medians)


def _force_under(recording: Recording, v_s: Float, voltage: Float, top: float) -> tuple[Float, Bool]:
    """Samples of the force channel, and which of them were taken with the voltage on."""
    f_s, force = seconds(recording.channels["force"], recording.start_ns)
    return force, np.abs(np.interp(f_s, v_s, voltage)) > _OFF * top


def _thickness(about: RecordingMetadata) -> float | None:
    """Thickness of one layer under the load in mm, None where sizes or stretches are not known."""
    along, across = about.pre_stretch, about.lateral_stretch
    if about.layer_thickness_mm is None or along is None or across is None:
        return None
    return about.layer_thickness_mm / (along * across)


def _scaled(estimate: Estimate, factor: float) -> Estimate:
    return Estimate(factor * estimate.value, factor * estimate.lower, factor * estimate.upper)
