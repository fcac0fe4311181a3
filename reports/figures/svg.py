"""Drawing primitives of SVG and the `<img>` that carries a drawing.

Written here rather than taken from a plotting library because a page must come out byte for byte the same on every
machine, a figure may weigh ten kilobytes and take two milliseconds (a campaign has five hundred recordings), and text
must stay text that the reader's own font sets without running into the curves. Axes and data are in `reports.figures.plot`.
"""

from __future__ import annotations

import base64
import json
import math
import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from reports.figures.palette import INK
from schemas.arrays import Float
from schemas.numbers import significant, with_unit

Points = Sequence[tuple[float, float]]

FONT = "-apple-system,'Segoe UI',Roboto,'Helvetica Neue','Noto Sans','Liberation Sans',Arial,sans-serif"
TEXT, TICKS = 12.0, 11.3
"""Sizes of text and of tick labels, in px: 9 pt and 8.5 pt."""


def number(value: float) -> str:
    """A coordinate to a tenth of a pixel."""
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


def _attributes(pairs: dict[str, str | float | None]) -> str:
    found = ((k.replace("_", "-"), v) for k, v in pairs.items() if v is not None)
    return "".join(f' {k}="{escape(v if isinstance(v, str) else number(v))}"' for k, v in found)


def path(points: Points) -> str:
    """Path data of an open line."""
    return "M" + "L".join([f"{x:.1f},{y:.1f}" for x, y in points])


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

    def told(self) -> list[tuple[float, float]]:
        """(x, y) of at most `_TOLD` values, marks before curves, of those that lie inside."""
        dots = [s for s in self.series if s.kind == "d"] or self.series
        if not dots:
            return []
        x, y = (np.concatenate([getattr(s, axis) for s in dots]) for axis in "xy")
        inside = (x >= self.x[0]) & (x <= self.x[1]) & (y >= self.y[0]) & (y <= self.y[1])
        places = np.flatnonzero(inside)
        places = places[:: max(1, -(-places.size // _TOLD))]
        return list(zip(x[places].tolist(), y[places].tolist(), strict=True))


_TOLD = 40
"""Values of a panel that say themselves under the pointer where no script is allowed."""


class Image(Markup):
    """A figure as HTML, and the drawing that it was made from."""

    drawing: Drawing

    @property
    def plot(self) -> Markup:
        """The values of its panels as JSON, for pages with a script; empty where nothing can be asked of it."""
        return self.drawing.values()


class Drawing:
    """A drawing of `width` × `height` px on white, built from back to front."""

    def __init__(self, width: float, height: float) -> None:
        self.width = width
        self.height = height
        self.plots: list[Plot] = []
        self._parts: list[str] = []
        self._clips: list[str] = []

    def _add(self, tag: str, content: str = "", **attributes: str | float | None) -> None:
        self._parts.append(
            f"<{tag}{_attributes(attributes)}" + (f">{content}</{tag}>" if content else "/>"),
        )

    def clip(self, x: float, y: float, width: float, height: float) -> str:
        """A clipping rectangle; its name goes to `line` and `area`."""
        name = f"c{len(self._clips)}"
        rectangle = _attributes({"x": x, "y": y, "width": width, "height": height})
        self._clips.append(f'<clipPath id="{name}"><rect{rectangle}/></clipPath>')
        return f"url(#{name})"

    def line(
        self,
        points: Points,
        colour: str,
        width: float = 2.1,
        *,
        dash: str | None = None,
        clip: str | None = None,
        opacity: str | None = None,
    ) -> None:
        """A line through points in px."""
        if len(points) > 1:
            self._add(
                "path",
                d=path(points),
                fill="none",
                stroke=colour,
                stroke_width=width,
                stroke_linejoin="round",
                stroke_dasharray=dash,
                stroke_opacity=opacity,
                clip_path=clip,
            )

    def segments(self, pairs: Iterable[tuple[float, float, float, float]], colour: str, width: float = 0.9) -> None:
        """Separate straight lines (x1, y1, x2, y2) as one element."""
        data = "".join(f"M{number(a)},{number(b)}L{number(c)},{number(d)}" for a, b, c, d in pairs)
        if data:
            self._add("path", d=data, fill="none", stroke=colour, stroke_width=width)

    def area(self, points: Points, colour: str, *, opacity: str | None = None, clip: str | None = None) -> None:
        """A filled polygon."""
        if len(points) > 2:
            self._add("path", d=path(points) + "z", fill=colour, fill_opacity=opacity, clip_path=clip)

    def box(self, x: float, y: float, width: float, height: float, fill: str, stroke: str | None = None) -> None:
        """A filled rectangle."""
        self._add("rect", x=x, y=y, width=width, height=height, fill=fill, stroke=stroke)

    def text(
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
        """A line of text with its base line at (x, y); `anchor` is `middle` or `end`."""
        self._add(
            "text",
            str(escape(content)),
            x=x,
            y=y,
            font_size=None if size == TEXT else size,
            fill=None if colour in (None, INK) else colour,
            text_anchor=anchor,
            font_weight="600" if bold else None,
            transform=None if turn is None else f"rotate({number(turn)} {number(x)} {number(y)})",
        )

    def marks(self, points: Points, marker: str, colour: str, size: float = 4.2, *, open_: bool = False) -> None:
        """Marks of one kind: filled, or white with an outline. More than `DENSE` become one image."""
        if not points:
            return
        if len(points) > DENSE:
            self._raster(points, colour, size)
            return
        outline = 1.2
        if marker in ("circle", "square"):
            data = "".join(f"M{number(x)},{number(y)}h.01" for x, y in points)
            cap = "round" if marker == "circle" else "square"
            diameter = size if marker == "circle" else size * 0.9
            self._add("path", d=data, stroke=colour, stroke_width=diameter, stroke_linecap=cap, fill="none")
            if open_:
                self._add(
                    "path", d=data, stroke="#fff", stroke_width=diameter - 2 * outline, stroke_linecap=cap, fill="none"
                )
            return
        shape = _SHAPES[marker]
        data = "".join(
            "M" + "L".join(f"{number(x + a * size / 2)},{number(y + b * size / 2)}" for a, b in shape) + "z"
            for x, y in points
        )
        self._add(
            "path", d=data, fill="#fff" if open_ else colour, stroke=colour, stroke_width=outline if open_ else 0.6
        )

    def _raster(self, points: Points, colour: str, size: float) -> None:
        """Marks as a PNG of twice the drawing's resolution: its size does not grow with their number."""
        factor = 2
        width, height = round(self.width * factor), round(self.height * factor)
        ink = np.zeros((height, width), dtype=bool)
        reach = max(1, round(size * factor / 2))
        across, down = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
        inside = across**2 + down**2 <= reach**2
        centres = np.unique(np.round(np.asarray(points) * factor).astype(int), axis=0)
        x = (centres[:, 0, None] + across[inside]).ravel()
        y = (centres[:, 1, None] + down[inside]).ravel()
        fits = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        ink[y[fits], x[fits]] = True
        rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)], dtype=np.uint8)
        palette = np.stack([np.full(3, 255, dtype=np.uint8), rgb])
        self._add("image", width=self.width, height=self.height, href=_png(ink.astype(np.uint8), palette))

    def picture(
        self, x: float, y: float, width: float, height: float, shade: NDArray[np.uint8], palette: NDArray[np.uint8]
    ) -> None:
        """A picture of (rows, columns) indices into a palette (n, 3), its cells as sharp as they are."""
        self._add(
            "image", x=x, y=y, width=width, height=height, preserveAspectRatio="none", style="image-rendering:pixelated",
            href=_png(shade, palette, opaque=True),
        )  # fmt: skip

    def svg(self) -> str:
        """The whole document."""
        size = f'width="{number(self.width)}" height="{number(self.height)}"'
        clips = f"<defs>{''.join(self._clips)}</defs>" if self._clips else ""
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" {size} viewBox="0 0 {number(self.width)} {number(self.height)}"'
            f' font-family="{FONT}" font-size="{number(TEXT)}" fill="{INK}">{clips}{"".join(self._parts)}</svg>'
        )

    def image(self, alt: str) -> Image:
        """`<img>` with the drawing inside, over it what says its values under the pointer; `alt` states the finding."""
        uri = "data:image/svg+xml;base64," + base64.b64encode(self.svg().encode()).decode("ascii")
        size = Markup('width="{}" height="{}"').format(round(self.width), round(self.height))
        picture = Markup('<img src="{}" {} alt="{}">').format(uri, size, alt)
        said = self._said()
        made = Image(Markup('<span class="plot">{}{}</span>').format(picture, said) if self.asked else picture)
        made.drawing = self
        return made

    @property
    def asked(self) -> list[Plot]:
        """Panels with axes that say what they show."""
        return [p for p in self.plots if p.y_title and p.series]

    def _said(self) -> Markup:
        """Invisible marks over the values, each with a title that says it; of residuals none, the values above them have it."""
        marks = []
        for plot in self.asked:
            if plot.y_title.startswith(_RESIDUALS):
                continue
            left, top, width, height = plot.box
            for x, y in plot.told():
                h, v = left + width * _share(plot.x, x), top + height * (1 - _share(plot.y, y))
                words = f"{_with_unit(x, plot.x_title or self._x_title())}: {_with_unit(y, plot.y_title)}"
                marks.append(f'<path d="M{h:.0f} {v:.0f}h0"><title>{escape(words)}</title></path>')
        if not marks:
            return Markup()
        frame = f'viewBox="0 0 {number(self.width)} {number(self.height)}"'
        return Markup(f'<svg class="said" {frame} aria-hidden="true">{"".join(marks)}</svg>')  # noqa: S704

    def _x_title(self) -> str:
        return next((p.x_title for p in reversed(self.plots) if p.x_title), "")

    def values(self) -> Markup:
        """The values of all panels as JSON that may stand in a page."""
        panels = [
            {
                "box": [round(v, 1) for v in p.box], "x": p.x, "y": p.y, "xt": p.x_title or self._x_title(), "yt": p.y_title,
                "names": [[_short(y), text, colour] for y, text, colour in p.names],
                "series": [
                    {
                        "kind": s.kind, "colour": s.colour, "width": s.width, "dash": s.dash, "open": s.open_,
                        "x": [_short(v) for v in s.x.tolist()], "y": [_short(v) for v in s.y.tolist()],
                    }
                    for s in p.series
                ],
            }
            for p in self.asked
        ]  # fmt: skip
        if not panels:
            return Markup()
        text = json.dumps(panels, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
        return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))  # noqa: S704


_RESIDUALS = ("Residual", "Off ")
"""How titles of panels begin that show what is left of the values of another."""


def _share(axis: tuple[float, float, bool], value: float) -> float:
    low, high, log = axis
    return math.log(value / low) / math.log(high / low) if log else (value - low) / (high - low)


def _with_unit(value: float, title: str) -> str:
    """The value with the unit that stands behind the comma of an axis's title."""
    unit = title.rpartition(", ")[2] if ", " in title else ""
    return with_unit(significant(value, 3), unit.partition(";")[0].partition(" (")[0])


def _short(value: float) -> float | None:
    """Five digits of it; None for what JSON has no number for."""
    if not math.isfinite(value):
        return None
    short = float(f"{value:.5g}")
    return int(short) if short.is_integer() and abs(short) < 1e5 else short


DENSE = 2000
"""More marks than this are drawn as an image."""

_HALF = 0.82
_SHAPES: dict[str, tuple[tuple[float, float], ...]] = {
    "triangle": ((0, -1.15), (1.1, 0.85), (-1.1, 0.85)),
    "down": ((0, 1.15), (1.1, -0.85), (-1.1, -0.85)),
    "diamond": ((0, -1.25), (1.1, 0), (0, 1.25), (-1.1, 0)),
    "cross": tuple(
        (_HALF * x, _HALF * y)
        for x, y in (
            (-1.3, -0.8), (-0.8, -1.3), (0, -0.5), (0.8, -1.3), (1.3, -0.8), (0.5, 0),
            (1.3, 0.8), (0.8, 1.3), (0, 0.5), (-0.8, 1.3), (-1.3, 0.8), (-0.5, 0),
        )
    ),
}  # fmt: skip


def _png(cells: NDArray[np.uint8], palette: NDArray[np.uint8], *, opaque: bool = False) -> str:
    """Data URI of a PNG of (rows, columns) indices into a palette (n, 3); index 0 is transparent unless `opaque`."""
    lines = np.concatenate([np.zeros((cells.shape[0], 1), dtype=np.uint8), cells], axis=1)

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    data = (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", cells.shape[1], cells.shape[0], 8, 3, 0, 0, 0))
        + chunk(b"PLTE", palette.tobytes())
        + (b"" if opaque else chunk(b"tRNS", b"\x00"))
        + chunk(b"IDAT", zlib.compress(lines.tobytes(), 9))
        + chunk(b"IEND", b"")
    )
    return "data:image/png;base64," + base64.b64encode(data).decode("ascii")
