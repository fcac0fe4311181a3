"""What do lives depend on, and does the regression describe them?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import BAND, INK, MODEL, RULE, SECOND, Group
from reports.figures.panel import WIDE, Drawing, Panel, note
from reports.figures.picture import pictured
from reports.figures.scale import Scale, linear, logarithmic, symmetric
from reports.names import short
from schemas.arrays import Bool, Float
from schemas.numbers import bounds, significant

_ROW = 26.0
_Z = 1.96
"""Standard deviations on either side within which 95 % of right residuals lie."""


@dataclass(frozen=True)
class StressLine:
    """Median life over a stress at m points with limits, and the medians of the groups tested there."""

    name: str
    drawn: Group
    stress: Float
    life: Float
    lower: Float
    upper: Float
    extrapolated: Bool
    tested: Float
    tested_life: Float


@pictured("against-stress")
def against_stress(lines: Sequence[StressLine], title: str, unit: str, *, log: bool, alt: str) -> Drawing:
    """Median life over a stress: dashed and named where nothing was tested, dots where groups were."""
    drawing = Drawing(WIDE, 330)
    every = np.concatenate([line.stress for line in lines])
    x = logarithmic(every, margin=0.02) if log else linear(every, margin=0.02)
    y = logarithmic(*(line.life for line in lines), *(line.tested_life for line in lines), margin=0.08)
    panel = Panel(drawing, 60, 26, 300, 248, x, y)
    outside = np.concatenate([line.stress[line.extrapolated] for line in lines])
    for side in (outside[outside < np.min(every[_inside(lines)])], outside[outside > np.max(every[_inside(lines)])]):
        if side.size:
            low, high = (side.min(), _next(every, side.max())) if side[0] < every.max() else (side.min(), side.max())
            panel.column(float(low), float(high))
            # In the corner that lines leave free: below them where lives become shorter along the axis.
            is_falling = lines[0].life[0] > lines[0].life[-1]
            y_of_note = panel.bottom - 20 if is_falling == (side[0] < np.min(every[_inside(lines)])) else panel.top + 12
            note(drawing, float(panel.px(low)) + 5, y_of_note, "not tested:\nextrapolated")
    entries = []
    for line in lines:
        panel.band(line.stress, line.lower, line.upper, line.drawn.colour, ".13")
        known = np.where(line.extrapolated, np.nan, line.life)
        beyond = np.where(line.extrapolated | np.roll(line.extrapolated, 1), line.life, np.nan)
        panel.curve(line.stress, known, line.drawn.colour, 2.0, dash=line.drawn.dash)
        panel.curve(line.stress, beyond, line.drawn.colour, 1.6, dash="2 4" if line.drawn.dash else "5 4")
        panel.dots(line.tested, line.tested_life, line.drawn.colour, 6.4, marker=line.drawn.marker)
        entries.append((float(line.life[-1]), short(line.name, 18), line.drawn.colour, True))
    panel.names(entries)
    panel.axes(f"Median life, {unit}", title, y_most=6)
    return drawing.told(alt)


def _inside(lines: Sequence[StressLine]) -> Bool:
    return ~np.concatenate([line.extrapolated for line in lines])


def _next(values: Float, above: float) -> float:
    """The smallest of the values that is larger than one of them."""
    larger = values[values > above * (1 + 1e-12)]
    return float(larger.min()) if larger.size else float(above)


@dataclass(frozen=True)
class Effect:
    """One covariate: `label`, over which contrast, the factor of life with limits, and the same by Cox's model."""

    label: str
    contrast: str
    factor: float
    low: float
    high: float
    by_cox: tuple[float, float, float] | None = None


@pictured("effects")
def forest(rows: Sequence[Effect], *, alt: str) -> Drawing:
    """How many times as long lives are over the contrast of each covariate, filled; what Cox's model says, open."""
    height = 2 * _ROW * len(rows)
    drawing = Drawing(WIDE, 84 + height)
    ends = [v for r in rows for v in (r.low, r.high, 1.0, *(r.by_cox[1:] if r.by_cox else ())) if 1e-9 < v < 1e9]
    panel = Panel(drawing, 176, 26, 164, height, logarithmic(ends, margin=0.06), Scale(len(rows) - 0.5, -0.5))
    one = float(panel.px(1.0))
    drawing.line([(one, panel.top), (one, panel.bottom)], RULE, 1.0)
    panel.axes("", "Life multiplied by", y_ticks=[], x_most=5)
    for i, row in enumerate(rows):
        y = float(panel.py(i - 0.1 if row.by_cox else i))
        _bar(panel, y, row.low, row.high, row.factor, INK)
        label_y = float(panel.py(i))
        drawing.write(panel.left - 10, label_y - 3, short(row.label, 22), size=11.3, anchor="end", bold=True)
        note(drawing, panel.left - 10, label_y + 11, short(row.contrast, 28), anchor="end")
        drawing.write(panel.right + 12, label_y + 4, f"× {bounds(row.factor, row.low, row.high)}", size=11.3)
        if row.by_cox:
            _bar(panel, float(panel.py(i + 0.22)), *row.by_cox[1:], row.by_cox[0], MODEL, open_=True)
    if any(row.by_cox for row in rows):
        note(drawing, panel.left - 10, panel.bottom + 17, "open: by Cox’s model", MODEL, anchor="end")
    return drawing.told(alt)


def _bar(panel: Panel, y: float, low: float, high: float, centre: float, colour: str, *, open_: bool = False) -> None:
    left, right = np.clip(panel.px([max(low, 1e-300), high]), panel.left, panel.right).tolist()
    panel.drawing.line([(left, y), (right, y)], colour, 1.6)
    place = float(panel.px(centre))
    if panel.left <= place <= panel.right:
        panel.drawing.marks([(place, y)], "circle", colour, 6.6, open_=open_)


@dataclass(frozen=True)
class Limits:
    """An interval: `label`, what it is of in a few words, the value and its limits."""

    label: str
    words: str
    value: float
    low: float
    high: float


@pictured("intervals")
def intervals(rows: Sequence[Limits], title: str, *, alt: str) -> Drawing:
    """Intervals of one number below each other, on a logarithmic axis."""
    height = 1.5 * _ROW * len(rows)
    drawing = Drawing(WIDE, 84 + height)
    x = logarithmic([v for r in rows for v in (r.low, r.high)], margin=0.08)
    panel = Panel(drawing, 150, 26, 270, height, x, Scale(len(rows) - 0.5, -0.5))
    panel.axes("", title, y_ticks=[], x_most=5)
    for i, row in enumerate(rows):
        y = float(panel.py(i))
        _bar(panel, y, row.low, row.high, row.value, INK)
        drawing.write(panel.left - 10, y - 1, short(row.label, 24), size=11.3, anchor="end", bold=True)
        note(drawing, panel.left - 10, y + 12, short(row.words, 26), anchor="end")
        drawing.write(panel.right + 12, y + 4, f"× {significant(row.high / row.low)}", size=11.3)
    return drawing.told(alt)


@pictured("cox-snell")
def cox_snell(residual: Float, observed: Float, failed: Bool, *, alt: str) -> Drawing:
    """Cumulative hazard of the residuals against themselves: on the line, within the band, where the model is right."""
    drawing = Drawing(WIDE, 330)
    order = np.argsort(residual, kind="stable")
    residual, observed, failed = residual[order], observed[order], failed[order]
    kept = failed & (residual > 0) & (observed > 0)
    scale = logarithmic(residual[kept], observed[kept], margin=0.06)
    panel = Panel(drawing, 60, 26, 300, 248, scale, scale)
    ends = np.array([scale.low, scale.high])
    count = np.cumsum(kept)[kept]
    spread = np.exp(_Z / np.sqrt(count))
    panel.band(residual[kept], residual[kept] / spread, residual[kept] * spread, SECOND, ".13")
    panel.curve(ends, ends, SECOND, 1.2)
    panel.dots(residual[kept], observed[kept], INK, 4.6)
    panel.axes("Observed cumulative hazard", "Cox–Snell residual: hazard by the regression", y_most=6, x_most=6)
    return drawing.told(alt)


@dataclass(frozen=True)
class Strip:
    """Deviance residuals of a group of equal conditions; open where nobody knows how long it would have lived."""

    name: str
    deviance: Float
    failed: Bool


@pictured("deviances")
def deviances(strips: Sequence[Strip], *, alt: str) -> Drawing:
    """Deviance residuals by conditions: a group that stands off zero does not follow the regression."""
    height = max(20.0, min(34.0, 240.0 / max(len(strips), 1))) * len(strips)
    drawing = Drawing(WIDE, 82 + height)
    panel = Panel(drawing, 190, 26, 270, height, symmetric(3.6), Scale(len(strips) - 0.5, -0.5))
    left, right = panel.px([-_Z, _Z]).tolist()
    drawing.box(left, panel.top, right - left, panel.height, BAND)
    zero = float(panel.px(0.0))
    drawing.line([(zero, panel.top), (zero, panel.bottom)], RULE, 1.0)
    panel.axes("", "Deviance residual, SD: early failures right", y_ticks=[], x_ticks=(-3, -2, -1, 0, 1, 2, 3))
    for i, strip in enumerate(strips):
        drawing.write(panel.left - 10, float(panel.py(i)) + 4, short(strip.name, 30), size=10.7, anchor="end")
        values = np.clip(strip.deviance, -3.5, 3.5)
        place = i + 0.24 * np.sin(2.4 * np.arange(values.size))
        for mask, open_ in ((strip.failed, False), (~strip.failed, True)):
            panel.dots(values[mask], place[mask], INK, 4.2, open_=open_)
    return drawing.told(alt)


@dataclass(frozen=True)
class Incidence:
    """Probability of having failed by a cause at k times in a group, with limits."""

    cause: str
    drawn: Group
    time: Float
    probability: Float
    lower: Float
    upper: Float


@pictured("incidence")
def incidence(groups: Sequence[tuple[str, Sequence[Incidence]]], time_title: str, *, alt: str) -> Drawing:
    """Cumulative incidence of each cause, a panel per group on the same axes."""
    height = 206.0 if len(groups) == 1 else 120.0
    drawing = Drawing(WIDE, 34 + (height + 28) * len(groups) + 34)
    end = max(float(one.time.max()) for _, causes in groups for one in causes)
    x, y = Scale(0.0, end * 1.02), Scale(0.0, 105.0)
    for k, (name, causes) in enumerate(groups):
        panel = Panel(drawing, 60, 26 + k * (height + 28), 310, height, x, y)
        entries = []
        for one in causes:
            time = np.concatenate(([0.0], one.time, [end]))
            share = 100 * np.concatenate(([0.0], one.probability, one.probability[-1:]))
            low = 100 * np.concatenate(([0.0], one.lower, one.lower[-1:]))
            high = 100 * np.concatenate(([0.0], one.upper, one.upper[-1:]))
            panel.band(time, low, high, one.drawn.colour, ".13", steps=True)
            panel.steps(time, share, one.drawn.colour, 2.0, dash=one.drawn.dash)
            entries.append((float(share[-1]), short(one.cause, 14), one.drawn.colour, True))
        panel.names(entries)
        last = k == len(groups) - 1
        title = "Failed by the cause, %" if len(groups) == 1 else f"{short(name, 40)}: failed by the cause, %"
        panel.axes(title, time_title if last else "", y_ticks=(0, 25, 50, 75, 100), x_labels=last, title_left=4)
    return drawing.told(alt)
