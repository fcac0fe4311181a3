"""Weights of nodes in features as dense blocks: rows that see about the same nodes stand together, over these nodes alone.

A band of a sweep sees a few of the thousand nodes that its harmonics see; most of one matrix for all would be zeros to be read.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.features.functionals import Operator
from schemas.arrays import Complex, Float, Int

_CALL = 4000
"""Weights that are read in the time that one product more takes."""


@dataclass(frozen=True)
class _Block:
    """Rows (n,), the parts first … stop − 1 that they see, and their weights (n, stop − first)."""

    rows: Int
    parts: slice
    weights: Float


class NodeWeights:
    """Weights (N, J) of the real and imaginary parts at J nodes, of operators one below the other."""

    def __init__(self, operators: list[Operator]) -> None:
        # Real and imaginary parts alternate, as they do in complex numbers.
        re, im = (np.concatenate([getattr(o, part).toarray() for o in operators]) for part in ("re", "im"))
        weights = np.stack([re, im], axis=2).reshape(len(re), -1)
        self.rows = len(weights)
        self._blocks = [_Block(rows, parts, weights[rows, parts].copy()) for rows, parts in _groups(weights)]

    @property
    def read(self) -> int:
        """How many weights one product reads."""
        return sum(b.weights.size for b in self._blocks)

    def apply(self, response: Complex) -> Float:
        """(N,) features of one response (J,) at the nodes; of several (B, J) at once (B, N)."""
        seen = np.ascontiguousarray(response).view(np.float64)
        values = np.empty((*response.shape[:-1], self.rows))
        for b in self._blocks:
            # One response by the matrix, several by a product of matrices: a matrix by one row of many is read anew each time.
            values[..., b.rows] = b.weights @ seen[b.parts] if seen.ndim == 1 else seen[:, b.parts] @ b.weights.T
        return values


def _groups(weights: Float) -> Iterator[tuple[Int, slice]]:
    """Rows that are cheaper to multiply at once than one after the other, and what they see."""
    seen = weights != 0
    first, stop = seen.argmax(axis=1), weights.shape[1] - seen[:, ::-1].argmax(axis=1)
    stop[~seen.any(axis=1)] = first[~seen.any(axis=1)] = 0
    wide = np.log2(np.maximum(stop - first, 1)).astype(int)
    own: list[int] = []
    low, high = weights.shape[1], 0
    for row in np.lexsort((first, wide)).tolist():
        a, b = int(first[row]), int(stop[row])
        together = min(low, a), max(high, b)
        if own and (len(own) + 1) * (together[1] - together[0]) > len(own) * (high - low) + (b - a) + _CALL:
            yield np.array(own), slice(low, high)
            own, together = [], (a, b)
        own.append(row)
        low, high = together
    if own:
        yield np.array(own), slice(low, high)
