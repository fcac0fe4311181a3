"""Noise of an output that its converter hides, or that stands exactly still: how much of it is there nevertheless.

Does not belong here: the noise of what moves and scatters (`system_parts`, `cycle_diagnosis`).
"""

from __future__ import annotations

import numpy as np

from pipeline.diagnose.features.records import split_runs
from schemas.arrays import Bool, Float

_STILL = 8
"""Equal samples on end from which an output stands still: what a machine resets or holds shows no noise."""
_MOST = 0.8
"""Share of still samples up to which the others tell the noise."""
_PARTS = 16
"""Parts of a record that are judged by themselves: the places, and as many again for their ends."""
_SEED = 3
"""Of the dither."""
_RESOLVED = 1e-12
"""Share of an output below which nothing is resolved in double precision."""


def find_moving(values: Float) -> Bool:
    """(n,) where an output does not stand exactly still; everywhere where it nearly always does.

    Parameters
    ----------
    values : (n,)
    """
    lengths = np.diff(split_runs(values))
    moves = np.repeat(lengths < _STILL, lengths)
    return moves if moves.mean() >= 1 - _MOST else np.ones(values.size, dtype=bool)


def dither(values: Float, step: float) -> Float:
    """(n,) an output in whole steps of a converter with its steps blurred: with `step`²/12 more variance, and no steps.

    Medians of what comes in whole steps are whole steps themselves, up to twice as large as they should be, or 0.

    Parameters
    ----------
    values : (n,)
    step : of the converter
    """
    return values + step * (np.random.default_rng(_SEED).random(values.size) - 0.5)


def bound_variance(values: Float, step: float, variance: float) -> float:
    """Variance of the noise of one value, with what rounding must add where the scatter is no larger than that.

    Over a part of a record that moves by whole steps of the converter rounding is off by a twelfth of a step squared, as noise would be; where
    it moves by less, all of the part may be off alike, by up to half a step.

    Parameters
    ----------
    values : (n,)
    step : of the converter; 0 where there is none
    variance : of the scatter of values about a smooth course
    """
    resolved = (_RESOLVED * float(np.abs(values).max(initial=0.0))) ** 2
    way = float(np.abs(np.diff(values)).sum())
    is_slow = way < _PARTS * step
    rounding = step**2 / (4 if is_slow else 12)
    return max(variance, resolved, rounding if variance < step**2 / 12 else 0.0)
