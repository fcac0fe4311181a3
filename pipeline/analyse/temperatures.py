"""A specimen's tables at several temperatures: joined into a master curve, which then stands in their place for the models.

Only tables take part, whose response is the film's own; a temperature is known of them by a column or by `temperature_c`. What
is computed stands in `pipeline.transform.superposition`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from pipeline.analyse.analysis import Analysis
from pipeline.analyse.inputs import Measured
from pipeline.analyse.responses import CORRECTED, response_table
from pipeline.fit.relaxation.ladder import Rung
from pipeline.fit.relaxation.order import LEVEL
from pipeline.physics.film import RelaxationModel
from pipeline.transform.relaxation import RelaxationCurve
from pipeline.transform.response import STIFFNESS, FrequencyResponse
from pipeline.transform.shift_laws import ShiftLaw, fit_shift_laws
from pipeline.transform.superposition import Shift, Superposition, superpose
from pipeline.transform.superposition_fit import Isotherm
from schemas.arrays import Bool, Float
from schemas.metadata import TableMetadata
from schemas.tables import TABLES
from schemas.units import conversion

if TYPE_CHECKING:
    import pyarrow as pa

TEMPERATURE = "temperature_c"
"""Key of the details of a result that says at which temperature it was measured, °C."""
SAME_TEMPERATURE = 2.0
"""K: a room or an oven may drift by as much between repeats, which are averaged."""

_Result: TypeAlias = FrequencyResponse | RelaxationCurve


@dataclass(frozen=True)
class _Part:
    """A result at a known temperature."""

    about: TableMetadata
    result: _Result

    @property
    def isotherm(self) -> Isotherm:
        result, usable = self.result, self.usable
        common: dict[str, Any] = {
            "temperature_c": float(result.details[TEMPERATURE]),
            "variance": result.variance[usable],
            "recording_id": result.recording_id,
        }
        if isinstance(result, FrequencyResponse):
            return Isotherm(axis=result.frequency_hz[usable], value=result.value[usable], **common)
        return Isotherm(axis=result.time_s[usable], value=result.stiffness[usable], in_time=True, **common)

    @property
    def usable(self) -> Bool:
        """(n,) which of its points take part."""
        value = self.result.value if isinstance(self.result, FrequencyResponse) else self.result.stiffness
        return np.asarray(self.result.usable & np.isfinite(value) & (value != 0), dtype=np.bool_)


@dataclass(frozen=True)
class Unit:
    """The unit of a table's values, and the N/mm that one of it became; `is_modulus`: it is one of a modulus."""

    name: str
    n_per_mm: float
    is_modulus: bool


def join_temperatures(
    analysis: Analysis, specimen_id: str, recordings: Sequence[Measured]
) -> tuple[Sequence[Measured], Unit | None]:
    """The recordings with those tables replaced by their master curve that were measured at different temperatures.

    Returns the recordings as they are, and None, where there is nothing to superpose; else the unit of the tables as well.
    """
    parts = [part for one in recordings for part in _parts_of(one) if part.usable.any()]
    temperatures = [part.result.details[TEMPERATURE] for part in parts]
    if not parts or max(temperatures) - min(temperatures) < SAME_TEMPERATURE:
        return recordings, None
    about = parts[0].about
    asked = next((p.about.reference_temperature_c for p in parts if p.about.reference_temperature_c is not None), None)
    vertical = any(part.about.vertical_shift == "free" for part in parts)
    isotherms = [part.isotherm for part in parts]
    master = analysis.attempt("master curve", superpose, isotherms, reference_c=asked, vertical=vertical)
    if master is None:
        return recordings, None
    analysis.note([f"master curve: {warning}" for warning in master.warnings])
    unit = _unit_of(parts[0].result)
    laws = analysis.attempt("shift laws", fit_shift_laws, master) or ()
    analysis.add(_tables(specimen_id, master, laws, isotherms, unit))
    responses = [part.result for part in parts if isinstance(part.result, FrequencyResponse)]
    if responses:
        analysis.add({"frequency_responses": response_table(responses, CORRECTED)})
    joined = Measured(replace(about, recording_id="master"), recordings[0].rig, _join(specimen_id, master, parts))
    taken = {id(part.result) for part in parts}
    rest = [replace(one, results=tuple(r for r in one.results if id(r) not in taken)) for one in recordings]
    kinds: tuple[type, ...] = (FrequencyResponse, RelaxationCurve)
    others = [one.recording_id for one in rest if any(isinstance(result, kinds) for result in one.results)]
    if others:
        analysis.note(
            [
                f"the temperature of {', '.join(others)} is not known: taken as that of the master curve,"
                f" {master.reference_c:.4g} °C"
            ]
        )
    return [joined, *rest], unit


def _parts_of(one: Measured) -> list[_Part]:
    """What a table holds at a known temperature."""
    about = one.metadata
    if not isinstance(about, TableMetadata):
        return []
    results: list[_Result] = [*one.of(FrequencyResponse), *one.of(RelaxationCurve)]
    return [_Part(about, r) for r in results if r.quantity == STIFFNESS and TEMPERATURE in r.details]


def _unit_of(result: _Result) -> Unit:
    is_modulus = result.details["measured_as"] == "modulus"
    canonical = "MPa" if is_modulus else "N/mm"
    name = str(result.details["unit"] or canonical)
    return Unit(name, conversion(name, canonical).scale * float(result.details["scale"]), is_modulus)


def _join(specimen_id: str, master: Superposition, parts: Sequence[_Part]) -> tuple[_Result, ...]:
    """All responses as one at the reference temperature, all relaxations as one."""
    pairs = list(zip(parts, master.shifts, strict=True))
    found: list[_Result] = []
    turned = [(p.result, p.usable, s) for p, s in pairs if isinstance(p.result, FrequencyResponse)]
    if turned:
        frequency = np.concatenate([r.frequency_hz[u] * 10**s.log_a for r, u, s in turned])
        order = np.argsort(frequency, kind="stable")
        found.append(
            FrequencyResponse(
                frequency_hz=frequency[order],
                value=np.concatenate([r.value[u] / s.b for r, u, s in turned])[order],
                variance=np.concatenate([r.variance[u] / s.b**2 for r, u, s in turned])[order],
                usable=np.ones(frequency.size, dtype=bool),
                quantity=STIFFNESS,
                loading=turned[0][0].loading,
                specimen_id=specimen_id,
                details=turned[0][0].details,
            )
        )
    held = [(p.result, p.usable, s) for p, s in pairs if isinstance(p.result, RelaxationCurve)]
    if held:
        time = np.concatenate([r.time_s[u] / 10**s.log_a for r, u, s in held])
        order = np.argsort(time, kind="stable")
        found.append(
            replace(
                held[0][0],
                time_s=time[order],
                window_s=np.column_stack([time[order], time[order]]),
                stiffness=np.concatenate([r.stiffness[u] / s.b for r, u, s in held])[order],
                variance=np.concatenate([r.variance[u] / s.b**2 for r, u, s in held])[order],
                usable=np.ones(time.size, dtype=bool),
                unusable_because=("",) * time.size,
                recording_id=None,
                specimen_id=specimen_id,
            )
        )
    return tuple(found)


def _tables(
    specimen_id: str, master: Superposition, laws: Sequence[ShiftLaw], isotherms: Sequence[Isotherm], unit: Unit
) -> dict[str, pa.Table]:
    turned = [(one, shift) for one, shift in zip(isotherms, master.shifts, strict=True) if not one.in_time]
    reduced = np.concatenate([one.axis * 10**shift.log_a for one, shift in turned]) if turned else np.array([np.nan])
    table = TABLES["shift_factors"]
    return {
        "master_curves": TABLES["master_curves"].from_objects(
            [master],
            specimen_id=specimen_id,
            temperatures=len(master.shifts),
            frequency_low_hz=float(reduced.min()),
            frequency_high_hz=float(reduced.max()),
            unit=unit.name,
            n_per_mm_of_unit=unit.n_per_mm,
        ),
        "shift_factors": table.from_objects(
            master.shifts,
            specimen_id=specimen_id,
            reference_c=master.reference_c,
            log10_a=lambda shift: shift.log_a,
            log10_a_sd=lambda shift: shift.log_a_sd,
            log10_a_lower=lambda shift: shift.log_a_lower,
            log10_a_upper=lambda shift: shift.log_a_upper,
        ),
        "shift_laws": TABLES["shift_laws"].from_objects(
            laws,
            specimen_id=specimen_id,
            degrees_of_freedom=lambda law: law.freedom,
            off_decades=lambda law: law.off,
            selected=lambda law: law is laws[0],
        ),
        "master_curve_points": TABLES["master_curve_points"].stack(
            _point_rows(specimen_id, master, one, shift, unit)
            for one, shift in zip(isotherms, master.shifts, strict=True)
        ),
    }


def _point_rows(specimen_id: str, master: Superposition, one: Isotherm, shift: Shift, unit: Unit) -> pa.Table:
    a = 10**shift.log_a
    value = one.value / shift.b / unit.n_per_mm
    columns: dict[str, Any]
    if one.in_time:
        curve = master.relaxation(one.axis / a) / unit.n_per_mm
        columns = {"time_s": one.axis, "reduced_time_s": one.axis / a, "storage": value, "curve_storage": curve}
    else:
        response = master.stiffness(one.axis * a) / unit.n_per_mm
        columns = {
            "frequency_hz": one.axis,
            "reduced_frequency_hz": one.axis * a,
            "storage": value.real,
            "loss": value.imag,
            "tan_delta": value.imag / np.where(value.real == 0, np.nan, value.real),
            "curve_storage": response.real,
            "curve_loss": response.imag,
        }
    return TABLES["master_curve_points"].arrays(
        one.axis.size,
        specimen_id=specimen_id,
        recording_id=one.recording_id,
        temperature_c=one.temperature_c,
        unit=unit.name,
        **columns,
    )


def prony_table(specimen_id: str, rungs: Sequence[Rung], unit: Unit | None) -> pa.Table:
    """Rows of `prony_series` for the models of a ladder."""
    enough = next((rung.model_order for rung in rungs if (rung.order_p_value or 0.0) >= LEVEL), None)
    table = TABLES["prony_series"]
    return table.stack(_prony_rows(specimen_id, rung, rung.model_order == enough, unit) for rung in rungs)


def _prony_rows(specimen_id: str, rung: Rung, enough: bool, unit: Unit | None) -> pa.Table:
    model: RelaxationModel = rung.model
    dashpot = [model.c_inf] if model.c_inf else []
    nothing = [np.nan] * len(dashpot)
    springs: Float = np.array([model.k0, *model.k, *nothing])
    modulus = springs / unit.n_per_mm if unit is not None and unit.is_modulus else None
    return TABLES["prony_series"].arrays(
        springs.size,
        specimen_id=specimen_id,
        model_order=rung.model_order,
        term=np.arange(springs.size),
        tau_s=np.array([np.nan, *model.tau, *nothing]),
        stiffness_n_per_mm=springs,
        share=springs / (model.k0 + sum(model.k)),
        modulus=modulus,
        damper_n_s_per_mm=np.array([np.nan, *model.c, *dashpot]),
        unit=unit.name if modulus is not None and unit is not None else None,
        enough=enough,
    )
