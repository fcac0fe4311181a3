"""Does the film's mechanical model predict what it does under voltage? Electrical responses and the blocked force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import BETTER, LOWER, LOWEST, MODEL, RAW, SECOND, group
from reports.figures.panel import WIDE, Drawing, Panel, note
from reports.figures.picture import pictured
from reports.figures.responses import Lines, beyond
from reports.figures.scale import linear, logarithmic, symmetric
from schemas.arrays import Complex, Float


@dataclass(frozen=True)
class Drive:
    """The electrical response of one recording, its name (the voltage), and the prediction on its lines, if any."""

    name: str
    lines: Lines
    predicted: Complex | None


@pictured("force-under-voltage")
def response(drives: Sequence[Drive], grid: Float, predicted: Complex | None, *, alt: str) -> Drawing:
    """|H| of each recording with the prediction from the mechanical fit, residual below."""
    drawing = Drawing(WIDE, 344)
    x = logarithmic(*(d.lines.frequency for d in drives), margin=0.015)
    values = [1e3 * np.abs(d.lines.value)[d.lines.usable] for d in drives]
    y = logarithmic(*values, 1e3 * np.abs(predicted) if predicted is not None else [], margin=0.08)
    upper = Panel(drawing, 46, 24, 352, 176, x, y)
    lower = Panel(drawing, 46, 226, 352, 72, x, symmetric(7))
    lower.across(-2, 2)
    lower.level(0)
    entries = []
    for i, drive in enumerate(drives):
        drawn, good = group(i), drive.lines.usable
        magnitude = 1e3 * np.abs(drive.lines.value)
        spread = 1e3 * drive.lines.component
        f = drive.lines.frequency
        upper.bars(f[good], (magnitude - 2 * spread)[good], (magnitude + 2 * spread)[good], drawn.colour, 0.8)
        upper.dots(f[~good], magnitude[~good], RAW, 3.2, marker=drawn.marker)
        upper.dots(f[good], magnitude[good], drawn.colour, 4.0, marker=drawn.marker)
        if good.any():
            entries.append((float(magnitude[good][-1]), drive.name, drawn.colour, False))
        if drive.predicted is not None:
            off = (np.abs(drive.lines.value) - np.abs(drive.predicted)) / drive.lines.component
            lower.held(f[good], off[good], drawn.colour, 3.8)
    if predicted is not None:
        upper.curve(grid, 1e3 * np.abs(predicted), MODEL)
        entries.append((float(1e3 * np.abs(predicted[-1])), "predicted", MODEL, True))
    upper.names(entries)
    upper.axes("Force per voltage squared |F/V²|, mN/kV²", x_labels=False)
    lower.axes("Residual, SD of the noise", "Frequency, Hz", y_ticks=(-5, 0, 5))
    drawing.write(lower.right + 6, float(lower.py([0])[0]) + 4, "±2 SD", size=11.3, colour=SECOND)
    if predicted is None:
        note(drawing, lower.left + 8, lower.top + 14, "no mechanical model: nothing to predict from")
    return drawing.told(alt)


@pictured("blocked-force")
def blocked_force(drives: Sequence[Drive], fitted: float | None, fitted_sd: float | None, *, alt: str) -> Drawing:
    """The actuation force itself, freed of film and rig: flat where nothing but V² acts."""
    drawing = Drawing(WIDE, 344)
    x = logarithmic(*(d.lines.frequency for d in drives), margin=0.015)
    values = [1e3 * np.abs(d.lines.value)[d.lines.usable] for d in drives]
    upper = Panel(drawing, 46, 24, 352, 150, x, linear(*values, [0.0], margin=0.12, zero=True))
    angles = [np.degrees(np.angle(d.lines.value)) for d in drives]
    inside = [a[d.lines.usable] for a, d in zip(angles, drives, strict=True)]
    lower = Panel(drawing, 46, 206, 352, 92, x, linear(*inside, [-10.0, 10.0], margin=0.1))
    first = drives[0].lines
    for low, high in beyond(first.frequency, first.amplification):
        upper.column(low, high)
        lower.column(low, high)
    entries = []
    if fitted is not None:
        sd = fitted_sd or 0.0
        ends = np.array([x.low, x.high])
        upper.band(ends, np.full(2, 1e3 * (fitted - 1.96 * sd)), np.full(2, 1e3 * (fitted + 1.96 * sd)), BETTER, ".22")
        upper.level(1e3 * fitted, BETTER, 1.8)
        entries.append((1e3 * fitted, "fitted, flat", BETTER, True))
    lower.level(0.0, "#c9ced4")
    for i, (drive, angle) in enumerate(zip(drives, angles, strict=True)):
        drawn, good, f = group(i), drive.lines.usable, drive.lines.frequency
        magnitude, spread = 1e3 * np.abs(drive.lines.value), 1e3 * drive.lines.component
        upper.bars(f[good], (magnitude - 2 * spread)[good], (magnitude + 2 * spread)[good], drawn.colour, 0.8)
        upper.dots(f[~good], magnitude[~good], RAW, 3.2, marker=drawn.marker)
        upper.dots(f[good], magnitude[good], drawn.colour, 4.0, marker=drawn.marker)
        lower.dots(f[~good], angle[~good], RAW, 3.2, marker=drawn.marker)
        lower.dots(f[good], angle[good], drawn.colour, 4.0, marker=drawn.marker)
        if good.any() and len(drives) > 1:
            entries.append((float(np.median(magnitude[good])), drive.name, drawn.colour, False))
    upper.names(entries)
    upper.axes("Blocked force per voltage squared, mN/kV²", x_labels=False)
    lower.axes("Its phase, degrees", "Frequency, Hz", y_most=4)
    return drawing.told(alt)


@dataclass(frozen=True)
class Ordered:
    """One recording in one form: its name, the measured lines, and the model of each order on them."""

    name: str
    lines: Lines
    models: dict[int, Complex]


@pictured("orders")
def orders(recordings: Sequence[Ordered], chosen: int | None, *, phase: bool, title: str, alt: str) -> Drawing:
    """Magnitude or phase of the force per voltage squared at each voltage, and the models of each order (thesis, fig 4-17)."""
    drawing = Drawing(WIDE, 290)

    def shown(value: Complex) -> Float:
        return np.degrees(np.unwrap(np.angle(value))) if phase else 1e3 * np.abs(value)

    x = logarithmic(*(r.lines.frequency for r in recordings), margin=0.015)
    values = [shown(r.lines.value)[r.lines.usable] for r in recordings]
    panel = Panel(drawing, 46, 24, 352, 216, x, linear(*values, zero=True, margin=0.1))
    entries = []
    for i, recording in enumerate(recordings):
        drawn, good, f = group(i), recording.lines.usable, recording.lines.frequency
        value = shown(recording.lines.value)
        panel.dots(f[~good], value[~good], RAW, 3.2, marker=drawn.marker)
        panel.held(f[good], value[good], drawn.colour, 4.0)
        if good.any() and len(recordings) > 1:
            entries.append((float(value[good][-1]), recording.name, drawn.colour, False))
    first = recordings[0]
    for order, model in sorted(first.models.items()):
        colour, width, dash = (MODEL, 2.1, None) if order == chosen else ORDER_LINES.get(order, (SECOND, 1.5, "2 4"))
        panel.curve(first.lines.frequency, shown(model), colour, width, dash=dash)
        mark = " ✓" if order == chosen else ""
        entries.append((float(shown(model)[-1]), f"order {order}{mark}", colour, order == chosen))
    panel.names(entries)
    panel.axes(title, "Frequency, Hz")
    return drawing.told(alt)


ORDER_LINES = {1: (LOWEST, 1.8, "1.5 3"), 2: (LOWER, 1.7, "6 3"), 3: (LOWER, 1.7, "9 3")}
"""Colour, width and dashes of the orders that are not the chosen one."""
