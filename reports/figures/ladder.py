"""What does one more arm bring? Error against the number of arms."""

from __future__ import annotations

from markupsafe import Markup

from reports.figures.palette import INK, MODEL, SECOND
from reports.figures.plot import WIDE, Panel, logarithmic
from reports.figures.svg import Drawing
from schemas.arrays import Float


def error_by_arms(arms: Float, error: Float, enough: int | None, *, alt: str) -> Markup:
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
    return drawing.image(alt)
