"""Do several temperatures make one curve? The master curve, its shifts, phase over magnitude, and what is left by temperature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from reports.figures.palette import INK, MODEL, RAW, SECOND
from reports.figures.panel import WIDE, Drawing, Panel
from reports.figures.picture import pictured
from reports.figures.scale import linear, logarithmic
from schemas.arrays import Float
from schemas.numbers import NBSP, fixed

_LEFT, _WIDTH, _HEIGHT = 60.0, 340.0, 330.0
_COLDEST, _HOTTEST = np.array([0x1B, 0x1F, 0x23]), np.array([0xB4, 0xBB, 0xC3])


@dataclass(frozen=True)
class Points:
    """The points of one temperature, °C: place on the master curve (n,) Hz or s, storage and loss (n,), and the common curve.

    Of a relaxation the storage is its value, and there is no loss.
    """

    temperature: float
    place: Float
    storage: Float
    loss: Float
    curve_storage: Float
    curve_loss: Float

    @property
    def phase(self) -> Float:
        """(n,) degrees."""
        return np.degrees(np.arctan2(self.loss, self.storage))


def shades(count: int) -> list[str]:
    """Greys from the coldest, ink, to the hottest, light."""
    shares = np.linspace(0, 1, count) if count > 1 else np.zeros(1)
    return ["#" + "".join(f"{round(c):02x}" for c in _COLDEST + s * (_HOTTEST - _COLDEST)) for s in shares]


@pictured("master-curve")
def master(found: Sequence[Points], unit: str, *, in_time: bool, alt: str) -> Drawing:
    """Storage (circles) and loss (squares) against reduced frequency, temperatures from cold (ink) to hot (light), curve through them."""
    drawing = Drawing(WIDE, _HEIGHT)
    place = np.concatenate([p.place for p in found])
    values = [p.storage for p in found] + [] if in_time else [v for p in found for v in (p.storage, p.loss)]
    panel = Panel(drawing, _LEFT, 24, _WIDTH, 250, logarithmic(place, margin=0.03), logarithmic(*values, margin=0.06))
    order = np.argsort(place)
    for parts in ("storage",) if in_time else ("storage", "loss"):
        marker = "circle" if parts == "storage" else "square"
        for i, (points, colour) in enumerate(zip(found, shades(len(found)), strict=True)):
            panel.dots(points.place, getattr(points, parts), colour, 4.2, marker=marker, open_=bool(i % 2))
        curve = np.concatenate([getattr(p, f"curve_{parts}") for p in found])[order]
        panel.curve(place[order], curve, MODEL, 1.4)
    last = int(np.argmax(place))
    ends = [("storage", np.concatenate([p.curve_storage for p in found]))]
    if not in_time:
        ends.append(("loss", np.concatenate([p.curve_loss for p in found])))
        panel.names([(float(v[last]), name, MODEL, False) for name, v in ends])
    _label_ends(panel, found)
    what = f"Relaxation, {unit}" if in_time else f"Storage ● and loss ■, {unit}"
    panel.axes(what, "Reduced time t/a, s" if in_time else "Reduced frequency a f, Hz", x_most=7)
    return drawing.told(alt)


def _label_ends(panel: Panel, found: Sequence[Points]) -> None:
    """The coldest and the hottest temperature at their points."""
    for points, colour, down in ((found[0], INK, 18.0), (found[-1], SECOND, -9.0)):
        middle = int(np.argsort(points.place)[points.place.size // 2])
        text = f"{fixed(points.temperature, 1)}{NBSP}°C"
        panel.label(float(points.place[middle]), float(points.storage[middle]), text, colour, anchor="middle", dy=down)


@pictured("shifts")
def shifts(
    temperature: Float,
    log_a: Float,
    lower: Float,
    upper: Float,
    course: tuple[Float, Float] | None,
    name: str,
    *,
    alt: str,
) -> Drawing:
    """log10 a (n,) with its 95 % limits against temperature (n,) °C, and the law's course."""
    drawing = Drawing(WIDE, _HEIGHT)
    parts = [log_a, lower, upper] + ([course[1]] if course else [])
    panel = Panel(drawing, _LEFT, 24, _WIDTH, 250, linear(temperature), linear(*parts, [0.0]))
    panel.level(0.0)
    if course is not None:
        panel.curve(*course, MODEL, 1.6)
        panel.names([(float(course[1][-1]), name, MODEL, True)])
    panel.bars(temperature, lower, upper, SECOND)
    panel.dots(temperature, log_a, INK, 4.6)
    panel.axes("Shift log₁₀ a", "Temperature, °C", signed=True)
    return drawing.told(alt)


@pictured("phase-over-magnitude")
def phase_over_magnitude(found: Sequence[Points], unit: str, *, alt: str) -> Drawing:
    """Phase against magnitude of all temperatures, unshifted: one curve where the superposition holds (van Gurp and Palmen)."""
    drawing = Drawing(WIDE, _HEIGHT)
    sizes = [np.hypot(p.storage, p.loss) for p in found]
    panel = Panel(
        drawing, _LEFT, 24, _WIDTH, 250, logarithmic(*sizes, margin=0.04), linear(*(p.phase for p in found), zero=True)
    )
    size = np.concatenate([np.hypot(p.curve_storage, p.curve_loss) for p in found])
    phase = np.concatenate([np.degrees(np.arctan2(p.curve_loss, p.curve_storage)) for p in found])
    order = np.argsort(np.concatenate([p.place for p in found]))
    for i, (points, colour) in enumerate(zip(found, shades(len(found)), strict=True)):
        panel.dots(sizes[i], points.phase, colour, 4.2, open_=bool(i % 2))
    panel.curve(size[order], phase[order], MODEL, 1.4)
    panel.axes("Phase, degrees", f"Magnitude, {unit}")
    return drawing.told(alt)


@pictured("misfits")
def misfits(temperature: Float, misfit: Float, noise: float, title: str, *, alt: str) -> Drawing:
    """What the common curve leaves (n,) against temperature (n,) °C, beside the noise."""
    drawing = Drawing(WIDE, _HEIGHT)
    panel = Panel(drawing, _LEFT, 24, _WIDTH, 250, linear(temperature), linear(misfit, [noise, 0.0], zero=True))
    panel.level(noise, RAW, 1.2, dash="6 3")
    panel.names([(noise, "noise", SECOND, False)])
    panel.dots(temperature, misfit, INK, 4.6)
    panel.axes(title, "Temperature, °C")
    return drawing.told(alt)
