"""What a specimen's recordings under voltage say beside their fits: errors of each order, and the permittivity."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import Measured
from pipeline.fit.actuator.known import allow_for_form, drive_specimen
from pipeline.fit.actuator.specification import (
    FREQUENCY_HZ,
    ForceStroke,
    Requirement,
    draw_force_stroke,
    specify,
    specify_force,
)
from pipeline.fit.force.permittivity import (
    SPHS,
    Permittivity,
    from_blocked_force,
    from_force,
    from_steps,
    relaxed_stiffness,
)
from pipeline.fit.relaxation.metrics import Geometry
from pipeline.fit.relaxation.predict import AMPLITUDE
from pipeline.fit.relaxation.results import RelaxationFit, SpecimenFits
from pipeline.fit.relaxation.under_voltage import CurveUnderVoltage, OrderUnderVoltage, compare_orders
from pipeline.transform.response import FrequencyResponse
from pipeline.transform.step import StepAnalysis, StepResponse
from schemas.metadata import RecordingMetadata, RigConstants
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_SAME_VOLTAGE = 0.05
"""Steps whose voltages differ by less than this share are repeats."""


def analyse_orders(
    analysis: Analysis,
    specimen_id: str,
    fits: SpecimenFits,
    responses: Sequence[FrequencyResponse],
    rigs: Sequence[RigConstants | None],
    recordings: Sequence[Measured],
) -> None:
    """Rows of `voltage_orders` and `voltage_curves`."""
    volts = {one.recording_id: _voltage(one) for one in recordings}
    voltages = [volts.get(r.recording_id or "") for r in responses]
    compared = analysis.attempt("orders under voltage", compare_orders, fits, responses, rigs, voltages)
    if compared is not None:
        analysis.add(order_tables(specimen_id, *compared))


def order_tables(
    specimen_id: str, found: Sequence[OrderUnderVoltage], curves: Sequence[CurveUnderVoltage]
) -> dict[str, pa.Table]:
    """Tables `voltage_orders` and `voltage_curves` of one specimen."""
    orders, table = TABLES["voltage_orders"], TABLES["voltage_curves"]
    return {
        "voltage_orders": orders.from_objects(found, specimen_id=specimen_id),
        "voltage_curves": table.stack(
            table.arrays(
                one.frequency_hz.size,
                specimen_id=specimen_id,
                recording_id=one.recording_id,
                voltage_kv=one.voltage_kv,
                form=one.form,
                model_order=one.model_order,
                frequency_hz=one.frequency_hz,
                real=one.value.real,
                imag=one.value.imag,
                standard_error=one.standard_error,
                usable=one.usable,
            )
            for one in curves
        ),
    }


def analyse_permittivity(
    analysis: Analysis,
    specimen_id: str,
    electrical: SpecimenFits | None,
    blocked: Sequence[FrequencyResponse],
    mechanical: RelaxationFit | None,
    recordings: Sequence[Measured],
) -> list[Permittivity]:
    """Permittivities of all sequences, of each voltage by itself, and of steps; adds their rows."""
    found: list[Permittivity | None] = []
    about = {one.recording_id: one.metadata for one in recordings if isinstance(one.metadata, RecordingMetadata)}
    sized = next((about[r.recording_id] for r in blocked if r.recording_id in about), None)
    if electrical is not None and sized is not None and AMPLITUDE in electrical.selected.estimates:
        force = electrical.selected.estimates[AMPLITUDE]
        if force.sd is not None:
            found.append(from_force(force.value, force.sd, sized, electrical.selected.lines))
    for response in blocked:
        metadata = about.get(response.recording_id or "")
        if metadata is not None:
            what = f"permittivity of {response.recording_id}"
            found.append(analysis.attempt(what, from_blocked_force, response, metadata, metadata.drive_kv))
    for one in recordings:
        metadata = about.get(one.recording_id)
        if metadata is not None and metadata.controller != "closed":
            for analysed in one.of(StepAnalysis):
                found += _static(analysed.steps, metadata, one.rig, mechanical)
    kept = [value for value in found if value is not None]
    analysis.add({"permittivities": TABLES["permittivities"].from_objects(kept, specimen_id=specimen_id)})
    return kept


def analyse_specification(
    analysis: Analysis,
    specimen_id: str,
    values: Sequence[Permittivity],
    mechanical: SpecimenFits | None,
    recordings: Sequence[Measured],
) -> None:
    """Rows of `specifications`: the specimen as an actuator, at the largest voltage that it was driven with."""
    abouts = [m for one in recordings if isinstance(m := one.metadata, RecordingMetadata) and m.drive_kv is not None]
    abouts = [m for m in abouts if m.controller != "closed"]
    if not values or not abouts:
        return
    about = max(abouts, key=lambda m: m.drive_kv or 0.0)
    best = min(values, key=lambda v: (v.method != SPHS, v.voltage_kv is not None, -(v.voltage_kv or 0.0)))
    relative = best.sd / best.force_per_voltage_squared_n_per_kv2
    volts = about.drive_kv or 0.0
    if mechanical is None:
        sheet = specify_force(best.force_per_voltage_squared_n_per_kv2 * volts**2, relative, volts)
        _add_sheet(analysis, specimen_id, volts, sheet, [])
        return
    lowest = mechanical.frequency_low_hz
    following = next((one.model for one in mechanical.fits if one.order == mechanical.selected_order + 1), None)
    chosen = mechanical.selected
    fit = allow_for_form(chosen, following, "; ".join(chosen.warnings), lowest)
    driven = drive_specimen(about, fit, best.force_per_voltage_squared_n_per_kv2, relative, volts, lowest)
    geometry = Geometry.of(about)
    length = None if geometry is None else geometry.length_mm
    found = analysis.attempt("specification", specify, driven, mechanical.frequency_high_hz, length)
    lines = [analysis.attempt("force over stroke", draw_force_stroke, driven, hz) for hz in (lowest, FREQUENCY_HZ)]
    _add_sheet(analysis, specimen_id, volts, found or [], [point for line in lines for point in line or ()])


def _add_sheet(
    analysis: Analysis,
    specimen_id: str,
    voltage_kv: float,
    sheet: Sequence[Requirement],
    line: Sequence[ForceStroke],
) -> None:
    for name, rows in (("specifications", sheet), ("force_strokes", line)):
        analysis.add({name: TABLES[name].from_objects(rows, specimen_id=specimen_id, voltage_kv=voltage_kv)})


def _static(
    steps: Sequence[StepResponse], about: RecordingMetadata, rig: RigConstants, mechanical: RelaxationFit | None
) -> list[Permittivity | None]:
    """One value for the repeats of each voltage."""
    groups: list[list[StepResponse]] = []
    for step in sorted((s for s in steps if not s.wrinkled), key=lambda s: s.voltage_kv):
        if groups and step.voltage_kv <= groups[-1][0].voltage_kv * (1 + _SAME_VOLTAGE):
            groups[-1].append(step)
        else:
            groups.append([step])
    found = []
    for group in groups:
        give = 1.0
        if mechanical is not None and rig.load_cell_stiffness_n_per_mm:
            held = float(np.mean([s.end_s - s.start_s for s in group])) / 2
            give += relaxed_stiffness(mechanical.model, about.on_s or held) / rig.load_cell_stiffness_n_per_mm
        found.append(from_steps([s.force_step_n for s in group], [s.voltage_kv for s in group], about, give))
    return found


def _voltage(recording: Measured) -> float | None:
    about = recording.metadata
    return about.drive_kv if isinstance(about, RecordingMetadata) else None
