"""How far does a film lift a constant load? Stroke against the squared voltage: in all, and at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, MODEL, SECOND
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import linear
from schemas.arrays import Float


@dataclass(frozen=True)
class StrokeCurve:
    """One test: (n,) levels in kV, strokes and instantaneous parts (n,) mm with limits (n, 2), and the stroke over V²."""

    voltage: Float
    stroke: Float
    stroke_limits: Float
    instant: Float
    instant_limits: Float
    per_square: float


@pictured("isotonic")
def isotonic(curve: StrokeCurve, *, alt: str) -> Drawing:
    """Strokes with their intervals over V², and the line through the origin."""
    drawing = Drawing(WIDE, 330)
    squares = curve.voltage**2
    x = linear(squares, [0.0], zero=True)
    line = np.array([0.0, float(squares.max())])
    panel = Panel(
        drawing,
        60,
        24,
        318,
        250,
        x,
        linear(curve.stroke_limits.ravel(), curve.instant_limits.ravel(), [0.0], margin=0.06),
    )
    panel.level(0.0)
    panel.curve(line, curve.per_square * line, MODEL, 1.4)
    for values, limits, colour in (
        (curve.instant, curve.instant_limits, SECOND),
        (curve.stroke, curve.stroke_limits, INK),
    ):
        for at, (low, high) in zip(squares, limits, strict=True):
            panel.curve(np.array([at, at]), np.array([low, high]), colour, 1.2)
        panel.dots(squares, values, colour, 4.4)
    panel.names(
        [
            (float(curve.stroke[-1]), "at the end", INK, True),
            (float(curve.instant[-1]), "at once", SECOND, False),
        ]
    )
    panel.axes("Stroke, mm", "Squared voltage, kV²")
    return drawing.told(alt)
