"""Steps of voltage and static force: against V², over time, force from capacitance, force by pre-stretch."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from reports.figures.palette import INK, MODEL, RAW, RULE, SECOND, WRONG, group
from reports.figures.plot import Scale, linear, nice, symmetric, tick_text
from reports.figures.printed.axes import (
    Name,
    draw_bars,
    draw_curve,
    draw_held,
    draw_points,
    draw_residual_strip,
    mark_column,
    mark_level,
    name_curves,
    scale_axes,
    write_label,
    write_note,
)
from reports.figures.printed.style import CURVE_PT, POINT_PT, SINGLE, open_axes, styled
from reports.figures.steps import ForceSeries, Trace
from schemas.arrays import Bool, Float

_MOST_TICKS = 8


@styled()
def draw_against_square(
    voltage: Float, step: Float, wrinkled: Bool, slope: float | None, title: str, *, width: str = SINGLE
) -> Figure:
    """The size of steps against V² with the line through zero, and what is off that line in its own unit.

    voltage (n,) kV, step (n,), slope per kV²; wrinkled steps are hollow and not in the line.
    """
    figure, axes = open_axes(width, 78, (2.6, 1.0))
    upper, lower = axes[:, 0]
    square = voltage**2
    x = Scale(0.0, float(square.max()) * 1.08)
    rest = step - (slope or 0.0) * square
    reach = float(np.max(np.abs(rest), initial=1e-9))
    levels = sorted({float(v) for v in np.round(voltage, 2)})
    levels = levels[:: max(1, -(-len(levels) // _MOST_TICKS))]
    places = [v**2 for v in levels]
    scale_axes(upper, x, linear(step, [0.0], zero=True), title, x_labels=False, x_ticks=places)
    scale_axes(
        lower, x, symmetric(1.25 * reach), "Off the line", "Voltage, kV (spaced as V²)", x_ticks=places,
        y_ticks=(-nice(reach), 0, nice(reach)),
    )  # fmt: skip
    lower.set_xticks(places, [tick_text(v) for v in levels])
    mark_level(lower, 0.0, MODEL)
    if slope is not None:
        draw_curve(upper, [0, x.high], [0, slope * x.high], MODEL)
        at = 0.5 * x.high
        write_label(upper, at, slope * at, "∝ V²", MODEL, side="right", dx=-7, dy=3 if slope > 0 else -3, bold=True)
    for mask, colour, hollow in ((~wrinkled, INK, False), (wrinkled, WRONG, True)):
        draw_points(upper, square[mask], step[mask], colour, 1.2 * POINT_PT, hollow=hollow)
        draw_points(lower, square[mask], rest[mask], colour, hollow=hollow)
    if wrinkled.any():
        i = int(np.flatnonzero(wrinkled)[0])
        write_label(upper, float(square[i]), float(step[i]), "○ wrinkled", WRONG, dx=5, dy=-6 if step[i] > 0 else 6, bold=True)  # fmt: skip
    return figure


@styled()
def draw_traces(steps: Sequence[Trace], on_s: float, title: str, *, width: str = SINGLE) -> Figure:
    """The course of steps, a line per voltage, with the time of voltage shaded."""
    figure, axes = open_axes(width, 62)
    (panel,) = axes[:, 0]
    start, end = min(float(t.time.min()) for t in steps), max(float(t.time.max()) for t in steps)
    scale_axes(
        panel,
        Scale(start, end),
        linear(*(t.change for t in steps), [0.0], margin=0.12),
        title,
        "Time after switching on, s",
    )
    mark_column(panel, 0.0, min(on_s, end))
    panel.annotate("voltage on", (0, 1), (3, -6), xycoords=("data", "axes fraction"), textcoords="offset points",
                   fontsize=6.3, color=SECOND, va="center")  # fmt: skip
    names: list[Name] = []
    shades = np.linspace(0.0, 1.0, max(2, len(steps)))
    for trace, shade in zip(steps, shades.tolist(), strict=False):
        colour = WRONG if trace.wrinkled else _mix(RAW, INK, shade)
        draw_curve(panel, trace.time, trace.change, colour, 0.7 * CURVE_PT, (5, 2) if trace.wrinkled else None)
        late = trace.time > 0.8 * on_s
        inside = np.flatnonzero(late & (trace.time < on_s))
        if inside.size:
            name = f"{trace.name} wrinkled" if trace.wrinkled else trace.name
            level = float(np.median(trace.change[inside]))
            panel.plot([on_s, end], [level, level], color=RULE, linewidth=0.4, zorder=1)
            names.append((level, name, WRONG if trace.wrinkled else SECOND, False))
    name_curves(panel, names)
    return figure


def _mix(first: str, second: str, share: float) -> str:
    parts = ((int(first[i : i + 2], 16), int(second[i : i + 2], 16)) for i in (1, 3, 5))
    return "#" + "".join(f"{round(a + (b - a) * share):02x}" for a, b in parts)


@styled()
def draw_sensing(
    strain: Float, force: Float, slope: float | None, intercept: float, kept: Bool, *, width: str = SINGLE
) -> Figure:
    """Force step (mN) against capacitive strain (%), with the fitted line; steps left out of it hollow."""
    figure, axes = open_axes(width, 66)
    (panel,) = axes[:, 0]
    x = linear(strain, [0.0], zero=True)
    scale_axes(panel, x, linear(force, [0.0], zero=True), "Force step, mN", "Capacitive strain, %")
    if slope is not None:
        ends = np.array([x.low, x.high])
        draw_curve(panel, ends, intercept + slope * ends, MODEL)
    draw_points(panel, strain[kept], force[kept], INK, 1.2 * POINT_PT)
    draw_points(panel, strain[~kept], force[~kept], WRONG, 1.2 * POINT_PT, hollow=True)
    if not kept.all():
        write_note(panel, 0.04, 0.93, "○ wrinkled, not in the line", WRONG)
    return figure


@styled()
def draw_forces(series: Sequence[ForceSeries], x_title: str, *, width: str = SINGLE) -> Figure:
    """Static actuation force by pre-stretch in each direction with what the theory expects, and what is off it.

    Dashed: with the permittivity that is stated; solid: with the one that meets all points best (thesis, eq 3.7).
    """
    figure, axes = open_axes(width, 84, (2.4, 1.0))
    upper, lower = axes[:, 0]
    x = linear(*(s.stretch for s in series))
    expected = [1e3 * line for s in series for line in (s.stated, s.fitted) if line is not None]
    scale_axes(upper, x, linear(*(1e3 * s.force for s in series), *expected, [0.0], zero=True), "Actuation force, mN", x_labels=False)  # fmt: skip
    left = draw_residual_strip(lower, x, 7.0, "Residual, SD of the repeats", x_title)
    names: list[Name] = []
    for i, s in enumerate(series):
        drawn, order = group(i), np.argsort(s.stretch, kind="stable")
        if s.stated is not None:
            draw_curve(upper, s.stretch[order], 1e3 * s.stated[order], drawn.colour, 0.6 * CURVE_PT, (5, 2))
        if s.fitted is not None:
            draw_curve(upper, s.stretch[order], 1e3 * s.fitted[order], drawn.colour, 0.9 * CURVE_PT)
        reference = s.fitted if s.fitted is not None else s.stated
        if reference is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                off = (s.force - reference) / s.sd
            draw_held(lower, s.stretch, off, left, drawn.colour, marker=drawn.marker)
        draw_bars(upper, s.stretch, 1e3 * (s.force - 2 * s.sd), 1e3 * (s.force + 2 * s.sd), drawn.colour)
        draw_points(upper, s.stretch, 1e3 * s.force, drawn.colour, 1.2 * POINT_PT, marker=drawn.marker)
        names.append((float(1e3 * s.force[order][-1]), s.name, drawn.colour, True))
    if expected:
        write_note(upper, 0.98, 0.05, "lines: theory; dashed: stated permittivity", side="right")
    else:
        write_note(lower, 0.03, 0.85, "no permittivity stated: nothing to predict from")
    name_curves(upper, names)
    return figure
