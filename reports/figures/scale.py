"""Scales of axes: their limits around data, their ticks, the words at the ticks, and names that do not touch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from schemas.arrays import Float
from schemas.numbers import NBSP, compact, fixed

_LEAST, _DECADES = 1e-290, 1e-30
"""What is smaller, by itself or against the largest value of a logarithmic axis, counts as nothing."""


@dataclass(frozen=True)
class Scale:
    """An axis from `low` to `high`, linear or logarithmic."""

    low: float
    high: float
    log: bool = False

    def share(self, values: ArrayLike) -> Float:
        """Position of values along the axis: 0 at `low`, 1 at `high`. NaN where a logarithm does not exist."""
        data = np.asarray(values, dtype=float)
        if not self.log:
            return np.asarray((data - self.low) / (self.high - self.low))
        with np.errstate(divide="ignore", invalid="ignore"):
            positive = np.log(np.where(data > 0, data, np.nan))
        return np.asarray((positive - math.log(self.low)) / math.log(self.high / self.low))

    def ticks(self, most: int = 6) -> tuple[list[float], list[float]]:
        """Labelled and unlabelled ticks: 1, 2, 5 and their powers of ten."""
        return _log_ticks(self.low, self.high, most) if self.log else (_linear_ticks(self.low, self.high, most), [])


def linear(*data: ArrayLike, zero: bool = False, margin: float = 0.06) -> Scale:
    """A linear scale around all finite data, from 0 on if asked."""
    values = _finite(*data)
    if not values.size:
        return Scale(0.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if zero:
        low, high = min(low, 0.0), max(high, 0.0)
    if high - low <= max(1e-12 * max(abs(low), abs(high)), _LEAST):
        pad = abs(high) * 0.1 if abs(high) > _LEAST else 1.0
        return Scale(low - pad, high + pad)
    pad = margin * (high - low)
    return Scale(low if zero and low == 0 else low - pad, high if zero and high == 0 else high + pad)


def logarithmic(*data: ArrayLike, margin: float = 0.05) -> Scale:
    """A logarithmic scale around all positive data."""
    values = _finite(*data)
    values = values[values > max(_LEAST, _DECADES * values.max(initial=0.0))]
    if not values.size:
        return Scale(0.1, 10.0, log=True)
    low, high = float(values.min()), float(values.max())
    if high < 1.3 * low:
        middle = math.sqrt(low * high)
        low, high = min(low, middle / 1.6), max(high, middle * 1.6)
    factor = (high / low) ** margin
    return Scale(low / factor, high * factor, log=True)


def symmetric(limit: float) -> Scale:
    """A linear scale around zero."""
    return Scale(-limit, limit)


def _finite(*data: ArrayLike) -> Float:
    parts = [np.asarray(d, dtype=float).ravel() for d in data]
    values = np.concatenate(parts) if parts else np.empty(0)
    return values[np.isfinite(values)]


def _linear_ticks(low: float, high: float, most: int) -> list[float]:
    raw = (high - low) / max(1, most)
    decade = 10.0 ** math.floor(math.log10(raw))
    step = next(s * decade for s in (1, 2, 5, 10) if s * decade >= raw * (1 - 1e-9))
    places = _multiples(low, high, step)
    for finer in (5, 2, 1, 0.5):  # one label says where an axis is, not how long it is
        if len(places) > 1 or finer * decade >= step:
            continue
        places = _multiples(low, high, finer * decade)
    return places


def _multiples(low: float, high: float, step: float) -> list[float]:
    first = math.ceil(low / step - 1e-9)
    return [round(i * step, 12) for i in range(first, math.floor(high / step + 1e-9) + 1)]


def _log_ticks(low: float, high: float, most: int) -> tuple[list[float], list[float]]:
    first, last = math.floor(math.log10(low)), math.ceil(math.log10(high))
    inside = [
        (m, m * 10.0**e)
        for e in range(first, last + 1)
        for m in range(1, 10)
        if low * (1 - 1e-9) <= m * 10.0**e <= high * (1 + 1e-9)
    ]
    every = [v for _, v in inside]
    for chosen in ((1, 2, 3, 4, 5, 6, 8), (1, 2, 5), (1, 3), (1,)):
        labelled = [v for m, v in inside if m in chosen]
        if len(labelled) <= most:
            break
    decades = [v for m, v in inside if m == 1]
    while len(labelled) > most:
        labelled = labelled[:: math.ceil(len(labelled) / most)]
    if len(labelled) < 2:
        labelled = _linear_ticks(low, high, max(2, most))
    minor = every if len(decades) <= 4 else decades
    return labelled, [v for v in minor if v not in labelled]


def nice(value: float) -> float:
    """The largest of 1, 2, 5 and their powers of ten that is not above `value`."""
    decade = 10.0 ** math.floor(math.log10(value))
    return max(s * decade for s in (1, 2, 5) if s * decade <= value * (1 + 1e-9))


def number(value: float) -> str:
    """A coordinate to a tenth of a pixel."""
    text = f"{value:.1f}"
    return text[:-2] if text.endswith(".0") else text


def tick_text(value: float) -> str:
    """`0.01`, `5`, `20 000`, `10⁻⁶`."""
    if value == 0:
        return "0"
    size = math.log10(abs(value))
    if size >= 6 or size < -4:
        digits = next(
            d for d in range(3, 17) if d == 16 or abs(float(f"{value:.{d - 1}e}") - value) <= 1e-11 * abs(value)
        )
        text = compact(value, digits)
        return text.removeprefix(f"1{NBSP}×{NBSP}")
    places = max(0, -math.floor(size + 1e-9))
    while places < 10 and abs(round(value, places) - value) > 1e-11 * abs(value):
        places += 1
    return fixed(value, places)


def apart(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Ascending positions at least `gap` from each other, as near to the wanted ones as a simple push gives."""
    placed: list[float] = []
    for want in wanted:
        placed.append(max(want, placed[-1] + gap) if placed else max(want, low))
    overflow = placed[-1] - high if placed else 0.0
    if overflow > 0:
        for i in reversed(range(len(placed))):
            ceiling = placed[i + 1] - gap if i + 1 < len(placed) else high
            placed[i] = min(placed[i], ceiling)
    return placed
