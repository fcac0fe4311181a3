"""Where is the film thin, and did it fail there? The simulated thickness with the electrode and the failures by region."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reports.figures.palette import MODEL, SECOND
from reports.figures.panel import Drawing
from reports.figures.picture import pictured
from reports.figures.scale import tick_text
from schemas.arrays import Bool, Float

REGIONS = ("left", "centre", "right")
_WIDTH = 302.0
_SIDE = 232.0
_THICK, _THIN = (241, 243, 245), (60, 78, 96)


@dataclass(frozen=True)
class Film:
    """Thickness over its median on a regular grid: `relative` and `active` are (rows, columns), rows along y (mm)."""

    x: Float
    y: Float
    relative: Float
    active: Bool


def grid(x: Float, y: Float, relative: Float, active: Bool) -> Film:
    """A film from points (n,) of a regular grid, in any order; places without a point are NaN and not active."""
    across, along = np.unique(np.round(x, 6)), np.unique(np.round(y, 6))
    rows, columns = np.searchsorted(along, np.round(y, 6)), np.searchsorted(across, np.round(x, 6))
    thickness = np.full((along.size, across.size), np.nan)
    under = np.zeros(thickness.shape, dtype=bool)
    thickness[rows, columns] = relative
    under[rows, columns] = active
    return Film(across, along, thickness, under)


@dataclass(frozen=True)
class Thinnest:
    """The thinnest place under an electrode: where in mm, how thick over the median, and whether its mirror images are as thin."""

    x: float
    y: float
    relative: float
    mirrored_x: bool
    mirrored_y: bool

    @property
    def place(self) -> str:
        """`at x = ±12, y = −8 mm`."""
        parts = []
        for name, value, mirrored in (("x", self.x, self.mirrored_x), ("y", self.y, self.mirrored_y)):
            shown = tick_text(round(abs(value) if mirrored else value, 1))
            parts.append(f"{name} = {'±' if mirrored and value else ''}{shown}")
        return f"at {', '.join(parts)} mm"


_ALIKE = 0.005
"""Difference of the relative thickness below which a place and its mirror image are equally thin."""


def find_thinnest(film: Film) -> Thinnest | None:
    """Where the film is thinnest under the electrode; None where none is known there."""
    under = np.where(film.active, film.relative, np.nan)
    if not np.isfinite(under).any():
        return None
    row, column = np.unravel_index(int(np.nanargmin(under)), under.shape)
    x, y, least = float(film.x[column]), float(film.y[row]), float(under[row, column])

    def is_alike(x: float, y: float) -> bool:
        rows, columns = np.isclose(film.y, y, atol=1e-3), np.isclose(film.x, x, atol=1e-3)
        return bool((np.abs(under[np.ix_(rows, columns)] - least) < _ALIKE).any())

    return Thinnest(x, y, least, is_alike(-x, y), is_alike(x, -y))


def palette() -> NDArray[np.uint8]:
    """256 greys from thick (light) to thin (dark)."""
    share = np.linspace(0, 1, 256)[:, None]
    return np.asarray(np.round((1 - share) * np.array(_THICK) + share * np.array(_THIN)), dtype=np.uint8)


@pictured("thickness-map")
def thickness_map(
    film: Film, span: tuple[float, float], failures: Mapping[str, int], title: str, *, alt: str
) -> Drawing:
    """The film in plan: shade is thickness from `span` (thin, thick), dashes the electrode, numbers the failures found."""
    width, height = float(np.ptp(film.x)), float(np.ptp(film.y))
    scale = _SIDE / max(width, height)
    shown_width, shown_height = max(40.0, width * scale), max(40.0, height * scale)
    left, top = 40.0, 30.0
    drawing = Drawing(_WIDTH, top + shown_height + 46)
    thin, thick = span
    share = np.clip((thick - film.relative) / max(thick - thin, 1e-9), 0, 1)
    cells = np.nan_to_num(np.round(255 * share)).astype(np.uint8)[::-1]
    drawing.picture(left, top, shown_width, shown_height, cells, palette())
    cell = (shown_width / film.x.size, shown_height / film.y.size)
    edges = [
        (left + cell[0] * a, top + cell[1] * b, left + cell[0] * c, top + cell[1] * d)
        for a, b, c, d in _outline(film.active[::-1])
    ]
    drawing.segments(edges, MODEL, 1.6)
    drawing.write(0, 14, title)
    for value, place in (
        (film.y.max(), top + 9),
        (0.0, top + shown_height / 2 + 4),
        (film.y.min(), top + shown_height),
    ):
        drawing.write(left - 6, place, tick_text(round(float(value), 1)), size=10.7, colour=SECOND, anchor="end")
    for i, region in enumerate(REGIONS):
        x = left + shown_width * (i + 0.5) / 3
        drawing.write(x, top + shown_height + 17, f"{region} {failures.get(region, 0)}", size=11.3, anchor="middle")
    drawing.write(
        left + shown_width / 2,
        top + shown_height + 36,
        "failures by third along the rods",
        size=10.7,
        colour=SECOND,
        anchor="middle",
    )
    return drawing.told(alt)


def _outline(mask: Bool) -> list[tuple[float, float, float, float]]:
    """Borders between active and other cells as merged straight lines (x1, y1, x2, y2) in cells."""
    padded = np.pad(mask, 1)
    lines: list[tuple[float, float, float, float]] = []
    for row, change in enumerate(np.diff(padded.astype(np.int8), axis=0)[:, 1:-1] != 0):
        lines += [(a, row, b, row) for a, b in _runs(change)]
    for column, change in enumerate(np.diff(padded.astype(np.int8), axis=1)[1:-1].T != 0):
        lines += [(column, a, column, b) for a, b in _runs(change)]
    return lines


def _runs(change: Bool) -> list[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], change.astype(np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
