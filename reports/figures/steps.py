"""Does force follow V²? Does capacitance follow force? Steps of voltage and what the film answers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import BAND, INK, MODEL, RAW, RULE, SECOND, WRONG, group
from reports.figures.panel import WIDE, Drawing, Panel, note
from reports.figures.picture import pictured
from reports.figures.scale import Scale, linear, logarithmic, nice, symmetric, tick_text
from schemas.arrays import Bool, Float


@pictured("voltage-squared")
def against_square(
    voltage: Float, step: Float, wrinkled: Bool, slope: float | None, title: str, *, alt: str
) -> Drawing:
    """The size of steps against V² with the line through zero; residual from that line below, in its own unit.

    voltage (n,) kV, step (n,), slope per kV².
    """
    drawing = Drawing(WIDE, 330)
    square = voltage**2
    x = Scale(0.0, float(square.max()) * 1.08)
    upper = Panel(drawing, 46, 24, 392, 168, x, linear(step, [0.0], zero=True))
    rest = step - (slope or 0.0) * square
    reach = float(np.max(np.abs(rest), initial=1e-9))
    lower = Panel(drawing, 46, 222, 392, 62, x, symmetric(1.25 * reach))
    if slope is not None:
        upper.curve([0, x.high], [0, slope * x.high], MODEL, 1.8)
        inside = min(0.55 * x.high, 0.8 * float(np.abs(step).max()) / max(abs(slope), 1e-300))
        upper.label(
            inside,
            slope * inside,
            "∝ V²",
            MODEL,
            bold=True,
            anchor="end",
            dx=-10,
            dy=-4 if slope > 0 else 18,
        )
    lower.level(0.0, MODEL, 1.2)
    for mask, colour, open_ in ((~wrinkled, INK, False), (wrinkled, WRONG, True)):
        upper.dots(square[mask], step[mask], colour, 5.0, open_=open_)
        lower.dots(square[mask], rest[mask], colour, 4.4, open_=open_)
    if wrinkled.any():
        i = int(np.flatnonzero(wrinkled)[-1])
        upper.label(float(square[i]), float(step[i]), "wrinkled", WRONG, bold=True, dx=8, dy=14 if step[i] > 0 else -8)
    ticks = sorted({float(v) for v in np.round(voltage, 2)})
    ticks = ticks[:: max(1, -(-len(ticks) // 9))]
    upper.axes(title, x_labels=False, x_ticks=[t**2 for t in ticks])
    unit = title.rpartition(", ")[2]
    lower.axes(
        f"Off the line, {unit}", "Voltage, kV (spaced as V²)", x_ticks=[], y_ticks=(-nice(reach), 0, nice(reach))
    )
    for t in ticks:
        p = float(lower.px([t**2])[0])
        drawing.segments([(p, lower.bottom, p, lower.bottom + 4.5)], SECOND)
        drawing.write(p, lower.bottom + 17.3, tick_text(t), size=11.3, colour=SECOND, anchor="middle")
    return drawing.told(alt)


@dataclass(frozen=True)
class Trace:
    """One recorded step, set to zero before it: time after switching on in s, change of the quantity.

    `expected` is the change that growth with V² predicts at its voltage, where that was fitted.
    """

    name: str
    time: Float
    change: Float
    wrinkled: bool = False
    expected: float | None = None


@pictured("step-response")
def traces(steps: Sequence[Trace], on_s: float, title: str, *, alt: str) -> Drawing:
    """The course of steps, one line per voltage, with the time of voltage shaded."""
    drawing = Drawing(WIDE, 262)
    end = max(float(t.time.max()) for t in steps)
    start = min(float(t.time.min()) for t in steps)
    expected = [t.expected for t in steps if t.expected is not None]
    y = linear(*(t.change for t in steps), expected, [0.0], margin=0.12)
    panel = Panel(drawing, 46, 24, 338, 192, Scale(start, end), y)
    panel.column(0.0, min(on_s, end))
    drawing.write(float(panel.px([0.0])[0]) + 5, panel.top + 12, "voltage on", size=10.7, colour=SECOND)
    entries = []
    for trace in steps:
        colour = WRONG if trace.wrinkled else RAW
        panel.curve(trace.time, trace.change, colour, 1.3, dash="6 3" if trace.wrinkled else None)
        if trace.expected is not None:
            panel.curve([0.0, 0.0, on_s, on_s], [0.0, trace.expected, trace.expected, 0.0], MODEL, 1.2, dash="5 3")
        inside = np.flatnonzero((trace.time > 0.8 * on_s) & (trace.time < on_s))
        if inside.size:
            name = f"{trace.name} wrinkled" if trace.wrinkled else trace.name
            level = float(np.median(trace.change[inside]))
            drawing.line(
                [(float(panel.px([on_s])[0]), float(panel.py([level])[0])), (panel.right, float(panel.py([level])[0]))],
                RULE,
                0.7,
            )
            entries.append((level, name, WRONG if trace.wrinkled else SECOND, False))
    panel.names(entries)
    if expected:
        upwards = abs(panel.y.high) > abs(panel.y.low)
        drawing.write(
            float(panel.px([end])[0]), panel.top - 8 if upwards else panel.bottom - 6, "– – simulated: ∝ V²",
            size=11.3, colour=MODEL, anchor="end",
        )  # fmt: skip
    panel.axes(title, "Time after switching on, s")
    return drawing.told(alt)


@pictured("sensing")
def sensing(strain: Float, force: Float, slope: float | None, intercept: float, kept: Bool, *, alt: str) -> Drawing:
    """Force step (mN) against capacitive strain (%), with the fitted line; steps left out of it open."""
    drawing = Drawing(WIDE, 290)
    x, y = linear(strain, [0.0], zero=True), linear(force, [0.0], zero=True)
    panel = Panel(drawing, 46, 24, 392, 218, x, y)
    if slope is not None:
        ends = np.array([0.0, x.high])
        panel.curve(ends, intercept + slope * ends, MODEL, 1.8)
    panel.dots(strain[kept], force[kept], INK, 5.0)
    panel.dots(strain[~kept], force[~kept], WRONG, 5.0, open_=True)
    panel.axes("Force step, mN", "Capacitive strain, %")
    return drawing.told(alt)


@dataclass(frozen=True)
class Level:
    """Lines of one kind that a linear system would leave empty, at n frequencies."""

    kind: str
    frequency: Float
    level: Float


@pictured("distortion")
def distortion(levels: Sequence[Level], unit: str, *, alt: str) -> Drawing:
    """Levels of even and odd lines against the noise."""
    drawing = Drawing(WIDE, 262)
    x = logarithmic(*(v.frequency for v in levels), margin=0.03)
    panel = Panel(drawing, 56, 24, 352, 192, x, logarithmic(*(v.level for v in levels), margin=0.08))
    colours = {"even": (WRONG, "circle", False), "odd": (MODEL, "square", False), "noise": (RAW, "circle", True)}
    entries = []
    for v in sorted(levels, key=lambda v: v.kind != "noise"):
        colour, marker, open_ = colours.get(v.kind, (INK, "diamond", False))
        panel.dots(v.frequency, v.level, colour, 4.2, marker=marker, open_=open_)
        positive = v.level[v.level > 0]
        if positive.size:
            entries.append((float(np.median(positive)), v.kind, colour if v.kind != "noise" else SECOND, True))
    panel.names(entries)
    panel.axes(f"Level of lines left empty, {unit}", "Frequency, Hz")
    return drawing.told(alt)


@dataclass(frozen=True)
class ForceSeries:
    """Static force of n points in N with its SD; what the stated and the fitted permittivity let expect, where known."""

    name: str
    stretch: Float
    force: Float
    sd: Float
    stated: Float | None
    fitted: Float | None


@pictured("force-map")
def forces(series: Sequence[ForceSeries], x_title: str, *, alt: str) -> Drawing:
    """Static actuation force by pre-stretch per direction, with eq 3.7 and the residual from it below."""
    drawing = Drawing(WIDE, 344)
    x = linear(*(s.stretch for s in series))
    expected = [1e3 * line for s in series for line in (s.stated, s.fitted) if line is not None]
    upper = Panel(drawing, 46, 24, 332, 176, x, linear(*(1e3 * s.force for s in series), *expected, [0.0], zero=True))
    lower = Panel(drawing, 46, 226, 332, 72, x, symmetric(7))
    lower.across(-2, 2, BAND)
    lower.level(0.0)
    entries = []
    for i, s in enumerate(series):
        drawn = group(i)
        order = np.argsort(s.stretch, kind="stable")
        if s.stated is not None:
            upper.curve(s.stretch[order], 1e3 * s.stated[order], drawn.colour, 1.2, dash="6 3")
        if s.fitted is not None:
            upper.curve(s.stretch[order], 1e3 * s.fitted[order], drawn.colour, 1.8)
        reference = s.fitted if s.fitted is not None else s.stated
        if reference is not None:
            with np.errstate(divide="ignore", invalid="ignore"):
                lower.held(s.stretch, (s.force - reference) / s.sd, drawn.colour, 4.0)
        upper.bars(s.stretch, 1e3 * (s.force - 2 * s.sd), 1e3 * (s.force + 2 * s.sd), drawn.colour)
        upper.dots(s.stretch, 1e3 * s.force, drawn.colour, 5.0, marker=drawn.marker)
        entries.append((float(1e3 * s.force[order][-1]), s.name, drawn.colour, True))
    upper.names(entries)
    upper.axes("Actuation force, mN", x_labels=False)
    lower.axes("Residual from eq 3.7, SD of the repeats", x_title, y_ticks=(-5, 0, 5))
    if not expected:
        note(drawing, lower.left + 8, lower.top + 14, "no permittivity stated: nothing to predict from")
    return drawing.told(alt)
