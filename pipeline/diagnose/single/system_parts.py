"""Two parts of a system's records, one to be predicted from the other, and the noise of its output.

Does not belong here: what is fitted to them (`system_mechanisms`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter

from pipeline.diagnose.features.records import find_converter_step
from pipeline.diagnose.rules import RULES
from pipeline.diagnose.single.oscillator import Oscillator, SystemRecord
from pipeline.diagnose.single.oscillator_fit import join_compared
from pipeline.diagnose.single.still_outputs import bound_variance, find_moving
from schemas.arrays import Bool, Float

_WINDOWS = 32
"""Stretches of a record that are dealt into two parts."""
_TINY = 1e-30
"""Instead of nothing."""


def split_in_two(oscillator: Oscillator, outputs: Sequence[Float]) -> tuple[tuple[str, str], Bool]:
    """Two parts of a system's records of which each can be predicted from the other.

    Of several records the one of the largest output and the others. Of one record the half that is driven more and the
    other; else its two halves; else every other stretch: the first of these in which both parts are driven at the same
    frequencies.

    Parameters
    ----------
    oscillator : with the records
    outputs : (n,) per record

    Returns
    -------
    Names of the two parts, and (M,) which compared values belong to the first
    """
    records = oscillator.records
    if len(records) > 1:
        levels = [float(np.abs(y[oscillator.compared(r)]).max()) for r, y in zip(records, outputs, strict=True)]
        loudest = int(np.argmax(levels))
        others = " and ".join(r.name for i, r in enumerate(records) if i != loudest)
        mask = join_compared(oscillator, [np.full(y.size, float(i == loudest)) for i, y in enumerate(outputs)])
        return (f"{records[loudest].name}, the loudest", others), mask > 0
    u = records[0].input[oscillator.compared(records[0])]
    windows = np.array_split(np.arange(u.size), _WINDOWS)
    levels = [float(np.std(u[window])) for window in windows]
    power = np.array([np.abs(np.fft.rfft(u[window[: u.size // _WINDOWS]])) ** 2 for window in windows])
    order, half, number = np.argsort(levels), _WINDOWS // 2, np.arange(_WINDOWS)
    louder = np.median(np.take(levels, order[half:])) > RULES.single.louder * np.median(np.take(levels, order[:half]))
    ways = [
        ("the half that is driven more", "the half that is driven less", np.isin(number, order[half:])),
        ("the second half", "the first half", number >= half),
        ("every other stretch", "the stretches between", number % 2 == 1),
    ]
    found = next((way for way in ways[0 if louder else 1 : -1] if _are_driven_alike(power, way[2])), ways[-1])
    return (found[0], found[1]), np.repeat(found[2], [w.size for w in windows])


def _are_driven_alike(power: Float, chosen: Bool) -> bool:
    """Whether two parts are driven at the same frequencies; power : (windows, frequencies) of the input."""
    inside, outside = (power[c].sum(axis=0) / max(power[c].sum(), _TINY) for c in (chosen, ~chosen))
    return bool(np.minimum(inside, outside).sum() > RULES.single.driven_alike)


def estimate_noise_sd(records: Sequence[SystemRecord]) -> tuple[float, str]:
    """Standard deviation of the noise of one output value, and in words how it is told.

    From frequencies that are not excited, as if it were white: the upper end of its 95 % interval, so that noise alone
    is no misfit; the largest of the records'. What stands exactly still shows none, and a converter's rounding hides some.
    """
    levels, free = [], True
    for record in records:
        n = record.input.size
        window = np.hanning(n)
        u, y = (np.abs(np.fft.rfft((x - x.mean()) * window)) ** 2 for x in (record.input, record.output))
        smooth = median_filter(u, max(n // 200, 1))
        excited = int(np.flatnonzero(smooth > RULES.single.excited * smooth.max())[-1] * RULES.single.above_excited)
        free &= excited < 0.95 * u.size
        above = y[min(excited, int(0.95 * u.size)) :]
        # The median of an exponential distribution is ln 2 of its mean, its relative error 1/(ln 2 √n), under this
        # window √1.5 of it.
        surely = 1 + 2 * np.sqrt(1.5 / above.size) / np.log(2)
        moving = np.where(find_moving(record.output), window, 0.0)
        level = float(np.median(above) / np.log(2) / np.sum(moving**2) * surely)
        levels.append(bound_variance(record.output, find_converter_step(record.output), level))
    told = (
        "if white as the output beyond the excited frequencies" if free else "at most that of the highest frequencies"
    )
    return max(float(np.sqrt(max(levels))), _TINY), told
