"""What would controllers do? Voltage, capacitance and force after a step of the demand, one above the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import BETTER, group
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import linear, logarithmic
from schemas.arrays import Float


@dataclass(frozen=True)
class Course:
    """One controller at (n,) s: voltage kV, change of the capacitance pF and drop of tension mN with their limits (2,
    n).
    """

    name: str
    time: Float
    voltage: Float
    capacitance: Float
    capacitance_limits: Float
    force: Float
    force_limits: Float


@pictured("controllers")
def controllers(courses: Sequence[Course], demand_pf: float, *, alt: str) -> Drawing:
    """Three panels over the logarithm of time, with the band of the films that the fit leaves possible."""
    height, gap = 112.0, 44.0
    drawing = Drawing(WIDE, 30 + 3 * (height + gap) + 14)
    x = logarithmic(*(one.time for one in courses), margin=0.0)
    panels = (("voltage", "Voltage, kV"), ("capacitance", "Change of the capacitance, pF"), ("force", "Drop of tension, mN"))  # fmt: skip
    for i, (quantity, title) in enumerate(panels):
        values = [getattr(one, quantity) for one in courses]
        y = linear(*values, [demand_pf] if quantity == "capacitance" else [], zero=True, margin=0.1)
        panel = Panel(drawing, 56, 24 + i * (height + gap), 314, height, x, y)
        if quantity == "capacitance":
            panel.level(demand_pf, BETTER, 1.2, dash="5 3")
        names = [(demand_pf, "demand", BETTER, False)] if quantity == "capacitance" else []
        for j, (one, value) in enumerate(zip(courses, values, strict=True)):
            drawn = group(j)
            if quantity != "voltage":
                low, high = getattr(one, f"{quantity}_limits")
                panel.band(one.time, low, high, drawn.colour)
            panel.curve(one.time, value, drawn.colour, 1.7, dash=drawn.dash)
            early = int(np.searchsorted(one.time, 0.06 * 2.2**j))
            panel.dots(one.time[early:][:1], value[early:][:1], drawn.colour, 5.5, marker=drawn.marker)
            if quantity == "voltage":
                names.append((float(value[-1]) + 0.01 * j, f"{drawn.sign} {one.name}", drawn.colour, False))
        panel.names(names)
        panel.axes(title, "Time since the change, s" if i == 2 else "", x_labels=i == 2, y_most=4)
    return drawing.told(alt)
