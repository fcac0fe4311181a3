"""Where is the simulation wrong, and what does the extension gain?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports.figures.comparison import write_times
from reports.figures.palette import BAND, BETTER, INK, RULE, SECOND, WRONG, misfit
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import Scale
from reports.names import short
from schemas.arrays import Float

_LETTER = 7.0
"""Room for a letter of a recording's name, px: names differ in their widest letters and fonts in theirs."""


@pictured("residual-map")
def residual_map(rms: Float, rows: Sequence[str], columns: Sequence[str], title: str, *, alt: str) -> Drawing:
    """Recording × quantity: root mean square residual in SD, the number in every cell; a dot where nothing was measured."""
    names, cell = [short(row, 18) for row in rows], 22.0
    left = max(112.0, 12 + _LETTER * max((len(name) for name in names), default=0))
    longest = max((len(c) for c in columns), default=0)
    turned = longest * 6.2 > (WIDE - left) / max(1, len(columns)) - 2
    foot = min(96.0, 14 + longest * 4.4) if turned else 22.0
    drawing = Drawing(WIDE, 26 + cell * len(rows) + foot)
    wide = (drawing.width - left - 6) / max(1, len(columns))
    drawing.write(0, 14, title)
    for i, shown in enumerate(names):
        y = 26 + cell * i
        drawing.write(left - 8, y + 15, shown, size=11, anchor="end")
        for j in range(len(columns)):
            x = left + wide * j
            value = float(rms[i, j])
            if np.isnan(value):
                drawing.marks([(x + wide / 2, y + cell / 2)], "circle", RULE, 3.0)
                continue
            drawing.box(x + 1, y + 1, wide - 2, cell - 2, misfit(value), RULE)
            colour = "#ffffff" if value > 4.2 else INK
            drawing.write(x + wide / 2, y + 15, _cell(value), size=11.3, anchor="middle", colour=colour)
    for j, column in enumerate(columns):
        x, y = left + wide * (j + 0.5), 26 + cell * len(rows) + 14
        if turned:
            drawing.write(x + 4, y, short(column, 20), size=10.5, colour=SECOND, anchor="end", turn=-35)
        else:
            drawing.write(x, y, column, size=10.7, colour=SECOND, anchor="middle")
    return drawing.told(alt)


def _cell(value: float) -> str:
    return f"{value:.1f}" if value < 99.5 else f"{value:.0f}"


@pictured("held-out")
def held_out(names: Sequence[str], before: Sequence[float], after: Sequence[float | None], *, alt: str) -> Drawing:
    """Error on data that the fit has not seen, plain and extended model, in SD of the noise."""
    height = 26.0
    drawing = Drawing(WIDE, 74 + height * len(names))
    most = max(1.3, *before, *(a for a in after if a is not None))
    panel = Panel(drawing, 112, 34, 262, height * len(names), Scale(0.5, most * 1.06), Scale(len(names) - 0.5, -0.5))
    panel.column(0.8, 1.2, BAND)
    x = float(panel.px([1.0])[0])
    drawing.line([(x, panel.top), (x, panel.bottom)], SECOND, 0.8)
    for i, (name, first, second) in enumerate(zip(names, before, after, strict=True)):
        y = float(panel.py([i])[0])
        drawing.write(panel.left - 8, y + 4, short(name, 16), size=11, anchor="end")
        if second is not None:
            ends = panel.px([first, second]).tolist()
            drawing.line([(ends[0], y), (ends[1], y)], "#7c8791", 1.0)
        panel.dots([first], [i], WRONG, 8.0, open_=True)
        text = write_times(first)
        if second is not None:
            panel.dots([second], [i], BETTER, 8.0)
            text += f" → {write_times(second)}"
        drawing.write(panel.right + 14, y + 4, text, size=11)
    drawing.write(
        float(panel.px([before[0]])[0]), panel.top - 5, "plain", size=11.3, colour=WRONG, anchor="middle", bold=True
    )
    if after[0] is not None and abs(float(panel.px([before[0]])[0]) - float(panel.px([after[0]])[0])) > 60:
        drawing.write(
            float(panel.px([after[0]])[0]),
            panel.top - 5,
            "extended",
            size=11.3,
            colour=BETTER,
            anchor="middle",
            bold=True,
        )
    panel.axes(x_title="Error of the prediction, SD of the noise", y_ticks=[])
    drawing.write(0, 14, "Predicting what the fit has not seen (1 = noise alone)")
    return drawing.told(alt)
