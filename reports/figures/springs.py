"""What do a spring and a damper do to the response? One parameter of a model at a time, after the thesis' figures 4-2 and 4-3."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from reports.figures.palette import INK, LOWER, MODEL, RULE, SECOND, WRONG
from reports.figures.plot import WIDE, Panel, linear, logarithmic
from reports.figures.svg import Drawing
from schemas.arrays import Complex, Float

_STYLES = ((MODEL, "6 3"), (WRONG, None), (LOWER, "2 3"), (SECOND, "8 3 2 3"))


@dataclass(frozen=True)
class Variant:
    """A model with one parameter changed: what was changed, and k(jω) (n,)."""

    name: str
    value: Complex


def study(frequency_hz: Float, base: Complex, variants: Sequence[Variant], *, alt: str) -> Markup:
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
    return drawing.image(alt)
