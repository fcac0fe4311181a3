"""How does the film relax: after a step, by the number of arms of its model, and by each spring and damper?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, LOWER, MODEL, RULE, SECOND, WRONG
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import linear, logarithmic
from schemas.arrays import Complex, Float


@pictured("relaxation")
def relaxation(time: Float, stiffness: Float, model: Float | None, *, alt: str, unit: str = "N/mm") -> Drawing:
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
        return drawing.told(alt)
    upper.names([(float(model[-1]), "model", MODEL, True)])
    upper.axes(title, x_labels=False)
    off = 100 * (stiffness / model - 1)
    lower = Panel(drawing, 60, 226, 350, 72, x, linear(off, [0.0], margin=0.15))
    lower.level(0.0)
    lower.dots(time, off, INK, 3.6)
    lower.axes("Off the model, %", "Time since the step, s", y_most=3)
    return drawing.told(alt)


@pictured("error-by-arms")
def error_by_arms(arms: Float, error: Float, enough: int | None, *, alt: str) -> Drawing:
    """Relative error in % of (n,) numbers of arms; the least that is enough is marked."""
    drawing = Drawing(WIDE, 290)
    panel = Panel(drawing, 52, 24, 386, 218, logarithmic(arms, margin=0.04), logarithmic(100 * error, margin=0.08))
    panel.curve(arms, 100 * error, SECOND, 1.2)
    chosen = arms == enough
    panel.dots(arms[~chosen], 100 * error[~chosen], INK, 4.6)
    if chosen.any():
        panel.dots(arms[chosen], 100 * error[chosen], MODEL, 6.0)
        panel.label(float(arms[chosen][0]), float(100 * error[chosen][0]), "enough ✓", MODEL, bold=True, dx=4, dy=-9)
    panel.axes("Relative error, %", "Arms")
    return drawing.told(alt)


_STYLES = ((MODEL, "6 3"), (WRONG, None), (LOWER, "2 3"), (SECOND, "8 3 2 3"))


@dataclass(frozen=True)
class Variant:
    """A model with one parameter changed: what was changed, and k(jω) (n,)."""

    name: str
    value: Complex


@pictured("parameter-study")
def study(frequency_hz: Float, base: Complex, variants: Sequence[Variant], *, alt: str) -> Drawing:
    """Magnitude above, phase below: the model as it is in ink, each change in its own colour and dash."""
    drawing = Drawing(WIDE, 344)
    x = logarithmic(frequency_hz, margin=0.0)
    values = [base, *(v.value for v in variants)]
    upper = Panel(drawing, 46, 24, 326, 160, x, linear(*(np.abs(v) for v in values), [0.0], zero=True))
    lower = Panel(drawing, 46, 210, 326, 88, x, linear(*(np.degrees(np.angle(v)) for v in values), [0.0], zero=True))
    lower.level(0.0, RULE)
    for panel, part in ((upper, np.abs), (lower, lambda v: np.degrees(np.angle(v)))):
        for variant, (colour, dash) in zip(variants, _STYLES, strict=False):
            panel.curve(frequency_hz, part(variant.value), colour, 1.6, dash=dash)
        panel.curve(frequency_hz, part(base), INK, 1.9)
    middle = frequency_hz.size * 2 // 3
    entries = [(float(np.abs(base)[-1]), "as it is", INK, True)]
    entries += [
        (float(np.abs(v.value)[-1]) + 1e-6 * float(np.abs(v.value)[middle]), v.name, colour, False)
        for v, (colour, _) in zip(variants, _STYLES, strict=False)
    ]
    upper.names(entries)
    upper.axes("Dynamic stiffness |k|, N/mm", x_labels=False)
    lower.axes("Phase of k, degrees", "Frequency, Hz", y_most=4)
    return drawing.told(alt)
