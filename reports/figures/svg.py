"""Drawing primitives of SVG and the `<img>` that carries a drawing.

Written here rather than taken from a plotting library because a page must come out byte for byte the same on every
machine, a figure may weigh ten kilobytes and take two milliseconds (a campaign has five hundred recordings), and text
must stay text that the reader's own font sets without running into the curves. Axes and data are in `reports.figures.plot`.
"""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Iterable, Sequence

import numpy as np
from markupsafe import Markup, escape
from numpy.typing import NDArray

from reports.figures.palette import INK

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


class Drawing:
    """A drawing of `width` × `height` px on white, built from back to front."""

    def __init__(self, width: float, height: float) -> None:
        self.width = width
        self.height = height
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

    def image(self, alt: str) -> Markup:
        """`<img>` with the drawing inside; `alt` states the finding."""
        uri = "data:image/svg+xml;base64," + base64.b64encode(self.svg().encode()).decode("ascii")
        size = Markup('width="{}" height="{}"').format(round(self.width), round(self.height))
        return Markup('<img src="{}" {} alt="{}">').format(uri, size, alt)


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
