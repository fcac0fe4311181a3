"""Weights of nodes in features as dense blocks: rows that see about the same nodes stand together, over these nodes alone.

A band of a sweep sees a few of the thousand nodes that its harmonics see; most of one matrix for all would be zeros to be read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.diagnose.features.functionals import Operator
from schemas.arrays import Bool, Complex, Float, Int

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
        self.rows, self._parts = weights.shape
        self._blocks = [_Block(rows, parts, weights[rows, parts].copy()) for rows, parts in _groups(weights)]

    @property
    def read(self) -> int:
        """How many weights one product reads."""
        return sum(b.weights.size for b in self._blocks)

    @property
    def products(self) -> int:
        """How many products there are."""
        return len(self._blocks)

    def dense(self) -> Float:
        """(N, parts) weights of all parts; those of the real and the imaginary part of a node stand side by side."""
        whole = np.zeros((self.rows, self._parts))
        for b in self._blocks:
            whole[b.rows, b.parts] = b.weights
        return whole

    def apply(self, response: Complex) -> Float:
        """(N,) features of one response (J,) at the nodes; of several (B, J) at once (B, N)."""
        seen = np.ascontiguousarray(response).view(np.float64)
        values = np.empty((*response.shape[:-1], self.rows))
        for b in self._blocks:
            # One response by the matrix, several by a product of matrices: a matrix by one row of many is read anew each time.
            values[..., b.rows] = b.weights @ seen[b.parts] if seen.ndim == 1 else seen[:, b.parts] @ b.weights.T
        return values


class WeightsByState:
    """Weights of the nodes in the rows of each state, whose response is its own.

    Where states are many and see little each, one stack of matrices of equal size is read quicker than a product for each.
    """

    def __init__(self, states: Sequence[tuple[Int, list[Operator]]]) -> None:
        """Of each state its rows in the features, and the operators that make them, one below the other."""
        self._of_state = [(rows, NodeWeights(operators)) for rows, operators in states]
        self._size = sum(rows.size for rows, _ in states)
        self._stack = self._make_stack()

    def apply(self, response: Complex) -> Float:
        """(N,) features of the responses (S, J) of the states at the nodes; of several (B, S, J) at once (B, N)."""
        if self._stack is None:
            values = np.empty((*response.shape[:-2], self._size))
            for state, (rows, weights) in enumerate(self._of_state):
                values[..., rows] = weights.apply(response[..., state, :])
            return values
        values = np.zeros((*response.shape[:-2], self._size))
        seen = np.ascontiguousarray(response).view(np.float64)
        found = self._stack.weights @ (seen[..., None] if seen.ndim == 2 else np.moveaxis(seen, 0, -1))
        values[..., self._stack.rows] = found[self._stack.used].T if seen.ndim > 2 else found[self._stack.used][:, 0]
        return values

    def _make_stack(self) -> _Stack | None:
        dense = [weights.dense() for _, weights in self._of_state]
        used = [each.any(axis=1) for each in dense]
        most = max(int(some.sum()) for some in used)
        width = dense[0].shape[1]
        apart = sum(weights.read + _CALL * weights.products for _, weights in self._of_state)
        if len(dense) * most * width >= apart:
            return None
        stacked, there = np.zeros((len(dense), most, width)), np.zeros((len(dense), most), dtype=bool)
        for state, (each, some) in enumerate(zip(dense, used, strict=True)):
            number = int(some.sum())
            stacked[state, :number], there[state, :number] = each[some], True
        rows = np.concatenate([rows[some] for (rows, _), some in zip(self._of_state, used, strict=True)])
        return _Stack(stacked, there, rows)


@dataclass(frozen=True)
class _Stack:
    """Weights (S, n, parts) of the states; which of these rows are used (S, n), and the features that they are."""

    weights: Float
    used: Bool
    rows: Int


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
