"""Relaxation after a step, and large load–unload cycles."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.cycle import CycleCurve
from reports.figures.cycle import styled as in_order
from reports.figures.palette import INK, MODEL, SECOND
from reports.figures.plot import linear, logarithmic, symmetric
from reports.figures.printed.axes import (
    Name,
    draw_curve,
    draw_points,
    mark_column,
    mark_level,
    name_curves,
    scale_axes,
)
from reports.figures.printed.style import CURVE_PT, POINT_PT, SINGLE, open_axes, styled
from schemas.arrays import Float

_DASHES = {None: None, "6 3": (4.0, 2.0), "1 3": (1.0, 2.0)}


@styled()
def draw_relaxation(
    time: Float, stiffness: Float, model: Float | None, *, unit: str = "N/mm", width: str = SINGLE
) -> Figure:
    """Force over displacement (n,) against the time (n,) s since the step, the model (n,) and what is off it in per cent.

    Without a unit it is output over input of a system of another kind.
    """
    figure, axes = open_axes(width, 78 if model is not None else 58, (2.4, 1.0) if model is not None else (1.0,))
    x = logarithmic(time, margin=0.03)
    upper = axes[0, 0]
    title = f"Force over displacement, {unit}" if unit else "Output over input"
    y = linear(*((stiffness,) if model is None else (stiffness, model)), margin=0.1)
    if model is None:
        scale_axes(upper, x, y, title, "Time since the step, s")
        draw_points(upper, time, stiffness, INK)
        return figure
    lower = axes[1, 0]
    off = 100 * (stiffness / model - 1)
    scale_axes(upper, x, y, title, x_labels=False)
    scale_axes(lower, x, linear(off, [0.0], margin=0.15), "Off the model, %", "Time since the step, s", y_most=3)
    draw_curve(upper, time, model, MODEL)
    draw_points(upper, time, stiffness, INK)
    mark_level(lower, 0.0)
    draw_points(lower, time, off, INK)
    name_curves(upper, [(float(model[-1]), "model", MODEL, True)])
    return figure


@styled()
def draw_cycle(curves: Sequence[CycleCurve], *, width: str = SINGLE) -> Figure:
    """Nominal stress against stretch over a large cycle, measured and by each order; below, what each leaves in time."""
    figure, axes = open_axes(width, 105, (2.4, 1.0))
    upper, lower = axes[:, 0]
    first = curves[0]
    y = linear(first.measured, *(c.modelled for c in curves), zero=True)
    scale_axes(upper, linear(first.stretch), y, "Nominal stress, kPa", "Stretch")
    draw_points(upper, first.stretch, first.measured, INK, 0.8 * POINT_PT)
    reach = max(float(np.max(np.abs(c.measured - c.modelled))) for c in curves)
    scale_axes(lower, linear(first.time, margin=0.01), symmetric(1.1 * max(reach, 1e-9)), "Measured less modelled, kPa", "Time, s", y_most=4)  # fmt: skip
    mark_level(lower, 0.0, SECOND)
    above, below = _draw_orders(upper, lower, curves)
    name_curves(upper, above)
    name_curves(lower, below)
    return figure


@styled()
def draw_cycle_residual(curves: Sequence[CycleCurve], held_out_from: float, *, width: str = SINGLE) -> Figure:
    """Measured less modelled stress over time; the part that is left out to judge the orders is shaded."""
    figure, axes = open_axes(width, 58)
    (panel,) = axes[:, 0]
    first = curves[0]
    reach = max(float(np.max(np.abs(c.measured - c.modelled))) for c in curves)
    scale_axes(panel, linear(first.time, margin=0.01), symmetric(1.1 * max(reach, 1e-9)), "Measured less modelled, kPa", "Time, s")  # fmt: skip
    mark_column(panel, held_out_from, float(first.time.max()))
    panel.annotate("left out to judge", (held_out_from, 1), (3, -6), xycoords=("data", "axes fraction"),
                   textcoords="offset points", fontsize=6.3, color=SECOND, va="center")  # fmt: skip
    mark_level(panel, 0.0, SECOND)
    name_curves(panel, _draw_orders(None, panel, curves)[1])
    return figure


def _draw_orders(upper: Axes | None, lower: Axes, curves: Sequence[CycleCurve]) -> tuple[list[Name], list[Name]]:
    """Each order's stress against stretch and its residual over time, where there are axes for it; their names."""
    above: list[Name] = []
    below: list[Name] = []
    for curve, colour, thick, dash in in_order(curves):
        thickness, dashes = CURVE_PT * thick / 2.1, _DASHES[dash]
        left = curve.measured - curve.modelled
        if upper is not None:
            draw_curve(upper, curve.stretch, curve.modelled, colour, thickness, dashes)
        draw_curve(lower, curve.time, left, colour, thickness, dashes)
        above.append((float(curve.modelled[int(np.argmax(curve.stretch))]), curve.name, colour, curve.selected))
        below.append((float(left[-1]), curve.name, colour, curve.selected))
    return above, below
