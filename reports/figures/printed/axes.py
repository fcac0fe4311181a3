"""What printed figures are put together from: axes with the pages' scales and ticks, points, bands, names at the curves."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedFormatter, FixedLocator
from numpy.typing import ArrayLike

from reports.figures.palette import BAND, INK, RULE, SECOND
from reports.figures.plot import Scale, apart, nice, tick_text
from reports.figures.printed.style import CURVE_PT, FINE_PT, POINT_PT, TEXT_PT, TICK_PT, find_figure, is_wide
from schemas.arrays import Bool, Float

MARKERS = {"circle": "o", "square": "s", "triangle": "^", "diamond": "D", "down": "v", "cross": "X"}
"""Markers of the pages in matplotlib's words."""
Name = tuple[float, str, str, bool]
"""Value at the end of a curve, its name, colour, and whether it is the one that counts."""

_READABLE = 40.0
"""Half height of a strip, SD, from which on ±2 SD cannot be told from zero."""
_DENSE = 120
"""Points from which on they are drawn smaller."""


def scale_axes(
    axes: Axes,
    x: Scale,
    y: Scale,
    title: str = "",
    x_title: str = "",
    *,
    x_labels: bool = True,
    y_most: int = 5,
    x_ticks: Sequence[float] | None = None,
    y_ticks: Sequence[float] | None = None,
    signed: bool = False,
) -> None:
    """Scales, ticks and titles as on the pages: the quantity with its unit stands over the axis."""
    for axis, scale, ticks, most in (
        (axes.xaxis, x, x_ticks, 8 if is_wide(axes) else 6),
        (axes.yaxis, y, y_ticks, y_most),
    ):
        set_scale, set_limits = (
            (axes.set_xscale, axes.set_xlim) if axis is axes.xaxis else (axes.set_yscale, axes.set_ylim)
        )
        set_scale("log" if scale.log else "linear")
        set_limits(scale.low, scale.high)
        major, minor = (list(ticks), []) if ticks is not None else scale.ticks(most)
        axis.set_major_locator(FixedLocator(major))
        axis.set_minor_locator(FixedLocator(minor))
        plus = signed and axis is axes.yaxis
        axis.set_major_formatter(FixedFormatter([("+" if plus and v > 0 else "") + tick_text(v) for v in major]))
        axis.set_minor_formatter(FixedFormatter([""] * len(minor)))
    if not x_labels:
        axes.tick_params(axis="x", labelbottom=False)
    if title:
        axes.set_title(title)
    if x_title:
        axes.set_xlabel(x_title)


def draw_curve(
    axes: Axes, x: ArrayLike, y: ArrayLike, colour: str, width: float = CURVE_PT, dash: Sequence[float] | None = None
) -> None:
    """A line; a NaN interrupts it."""
    axes.plot(x, y, color=colour, linewidth=width, linestyle=(0, tuple(dash)) if dash else "-", zorder=2)


def draw_band(
    axes: Axes, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, opacity: float = 0.2, *, steps: bool = False
) -> None:
    """A shaded band between two curves; where either is NaN there is none."""
    axes.fill_between(
        x, low, high, color=colour, alpha=opacity, linewidth=0, step="post" if steps else None, zorder=1
    )  # fmt: skip


def draw_points(
    axes: Axes,
    x: ArrayLike,
    y: ArrayLike,
    colour: str,
    size: float = POINT_PT,
    *,
    marker: str = "circle",
    hollow: bool = False,
) -> None:
    """Marks at points; hollow ones have the second meaning that the caption gives them."""
    values = np.asarray(y, dtype=float)
    if not values.size:
        return
    size = size if values.size < _DENSE else 0.8 * size
    axes.plot(
        np.broadcast_to(np.asarray(x, dtype=float), values.shape), values, linestyle="none", marker=MARKERS[marker],
        markersize=size, markeredgewidth=0.7 if hollow else 0.0, markeredgecolor=colour,
        markerfacecolor="white" if hollow else colour, zorder=3,
    )  # fmt: skip


def draw_held(
    axes: Axes, x: ArrayLike, y: ArrayLike, scale: Scale, colour: str, size: float = POINT_PT, *, marker: str = "circle",
    hollow: bool = False,
) -> None:  # fmt: skip
    """Marks, and triangles at the edge for those that lie above or below: none is cut off in silence."""
    values = np.asarray(y, dtype=float)
    places = np.broadcast_to(np.asarray(x, dtype=float), values.shape)
    inside = (values >= scale.low) & (values <= scale.high)
    draw_points(axes, places[inside], values[inside], colour, size, marker=marker, hollow=hollow)
    for beyond, edge, sign in ((values > scale.high, scale.high, "^"), (values < scale.low, scale.low, "v")):
        if beyond.any():
            axes.plot(
                places[beyond], np.full(int(beyond.sum()), edge), linestyle="none", marker=sign, markersize=size * 1.1,
                markeredgewidth=0.7 if hollow else 0.0, markeredgecolor=colour,
                markerfacecolor="white" if hollow else colour, clip_on=False, zorder=3,
            )  # fmt: skip


def draw_bars(axes: Axes, x: ArrayLike, low: ArrayLike, high: ArrayLike, colour: str, width: float = FINE_PT) -> None:
    """Vertical error bars; one that would end at or below zero on a logarithmic axis ends at the axis."""
    bottom, places = np.asarray(low, dtype=float), np.asarray(x, dtype=float)
    top = np.broadcast_to(np.asarray(high, dtype=float), bottom.shape)
    known = np.isfinite(bottom) & np.isfinite(top)
    if axes.get_yscale() == "log":
        bottom = np.maximum(bottom, axes.get_ylim()[0] * 1e-3)
    axes.vlines(np.broadcast_to(places, bottom.shape)[known], bottom[known], top[known], color=colour, linewidth=width, zorder=2)  # fmt: skip


def mark_level(
    axes: Axes, y: float, colour: str = SECOND, width: float = FINE_PT, dash: Sequence[float] | None = None
) -> None:
    """A horizontal line across the axes."""
    axes.axhline(y, color=colour, linewidth=width, linestyle=(0, tuple(dash)) if dash else "-", zorder=1)


def mark_stripe(axes: Axes, low: float, high: float, colour: str = BAND) -> None:
    """A horizontal stripe, such as what noise alone gives."""
    axes.axhspan(low, high, color=colour, linewidth=0, zorder=0)


def mark_column(axes: Axes, low: float, high: float, colour: str = BAND) -> None:
    """A vertical stripe, such as where a correction has no information."""
    axes.axvspan(low, high, color=colour, linewidth=0, zorder=0)


def mark_box(axes: Axes, left: float, right: float, bottom: float, top: float, colour: str, edge: str = "none") -> None:
    """A filled rectangle in the units of the axes."""
    axes.add_patch(Rectangle((left, bottom), right - left, top - bottom, facecolor=colour, edgecolor=edge, linewidth=0.4, zorder=0))  # fmt: skip


def draw_residual_strip(axes: Axes, x: Scale, reach: float, title: str, x_title: str, *, in_sd: bool = True) -> Scale:
    """Axes for what a model leaves: zero, and ±2 SD where it is in SD; returns their scale."""
    y = Scale(-reach, reach)
    if in_sd:
        mark_stripe(axes, -2, 2)
    if in_sd and reach < _READABLE:
        axes.annotate("±2 SD", (1, 0), (4, 0), xycoords=("axes fraction", "data"), textcoords="offset points", va="center",
                      fontsize=TICK_PT, color=SECOND, annotation_clip=False)  # fmt: skip
    mark_level(axes, 0.0)
    tick = nice(0.75 * reach)
    scale_axes(axes, x, y, title, x_title, y_ticks=(-tick, 0, tick), signed=True)
    return y


def write_note(
    axes: Axes, x: float, y: float, text: str, colour: str = SECOND, *, side: str = "left", bold: bool = False
) -> None:
    """Small text at a place given in shares of the axes."""
    axes.text(
        x, y, text, transform=axes.transAxes, ha=side, va="center", fontsize=TICK_PT, color=colour,
        fontweight="bold" if bold else "normal", zorder=4,
    )  # fmt: skip


def write_label(
    axes: Axes, x: float, y: float, text: str, colour: str = INK, *, dx: float = 0.0, dy: float = 0.0, side: str = "left",
    bold: bool = False,
) -> None:  # fmt: skip
    """Text at a point in the units of the axes, moved by (dx, dy) pt."""
    axes.annotate(
        text, (x, y), (dx, dy), textcoords="offset points", ha=side, va="center", fontsize=TEXT_PT, color=colour,
        fontweight="bold" if bold else "normal", annotation_clip=False, zorder=4,
    )  # fmt: skip


def name_curves(axes: Axes, entries: Sequence[Name], *, lines: int = 1) -> None:
    """Names of so many lines right of the axes at the ends of their curves, pushed apart where they meet; a thin line leads back.

    The limits of the axes must be set; room is made by the layout.
    """
    low, high = axes.get_ylim()
    scale = Scale(low, high, log=axes.get_yscale() == "log")
    shares = [(float(scale.share(value)), text, colour, bold) for value, text, colour, bold in entries]
    kept = sorted((e for e in shares if math.isfinite(e[0])), key=lambda e: -e[0])
    if not kept:
        return
    figure = find_figure(axes)
    figure.draw_without_rendering()
    points = axes.get_window_extent().height * 72 / figure.dpi
    wanted = [points * (1 - min(max(e[0], 0.0), 1.0)) for e in kept]
    for (_, text, colour, bold), place, want in zip(
        kept, apart(wanted, 1.25 * lines * TEXT_PT, -4.0, points + 4.0), wanted, strict=True
    ):
        axes.annotate(
            text, (1, 1 - want / points), (9 if len(kept) > 1 else 5, want - place), xycoords="axes fraction",
            textcoords="offset points", ha="left", va="center", fontsize=TEXT_PT, color=colour,
            fontweight="bold" if bold else "normal", annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": RULE, "linewidth": 0.5, "shrinkA": 0.5, "shrinkB": 0.5}
            if abs(want - place) > 0.5 * TEXT_PT else None,
        )  # fmt: skip


def name_points(axes: Axes, x: Float, y: Float, names: Sequence[str], which: Bool, colour: str) -> None:
    """Names beside the points that are to be looked at, on the side where there is room."""
    low, high = axes.get_xlim()
    for i in np.flatnonzero(which).tolist():
        late = x[i] > low + 0.6 * (high - low)
        write_label(
            axes, x[i], y[i], names[i], colour, dx=-5 if late else 5, side="right" if late else "left", bold=True
        )
