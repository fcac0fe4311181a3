"""Whether the steps of a staircase add what they would in a linear film, and what they add where they do not.

The question is put to all positive relaxations at once, many arms side by side: where none of them follows all steps, the
steps are no multiples of one another. Each further step then gets a factor of its own, and the model is that of the first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls

from pipeline.physics.held_step import Hold, hold_kernel
from schemas.arrays import Float

UNEQUAL = 0.5
"""Standard deviation of the factor of a further step, where they are not equal: soft solids lose half in a few steps."""
_BEYOND = 5.0
"""Standard deviations of its χ² by which a linear film must miss a staircase."""
_PER_DECADE = 4
_SMALLEST = 0.02
"""Least factor of a step."""


@dataclass(frozen=True)
class StepFactors:
    """What each further step adds over what it would in a linear film (r,), with standard deviations (r,)."""

    factors: Float
    sds: Float

    @property
    def statement(self) -> str:
        """In words, for a warning."""
        each = ", ".join(f"{f:.3g} ± {max(s, 0.001):.1g}" for f, s in zip(self.factors, self.sds, strict=True))
        last = self.factors.size + 1
        which = "step 2 adds" if last == 2 else f"steps 2 to {last} add"
        return (
            f"the further steps do not add in proportion to their height: {which} {each} of what a linear film would; each has a"
            " factor of its own, and the model is that of the first step"
        )


def find_step_factors(hold: Hold, value: Float, variance: Float, offset: float) -> StepFactors | None:
    """Factors of the further steps of a curve, None where a linear film follows all of them.

    Parameters
    ----------
    hold : p windows
    value, variance : (p,) N/mm and its square
    offset : standard deviation of an error that all values share, N/mm
    """
    count = len(hold.further)
    if not count:
        return None
    weight = 1 / np.sqrt(variance)
    first, last = float(hold.since_last.min()), float((hold.start + hold.width).max())
    decades = np.log10(10 * last / max(first / 3, 1e-9 * last))
    tau = max(first / 3, 1e-9 * last) * 10 ** np.linspace(0, decades, int(decades * _PER_DECADE) + 2)

    def left(factors: Float) -> Float:
        scaled = hold.scaled(factors)
        columns = np.column_stack([scaled.level, hold_kernel(scaled, tau)[0]]) * weight[:, None]
        shift = offset * weight[:, None]
        # An error that all share goes either way, which coefficients that are not negative do as a pair; its size is weighted.
        rows = np.block([[columns, shift, -shift], [np.zeros((1, columns.shape[1])), np.array([[1.0, -1.0]])]])
        scale = np.maximum(np.sqrt((rows**2).sum(axis=0)), 1e-300)
        target = np.append(value * weight, 0.0)
        found, _ = nnls(rows / scale, target, maxiter=50 * rows.shape[1])
        return np.asarray((rows / scale) @ found - target)

    linear = float(np.sum(left(np.ones(count)) ** 2))
    if linear <= value.size + _BEYOND * np.sqrt(2 * value.size):
        return None
    best = least_squares(left, np.ones(count), bounds=(_SMALLEST, np.inf), x_scale=0.1, diff_step=1e-4)
    excess = max(1.0, 2 * best.cost / max(value.size - count, 1))
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * excess
    return StepFactors(best.x, np.sqrt(np.diag(covariance)))
