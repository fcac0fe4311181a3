"""A fit as the database keeps it, to be used again with its covariance."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pipeline.fit.relaxation.results import find_slopes
from pipeline.physics.film import RelaxationModel, Shape
from schemas.arrays import Complex, Float
from schemas.tables import ARMS


@dataclass(frozen=True)
class StoredFit:
    """What `RelaxationFit` says about the film: the model, and the covariance (p, p) of its parameters called `names`."""

    model: RelaxationModel
    shape: Shape
    names: tuple[str, ...]
    covariance: Float

    def slopes(self, frequency_hz: ArrayLike) -> Complex:
        """∂k/∂θ (m, p) at (m,) Hz, columns in the order of `names`; 0 for those of the rig."""
        theta = self.shape.theta(self.model)
        return find_slopes(theta, self.shape, self.names, self.model.c_inf, frequency_hz)


def read_fit(row: Mapping[str, Any]) -> StoredFit | None:
    """The fit of a row of `model_fits`; None where the row keeps no covariance of springs and relaxation times.

    Parameters
    ----------
    row : by column
    """
    stored = json.loads(row["covariance"] or "null")
    if not isinstance(stored, dict) or "matrix" not in stored:
        return None
    names, matrix = tuple(stored["names"]), np.asarray(stored["matrix"], dtype=float)
    arms = [(row[f"k{i}_n_per_mm"], row[f"c{i}_n_s_per_mm"]) for i in range(1, ARMS + 1)]
    springs = [(k, c / k) for k, c in arms if k is not None and c is not None]
    dashpot = sum(c for k, c in arms if k is None and c is not None)
    shape = Shape(len(springs), spring="log k0" in names, dashpot=dashpot > 0)
    if matrix.shape != (len(names), len(names)) or names[: shape.size] != shape.names:
        return None
    k0 = float(row["k0_n_per_mm"] or 0.0)
    model = RelaxationModel(k0, tuple(k for k, _ in springs), tuple(tau for _, tau in springs), dashpot)
    return StoredFit(model, shape, names, matrix)


def read_following(row: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]) -> RelaxationModel | None:
    """The model of the next order of the same kind of fit among rows of `model_fits`; None where there is none."""
    kind = ("specimen_id", "loading", "method", "weighting", "extension")
    for other in rows:
        if other["model_order"] == row["model_order"] + 1 and all(other[k] == row[k] for k in kind):
            found = read_fit(other)
            return None if found is None else found.model
    return None
