"""A figure on a page: the SVG of its drawing, over it what says its values under the pointer, and the way back to the figure.

A figure is one function that takes data and draws with matplotlib. `@pictured` makes of it what pages call: it gives the HTML,
and `draw` of what it gives makes the figure anew, for a notebook or a paper.
"""

from __future__ import annotations

import base64
import functools
import json
import math
from collections.abc import Callable, Mapping
from typing import Any, ParamSpec

import numpy as np
from markupsafe import Markup, escape

from reports.figures.drawn import Drawn, digest_data, find_drawn, mark
from reports.figures.panel import SHEET, Drawing, Plot, styled
from reports.figures.paper import SINGLE, draw_for_column
from reports.figures.scale import number
from schemas.numbers import significant, with_unit

P = ParamSpec("P")

_TOLD = 40
"""Values of a panel that say themselves under the pointer where no script is allowed."""
_RESIDUALS = ("Residual", "Off ")
"""How titles of panels begin that show what is left of the values of another."""


class Picture(Markup):
    """A figure as HTML.

    `kind` is what it shows, `data` and `options` are what it was drawn from, `finding` is its alt text; `plot` holds the values
    of its panels as JSON for pages with a script, and is empty where nothing can be asked of it.
    """

    kind: str
    data: tuple[Any, ...]
    options: Mapping[str, Any]
    finding: str
    plot: Markup
    figure: Callable[..., Drawing]
    column: str
    whole: Mapping[str, Any]

    def draw(self, width: str | None = None) -> Drawing:
        """The figure for a paper, made anew: `single` or `double` column, what suits its kind where `width` is None."""
        options = {**self.options, **self.whole}
        return draw_for_column(lambda: self.figure(*self.data, **options), width or self.column)


def pictured(
    kind: str, *, column: str = SINGLE, whole: Mapping[str, Any] | None = None
) -> Callable[[Callable[P, Drawing]], Callable[P, Picture]]:
    """Makes a function that draws into one that gives the HTML of what it draws, and keeps its data.

    Parameters
    ----------
    kind : what the figure shows: its name for who asks for it as a file
    column : the width that it has in a paper unless another is asked for
    whole : options of the figure by itself, where the page shows its parts apart
    """

    def embed_what_is_drawn(draw: Callable[P, Drawing]) -> Callable[P, Picture]:
        @functools.wraps(draw)
        def embed(*data: P.args, **options: P.kwargs) -> Picture:
            digest = digest_data(kind, data, options, SHEET.get())
            html, values = find_drawn(digest) or _draw(functools.partial(draw, *data, **options), digest)
            picture = Picture(html)
            picture.plot, picture.finding = values, str(options["alt"])
            picture.kind, picture.data, picture.options = kind, data, options
            picture.figure, picture.column, picture.whole = draw, column, whole or {}
            return picture

        return embed

    return embed_what_is_drawn


def _draw(draw: Callable[[], Drawing], digest: str | None) -> Drawn:
    from reports.figures.backend import write_svg

    with styled():
        drawing = draw()
        svg = write_svg(drawing)
    return mark(_embed(drawing, svg), digest), write_values(drawing)


def _embed(drawing: Drawing, svg: str) -> Markup:
    """`<img>` with the drawing inside, over it what says its values under the pointer."""
    uri = "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode("ascii")
    size = Markup('width="{}" height="{}"').format(round(drawing.width), round(drawing.height))
    picture = Markup('<img src="{}" {} alt="{}">').format(uri, size, drawing.figure.get_label())
    return Markup('<span class="plot">{}{}</span>').format(picture, _said(drawing)) if _asked(drawing) else picture


def _asked(drawing: Drawing) -> list[Plot]:
    """Panels with axes that say what they show."""
    return [p for p in drawing.plots if p.y_title and p.series]


def told(plot: Plot) -> list[tuple[float, float]]:
    """(x, y) of at most `_TOLD` values, marks before curves, of those that lie inside."""
    dots = [s for s in plot.series if s.kind == "d"] or plot.series
    if not dots:
        return []
    x, y = (np.concatenate([getattr(s, axis) for s in dots]) for axis in "xy")
    inside = (x >= plot.x[0]) & (x <= plot.x[1]) & (y >= plot.y[0]) & (y <= plot.y[1])
    places = np.flatnonzero(inside)
    places = places[:: max(1, -(-places.size // _TOLD))]
    return list(zip(x[places].tolist(), y[places].tolist(), strict=True))


def _said(drawing: Drawing) -> Markup:
    """Invisible marks over the values, each with a title that says it; of residuals none, the values above them have it."""
    marks = []
    for plot in _asked(drawing):
        if plot.y_title.startswith(_RESIDUALS):
            continue
        left, top, width, height = plot.box
        for x, y in told(plot):
            h, v = left + width * _share(plot.x, x), top + height * (1 - _share(plot.y, y))
            words = f"{_with_unit(x, plot.x_title or _x_title(drawing))}: {_with_unit(y, plot.y_title)}"
            marks.append(f'<path d="M{h:.0f} {v:.0f}h0"><title>{escape(words)}</title></path>')
    if not marks:
        return Markup()
    frame = f'viewBox="0 0 {number(drawing.width)} {number(drawing.height)}"'
    return Markup(f'<svg class="said" {frame} aria-hidden="true">{"".join(marks)}</svg>')  # noqa: S704


def _x_title(drawing: Drawing) -> str:
    return next((p.x_title for p in reversed(drawing.plots) if p.x_title), "")


def write_values(drawing: Drawing) -> Markup:
    """The values of all panels as JSON that may stand in a page."""
    panels = [
        {
            "box": [round(v, 1) for v in p.box], "x": p.x, "y": p.y, "xt": p.x_title or _x_title(drawing), "yt": p.y_title,
            "names": [[_short(y), text, colour] for y, text, colour in p.names],
            "series": [
                {
                    "kind": s.kind, "colour": s.colour, "width": s.width, "dash": s.dash, "open": s.open_,
                    "x": [_short(v) for v in s.x.tolist()], "y": [_short(v) for v in s.y.tolist()],
                }
                for s in p.series
            ],
        }
        for p in _asked(drawing)
    ]  # fmt: skip
    if not panels:
        return Markup()
    text = json.dumps(panels, separators=(",", ":"), ensure_ascii=False, allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("&", "\\u0026"))  # noqa: S704


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
