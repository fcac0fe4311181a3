"""What a simulation gets wrong: measured against plain and extended model, misfit by recording, error on data left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from reports.figures.comparison import Compared, broken, comparison_reach, shown_scale, write_times
from reports.figures.palette import BAND, BETTER, INK, MODEL, RULE, SECOND, WRONG, misfit
from reports.figures.plot import Scale, linear, logarithmic
from reports.figures.printed.axes import (
    Name,
    draw_bars,
    draw_curve,
    draw_held,
    draw_points,
    draw_residual_strip,
    mark_box,
    mark_column,
    name_curves,
    scale_axes,
    write_label,
)
from reports.figures.printed.style import CURVE_PT, POINT_PT, SINGLE, TICK_PT, open_axes, styled
from reports.names import short
from schemas.arrays import Float

_HEADROOM = -1.4
"""Upper end of the axis of parts: room for the names over the first."""
_DARK = 4.2
"""Misfit from which the number in a cell is white."""


@styled()
def draw_comparison(data: Compared, *, width: str = SINGLE) -> Figure:
    """Measured dots ± 2 SD with the plain (blue) and the extended model (green); below, what each leaves in SD."""
    figure, axes = open_axes(width, 84, (2.4, 1.0))
    upper, lower = axes[:, 0]
    x = logarithmic(data.x, margin=0.02) if data.x_log else linear(data.x, margin=0.04)
    ticks = [place for place, _ in data.groups] if data.groups else None
    measured, plain = data.shown(data.measured), data.shown(data.plain)
    models = [("plain", plain, MODEL, "square")]
    if data.extended is not None:
        models.append(("extended", data.shown(data.extended), BETTER, "triangle"))
    y = shown_scale(data, [measured, *(m[1] for m in models)])
    scale_axes(upper, x, y, data.shown_title, x_labels=False, x_ticks=ticks)
    draw_bars(upper, data.x, measured - 2 * data.spread, measured + 2 * data.spread, INK)
    draw_held(upper, data.x, measured, y, INK)
    order = np.argsort(data.x, kind="stable")
    names: list[Name] = []
    for name, value, colour, marker in models:
        if data.lines:
            drawn = order[data.sharp[order]] if data.x_log else order
            course = data.x[drawn], value[drawn]
            draw_curve(upper, *(course if data.x_log else broken(*course)), colour, CURVE_PT)
        else:
            draw_points(upper, data.x, value, colour, 1.3 * POINT_PT, marker=marker, hollow=True)
        names.append((float(value[int(np.argmax(data.x))]), name, colour, True))
    left = draw_residual_strip(lower, x, comparison_reach(data), "Residual, SD", data.x_title)
    if data.groups:
        lower.set_xticks([place for place, _ in data.groups], [text for _, text in data.groups])
    draw_held(lower, data.residual_x, data.residual(data.plain), left, WRONG, hollow=True)
    words = [(f"○ plain: {write_times(data.rms(data.plain))}", WRONG)]
    if data.extended is not None:
        draw_held(lower, data.residual_x, data.residual(data.extended), left, BETTER, 0.9 * POINT_PT)
        words.append((f"● extended: {write_times(data.rms(data.extended))}", BETTER))
    offset = 0.0
    for text, colour in reversed(words):
        lower.annotate(
            text, (1, 1), (-offset, 5), xycoords="axes fraction", textcoords="offset points", ha="right", va="baseline",
            fontsize=TICK_PT, color=colour, fontweight="bold", annotation_clip=False,
        )  # fmt: skip
        offset += 0.6 * TICK_PT * len(text) + 5
    name_curves(upper, names)
    return figure


@styled()
def draw_residual_map(
    rms: Float, rows: Sequence[str], columns: Sequence[str], title: str, *, width: str = SINGLE
) -> Figure:
    """Recording × quantity: root mean square residual in SD, the number in every cell; a dot where nothing was measured."""
    figure, axes = open_axes(width, 16 + 4.6 * len(rows) + (14 if len(columns) > 4 else 4))
    (panel,) = axes[:, 0]
    panel.set(xlim=(0, len(columns)), ylim=(len(rows), 0))
    for i in range(len(rows)):
        for j in range(len(columns)):
            value = float(rms[i, j])
            if np.isnan(value):
                draw_points(panel, [j + 0.5], [i + 0.5], RULE, 1.8)
                continue
            mark_box(panel, j + 0.03, j + 0.97, i + 0.05, i + 0.95, misfit(value), RULE)
            text = f"{value:.1f}" if value < 99.5 else f"{value:.0f}"
            panel.text(j + 0.5, i + 0.53, text, ha="center", va="center", fontsize=TICK_PT, color="white" if value > _DARK else INK)  # fmt: skip
    turned = len(columns) > 4
    panel.set_xticks(
        [j + 0.5 for j in range(len(columns))], [short(c, 20) for c in columns],
        rotation=35 if turned else 0, ha="right" if turned else "center",
    )  # fmt: skip
    panel.set_yticks([i + 0.5 for i in range(len(rows))], [short(r, 22) for r in rows])
    panel.tick_params(length=0, labelcolor=INK)
    panel.spines[:].set_visible(False)
    panel.set_title(title)
    return figure


@styled()
def draw_held_out(
    names: Sequence[str], before: Sequence[float], after: Sequence[float | None], *, width: str = SINGLE
) -> Figure:
    """Error on data that the fit has not seen, plain and extended model, in SD of the noise; the band is noise alone."""
    figure, axes = open_axes(width, 21 + 5.0 * len(names))
    (panel,) = axes[:, 0]
    most = max(1.3, *before, *(a for a in after if a is not None))
    scale_axes(
        panel, Scale(0.5, most * 1.06), Scale(len(names) - 0.4, _HEADROOM), "Predicting what the fit has not seen",
        "Error of the prediction, SD of the noise (1 = noise alone)", y_ticks=(),
    )  # fmt: skip
    mark_column(panel, 0.8, 1.2, BAND)
    panel.axvline(1.0, color=SECOND, linewidth=0.6)
    for i, (first, second) in enumerate(zip(before, after, strict=True)):
        if second is not None:
            panel.plot([first, second], [i, i], color="#7c8791", linewidth=0.7)
            draw_points(panel, [second], [i], BETTER, 1.7 * POINT_PT)
        draw_points(panel, [first], [i], WRONG, 1.7 * POINT_PT, hollow=True)
        text = f"{first:.1f}" + (f" → {second:.1f}" if second is not None else "")
        panel.annotate(text, (1, i), (5, 0), xycoords=("axes fraction", "data"), textcoords="offset points", va="center", annotation_clip=False)  # fmt: skip
    panel.set_yticks(range(len(names)), [short(n, 22) for n in names])
    panel.tick_params(axis="y", length=0, labelcolor=INK)
    heads = [(before[0], "○ plain", WRONG)]
    if after[0] is not None and abs(before[0] - after[0]) > 0.2 * most:
        heads.append((after[0], "● extended", BETTER))
    for place, text, colour in heads:
        write_label(panel, place, 0.55 * _HEADROOM, text, colour, dx=-3, side="left", bold=True)
    return figure
