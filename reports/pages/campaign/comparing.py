"""The parts of a campaign's page that set specimens beside each other: self-sensing, and static force by configuration."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reports import words
from reports.blocks import Block, Figure, Fold, Head, Row, Section, Table, bold, filled, flow
from reports.figures import sensing as figures
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import ABSENT, NBSP, bounds, capital, compact, p_value, percent, pm, significant

_IN_CAMPAIGN = "specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $item)"
_SENSING_SQL = f"""SELECT f.*, d.configuration, l.relation_drift_percent, l.relation_drift_percent_sd, l.hold_s
FROM sensing_fits AS f
JOIN (SELECT specimen_id, max(configuration) AS configuration FROM recordings GROUP BY specimen_id) AS d USING (specimen_id)
LEFT JOIN (SELECT specimen_id, relation_drift_percent, relation_drift_percent_sd, hold_s FROM loop_responses
           WHERE relation_drift_percent IS NOT NULL
           QUALIFY row_number() OVER (PARTITION BY specimen_id ORDER BY hold_s DESC, recording_id) = 1) AS l USING (specimen_id)
WHERE f.{_IN_CAMPAIGN}
ORDER BY f.sensing_region DESC, d.configuration, f.specimen_id"""


def self_sensing(draft: Draft) -> Section | None:
    """Does the capacitance tell the force: with a region of its own, and with one that actuates as well?"""
    query = Query(_SENSING_SQL, {"item": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                draft.site.specimen(r["specimen_id"]), short(r["configuration"] or ABSENT),
                "one for both" if r["sensing_region"] == "active" else "separate",
                pm(r["force_per_capacitive_strain_n"], r["force_per_capacitive_strain_n_sd"]),
                percent(r["nonlinearity"]), pm(r["modulus_mpa"], r["modulus_mpa_sd"]),
                pm(r["mechanical_modulus_mpa"], r["mechanical_modulus_mpa_sd"]),
                pm(r["sensitivity"], r["sensitivity_sd"]), significant(r["predicted_sensitivity"]),
                pm(r["force_exponent"], r["force_exponent_sd"]),
                pm(r["relation_drift_percent"], r["relation_drift_percent_sd"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads, rows = filled(
        (
            Head("Specimen"), Head("Configuration", "text"), Head("Sensing region"), Head("Force over strain, N", "n"),
            Head("Bend", "n"), Head("Modulus, MPa", "n"), Head("mechanical", "n"), Head("Sensitivity", "n"),
            Head("predicted", "n"), Head("Exponent of the force", "n"), Head("Drift held, %", "n"),
        ),
        rows,
    )  # fmt: skip
    below = (
        "Bend: departure of a parabola from the line at the largest strain. Mechanical: modulus of the relaxation model for"
        " a film that creeps as the capacitance does. Drift held: change of the force at given capacitance in the longest closed loop, from 20 s on."
    )
    table = Table("Self-sensing of the specimens", heads, rows, query.shown(), below=below, kind="wide")
    blocks: list[Block | Fold] = [table]
    drawn = agreement(draft, found, None)
    if drawn is not None:
        blocks.insert(0, drawn)
    return Section("self-sensing", _sensing_heading(found), "Self-sensing", tuple(blocks))


def _sensing_heading(found: Sequence[Record]) -> str:
    held = [r for r in found if r["relation_drift_percent"] is not None]
    separate = [r for r in held if r["sensing_region"] != "active"]
    shared = [r for r in held if r["sensing_region"] == "active"]
    if separate and shared:
        one, other = separate[0], shared[0]
        own, conventional = (
            f"{pm(r['relation_drift_percent'], r['relation_drift_percent_sd'])}{NBSP}%" for r in (one, other)
        )
        return f"Held at given capacitance, the force drifts by {own} with a sensing region of its own, by {conventional} without"
    number = len(found)
    return f"{capital(compact(number))} self-sensing specimen{'s' if number != 1 else ''}"


def agreement(draft: Draft, found: Sequence[Record], specimen: str | None) -> Figure | None:
    """Measured against predicted sensitivity of some specimens; one may be the one at hand."""
    known = [r for r in found if r["sensitivity"] is not None and r["predicted_sensitivity"] is not None]
    if not known:
        return None
    columns = {
        n: np.array([r[n] for r in known], dtype=float)
        for n in ("predicted_sensitivity", "sensitivity", "sensitivity_lower", "sensitivity_upper")
    }
    names = [r["specimen_id"] for r in known]
    at_hand = names.index(specimen) if specimen in names else None
    outside = [
        r["specimen_id"]
        for r in known
        if r["sensitivity_lower"] is not None
        and r["sensitivity_upper"] is not None
        and not r["sensitivity_lower"] <= r["predicted_sensitivity"] <= r["sensitivity_upper"]
    ]
    limited = any(r["sensitivity_lower"] is not None for r in known)
    words = "all within their 95 % limits" if limited else "no limits are known"
    if outside:
        words = f"outside its limits: {', '.join(short(s, 20) for s in outside)}"
    if at_hand is not None:
        r = known[at_hand]
        words = f"measured {pm(r['sensitivity'], r['sensitivity_sd'])}, from the geometry {significant(r['predicted_sensitivity'])}"
    measured, predicted = columns["sensitivity"], columns["predicted_sensitivity"]
    image = figures.agreement(
        [short(n, 14) for n in names],
        predicted,
        measured,
        columns["sensitivity_lower"],
        columns["sensitivity_upper"],
        at_hand,
        alt=f"Measured against predicted sensitivity: {words}.",
    )
    return Figure(
        image,
        flow(
            bold("Sensitivity."),
            f" Change of the capacitive strain per stretch of the active region: {words}. Bars: 95{NBSP}%, the permittivity's"
            " uncertainty included.",
        ),
        draft.data("sensitivity", {"specimen_id": names, **columns}),
    )


_FORCE_SQL = """SELECT *
FROM force_comparisons
WHERE configuration_a IN (SELECT configuration FROM recordings WHERE campaign = $item)
  AND configuration_b IN (SELECT configuration FROM recordings WHERE campaign = $item)
ORDER BY voltage_kv, direction, configuration_a, configuration_b"""


def forces(draft: Draft) -> Section | None:
    """What rods add to the static force, and what a divided electrode takes from it."""
    query = Query(_FORCE_SQL, {"item": draft.item})
    found = [r for r in draft.results.rows(query) if r["difference_n"] is not None]
    if not found:
        return None
    rows = tuple(
        Row(
            (
                words.against(r), str(r["direction"]),
                f"{compact(r['stretch_1'])} × {compact(r['stretch_2'])}", compact(r["voltage_kv"], 2),
                f"{r['specimens_b']} and {r['specimens_a']}",
                bounds(r["difference_n"], r["difference_n_lower"], r["difference_n_upper"], 1e3),
                bounds(*(r[f"ratio{end}"] for end in ("", "_lower", "_upper"))), p_value(r["p_value"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Configurations", "text"), Head("Direction", "n"), Head("Stretches", "n"), Head("Voltage, kV", "n"), Head("Specimens", "n"),
        Head("Difference, mN", "n"), Head("Ratio", "n"), Head("p", "n"),
    )  # fmt: skip
    warned = sorted({r["warnings"] for r in found if r["warnings"]})
    below = "Differences and ratios with 95 % limits, p of equal forces (both Welch), over specimens."
    below += "".join(f" {capital(visible(w))}." for w in warned)
    table = Table("Static force of two configurations", heads, rows, query.shown(), below=below)
    return Section("forces", _force_heading(found), "Static force compared", (table,))


def _force_heading(found: Sequence[Record]) -> str:
    first = [r for r in found if r["direction"] == 1 and r["ratio"] is not None]
    if not first:
        return "Static force by configuration"
    parts = [f"“{short(r['configuration_b'], 60)}” {_change(r)}" for r in first[:2]]
    return f"Static force against the other configuration: {'; '.join(parts)}"


def _change(row: Record) -> str:
    """`+41 % (34 to 48)` from a ratio with its limits."""
    value, low, high = (None if row[n] is None else 100 * (row[n] - 1) for n in ("ratio", "ratio_lower", "ratio_upper"))
    sign = "+" if value is not None and value > 0 else ""
    return f"{sign}{bounds(value, low, high)}{NBSP}%"
