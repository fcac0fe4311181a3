"""Rows of self-sensing: slow changes, closed loops, sensing fits, electrode coverage and migration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.fit.sensing.coverage import CoverageFit
from pipeline.fit.sensing.gains import GainProposal
from pipeline.fit.sensing.migration import Migration
from pipeline.fit.sensing.self_sensing import SensingFit
from pipeline.fit.weighted import Estimate
from pipeline.transform.capacitance_cycles import CapacitanceCycles
from pipeline.transform.coats import Coat
from pipeline.transform.loop import LoopResponse
from pipeline.transform.step import StepAnalysis
from schemas.metadata import RecordingMetadata
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


def _columns(estimates: Mapping[str, Estimate | None], *, bounds: bool = True) -> dict[str, float]:
    """Columns of estimates: value, standard deviation, 95 % limits."""
    row: dict[str, float] = {}
    for name, estimate in estimates.items():
        if estimate is None:
            continue
        row |= {name: estimate.value, f"{name}_sd": estimate.sd}
        if bounds:
            row |= {f"{name}_lower": estimate.lower, f"{name}_upper": estimate.upper}
    return row


def slow_table(about: RecordingMetadata, analysis: StepAnalysis) -> pa.Table:
    """Rows of `slow_changes` of one recording."""
    changes = {"force": analysis.force_change, "capacitance": analysis.capacitance_change}
    return TABLES["slow_changes"].rows(
        {
            "recording_id": about.recording_id,
            "specimen_id": about.specimen_id,
            "quantity": quantity,
            **{
                name: getattr(change, name)
                for name in (
                    "change",
                    "change_sd",
                    "duration_s",
                    "shape",
                    "bend_s",
                    "unrecovered",
                    "unrecovered_sd",
                    "fading",
                )
            },
        }
        for quantity, change in changes.items()
        if change is not None
    )


def sensing_table(specimen_id: str, fit: SensingFit) -> pa.Table:
    """The row of `sensing_fits` of one specimen."""
    row: dict[str, Any] = {
        "specimen_id": specimen_id,
        "sensing_region": fit.sensing_region,
        "r_squared": fit.r_squared,
        "predicted_sensitivity": fit.predicted_sensitivity,
        "steps": fit.steps,
        "warnings": "; ".join(fit.warnings),
    }
    row |= _columns(
        {
            "force_per_capacitive_strain_n": fit.force_per_capacitive_strain,
            "nonlinearity": fit.nonlinearity,
            "modulus_mpa": fit.modulus_mpa,
            "modulus_ratio": fit.modulus_ratio,
            "sensitivity": fit.sensitivity,
            "drift_pf_per_hour": fit.drift_pf_per_hour,
            "wrinkling_onset_kv": fit.wrinkling_onset_kv,
            "force_exponent": fit.force_exponent,
        }
    )
    row |= _columns({"mechanical_modulus_mpa": fit.mechanical_modulus_mpa}, bounds=False)
    return TABLES["sensing_fits"].rows([row])


_LOOP = (
    "recording_id",
    "specimen_id",
    "proportional_gain",
    "integral_gain",
    "start_s",
    "hold_s",
    "demand_step_pf",
    "capacitance_rest_pf",
    "capacitance_step_pf",
    "rise_time_s",
    "overshoot_percent",
    "settling_time_s",
    "error_rms_pf",
    "force_step_n",
    "force_overshoot_percent",
    "peak_kv",
    "final_kv",
    "error_sign",
    "relation_drift_percent",
    "relation_drift_percent_sd",
)


def loop_table(loop: LoopResponse) -> pa.Table:
    """The row of `loop_responses` of one recording."""
    row = {name: getattr(loop, name) for name in _LOOP}
    return TABLES["loop_responses"].rows([{**row, "warnings": "; ".join(loop.warnings) or None}])


def gains_table(proposals: Sequence[GainProposal]) -> pa.Table:
    """Rows of `controller_gains` of one specimen."""
    return TABLES["controller_gains"].rows(
        {
            "specimen_id": one.specimen_id,
            "demand_step_pf": one.demand_step_pf,
            "tried": one.tried,
            "kept": one.kept,
            "recording_id": None if one.best is None else one.best.recording_id,
            "proportional_gain": None if one.best is None else one.best.proportional_gain,
            "integral_gain": None if one.best is None else one.best.integral_gain,
            "gentle_recording_id": None if one.gentle is None else one.gentle.recording_id,
            "statement": one.statement,
        }
        for one in proposals
    )


def coverage_tables(coats: Sequence[Coat], fit: CoverageFit | None) -> dict[str, pa.Table]:
    """Rows of `electrode_coats`, and the row of `coverage_fits` where there is a fit."""
    names = ("recording_id", "specimen_id", "coats", "capacitance_pf")
    tables = {
        "electrode_coats": TABLES["electrode_coats"].rows(
            {**{name: getattr(coat, name) for name in names}, "capacitance_pf_sd": coat.capacitance_sd_pf}
            for coat in coats
        )
    }
    if fit is not None:
        row = {
            "specimen_id": fit.specimen_id,
            "coats": fit.coats,
            "form": fit.form,
            "warnings": "; ".join(fit.warnings) or None,
            **_columns(
                {
                    "full_pf": fit.full_pf,
                    "first_share": fit.first_share,
                    "coats_to_cover": fit.coats_to_cover,
                }
            ),
        }
        tables["coverage_fits"] = TABLES["coverage_fits"].rows([row])
    return tables


def migration_tables(cycles: CapacitanceCycles, onset: Migration | None) -> dict[str, pa.Table]:
    """Rows of `electrode_cycles` of one recording, and of `electrode_migrations` where an onset was looked for."""
    size = np.abs(cycles.harmonics)
    tables = {
        "electrode_cycles": TABLES["electrode_cycles"].arrays(
            cycles.cycle.size,
            recording_id=cycles.recording_id,
            specimen_id=cycles.specimen_id,
            cycle=cycles.cycle,
            mean_pf=cycles.mean_pf,
            amplitude_pf=cycles.amplitude_pf,
            distortion=cycles.distortion,
            second_harmonic=size[:, 0],
            third_harmonic=size[:, 1] if size.shape[1] > 1 else None,
        )
    }
    if onset is not None:
        row = {
            name: getattr(onset, name)
            for name in (
                "recording_id",
                "specimen_id",
                "cycles",
                "onset_cycle",
                "onset_cycle_lower",
                "onset_cycle_upper",
                "p_value",
                "distortion_before",
                "distortion_after",
            )
        }
        tables["electrode_migrations"] = TABLES["electrode_migrations"].rows(
            [{**row, "warnings": "; ".join(onset.warnings) or None}]
        )
    return tables
