"""How does a film give way under a load, and does it come back? Displacement over log time, on and off, beside the model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, MODEL, SECOND
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import linear, logarithmic
from schemas.arrays import Float


@dataclass(frozen=True)
class HeldCurve:
    """What follows one change of the load: (n,) s since it, displacement and model in mm; `name` of the curve."""

    name: str
    since: Float
    measured: Float
    modelled: Float


@pictured("creep")
def creep(curves: tuple[HeldCurve, ...], *, alt: str) -> Drawing:
    """Every level of the load from when it was reached: measured windows, the model through them, what is off it below."""
    drawing = Drawing(WIDE, 372)
    x = logarithmic(*(c.since for c in curves), margin=0.03)
    values = [v for c in curves for v in (c.measured, c.modelled)]
    upper = Panel(drawing, 60, 24, 316, 212, x, linear(*values, [0.0], margin=0.06))
    upper.level(0.0)
    names = []
    for i, curve in enumerate(curves):
        upper.curve(curve.since, curve.modelled, MODEL, 1.8)
        upper.dots(curve.since, curve.measured, INK if i == 0 else SECOND, 3.8)
        names.append((float(curve.modelled[-1]), curve.name, INK if i == 0 else SECOND, i == 0))
    upper.names(names)
    upper.axes("Displacement from rest, mm", x_labels=False)
    off = [1e3 * (c.measured - c.modelled) for c in curves]
    lower = Panel(drawing, 60, 252, 316, 74, x, linear(*off, [0.0], margin=0.15))
    lower.level(0.0)
    for i, curve in enumerate(curves):
        lower.dots(curve.since, np.asarray(off[i]), INK if i == 0 else SECOND, 3.2)
    lower.axes("Off the model, µm", "Time since the load changed, s", y_most=3)
    return drawing.told(alt)
