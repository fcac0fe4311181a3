"""How does the film relax after a step, and does the model say so?"""

from __future__ import annotations

from markupsafe import Markup

from reports.figures.palette import INK, MODEL
from reports.figures.plot import WIDE, Panel, linear, logarithmic
from reports.figures.svg import Drawing
from schemas.arrays import Float


def relaxation(time: Float, stiffness: Float, model: Float | None, *, alt: str, unit: str = "N/mm") -> Markup:
    """Force over displacement (n,) against the time since the step (n,) s, the model (n,) and what is off it below.

    Without a unit it is output over input of a system of another kind.
    """
    drawing = Drawing(WIDE, 344 if model is not None else 262)
    x = logarithmic(time, margin=0.03)
    drawn = (stiffness,) if model is None else (stiffness, model)
    upper = Panel(drawing, 60, 24, 350, 192 if model is None else 176, x, linear(*drawn, margin=0.1))
    if model is not None:
        upper.curve(time, model, MODEL, 1.8)
    upper.dots(time, stiffness, INK, 4.2)
    title = f"Force over displacement, {unit}" if unit else "Output over input"
    if model is None:
        upper.axes(title, "Time since the step, s")
        return drawing.image(alt)
    upper.names([(float(model[-1]), "model", MODEL, True)])
    upper.axes(title, x_labels=False)
    off = 100 * (stiffness / model - 1)
    lower = Panel(drawing, 60, 226, 350, 72, x, linear(off, [0.0], margin=0.15))
    lower.level(0.0)
    lower.dots(time, off, INK, 3.6)
    lower.axes("Off the model, %", "Time since the step, s", y_most=3)
    return drawing.image(alt)
