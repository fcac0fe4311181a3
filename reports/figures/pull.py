"""Where does a film break, and which law leads there? Nominal stress against stretch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, MODEL, SECOND
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import linear
from schemas.arrays import Float


@dataclass(frozen=True)
class PullCurve:
    """One pull: (m,) measured stretch and stress in kPa; (k,) those of the law; where it broke, if it did."""

    stretch: Float
    stress: Float
    law: str
    law_stretch: Float
    law_stress: Float
    broke_at: float | None


@pictured("tension")
def pull(curve: PullCurve, *, alt: str) -> Drawing:
    """Measured samples, the law through them, and the break."""
    drawing = Drawing(WIDE, 330)
    x = linear(curve.stretch)
    panel = Panel(drawing, 52, 24, 326, 250, x, linear(curve.stress, curve.law_stress, zero=True))
    panel.dots(curve.stretch, curve.stress, INK, 3.2)
    panel.curve(curve.law_stretch, curve.law_stress, MODEL)
    panel.names([(float(curve.law_stress[-1]), curve.law, MODEL, True)])
    if curve.broke_at is not None:
        left = float(panel.px([curve.broke_at])[0])
        panel.curve(np.full(2, curve.broke_at), np.array([0.0, float(np.max(curve.stress))]), SECOND, 0.9, dash="4 3")
        drawing.write(left - 6, panel.bottom - 8, "break", size=10.7, colour=SECOND, anchor="end")
    panel.axes("Nominal stress, kPa", "Stretch")
    return drawing.told(alt)
