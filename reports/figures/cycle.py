"""Does the model follow a large cycle? Nominal stress against stretch, and what each order leaves in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, LOWER, LOWEST, MODEL, SECOND
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import linear, symmetric
from schemas.arrays import Float
from schemas.numbers import ordinal

_STYLES = ((MODEL, 2.1, None), (LOWER, 1.5, "6 3"), (LOWEST, 1.3, "1 3"))


@dataclass(frozen=True)
class CycleCurve:
    """One order over the cycle: (m,) s, stretch, measured and modelled nominal stress in kPa."""

    order: int
    selected: bool
    time: Float
    stretch: Float
    measured: Float
    modelled: Float

    @property
    def name(self) -> str:
        return f"{ordinal(self.order)} order{' ✓' if self.selected else ''}"


def styled(curves: Sequence[CycleCurve]) -> list[tuple[CycleCurve, str, float, str | None]]:
    """The curves, the chosen one last and strongest, with colour, width and dashes."""
    order = sorted(curves, key=lambda c: (not c.selected, c.order))[: len(_STYLES)]
    return [(c, *_STYLES[i]) for i, c in enumerate(order)][::-1]


@pictured("cycle", whole={"residual": True})
def loop(curves: Sequence[CycleCurve], *, alt: str, residual: bool = False) -> Drawing:
    """Stress against stretch: measured points, and the models through them; with `residual` what each leaves, below."""
    drawing = Drawing(WIDE, 480 if residual else 330)
    first = curves[0]
    x, y = linear(first.stretch), linear(first.measured, *(c.modelled for c in curves), zero=True)
    panel = Panel(drawing, 52, 24, 326, 250, x, y)
    panel.dots(first.stretch, first.measured, INK, 3.2)
    names = []
    for curve, colour, width, dash in styled(curves):
        panel.curve(curve.stretch, curve.modelled, colour, width, dash=dash)
        top = int(np.argmax(curve.stretch))
        names.append((float(curve.modelled[top]), curve.name, colour, curve.selected))
    panel.names(names)
    panel.axes("Nominal stress, kPa", "Stretch")
    if residual:
        _draw_left(_open_left(drawing, 350, 80, curves), curves)
    return drawing.told(alt)


@pictured("cycle-residual")
def rest(curves: Sequence[CycleCurve], held_out_from: float, *, alt: str) -> Drawing:
    """Measured minus modelled stress over time; the part that is left out to judge the orders is shaded."""
    drawing = Drawing(WIDE, 330)
    panel = _open_left(drawing, 24, 250, curves)
    panel.column(held_out_from, float(curves[0].time.max()))
    drawing.write(
        float(panel.px([held_out_from])[0]) + 5, panel.top + 12, "left out to judge", size=10.7, colour=SECOND
    )
    _draw_left(panel, curves)
    return drawing.told(alt)


def _open_left(drawing: Drawing, top: float, height: float, curves: Sequence[CycleCurve]) -> Panel:
    """Axes for what the orders leave over time."""
    reach = max(float(np.max(np.abs(c.measured - c.modelled))) for c in curves)
    x, y = linear(curves[0].time, margin=0.01), symmetric(1.1 * max(reach, 1e-9))
    return Panel(drawing, 52, top, 326, height, x, y)


def _draw_left(panel: Panel, curves: Sequence[CycleCurve]) -> None:
    """What each order leaves, over time."""
    panel.level(0.0, SECOND)
    names = []
    for curve, colour, width, dash in styled(curves):
        left = curve.measured - curve.modelled
        panel.curve(curve.time, left, colour, width, dash=dash)
        names.append((float(left[-1]), curve.name, colour, curve.selected))
    panel.names(names)
    panel.axes("Measured less modelled, kPa", "Time, s")
