"""What force has an actuator left when it moves? The line from blocked force to free stroke."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from reports.figures.palette import group
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import apart, linear
from schemas.arrays import Float

_LINE = 14.5
"""Height of a line of names, px."""


@dataclass(frozen=True)
class Line:
    """Force (n,) N with its 95 % limits over stroke (n,) mm at one frequency, which is its name."""

    name: str
    stroke: Float
    force: Float
    lower: Float
    upper: Float


@pictured("force-stroke")
def force_stroke(lines: Sequence[Line], *, alt: str) -> Drawing:
    """Force over stroke with its band, a line for each frequency; dots where it gives most work."""
    drawing = Drawing(WIDE, 280)
    x = linear(*(one.stroke for one in lines), zero=True, margin=0.03)
    panel = Panel(drawing, 46, 24, 352, 206, x, linear(*(one.upper for one in lines), zero=True, margin=0.08))
    names: list[tuple[float, float, str, str]] = []
    for i, one in enumerate(lines):
        drawn = group(i)
        panel.band(one.stroke, one.lower, one.upper, drawn.colour)
        panel.curve(one.stroke, one.force, drawn.colour, dash=drawn.dash)
        middle = [one.stroke[-1] / 2], [one.force[0] / 2]
        panel.dots(*middle, drawn.colour, 5.0, marker=drawn.marker)
        names.append(
            (
                float(panel.py(middle[1])[0]) - 5,
                float(panel.px(middle[0])[0]) + 9,
                f"{drawn.sign} {one.name}",
                drawn.colour,
            )
        )
    names.sort()
    places = apart([name[0] for name in names], _LINE, panel.top + _LINE, panel.bottom - 5)
    for y, (_, left, text, colour) in zip(places, names, strict=True):
        drawing.write(left, y, text, colour=colour)
    panel.axes("Force left, N", "Stroke, mm")
    return drawing.told(alt)
