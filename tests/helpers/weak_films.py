"""Lives of films drawn flaw by flaw: each small cell of a specimen draws a life of its own, and the first one ends it.

Written without the code that fits such lives, and computed another way: no integral over the film, no power of the area.
Thickness is a formula over the film's plane, taken at random places that differ from specimen to specimen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from schemas.arrays import Bool, Float


@dataclass(frozen=True)
class Film:
    """Law of the film: median life in s of a cell of 1 mm² at 40 MV/m, exponent of life over field, Weibull shape."""

    cell_median_s: float = 3e5
    life_exponent: float = -6.0
    shape: float = 1.6


@dataclass(frozen=True)
class Sheet:
    """A layout: sizes of the electrode, thickness in the middle, how much thinner the film is at lines, and scatter.

    Parameters
    ----------
    length_mm, width_mm : of the electrode, undeformed
    thickness_mm : away from the lines
    lines_mm : y of lines along which the film is thin
    dip : share of the thickness that is missing on a line
    reach_mm : standard deviation of the dip across
    scatter : relative standard deviation of the whole thickness from specimen to specimen
    """

    name: str
    length_mm: float
    width_mm: float
    thickness_mm: float
    lines_mm: tuple[float, ...] = ()
    dip: float = 0.0
    reach_mm: float = 1.0
    scatter: float = 0.02

    def thickness_at(self, y: Float) -> Float:
        """Thickness in mm at y (…,) mm across the lines."""
        missing = np.zeros_like(y)
        for line in self.lines_mm:
            missing = np.maximum(missing, self.dip * np.exp(-(((y - line) / self.reach_mm) ** 2) / 2))
        return np.asarray(self.thickness_mm * (1 - missing))


SHEETS = (
    Sheet("small", 10.0, 10.0, 0.20, (0.0,), 0.15),
    Sheet("large", 20.0, 20.0, 0.20, (-5.0, 0.0, 5.0), 0.20),
    Sheet("strip", 40.0, 6.0, 0.18),
)


def draw_lives(
    film: Film, sheet: Sheet, voltage_kv: float, specimens: int, end_s: float, rng: np.random.Generator
) -> tuple[Float, Bool]:
    """Times in s and failure flags of specimens, each tested until the end."""
    cells = round(sheet.length_mm * sheet.width_mm)
    y = rng.uniform(-sheet.width_mm / 2, sheet.width_mm / 2, (specimens, cells))
    whole = np.exp(rng.normal(0.0, np.log1p(sheet.scatter), (specimens, 1)))
    field = voltage_kv / (sheet.thickness_at(y) * whole)
    median = film.cell_median_s * (field / 40.0) ** film.life_exponent
    cell_life = median * (rng.weibull(film.shape, (specimens, cells)) / np.log(2) ** (1 / film.shape))
    life = cell_life.min(axis=1)
    return np.minimum(life, end_s), life <= end_s


def true_median_s(film: Film, sheet: Sheet, voltage_kv: float, rng: np.random.Generator) -> float:
    """Median of very many specimens, in s."""
    lives = [draw_lives(film, sheet, voltage_kv, 200, np.inf, rng)[0] for _ in range(100)]
    return float(np.median(np.concatenate(lives)))
