"""Where do measurement and simulation part? One block of a diagnosis: measured, plain, extended, and both residuals in SD."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import BETTER, INK, MODEL, SECOND, WRONG
from reports.figures.panel import TICKS, WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import Scale, linear, logarithmic, nice, symmetric
from schemas.arrays import Bool, Complex, Float
from schemas.numbers import significant

_REACH = 8.0
"""Half height of the residual panel, SD: what lies beyond is drawn at its edge."""
_FLAT = 3.0
"""A magnitude that spans less than this factor has a linear axis."""
_LEAST = 1e-30
_SHRINKS = 0.5
"""A spacing below this share of the one before begins a new row of windows."""
_BOLD_WIDTH, _APART = 7.9, 8.0
"""Width of a bold letter of the widest common font, and space between two texts of one line, px."""
_DWARFED = 50.0
"""Residuals from which on the ±2 band is a line in any case, SD: then all of them are drawn, none at the edge."""
_FAINT = 4.0
"""Noise over its median from which on a model is not followed from line to line: it would look spiky, and is only badly seen."""
_MOST_EDGES = 4
"""More would be no edges but a scatter of places."""


@dataclass(frozen=True)
class Compared:
    """Values of one kind at n places (complex where the quantity is): measured, simulated by both models, and the noise.

    x (n,) along the axis `x_title`, logarithmic if `x_log`; `sd` (n,) of one component, in the unit of the values after
    `factor`. `groups`: places and names on an axis that is only an order. `lines`: the values lie on a curve, so that the models are drawn as lines; else as marks. `extended` is None where
    there is no extended model.
    """

    x: Float
    measured: Complex | Float
    plain: Complex | Float
    extended: Complex | Float | None
    sd: Float
    title: str
    x_title: str
    x_log: bool
    lines: bool
    groups: tuple[tuple[float, str], ...] = ()

    def residual(self, simulated: Complex | Float) -> Float:
        """(n,) or, of complex values, (2n,): real parts, then imaginary parts, in SD."""
        off = (self.measured - simulated) / np.maximum(self.sd, _LEAST)
        return np.concatenate([off.real, off.imag]) if np.iscomplexobj(off) else np.asarray(off)

    @property
    def turned(self) -> bool:
        """More of what the plain model misses is phase than magnitude."""
        if not np.iscomplexobj(self.measured):
            return False
        off = (self.measured - self.plain) / np.maximum(self.sd, _LEAST)
        along = (off * np.exp(-1j * np.angle(self.measured)))[self.measured != 0]
        return bool(np.nansum(along.imag**2) > np.nansum(along.real**2))

    @property
    def shown_title(self) -> str:
        """The title of what is drawn: of the phase where that tells more."""
        what = self.title.partition(",")[0].replace("|", "")
        return f"Phase of {what[:1].lower()}{what[1:]}, degrees" if self.turned else self.title

    def shown(self, values: Complex | Float) -> Float:
        """(n,) what is drawn of the values: themselves, or their magnitude, or their phase in degrees."""
        if self.turned:
            turn = np.angle(values * np.exp(-1j * self._middle))
            return np.asarray(np.degrees(turn + self._middle))
        return shown_values(values)

    @property
    def _middle(self) -> float:
        """Mean direction of what was measured, rad: phases are given within half a turn of it."""
        return float(np.angle(np.sum(self.measured / np.maximum(np.abs(self.measured), _LEAST))))

    @property
    def spread(self) -> Float:
        """(n,) one standard deviation of what is drawn."""
        if not self.turned:
            return self.sd
        return np.asarray(np.degrees(self.sd / np.maximum(np.abs(self.measured), _LEAST)))

    @property
    def sharp(self) -> Bool:
        """(n,) true where the noise is not far above the usual: through the other places no line of a model is drawn."""
        return np.asarray(self.sd <= _FAINT * np.median(self.sd))

    @property
    def residual_x(self) -> Float:
        return np.tile(self.x, 2) if np.iscomplexobj(self.measured) else self.x

    def rms(self, simulated: Complex | Float) -> float:
        """Root mean square residual, SD of the noise."""
        return float(np.sqrt(np.mean(self.residual(simulated) ** 2)))


@pictured("diagnosis")
def comparison(data: Compared, *, alt: str) -> Drawing:
    """Measured dots ± 2 SD with the plain (blue) and the extended model (green); below, what each leaves."""
    drawing = Drawing(WIDE, 344)
    x = logarithmic(data.x, margin=0.02) if data.x_log else linear(data.x, margin=0.04)
    ticks = [place for place, _ in data.groups] if data.groups else None
    if ticks is None and not data.x_log and np.array_equal(data.x, np.round(data.x)):  # places in an order
        ticks = [place for place in x.ticks(8)[0] if float(place).is_integer()]
    shown = {"measured": data.shown(data.measured), "plain": data.shown(data.plain)}
    if data.extended is not None:
        shown["extended"] = data.shown(data.extended)
    upper = Panel(drawing, 52, 24, 352, 176, x, shown_scale(data, list(shown.values())))
    lower = Panel(drawing, 52, 232, 352, 66, x, symmetric(comparison_reach(data)))
    upper.axes(data.shown_title, x_labels=False, y_most=5, x_ticks=ticks)
    upper.bars(data.x, shown["measured"] - 2 * data.spread, shown["measured"] + 2 * data.spread, INK)
    upper.held(data.x, shown["measured"], INK, 4.2)
    names = [("plain", MODEL, "square")] + ([("extended", BETTER, "triangle")] if data.extended is not None else [])
    for name, colour, marker in names:
        if data.lines:
            order = np.argsort(data.x, kind="stable")
            drawn = order[data.sharp[order]] if data.x_log else order
            course = data.x[drawn], shown[name][drawn]
            upper.curve(*(course if data.x_log else broken(*course)), colour, 1.9)
        else:
            upper.dots(data.x, shown[name], colour, 5.4, marker=marker, open_=True)
    last = int(np.argmax(data.x))
    upper.names([(float(shown[name][last]), name, colour, True) for name, colour, _ in names])
    _residuals(lower, data)
    reach = nice(lower.y.high)
    lower.axes(
        "Residual, SD", data.x_title, y_ticks=(-reach, 0, reach), signed=True, x_ticks=ticks, x_labels=not data.groups
    )
    for place, name in data.groups:
        drawing.write(float(lower.px(place)), lower.bottom + 17, name, size=TICKS, colour=SECOND, anchor="middle")
    return drawing.told(alt)


def broken(x: Float, y: Float) -> tuple[Float, Float]:
    """A course over ascending times x with a gap where windows that grew begin small again: an edge lies between them."""
    gaps = np.diff(x)
    shrinks = np.append(gaps[1:] < _SHRINKS * gaps[:-1], [False, False])[: gaps.size]
    last = shrinks & ~np.append(shrinks[1:], False)
    if np.count_nonzero(last) > _MOST_EDGES:
        return x, y
    places = np.flatnonzero(last) + 1
    return np.insert(x, places, np.nan), np.insert(y, places, np.nan)


def _residuals(panel: Panel, data: Compared) -> None:
    panel.across(-2, 2)
    panel.level(0)
    drawing = panel.drawing
    panel.held(data.residual_x, data.residual(data.plain), WRONG, 3.8, open_=True)
    words = f"○ plain: {write_times(data.rms(data.plain))}"
    x = panel.right
    if data.extended is not None:
        panel.held(data.residual_x, data.residual(data.extended), BETTER, 3.4)
        text = f"● extended: {write_times(data.rms(data.extended))}"
        drawing.write(x, panel.top - 9, text, colour=BETTER, anchor="end", bold=True)
        x -= _BOLD_WIDTH * len(text) + _APART
    drawing.write(x, panel.top - 9, words, colour=WRONG, anchor="end", bold=True)


def shown_scale(data: Compared, values: Sequence[Float]) -> Scale:
    """The axis of what is drawn: magnitudes on a logarithmic one where they span much."""
    if data.turned:
        return linear(*values, margin=0.08)
    return magnitude_scale(values, positive=np.iscomplexobj(data.measured))


def shown_values(values: Complex | Float) -> Float:
    return np.abs(values) if np.iscomplexobj(values) else np.asarray(values, dtype=float)


def magnitude_scale(values: Sequence[Float], *, positive: bool) -> Scale:
    together = np.concatenate(values)
    together = together[np.isfinite(together)]
    if positive and together.size and together.min() > 0 and together.max() > _FLAT * together.min():
        return logarithmic(together, margin=0.06)
    return linear(together, margin=0.08)


def comparison_reach(data: Compared) -> float:
    """High enough for most of both residuals, and for the ±2 band; all of them where they dwarf the noise anyway."""
    parts = [data.residual(data.plain)] + ([data.residual(data.extended)] if data.extended is not None else [])
    largest = max(float(np.quantile(np.abs(p), 0.97)) for p in parts)
    if largest > _DWARFED:
        return 1.08 * max(float(np.abs(p).max()) for p in parts)
    return max(4.0, min(1.15 * largest, max(_REACH, 1.15 * float(np.quantile(np.abs(parts[0]), 0.9)))))


def write_times(rms: float) -> str:
    """So many times the noise, short enough to stand beside the title."""
    if rms >= 1e5:
        return significant(rms, 2)
    return f"{rms:.1f}" if rms < 99.5 else f"{rms:.0f}"
