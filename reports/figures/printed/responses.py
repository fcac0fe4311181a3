"""Responses over frequency: stiffness with its models, force under voltage, blocked force, one recording at each stage."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reports.figures.electrical import Drive
from reports.figures.palette import BETTER, INK, LOWER, LOWEST, MODEL, RAW, RULE, SECOND, WRONG, group
from reports.figures.plot import Scale, linear, logarithmic
from reports.figures.printed.axes import (
    Name,
    draw_band,
    draw_bars,
    draw_curve,
    draw_held,
    draw_points,
    draw_residual_strip,
    mark_column,
    mark_level,
    name_curves,
    scale_axes,
    write_note,
)
from reports.figures.printed.style import CURVE_PT, DOUBLE, POINT_PT, SINGLE, TICK_PT, open_axes, styled
from reports.figures.responses import Curve, Lines, beyond, residual_reach, scale_of_values
from schemas.arrays import Complex, Float
from schemas.numbers import MINUS, compact

_FAINT = "#c9ced4"
_FREQUENCY = "Frequency, Hz"
_REACH = 7.0
_WRONG_SD = 3.0


@styled()
def draw_response(
    lines: Lines,
    recorded: Lines | None,
    curves: Sequence[Curve],
    *,
    width: str = DOUBLE,
    phase: bool = False,
    alarm: bool = False,
) -> Figure:
    """Dynamic stiffness and its phase with the models, and below each what the chosen order and the one below it leave.

    Parameters
    ----------
    lines : the response of the film
    recorded : the response before clamp and load cell were taken out, where that differs
    curves : the models, one an order
    width : `single` or `double` column
    phase : without meaning here: both parts are drawn
    alarm : residuals beyond 3 SD are marked as wrong, and the largest is named
    """
    x = logarithmic(lines.frequency, *([recorded.frequency] if recorded else []), margin=0.015)
    strips = bool(curves)
    if width == DOUBLE:
        figure, axes = open_axes(width, 78 if strips else 58, (2.6, 1.0) if strips else (1.0,), 2)
        parts = [(False, *axes[:, 0]), (True, *axes[:, 1])]
    else:
        heights = (2.2, 1.0, 2.2, 1.0) if strips else (1.0, 1.0)
        figure, axes = open_axes(width, 150 if strips else 100, heights)
        parts = [(False, *axes[:2, 0]), (True, *axes[2:, 0])] if strips else [(False, axes[0, 0]), (True, axes[1, 0])]
    named = []
    for is_phase, upper, *lower in parts:
        named.append((upper, _draw_part(upper, x, lines, recorded, curves, phase=is_phase, alone=not lower)))
        if lower:
            _draw_left(lower[0], x, curves, phase=is_phase, alarm=alarm)
    for upper, names in named:
        name_curves(upper, names)
    return figure


def _shown(value: Complex, *, phase: bool) -> Float:
    return np.degrees(np.angle(value)) if phase else np.abs(value)


def _draw_part(
    axes: Axes, x: Scale, lines: Lines, recorded: Lines | None, curves: Sequence[Curve], *, phase: bool, alone: bool
) -> list[Name]:
    """Magnitude or phase of everything; gives the names of the models."""
    value = _shown(lines.value, phase=phase)
    measured = [value] + ([_shown(recorded.value, phase=phase)] if recorded else [])
    y = scale_of_values(measured, curves, lambda v: _shown(v, phase=phase), phase=phase)
    title = "Phase of k, degrees" if phase else "Dynamic stiffness |k|, N/mm"
    scale_axes(axes, x, y, title, _FREQUENCY if alone else "", x_labels=alone)
    _grey(lines, axes)
    if phase and y.low < 0 < y.high:
        mark_level(axes, 0.0, _FAINT)
    if recorded:
        draw_held(axes, recorded.frequency, measured[1], y, RAW, hollow=True)
    for curve in curves:
        _draw_model(axes, curve, phase=phase)
    spread = np.degrees(lines.component / np.abs(lines.value)) if phase else lines.component
    good = lines.usable
    draw_points(axes, lines.frequency[~good], value[~good], RAW, 0.8 * POINT_PT)
    draw_bars(axes, lines.frequency[good], (value - 2 * spread)[good], (value + 2 * spread)[good], INK)
    draw_points(axes, lines.frequency[good], value[good], INK)
    if not phase:
        write_note(
            axes, 0.03, 0.955, "● corrected for clamp and load cell, ±2 SD" if recorded else "● measured, ±2 SD", INK
        )
        if recorded:
            write_note(axes, 0.03, 0.885, "○ as recorded, |F/x|", "#6b747d")
    return [_name(c, float(_shown(c.on_grid[-1:], phase=phase)[0])) for c in curves]


def _draw_model(axes: Axes, curve: Curve, *, phase: bool) -> None:
    value = _shown(curve.on_grid, phase=phase)
    if curve.selected:
        if curve.sd is not None:
            reach = 1.96 * (np.degrees(curve.sd[1]) if phase else curve.sd[0])
            draw_band(axes, curve.grid, value - reach, value + reach, MODEL, 0.22)
        draw_curve(axes, curve.grid, value, MODEL)
    elif curve.order == 1:
        draw_curve(axes, curve.grid, value, LOWEST, 0.85 * CURVE_PT, (1, 2))
    else:
        draw_curve(axes, curve.grid, value, LOWER, 0.8 * CURVE_PT, (4, 2))


def _name(curve: Curve, y: float) -> Name:
    if curve.selected:
        return y, f"{curve.name} order ✓", MODEL, True
    return y, f"{curve.name} order", SECOND if curve.order == 1 else "#2f7fb8", False


def _grey(lines: Lines, *axes: Axes) -> None:
    """Columns where the correction amplifies the noise too much, named once."""
    columns = beyond(lines.frequency, lines.amplification)
    for low, high in columns:
        for one in axes:
            mark_column(one, low, high)
    if columns:
        low, high = max(columns, key=lambda c: c[1] / c[0])
        left, right = axes[0].get_xlim()
        share = float(np.log(np.sqrt(low * high) / left) / np.log(right / left))
        write_note(axes[0], min(max(share, 0.2), 0.8), 0.07, "correction amplifies\nnoise over 5 ×", side="center")


def _draw_left(axes: Axes, x: Scale, curves: Sequence[Curve], *, phase: bool, alarm: bool) -> None:
    """The residual of the chosen order, and of the one below unless most of it would lie off the scale."""
    chosen = next((c for c in curves if c.selected), None)
    below = next((c for c in curves if chosen and c.order == chosen.order - 1), None)
    in_sd = chosen is None or chosen.residual.in_sd
    title = "Residual of the record, SD" if chosen and chosen.residual.recorded else "Residual, SD"
    if not in_sd:
        title = "Residual, degrees" if phase else "Residual, %"
    y = draw_residual_strip(axes, x, residual_reach(curves, phase=phase), title, _FREQUENCY, in_sd=in_sd)
    if below:
        off = below.residual.phase if phase else below.residual.magnitude
        drawn = bool(np.mean(np.abs(off) > y.high) < 0.4) if off.size else False
        if drawn:
            draw_held(axes, below.residual.frequency, off, y, LOWER, hollow=True)
        text = f"○ {below.name} order" if drawn else f"{below.name} order: off the scale"
        write_note(axes, 0.99, 0.07, text, "#2f7fb8", side="right")
    if chosen:
        f, off = chosen.residual.frequency, chosen.residual.phase if phase else chosen.residual.magnitude
        draw_held(axes, f, off, y, MODEL)
        if alarm and in_sd and np.any(np.abs(off) > _WRONG_SD):
            wrong = np.abs(off) > _WRONG_SD
            draw_held(axes, f[wrong], off[wrong], y, WRONG)
            i = int(np.nanargmax(np.abs(off)))
            sign, side = ("+", 0.9) if off[i] > 0 else (MINUS, 0.1)
            text = f"{sign}{abs(off[i]):.0f} SD at {compact(float(f[i]), 2)} Hz"
            late = float(x.share(f[[i]])[0]) > 0.45
            write_note(axes, float(x.share(f[[i]])[0]) + (-0.09 if late else 0.09), side, text, WRONG, side="right" if late else "left", bold=True)  # fmt: skip
        axes.annotate(
            f"● {chosen.name} ✓", (1, 1), (0, 5), xycoords="axes fraction", textcoords="offset points", ha="right",
            va="baseline", fontsize=TICK_PT, color=MODEL, fontweight="bold", annotation_clip=False,
        )  # fmt: skip


@styled()
def draw_force_under_voltage(
    drives: Sequence[Drive], grid: Float, predicted: Complex | None, *, width: str = SINGLE
) -> Figure:
    """Force per voltage squared of each recording with the prediction of the mechanical model, and what that leaves.

    Parameters
    ----------
    drives : recordings
    grid, predicted : (m,) Hz and N/kV², None where there is no mechanical model
    """
    figure, axes = open_axes(width, 82, (2.4, 1.0))
    upper, lower = axes[:, 0]
    x = logarithmic(*(d.lines.frequency for d in drives), margin=0.015)
    values = [1e3 * np.abs(d.lines.value)[d.lines.usable] for d in drives]
    y = logarithmic(*values, 1e3 * np.abs(predicted) if predicted is not None else [], margin=0.08)
    scale_axes(upper, x, y, "Force per voltage squared |F/V²|, mN/kV²", x_labels=False)
    left = draw_residual_strip(lower, x, _REACH, "Residual, SD of the noise", _FREQUENCY)
    names = []
    for i, drive in enumerate(drives):
        names += _draw_drive(upper, drive, i)
        if drive.predicted is not None:
            good = drive.lines.usable
            off = (np.abs(drive.lines.value) - np.abs(drive.predicted)) / drive.lines.component
            draw_held(lower, drive.lines.frequency[good], off[good], left, group(i).colour, marker=group(i).marker)
    if predicted is not None:
        draw_curve(upper, grid, 1e3 * np.abs(predicted), MODEL)
        names.append((float(1e3 * np.abs(predicted[-1])), "predicted", MODEL, True))
    else:
        write_note(lower, 0.03, 0.85, "no mechanical model: nothing to predict from")
    name_curves(upper, names)
    return figure


def _draw_drive(axes: Axes, drive: Drive, index: int) -> list[Name]:
    """Magnitude of one recording in mN/kV², and its name at its last usable line."""
    drawn, good, f = group(index), drive.lines.usable, drive.lines.frequency
    magnitude, spread = 1e3 * np.abs(drive.lines.value), 1e3 * drive.lines.component
    draw_bars(axes, f[good], (magnitude - 2 * spread)[good], (magnitude + 2 * spread)[good], drawn.colour)
    draw_points(axes, f[~good], magnitude[~good], RAW, 0.8 * POINT_PT, marker=drawn.marker)
    draw_points(axes, f[good], magnitude[good], drawn.colour, marker=drawn.marker)
    return [(float(magnitude[good][-1]), drive.name, drawn.colour, False)] if good.any() else []


@styled()
def draw_blocked_force(
    drives: Sequence[Drive], fitted: float | None, fitted_sd: float | None, *, width: str = SINGLE
) -> Figure:
    """The actuation force itself, freed of film and rig, with its phase: flat where nothing but V² acts."""
    figure, axes = open_axes(width, 82, (1.7, 1.0))
    upper, lower = axes[:, 0]
    x = logarithmic(*(d.lines.frequency for d in drives), margin=0.015)
    values = [1e3 * np.abs(d.lines.value)[d.lines.usable] for d in drives]
    inside = [np.degrees(np.angle(d.lines.value))[d.lines.usable] for d in drives]
    scale_axes(upper, x, linear(*values, [0.0], margin=0.12, zero=True), "Blocked force per voltage squared, mN/kV²", x_labels=False)  # fmt: skip
    scale_axes(lower, x, linear(*inside, [-10.0, 10.0], margin=0.1), "Its phase, degrees", _FREQUENCY, y_most=4)
    _grey(drives[0].lines, upper, lower)
    mark_level(lower, 0.0, _FAINT)
    names: list[Name] = []
    if fitted is not None:
        reach = 1.96 * (fitted_sd or 0.0)
        upper.axhspan(1e3 * (fitted - reach), 1e3 * (fitted + reach), color=BETTER, alpha=0.22, linewidth=0)
        mark_level(upper, 1e3 * fitted, BETTER, CURVE_PT)
        names.append((1e3 * fitted, "fitted, flat", BETTER, True))
    for i, drive in enumerate(drives):
        own = _draw_drive(upper, drive, i)
        names += own if len(drives) > 1 else []
        angle, good = np.degrees(np.angle(drive.lines.value)), drive.lines.usable
        draw_points(lower, drive.lines.frequency[good], angle[good], group(i).colour, marker=group(i).marker)
    name_curves(upper, names)
    return figure


@styled()
def draw_spectrum(stages: Mapping[str, Lines], unit: str, *, width: str = SINGLE) -> Figure:
    """The response of one recording at each stage: magnitude above, phase below."""
    figure, axes = open_axes(width, 82, (1.7, 1.0))
    upper, lower = axes[:, 0]
    x = logarithmic(*(s.frequency for s in stages.values()), margin=0.015)
    inside = [s.value[s.usable] for s in stages.values()]
    angles = [np.degrees(np.angle(v)) for v in inside]
    scale_axes(upper, x, logarithmic(*(np.abs(v) for v in inside), margin=0.06), f"Magnitude, {unit}", x_labels=False)
    y = linear(*angles, [0.0], margin=0.08)
    scale_axes(lower, x, y, "Phase, degrees", _FREQUENCY, y_most=4)
    _grey(list(stages.values())[-1], upper, lower)
    mark_level(lower, 0.0, _FAINT)
    names: list[Name] = []
    for stage, lines in stages.items():
        colour, hollow = {"measured": (RAW, True), "corrected": (INK, False)}.get(stage, (MODEL, False))
        good, magnitude, angle = lines.usable, np.abs(lines.value), np.degrees(np.angle(lines.value))
        f, spread = lines.frequency, 2 * lines.component
        draw_bars(upper, f[good], (magnitude - spread)[good], (magnitude + spread)[good], colour)
        for axes_, shown in ((upper, magnitude), (lower, angle)):
            draw_points(axes_, f[~good], shown[~good], RULE, 0.8 * POINT_PT)
            draw_points(axes_, f[good], shown[good], colour, hollow=hollow)
        if good.any():
            names.append((float(magnitude[good][-1]), stage, colour if colour != RAW else "#6b747d", not hollow))
    name_curves(upper, names)
    return figure
