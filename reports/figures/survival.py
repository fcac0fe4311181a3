"""How long do they live, in which group, and does one law describe it?"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from textwrap import wrap

import numpy as np

from reports.figures.palette import BAND, INK, RULE, SECOND, Group
from reports.figures.panel import WIDE, Drawing, Panel, note, pointer
from reports.figures.picture import pictured
from reports.figures.scale import Scale, logarithmic, symmetric, tick_text
from reports.names import short
from schemas.arrays import Float, Int

_ROOM = 5.0
"""Room between a name and a curve, px."""
_ALONG = 60
"""Points along a fitted line."""
_COVERED = 1e4
"""What a covered point of a curve costs, in px of distance from its own curve."""
_MISTAKEN = 4.0
"""What a px costs by which another curve is nearer than the own one."""
_NEAR = 16.0
"""So many px from its curve a name still belongs to it by sight; from farther away a thin line leads there."""
_AT_RISK_LETTERS = 24
"""Letters of a line beside the numbers at risk; a name has two or three."""
_FEW = 3
"""Up to so many groups have room for a second line beside their name."""


WEIBULL, LOG_NORMAL = "weibull", "log-normal"


@dataclass(frozen=True)
class FittedLaw:
    """A fitted line ln t = location + sigma w of a probability plot, what to say of it, and its band at q shares failed."""

    location: float
    sigma: float
    words: str
    share: Float
    lower: Float
    upper: Float


@dataclass(frozen=True)
class GroupCurve:
    """Survival curve of a group at m times, and the laws that were fitted to it, by name.

    `failures` says where the curve falls; where only inspections tell that, `inspected_failed` is how many failed in all.
    """

    name: str
    drawn: Group
    time: Float
    survival: Float
    lower: Float
    upper: Float
    at_risk: Int
    censored: Int
    failures: Int
    laws: Mapping[str, FittedLaw] = field(default_factory=dict)
    inspected_failed: int | None = None

    @property
    def failed(self) -> int:
        return int(self.failures.sum()) if self.inspected_failed is None else self.inspected_failed

    @property
    def total(self) -> int:
        return int(self.at_risk[0]) if self.at_risk.size else 0

    def still_at_risk(self, time: float) -> int:
        """At risk just before `time`: those whose time is not below it."""
        later = np.flatnonzero(self.time >= time * (1 - 1e-12))
        return int(self.at_risk[later[0]]) if later.size else 0


@pictured("survival")
def kaplan_meier(groups: Sequence[GroupCurve], time_title: str, *, alt: str) -> Drawing:
    """Step curves with 95 % bands, open marks where specimens were still alive, numbers at risk under the ticks."""
    names = [wrap(short(g.name, 2 * _AT_RISK_LETTERS), _AT_RISK_LETTERS) for g in groups]
    drawing = Drawing(WIDE, 286 + 17.0 + sum(_row_height(n) for n in names))
    x, ticks = survival_time_scale(groups)
    above = [_unfailed_words(g) for g in groups if not g.failed]
    panel = Panel(drawing, 162, 26, 286, 206, x, Scale(0.0, max(110.0, 104.0 + 7.6 * sum(map(len, above)))))
    start = x.low
    for g in groups:
        time, survival = np.append(start, np.maximum(g.time, start)), np.append(1.0, g.survival)
        lower, upper = np.append(1.0, g.lower), np.append(1.0, g.upper)
        panel.band(time, 100 * lower, 100 * upper, g.drawn.colour, ".14", steps=True)
        panel.steps(time, 100 * survival, g.drawn.colour, 2.2, dash=g.drawn.dash)
        kept = g.censored > 0
        panel.dots(g.time[kept], 100 * g.survival[kept], g.drawn.colour, 7.2, marker=g.drawn.marker, open_=True)
    panel.axes("Surviving, %", time_title, x_ticks=ticks, y_ticks=(0, 25, 50, 75, 100))
    _names(panel, groups)
    _at_risk(panel, groups, names, ticks)
    return drawing.told(alt)


def survival_time_scale(groups: Sequence[GroupCurve]) -> tuple[Scale, list[float]]:
    """The time axis of survival curves, logarithmic where lives differ by far, and its ticks; numbers at risk stand under them."""
    times = np.concatenate([g.time for g in groups])
    positive = times[times > 0]
    spread = positive.max() / positive.min() if positive.size else 1.0
    end = float(positive.max()) if positive.size else 1.0
    x = logarithmic(positive, margin=0.03) if spread > 300 else Scale(0.0, end * 1.0001)
    ticks = x.ticks(7)[0]
    if not x.log and end - ticks[-1] > 0.35 * (ticks[1] - ticks[0]):
        ticks.append(_in_few_digits(end))
    return x, ticks


def _in_few_digits(end: float) -> float:
    """The end of an axis in three digits, not beyond it: 277.78 h is 277."""
    place = 10.0 ** (math.floor(math.log10(end)) - 2)
    return float(f"{math.floor(end / place * (1 + 1e-12)) * place:.6g}")


def _unfailed_words(g: GroupCurve) -> list[str]:
    """The name of a group without a failure, in lines as wide as the figure."""
    return wrap(f"{short(g.name, 60)}: {g.failed} of {g.total} failed", 44)


def _names(panel: Panel, groups: Sequence[GroupCurve]) -> None:
    """The group's name beside its curve, where neither a curve nor another name is; above it where nobody failed."""
    y = float(panel.py([100.0])[0]) - 6
    paths = [_trace(panel, g) for g in groups]
    taken: list[tuple[float, float, float, float]] = []
    for g, own in zip(groups, paths, strict=True):
        if not g.failed:
            for line in reversed(_unfailed_words(g)):
                panel.drawing.write(panel.right, y, line, size=11.3, colour=g.drawn.colour, anchor="end", bold=True)
                y -= 14
            continue
        lines = [*wrap(short(g.name, 44), 22), f"{g.failed} of {g.total} failed"]
        lines = lines if len(groups) <= _FEW else [short(g.name, 22)]
        others = [path for path in paths if path is not own]
        _write_name(panel, g, lines, own, others, taken)


def _write_name(
    panel: Panel,
    g: GroupCurve,
    lines: Sequence[str],
    own: Float,
    others: Sequence[Float],
    taken: list[tuple[float, float, float, float]],
) -> None:
    """Lines of text where there is room near a group's curve; the place is added to those that are taken."""
    box = _find_room(panel, 6.6 * max(len(line) for line in lines), 14.0 * len(lines), own, others, taken)
    taken.append(box)
    away = _distances(box, own)
    there = own[int(np.argmin(away))]
    nearest = min((float(_distances(box, other).min()) for other in others), default=np.inf)
    if away.min() > _NEAR or away.min() > nearest:
        left, right, top, bottom = box
        at = (float(np.clip(there[0], left, right)), float(np.clip(there[1], top, bottom)))
        pointer(panel.drawing, at, (float(there[0]), float(there[1])), g.drawn.colour)
    for i, line in enumerate(lines):
        panel.drawing.write(box[0], box[2] + 11 + 14 * i, line, size=11.3, colour=g.drawn.colour, bold=True)


def _find_room(
    panel: Panel,
    wide: float,
    high: float,
    own: Float,
    others: Sequence[Float],
    taken: Sequence[tuple[float, float, float, float]],
) -> tuple[float, float, float, float]:
    """Left, right, top and bottom of a name in px, as near to its own curve (n, 2) as other names and curves leave room.

    A place nearer to another curve than to its own is taken only where there is no other: there it would be read as that one's name.
    """
    lefts = np.arange(panel.left + 6, max(panel.right + 24 - wide, panel.left + 7), 6.0)
    tops = np.arange(panel.top + 16, panel.bottom - high - 4, 6.0)
    x, y = np.vstack([own, *others]).T
    beside = (x > lefts[:, None] - _ROOM) & (x < lefts[:, None] + wide + _ROOM)
    within = (y > tops[:, None] - _ROOM) & (y < tops[:, None] + high + _ROOM)
    covered = beside.astype(float) @ within.T.astype(float)
    hidden = np.zeros_like(covered)
    for left, right, top, bottom in taken:
        level = (tops < bottom) & (top < tops + high)
        hidden += ((lefts < right) & (left < lefts + wide))[:, None] & level
    boxes = lefts[:, None, None], lefts[:, None, None] + wide, tops[:, None], tops[:, None] + high
    away = _distances(boxes, own).min(axis=-1)
    nearest = np.full_like(away, np.inf)
    for other in others:
        nearest = np.minimum(nearest, _distances(boxes, other).min(axis=-1))
    cost = away + _MISTAKEN * np.maximum(away - nearest, 0.0) + _COVERED * covered + _COVERED**2 * hidden
    across, down = np.unravel_index(int(np.argmin(cost)), cost.shape)
    left, top = float(lefts[across]), float(tops[down])
    return left, left + wide, top, top + high


def _distances(box: tuple[float | Float, float | Float, float | Float, float | Float], points: Float) -> Float:
    """From a box (left, right, top, bottom) to points (n, 2), px; 0 within it. Of many boxes, each (…, 1), all: (…, n)."""
    left, right, top, bottom = box
    x, y = points.T
    across = np.maximum(np.maximum(left - x, x - right), 0.0)
    return np.asarray(np.hypot(across, np.maximum(np.maximum(top - y, y - bottom), 0.0)))


def _trace(panel: Panel, g: GroupCurve) -> Float:
    """(n, 2) points of a curve in px, no farther apart than names are high."""
    x = np.concatenate([[panel.left], panel.px(g.time)])
    y = np.concatenate([panel.py([100.0]), panel.py(100 * g.survival)])
    drawn = np.isfinite(x) & np.isfinite(y)  # no time 0 on a logarithmic scale, nothing after the last risk
    x, y = x[drawn], y[drawn]
    corners = np.column_stack([np.repeat(x, 2)[1:], np.repeat(y, 2)[:-1]])
    along = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(corners, axis=0)).sum(axis=1))])
    at = np.linspace(0.0, along[-1], int(along[-1] / _ROOM) + 2)
    return np.column_stack([np.interp(at, along, corners[:, 0]), np.interp(at, along, corners[:, 1])])


def _row_height(lines: Sequence[str]) -> float:
    return 4.0 + 13.0 * max(1, len(lines))


def _at_risk(
    panel: Panel, groups: Sequence[GroupCurve], names: Sequence[Sequence[str]], ticks: Sequence[float]
) -> None:
    top = panel.bottom + 50
    panel.drawing.line([(4, top - 8), (panel.right + 14, top - 8)], RULE, 0.9)
    panel.drawing.write(panel.left - 12, top + 6, "At risk", size=11, colour=SECOND, anchor="end")
    y = top + 6.0
    for g, lines, before in zip(groups, names, [["At risk"], *names], strict=False):
        y += _row_height(before)
        for j, line in enumerate(lines):
            panel.drawing.write(
                panel.left - 12, y + 13 * j, line, size=10.7, colour=g.drawn.colour, anchor="end", bold=True
            )
        for p, t in zip(panel.px(list(ticks)).tolist(), ticks, strict=True):
            panel.drawing.write(p, y, str(g.still_at_risk(t)), size=11.3, anchor="middle")


@pictured("lifetimes")
def probability(groups: Sequence[GroupCurve], law: str, time_title: str, *, alt: str) -> Drawing:
    """Share failed on the scale of a law, with the band of its fit: points on the line where the law holds."""
    w, name = LAWS[law]
    drawing = Drawing(WIDE, 286 + 17.0 * (len(groups) + 1))
    points = [(g, *plotted_shares(g)) for g in groups]
    times = [t for _, t, _ in points]
    panel = Panel(
        drawing, 46, 26, 380, drawing.height - 26 - 54, logarithmic(*times, margin=0.08), Scale(w(0.015), w(0.985))
    )
    panel.axes(f"Failed, % ({name} scale)", time_title, y_ticks=[])
    for share in (0.02, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98):
        y = float(panel.py([w(share)])[0])
        drawing.segments([(panel.left - 4.5, y, panel.left, y)], SECOND)
        drawing.write(panel.left - 7, y + 4, tick_text(100 * share), size=11.3, colour=SECOND, anchor="end")
    fitted = [(g, g.laws[law]) for g in groups if law in g.laws]
    for g, line in fitted:
        heights = panel.py([w(share) for share in line.share.tolist()]).tolist()
        if heights:
            there = list(zip(panel.px(line.lower).tolist(), heights, strict=True))
            back = list(zip(panel.px(line.upper).tolist(), heights, strict=True))[::-1]
            panel.area([p for p in there + back if all(map(math.isfinite, p))], g.drawn.colour, ".12")
    for g, time, failed in points:
        panel.dots(time, [w(s) for s in failed.tolist()], g.drawn.colour, 5.2, marker=g.drawn.marker)
    for g, line in fitted:
        height = np.linspace(panel.y.low, panel.y.high, 3)
        panel.curve(np.exp(line.location + line.sigma * height), height, g.drawn.colour, 1.5, dash=g.drawn.dash)
    _name_lines(panel, fitted, points, w)
    return drawing.told(alt)


def _name_lines(
    panel: Panel,
    fitted: Sequence[tuple[GroupCurve, FittedLaw]],
    points: Sequence[tuple[GroupCurve, Float, Float]],
    w: Callable[[float], float],
) -> None:
    """The groups' names beside their lines, where neither a line, a point nor another name is."""

    def trace(line: FittedLaw) -> Float:
        height = np.linspace(panel.y.low, panel.y.high, _ALONG)
        at = np.column_stack([panel.px(np.exp(line.location + line.sigma * height)), panel.py(height)])
        return at[(at[:, 0] >= panel.left) & (at[:, 0] <= panel.right)]

    lines = [trace(line) for _, line in fitted]
    dots = [np.column_stack([panel.px(t), panel.py([w(s) for s in failed.tolist()])]) for _, t, failed in points]
    taken: list[tuple[float, float, float, float]] = []
    for (g, line), own in zip(fitted, lines, strict=True):
        words = [*wrap(short(g.name, 44), 24), line.words][: None if len(fitted) <= _FEW else 1]
        mine = next(d for d, (h, _, _) in zip(dots, points, strict=True) if h is g)
        others = [one for one in (*lines, *dots) if one is not own and one is not mine and one.size]
        _write_name(panel, g, words, np.vstack([own, mine]), others, taken)


def _w(share: float) -> float:
    """ln(−ln(1 − F)): Weibull laws are straight lines in it against ln t."""
    return math.log(-math.log1p(-share))


LAWS: Mapping[str, tuple[Callable[[float], float], str]] = {
    WEIBULL: (_w, "Weibull"),
    LOG_NORMAL: (NormalDist().inv_cdf, "log-normal"),
}
"""The scale of each law, on which it is a straight line against ln t, and its name."""


def plotted_shares(g: GroupCurve) -> tuple[Float, Float]:
    """Failure times and the share failed there: middle of the curve's jump, so that neither end is at 0 or 1."""
    before = np.append(1.0, g.survival[:-1])
    hit = (g.failures > 0) & (g.time > 0)
    share = 1 - (before + g.survival) / 2
    return g.time[hit], share[hit]


@dataclass(frozen=True)
class Share:
    """One row of the chart of regions: where, how many of how many, observed share with limits, predicted share."""

    label: str
    drawn: Group
    count: int
    total: int
    observed: float
    low: float
    high: float
    predicted: float | None


@pictured("regions")
def regions(rows: Sequence[Share], *, alt: str) -> Drawing:
    """Share of the failures by region: found with its 95 % interval, expected as an open diamond."""
    height = 24.0
    drawing = Drawing(WIDE, 64 + height * len(rows))
    panel = Panel(drawing, 150, 26, 250, height * len(rows), Scale(0.0, 100.0), Scale(len(rows) - 0.5, -0.5))
    for x in (25, 50, 75):
        p = float(panel.px([x])[0])
        drawing.line([(p, panel.top), (p, panel.bottom)], BAND, 1.0)
    panel.axes("Share of the failures, %", x_ticks=(0, 25, 50, 75, 100), y_ticks=[], title_left=4)
    for i, row in enumerate(rows):
        y = float(panel.py([i])[0])
        low, high = (float(v) for v in panel.px([100 * row.low, 100 * row.high]))
        drawing.write(panel.left - 10, y + 4, row.label, size=11.3, anchor="end")
        drawing.line([(low, y), (high, y)], row.drawn.colour, 1.6)
        panel.dots([100 * row.observed], [i], row.drawn.colour, 7.0, marker=row.drawn.marker)
        if row.predicted is not None:
            panel.dots([100 * row.predicted], [i], INK, 8.0, marker="diamond", open_=True)
        drawing.write(panel.right + 12, y + 4, f"{row.count} of {row.total}", size=11.3, colour=SECOND)
    if any(r.predicted is not None for r in rows):
        note(drawing, panel.right + 16, panel.bottom + 17, "◇ expected", INK)
    return drawing.told(alt)


@dataclass(frozen=True)
class VoltageLife:
    """Life against voltage of a configuration: Weibull scales at n voltages in kV, by the law and free."""

    name: str
    drawn: Group
    voltage: Float
    scale: Float
    law: Float
    standardised: Float


@pictured("against-voltage")
def against_voltage(items: Sequence[VoltageLife], unit: str, *, alt: str) -> Drawing:
    """Life against voltage on logarithmic axes with the inverse power law, and what is left of it below."""
    drawing = Drawing(WIDE, 344)
    x = logarithmic(*(i.voltage for i in items), margin=0.08)
    upper = Panel(
        drawing, 60, 24, 322, 176, x, logarithmic(*(i.scale for i in items), *(i.law for i in items), margin=0.08)
    )
    lower = Panel(drawing, 60, 226, 322, 72, x, symmetric(7))
    lower.across(-2, 2)
    lower.level(0)
    entries = []
    for i in items:
        order = np.argsort(i.voltage)
        upper.curve(i.voltage[order], i.law[order], i.drawn.colour, 1.6, dash=i.drawn.dash)
        upper.dots(i.voltage, i.scale, i.drawn.colour, 5.6, marker=i.drawn.marker)
        lower.held(i.voltage, i.standardised, i.drawn.colour, 5.0)
        entries.append((float(i.law[order][-1]), short(i.name, 16), i.drawn.colour, True))
    upper.names(entries)
    upper.axes(f"Weibull scale, {unit}; line: inverse power law", x_labels=False, y_most=5)
    lower.axes("Off the law, SD", "Voltage, kV", y_ticks=(-5, 0, 5))
    return drawing.told(alt)
