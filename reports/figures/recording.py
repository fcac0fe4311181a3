"""What is in a recording: the envelope of each channel over time, drawn as dense as a screen can show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, MODEL, WRONG
from reports.figures.panel import Drawing, Panel, Series
from reports.figures.paper import DOUBLE
from reports.figures.picture import pictured
from reports.figures.scale import Scale, linear
from reports.words import plain
from schemas.arrays import Bool, Float
from schemas.numbers import capital

WIDTH = 1000.0
COLUMNS = 440
"""Most intervals drawn per channel: neighbours are merged, their extremes kept."""
_DETAIL = 2000
"""Most intervals kept per channel for who zooms in."""


@dataclass(frozen=True)
class Envelope:
    """Least and largest value of a channel in each of n intervals that begin at `time` (s)."""

    name: str
    unit: str
    time: Float
    low: Float
    high: Float

    def merged(self, columns: int = COLUMNS) -> Envelope:
        """The same with at most `columns` intervals; no extreme is lost and no gap is closed."""
        n = self.time.size
        if n <= columns:
            return self
        edges = np.linspace(0, n, columns + 1).astype(int)[:-1]
        low = np.fmin.reduceat(self.low, edges)
        high = np.fmax.reduceat(self.high, edges)
        return Envelope(self.name, self.unit, self.time[edges], low, high)

    def gaps(self) -> Bool:
        """(n,) true where more than three usual intervals pass before the next."""
        if self.time.size < 3:
            return np.zeros(self.time.size, dtype=bool)
        pause = np.diff(self.time)
        usual = float(np.median(pause))
        return np.append(pause > max(3 * usual, 1e-9), False)


@pictured("timeline", column=DOUBLE)
def channels(envelopes: Sequence[Envelope], marks: Sequence[tuple[float, str]], *, alt: str) -> Drawing:
    """All channels over the same time, with instants named (time in s, words)."""
    height, gap = (104.0, 44.0) if len(envelopes) <= 4 else (74.0, 38.0)
    drawing = Drawing(WIDTH, 24 + (height + gap) * len(envelopes) + 6)
    known = [e for e in envelopes if e.time.size]
    start = min((float(e.time[0]) for e in known), default=0.0)
    end = max((float(e.time[-1]) for e in known), default=1.0)
    x = Scale(start, end if end > start else start + 1.0)
    for i, envelope in enumerate(envelopes):
        top = 24 + (height + gap) * i
        panel = Panel(drawing, 60, top, WIDTH - 76, height, x, linear(envelope.low, envelope.high))
        last = i + 1 == len(envelopes)
        _drawn(panel, envelope)
        for time, words in marks:
            p = float(panel.px([time])[0])
            drawing.line([(p, panel.top), (p, panel.bottom)], WRONG, 1.1, dash="5 3")
            if i == 0:
                drawing.write(p, panel.top - 8, words, colour=WRONG, bold=True, anchor="middle")
        unit = f", {envelope.unit}" if envelope.unit not in ("", "1") else ""
        panel.axes(
            capital(plain(envelope.name)) + unit, "Time since the first sample, s" if last else "", y_most=4, x_most=10
        )
    return drawing.told(alt)


def _drawn(panel: Panel, envelope: Envelope) -> None:
    """Each unbroken stretch as its envelope, filled, with its middle as a line so that thin ones are seen."""
    thin = envelope.merged()
    ends = np.flatnonzero(thin.gaps()) + 1
    for part in np.split(np.arange(thin.time.size), ends):
        time, low, high = thin.time[part], thin.low[part], thin.high[part]
        panel.band(time, low, high, MODEL, ".45")
        panel.curve(time, (low + high) / 2, MODEL if part.size > 2 else INK, 1.0)
    panel.plot.series = [_in_detail(envelope)]


def _in_detail(envelope: Envelope) -> Series:
    """The envelope as one line up and down, denser than it is drawn: for who zooms into the record."""
    full = envelope.merged(_DETAIL)
    ends = np.flatnonzero(full.gaps()) + 1
    time, low, high = (np.insert(v, ends, np.nan) for v in (full.time, full.low, full.high))
    return Series("c", np.repeat(time, 2), np.column_stack([low, high]).ravel(), MODEL, 1.0)
