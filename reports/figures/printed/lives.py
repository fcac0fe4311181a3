"""Lifetimes: survival curves with numbers at risk, and the check of a law on its own scale."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import wrap

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.palette import INK, RULE, SECOND
from reports.figures.plot import Scale, logarithmic, tick_text
from reports.figures.printed.axes import (
    Name,
    draw_band,
    draw_curve,
    draw_points,
    name_curves,
    scale_axes,
    write_label,
)
from reports.figures.printed.style import CURVE_PT, POINT_PT, SINGLE, TEXT_PT, TICK_PT, open_axes, styled
from reports.figures.survival import LAWS, GroupCurve, plotted_shares, survival_time_scale
from reports.names import short

_ROW_MM = 3.6
_FEW = 3
"""Up to so many groups have room for a second line beside their name."""
_HALF_A_LINE = 0.045
"""Half the height of a line of text, as a share surviving."""
_NONE_LEFT, _LATE = 0.02, 0.55
"""Survival at which a curve has ended at the axis, and share of the axis from which on its name has no room beside it."""
_CROSSED = (0.45, 0.6, 0.3)
"""Survival at whose height curves that end at the axis are named, in turn."""
_NAMED_AT = (0.13, 0.04, 0.32)
"""Shares failed at whose height the lines are named, in turn."""
_SHARES = (0.02, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98)


@styled()
def draw_survival(groups: Sequence[GroupCurve], time_title: str, *, width: str = SINGLE) -> Figure:
    """Kaplan–Meier curves with 95 % bands, open marks where specimens were alive at the end, numbers at risk below."""
    figure, axes = open_axes(width, 68 + _ROW_MM * (len(groups) + 1), (52.0, 4 + _ROW_MM * (len(groups) + 1)))
    panel, table = axes[:, 0]
    x, ticks = survival_time_scale(groups)
    scale_axes(panel, x, Scale(0.0, 104.0), "Surviving, %", time_title, x_ticks=ticks, y_ticks=(0, 25, 50, 75, 100))
    ends: list[Name] = []
    fallen: list[tuple[float, float, str, str]] = []
    few = len(groups) <= _FEW
    for g in groups:
        time = np.append(x.low, np.maximum(g.time, x.low))
        survival, lower, upper = (np.append(1.0, v) for v in (g.survival, g.lower, g.upper))
        draw_band(panel, time, 100 * lower, 100 * upper, g.drawn.colour, 0.13, steps=True)
        panel.step(time, 100 * survival, where="post", color=g.drawn.colour, linewidth=CURVE_PT, zorder=2)
        kept = g.censored > 0
        draw_points(panel, g.time[kept], 100 * g.survival[kept], g.drawn.colour, 1.5 * POINT_PT, marker=g.drawn.marker, hollow=True)  # fmt: skip
        known = survival[np.isfinite(survival)]
        text = short(g.name, 24)
        if few:
            text = "\n".join([*wrap(short(g.name, 60), 20), f"{g.failed} of {g.total} failed"])
        text = f"{g.drawn.sign} {text}"
        level = _CROSSED[len(fallen) % len(_CROSSED)]
        foot = max(level - _HALF_A_LINE * (1 + text.count("\n")), 0.0)  # right of the curve over its whole height
        at = float(g.time[np.argmax(g.survival <= foot)]) if np.any(g.survival <= foot) else math.inf
        if known[-1] <= _NONE_LEFT and float(x.share([max(at, x.low)])[0]) < _LATE:
            fallen.append((max(at, x.low), 100 * level, text, g.drawn.colour))
        else:
            ends.append((100 * float(known[-1]), text, g.drawn.colour, True))
    for at, height, text, colour in fallen:
        write_label(panel, at, height, text, colour, dx=4, bold=True)
    _write_at_risk(table, x, groups, ticks)
    name_curves(panel, ends, lines=3 if few else 1)
    return figure


def _write_at_risk(axes: Axes, x: Scale, groups: Sequence[GroupCurve], ticks: Sequence[float]) -> None:
    """A row of numbers for each group under the ticks of the curves; the group is told by colour, sign and name."""
    scale_axes(axes, x, Scale(len(groups) - 0.4, -1.4), x_labels=False, x_ticks=ticks, y_ticks=())
    axes.spines[:].set_visible(False)
    axes.tick_params(length=0, which="both")
    axes.axhline(-0.75, color=RULE, linewidth=0.6, xmin=-0.15, xmax=1.0, clip_on=False)
    axes.annotate("At risk", (0, -1.25), (-6, 0), xycoords=("axes fraction", "data"), textcoords="offset points",
                  ha="right", va="center", fontsize=TICK_PT, color=SECOND, annotation_clip=False)  # fmt: skip
    for i, g in enumerate(groups):
        axes.annotate(
            g.drawn.sign, (0, i), (-12, 0), xycoords=("axes fraction", "data"), textcoords="offset points",
            ha="right", va="center", fontsize=TEXT_PT, color=g.drawn.colour, annotation_clip=False,
        )  # fmt: skip
        for tick in ticks:
            axes.text(tick, i, str(g.still_at_risk(tick)), ha="center", va="center", fontsize=TICK_PT, color=INK)


@styled()
def draw_probability(groups: Sequence[GroupCurve], law: str, time_title: str, *, width: str = SINGLE) -> Figure:
    """Share failed on the scale of a law, with the 95 % band of its fit: points on the line where the law holds."""
    to_scale, name = LAWS[law]
    figure, axes = open_axes(width, 74)
    (panel,) = axes[:, 0]
    points = [(g, *plotted_shares(g)) for g in groups]
    y = Scale(to_scale(0.015), to_scale(0.985))
    x = logarithmic(*(t for _, t, _ in points), margin=0.08)
    scale_axes(panel, x, y, f"Failed, % ({name} scale)", time_title, y_ticks=())  # fmt: skip
    panel.set_yticks([to_scale(s) for s in _SHARES], [tick_text(100 * s) for s in _SHARES])
    panel.set_ylim(y.low, y.high)
    height = np.linspace(y.low, y.high, 60)
    for i, (g, time, failed) in enumerate(points):
        if law in g.laws:
            line = g.laws[law]
            level = np.array([to_scale(s) for s in line.share.tolist()])
            panel.fill_betweenx(level, line.lower, line.upper, color=g.drawn.colour, alpha=0.12, linewidth=0)
            draw_curve(panel, np.exp(line.location + line.sigma * height), height, g.drawn.colour)
        draw_points(panel, time, [to_scale(s) for s in failed.tolist()], g.drawn.colour, 1.4 * POINT_PT, marker=g.drawn.marker)  # fmt: skip
        words = g.laws[law].words if law in g.laws else f"{g.failed} failed, no law fitted"
        at = _NAMED_AT[i % len(_NAMED_AT)]
        nearest = int(np.argmin(np.abs(failed - at)))
        place = (
            math.exp(g.laws[law].location + g.laws[law].sigma * to_scale(at)) if law in g.laws else float(time[nearest])
        )
        late = float(x.share([place])[0]) > 0.55
        text = f"{short(g.name, 40)}\n{words}" if len(groups) <= _FEW else short(g.name, 24)
        write_label(panel, place, to_scale(at), text, g.drawn.colour, side="right" if late else "left", dx=-8 if late else 9, bold=True)  # fmt: skip
    return figure
