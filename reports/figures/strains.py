"""Does the film depend on how far it swings? Stiffness and phase against frequency, an amplitude each (thesis, fig 4-8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import MODEL, RAW, group
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.responses import Lines
from reports.figures.scale import linear, logarithmic
from schemas.arrays import Complex, Float


@dataclass(frozen=True)
class Swing:
    """One amplitude: its name, what was measured, and the stiffness of its model on the common grid, if any."""

    name: str
    lines: Lines
    model: Complex | None


@pictured("by-amplitude")
def by_amplitude(swings: Sequence[Swing], grid: Float, average: Complex | None, *, phase: bool, alt: str) -> Drawing:
    """Magnitude or phase of each amplitude with its model, and of the model of their average."""
    drawing = Drawing(WIDE, 300)

    def shown(value: Complex) -> Float:
        return np.degrees(np.angle(value)) if phase else np.abs(value)

    x = logarithmic(*(s.lines.frequency for s in swings), margin=0.02)
    values = [shown(s.lines.value[s.lines.usable]) for s in swings]
    panel = Panel(drawing, 46, 24, 352, 226, x, linear(*values, zero=True, margin=0.08))
    entries = []
    for i, swing in enumerate(swings):
        drawn, good, f = group(i), swing.lines.usable, swing.lines.frequency
        value = shown(swing.lines.value)
        if swing.model is not None:
            panel.curve(grid, shown(swing.model), drawn.colour, 1.3, dash=drawn.dash)
        panel.dots(f[~good], value[~good], RAW, 3.4, marker=drawn.marker)
        panel.dots(f[good], value[good], drawn.colour, 4.6, marker=drawn.marker)
        if good.any():
            entries.append((float(value[good][-1]), swing.name, drawn.colour, False))
    if average is not None:
        panel.curve(grid, shown(average), MODEL, 2.4, dash="6 3")
        entries.append((float(shown(average[-1:])[0]), "average", MODEL, True))
    panel.names(entries)
    panel.axes("Phase of k, degrees" if phase else "Dynamic stiffness |k|, N/mm", "Frequency, Hz")
    return drawing.told(alt)
