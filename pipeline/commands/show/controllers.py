"""Controllers of a specimen in words, or for a program: designed anew from what the lab knows of its film."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from pipeline.analyse.controllers import assume_electronics
from pipeline.commands.show.rows import as_csv, as_finite_json, in_plain
from pipeline.fit.control.design import (
    ControllerDesign,
    DesignCourses,
    Range,
    choose_demand,
    propose_controllers,
    try_controllers,
)
from pipeline.fit.control.identify import Plant, SensedStep, identify_plant
from pipeline.fit.control.loops import Electronics
from pipeline.fit.relaxation.stored import StoredFit, read_fit
from pipeline.lab.lab import Lab
from pipeline.lab.reader import Reader
from schemas.errors import NotIdentifiableError, UsageError
from schemas.metadata import RigConstants
from schemas.numbers import ABSENT, significant

_OVER = 1e-9


@dataclass(frozen=True)
class ControlAsked:
    """The arguments of `dealab control`; None where they were not given."""

    specimen: str
    demand_pf: float | None
    force_overshoot: float
    largest_kv: float | None
    lag_ms: float
    filter_hz: float
    interval_ms: float


def control_specimen(lab: Lab, asked: ControlAsked, form: str) -> tuple[str, str]:
    """Controllers for a specimen.

    Parameters
    ----------
    lab : where the film was measured
    asked : the arguments
    form : `text`, `csv` or `json`

    Returns
    -------
    What is asked for, and what a reader of a table has to be told beside it

    Raises
    ------
    UsageError, LabError The specimen has no mechanical model or no steps with a capacitance, its voltage cannot reach
        the demand, no gains keep the margins, or there is no database.
    """
    fit, recordings, rig = _read(lab, asked.specimen)
    try:
        plant = identify_plant(fit.model, fit.shape, fit.covariance, recordings)
        electronics, told = _close(plant, rig, asked)
        demand = _choose_demand(plant, electronics, asked)
        candidates = propose_controllers(plant, demand, electronics, force_overshoot_percent=asked.force_overshoot)
    except NotIdentifiableError as error:
        raise UsageError(f"{asked.specimen[:80]}: {error}") from None
    rows, courses = try_controllers(plant, candidates, demand, electronics)
    if form == "csv":
        return as_csv(_table(rows)), in_plain(told)
    if form == "json":
        return as_finite_json(_as_data(asked.specimen, rows, courses, told)), ""
    return _describe(asked, rows, plant, demand, told), ""


def _read(lab: Lab, name: str) -> tuple[StoredFit, list[list[SensedStep]], RigConstants]:
    lab.require_database()
    with Reader(lab.database) as reader:
        fits = reader.rows(
            "model_fits", None, "specimen_id", [name], "selected AND loading = 'mechanical' AND method = 'forward'"
        )
        loops = {r["recording_id"] for r in reader.rows("loop_responses", ["recording_id"], "specimen_id", [name])}
        steps = reader.rows("step_responses", None, "specimen_id", [name])
        recorded = reader.rows("recordings", ["metadata"], "recording_id", {r["recording_id"] for r in steps})
    if not fits:
        raise UsageError(
            f'there is no mechanical model of "{name[:80]}" in this lab',
            expected="sweeps, sinusoids or a relaxation of the specimen",
            remedy=lab.spell_command("sql \"SELECT specimen_id FROM best_models WHERE loading = 'mechanical'\"")
            + " lists those with one",
        )
    fit = read_fit(fits[0])
    if fit is None:
        raise UsageError(f"the model of {name[:80]} keeps no covariance of springs and relaxation times")
    found: dict[str, list[SensedStep]] = defaultdict(list)
    for row in sorted(steps, key=lambda r: (r["recording_id"], r["cycle"])):
        known = row["capacitance_step_pf"] is not None and row["capacitance_step_sd_pf"] is not None
        if known and not row["wrinkled"] and row["recording_id"] not in loops:
            found[row["recording_id"]].append(SensedStep(**{n: row[n] for n in SensedStep.__dataclass_fields__}))
    rigs = [json.loads(r["metadata"] or "{}").get("rig", {}) for r in recorded]
    return fit, list(found.values()), RigConstants.parse(next(filter(None, rigs), {}))


def _close(plant: Plant, rig: RigConstants, asked: ControlAsked) -> tuple[Electronics, str]:
    usual, _ = assume_electronics(plant, rig)
    own = replace(
        usual,
        largest_kv=asked.largest_kv or usual.largest_kv,
        time_constant_s=1e-3 * asked.lag_ms,
        filter_hz=asked.filter_hz,
        interval_s=1e-3 * asked.interval_ms,
    )
    told = (
        f"voltage up to {own.largest_kv:.3g} kV; amplifier {own.gain_kv_per_v:g} kV/V, lag {asked.lag_ms:g} ms; filter"
        f" {own.filter_hz:g} Hz; a decision every {asked.interval_ms:g} ms; gains of {plant.steps} steps,"
        " relaxation of the mechanical model, the same in all parts of the film; no noise"
    )
    return own, told


def _choose_demand(plant: Plant, electronics: Electronics, asked: ControlAsked) -> float:
    gain = float(plant.film.gain_pf_per_kv2[0])
    if asked.demand_pf is None:
        return choose_demand(plant)
    reach = gain * electronics.largest_kv**2
    if asked.demand_pf * gain <= 0 or abs(asked.demand_pf) > abs(reach) * (1 + _OVER):
        raise UsageError(
            f"--demand-pf {asked.demand_pf:g}",
            expected=f"a change that up to {electronics.largest_kv:.3g} kV can hold: between 0 and {reach:.2g} pF",
        )
    return asked.demand_pf


def _describe(asked: ControlAsked, rows: Sequence[ControllerDesign], plant: Plant, demand: float, told: str) -> str:
    heads = ("goal", "controller", "Kp V/pF", "Ki V/pF/s", "margins", "rise s", "settled s",
             "over %", "force over %", "peak kV")  # fmt: skip
    table = [
        (
            r.goal, r.controller, _number(r.proportional_gain), _number(r.integral_gain),
            ABSENT if r.phase_margin_deg is None else f"{r.phase_margin_deg:.0f}°, {significant(r.gain_margin, 2)}",
            _limited(r.rise_time_s), _limited(r.settling_time_s), _limited(r.overshoot_percent),
            _limited(r.force_overshoot_percent), _limited(r.peak_kv),
        )
        for r in rows
    ]  # fmt: skip
    widths = [max(len(line[i]) for line in (heads, *table)) for i in range(len(heads))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(line, widths, strict=True)).rstrip() for line in (heads, *table)]
    title = (
        f"{asked.specimen}: a step of {demand:.3g} pF, held for 60 s; in brackets 95 % limits over"
        f" {len(plant.possible)} films that the fit leaves possible"
    )
    notes = [
        f"gentle: as quick as an overshoot of the force by {asked.force_overshoot:g} % allows; quick: a rise within"
        " 0.5 s with the least overshoot of the force; printed: the thesis' gains",
        "designed gains are those of a square-root drive, V² = u V_largest; margins are kept by 95 % of the"
        " possible films",
        told,
    ]
    return in_plain("\n".join([title, "", *lines, "", *notes]))


def _number(value: float | None) -> str:
    return ABSENT if value is None else significant(value)


def _limited(value: Range) -> str:
    if value.value is None:
        return "never"
    low, high = (ABSENT if x is None else significant(x, 2) for x in (value.lower, value.upper))
    middle = significant(value.value, 2)
    return middle if (low, high) == (middle, middle) else f"{middle} ({low} to {high})"


def _flat(row: ControllerDesign) -> dict[str, Any]:
    """One row with a column for each value and limit, as the table `controller_designs` has them."""
    flat: dict[str, Any] = {}
    for name in ControllerDesign.__dataclass_fields__:
        value = getattr(row, name)
        if isinstance(value, Range):
            flat |= {name: value.value, f"{name}_lower": value.lower, f"{name}_upper": value.upper}
        else:
            flat[name] = value
    return flat


def _table(rows: Sequence[ControllerDesign]) -> Any:
    import pyarrow as pa

    return pa.Table.from_pylist([_flat(row) for row in rows])


def _as_data(
    specimen: str, rows: Sequence[ControllerDesign], courses: Sequence[DesignCourses], told: str
) -> dict[str, Any]:
    drawn = [{n: v.tolist() if hasattr(v, "tolist") else v for n, v in asdict(one).items()} for one in courses]
    return {"specimen_id": specimen, "designs": [_flat(row) for row in rows], "courses": drawn, "assumptions": told}
