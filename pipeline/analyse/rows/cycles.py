"""Rows of `cycle_fits` and `cycle_curves`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from pipeline.fit.relaxation.time_domain import HELD_OUT, CycleFit, CycleFits
from schemas.arrays import Float
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa


MOST_POINTS = 400


def cycle_tables(fits: Sequence[CycleFits], time_s: Float, stretch: Float, stress: Float) -> dict[str, pa.Table]:
    """Rows for all fits of one cycle, (m,) s since the recording's first sample, stretch and stress in kPa."""
    good = np.isfinite(time_s) & np.isfinite(stretch) & np.isfinite(stress)
    t, lam, p = time_s[good], stretch[good], stress[good]
    begins = float(t[0] + (1 - HELD_OUT) * (t[-1] - t[0]))
    shown = np.unique(np.linspace(0, t.size - 1, min(t.size, MOST_POINTS)).astype(int))
    curves = []
    for group in fits:
        for fit in group.fits:
            model = group.stress(fit, t, lam)
            curves += [
                {
                    "recording_id": group.recording_id,
                    "law_given": group.fixed,
                    "model_order": fit.order,
                    "time_s": float(t[i]),
                    "stretch": float(lam[i]),
                    "measured_kpa": float(p[i]),
                    "modelled_kpa": float(model[i]),
                }
                for i in shown
            ]
    rows = [_row(group, fit, begins) for group in fits for fit in group.fits]
    return {"cycle_fits": TABLES["cycle_fits"].rows(rows), "cycle_curves": TABLES["cycle_curves"].rows(curves)}


def _row(group: CycleFits, fit: CycleFit, begins: float) -> dict[str, Any]:
    names = ("gamma_kpa", "gamma_kpa_sd", "tau_s", "tau_s_sd", "eta_kpa_s", "eta_kpa_s_sd")
    columns = (fit.gamma, fit.gamma_sd, fit.tau, fit.tau_sd, fit.eta, fit.eta_sd)
    branches = [dict(zip(names, values, strict=True)) for values in zip(*columns, strict=True)]
    return {
        "recording_id": group.recording_id,
        "specimen_id": group.specimen_id,
        "law": group.law,
        "law_given": group.fixed,
        "model_order": fit.order,
        "rmse_kpa": fit.rmse,
        "relative_rmse": fit.relative_rmse,
        "held_out_rmse_kpa": fit.held_out_rmse,
        "held_out_from_s": begins,
        "residual_correlation": fit.correlation,
        "samples": fit.samples,
        "selected": fit.order == group.selected_order,
        "equilibrium": json.dumps(dict(fit.equilibrium)),
        "branches": json.dumps(branches),
        "warnings": "; ".join(dict.fromkeys((*fit.warnings, *group.warnings))),
    }
