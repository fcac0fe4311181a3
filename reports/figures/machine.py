"""How much of what a machine records is itself? The cost of taking its own compliance off."""

from __future__ import annotations

import numpy as np

from reports.figures.palette import INK, SECOND, WRONG
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.responses import Lines
from reports.figures.scale import logarithmic


@pictured("compliance")
def compliance(lines: Lines, *, alt: str) -> Drawing:
    """Amplification of errors by the machine's own correction; lines that are not used are open."""
    drawing = Drawing(WIDE, 290)
    known = np.isfinite(lines.amplification)
    f, a, good = lines.frequency[known], lines.amplification[known], lines.usable[known]
    panel = Panel(drawing, 46, 24, 372, 218, logarithmic(f, margin=0.015), logarithmic(a, [1.0, 4.0], margin=0.08))
    order = np.argsort(f, kind="stable")
    panel.curve(f[order], a[order], SECOND, 1.2)
    panel.dots(f[good], a[good], INK, 4.4)
    panel.dots(f[~good], a[~good], WRONG, 4.8, open_=True)
    if (~good).any():
        first = int(np.argmin(np.where(good, np.inf, f)))
        panel.label(float(f[first]), float(a[first]), "not used", WRONG, bold=True, anchor="end", dx=-8, dy=0)
    panel.axes("Relative errors of the specimen's response over those of the record", "Frequency, Hz")
    return drawing.told(alt)
