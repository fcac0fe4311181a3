"""Figures by matplotlib in the look of the house: a drawing laid out in px, panels of axes in it, names at the curves.

A drawing lays out a `matplotlib.figure.Figure`, its panels are real axes with the data in their own units: what a page shows can
be changed and saved in a notebook. No grid, no frame, no legend. Nothing here reads or changes the state of pyplot. The layout
is that of the page; for print the same drawing is made as wide as a column, its panels take what the text beside them leaves.
Which data answer which question is decided in `reports.figures`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reports.figures import artists
from reports.figures.palette import BAND, INK, RULE, SECOND
from reports.figures.scale import Scale, apart, tick_text
from schemas.arrays import Bool, Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

WIDE, NARROW = 480.0, 227.0
"""Widths of a figure in px: one of a pair, one of small multiples."""
TEXT, TICKS = 12.0, 11.3
"""Sizes of text and of tick labels, in px."""

Points = Sequence[tuple[float, float]]

_STYLE: Mapping[str, Any] = {
    "font.family": ["DejaVu Sans"],
    "text.color": INK,
    "text.parse_math": False,  # a name with a dollar sign is a name
    "axes.edgecolor": SECOND,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.color": SECOND,
    "ytick.color": SECOND,
    "lines.solid_capstyle": "butt",
    "lines.solid_joinstyle": "round",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "pdf.fonttype": 42,  # TrueType, embedded: journals refuse type 3
    "svg.fonttype": "none",  # text stays text
    "svg.hashsalt": "dealab",
}
_BEHIND, _UNDER, _AXES, _OVER, _WORDS = -2.0, -1.0, 1.0, 2.0, 3.0
"""Order from back to front: boxes and pictures, lines, axes with their data, marks, text."""


_STYLED: ContextVar[bool] = ContextVar("_STYLED", default=False)


@contextmanager
def styled() -> Iterator[None]:
    """Within it, what is drawn or written has the style of the house; the style of the caller comes back after it."""
    if _STYLED.get():
        yield
        return
    token = _STYLED.set(True)
    try:
        with artists.rc_context():
            dict.update(artists.rcParams, _house_style())  # checked once: to check it again takes a tenth of a figure
            yield
    finally:
        _STYLED.reset(token)


@cache
def _house_style() -> dict[str, Any]:
    """All parameters of matplotlib as the house has them, but for its backend, which is nobody's style."""
    with artists.rc_context():
        artists.rcParams.update(artists.rcParamsDefault)
        artists.rcParams.update(_STYLE)
        return {key: value for key, value in dict.items(artists.rcParams) if key != "backend"}


@dataclass(frozen=True)
class Sheet:
    """What a drawing is made for: points per px of its layout, its width in px or that of the layout, and room beside panels, px."""

    unit: float = 0.75
    width: float | None = None
    left: float = 0.0
    right: float = 0.0


PAGE = Sheet()
SHEET: ContextVar[Sheet] = ContextVar("SHEET", default=PAGE)
"""What is drawn for at the moment; `on_sheet` sets it."""


@contextmanager
def on_sheet(sheet: Sheet) -> Iterator[None]:
    """Within it, drawings are made for that sheet."""
    token = SHEET.set(sheet)
    try:
        yield
    finally:
        SHEET.reset(token)


@dataclass(frozen=True)
class Series:
    """Values that a panel shows: `kind` is d (dots), c (a curve) or t (steps); x and y (n,) in the units of its axes."""

    kind: str
    x: Float
    y: Float
    colour: str
    width: float = 0.0
    dash: str | None = None
    open_: bool = False


@dataclass
class Plot:
    """What a panel holds: its place (left, top, width, height) in px, its axes (low, high, logarithmic), titles and values."""

    box: tuple[float, float, float, float]
    x: tuple[float, float, bool]
    y: tuple[float, float, bool]
    x_title: str = ""
    y_title: str = ""
    series: list[Series] = field(default_factory=list)
    names: list[tuple[float, str, str]] = field(default_factory=list)


class Drawing:
    """A `figure` of `width` × `height` px of layout; y counts downwards from the top, as on a page.

    Of several parts of that size each has its own place: side by side where the sheet is wide enough, else below each other.
    """

    def __init__(self, width: float, height: float, *, parts: int = 1) -> None:
        sheet = SHEET.get()
        self.sheet, self.unit, self._drawn_for = sheet, sheet.unit, width
        self.width = sheet.width or width
        abreast = self.width >= _ABREAST * parts * width
        self._part = (self.width / parts, 0.0) if abreast else (0.0, height)
        self._part_width = self.width / parts if abreast else self.width
        self._at = (0.0, 0.0)
        self.height = height if abreast else parts * height
        size = (self.width * self.unit / 72, self.height * self.unit / 72)
        self.figure = artists.Figure(figsize=size, dpi=72 / self.unit)
        self.plots: list[Plot] = []
        self.px = artists.Affine2D.from_values(1 / self.width, 0, 0, -1 / self.height, 0, 1) + self.figure.transFigure

    def begin_part(self, index: int) -> None:
        """What is placed from now on belongs to that part."""
        self._at = (self._part[0] * index, self._part[1] * index)

    def told(self, finding: str) -> Drawing:
        """The same with what it shows in words, for who cannot see it."""
        self.figure.set_label(finding)
        return self

    def place(self, left: float, top: float, width: float) -> tuple[float, float, float]:
        """Left and upper edge and width of a panel of the layout on this sheet: margins stay, the panel takes what is left."""
        more = self._part_width - self._drawn_for - self.sheet.left - self.sheet.right
        return self._at[0] + left + self.sheet.left, self._at[1] + top, max(width + more, _LEAST * width)

    def pt(self, px: float) -> float:
        """A length of the layout in points."""
        return px * self.unit

    def line(self, points: Points, colour: str, width: float = 2.1, *, dash: str | None = None) -> None:
        """A line through points in px."""
        x, y = np.asarray(points, dtype=float).T
        self.figure.add_artist(
            artists.Line2D(
                x, y, color=colour, linewidth=self.pt(width), linestyle=self.dashes(dash, width), transform=self.px, zorder=_UNDER
            )
        )  # fmt: skip

    def dashes(self, dash: str | None, width: float) -> Any:
        """A pattern of lengths in px in matplotlib's words, which counts in widths of the line."""
        return (0, [float(v) / width for v in dash.split()]) if dash else "-"

    def segments(self, pairs: Iterable[tuple[float, float, float, float]], colour: str, width: float = 0.9) -> None:
        """Separate straight lines (x1, y1, x2, y2) in px."""
        ends = [((a, b), (c, d)) for a, b, c, d in pairs]
        if ends:
            self.figure.add_artist(
                artists.LineCollection(ends, colors=colour, linewidths=self.pt(width), transform=self.px, zorder=_UNDER)
            )

    def box(self, x: float, y: float, width: float, height: float, fill: str, stroke: str | None = None) -> None:
        """A filled rectangle in px, behind everything."""
        self.figure.add_artist(
            artists.Rectangle(
                (x, y), width, height, facecolor=fill, edgecolor=stroke or "none", linewidth=self.pt(1.0) if stroke else 0.0,
                transform=self.px, zorder=_BEHIND,
            )
        )  # fmt: skip

    def write(
        self,
        x: float,
        y: float,
        content: str,
        *,
        size: float = TEXT,
        colour: str | None = None,
        anchor: str | None = None,
        bold: bool = False,
        turn: float | None = None,
    ) -> None:
        """A line of text with its base line at (x, y) px; `anchor` is `middle` or `end`; `turn` in degrees clockwise."""
        self.figure.add_artist(
            artists.Text(
                x, y, content, fontsize=self.pt(size), color=colour or INK, ha=_SIDES[anchor], va="baseline",
                fontweight="bold" if bold else "normal", rotation=-(turn or 0.0), rotation_mode="anchor",
                transform=self.px, zorder=_WORDS,
            )
        )  # fmt: skip

    def marks(self, points: Points, marker: str, colour: str, size: float = 4.2, *, open_: bool = False) -> None:
        """Marks of one kind at points in px: filled, or white with an outline."""
        if points:
            x, y = np.asarray(points, dtype=float).T
            look = self.mark(marker, colour, size, open_=open_)
            self.figure.add_artist(artists.Line2D(x, y, transform=self.px, zorder=_OVER, **look))

    def mark(self, marker: str, colour: str, size: float, *, open_: bool) -> dict[str, Any]:
        """How marks of so many px are drawn, in matplotlib's words."""
        sign, factor = _MARKERS[marker]
        outline = _OUTLINE if open_ else 0.0
        return {
            "linestyle": "none", "marker": sign, "markersize": self.pt(factor * size - outline),
            "markeredgewidth": self.pt(outline), "markeredgecolor": colour, "markerfacecolor": "white" if open_ else colour,
        }  # fmt: skip

    def picture(
        self, x: float, y: float, width: float, height: float, shade: NDArray[np.uint8], palette: NDArray[np.uint8]
    ) -> None:
        """A picture of (rows, columns) indices into a palette (n, 3), its cells as sharp as they are."""
        box = artists.TransformedBbox(artists.Bbox.from_bounds(x, y + height, width, -height), self.px)
        image = artists.BboxImage(box, interpolation="none", zorder=_BEHIND, origin="upper")
        image.set_data(palette[shade])
        self.figure.add_artist(image)

    def overhang(self, renderer: Any) -> tuple[float, float]:
        """How far text beside panels reaches over the left and the right edge of its part, px of layout."""
        self.figure.draw_without_rendering()
        above = {axes.get_title(loc="left") for axes in self.figure.axes}
        scale = self.figure.dpi * self.unit / 72
        left = right = 0.0
        for text in self.figure.findobj(artists.Text):
            if text.get_visible() and text.get_text() not in above:
                box = text.get_window_extent(renderer)
                middle = (box.x0 + box.x1) / 2 / scale
                start = self._part_width * min(int(middle / self._part_width), round(self.width / self._part_width) - 1)
                left = max(left, start - box.x0 / scale)
                right = max(right, box.x1 / scale - start - self._part_width)
        return left, right


_ABREAST = 0.85
"""Parts stand side by side on a sheet that has so much of the width that they were laid out for."""
_LEAST = 0.4
"""A panel keeps at least so much of its width, however long the text beside it."""
_SIDES = {None: "left", "middle": "center", "end": "right"}
_OUTLINE = 1.2
_MARKERS = {
    "circle": ("o", 1.0), "square": ("s", 0.9), "triangle": ("^", 1.15), "down": ("v", 1.15), "diamond": ("D", 0.95),
    "cross": ("X", 1.15), "left": ("<", 1.15), "right": (">", 1.15), "star": ("*", 1.4), "plus": ("P", 1.15), "pentagon": ("p", 1.15),
    "hexagon": ("h", 1.15),
}  # fmt: skip
"""Markers in matplotlib's words, and the factor of their size that makes them look as large as a circle."""


_TICK_WIDTH = 30.0
"""Room that the words at a tick need, px."""


class Panel:
    """One pair of axes in a drawing, its inner area given in px of the layout."""

    def __init__(
        self, drawing: Drawing, left: float, top: float, width: float, height: float, x: Scale, y: Scale
    ) -> None:
        left, top, width = drawing.place(left, top, width)
        self.drawing = drawing
        self.left, self.top, self.width, self.height = left, top, width, height
        self.x, self.y = x, y
        self.plot = Plot((left, top, width, height), (x.low, x.high, x.log), (y.low, y.high, y.log))
        drawing.plots.append(self.plot)
        across, down = drawing.width, drawing.height
        self.on: Axes = drawing.figure.add_axes(
            (left / across, 1 - (top + height) / down, width / across, height / down), zorder=_AXES, frameon=True
        )
        self.on.patch.set_visible(False)
        for axis, scale, limit in ((self.on.xaxis, x, self.on.set_xlim), (self.on.yaxis, y, self.on.set_ylim)):
            if scale.log:
                (self.on.set_xscale if axis is self.on.xaxis else self.on.set_yscale)("log")
            limit(scale.low, scale.high)
            axis.set_major_locator(artists.NullLocator())
            axis.set_minor_locator(artists.NullLocator())
        self.on.set_axis_off()
        self._drawn = 0

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
    ) -> tuple[Float, Float]:
        """Keeps values for who asks the figure: what is drawn, in the units of the axes."""
        across, up = np.broadcast_arrays(np.asarray(x, dtype=float), np.asarray(y, dtype=float))
        self.plot.series.append(Series(kind, across.ravel(), up.ravel(), colour, width, dash, open_))
        return across.ravel(), up.ravel()

    def _next(self) -> float:
        """Order among what the axes hold: each over what was there before it, all over the axes."""
        self._drawn += 1
        return 3 + 0.001 * self._drawn

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
        on, pt = self.on, self.drawing.pt
        self.plot.x_title, self.plot.y_title = x_title, title
        on.set_axis_on()
        x_most = min(x_most, int(self.width / _TICK_WIDTH))
        xs, x_minor = (list(x_ticks), []) if x_ticks is not None else self.x.ticks(x_most)
        ys, y_minor = (list(y_ticks), []) if y_ticks is not None else self.y.ticks(y_most)
        for side in ("left", "bottom"):
            on.spines[side].set_linewidth(pt(0.95))
        for axis, places, pad in ((on.xaxis, xs, 1.5 + size), (on.yaxis, ys, 2.5)):
            plus = signed and axis is on.yaxis
            words = [("+" if plus and v > 0 else "") + tick_text(v) for v in places]
            axis.set_major_locator(artists.FixedLocator(places))
            axis.set_major_formatter(artists.FixedFormatter(words))
            axis.set_tick_params(length=pt(4.5), width=pt(0.9), pad=pt(pad), labelsize=pt(size))
        on.tick_params(axis="x", labelbottom=x_labels)
        for label in on.get_xticklabels():
            label.set_verticalalignment("baseline")
        self._small_ticks(x_minor, y_minor)
        if title:
            at = 0.0 if title_left is None else (title_left - self.left) / self.width
            on.set_title(title, loc="left", x=at, y=1 + 8 / self.height, pad=0, fontsize=pt(TEXT))
        if x_title:
            on.xaxis.set_label_coords(0.5, -(24 + size) / self.height)
            on.set_xlabel(x_title, fontsize=pt(TEXT), va="baseline")

    def _small_ticks(self, x: Sequence[float], y: Sequence[float]) -> None:
        """Ticks without a label: one artist an axis, where matplotlib's own would be three for each of fifty."""
        ends = [((p, self.bottom), (p, self.bottom + 2.7)) for p in self.px(list(x)).tolist()]
        ends += [((self.left - 2.7, p), (self.left, p)) for p in self.py(list(y)).tolist()]
        if ends:
            self.on.add_collection(
                artists.LineCollection(
                    ends, colors=SECOND, linewidths=self.drawing.pt(0.8), transform=self.drawing.px, clip_on=False, zorder=2.4
                ),
                autolim=False,
            )  # fmt: skip

    def curve(self, x: ArrayLike, y: ArrayLike, colour: str, width: float = 2.1, *, dash: str | None = None) -> None:
        """A line; a NaN interrupts it."""
        across, up = self._keep("c", x, y, colour, width, dash)
        self._add(artists.Line2D(across, up, color=colour, linewidth=self.drawing.pt(width), linestyle=self.drawing.dashes(dash, width)))  # fmt: skip

    def _add(self, line: Line2D, *, clipped: bool = True) -> None:
        """A line among what the axes hold, without a look at their limits: they are set."""
        line.set_zorder(self._next())
        line.set_clip_on(clipped)
        self.on.add_artist(line)

    def steps(self, x: ArrayLike, y: ArrayLike, colour: str, width: float = 2.1, *, dash: str | None = None) -> None:
        """A step line: the value holds until the next x."""
        across, up = self._keep("t", x, y, colour, width, dash)
        self._add(artists.Line2D(across, up, color=colour, linewidth=self.drawing.pt(width), linestyle=self.drawing.dashes(dash, width), drawstyle="steps-post"))  # fmt: skip

    def band(
        self, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, opacity: str = ".18", *, steps: bool = False
    ) -> None:
        """A shaded band between two curves; where either is NaN there is none. Steps hold until the next x."""
        across, down, up = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (x, low, high)))
        if steps:
            known = np.isfinite(down) & np.isfinite(up)
            ends = ~known & np.append(False, known[:-1])
            down, up = (np.where(ends, np.append(np.nan, v[:-1]), v) for v in (down, up))
        self.on.fill_between(
            across, down, up, color=colour, alpha=float(opacity), linewidth=0, step="post" if steps else None,
            zorder=self._next() if float(opacity) < 1 else 2.2,  # what hides what is behind it lies behind the axes
        )  # fmt: skip

    def area(self, points: Sequence[tuple[float, float]], colour: str, opacity: str = ".18") -> None:
        """A shaded area around points in px, cut at the edges of the axes."""
        if len(points) > 2:
            self.on.add_artist(
                artists.Polygon(points, facecolor=colour, alpha=float(opacity), linewidth=0, transform=self.drawing.px, zorder=self._next())
            )  # fmt: skip

    def dots(
        self, x: ArrayLike, y: ArrayLike, colour: str, size: float = 4.2, *, marker: str = "circle", open_: bool = False
    ) -> None:
        """Marks at the points that lie inside the axes."""
        across, up = self._keep("d", x, y, colour, open_=open_)
        inside = self._inside(across, up)
        if inside.any():
            self._add(
                artists.Line2D(across[inside], up[inside], **self.drawing.mark(marker, colour, size, open_=open_)),
                clipped=False,
            )

    def held(self, x: ArrayLike, y: ArrayLike, colour: str, size: float = 4.2, *, open_: bool = False) -> None:
        """Marks, and triangles at the edge for those that lie above or below: none is cut off in silence."""
        values = np.asarray(y, dtype=float)
        self.dots(x, values, colour, size, open_=open_)
        places = np.broadcast_to(np.asarray(x, dtype=float), values.shape)
        for beyond, edge, marker in (
            (values > self.y.high, self.y.high, "triangle"),
            (values < self.y.low, self.y.low, "down"),
        ):
            if beyond.any():
                look = self.drawing.mark(marker, colour, size * 1.1, open_=open_)
                self._add(artists.Line2D(places[beyond], np.full(int(beyond.sum()), edge), **look), clipped=False)

    def _inside(self, x: Float, y: Float) -> Bool:
        h, v = self.px(x), self.py(y)
        with np.errstate(invalid="ignore"):
            across, down = (h >= self.left - 2) & (h <= self.right + 2), (v >= self.top - 2) & (v <= self.bottom + 2)
        return np.asarray(across & down)

    def bars(self, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, width: float = 1.1) -> None:
        """Vertical error bars, cut at the edges of the axes."""
        places, a, b = np.broadcast_arrays(*(np.asarray(v, dtype=float) for v in (x, low, high)))
        a = np.maximum(np.where(np.isnan(a), self.y.low, a), min(self.y.low, self.y.high))
        known = np.isfinite(places) & np.isfinite(b) & (b >= min(self.y.low, self.y.high))
        ends = np.full((int(known.sum()), 3, 2), np.nan)
        ends[:, :2, 0] = places[known][:, None]
        ends[:, 0, 1], ends[:, 1, 1] = a[known], b[known]
        if ends.size:
            self._add(artists.Line2D(*ends.reshape(-1, 2).T, color=colour, linewidth=self.drawing.pt(width)))

    def level(self, y: float, colour: str = SECOND, width: float = 0.8, *, dash: str | None = None) -> None:
        """A horizontal line across the panel."""
        self.on.axhline(
            y, color=colour, linewidth=self.drawing.pt(width), linestyle=self.drawing.dashes(dash, width), zorder=2.3
        )

    def across(self, low: float, high: float, colour: str = BAND) -> None:
        """A horizontal stripe between two y values, behind lines and data."""
        top, bottom = np.clip(self.py([high, low]), self.top, self.bottom).tolist()
        self.drawing.box(self.left, top, self.width, bottom - top, colour)

    def column(self, low: float, high: float, colour: str = BAND) -> None:
        """A vertical stripe between two x values, never too thin to be seen, behind lines and data."""
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
            self.drawing.write(h, v + 1.2 * size * i, line, colour=colour, anchor=anchor, bold=bold, size=size)

    def names(self, entries: Sequence[tuple[float, str, str, bool]], *, gap: float = 14.5, dx: float = 6.0) -> None:
        """Names (y value, text, colour, bold) right of the panel at the curves' ends, pushed apart where they meet."""
        kept = [e for e in entries if math.isfinite(float(self.py(e[0])))]
        order = sorted(range(len(kept)), key=lambda i: float(self.py(kept[i][0])))
        wanted = [min(max(float(self.py(kept[i][0])), self.top), self.bottom) for i in order]
        for i, place in zip(order, apart(wanted, gap, self.top - 4, self.bottom + 6), strict=True):
            value, text, colour, bold = kept[i]
            self.plot.names.append((value, text, colour))
            self.drawing.write(self.right + dx, place + 4, text, colour=colour, bold=bold)


def note(drawing: Drawing, x: float, y: float, text: str, colour: str = SECOND, *, anchor: str | None = None) -> None:
    """Small text in px coordinates; lines are separated by a line feed."""
    for i, line in enumerate(text.split("\n")):
        drawing.write(x, y + 13 * i, line, size=10.7, colour=colour, anchor=anchor)


def pointer(drawing: Drawing, start: tuple[float, float], end: tuple[float, float], colour: str = RULE) -> None:
    """A thin line from a name to its curve, in px."""
    drawing.line([start, end], colour, 0.8)
