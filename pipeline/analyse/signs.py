"""Stiffness and actuation that come out negative: a film pulls back when it is pulled, and slackens under voltage.

A negative one is no property of a film but of its record: a channel that counts the other way, two that are swapped, a
cable turned. It is a finding, whatever else is fitted. Does not belong here: what turns it round.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.analyse.cycle import stretch_and_stress
from pipeline.physics.rig import TONNES_PER_KG
from pipeline.transform.force_map import ForceMapReadings
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import FORCE_PER_VOLTAGE_SQUARED, STIFFNESS, FrequencyResponse
from pipeline.transform.slow_voltage import measure_slow_voltage
from pipeline.transform.step import StepAnalysis
from schemas.arrays import Float
from schemas.errors import NotIdentifiableError
from schemas.metadata import RigConstants
from schemas.numbers import compact, significant
from schemas.places import SIGN
from schemas.protocols import ELECTRICAL, MECHANICAL
from schemas.recording import Recording
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_CLEAR = 5.0
"""Standard deviations below 0 from which a value is negative: by chance in one of 3 million recordings."""
_BELOW_RESONANCE = 0.7
"""Share of the clamp's own frequency up to which its inertia cannot turn the sign of a stiffness."""
_NORMAL_95 = 1.96
_CORRELATED = -0.5
"""Correlation of stress and stretch of a cycle from which on the stress falls with the stretch."""
_TURNED = "force or displacement counts the other way, or the two are swapped"
_RAISED = "the force counts the other way: actuation lowers the tension"


@dataclass(frozen=True)
class Negative:
    """One negative value: the statement, what is found and why before the colon, and how many standard deviations below 0."""

    statement: str
    deviations: float


def find_negative(recording: Recording | None, results: Sequence[Any]) -> tuple[Negative, ...]:
    """Stiffnesses and actuations of one recording or table that are clearly negative.

    Parameters
    ----------
    recording : None for a table
    results : what was computed from it
    """
    found = [one for result in results for one in _of_result(result, None if recording is None else recording.rig)]
    if recording is not None and recording.metadata.protocol == "cycle" and recording.metadata.loading == MECHANICAL:
        found += _of_cycle(recording)
    if recording is not None and recording.metadata.protocol == "cycle" and recording.metadata.loading == ELECTRICAL:
        found += _of_slow_voltage(recording)
    return tuple(found)


def sign_table(recording_id: str, specimen_id: str | None, found: Sequence[Negative]) -> pa.Table:
    """Rows of `discrepancies`."""
    return TABLES["discrepancies"].rows(
        {
            "specimen_id": specimen_id,
            "recording_id": recording_id,
            "where_found": SIGN,
            "chi2": one.deviations**2,
            "degrees_of_freedom": 1.0,
            "p_value": math.erfc(one.deviations / math.sqrt(2)),
            "statement": one.statement,
        }
        for one in found
    )


def _of_result(result: Any, rig: RigConstants | None) -> Iterator[Negative]:
    if isinstance(result, FrequencyResponse) and result.quantity in (STIFFNESS, FORCE_PER_VOLTAGE_SQUARED):
        yield from _of_response(result, rig)
    elif isinstance(result, RelaxationCurve) and result.quantity == STIFFNESS:
        first = result.first_step()
        value, usable = first.stiffness, first.usable & np.isfinite(first.variance)
        sd = math.sqrt(first.rest_variance + float(np.mean(first.variance[usable]))) if usable.any() else math.nan
        mean = float(np.mean(value[usable])) if usable.any() else math.nan
        yield from _judge("the stiffness is negative", mean, sd, "N/mm after the step", _TURNED)
    elif isinstance(result, StepAnalysis):
        steps = [s for s in result.steps if math.isfinite(s.force_step_n) and s.force_step_sd_n > 0]
        yield from _of_many(
            np.array([s.force_step_n for s in steps]),
            np.array([s.force_step_sd_n for s in steps]),
            "N in the mean step",
        )
    elif isinstance(result, ForceMapReadings):
        for direction in sorted({r.direction for r in result.readings}):
            readings = [r for r in result.readings if r.direction == direction and r.force_sd_n > 0]
            yield from _of_many(
                np.array([r.force_n for r in readings]),
                np.array([r.force_sd_n for r in readings]),
                f"N in direction {direction}",
            )


def _of_response(response: FrequencyResponse, rig: RigConstants | None) -> Iterator[Negative]:
    """By the lowest third of the usable lines, where neither clamp nor film has inertia."""
    usable = response.usable & np.isfinite(response.value) & (response.variance > 0) & np.isfinite(response.variance)
    if rig is not None and rig.clamp_mass_kg and rig.load_cell_stiffness_n_per_mm:
        own = math.sqrt(rig.load_cell_stiffness_n_per_mm / (TONNES_PER_KG * rig.clamp_mass_kg)) / (2 * math.pi)
        usable = usable & (response.frequency_hz < _BELOW_RESONANCE * own)
    lines = np.flatnonzero(usable)[: max(1, int(usable.sum()) // 3)]
    if not lines.size:
        return
    weight = 2 / response.variance[lines]
    mean = float(np.average(response.value.real[lines], weights=weight))
    low, high = (compact(float(response.frequency_hz[i])) for i in (lines[0], lines[-1]))
    at = f"at {low} Hz" if low == high else f"at {low} to {high} Hz"
    if response.quantity == STIFFNESS:
        yield from _judge("the stiffness is negative", mean, float(weight.sum()) ** -0.5, f"N/mm {at}", _TURNED)
    else:
        yield from _judge("the actuation is negative", mean, float(weight.sum()) ** -0.5, f"N/kV² {at}", _RAISED)


def _of_many(values: Float, sds: Float, unit: str) -> Iterator[Negative]:
    if values.size:
        sd = float(np.sqrt(np.sum(sds**2))) / values.size
        yield from _judge("the actuation is negative", float(values.mean()), sd, unit, _RAISED)


def _of_cycle(recording: Recording) -> Iterator[Negative]:
    """By the slope of the stress over the stretch."""
    try:
        _, stretch, stress = stretch_and_stress(recording)
    except NotIdentifiableError:
        return
    good = np.isfinite(stretch) & np.isfinite(stress)
    if good.sum() < 8 or not (np.ptp(stretch[good]) and np.ptp(stress[good])):
        return
    r = float(np.corrcoef(stretch[good], stress[good])[0, 1])
    if r < _CORRELATED:
        slope = r * float(stress[good].std() / stretch[good].std())
        sd = abs(slope / r) * math.sqrt((1 - r**2) / (good.sum() - 2))
        yield from _judge(
            "the stiffness is negative", slope, max(sd, float(np.finfo(float).tiny)), "kPa per stretch", _TURNED
        )


def _of_slow_voltage(recording: Recording) -> Iterator[Negative]:
    """By the drop over the squared voltage: its scatter from cycle to cycle, for one cycle all that is left of the force at the peak."""
    try:
        found = measure_slow_voltage(recording)
    except NotIdentifiableError:
        return
    of_cycles = (found.upper - found.lower) / (2 * _NORMAL_95)
    sd = of_cycles if math.isfinite(of_cycles) else found.misfit_n / found.peak_kv**2
    yield from _judge("the actuation is negative", found.drop_n_per_kv2, sd, "N/kV²", _RAISED)


def _judge(what: str, value: float, sd: float, unit: str, why: str) -> Iterator[Negative]:
    if value < 0 and sd > 0 and -value > _CLEAR * sd:
        deviations = -value / sd
        yield Negative(
            f"{what}, {significant(value)} {unit}: {why} ({significant(deviations, 2)} SD below 0)", deviations
        )
