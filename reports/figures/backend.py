"""A drawing as SVG for a page: a small backend, because matplotlib's own writes for editors rather than for pages.

What it leaves out is what a page does not need: a group and a name for every artist, a clipping path beside each line, a mark
per point, an element per tick. Lines are simplified and cut at the axes as they are written, marks of one kind are one path,
coordinates go to a tenth of a pixel, and text stays text that the reader's own font sets. No date, no random name.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import escape
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.colors import to_hex
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.transforms import Affine2D, Bbox, Transform
from numpy.typing import ArrayLike
from PIL import Image

from reports.figures.palette import INK
from reports.figures.panel import Drawing
from reports.figures.scale import number
from schemas.arrays import Float

FONT = "-apple-system,'Segoe UI',Roboto,'Helvetica Neue','Noto Sans','Liberation Sans',Arial,sans-serif"
TEXT = 12.0
"""Size of text that is not said, px."""
DENSE = 2000
"""More marks than this are drawn as an image."""
_EDGE = 2.0
"""Room for half a line beyond the axes, px."""
_MARK = 40.0
"""Largest mark, px."""
_WIDE = 0.6
"""Mean width of a letter over its size, for the few places where matplotlib asks for it."""
_CUT = 1e4
"""Farthest place, px: what lies beyond is not seen, and its digits would only cost."""

Colour = Sequence[float]


def write_svg(drawing: Drawing) -> str:
    """Its figure as an SVG document, in px as large as the drawing was laid out."""
    figure = drawing.figure
    renderer = _PageRenderer(*(figure.get_size_inches() * figure.dpi))
    figure.patch.set_visible(False)  # the page is the paper
    figure.draw(renderer)
    figure.patch.set_visible(True)
    return renderer.document()


class _PageRenderer(RendererBase):
    """What matplotlib's artists draw on; see `RendererBase` for the methods' meaning."""

    def __init__(self, width: float, height: float) -> None:
        super().__init__()
        self.width, self.height = width, height
        self._parts: list[str] = []
        self._down = Affine2D().scale(1, -1).translate(0, height)

    def document(self) -> str:
        """All that was drawn."""
        w, h = number(self.width), number(self.height)
        return (
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{w}" height="{h}" viewBox="0 0 {w} {h}"'
            f' font-family="{FONT}" font-size="{number(TEXT)}" fill="{INK}">{"".join(self._parts)}</svg>'
        )

    def points_to_pixels(self, points: Any) -> Any:
        return points * 96 / 72

    def get_canvas_width_height(self) -> tuple[float, float]:
        return self.width, self.height

    def get_text_width_height_descent(self, s: str, prop: FontProperties, ismath: Any) -> tuple[float, float, float]:
        """A guess: the reader's font sets the text, at the place and on the side that were asked for."""
        size = self.points_to_pixels(prop.get_size_in_points())
        return _WIDE * size * len(s), 0.95 * size, 0.22 * size

    def option_image_nocomposite(self) -> bool:
        return True

    def option_scale_image(self) -> bool:
        return True

    def _clip(self, gc: GraphicsContextBase) -> Bbox | None:
        """Where the artist may draw, downwards as SVG counts, with room for half a line."""
        box = gc.get_clip_rectangle()
        if box is None:
            return None
        return Bbox.from_extents(
            box.x0 - _EDGE, self.height - box.y1 - _EDGE, box.x1 + _EDGE, self.height - box.y0 + _EDGE
        )

    def draw_path(
        self, gc: GraphicsContextBase, path: Path, transform: Transform, rgbFace: Colour | None = None
    ) -> None:
        clip = self._clip(gc)
        lined = gc.get_linewidth() > 0
        placed = path.transformed(transform + self._down)
        if rgbFace is not None and clip is not None:
            placed = _cut_area(placed, clip)
        simple = rgbFace is None and path.should_simplify
        edge = clip if clip is not None else Bbox.from_extents(-_CUT, -_CUT, _CUT, _CUT)
        clean = placed.cleaned(
            remove_nans=True, clip=edge.extents if rgbFace is None else None, simplify=simple, curves=False
        )
        data = _path_data(clean)
        if not data:
            return
        style = (
            ' fill="none"'
            if rgbFace is None
            else _paint("fill", rgbFace, gc.get_alpha() if gc.get_forced_alpha() else None)
        )
        if lined:
            style += _paint("stroke", gc.get_rgb(), gc.get_alpha() if gc.get_forced_alpha() else None)
            style += f' stroke-width="{_short(self.points_to_pixels(gc.get_linewidth()))}"'
            if rgbFace is None:
                style += ' stroke-linejoin="round"'
            _, dashes = gc.get_dashes()
            if dashes is not None:
                style += f' stroke-dasharray="{" ".join(_short(self.points_to_pixels(d)) for d in np.asarray(dashes).tolist())}"'
        self._parts.append(f'<path d="{data}"{style}/>')

    def draw_markers(
        self,
        gc: GraphicsContextBase,
        marker_path: Path,
        marker_trans: Transform,
        path: Path,
        trans: Transform,
        rgbFace: Colour | None = None,
    ) -> None:
        places = (trans + self._down).transform(path.vertices)
        places = places[np.isfinite(places).all(axis=1)]
        shape = marker_path.transformed(marker_trans + Affine2D().scale(1, -1))
        if max(shape.get_extents().size) > _MARK:  # an area that matplotlib draws as if it were a mark
            for x, y in places.tolist():
                self.draw_path(gc, marker_path, marker_trans + Affine2D().translate(x, self.height - y), rgbFace)
            return
        clip = self._clip(gc)
        if clip is not None:
            x, y = places.T
            places = places[(x >= clip.x0) & (x <= clip.x1) & (y >= clip.y0) & (y <= clip.y1)]
        if not len(places):
            return
        outline = float(self.points_to_pixels(gc.get_linewidth()))
        edge, fill = to_hex(gc.get_rgb()), "none" if rgbFace is None else to_hex(rgbFace)
        size = shape.get_extents().width
        if rgbFace is not None and len(places) > DENSE:
            self._parts.append(self._raster(places, fill, size))
            return
        cap = _cap(shape)
        if rgbFace is None or cap is None:
            corners = np.asarray(shape.vertices)
            data = "".join(_path_data(Path(corners + place, shape.codes)) for place in places)
            stroke = f' stroke="{edge}" stroke-width="{_short(outline)}"' if outline else ""
            self._parts.append(f'<path d="{data}" fill="{fill}"{stroke}/>')
            return
        data = "".join(f"M{number(x)},{number(y)}h.01" for x, y in places.tolist())
        for colour, wide in ((edge, size + outline), (fill, size - outline))[0 if outline else 1 :]:
            self._parts.append(f'<path d="{data}" stroke="{colour}" stroke-width="{_short(wide)}" stroke-linecap="{cap}" fill="none"/>')  # fmt: skip

    def _raster(self, places: Float, colour: str, size: float) -> str:
        """Marks as a PNG of twice the drawing's resolution: its size does not grow with their number."""
        factor = 2
        width, height = round(self.width * factor), round(self.height * factor)
        ink = np.zeros((height, width), dtype=np.uint8)
        reach = max(1, round(size * factor / 2))
        across, down = np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1))
        inside = across**2 + down**2 <= reach**2
        centres = np.unique(np.round(places * factor).astype(int), axis=0)
        x = (centres[:, 0, None] + across[inside]).ravel()
        y = (centres[:, 1, None] + down[inside]).ravel()
        fits = (x >= 0) & (x < width) & (y >= 0) & (y < height)
        ink[y[fits], x[fits]] = 1
        image = Image.fromarray(ink, mode="P")
        image.putpalette([255, 255, 255, *bytes.fromhex(colour[1:])])
        return (
            f'<image width="{number(self.width)}" height="{number(self.height)}" href="{_png(image, transparency=0)}"/>'
        )

    def draw_image(self, gc: GraphicsContextBase, x: float, y: float, im: ArrayLike, transform: Any = None) -> None:
        cells = np.asarray(im)
        if transform is None:
            height, width = cells.shape[:2]
        else:
            width, height = transform.frozen().to_values()[0], transform.frozen().to_values()[3]
        left, top = x, self.height - y - height
        image = Image.fromarray(np.ascontiguousarray(cells[::-1]))
        self._parts.append(
            f'<image x="{number(left)}" y="{number(top)}" width="{number(width)}" height="{number(height)}"'
            f' preserveAspectRatio="none" style="image-rendering:pixelated" href="{_png(image)}"/>'
        )

    def draw_text(
        self,
        gc: GraphicsContextBase,
        x: float,
        y: float,
        s: str,
        prop: FontProperties,
        angle: float,
        ismath: Any = False,
        mtext: Any = None,
    ) -> None:
        side = ""
        if mtext is not None:
            x, at = mtext.get_transform().transform(mtext.get_unitless_position())
            y = self.height - at if angle else y
            side = {"center": ' text-anchor="middle"', "right": ' text-anchor="end"'}.get(mtext.get_ha(), "")
        size = float(self.points_to_pixels(prop.get_size_in_points()))
        colour = to_hex(gc.get_rgb())
        style = "" if abs(size - TEXT) < 0.01 else f' font-size="{_short(size)}"'
        style += "" if colour == INK else f' fill="{colour}"'
        style += ' font-weight="600"' if prop.get_weight() == "bold" else ""
        turn = f' transform="rotate({number(-angle)} {number(x)} {number(y)})"' if angle else ""
        self._parts.append(f'<text x="{number(x)}" y="{number(y)}"{side}{style}{turn}>{escape(s)}</text>')


def _cap(shape: Path) -> str | None:
    """The end of a line that looks like this mark: round for a circle, square for a square; None for other shapes."""
    if shape.codes is not None and np.any(np.asarray(shape.codes) == Path.CURVE4):
        return "round"
    corners = np.unique(np.round(np.asarray(shape.vertices), 3), axis=0)
    return "square" if len(corners) == 4 and len(np.unique(corners[:, 0])) == 2 else None


def _cut_area(path: Path, clip: Bbox) -> Path:
    """A filled path without what lies outside; unchanged where all of it is inside."""
    box = path.get_extents()
    if box.x0 >= clip.x0 and box.x1 <= clip.x1 and box.y0 >= clip.y0 and box.y1 <= clip.y1:
        return path
    return path.clip_to_bbox(clip)


def _path_data(path: Path) -> str:
    """What SVG writes for a path of straight lines."""
    vertices = np.asarray(path.vertices)
    plain = [Path.MOVETO] + [Path.LINETO] * (len(vertices) - 1)
    codes = plain if path.codes is None else np.asarray(path.codes).tolist()
    parts = []
    last = ""
    for (x, y), code in zip(vertices.tolist(), codes, strict=True):
        if code == Path.STOP:
            break
        if code == Path.CLOSEPOLY:
            parts.append("z")
            last = ""
            continue
        place = f"{x:.1f},{y:.1f}"
        if code == Path.MOVETO:
            parts.append(f"M{place}")
        elif place != last:
            parts.append(f"L{place}")
        last = place
    return "".join(parts).replace(".0,", ",").replace(".0L", "L").replace(".0M", "M").replace(".0z", "z")


def _paint(what: str, colour: Colour, alpha: float | None) -> str:
    opacity = alpha if alpha is not None else (colour[3] if len(colour) > 3 else 1.0)
    return f' {what}="{to_hex(colour)}"' + (f' {what}-opacity="{opacity:.2g}"' if opacity < 1 else "")


def _short(value: float) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _png(image: Image.Image, **options: Any) -> str:
    """Data URI of a picture; colours that are few are kept as a palette."""
    if image.mode != "P":
        image = image.convert("RGB").quantize(256) if image.convert("RGB").getcolors(256) else image
    file = io.BytesIO()
    image.save(file, "png", optimize=True, **options)
    return "data:image/png;base64," + base64.b64encode(file.getvalue()).decode("ascii")
