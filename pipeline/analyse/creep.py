"""Creep and recovery as rows: what was measured, all orders with the Maxwell-Wiechert model of each, and the curve."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.fit.retardation.creep import Creep, Estimate
from pipeline.fit.retardation.fit import RESOLVED, RetardationFit
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

NOT_ASKED = "the diagnosis does not simulate creep: it does not ask this recording"


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
    estimates = {
        "elastic_mm": found.elastic_mm,
        "end_mm": found.end_mm,
        "left_mm": found.left_mm,
        "recovered_share": found.recovered_share,
        "compliance_mm_per_n": compliance,
        "drift_mm_per_h": found.drift_mm_per_h,
    }
    row: dict[str, Any] = {}
    for name, estimate in estimates.items():
        if estimate is not None:
            row |= {name: estimate.value, f"{name}_lower": estimate.lower, f"{name}_upper": estimate.upper}
    return row | {
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


def _fit(found: Creep, fit: RetardationFit) -> dict[str, Any]:
    compliance, n, count = fit.compliance, fit.nuisance, len(fit.compliance.times_s)
    sd = np.sqrt(np.diag(fit.covariance))
    instant = compliance.instant - found.cell_mm_per_n
    retarded = [
        _resolved(j, s / j if j > 0 else math.inf) for j, s in zip(compliance.retarded, sd[n + 1 :], strict=False)
    ]
    times = [_resolved(t, s) for t, s in zip(compliance.times_s, sd[sd.size - count :], strict=True)]
    model = found.solid(fit)
    k0_sd, springs, relaxation = found.solid_sd(fit)
    return {
        "model_order": fit.order,
        "selected": fit.order == found.retardation.selected_order,
        "p_value": fit.p_value,
        "reduced_chi2": fit.chi2 / fit.freedom,
        "instant_mm_per_n": instant,
        "instant_mm_per_n_sd": _resolved(instant, float(sd[n]) / instant),
        "flow_mm_per_n_s": compliance.flow or None,
        "flow_mm_per_n_s_sd": _resolved(compliance.flow, float(sd[n + 1 + count]) / compliance.flow)
        if compliance.flow
        else None,
        "retardations": _written(
            ("compliance_mm_per_n", compliance.retarded, retarded), ("time_s", compliance.times_s, times)
        ),
        "k0_n_per_mm": model.k0 or None,
        "k0_n_per_mm_sd": k0_sd,
        "arms": _written(("k_n_per_mm", model.k, springs), ("tau_s", model.tau, relaxation)),
        "warnings": "; ".join(fit.warnings) or None,
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
