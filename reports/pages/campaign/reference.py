"""Published numbers that a campaign is compared with, and where they are printed.

Source: the doctoral thesis on rod-pre-strained dielectric elastomer actuators that the protocols follow, chapter 4,
tables 4.2 (stacked polyacrylate film, 0.01–5 Hz), 4.3 (single layers, 1–100 Hz) and 4.4 (errors of the latter).
Springs in N/mm, dampers in N s/mm, errors in N/mm and degrees (eq 4.14, whose frequency grid the thesis does not state).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class ReferenceModel:
    """One fitted model of the literature, in the columns of `model_fits`."""

    order: int
    k: tuple[float, ...]
    c: tuple[float, ...]
    magnitude_error: float
    phase_error: float

    def row(self) -> dict[str, Any]:
        """The model as a row of `model_fits`, for `reports.figures.curves`."""
        row: dict[str, Any] = {"k0_n_per_mm": self.k[0]}
        for i in range(1, 9):
            row[f"k{i}_n_per_mm"] = self.k[i] if i < len(self.k) else None
            row[f"c{i}_n_s_per_mm"] = self.c[i - 1] if i <= len(self.c) else None
        return row


@dataclass(frozen=True)
class ReferenceFilm:
    """A film of the literature: what it was, where the numbers stand, in which band they hold."""

    name: str
    source: str
    low_hz: float
    high_hz: float
    models: tuple[ReferenceModel, ...]


STACK = ReferenceFilm(
    "stacked polyacrylate, ten layers at stretch 2",
    "thesis, table 4.2",
    0.01,
    5.0,
    (
        ReferenceModel(1, (0.40, 2.20), (1.00,), 0.64, 18.58),
        ReferenceModel(2, (0.40, 0.40, 1.80), (1.00, 0.28), 0.26, 10.05),
        ReferenceModel(3, (0.40, 0.40, 1.00, 50.0), (1.00, 0.10, 0.05), 0.06, 3.96),
    ),
)
POLYACRYLATE = ReferenceFilm(
    "polyacrylate, single layer at stretch 1.4",
    "thesis, tables 4.3 and 4.4",
    1.0,
    100.0,
    (
        ReferenceModel(1, (1.00, 4.00), (0.10,), 1.73, 37.52),
        ReferenceModel(2, (1.00, 4.00, 4.00), (0.10, 0.02), 1.29, 28.58),
        ReferenceModel(3, (1.00, 1.50, 2.00, 30.0), (0.05, 0.02, 0.02), 1.05, 2.64),
    ),
)
SILICONE = ReferenceFilm(
    "silicone, single layer at stretch 1.2",
    "thesis, tables 4.3 and 4.4",
    1.0,
    100.0,
    (ReferenceModel(1, (0.29, 0.30), (1.4e-4,), 1.11, 8.66),),
)


_SINGLE_LAYER, _SAME_STRETCH = 1.4, 0.05
"""Pre-stretch of the published single layer, and how far another's may be from it."""


def reference(material: str | None, metadata: Mapping[str, Any]) -> ReferenceFilm | None:
    """The film of the literature that a specimen resembles by material, layers and pre-stretch; None for any other."""
    name = (material or "").casefold()
    if any(word in name for word in ("silicone", "platsil", "pdms")):
        return SILICONE
    if not any(word in name for word in ("polyacrylate", "acrylic", "vhb")):
        return None
    try:
        layers = int(float(metadata.get("layers", 1)))
    except (TypeError, ValueError):
        layers = 1
    if layers > 1:
        return STACK
    try:
        stretch = float(metadata.get("stretch_1", _SINGLE_LAYER))
    except (TypeError, ValueError):
        stretch = _SINGLE_LAYER
    return POLYACRYLATE if abs(stretch / _SINGLE_LAYER - 1) < _SAME_STRETCH else None
