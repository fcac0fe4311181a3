"""Does a rig, a batch or an operator stay the same?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import BAND, INK, RAW, SECOND, WRONG
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import Scale, linear
from reports.names import short
from schemas.arrays import Bool, Float


@dataclass(frozen=True)
class Chart:
    """n points in the order of time with their standard deviations, what the others predict and within which limits.

    Limits are NaN where there are too few points; `alarm` (n,) marks points that leave them or end a row on one side.
    """

    names: Sequence[str]
    value: Float
    sd: Float
    expected: Float
    lower: Float
    upper: Float
    alarm: Bool


@pictured("control")
def chart(item: Chart, title: str, x_title: str, *, alt: str) -> Drawing:
    """Points ± 1 SD within the limits that the other points set; those with an alarm are named."""
    drawing = Drawing(WIDE, 218)
    n = item.value.size
    place = np.arange(1.0, n + 1)
    with_bars = (item.value - np.nan_to_num(item.sd), item.value + np.nan_to_num(item.sd))
    limited = np.isfinite(item.lower)
    seen = limited & item.alarm if (limited & item.alarm).any() else limited
    shown = (item.lower[seen], item.upper[seen])
    panel = Panel(drawing, 76, 30, 376, 134, Scale(0.4, n + 0.6), linear(*with_bars, *shown, margin=0.12))
    # One area for all points: a lab of years has thousands of them.
    edges, none = np.append(place - 0.5, n + 0.5), np.nan
    panel.band(edges, np.append(item.lower, none), np.append(item.upper, none), BAND, "1", steps=True)
    known = np.isfinite(item.expected)
    panel.curve(place[known], item.expected[known], RAW, 1.0, dash="4 3")
    calm = ~item.alarm
    bars = np.isfinite(item.sd)
    panel.bars(place[bars & calm], with_bars[0][bars & calm], with_bars[1][bars & calm], SECOND)
    panel.bars(place[bars & item.alarm], with_bars[0][bars & item.alarm], with_bars[1][bars & item.alarm], WRONG)
    panel.dots(place[calm], item.value[calm], INK, 5.0)
    panel.dots(place[item.alarm], item.value[item.alarm], WRONG, 7.0, marker="diamond")
    for i in np.flatnonzero(item.alarm).tolist():
        late = place[i] > 0.6 * n
        panel.label(
            place[i], item.value[i], short(item.names[i], 18), WRONG, anchor="end" if late else None, bold=True,
            dx=-9 if late else 9,
        )  # fmt: skip
    few = [1.0, float(n)] if n > 12 else place.tolist()
    panel.axes(title, x_title, x_ticks=few, y_most=4)
    return drawing.told(alt)
