"""Rows of `model_fits`: models of responses, and those of large cycles as the same springs and dampers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.fit.relaxation.amplitudes import AmplitudeFits
from pipeline.fit.relaxation.results import (
    MECHANICAL,
    NOISE,
    TIME_DOMAIN,
    UNIFORM,
    Estimate,
    RelaxationFit,
    SpecimenFits,
)
from pipeline.fit.relaxation.time_domain import CycleFit, CycleFits
from schemas.tables import ARMS, TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_PLAIN = (
    "clamp_mass_kg",
    "load_cell_stiffness_n_per_mm",
    "load_cell_damping_n_s_per_mm",
    "force_per_voltage_squared_n_per_kv2",
)


def model_fits_table(fits: Sequence[SpecimenFits], cycles: Sequence[CycleFits] = ()) -> pa.Table:
    """Rows for the fits of one specimen, every order of each; extended models have theirs with the diagnosis."""
    rows = [_row(group, fit) for group in fits for fit in group.fits]
    rows += [_cycle_row(group, fit) for group in cycles for fit in group.fits]
    return TABLES["model_fits"].rows(rows)


def _row(group: SpecimenFits, fit: RelaxationFit) -> dict[str, Any]:
    size = fit.shape.size
    by_noise = group.weighting == NOISE
    row: dict[str, Any] = {
        "specimen_id": group.specimen_id,
        "loading": group.loading,
        "method": group.method,
        "weighting": group.weighting,
        "model_order": fit.order,
        "magnitude_error_n_per_mm": fit.magnitude_error,
        "phase_error_deg": fit.phase_error_deg,
        "extension": "",
        "frequency_lines": fit.lines,
        "reduced_chi2": fit.reduced_chi2 if by_noise else None,
        "bic": fit.bic if by_noise else None,
        "selected": by_noise and fit.order == group.selected_order,
        "warnings": _sentences(fit.warnings + group.warnings),
        "order_p_value": fit.order_p_value if by_noise else None,
        "held_out_error": fit.held_out_error if by_noise else None,
        "frequency_low_hz": group.frequency_low_hz,
        "frequency_high_hz": group.frequency_high_hz,
        "positivity_chi2": group.positivity.chi2_per_line if group.positivity else None,
        "modulus_mpa": fit.modulus_mpa,
        "covariance": json.dumps(
            {"names": list(fit.names), "material": size, "matrix": [[_short(v) for v in r] for r in fit.covariance]}
        ),
        "intervals": json.dumps(
            {n: {"lower": e.lower, "upper": e.upper, "method": e.method} for n, e in fit.estimates.items()}
        ),
        "choices": json.dumps(dict(group.choices)),
        "spread": _spread(group),
    }
    for name, column in _columns().items():
        if name in fit.estimates:
            row |= _estimate(column, fit.estimates[name])
    return row


def amplitude_fits_table(found: Sequence[AmplitudeFits]) -> pa.Table:
    """Rows of `amplitude_fits`: those of `model_fits`, for each amplitude by itself."""
    table = TABLES["amplitude_fits"]
    return table.rows(
        {
            "amplitude": one.amplitude,
            "recordings": one.recordings,
            **{name: value for name, value in _row(one.fits, fit).items() if name in table.names},
        }
        for one in found
        for fit in one.fits.fits
    )


def _spread(group: SpecimenFits) -> str | None:
    spread = group.spread
    if not spread.gain_sd and not spread.relative_sd:
        return None
    return json.dumps({"gain_sd": spread.gain_sd, "relative_sd": spread.relative_sd, "gains": dict(spread.gains)})


def _columns() -> Mapping[str, str]:
    arms = range(1, ARMS + 1)
    named = (
        {"k0": "k0_n_per_mm"} | {f"k{i}": f"k{i}_n_per_mm" for i in arms} | {f"c{i}": f"c{i}_n_s_per_mm" for i in arms}
    )
    return named | {name: name for name in _PLAIN}


def _estimate(column: str, estimate: Estimate) -> dict[str, float | None]:
    return {column: estimate.value, f"{column}_sd": estimate.sd}


def _cycle_row(group: CycleFits, fit: CycleFit) -> dict[str, Any]:
    """Branches as springs and dampers of the film; k0 is the law's slope at stretch 1, where the film is undeformed."""
    to_n_per_mm, ratio = group.n_per_mm_of_kpa, group.section_over_length_mm
    film = "a 1 mm cube" if ratio is None else f"a film whose section over length is {ratio:.4g} mm"
    row: dict[str, Any] = {
        "specimen_id": group.specimen_id,
        "loading": MECHANICAL,
        "method": TIME_DOMAIN,
        "weighting": UNIFORM,
        "model_order": fit.order,
        "k0_n_per_mm": group.slope_at_rest(fit) * to_n_per_mm,
        "extension": "",
        "frequency_lines": fit.samples,
        "selected": fit.order == group.selected_order,
        "held_out_error": None,
        "warnings": _sentences(
            (
                f"time-domain fit with {group.law} equilibrium stress, {'given' if group.fixed else 'fitted'}; as"
                f" {film}; root mean square error {fit.rmse:.4g} kPa ({100 * fit.relative_rmse:.2g} % of the peak), on the"
                f" part left out {fit.held_out_rmse:.4g} kPa",
                *fit.warnings,
                *group.warnings,
            )
        ),
        "choices": json.dumps({"held_out": group.selected_order}),
        "covariance": json.dumps({"equilibrium": dict(fit.equilibrium), "unit": "kPa"}),
    }
    for i in range(len(fit.gamma)):
        row[f"k{i + 1}_n_per_mm"] = fit.gamma[i] * to_n_per_mm
        row[f"k{i + 1}_n_per_mm_sd"] = _times(fit.gamma_sd[i], to_n_per_mm)
        row[f"c{i + 1}_n_s_per_mm"] = fit.eta[i] * to_n_per_mm
        row[f"c{i + 1}_n_s_per_mm_sd"] = _times(fit.eta_sd[i], to_n_per_mm)
    return row


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _short(value: float) -> float:
    return float(f"{value:.6g}")


def _sentences(parts: Sequence[str]) -> str:
    return "; ".join(dict.fromkeys(parts))
