"""Several specimens or batches in one figure: stiffness and phase of each, and how far each is off the first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.palette import group
from reports.figures.plot import Scale, linear, logarithmic
from reports.figures.printed.axes import (
    Name,
    draw_band,
    draw_curve,
    draw_points,
    mark_level,
    name_curves,
    scale_axes,
    write_note,
)
from reports.figures.printed.style import CURVE_PT, DOUBLE, POINT_PT, open_axes, styled
from reports.figures.responses import Curve, Lines
from schemas.arrays import Complex, Float

_GRID = 160
_MARKS = 40
"""Points drawn of each specimen at most; a batch of several is drawn as lines."""


@dataclass(frozen=True)
class Overlaid:
    """An item of an overlay: its name, and measured lines and model of each of its specimens."""

    name: str
    members: tuple[tuple[Lines, Curve], ...]

    def mean(self, grid: Float) -> tuple[Float, Float, Float, Float]:
        """(m,) ln |k| and phase in degrees on a grid, and the standard deviation of each.

        Of several specimens: mean and its standard error; of one: its model and band, NaN where there is none.
        """
        logs = np.array([np.interp(np.log(grid), np.log(c.grid), np.log(np.abs(c.on_grid))) for _, c in self.members])
        turns = np.array([np.interp(np.log(grid), np.log(c.grid), np.degrees(np.angle(c.on_grid))) for _, c in self.members])  # fmt: skip
        if len(self.members) > 1:
            root = np.sqrt(len(self.members))
            return logs.mean(0), turns.mean(0), logs.std(0, ddof=1) / root, turns.std(0, ddof=1) / root
        curve = self.members[0][1]
        if curve.sd is None:
            nothing = np.full(grid.shape, np.nan)
            return logs[0], turns[0], nothing, nothing
        sd = [np.interp(np.log(grid), np.log(curve.grid), s) for s in (curve.sd[0] / np.abs(curve.on_grid), np.degrees(curve.sd[1]))]  # fmt: skip
        return logs[0], turns[0], sd[0], sd[1]

    @property
    def reach(self) -> tuple[float, float]:
        """Frequencies in Hz that all its specimens cover."""
        return max(float(c.grid[0]) for _, c in self.members), min(float(c.grid[-1]) for _, c in self.members)


@styled()
def draw_overlay(items: Sequence[Overlaid], *, width: str = DOUBLE) -> Figure:
    """Dynamic stiffness and phase of several items, and below how far each is off the first, with 95 % bands."""
    figure, axes = open_axes(width, 92 if width == DOUBLE else 160, (2.2, 1.2) if width == DOUBLE else (2.2, 1.2, 2.2, 1.2), 2 if width == DOUBLE else 1)  # fmt: skip
    parts = [axes[:, 0], axes[:, 1]] if width == DOUBLE else [axes[:2, 0], axes[2:, 0]]
    lines = [line for item in items for line, _ in item.members]
    x = logarithmic(*(line.frequency for line in lines), margin=0.015)
    means = []
    for item in items:
        grid = np.geomspace(*item.reach, _GRID)
        means.append((grid, *item.mean(grid)))
    for phase, (upper, lower) in zip((False, True), parts, strict=True):
        values = [_show(line.value[line.usable], phase=phase) for line in lines]
        y = linear(*values, [0.0], margin=0.08) if phase else logarithmic(*values, margin=0.06)
        scale_axes(upper, x, y, "Phase of k, degrees" if phase else "Dynamic stiffness |k|, N/mm", x_labels=False)
        names: list[Name] = []
        for i, (item, (grid, log, turn, *_)) in enumerate(zip(items, means, strict=True)):
            drawn = group(i)
            for line, curve in item.members:
                if len(item.members) > 1:
                    draw_curve(upper, curve.grid, _show(curve.on_grid, phase=phase), drawn.colour, 0.35 * CURVE_PT)
                    continue
                good = np.flatnonzero(line.usable)[:: max(1, -(-line.size // _MARKS))]
                draw_points(upper, line.frequency[good], _show(line.value[good], phase=phase), drawn.colour, 0.9 * POINT_PT, marker=drawn.marker)  # fmt: skip
            shown = turn if phase else np.exp(log)
            draw_curve(upper, grid, shown, drawn.colour)
            names.append((float(shown[-1]), f"{drawn.sign} {item.name}", drawn.colour, True))
        off = _draw_difference(lower, x, items, means, phase=phase)
        name_curves(upper, names)
        if not off:
            write_note(lower, 0.03, 0.85, "no frequencies in common with the first")
    return figure


def _draw_difference(
    axes: Axes, x: Scale, items: Sequence[Overlaid], means: Sequence[tuple[Float, ...]], *, phase: bool
) -> bool:
    """How far each item is off the first where both were measured; false where nothing is in common."""
    courses: list[tuple[int, Float, Float, Float, Float]] = []
    for i in range(1, len(items)):
        low, high = max(items[0].reach[0], items[i].reach[0]), min(items[0].reach[1], items[i].reach[1])
        if low >= high:
            continue
        grid = np.geomspace(low, high, _GRID)
        first, other = items[0].mean(grid), items[i].mean(grid)
        if phase:
            value, sd = other[1] - first[1], np.hypot(other[3], first[3])
            courses.append((i, grid, value, value - 1.96 * sd, value + 1.96 * sd))
        else:
            value, sd = other[0] - first[0], np.hypot(other[2], first[2])
            off, low_off, high_off = (100 * np.expm1(v) for v in (value, value - 1.96 * sd, value + 1.96 * sd))
            courses.append((i, grid, off, low_off, high_off))
    shown = [v for _, _, *three in courses for v in three]
    title = f"Phase less that of {items[0].name}, degrees" if phase else f"|k| over that of {items[0].name}, %"
    y = linear(*[v for v in shown if np.isfinite(v).any()], [0.0], margin=0.12)
    scale_axes(axes, x, y, title, "Frequency, Hz", y_most=4, signed=True)
    mark_level(axes, 0.0, group(0).colour)
    for i, grid, value, lower, upper in courses:
        draw_band(axes, grid, lower, upper, group(i).colour, 0.2)
        draw_curve(axes, grid, value, group(i).colour, 0.8 * CURVE_PT)
    return bool(courses)


def _show(value: Complex, *, phase: bool) -> Float:
    return np.degrees(np.angle(value)) if phase else np.abs(value)
