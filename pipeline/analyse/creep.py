"""Creep and recovery as rows: what was measured, all orders with the Maxwell-Wiechert model of each, and the curve."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.fit.retardation.creep import NOT_AT_ONCE, Creep, Estimate, measure_creep
from pipeline.fit.retardation.fit import RESOLVED, RetardationFit
from schemas.recording import Recording
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

NOT_ASKED = "the diagnosis does not simulate creep: it does not ask this recording"


def analyse_creep(recording: Recording) -> tuple[tuple[str, ...], dict[str, pa.Table]]:
    """What limits a creep test, and its rows."""
    found, about = measure_creep(recording), recording.metadata
    return found.warnings, creep_tables(about.recording_id, about.specimen_id, found)


def creep_tables(recording_id: str, specimen_id: str, found: Creep) -> dict[str, pa.Table]:
    """Tables `creep_tests`, `creep_fits` and `creep_curves` of one recording."""
    about = {"recording_id": recording_id, "specimen_id": specimen_id}
    return {
        "creep_tests": TABLES["creep_tests"].rows([{**about, **_test(found)}]),
        "creep_fits": TABLES["creep_fits"].rows({**about, **_fit(found, fit)} for fit in found.retardation.fits),
        "creep_curves": _curve(recording_id, found),
    }


def _test(found: Creep) -> dict[str, Any]:
    compliance = Estimate(
        *(
            x / abs(found.load_n) - found.cell_mm_per_n
            for x in (abs(found.end_mm.value), *sorted(map(abs, (found.end_mm.lower, found.end_mm.upper))))
        )
    )
    return {
        **spread("elastic_mm", found.elastic_mm),
        **spread("end_mm", found.end_mm),
        **spread("left_mm", found.left_mm),
        **spread("recovered_share", found.recovered_share),
        **spread("compliance_mm_per_n", compliance),
        **spread("drift_mm_per_h", found.drift_mm_per_h),
        "load_n": found.load_n,
        "load_n_sd": found.load_n_sd,
        "hold_s": found.hold_s,
        "recovery_s": found.recovery_s,
        "strain_at_end": None if found.length_mm is None else found.end_mm.value / found.length_mm,
        "walk_mm_per_sqrt_h": found.walk_mm_per_sqrt_h,
        "load_cell_mm_per_n": found.cell_mm_per_n,
        "model_order": found.retardation.selected_order,
        "warnings": "; ".join(found.warnings) or None,
    }


def spread(name: str, estimate: Estimate | None) -> dict[str, float]:
    """A number and its limits as columns; none where there is no number."""
    if estimate is None:
        return {}
    return {name: estimate.value, f"{name}_lower": estimate.lower, f"{name}_upper": estimate.upper}


def _fit(found: Creep, fit: RetardationFit) -> dict[str, Any]:
    compliance, n, count = fit.compliance, fit.nuisance, len(fit.compliance.times_s)
    sd = np.sqrt(np.diag(fit.covariance))
    instant, model = found.instant(fit), found.solid(fit)
    warnings = list(fit.warnings) if instant is not None else [*fit.warnings, NOT_AT_ONCE]
    retarded = [
        _resolved(j, s / j if j > 0 else math.inf) for j, s in zip(compliance.retarded, sd[n + 1 :], strict=False)
    ]
    times = [_resolved(t, s) for t, s in zip(compliance.times_s, sd[sd.size - count :], strict=True)]
    k0_sd, springs, relaxation = found.solid_sd(fit)
    return {
        "model_order": fit.order,
        "selected": fit.order == found.retardation.selected_order,
        "p_value": fit.p_value,
        "reduced_chi2": fit.chi2 / fit.freedom,
        "instant_mm_per_n": instant,
        "instant_mm_per_n_sd": None if instant is None else _resolved(instant, float(sd[n]) / instant),
        "flow_mm_per_n_s": compliance.flow or None,
        "flow_mm_per_n_s_sd": _resolved(compliance.flow, float(sd[n + 1 + count]) / compliance.flow)
        if compliance.flow
        else None,
        "retardations": _written(
            ("compliance_mm_per_n", compliance.retarded, retarded), ("time_s", compliance.times_s, times)
        ),
        "k0_n_per_mm": None if model is None else model.k0 or None,
        "k0_n_per_mm_sd": k0_sd,
        "arms": None if model is None else _written(("k_n_per_mm", model.k, springs), ("tau_s", model.tau, relaxation)),
        "warnings": "; ".join(warnings) or None,
    }


def _resolved(value: float, sd_log: float) -> float | None:
    return float(abs(value) * sd_log) if sd_log <= RESOLVED else None


def _written(*columns: tuple[str, Sequence[float], Sequence[float | None]]) -> str:
    """Entries of several columns, each value with its standard deviation, longest time first."""
    entries = [
        {key: value for (name, values, sds) in columns for key, value in ((name, values[i]), (f"{name}_sd", sds[i]))}
        for i in range(len(columns[0][1]))
    ]
    return json.dumps(sorted(entries, key=lambda entry: -(entry[columns[-1][0]] or 0.0)))


def _curve(recording_id: str, found: Creep) -> pa.Table:
    record = found.retardation.record
    begins = np.array([hold.begins_s for hold in record.holds])
    return TABLES["creep_curves"].arrays(
        record.time_s.size,
        recording_id=recording_id,
        hold=record.hold,
        time_s=record.time_s,
        since_s=record.time_s - begins[record.hold],
        load_n=record.mean @ record.drive,
        displacement_mm=record.displacement,
        modelled_mm=found.retardation.modelled(found.retardation.selected),
        usable=record.usable,
    )
