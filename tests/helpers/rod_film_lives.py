"""Lives of films over rods drawn cell by cell, for electrodes of any shape on the same specimens: written without the fit.

Each cell of a thickness map draws its own thickness and its own life; the first cell under an electrode ends the specimen.
"""

from __future__ import annotations

import numpy as np

from pipeline.physics.thickness.film import ThicknessMap
from schemas.arrays import Float


def draw_paired_lives(
    film_map: ThicknessMap,
    covers: list[Float],
    voltages: list[float],
    *,
    exponent: float,
    shape: float,
    specimens: int,
    rng: np.random.Generator,
    local_scatter: float = 0.0,
    whole_scatter: float = 0.0,
) -> Float:
    """(len(covers), specimens) lives in units of that of 1 mm² at 1 kV over the undeformed thickness.

    Parameters
    ----------
    film_map : thickness of n cells
    covers : shares (n,) of each cell under the electrodes of a layout
    voltages : of each layout
    exponent, shape : of life over field (positive), and of Weibull's law
    specimens : each is tested with all layouts
    rng : where flaws and thickness come from
    local_scatter, whole_scatter : relative standard deviations of the thickness from cell to cell, and from film to film
    """
    n = len(film_map.thickness)
    lives = np.empty((len(covers), specimens))
    for i in range(specimens):
        thickness = film_map.thickness * (1 + local_scatter * rng.normal(size=n)) * (1 + whole_scatter * rng.normal())
        flaw = rng.exponential(size=n) / film_map.undeformed_area_mm2
        for j, (cover, voltage) in enumerate(zip(covers, voltages, strict=True)):
            # A part of a cell holds that share of its flaws.
            with np.errstate(divide="ignore"):
                cell = (flaw / cover) ** (1 / shape) * (thickness / voltage) ** exponent
            lives[j, i] = cell.min()
    return lives
