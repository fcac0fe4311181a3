"""The parts of a specimen's page about its models: order and parameters."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from reports.blocks import Head, Piece, Row, Section, Table, Text, bold, code, filled, flow, sub
from reports.evidence import Standing, beyond_noise, siblings
from reports.figures.curves import Arm, arms, relaxation_time_sd
from reports.findings import FoundConstant, find_constants, sentences, tell_constants, tell_negative
from reports.names import visible
from reports.pages.draft import Draft
from reports.pages.specimen import shifts
from reports.results import Query
from reports.results import Row as Record
from reports.site import flat_metadata
from reports.words import remark
from schemas.mechanisms import model_name
from schemas.numbers import (
    ABSENT,
    NBSP,
    capital,
    compact,
    digits,
    headline,
    is_usable,
    never_negative,
    ordinal,
    p_equals,
    p_value,
    percent,
    pm,
    significant,
    whole,
)
from schemas.rig_constants import RIG_CONSTANTS

_ORDER_SQL = """SELECT model_order, reduced_chi2, bic - min(bic) OVER () AS delta_bic, order_p_value, magnitude_error_n_per_mm,
       phase_error_deg, held_out_error, selected
FROM model_fits
WHERE specimen_id = $specimen AND loading = $loading AND method = $method AND weighting IS NOT DISTINCT FROM $weighting
  AND coalesce(extension, '') = ''
ORDER BY model_order"""


def order(draft: Draft, fits: Sequence[Record], chosen: Record) -> Section:
    """What each order leaves, and why the chosen one was chosen."""
    alike = {name: chosen[name] for name in ("loading", "method", "weighting")}
    query = Query(_ORDER_SQL, {"specimen": draft.item, **alike})
    rows = []
    for r in draft.results.rows(query):
        label: Piece = f"{r['model_order']} ✓ selected" if r["selected"] else str(r["model_order"])
        rows.append(
            Row(
                (
                    label,
                    significant(r["reduced_chi2"]),
                    _difference(r["delta_bic"]),
                    p_value(r["order_p_value"]),
                    significant(r["magnitude_error_n_per_mm"], 2),
                    significant(r["phase_error_deg"], 2),
                    significant(r["held_out_error"], 2),
                ),
                "sel" if r["selected"] else "",
            )
        )
    heads = (
        Head("Order"), Head("Red. χ²", "n"), Head("ΔBIC", "n"), Head("p, next not needed", "n"),
        Head("Magnitude error, N/mm", "n"), Head("Phase error, °", "n"), Head("Held-out error, SD", "n"),
    )  # fmt: skip
    below = "The first order is the standard linear solid (Zener), which the thesis calls Kelvin–Voigt."
    if chosen["magnitude_error_n_per_mm"] is not None:
        below = (
            "Errors: mean absolute difference of magnitude and of phase (thesis, eq 4.14) over the usable ones of"
            f" {digits(chosen['frequency_lines'], 'line')} from {compact(chosen['frequency_low_hz'])} to"
            f" {compact(chosen['frequency_high_hz'])}{NBSP}Hz; they depend on that grid. {below}"
        )
    below = " ".join(filter(None, (_rules(chosen), _tell_next(fits, chosen), below)))
    kept, shown = filled(heads, rows)
    table = Table(
        "Evidence for the order of the model", kept, shown, query.shown(), _method_note(chosen), below, "narrow"
    )
    return Section("order", _order_heading(fits, chosen), "Order", (table,))


def _tell_next(fits: Sequence[Record], chosen: Record) -> str:
    """Why the order that the last row is tested against has no row."""
    last = siblings(fits, chosen)[-1]
    if last["order_p_value"] is None:
        return ""
    return f"The {ordinal(last['model_order'] + 1)} order has no row: it was fitted for that test alone, or bounded by the best relaxation of any order."


_RULES = {"test": "likelihood-ratio test", "bic": "BIC", "held_out": "held-out error"}


def _choices(chosen: Record) -> dict[str, int]:
    """The order that each rule would choose."""
    try:
        return {str(rule): int(order) for rule, order in json.loads(chosen["choices"] or "{}").items()}
    except (ValueError, TypeError, AttributeError):
        return {}


def _rules(chosen: Record) -> str:
    """What each rule would choose, and which of them decided."""
    texts = [f"{_RULES.get(rule, rule)}: {order}" for rule, order in _choices(chosen).items()]
    if not texts:
        return ""
    tested = chosen["order_p_value"] is not None
    decides = f" The test decides, at the level {_LEVEL:g}." if tested else ""
    return f"Order that each rule chooses: {visible(', '.join(texts))}.{decides}"


_HOW = {
    "forward": "fitted forward, rig inside the model",
    "corrected": "fitted to the corrected response",
    "time_domain": "fitted in time",
}


def _method_note(chosen: Record) -> str:
    return f"{chosen['loading']}, {_HOW.get(chosen['method'], visible(chosen['method'] or ''))}"


def _difference(delta: float | None) -> str:
    """A difference of BIC: whole, and as a power of ten where only its size matters."""
    if delta is None:
        return ABSENT
    return whole(round(delta)) if delta < 1e6 else significant(delta, 2)


_LEVEL = 0.01
"""Level of the test of one order against the next; the fit's own remark has the same."""


def _order_heading(fits: Sequence[Record], chosen: Record) -> str:
    """Where the test stopped, or that it did not: no order is the last only because nobody tried on."""
    highest = chosen["model_order"] == max(f["model_order"] for f in siblings(fits, chosen))
    order, following = capital(ordinal(chosen["model_order"])), ordinal(chosen["model_order"] + 1)
    p = chosen["order_p_value"]
    if p is None:
        tried = f", the highest that was tried; a {following} was not tested" if highest else ""
        return f"{order} order is chosen{tried}"
    if p >= _LEVEL:
        return f"A {following} relaxation is not shown ({p_equals(p)}, level {_LEVEL:g}){_dissent(chosen)}"
    if highest:
        return f"{order} order is chosen, the highest that was fitted; a {following} would fit better still ({p_equals(p)})"
    return f"{order} order is chosen"


def _dissent(chosen: Record) -> str:
    """Which rules would choose another order than the test did."""
    others: dict[int, list[str]] = {}
    for rule, order in _choices(chosen).items():
        if order != chosen["model_order"]:
            others.setdefault(order, []).append(_RULES.get(rule, visible(rule)))
    said = [f"{' and '.join(rules)} would choose order {order}" for order, rules in sorted(others.items())]
    return f"; {', '.join(said)}" if said else ""


def parameters(draft: Draft, standing: Standing, chosen: Record) -> Section:
    """The chosen model in numbers; beside it the extended one where there is one."""
    after, stated, moved = standing.extension, standing.stated, shifts.load(draft.results, standing)
    query = Query(
        "SELECT *\nFROM model_fits\nWHERE specimen_id = $specimen AND loading = $loading AND method = $method"
        " AND weighting IS NOT DISTINCT FROM $weighting AND model_order = $order AND coalesce(extension, '') IN ('', $extension)",
        {
            "specimen": draft.item, "loading": chosen["loading"], "method": chosen["method"], "weighting": chosen["weighting"],
            "order": chosen["model_order"], "extension": (after or chosen)["extension"] or "",
        },
    )  # fmt: skip
    filed = {c.key: _filed(stated, c.key) for c in RIG_CONSTANTS if _filed(stated, c.key) and chosen[c.key] is not None}
    constants = find_constants(standing)
    if after is not None:
        after = {**after, **{key: value for f in constants for key, value in _as_columns(f).items()}}
    rows = [Row(cells) for cells in _parameter_rows(chosen, after, filed)]
    heads = [Head("Parameter"), Head("Unit"), Head("Value" if after is None else "Fitted", "n")]
    if after is not None:
        heads += [Head("Extended", "n"), Head("Moved by, SD", "n")]
    heads.append(Head("Relaxation time, s", "n"))
    if filed:
        heads.append(Head("In the file", "n"))
    caption = f"{capital(model_name(chosen['model_order']))} model"
    if after is not None:
        caption += ", as fitted and as the diagnosis extends it"
    table = Table(
        caption,
        tuple(heads),
        tuple(rows),
        query.shown(),
        _method_note(chosen),
        _parameter_note(chosen, after, moved, _step_strain(draft)),
        "narrow",
    )
    heading: Piece = "Parameters"
    if chosen["modulus_mpa"]:
        sd = _modulus_sd(chosen)
        known = headline(chosen["modulus_mpa"], sd, "MPa") if is_usable(sd) else "not resolved"
        heading = flow("Parameters: modulus ", known)
        if after is not None and chosen["k0_n_per_mm"] and after["k0_n_per_mm"] and moved.any:
            scale = chosen["modulus_mpa"] / chosen["k0_n_per_mm"]
            value, sd = (
                scale * after[column] if after[column] else None for column in ("k0_n_per_mm", "k0_n_per_mm_sd")
            )
            heading = flow(
                heading, f", {headline(value, sd, 'MPa')} with {moved.cause} in the model" if is_usable(sd) else ""
            )
    notes = (Text(flow(bold("The rig: "), text)) for text in _rig_notes(standing, chosen, constants))
    return Section("parameters", heading, "Parameters", (table, *notes))


def _as_columns(found: FoundConstant) -> dict[str, float]:
    return {found.constant.key: found.value, f"{found.constant.key}_sd": found.sd}


def _rig_notes(standing: Standing, chosen: Record, constants: Sequence[FoundConstant]) -> list[str]:
    """What has to be said of the fitted constants of the rig: that the diagnosis found others, and that one cannot be so."""
    notes = []
    if constants:
        notes.append(
            "clamp and load cell are fitted from what the rig's file says of them, within its ±; the diagnosis finds them elsewhere."
            f" {tell_constants(standing, constants)}"
        )
    return [*notes, *(text[:1].lower() + text[1:] for text in tell_negative(chosen))]


def _filed(stated: Mapping[str, Any], column: str) -> str:
    """A constant as the rig's file states it, with its SD where that is stated too."""
    try:
        value = float(stated[column])
    except (KeyError, TypeError, ValueError):
        return ""
    try:
        return pm(value, float(stated[f"{column}_sd"]))
    except (KeyError, TypeError, ValueError):
        return compact(value)


def _modulus_sd(row: Record) -> float | None:
    """The modulus is proportional to k0; the geometry is taken as exact."""
    if not row["k0_n_per_mm"] or row["k0_n_per_mm_sd"] is None:
        return None
    return float(row["modulus_mpa"] * row["k0_n_per_mm_sd"] / row["k0_n_per_mm"])


def _parameter_rows(chosen: Record, after: Record | None, filed: Mapping[str, str]) -> list[tuple[Piece, ...]]:
    found: list[tuple[Piece, str, str, str]] = [(sub("k", 0), "N/mm", "k0_n_per_mm", "")]
    for i, arm in enumerate(arms(chosen), 1):
        tau = _time(chosen, i, arm)
        found.append((sub("k", i), "N/mm", f"k{i}_n_per_mm", tau))
        found.append((sub("c", i), "N s/mm", f"c{i}_n_s_per_mm", ""))
    found += [
        ("clamp mass", "kg", "clamp_mass_kg", ""),
        (flow(sub("k", "L"), ", load cell"), "N/mm", "load_cell_stiffness_n_per_mm", ""),
        (flow(sub("c", "L"), ", load cell"), "N s/mm", "load_cell_damping_n_s_per_mm", ""),
        ("force over V²", "N/kV²", "force_per_voltage_squared_n_per_kv2", ""),
    ]
    rows = []
    for label, unit, column, tau in found:
        values = [r[column] for r in (chosen, after) if r is not None]
        if all(v is None for v in values) and not column.startswith("k"):
            continue
        if column.startswith(("load", "clamp", "force")) and all(v is None for v in values):
            continue
        cells: list[Piece] = [label, unit, _estimate(chosen, column, tau)]
        if after is not None:
            cells += [_estimate(after, column, ""), significant(shifts.measure_shift(chosen, after, column), 2)]
        cells.append(tau if tau != "pure dashpot" else ABSENT)
        rows.append((*cells, filed.get(column, "")) if filed else tuple(cells))
    return rows


def _time(chosen: Record, index: int, arm: Arm) -> str:
    if arm.tau is None:
        return "pure dashpot"
    sd = relaxation_time_sd(chosen, index)
    return significant(arm.tau) if sd is None else pm(arm.tau, sd)


def _estimate(row: Record, column: str, tau: str) -> str:
    if row[column] is None:
        return "rigid: pure dashpot" if tau == "pure dashpot" else ABSENT
    return never_negative(row[column], row[f"{column}_sd"])


_SMALL_STRAIN = 0.1
"""Strain from which a secant is told from a slope: an elastomer's differ by some per cent there."""
_STEP_SQL = """SELECT DISTINCT c.step, r.metadata
FROM relaxation_curves AS c JOIN recordings AS r USING (recording_id)
WHERE c.specimen_id = $specimen AND c.quantity = 'stiffness_n_per_mm'"""


def _step_strain(draft: Draft) -> float | None:
    """Height of the largest step over the length of the film as clamped; None without steps or length."""
    found = []
    for row in draft.results.rows(Query(_STEP_SQL, {"specimen": draft.item})):
        about = flat_metadata(row["metadata"])
        try:
            length = float(about["film_length_mm"]) * float(about.get("stretch_1") or 1)
        except (KeyError, TypeError, ValueError):
            continue
        found.append(abs(float(row["step"])) / length)
    return max(found, default=None)


def _parameter_note(chosen: Record, after: Record | None, moved: shifts.Shifts, strain: float | None) -> Markup:
    parts: list[Piece] = ["± is one standard deviation, scaled by √(reduced χ²) where that exceeds 1."]
    if any(_estimate(chosen, c, "").startswith("<") for c in chosen if f"{c}_sd" in chosen):
        parts.append(" <: upper 95 % limit, where ± would reach 0.")
    if beyond_noise(chosen):
        parts.append(" The residual is not noise, so ± does not hold all of the error.")
    if after is not None:
        parts.append(
            flow(
                " Extended by ", code(after["extension"]), f": {shifts.tell(moved)}. The fitted model rests on the responses alone; the plain model of the"
                " diagnosis is another fit, to all that it simulates (mean forces, harmonics and rests too), and its parameters"
                " stand there. In its own ± what the extended model does not describe counts for less.",
            )
        )  # fmt: skip
    if chosen["modulus_mpa"]:
        parts.append(" Modulus: k₀ times stretched length over stretched area, geometry taken as exact.")
        if strain is not None and strain > _SMALL_STRAIN:
            parts.append(
                f" It is the secant of a step of {percent(strain)} of the length: stress over strain there, both of the film as clamped,"
                " and no slope at small strains."
            )
    if chosen["warnings"]:
        parts.append(f" {sentences(chosen['warnings'])}")
    else:
        parts.append(" No bound is active.")
    return flow(*parts)


_WEIGHTED_SQL = """SELECT *
FROM model_fits
WHERE specimen_id = $specimen AND loading = 'mechanical' AND method IN ('forward', 'corrected') AND coalesce(extension, '') = ''
ORDER BY model_order, method <> 'forward', weighting <> 'noise', weighting <> 'uniform'"""
_WEIGHTED = {
    ("forward", "noise"): "noise, rig inside the model",
    ("corrected", "noise"): "noise, corrected response",
    ("corrected", "uniform"): "uniform: every line alike",
    ("corrected", "relative"): "relative: every line as a share of its magnitude",
}


def weightings(draft: Draft) -> Section | None:
    """Models of each order by the weights of their lines; None where all have the same."""
    query = Query(_WEIGHTED_SQL, {"specimen": draft.item})
    found = [r for r in draft.results.rows(query) if (r["method"], r["weighting"]) in _WEIGHTED]
    if not any(r["weighting"] != "noise" for r in found):
        return None
    most = max(len(arms(r)) for r in found)
    columns = [
        "k0_n_per_mm",
        *(f"{n}{i}_{unit}" for n, unit in (("k", "n_per_mm"), ("c", "n_s_per_mm")) for i in range(1, most + 1)),
    ]
    rows = [
        Row(
            (
                str(r["model_order"]), _WEIGHTED[r["method"], r["weighting"]],
                *(ABSENT if r[c] is None else significant(r[c], 3) for c in columns),
                significant(r["magnitude_error_n_per_mm"], 2), significant(r["phase_error_deg"], 2),
            ),
            "sel" if r["selected"] else "",
        )
        for r in found
    ]  # fmt: skip
    heads = (
        Head("Order", "n"), Head("Weights", "text"), *(Head(sub(c[0], int(c[1])), "n") for c in columns),
        Head("Magnitude error, N/mm", "n"), Head("Phase error, °", "n"),
    )  # fmt: skip
    below = (
        "k in N/mm, c in N s/mm. Weights by noise give the least uncertain parameters of a model that is right; a model of few arms"
        " then follows the lines that are measured best. Uniform weights keep it near the measurement where the film is stiff,"
        " relative ones in equal shares at all frequencies, as a controller needs it and as the tables 4.2 to 4.4 of the thesis have"
        " it. They say nothing about noise and choose no order. –: a pure dashpot, or an arm that the lines do not tell."
    )
    table = Table("Models by the weights of their lines", heads, tuple(rows), query.shown(), below=below, kind="wide")
    return Section("weightings", "The same orders with other weights", "Weights", (table,))


def without_model(fits: Sequence[Record]) -> Text | None:
    """Why no fit was chosen, where fits were tried."""
    warnings = sorted({remark(f["warnings"]) for f in fits if f["warnings"]})
    return Text("No order was selected: " + "; ".join(warnings), "sub") if warnings else None
