"""Rows of `step_responses`, and steps back from rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from pipeline.transform.step import StepResponse
from schemas.tables import TABLES

if TYPE_CHECKING:
    import pyarrow as pa

_SAME = (
    "cycle",
    "start_s",
    "end_s",
    "voltage_kv",
    "force_rest_n",
    "force_step_n",
    "force_step_sd_n",
    "force_instant_fraction",
    "rise_time_s",
    "overshoot_percent",
    "settling_time_s",
    "recovery_time_s",
    "capacitance_rest_pf",
    "capacitance_step_pf",
    "capacitance_step_sd_pf",
    "capacitance_instant_fraction",
    "capacitance_mean_fraction",
    "spikes",
    "wrinkled",
)


def step_table(recording_id: str, steps: Sequence[StepResponse], specimen_id: str | None = None) -> pa.Table:
    """Rows of `step_responses` of one recording."""
    return TABLES["step_responses"].rows(
        {
            **{name: getattr(step, name) for name in _SAME},
            "recording_id": recording_id,
            "specimen_id": specimen_id,
            "capacitive_strain": step.capacitive_strain,
            "warnings": "; ".join(step.warnings) or None,
        }
        for step in steps
    )


def steps_from_rows(rows: Sequence[Mapping[str, Any]]) -> tuple[StepResponse, ...]:
    """Steps of one recording from its rows, as `step_table` wrote them."""
    steps = []
    for row in rows:
        values = {name: row[name] for name in _SAME}
        for name in ("force_rest_n", "force_step_n", "force_step_sd_n"):
            values[name] = float("nan") if values[name] is None else values[name]
        warnings = tuple((row.get("warnings") or "").split("; ")) if row.get("warnings") else ()
        steps.append(StepResponse(**values, warnings=warnings))
    return tuple(steps)
