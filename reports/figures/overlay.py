"""Several specimens or batches in one figure: stiffness and phase of each, and how far each is off the first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import group
from reports.figures.panel import WIDE, Drawing, Panel, note
from reports.figures.paper import DOUBLE
from reports.figures.picture import pictured
from reports.figures.responses import Curve, Lines
from reports.figures.scale import Scale, linear, logarithmic
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


@pictured("overlay", column=DOUBLE)
def overlay(items: Sequence[Overlaid], *, alt: str) -> Drawing:
    """Dynamic stiffness and phase of several items, and below how far each is off the first, with 95 % bands."""
    drawing = Drawing(WIDE, 374, parts=2)
    lines = [line for item in items for line, _ in item.members]
    x = logarithmic(*(line.frequency for line in lines), margin=0.015)
    for part, phase in enumerate((False, True)):
        drawing.begin_part(part)
        values = [_show(line.value[line.usable], phase=phase) for line in lines]
        y = linear(*values, [0.0], margin=0.08) if phase else logarithmic(*values, margin=0.06)
        upper = Panel(drawing, 46, 24, 332, 186, x, y)
        upper.axes("Phase of k, degrees" if phase else "Dynamic stiffness |k|, N/mm", x_labels=False)
        names = []
        for i, item in enumerate(items):
            drawn = group(i)
            for line, curve in item.members:
                if len(item.members) > 1:
                    upper.curve(curve.grid, _show(curve.on_grid, phase=phase), drawn.colour, 0.7, dash=drawn.dash)
                    continue
                good = np.flatnonzero(line.usable)[:: max(1, -(-line.size // _MARKS))]
                shown = _show(line.value[good], phase=phase)
                upper.dots(line.frequency[good], shown, drawn.colour, 4.2, marker=drawn.marker)
            grid = np.geomspace(*item.reach, _GRID)
            log, turn, *_ = item.mean(grid)
            course = turn if phase else np.exp(log)
            upper.curve(grid, course, drawn.colour, dash=drawn.dash)
            names.append((float(course[-1]), f"{drawn.sign} {item.name}", drawn.colour, True))
        upper.names(names)
        _draw_difference(drawing, x, items, phase=phase)
    return drawing.told(alt)


def _draw_difference(drawing: Drawing, x: Scale, items: Sequence[Overlaid], *, phase: bool) -> None:
    """How far each item is off the first where both were measured; says so where nothing is in common."""
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
    panel = Panel(drawing, 46, 240, 332, 88, x, y)
    panel.axes(title, "Frequency, Hz", y_most=4, signed=True)
    panel.level(0.0, group(0).colour)
    for i, grid, value, lower, upper in courses:
        panel.band(grid, lower, upper, group(i).colour, ".2")
        panel.curve(grid, value, group(i).colour, 1.7, dash=group(i).dash)
    if not courses:
        note(drawing, panel.left + 8, panel.top + 14, "no frequencies in common with the first")


def _show(value: Complex, *, phase: bool) -> Float:
    return np.degrees(np.angle(value)) if phase else np.abs(value)
