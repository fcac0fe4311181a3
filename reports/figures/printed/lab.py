"""What belongs to a lab or a recording rather than a film: control charts, and the channels of a recording over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.control import Chart
from reports.figures.palette import BAND, INK, MODEL, RAW, SECOND, WRONG
from reports.figures.plot import Scale, linear
from reports.figures.printed.axes import (
    draw_band,
    draw_bars,
    draw_curve,
    draw_points,
    mark_box,
    name_points,
    scale_axes,
)
from reports.figures.printed.style import DOUBLE, POINT_PT, SINGLE, TICK_PT, open_axes, styled
from reports.figures.recording import Envelope
from reports.names import short
from reports.words import plain
from schemas.numbers import capital


@styled()
def draw_control(item: Chart, title: str, x_title: str, *, width: str = SINGLE) -> Figure:
    """Points ± 1 SD within the limits that the other points set; those with an alarm are named."""
    figure, axes = open_axes(width, 56)
    (panel,) = axes[:, 0]
    n = item.value.size
    place = np.arange(1.0, n + 1)
    sd = np.nan_to_num(item.sd)
    limited = np.isfinite(item.lower)
    seen = limited & item.alarm if (limited & item.alarm).any() else limited
    y = linear(item.value - sd, item.value + sd, item.lower[seen], item.upper[seen], margin=0.12)
    few = [1.0, float(n)] if n > 12 else place.tolist()
    scale_axes(panel, Scale(0.4, n + 0.6), y, title, x_title, x_ticks=few, y_most=4)
    for i in np.flatnonzero(limited).tolist():
        mark_box(panel, place[i] - 0.5, place[i] + 0.5, item.lower[i], item.upper[i], BAND)
    known = np.isfinite(item.expected)
    draw_curve(panel, place[known], item.expected[known], RAW, 0.6, (4, 3))
    for mask, colour, size, marker in ((~item.alarm, INK, 1.2, "circle"), (item.alarm, WRONG, 1.6, "diamond")):
        barred = mask & np.isfinite(item.sd)
        draw_bars(panel, place[barred], (item.value - sd)[barred], (item.value + sd)[barred], SECOND if colour == INK else WRONG)  # fmt: skip
        draw_points(panel, place[mask], item.value[mask], colour, size * POINT_PT, marker=marker)
    name_points(panel, place, item.value, [short(name, 18) for name in item.names], item.alarm, WRONG)
    return figure


@styled()
def draw_timeline(envelopes: Sequence[Envelope], marks: Sequence[tuple[float, str]], *, width: str = DOUBLE) -> Figure:
    """All channels of a recording over the same time, with instants named (time in s, words); a break is a gap in the data."""
    figure, axes = open_axes(width, 12 + (26 if len(envelopes) <= 4 else 20) * len(envelopes), (1.0,) * len(envelopes))
    known = [e for e in envelopes if e.time.size]
    start = min((float(e.time[0]) for e in known), default=0.0)
    end = max((float(e.time[-1]) for e in known), default=1.0)
    x = Scale(start, end if end > start else start + 1.0)
    for i, envelope in enumerate(envelopes):
        panel, last = axes[i, 0], i + 1 == len(envelopes)
        unit = f", {envelope.unit}" if envelope.unit not in ("", "1") else ""
        scale_axes(
            panel, x, linear(envelope.low, envelope.high), capital(plain(envelope.name)) + unit,
            "Time since the first sample, s" if last else "", x_labels=last, y_most=4,
        )  # fmt: skip
        _draw_envelope(panel, envelope)
        for time, words in marks:
            panel.axvline(time, color=WRONG, linewidth=0.7, linestyle=(0, (4, 2)))
            if i == 0:
                panel.annotate(words, (time, 1), (0, 5), xycoords=("data", "axes fraction"), textcoords="offset points",
                               ha="center", fontsize=TICK_PT, color=WRONG, fontweight="bold", annotation_clip=False)  # fmt: skip
    return figure


def _draw_envelope(axes: Axes, envelope: Envelope) -> None:
    """Each unbroken stretch as its envelope, filled, with its middle as a line so that thin ones are seen."""
    thin = envelope.merged()
    ends = np.flatnonzero(thin.gaps()) + 1
    for part in np.split(np.arange(thin.time.size), ends):
        time, low, high = thin.time[part], thin.low[part], thin.high[part]
        draw_band(axes, time, low, high, MODEL, 0.45)
        draw_curve(axes, time, (low + high) / 2, MODEL if part.size > 2 else INK, 0.6)
