"""How does the force go with a slow voltage? Its drop against the squared voltage, with the line through the origin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, MODEL
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import linear
from schemas.arrays import Float


@dataclass(frozen=True)
class DropCurve:
    """One test: (n,) voltage in kV and drop of force in N, drift taken off; and the drop over V² in N/kV²."""

    voltage: Float
    drop: Float
    per_square: float


@pictured("slow-voltage")
def slow_voltage(curve: DropCurve, *, alt: str) -> Drawing:
    """Samples over V², and the line that goes with it."""
    drawing = Drawing(WIDE, 330)
    squares = curve.voltage**2
    line = np.array([0.0, float(squares.max())])
    panel = Panel(drawing, 60, 24, 318, 250, linear(squares, [0.0], zero=True), linear(curve.drop, [0.0], margin=0.06))
    panel.level(0.0)
    panel.dots(squares, curve.drop, INK, 2.0)
    panel.curve(line, curve.per_square * line, MODEL, 1.4)
    panel.axes("Drop of force, N", "Squared voltage, kV²")
    return drawing.told(alt)
