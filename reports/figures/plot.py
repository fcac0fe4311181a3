"""Panels: axes with scales and ticks, and data in them. No grid, no frame, no legend: names stand at the curves.

Which data answer which question is decided in `reports.figures`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from reports.figures.palette import BAND, INK, RULE, SECOND
from reports.figures.svg import TICKS, Drawing, Plot, Series
from schemas.arrays import Bool, Float
from schemas.numbers import NBSP, compact, fixed

WIDE, NARROW = 480.0, 227.0
"""Widths of a figure in px: one of a pair, one of small multiples."""


_LEAST, _DECADES = 1e-290, 1e-30
"""What is smaller, by itself or against the largest value of a logarithmic axis, counts as nothing."""


@dataclass(frozen=True)
class Scale:
    """An axis from `low` to `high`, linear or logarithmic."""

    low: float
    high: float
    log: bool = False

    def share(self, values: ArrayLike) -> Float:
        """Position of values along the axis: 0 at `low`, 1 at `high`. NaN where a logarithm does not exist."""
        data = np.asarray(values, dtype=float)
        if not self.log:
            return np.asarray((data - self.low) / (self.high - self.low))
        with np.errstate(divide="ignore", invalid="ignore"):
            positive = np.log(np.where(data > 0, data, np.nan))
        return np.asarray((positive - math.log(self.low)) / math.log(self.high / self.low))

    def ticks(self, most: int = 6) -> tuple[list[float], list[float]]:
        """Labelled and unlabelled ticks: 1, 2, 5 and their powers of ten."""
        return _log_ticks(self.low, self.high, most) if self.log else (_linear_ticks(self.low, self.high, most), [])


def linear(*data: ArrayLike, zero: bool = False, margin: float = 0.06) -> Scale:
    """A linear scale around all finite data, from 0 on if asked."""
    values = _finite(*data)
    if not values.size:
        return Scale(0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    if high - low <= max(1e-12 * max(abs(low), abs(high)), _LEAST):
        pad = abs(high) * 0.1 if abs(high) > _LEAST else 1.0
        return Scale(low - pad, high + pad)
    pad = margin * (high - low)
    return Scale(low if zero and low == 0 else low - pad, high if zero and high == 0 else high + pad)


def logarithmic(*data: ArrayLike, margin: float = 0.05) -> Scale:
    """A logarithmic scale around all positive data."""
    values = _finite(*data)
    values = values[values > max(_LEAST, _DECADES * values.max(initial=0.0))]
    if not values.size:
        return Scale(0.1, 10.0, log=True)
    low, high = float(values.min()), float(values.max())
    if high < 1.3 * low:
        middle = math.sqrt(low * high)
        low, high = min(low, middle / 1.6), max(high, middle * 1.6)
    factor = (high / low) ** margin
    return Scale(low / factor, high * factor, log=True)


def symmetric(limit: float) -> Scale:
    """A linear scale around zero."""
    return Scale(-limit, limit)


def _finite(*data: ArrayLike) -> Float:
    parts = [np.asarray(d, dtype=float).ravel() for d in data]
    values = np.concatenate(parts) if parts else np.empty(0)
    return values[np.isfinite(values)]


def _linear_ticks(low: float, high: float, most: int) -> list[float]:
    raw = (high - low) / max(1, most)
    decade = 10.0 ** math.floor(math.log10(raw))
    step = next(s * decade for s in (1, 2, 5, 10) if s * decade >= raw * (1 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [round(i * step, 12) for i in range(first, math.floor(high / step + 1e-9) + 1)]


def _log_ticks(low: float, high: float, most: int) -> tuple[list[float], list[float]]:
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    inside = [
        (m, m * 10.0**e)
        for e in range(first, last + 1)
        for m in range(1, 10)
        if low * (1 - 1e-9) <= m * 10.0**e <= high * (1 + 1e-9)
    ]
    every = [v for _, v in inside]
    for chosen in ((1, 2, 3, 4, 5, 6, 8), (1, 2, 5), (1, 3), (1,)):
        labelled = [v for m, v in inside if m in chosen]
        if len(labelled) <= most:
            break
    decades = [v for m, v in inside if m == 1]
    while len(labelled) > most:
        labelled = labelled[:: math.ceil(len(labelled) / most)]
    minor = every if len(decades) <= 4 else decades
    return labelled, [v for v in minor if v not in labelled]


def nice(value: float) -> float:
    """The largest of 1, 2, 5 and their powers of ten that is not above `value`."""
    decade = 10.0 ** math.floor(math.log10(value))
    return max(s * decade for s in (1, 2, 5) if s * decade <= value * (1 + 1e-9))


def tick_text(value: float) -> str:
    """`0.01`, `5`, `20 000`, `10⁻⁶`."""
    if value == 0:
        return "0"
    size = math.log10(abs(value))
    if size >= 6 or size < -4:
        digits = next(
            d for d in range(3, 17) if d == 16 or abs(float(f"{value:.{d - 1}e}") - value) <= 1e-11 * abs(value)
        )
        text = compact(value, digits)
        return text.removeprefix(f"1{NBSP}×{NBSP}")
    places = max(0, -math.floor(size + 1e-9))
    while places < 10 and abs(round(value, places) - value) > 1e-11 * abs(value):
        places += 1
    return fixed(value, places)


class Panel:
    """One pair of axes in a drawing, its inner area given in px."""

    def __init__(
        self, drawing: Drawing, left: float, top: float, width: float, height: float, x: Scale, y: Scale
    ) -> None:
        self.drawing = drawing
        self.left, self.top, self.width, self.height = left, top, width, height
        self.x, self.y = x, y
        self._clip = drawing.clip(left - 3, top - 3, width + 6, height + 6)
        self.plot = Plot((left, top, width, height), (x.low, x.high, x.log), (y.low, y.high, y.log))
        drawing.plots.append(self.plot)

    @property
    def right(self) -> float:
        return self.left + self.width

    @property
    def bottom(self) -> float:
        return self.top + self.height

    def px(self, values: ArrayLike) -> Float:
        """Horizontal positions in px."""
        return np.asarray(self.left + self.width * self.x.share(values))

    def py(self, values: ArrayLike) -> Float:
        """Vertical positions in px, downwards."""
        return np.asarray(self.top + self.height * (1 - self.y.share(values)))

    def _keep(
        self,
        kind: str,
        x: ArrayLike,
        y: ArrayLike,
        colour: str,
        width: float = 0.0,
        dash: str | None = None,
        *,
        open_: bool = False,
    ) -> None:
        """Keeps values for who asks the figure: what is drawn, in the units of the axes."""
        across, up = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        self.plot.series.append(Series(kind, across.ravel(), up.ravel(), colour, width, dash, open_))

    def _points(self, x: ArrayLike, y: ArrayLike) -> list[tuple[float, float]]:
        h, v = np.broadcast_arrays(self.px(x), self.py(y))
        fits = np.isfinite(h) & np.isfinite(v)
        return list(zip(h[fits].tolist(), v[fits].tolist(), strict=True))

    def axes(
        self,
        title: str = "",
        x_title: str = "",
        *,
        x_labels: bool = True,
        x_most: int = 8,
        y_most: int = 5,
        x_ticks: Sequence[float] | None = None,
        y_ticks: Sequence[float] | None = None,
        signed: bool = False,
        size: float = TICKS,
        title_left: float | None = None,
    ) -> None:
        """Left and lower axis with ticks; the y quantity with its unit is the title, top left."""
        drawing = self.drawing
        self.plot.x_title, self.plot.y_title = x_title, title
        xs, x_minor = (list(x_ticks), []) if x_ticks is not None else self.x.ticks(x_most)
        ys, y_minor = (list(y_ticks), []) if y_ticks is not None else self.y.ticks(y_most)
        drawing.line([(self.left, self.top), (self.left, self.bottom), (self.right, self.bottom)], SECOND, 0.95)
        base = self.bottom
        drawing.segments([(p, base, p, base + 4.5) for p in self.px(xs).tolist()], SECOND)
        drawing.segments([(p, base, p, base + 2.7) for p in self.px(x_minor).tolist()], SECOND, 0.8)
        drawing.segments([(self.left - 4.5, p, self.left, p) for p in self.py(ys).tolist()], SECOND)
        drawing.segments([(self.left - 2.7, p, self.left, p) for p in self.py(y_minor).tolist()], SECOND, 0.8)
        if x_labels:
            for value, p in zip(xs, self.px(xs).tolist(), strict=True):
                drawing.text(p, base + 6 + size, tick_text(value), size=size, colour=SECOND, anchor="middle")
        for value, p in zip(ys, self.py(ys).tolist(), strict=True):
            text = ("+" if signed and value > 0 else "") + tick_text(value)
            drawing.text(self.left - 7, p + 0.36 * size, text, size=size, colour=SECOND, anchor="end")
        if title:
            drawing.text(self.left if title_left is None else title_left, self.top - 8, title)
        if x_title:
            drawing.text(self.left + self.width / 2, base + 24 + size, x_title, anchor="middle")

    def curve(self, x: ArrayLike, y: ArrayLike, colour: str, width: float = 2.1, *, dash: str | None = None) -> None:
        """A line; a NaN interrupts it."""
        self._keep("c", x, y, colour, width, dash)
        h, v = self.px(x), self.py(y)
        limit = 8 * self.height
        v = np.clip(v, self.top - limit, self.bottom + limit)
        for part in _runs(np.isfinite(h) & np.isfinite(v)):
            points = list(zip(h[part].tolist(), v[part].tolist(), strict=True))
            self.drawing.line(points, colour, width, dash=dash, clip=self._clip)

    def steps(self, x: ArrayLike, y: ArrayLike, colour: str, width: float = 2.1) -> None:
        """A step line: the value holds until the next x."""
        self._keep("t", x, y, colour, width)
        corners = self._points(x, y)
        points = corners[:1]
        for (_, before), (p, after) in itertools.pairwise(corners):
            points += [(p, before), (p, after)]
        self.drawing.line(points, colour, width, clip=self._clip)

    def band(
        self, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, opacity: str = ".18", *, steps: bool = False
    ) -> None:
        """A shaded band between two curves; where either is NaN there is none."""
        h = self.px(x)
        a, b = self.py(low), self.py(high)
        for part in _runs(np.isfinite(h) & np.isfinite(a) & np.isfinite(b)):
            p, lower, upper = h[part], a[part], b[part]
            if steps:
                following = part.stop if part.stop < h.size else part.stop - 1
                p = np.append(np.repeat(p, 2)[1:], h[following])
                lower, upper = np.repeat(lower, 2), np.repeat(upper, 2)
            there = list(zip(p.tolist(), upper.tolist(), strict=True))
            back = list(zip(p[::-1].tolist(), lower[::-1].tolist(), strict=True))
            self.drawing.area(there + back, colour, opacity=opacity, clip=self._clip)

    def area(self, points: Sequence[tuple[float, float]], colour: str, opacity: str = ".18") -> None:
        """A shaded area around points in px, cut at the edges of the axes."""
        self.drawing.area(points, colour, opacity=opacity, clip=self._clip)

    def dots(
        self, x: ArrayLike, y: ArrayLike, colour: str, size: float = 4.2, *, marker: str = "circle", open_: bool = False
    ) -> None:
        """Marks at the points that lie inside the axes."""
        self._keep("d", x, y, colour, open_=open_)
        points = [p for p in self._points(x, y) if self._inside(*p)]
        self.drawing.marks(points, marker, colour, size, open_=open_)

    def held(self, x: ArrayLike, y: ArrayLike, colour: str, size: float = 4.2, *, open_: bool = False) -> None:
        """Marks, and triangles at the edge for those that lie above or below: none is cut off in silence."""
        values = np.asarray(y, dtype=float)
        self.dots(x, values, colour, size, open_=open_)
        places = np.broadcast_to(np.asarray(x, dtype=float), values.shape)
        for beyond, edge, marker in (
            (values > self.y.high, self.y.high, "triangle"),
            (values < self.y.low, self.y.low, "down"),
        ):
            points = self._points(places[beyond], np.full(int(beyond.sum()), edge))
            self.drawing.marks(points, marker, colour, size * 1.1, open_=open_)

    def _inside(self, x: float, y: float) -> bool:
        return self.left - 2 <= x <= self.right + 2 and self.top - 2 <= y <= self.bottom + 2

    def bars(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, width: float = 1.1) -> None:
        """Vertical error bars, cut at the edges of the axes."""
        h, a, b = self.px(x), self.py(low), self.py(high)
        a = np.where(np.isnan(a), self.bottom, a)
        fits = np.isfinite(h) & np.isfinite(b) & (np.maximum(a, b) >= self.top) & (np.minimum(a, b) <= self.bottom)
        a, b = np.clip(a, self.top, self.bottom), np.clip(b, self.top, self.bottom)
        rows = zip(h[fits].tolist(), a[fits].tolist(), h[fits].tolist(), b[fits].tolist(), strict=True)
        self.drawing.segments(rows, colour, width)

    def level(self, y: float, colour: str = SECOND, width: float = 0.8, *, dash: str | None = None) -> None:
        """A horizontal line across the panel."""
        p = float(self.py(y))
        self.drawing.line([(self.left, p), (self.right, p)], colour, width, dash=dash)

    def across(self, low: float, high: float, colour: str = BAND) -> None:
        """A horizontal stripe between two y values."""
        top, bottom = np.clip(self.py([high, low]), self.top, self.bottom).tolist()
        self.drawing.box(self.left, top, self.width, bottom - top, colour)

    def column(self, low: float, high: float, colour: str = BAND) -> None:
        """A vertical stripe between two x values."""
        left, right = np.clip(self.px([low, high]), self.left, self.right).tolist()
        self.drawing.box(left, self.top, max(right - left, 1.5), self.height, colour)

    def label(
        self,
        x: float,
        y: float,
        text: str,
        colour: str = INK,
        *,
        anchor: str | None = None,
        bold: bool = False,
        size: float = 12.0,
        dx: float = 0.0,
        dy: float = 4.0,
    ) -> None:
        """Text at a point in data coordinates, moved by (dx, dy) px; lines are separated by a line feed."""
        h, v = float(self.px(x)) + dx, float(self.py(y)) + dy
        for i, line in enumerate(text.split("\n")):
            self.drawing.text(h, v + 1.2 * size * i, line, colour=colour, anchor=anchor, bold=bold, size=size)

    def names(self, entries: Sequence[tuple[float, str, str, bool]], *, gap: float = 14.5, dx: float = 6.0) -> None:
        """Names (y value, text, colour, bold) right of the panel at the curves' ends, pushed apart where they meet."""
        kept = [e for e in entries if math.isfinite(float(self.py(e[0])))]
        order = sorted(range(len(kept)), key=lambda i: float(self.py(kept[i][0])))
        wanted = [min(max(float(self.py(kept[i][0])), self.top), self.bottom) for i in order]
        for i, place in zip(order, apart(wanted, gap, self.top - 4, self.bottom + 6), strict=True):
            value, text, colour, bold = kept[i]
            self.plot.names.append((value, text, colour))
            self.drawing.text(self.right + dx, place + 4, text, colour=colour, bold=bold)


def apart(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Ascending positions at least `gap` from each other, as near to the wanted ones as a simple push gives."""
    placed: list[float] = []
    for want in wanted:
        placed.append(max(want, placed[-1] + gap) if placed else max(want, low))
    overflow = placed[-1] - high if placed else 0.0
    if overflow > 0:
        for i in reversed(range(len(placed))):
            ceiling = placed[i + 1] - gap if i + 1 < len(placed) else high
            placed[i] = min(placed[i], ceiling)
    return placed


def _runs(mask: Bool) -> list[slice]:
    """Slices of the stretches in which the mask (n,) is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(np.int8), [0]])))
    return [slice(a, b) for a, b in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)]


def note(drawing: Drawing, x: float, y: float, text: str, colour: str = SECOND, *, anchor: str | None = None) -> None:
    """Small text in px coordinates; lines are separated by a line feed."""
    for i, line in enumerate(text.split("\n")):
        drawing.text(x, y + 13 * i, line, size=10.7, colour=colour, anchor=anchor)


def pointer(drawing: Drawing, start: tuple[float, float], end: tuple[float, float], colour: str = RULE) -> None:
    """A thin line from a name to its curve, in px."""
    drawing.line([start, end], colour, 0.8)
