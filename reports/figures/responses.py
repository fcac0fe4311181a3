"""Does the model describe the film? Dynamic stiffness, measured and modelled, never without the residual below."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, LOWER, LOWEST, MODEL, RAW, RULE, SECOND, WRONG
from reports.figures.panel import NARROW, WIDE, Drawing, Panel, note, pointer
from reports.figures.paper import DOUBLE
from reports.figures.picture import pictured
from reports.figures.scale import Scale, linear, logarithmic, nice, symmetric
from schemas.arrays import Bool, Complex, Float
from schemas.numbers import compact, significant

LIMIT = 5.0
"""Amplification of noise beyond which a corrected point is not used."""
_REACH = 7.0
"""Half height of the residual panel, SD."""
_WITHOUT_RESIDUAL = 244
"""Height of the picture where no model leaves a residual."""


@dataclass(frozen=True)
class Lines:
    """A measured response at n frequencies: complex values, standard errors of both components together, usability."""

    frequency: Float
    value: Complex
    error: Float
    usable: Bool
    amplification: Float

    @property
    def component(self) -> Float:
        """Standard deviation of one component."""
        return np.asarray(self.error / np.sqrt(2))

    @property
    def size(self) -> int:
        return int(self.frequency.size)


@dataclass(frozen=True)
class Residual:
    """What a model leaves of the measurement at n frequencies, in SD of the noise of one component.

    `magnitude` (n,) of the modulus, `phase` (n,) of the phase; `recorded`: of the recorded response, with the rig in the
    model, rather than of the corrected one. Where no noise is known (`in_sd` false) the magnitude is in % of the measured
    one and the phase in degrees.
    """

    frequency: Float
    magnitude: Float
    phase: Float
    recorded: bool
    in_sd: bool = True

    @property
    def rms(self) -> float:
        """Root mean square over both; NaN where there is nothing."""
        both = np.concatenate([self.magnitude, self.phase])
        both = both[np.isfinite(both)]
        return float(np.sqrt(np.mean(both**2))) if both.size else float("nan")


def residual(lines: Lines, model: Complex, *, recorded: bool = False) -> Residual:
    """The residual at the usable lines of a model's values (n,) at all lines."""
    good = lines.usable
    value, sd, model = lines.value[good], lines.component[good], model[good]
    known = bool(np.any(sd > 0))
    with np.errstate(divide="ignore", invalid="ignore"):
        off, turned = np.abs(value) - np.abs(model), np.angle(value / model)
        magnitude = off / sd if known else 100 * off / np.abs(value)
        phase = turned * np.abs(value) / sd if known else np.degrees(turned)
    return Residual(lines.frequency[good], np.asarray(magnitude), np.asarray(phase), recorded, known)


@dataclass(frozen=True)
class Curve:
    """A model's stiffness on the measured lines and on a dense grid, and what it leaves.

    `sd` (2, m): of |k| and of arg k in rad on the grid; `times_noise`: what the fit leaves over all its data.
    """

    order: int
    selected: bool
    at_lines: Complex
    grid: Float
    on_grid: Complex
    residual: Residual
    sd: Float | None = None
    times_noise: float | None = None

    @property
    def name(self) -> str:
        return {1: "1st", 2: "2nd", 3: "3rd"}.get(self.order, f"{self.order}th")


@pictured("response", column=DOUBLE, whole={"phase": None})
def response(
    lines: Lines, recorded: Lines | None, curves: Sequence[Curve], *, phase: bool | None, alt: str, alarm: bool = False
) -> Drawing:
    """Magnitude or phase against frequency with the models, and the residual of the chosen order and the one below.

    Both parts where `phase` is None. Without models there is no residual, and no room for one. With `alarm`, residuals of the
    chosen order beyond 3 SD are marked as wrong, with what the fit leaves and where most of it lies.
    """
    parts = (False, True) if phase is None else (phase,)
    drawing = Drawing(WIDE, 344 if curves else _WITHOUT_RESIDUAL, parts=len(parts))
    for i, part in enumerate(parts):
        drawing.begin_part(i)
        _draw_part(drawing, lines, recorded, curves, phase=part, alarm=alarm)
    return drawing.told(alt)


def _draw_part(
    drawing: Drawing, lines: Lines, recorded: Lines | None, curves: Sequence[Curve], *, phase: bool, alarm: bool
) -> None:
    """Magnitude or phase of everything."""
    frequencies = [lines.frequency] + ([recorded.frequency] if recorded else [])
    x = logarithmic(*frequencies, margin=0.015)

    def shown(value: Complex) -> Float:
        return np.degrees(np.angle(value)) if phase else np.abs(value)

    y = scale_of_values(
        [shown(lines.value)] + ([shown(recorded.value)] if recorded else []), curves, shown, phase=phase
    )
    upper = Panel(drawing, 46, 24, 332, 176, x, y)
    lower = Panel(drawing, 46, 226, 332, 72, x, symmetric(residual_reach(curves, phase=phase))) if curves else None
    _greyed(lines, upper, *((lower,) if lower else ()), at_top=phase)
    title = "Phase of k, degrees" if phase else "Dynamic stiffness |k|, N/mm"
    upper.axes(title, *(() if lower else ("Frequency, Hz",)), x_labels=not lower, y_most=5)
    if phase and y.low < 0 < y.high:
        upper.level(0, "#c9ced4")
    if recorded:
        upper.held(recorded.frequency, shown(recorded.value), RAW, 4.6, open_=True)
    for curve in curves:
        _model(upper, curve, shown, phase=phase)
    spread = np.degrees(lines.component / np.abs(lines.value)) if phase else lines.component
    good = lines.usable
    upper.dots(lines.frequency[~good], shown(lines.value)[~good], RAW, 3.4)
    upper.bars(
        lines.frequency[good], (shown(lines.value) - 2 * spread)[good], (shown(lines.value) + 2 * spread)[good], INK
    )
    upper.dots(lines.frequency[good], shown(lines.value)[good], INK, 4.2)
    upper.names([_name(c, float(shown(c.on_grid[-1:])[0])) for c in curves])
    _captions(upper, lines, recorded, shown, phase=phase)
    if lower:
        _residuals(lower, curves, phase=phase, alarm=alarm)


def scale_of_values(
    measured: Sequence[Float], curves: Sequence[Curve], shown: Callable[[Complex], Float], *, phase: bool
) -> Scale:
    if phase:
        film = measured[0][np.isfinite(measured[0])]
        models = [float(np.clip(shown(c.on_grid), -90, 90).max()) for c in curves]
        low, high = min(0.0, float(film.min(initial=0.0))), max(30.0, float(film.max(initial=0.0)), *models)
        if len(measured) > 1:
            raw = measured[1][np.isfinite(measured[1])]
            low = min(low, max(float(raw.min(initial=0.0)), -1.3 * high))
        return Scale(low - 0.06 * (high - low), high + 0.3 * (high - low))
    return logarithmic(*measured, margin=0.06)


def _model(panel: Panel, curve: Curve, shown: Callable[[Complex], Float], *, phase: bool) -> None:
    value = np.degrees(np.angle(curve.on_grid)) if phase else np.abs(curve.on_grid)
    if curve.selected:
        if curve.sd is not None:
            reach = 1.96 * (np.degrees(curve.sd[1]) if phase else curve.sd[0])
            panel.band(curve.grid, value - reach, value + reach, MODEL, ".22")
        panel.curve(curve.grid, value, MODEL)
    elif curve.order == 1:
        panel.curve(curve.grid, value, LOWEST, 1.8, dash="1.5 3")
    else:
        panel.curve(curve.grid, value, LOWER, 1.7, dash="6 3")


def _name(curve: Curve, y: float) -> tuple[float, str, str, bool]:
    if curve.selected:
        return y, f"{curve.name} order ✓", MODEL, True
    return y, f"{curve.name} order", SECOND if curve.order == 1 else "#2f7fb8", False


def _greyed(lines: Lines, *panels: Panel, at_top: bool = False) -> None:
    """Columns where the correction amplifies the noise too much, named once."""
    columns = beyond(lines.frequency, lines.amplification)
    for low, high in columns:
        for panel in panels:
            panel.column(low, high)
    if columns:
        panel = panels[0]
        low, high = max(columns, key=lambda c: c[1] / c[0])
        middle = float(panel.px([np.sqrt(low * high)])[0])
        middle = min(max(middle, panel.left + 52), panel.right - 46)
        y = panel.top + 8 if at_top else panel.bottom - 19
        note(panel.drawing, middle, y, "correction amplifies\nnoise over 5 ×", anchor="middle")


def beyond(frequency: Float, amplification: Float) -> list[tuple[float, float]]:
    """Stretches of frequency where the amplification exceeds its limit, to half way to the neighbouring lines."""
    order = np.argsort(frequency, kind="stable")
    f, over = frequency[order], np.nan_to_num(amplification[order]) > LIMIT
    if f.size < 2 or not over.any():
        return []
    edges = np.concatenate([[f[0]], np.sqrt(f[1:] * f[:-1]), [f[-1]]])
    steps = np.flatnonzero(np.diff(np.concatenate([[0], over.astype(np.int8), [0]])))
    return [(float(edges[a]), float(edges[b])) for a, b in zip(steps[::2], steps[1::2], strict=True)]


def _captions(
    panel: Panel, lines: Lines, recorded: Lines | None, shown: Callable[[Complex], Float], *, phase: bool
) -> None:
    """Names of the measured and the corrected points, at the points."""
    value = shown(lines.value)
    good = np.flatnonzero(lines.usable & np.isfinite(value))
    if not good.size or recorded is None:
        return
    i = good[np.argmin(np.abs(panel.x.share(lines.frequency[good]) - 0.17))]
    x, y = float(panel.px(lines.frequency[[i]])[0]), float(panel.py(value[[i]])[0])
    above = y > panel.top + 70
    beside = good[panel.px(lines.frequency[good]) < panel.left + _CAPTION_WIDTH]
    heights = panel.py(value[beside])
    place = max(panel.top + 12, min(y - 48, float(heights.min(initial=y)) - 24)) if above else y + 52
    pointer(panel.drawing, (x, y + (-6 if above else 6)), (x, place + (20 if above else -12)), INK)
    panel.drawing.write(panel.left + 6, place, "corrected for clamp", size=11.3)
    panel.drawing.write(panel.left + 6, place + 13.5, "and load cell, ±2 SD", size=11.3)
    raw = np.degrees(np.angle(recorded.value)) if phase else np.log(np.abs(recorded.value))
    film = np.interp(recorded.frequency, lines.frequency, value if phase else np.log(value))
    height = panel.py(raw if phase else np.exp(raw))
    seen = np.isfinite(raw) & (height >= panel.top - 1) & (height <= panel.bottom - 34)  # the name stands at a point
    j = int(np.argmax(np.where(seen, np.abs(raw - film), 0)))
    y_raw = float(np.clip(panel.py([raw[j] if phase else np.exp(raw[j])])[0], panel.top + 14, panel.bottom - 34))
    x_raw = float(panel.px(recorded.frequency[[j]])[0])
    words = "as recorded" if phase else "as recorded, |F/x|"
    side = "end" if x_raw - 6 * len(words) > panel.left else None
    panel.drawing.write(x_raw + (-9 if side else 9), y_raw + 4, words, size=11.3, colour="#6b747d", anchor=side)


def _residuals(panel: Panel, curves: Sequence[Curve], *, phase: bool, alarm: bool) -> None:
    """Residual of the chosen order, and of the one below unless most of it would lie off the scale."""
    chosen = next((c for c in curves if c.selected), None)
    below = next((c for c in curves if chosen and c.order == chosen.order - 1), None)
    in_sd = chosen is None or chosen.residual.in_sd
    if in_sd:
        panel.across(-2, 2)
    panel.level(0)
    x = panel.right
    if chosen:
        panel.drawing.write(x, panel.top - 8, f"● {chosen.name} ✓", colour=MODEL, anchor="end", bold=True)
        x -= 56
    if below:
        f, off = below.residual.frequency, below.residual.phase if phase else below.residual.magnitude
        drawn = bool(np.mean(np.abs(off) > panel.y.high) < 0.4) if off.size else False
        words = f"○ {below.name} order" if drawn else f"{below.name}: off the scale"
        panel.drawing.write(x, panel.top - 8, words, colour="#2f7fb8", anchor="end")
        if drawn:
            panel.held(f, off, LOWER, 4.2, open_=True)
    if chosen:
        f, off = chosen.residual.frequency, chosen.residual.phase if phase else chosen.residual.magnitude
        panel.held(f, off, MODEL, 4.2 if off.size < 120 else 3.4)
        if alarm and in_sd and np.any(np.abs(off) > 4):
            _worst(panel, f, off, chosen.times_noise)
    title = "Residual of the record, SD" if chosen and chosen.residual.recorded else "Residual, SD of the noise"
    if panel.width < _ROOM_FOR_WORDS:
        title = "Residual, SD"
    if not in_sd:
        title = "Residual, degrees" if phase else "Residual, %"
    tick = nice(0.9 * panel.y.high)
    panel.axes(title, "Frequency, Hz", y_ticks=(-tick, 0, tick))
    if in_sd:
        panel.drawing.write(panel.right + 6, float(panel.py([0])[0]) + 4, "±2 SD", size=11.3, colour=SECOND)


def residual_reach(curves: Sequence[Curve], *, phase: bool) -> float:
    """Half height of the residual panel: fixed in SD, else what the chosen model leaves."""
    chosen = next((c for c in curves if c.selected), None)
    if chosen is None or chosen.residual.in_sd:
        return _REACH
    off = np.abs(chosen.residual.phase if phase else chosen.residual.magnitude)
    off = off[np.isfinite(off)]
    return 1.15 * float(off.max()) if off.size and off.max() > 0 else 1.0


def _worst(panel: Panel, f: Float, off: Float, times_noise: float | None) -> None:
    """Residuals beyond 3 SD in the colour of what is wrong; beside the largest its frequency, and what the whole fit leaves."""
    wrong = np.abs(off) > 3
    panel.held(f[wrong], off[wrong], WRONG, 4.2)
    i = int(np.nanargmax(np.abs(off)))
    at = f"most at {compact(float(f[i]), 2)} Hz"
    words = [at] if times_noise is None else [f"over all data {significant(times_noise, 2)} times the noise;", at]
    x = float(panel.px(f[[i]])[0])
    anchor = "end" if x > panel.left + 0.4 * panel.width else None
    room = x - 34 - panel.left if anchor else panel.right - x - 12
    lines = [" ".join(words)] if _LETTER * len(" ".join(words)) <= room else words
    y = panel.top + 10 if off[i] > 0 else panel.bottom - 5 - _LINE * (len(lines) - 1)
    for k, line in enumerate(lines):
        panel.drawing.write(
            x + (-34 if anchor else 12), y + _LINE * k, line, colour=WRONG, anchor=anchor, bold=True, size=11.3
        )


_LETTER = 6.1
"""Width of a letter of the words beside the largest residual, px: what has no room on one line takes two."""
_LINE = 12.0
"""Height of these lines, px."""
_ROOM_FOR_WORDS = 300.0
"""Width of a panel, px, from which on the title of the residual has room beside the names of the orders."""
_CAPTION_WIDTH = 130.0
"""Width of the words over the points, px: they stand above all of them."""

OUTSIDE = 3.0
"""Residual from which on a point of the overview is drawn in the colour of what is wrong, SD."""
_JUMP, _NEIGHBOURS = 1.25, 1.3
"""Factor between the measured points over the model that is a jump, and of the frequencies that are neighbours."""


@dataclass(frozen=True)
class Multiple:
    """A specimen in the overview: measured points, selected model, alarm colour where the residual is no noise."""

    name: str
    lines: Lines
    curve: Curve | None
    alarm: bool


def find_jump(lines: Lines, model: Complex) -> tuple[float, float] | None:
    """Frequency in Hz and factor of the largest jump of the usable lines against a model's values (n,) at all lines."""
    good = np.flatnonzero(lines.usable & (np.abs(lines.value) > 0))
    good = good[np.argsort(lines.frequency[good], kind="stable")]
    if good.size < 3:
        return None
    f = lines.frequency[good]
    over = np.log(np.abs(lines.value[good]) / np.abs(model[good]))
    beside = (f[1:] < _NEIGHBOURS * f[:-1]) & (f[1:] > f[:-1])
    steps = np.where(beside, np.abs(np.diff(over)), 0.0)
    place = int(np.argmax(steps))
    factor = float(np.exp(steps[place]))
    return (float(np.sqrt(f[place] * f[place + 1])), factor) if factor > _JUMP else None


@pictured("multiple")
def multiple(item: Multiple, x: Scale, y: Scale, *, alt: str) -> Drawing:
    """A small response with its residual, on axes shared by all specimens."""
    drawing = Drawing(NARROW, 187)
    upper = Panel(drawing, 30, 6, 190, 94, x, y)
    in_sd = item.curve is None or item.curve.residual.in_sd
    reach = 9.0 if in_sd or item.curve is None else residual_reach([item.curve], phase=False)
    lower = Panel(drawing, 30, 117, 190, 46, x, symmetric(reach))
    upper.axes(x_labels=False, x_most=5, y_most=3, size=10.5)
    if in_sd:
        lower.across(-2, 2)
    lower.level(0)
    every = max(1, -(-item.lines.size // 40))
    good = np.flatnonzero(item.lines.usable)[::every]
    if item.curve:
        upper.curve(item.curve.grid, np.abs(item.curve.on_grid), LOWER, 1.8)
        left = item.curve.residual
        thin = max(1, -(-left.frequency.size // 60))
        f, off = left.frequency[::thin], left.magnitude[::thin]
        wrong = np.abs(off) > OUTSIDE if item.alarm and in_sd else np.full(off.shape, item.alarm and not in_sd)
        lower.held(f[~wrong], off[~wrong], MODEL, 3.6)
        lower.held(f[wrong], off[wrong], WRONG, 3.6)
    upper.dots(item.lines.frequency[good], np.abs(item.lines.value)[good], INK, 3.4)
    tick = nice(0.7 * reach)
    lower.axes(x_most=5 if x.high / x.low < 1e6 else 3, y_ticks=(-tick, tick), signed=True, size=10.5)
    for panel, title in (
        (upper, "Dynamic stiffness |k|, N/mm"),
        (lower, "Residual, SD"),
    ):  # there is no room to write it
        panel.plot.x_title, panel.plot.y_title = "Frequency, Hz", title
    return drawing.told(alt)


@pictured("correction")
def correction(lines: Lines, recorded: Lines, expected: Complex | None, grid: Float, *, alt: str) -> Drawing:
    """What the resonance of clamp and load cell did to the record: recorded over corrected, magnitude and phase."""
    ratio = np.interp(lines.frequency, recorded.frequency, recorded.value.real) + 1j * np.interp(
        lines.frequency, recorded.frequency, recorded.value.imag
    )
    ratio = ratio / lines.value
    drawing = Drawing(WIDE, 344)
    x = logarithmic(lines.frequency, margin=0.015)
    good = lines.usable
    y = logarithmic(np.abs(ratio[good]), [1.0], np.abs(expected) if expected is not None else [], margin=0.08)
    upper = Panel(drawing, 46, 24, 372, 150, x, y)
    angle = np.degrees(np.angle(ratio))
    lower = Panel(drawing, 46, 206, 372, 92, x, linear(angle[good], [0.0], margin=0.1))
    _greyed(lines, upper, lower)
    upper.level(1.0, "#c9ced4")
    lower.level(0.0, "#c9ced4")
    if expected is not None:
        upper.curve(grid, np.abs(expected), MODEL)
        lower.curve(grid, np.degrees(np.angle(expected)), MODEL)
        i = int(np.argmax(np.abs(np.log(np.abs(expected)))))
        upper.label(
            grid[i], float(np.abs(expected[i])), "fitted clamp\nand load cell", MODEL, anchor="end", bold=True, dx=-16
        )
    upper.dots(lines.frequency[~good], np.abs(ratio)[~good], RAW, 3.4)
    lower.dots(lines.frequency[~good], angle[~good], RAW, 3.4)
    upper.dots(lines.frequency[good], np.abs(ratio)[good], INK, 4.0)
    lower.dots(lines.frequency[good], angle[good], INK, 4.0)
    upper.axes("Recorded over corrected, magnitude", x_labels=False)
    lower.axes("Recorded over corrected, degrees", "Frequency, Hz", y_most=4)
    return drawing.told(alt)


@pictured("amplification")
def amplification(lines: Lines, *, alt: str) -> Drawing:
    """Where the correction still carries information: its amplification of the noise, with the limit."""
    drawing = Drawing(WIDE, 344)
    x = logarithmic(lines.frequency, margin=0.015)
    panel = Panel(drawing, 46, 24, 372, 274, x, logarithmic(lines.amplification, [1.0, 8.0], margin=0.08))
    for low, high in beyond(lines.frequency, lines.amplification):
        panel.column(low, high)
    panel.level(LIMIT, WRONG, 1.2, dash="6 3")
    panel.label(x.low, LIMIT, "not used above 5 ×", WRONG, bold=True, dx=8, dy=-7)
    order = np.argsort(lines.frequency, kind="stable")
    panel.curve(lines.frequency[order], lines.amplification[order], SECOND, 1.2)
    over = np.nan_to_num(lines.amplification) > LIMIT
    panel.dots(lines.frequency[~over], lines.amplification[~over], INK, 4.0)
    panel.dots(lines.frequency[over], lines.amplification[over], WRONG, 4.4, open_=True)
    panel.axes("Noise, corrected over recorded response, relative", "Frequency, Hz")
    return drawing.told(alt)


@pictured("spectrum")
def spectrum(stages: Mapping[str, Lines], unit: str, *, alt: str) -> Drawing:
    """The response of one recording at each stage: magnitude above, phase below."""
    drawing = Drawing(WIDE, 344)
    x = logarithmic(*(s.frequency for s in stages.values()), margin=0.015)
    drawn = {"measured": (RAW, True), "corrected": (INK, False)}
    inside = [s.value[s.usable] for s in stages.values()]
    y = logarithmic(*(np.abs(v) for v in inside), margin=0.06)
    angles = [np.degrees(np.angle(v)) for v in inside]
    upper = Panel(drawing, 52, 24, 346, 150, x, y)
    lower = Panel(drawing, 52, 206, 346, 92, x, linear(*angles, [0.0], margin=0.08))
    _greyed(list(stages.values())[-1], upper, lower)
    lower.level(0.0, "#c9ced4")
    entries = []
    for stage, lines in stages.items():
        colour, open_ = drawn.get(stage, (MODEL, False))
        good, magnitude = lines.usable, np.abs(lines.value)
        f, angle = lines.frequency, np.degrees(np.angle(lines.value))
        upper.bars(f[good], (magnitude - 2 * lines.component)[good], (magnitude + 2 * lines.component)[good], colour)
        upper.dots(f[good], magnitude[good], colour, 4.4, open_=open_)
        upper.dots(f[~good], magnitude[~good], RULE, 3.0)
        lower.dots(f[good], angle[good], colour, 4.4, open_=open_)
        lower.dots(f[~good], angle[~good], RULE, 3.0)
        if good.any():
            entries.append((float(magnitude[good][-1]), stage, colour if colour != RAW else "#6b747d", not open_))
    upper.names(entries)
    upper.axes(f"Magnitude, {unit}", x_labels=False)
    lower.axes("Phase, degrees", "Frequency, Hz", y_most=4)
    return drawing.told(alt)
