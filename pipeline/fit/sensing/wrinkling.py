"""Wrinkling of an actuator from its steps of capacitance: which steps, and from which voltage on (thesis, section 5.4.6)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pipeline.fit.weighted import Estimate, regression, weighted_mean
from pipeline.transform.step import StepResponse

_SAME_VOLTAGE = 0.04
"""Steps whose voltages differ by less than this share are of one level."""
_LONGER, _AT_LEAST_S = 1.3, 0.02
"""How much longer a recovery must be than before."""
_STALLED = 0.5
"""A level has stalled when its step grows by less than this share of what V² would add."""
_SOFT = 0.01
"""How far, at least, the size that is not exceeded may lie from that of a sharp onset, as a share."""
_EXPONENT_SD = 0.1
"""The step below the onset grows with V to the power 2 ± this: permittivity and stiffness depend a little on the field."""


def wrinkling(steps: Sequence[StepResponse]) -> tuple[tuple[StepResponse, ...], Estimate | None]:
    """Marks wrinkled steps and estimates the onset voltage, from one level of voltage to the next.

    Wrinkling shows when the capacitance step no longer grows as V² has it (by less than half of that, beyond noise) and
    the recovery is longer than below (features A1 and A2). The onset is where the power law through the levels below,
    its exponent 2 ± 0.1, reaches the size that is not exceeded. A step is wrinkled from the lower 95 % limit of the onset
    on: what may be wrinkled is kept out of fits. Fewer than three levels cannot tell: steps keep None.
    """
    usable = [s for s in steps if s.capacitance_step_pf and s.capacitance_step_sd_pf is not None]
    levels: list[list[StepResponse]] = []
    for step in sorted(usable, key=lambda s: s.voltage_kv):
        if levels and step.voltage_kv - levels[-1][-1].voltage_kv < _SAME_VOLTAGE * step.voltage_kv:
            levels[-1].append(step)
        else:
            levels.append([step])
    if len(levels) < 3:
        return tuple(steps), None
    volts = [float(np.mean([s.voltage_kv for s in group])) for group in levels]
    size = [_size(group) for group in levels]
    onset = None
    for i in range(2, len(levels)):
        ratio = (volts[i] / volts[i - 1]) ** 2
        growth, expected = size[i].value - size[i - 1].value, size[i - 1].value * (ratio - 1)
        sd = math.hypot(size[i].sd, size[i - 1].sd * ratio)
        stalled = growth + 2.6 * sd < _STALLED * expected and expected > 4 * sd
        below = [s.recovery_time_s for group in levels[: i - 1] for s in group]
        if stalled and _longer([s.recovery_time_s for s in levels[i]], below):
            onset = _onset(volts, size, i)
            break
    limit = math.inf if onset is None else onset.lower
    marked = tuple(
        replace(s, wrinkled=s.voltage_kv >= limit) if s.capacitance_step_pf is not None else s for s in steps
    )
    return marked, onset


def _size(group: Sequence[StepResponse]) -> Estimate:
    """Mean step of one level in pF."""
    size = np.array([abs(s.capacitance_step_pf or 0.0) for s in group])
    sd = np.array([s.capacitance_step_sd_pf or 0.0 for s in group])
    return weighted_mean(size, np.maximum(sd, 1e-12))


def _longer(now: Sequence[float | None], before: Sequence[float | None]) -> bool:
    """Recovery at this level is longer than at those well below; not recovering at all counts as longer."""
    known = [t for t in before if t is not None]
    if not known:
        return False
    if any(t is None for t in now):
        return True
    return float(np.median([t for t in now if t is not None])) > _LONGER * float(np.median(known)) + _AT_LEAST_S


def _onset(volts: Sequence[float], size: Sequence[Estimate], stalled: int) -> Estimate:
    """Voltage at which ΔC = κ V^p, from the levels two and more below, reaches the size that is not exceeded.

    That size is the mean of the levels above the first that stalled, where there are any: near a soft onset the first
    stays below it.
    """
    below = range(stalled - 1)
    x = np.log([volts[i] for i in below])
    y = np.log([size[i].value for i in below])
    sd = np.array([size[i].sd / size[i].value for i in below])
    # The exponent's prior is one more row: p = 2 ± its standard deviation.
    design = np.vstack([np.column_stack([np.ones_like(x), x]), [0.0, 1.0]])
    rows, noise = np.append(y, 2.0), np.append(sd, _EXPONENT_SD)
    solution, covariance, freedom = regression(design, rows, noise, np.append(np.ones_like(x), 0.0))
    above = size[stalled + 1 :] or size[stalled:]
    reached = weighted_mean(np.array([s.value for s in above]), np.array([max(s.sd, 1e-12) for s in above]))
    soft = max(_SOFT, abs(math.log(size[stalled].value / reached.value)) / 2)
    log_onset = (math.log(reached.value) - solution[0]) / solution[1]
    slopes = np.array([-1.0, -log_onset]) / solution[1]
    own = math.hypot(reached.sd / reached.value, soft) / solution[1]
    onset = math.exp(log_onset)
    sd_log = math.hypot(math.sqrt(float(slopes @ covariance @ slopes)), own)
    return Estimate(min(onset, volts[stalled]), onset * sd_log, freedom)
