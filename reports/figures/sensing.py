"""Self-sensing: open against closed loop, gains of a controller, sensitivity against geometry, coats and cycles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import BAND, BETTER, INK, LOWER, MODEL, RAW, SECOND, WRONG, group
from reports.figures.panel import WIDE, Drawing, Panel, note, pointer
from reports.figures.picture import pictured
from reports.figures.scale import Scale, apart, linear, logarithmic
from schemas.arrays import Bool, Float
from schemas.numbers import compact


@dataclass(frozen=True)
class Channel:
    """One quantity of a run over the time since its start, s."""

    time: Float
    value: Float


@dataclass(frozen=True)
class Run:
    """A run to be compared: its name and its channels (voltage kV, capacitance pF, drop of tension mN) where known."""

    name: str
    closed: bool
    channels: dict[str, Channel]


_TITLES = {"voltage": "Voltage, kV", "capacitance": "Capacitance, pF", "force": "Drop of tension, mN"}


@pictured("open-and-closed-loop")
def open_closed(runs: Sequence[Run], demand_pf: float | None, until_s: float, *, alt: str) -> Drawing:
    """Voltage, capacitance and force of an open and a closed loop over the same time, one above the other."""
    height, gap = 112.0, 44.0
    drawing = Drawing(WIDE, 30 + 3 * (height + gap) + 14)
    start = min(float(c.time.min()) for r in runs for c in r.channels.values())
    x = Scale(start, until_s)
    for i, (quantity, title) in enumerate(_TITLES.items()):
        drawn = [(r, r.channels[quantity]) for r in runs if quantity in r.channels]
        within = [c.value[c.time <= until_s] for _, c in drawn]
        extra = [] if quantity != "capacitance" or demand_pf is None else [demand_pf]
        y = linear(*(_trimmed(v) for v in within), extra, zero=quantity != "capacitance", margin=0.1)
        panel = Panel(drawing, 52, 24 + i * (height + gap), 336, height, x, y)
        if quantity == "capacitance" and demand_pf is not None:
            panel.level(demand_pf, BETTER, 1.2, dash="5 3")
        names = []
        for run, channel in drawn:
            colour = MODEL if run.closed else RAW
            shown = channel.time <= until_s
            panel.curve(channel.time[shown], channel.value[shown], colour, 1.6)
            late = shown & (channel.time > 0.7 * until_s)
            if late.any():
                names.append(
                    (float(np.median(channel.value[late])), run.name, colour if run.closed else SECOND, run.closed)
                )
        if quantity == "capacitance" and demand_pf is not None:
            names.append((demand_pf, "demand", BETTER, False))
        panel.names(names)
        panel.axes(title, "Time since the change, s" if i == 2 else "", x_labels=i == 2, y_most=4)
    return drawing.told(alt)


def _trimmed(values: Float) -> Float:
    """Values without the few that stand out: interference at an edge must not set the scale."""
    return values if values.size < 50 else np.clip(values, *np.quantile(values, [0.004, 0.996]))


@dataclass(frozen=True)
class Gains:
    """Loops of one proportional gain: integral gains (n,), rise s, overshoot %, overshoot of the force %, settled (n,)."""

    proportional: float
    integral: Float
    rise: Float
    overshoot: Float
    force_overshoot: Float
    settled: Bool


@pictured("gains")
def gains(rows: Sequence[Gains], best: tuple[float, float] | None, *, alt: str) -> Drawing:
    """Rise, overshoot and overshoot of the force against the integral gain, a line per proportional gain."""
    height, gap = 96.0, 42.0
    drawing = Drawing(WIDE, 30 + 3 * (height + gap) + 18)
    x = logarithmic(*(r.integral for r in rows), margin=0.06)
    panels = (("Rise time, s", "rise", 0.5), ("Overshoot of the capacitance, %", "overshoot", 10.0), ("Overshoot of the force, %", "force_overshoot", 10.0))  # fmt: skip
    for i, (title, quantity, limit) in enumerate(panels):
        values = [getattr(r, quantity) for r in rows]
        y = linear(*values, [0.0, 1.2 * limit], zero=True, margin=0.08)
        panel = Panel(drawing, 52, 24 + i * (height + gap), 326, height, x, y)
        panel.across(0.0, limit, BAND)
        names = []
        for j, (row, value) in enumerate(zip(rows, values, strict=True)):
            drawn = group(j)
            panel.curve(row.integral, value, drawn.colour, 1.3, dash=drawn.dash)
            panel.dots(row.integral[row.settled], value[row.settled], drawn.colour, 5.0, marker=drawn.marker)
            panel.dots(
                row.integral[~row.settled], value[~row.settled], drawn.colour, 5.0, marker=drawn.marker, open_=True
            )
            known = value[np.isfinite(value)]
            if known.size:
                names.append((float(known[-1]), f"{compact(row.proportional, 3)} V/pF", drawn.colour, False))
            if best is not None and row.proportional == best[0]:
                here = row.integral == best[1]
                panel.dots(row.integral[here], value[here], INK, 11.0, open_=True)
        panel.names(names)
        panel.axes(title, "Integral gain, V/pF/s" if i == 2 else "", x_labels=i == 2, y_most=4)
        if i == 0:
            note(drawing, panel.left + 6, float(panel.py([limit])[0]) - 4, "goal")
    return drawing.told(alt)


@pictured("agreement")
def agreement(
    names: Sequence[str], predicted: Float, measured: Float, low: Float, high: Float, shown: int | None, *, alt: str
) -> Drawing:
    """Measured against predicted sensitivity (n,), with 95 % limits; the specimen at hand is filled, the others open."""
    drawing = Drawing(WIDE, 290)
    scale = linear(predicted, low, high, [0.0], margin=0.08)
    panel = Panel(drawing, 52, 24, 300, 218, scale, scale)
    panel.curve([scale.low, scale.high], [scale.low, scale.high], MODEL, 1.6)
    panel.label(scale.high, scale.high, "as predicted", MODEL, anchor="end", dx=-6, dy=-6)
    panel.bars(predicted, low, high, SECOND)
    for i in range(len(names)):
        panel.dots([predicted[i]], [measured[i]], INK if i == shown else SECOND, 5.4, open_=i != shown)
    _name_points(panel, names, predicted, measured, shown)
    panel.axes("Sensitivity measured", "Sensitivity predicted from the geometry")
    return drawing.told(alt)


def _name_points(panel: Panel, names: Sequence[str], x: Float, y: Float, shown: int | None) -> None:
    """Names right of their points (n,), pushed apart where they meet; a line leads to those that had to move."""
    at = np.column_stack([panel.px(x), panel.py(y)])
    order = np.argsort(at[:, 1], kind="stable").tolist()
    places = apart(at[order, 1].tolist(), 14.5, panel.top, panel.bottom)
    for i, place in zip(order, places, strict=True):
        across, down = at[i].tolist()
        moved = abs(place - down) > 7
        left = across + (22 if moved else 9)
        if moved:
            pointer(panel.drawing, (left - 3, place), (across + 4, down), SECOND)
        colour = INK if i == shown else SECOND
        panel.drawing.write(left, place + 4, names[i], colour=colour, bold=i == shown)


@dataclass(frozen=True)
class Pairing:
    """Outputs of a free film and of one whose passive part is held, (n,) each over voltage, and what is expected of the held one."""

    voltage_kv: Float
    free: Float
    held: Float
    expected: Float
    title: str


@pictured("constraint")
def constraint(pairings: Sequence[Pairing], *, alt: str) -> Drawing:
    """Force and capacitance of a held and a free film over voltage, one above the other (thesis, fig 5-11)."""
    height, gap = 128.0, 52.0
    drawing = Drawing(WIDE, 24 + len(pairings) * (height + gap))
    for i, one in enumerate(pairings):
        x = linear(one.voltage_kv, margin=0.05)
        panel = Panel(drawing, 52, 24 + i * (height + gap), 320, height, x, linear(one.free, one.held, zero=True))
        panel.curve(one.voltage_kv, one.expected, MODEL, 1.8)
        panel.dots(one.voltage_kv, one.held, INK, 5.0)
        panel.dots(one.voltage_kv, one.free, SECOND, 5.0, open_=True)
        names: list[tuple[Float, str, str, bool]] = [
            (one.held, "held", INK, False),
            (one.free, "free", SECOND, False),
            (one.expected, "expected", MODEL, True),
        ]
        panel.names([(float(values[-1]), name, colour, bold) for values, name, colour, bold in names])
        panel.axes(one.title, "Voltage, kV" if i == len(pairings) - 1 else "")
    return drawing.told(alt)


@pictured("sensitivity-map")
def sensitivity_map(names: Sequence[str], sensing: Float, rest: Float, measured: Float, *, alt: str) -> Drawing:
    """Sensitivity 1/(R + R_d) over geometry as lines of equal values, with specimens (n,) at their places (thesis, eq 5.19 to 5.23).

    `sensing`: R, length of the sensing region over that of the active one; `rest`: R_d, that of what is free and neither; `measured`:
    the sensitivities found.
    """
    drawing = Drawing(WIDE, 290)
    reach = 1.25 * max(1.0, float(sensing.max()), float(rest.max()))
    panel = Panel(drawing, 52, 24, 300, 218, Scale(0.0, reach), Scale(0.0, reach))
    for value in (0.25, 0.33, 0.5, 1.0, 2.0):
        ends = np.array([0.0, min(1 / value, reach)])
        panel.curve(ends, 1 / value - ends, LOWER, 1.2)
        low = max(0.0, 1 / value - reach)
        if low < 0.9 * reach:
            panel.label(low, 1 / value - low, compact(value, 2), MODEL, dx=5, dy=14 if low == 0 else 18, size=11.3)
    for i, name in enumerate(names):
        panel.dots([sensing[i]], [rest[i]], INK, 5.4)
        panel.label(
            float(sensing[i]),
            float(rest[i]),
            f"{name}: {compact(float(measured[i]), 2)}",
            INK,
            dx=8,
            dy=4 + 14 * _above(i, sensing, rest),
        )
    panel.axes("Free rest over active length", "Sensing region over active length")
    return drawing.told(alt)


def _above(i: int, sensing: Float, rest: Float) -> int:
    """How many earlier specimens stand at the same place: names go below each other."""
    return sum(abs(sensing[j] - sensing[i]) + abs(rest[j] - rest[i]) < 0.05 for j in range(i))


@pictured("coats")
def coats(
    number: Float, capacitance: Float, full: tuple[float, float, float] | None, cover: float | None, *, alt: str
) -> Drawing:
    """Capacitance (n,) over the number of coats; the covered region's with its limits, and the coats that it takes."""
    drawing = Drawing(WIDE, 270)
    extra = [] if full is None else list(full)
    panel = Panel(drawing, 52, 24, 340, 198, Scale(0.0, 1.05 * float(number.max())), linear(capacitance, extra))
    if full is not None:
        panel.across(full[1], full[2], BAND)
        panel.level(full[0], MODEL, 1.2)
        panel.names([(full[0], "covered", MODEL, True)])
    if cover is not None and cover <= panel.x.high:
        top = float(panel.px([cover])[0])
        drawing.line([(top, panel.top), (top, panel.bottom)], SECOND, 0.9, dash="4 3")
        note(drawing, top + 4, panel.bottom - 6, "99 %")
    panel.dots(number, capacitance, INK, 5.0)
    panel.axes("Capacitance at rest, pF", "Coats")
    return drawing.told(alt)


@pictured("migration")
def migration(
    cycle: Float, lines: Sequence[tuple[str, Float]], onset: tuple[float, float, float] | None, *, alt: str
) -> Drawing:
    """Harmonics over the fundamental, percent, by cycle; the onset with its limits."""
    drawing = Drawing(WIDE, 270)
    panel = Panel(
        drawing,
        52,
        24,
        330,
        198,
        Scale(0.0, float(cycle.max()) * 1.02),
        logarithmic(*(v for _, v in lines), margin=0.08),
    )
    if onset is not None:
        panel.column(onset[1], onset[2], BAND)
        at = float(panel.px([onset[0]])[0])
        drawing.line([(at, panel.top), (at, panel.bottom)], WRONG, 1.2)
        note(drawing, at - 5, panel.top + 12, "migration begins", WRONG, anchor="end")
    entries = []
    for i, (name, value) in enumerate(lines):
        drawn = INK if i == 0 else group(i).colour
        panel.curve(cycle, value, drawn, 1.6 if i == 0 else 1.1)
        entries.append((float(np.median(value[-10:])), name, drawn, i == 0))
    panel.names(entries)
    panel.axes("Harmonics over the fundamental, %", "Cycle")
    return drawing.told(alt)
