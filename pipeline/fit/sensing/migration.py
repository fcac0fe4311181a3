"""From which cycle on an electrode migrates: the onset of harmonics in a capacitance that was sinusoidal (thesis, 5.4.3)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from pipeline.transform.capacitance_cycles import CapacitanceCycles
from schemas.arrays import Float

LEVEL = 1e-6
"""Nominal probability up to which a change counts as an onset: the count of onsets tried does not count their shapes, and
the study of self-sensing finds an onset in less than 1 % of waves that do not change."""
_SCALES = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0, 10000.0)
"""Cycles in which a distortion grows to its final size; the last is a straight line, the first a jump."""
_WITHIN = 3.841
"""95 % point of χ² with one degree of freedom."""
_LONGEST_GRID = 120
_SHORTER = 0.75
_CLEAR = 1e-6
"""Probability by chance up to which the record behind the onset is cut shorter."""


@dataclass(frozen=True)
class Migration:
    """Onset of electrode migration in completed cycles with its 95 % limits, None where the wave does not change.

    `distortion_before`, `distortion_after`: root sum of squares of the harmonics over the fundamental, before the onset
    (over the whole record where there is none) and at the end. `cycles` is the number of the last cycle.
    """

    recording_id: str
    specimen_id: str
    cycles: int
    onset_cycle: float | None
    onset_cycle_lower: float | None
    onset_cycle_upper: float | None
    p_value: float
    distortion_before: float
    distortion_after: float
    warnings: tuple[str, ...] = ()


def migration(found: CapacitanceCycles) -> Migration:
    """Onset of distortion: harmonics that are constant up to a cycle and grow in one direction from there on.

    The growth is (1 − exp(−(n − n0)/s))^p with s free among a few and p = ½, 1 or 2, so that neither a jump nor a slow bend is
    forced; limits of n0 by the likelihood ratio over all of them. What follows long after the onset must not move it: the
    record is cut ever shorter behind the onset and fitted again, as long as the change stays beyond doubt.
    """
    z = np.concatenate([found.harmonics.real, found.harmonics.imag], axis=1)
    # Noise from cycle to cycle, whatever its origin: differences of neighbours do not feel a slow change.
    noise = np.median(np.abs(np.diff(z, axis=0)), axis=0) / (0.6745 * np.sqrt(2))
    z = z / np.maximum(noise, 1e-15)
    n: Float = found.cycle.astype(np.float64) - 0.5  # middles of the cycles, counted in completed ones
    tail = max(10, n.size // 20)
    after = float(np.sqrt(np.mean(found.distortion[-tail:] ** 2)))
    whole = _fit(n, z)
    warnings: tuple[str, ...] = ()
    if whole.p_value >= LEVEL:
        before = float(np.sqrt(np.mean(found.distortion**2)))
        return Migration(
            found.recording_id,
            found.specimen_id,
            int(found.cycle[-1]),
            None,
            None,
            None,
            whole.p_value,
            before,
            after,
            warnings,
        )
    best = whole
    behind = float(n[-1]) - best.onset
    while behind > 8:
        behind *= _SHORTER
        kept = n <= best.onset + behind
        if kept.sum() < 20:
            break
        shorter = _fit(n[kept], z[kept])
        if shorter.p_value >= _CLEAR:
            break
        behind = min(behind, float(n[kept][-1]) - shorter.onset)
        best = shorter
    early = n < best.onset
    if best.lower <= n[0] + 2:
        warnings += ("the wave is distorted from the first cycles on",)
    before = float(np.sqrt(np.mean(found.distortion[early] ** 2))) if early.any() else float(found.distortion[0])
    return Migration(
        found.recording_id,
        found.specimen_id,
        int(found.cycle[-1]),
        best.onset,
        best.lower,
        best.upper,
        whole.p_value,
        before,
        after,
        warnings,
    )


@dataclass(frozen=True)
class _Hinge:
    onset: float
    lower: float
    upper: float
    p_value: float


def _fit(n: Float, z: Float) -> _Hinge:
    """Likeliest onset among the cycles n (k,) of whitened harmonics z (k, m), its limits and the chance of it by noise."""
    last = float(n[-3])
    grid: Float = np.unique(np.round(np.linspace(float(n[0]) + 0.5, last, min(2 * n.size, _LONGEST_GRID)) * 2) / 2)
    centred = z - z.mean(axis=0)
    gain = _gains(n, centred, grid)
    profile = gain.max(axis=0)
    i = int(profile.argmax())
    if n.size > grid.size:
        near = np.arange(
            float(grid[max(i - 2, 0)]), float(grid[min(i + 2, grid.size - 1)]) + 0.5, 0.5, dtype=np.float64
        )
        finer: Float = np.asarray(np.union1d(grid, near), dtype=np.float64)
        gain, grid = _gains(n, centred, finer), finer
        profile = gain.max(axis=0)
        i = int(profile.argmax())
    free = z.size - 2 * z.shape[1] - 3
    left = float(np.sum(centred**2)) - float(profile[i])
    variance = max(left / free, 1.0)
    ratio = float(profile[i]) / variance
    # Bonferroni over the onsets: the shapes of one onset are nearly the same test.
    p_value = float(min(1.0, 3 * grid.size * special.chdtrc(z.shape[1], ratio)))
    inside = grid[profile >= profile[i] - _WITHIN * variance]
    # Half a cycle is what the numbering itself leaves open.
    return _Hinge(float(grid[i]), float(inside[0]) - 0.5, float(inside[-1]) + 0.5, p_value)


def _gains(n: Float, centred: Float, grid: Float) -> Float:
    """(shapes, onsets) fall of the sum of squares when the harmonics may grow from an onset in one shape."""
    since = np.maximum(n[:, None] - grid[None, :], 0.0)
    rows = []
    for scale in _SCALES:
        grown = -np.expm1(-since / scale)
        for shape in (np.sqrt(grown), grown, grown * grown):
            # Of columns that have no mean only the norm needs it: the harmonics are centred already.
            norm = np.einsum("ij,ij->j", shape, shape) - shape.sum(axis=0) ** 2 / n.size
            projected = np.sum((shape.T @ centred) ** 2, axis=1)
            rows.append(np.where(norm > 1e-12, projected / np.maximum(norm, 1e-12), 0.0))
    return np.array(rows)
