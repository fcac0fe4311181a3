"""The part of a specimen's page about large load–unload cycles: equilibrium stress and branches, fitted in time."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Pair, Piece, Row, Section, Table, bold, flow, name
from reports.figures.cycle import CycleCurve, loop, rest
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query, tell_warnings
from reports.results import Row as Record
from schemas.numbers import ABSENT, NBSP, capital, counted, ordinal, percent, pm, significant, with_unit, word

_FITS_SQL = """SELECT f.*
FROM cycle_fits AS f JOIN recordings AS r USING (recording_id)
WHERE f.specimen_id = $specimen AND r.status IN ('ok', 'damaged')
ORDER BY f.recording_id, f.law_given DESC, f.model_order"""
_CURVES_SQL = """SELECT model_order, time_s, stretch, measured_kpa, modelled_kpa
FROM cycle_curves
WHERE recording_id = $recording AND law_given = $given
ORDER BY model_order, time_s"""
_LOOPS_SQL = """SELECT *
FROM cycle_loops
WHERE specimen_id = $specimen
ORDER BY recording_id, cycle"""
_LOOPS = 10
"""Cycles of a recording that are told; of more, the first and the last ones."""
_IN_FULL = 3
"""Recordings of which so many cycles are told; of more, the first and the last one of each."""
_AS_FAR = 0.98
"""Range over the largest one from which a recording goes as far."""
_LONG = 0.9
"""Correlation of neighbouring residuals from which what is left is called no noise."""
_SHOWN = 4
"""Cycles that are drawn; of more, those that are best determined."""


def of_specimen(draft: Draft) -> Section | None:
    """All cycles of a specimen; the first ones drawn."""
    query = Query(_FITS_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    groups: dict[tuple[str, bool], list[Record]] = {}
    for row in found:
        groups.setdefault((row["recording_id"], row["law_given"]), []).append(row)
    recordings = sorted(dict.fromkeys(r for r, _ in groups), key=lambda r: _missed(groups, r))[:_SHOWN]
    blocks: list[Block | Fold] = []
    for recording in recordings:
        for given in (True, False):
            if (recording, given) in groups:
                blocks += _cycle(draft, groups[recording, given], alone=len(recordings) == 1)
    best = groups[next(k for k in groups if k[0] == recordings[0])]
    return Section(
        "cycles", _heading(best), "Large cycle", (*blocks, _table(draft, query, found), _branches(draft, query, found))
    )


def loops_of_specimen(draft: Draft) -> Section | None:
    """What each load-unload cycle took: the first and the last ones of many."""
    query = Query(_LOOPS_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = []
    groups = [tuple(group) for _, group in itertools.groupby(found, key=lambda r: r["recording_id"])]
    for own in groups:
        shown = _LOOPS if len(groups) <= _IN_FULL else 2
        kept = own if len(own) <= shown else (*own[: shown // 2], *own[-shown // 2 :])
        rows += [Row(_loop_cells(draft, r)) for r in kept]
    heads = (
        Head("Recording"), Head("Cycle", "n"), Head("From", "n"), Head("to", "n"), Head("Largest", "n"), Head("Loss, mJ", "n"),
        Head("without drift, mJ", "n"), Head("Loss, kJ/m³", "n"), Head("without drift, kJ/m³", "n"), Head("of the work", "n"),
        Head("Secant", "n"), Head("Modulus, kPa", "n"),
    )  # fmt: skip
    below = (
        "From one lowest displacement (mm, or stretch) to the next. Loss: the area between loading and unloading; without drift: after the"
        " force has lost what it changes from a cycle’s beginning to its end, which is relaxation from cycle to cycle and no loss of each."
        " Of the work: loss over the work of loading, force as recorded. Largest: force in N, or stress in kPa; secant: its range over that"
        " of the displacement. Modulus: slope of the line through the loading from 2 to 10 % elongation."
    )
    opened = max(int(r["unclosed"] or 0) for r in found)
    if opened:
        below += (
            f" Of the recording {counted(opened, 'cycle')} more, such as a first one from rest to the lower turning point, ends elsewhere than it"
            " began: it has no loss of its own and is not numbered here."
        )
    table = Table("Load–unload cycles", heads, tuple(rows), query.shown(), below=below, kind="narrow")
    return Section("loops", _loops_heading(found), "Cycles", (table,))


def _loop_cells(draft: Draft, r: Record) -> tuple[Piece, ...]:
    by_force = r["force_high_n"] is not None
    low, high, most, secant, unit = (
        ("displacement_low_mm", "displacement_high_mm", "force_high_n", "secant_n_per_mm", "N/mm")
        if by_force
        else ("stretch_low", "stretch_high", "stress_high_kpa", "secant_kpa", "kPa")
    )
    numbers = (r[k] for k in (low, high, most, "loss_mj", "steady_loss_mj", "loss_kj_per_m3", "steady_loss_kj_per_m3"))
    return (
        draft.site.recording(r["recording_id"]),
        str(r["cycle"]),
        *(ABSENT if v is None else significant(v, 4) for v in numbers),
        ABSENT if r["loss_share"] is None else percent(r["loss_share"]),
        with_unit(significant(r[secant], 3), unit),
        ABSENT if r["modulus_kpa"] is None else significant(r["modulus_kpa"], 3),
    )


def _loops_heading(found: Sequence[Record]) -> str:
    """The loss of the last cycles that are steady, else of the first one, of the slowest of the recordings that go farthest."""
    unit = "mm" if any(r["displacement_high_mm"] is not None for r in found) else "stretch"
    low, high = ("displacement_low_mm", "displacement_high_mm") if unit == "mm" else ("stretch_low", "stretch_high")
    told = [r for r in found if r[high] is not None]
    if not told:
        return "What the cycles take"
    farthest = _AS_FAR * max(float(r[high] - r[low]) for r in told)
    as_far = [r for r in told if float(r[high] - r[low]) >= farthest]
    slowest = max(as_far, key=lambda r: float(r["end_s"] - r["start_s"]))["recording_id"]
    own = [r for r in told if r["recording_id"] == slowest]
    several = len({r["recording_id"] for r in told}) > 1
    about = ""
    if several:
        width = significant(float(np.median([r[high] - r[low] for r in own])), 3)
        duration = with_unit(significant(float(np.median([r["end_s"] - r["start_s"] for r in own])), 3), "s")
        about = f" over {with_unit(width, 'mm')}" if unit == "mm" else f" over {width} of stretch"
        about += f" in {duration}"
    for key, energy in (("loss_mj", "mJ"), ("loss_kj_per_m3", "kJ/m³")):
        steady = [float(r[f"steady_{key}"]) for r in own if r[f"steady_{key}"] is not None]
        if len(steady) > 1:
            return (
                f"A cycle{about} takes {with_unit(significant(float(np.median(steady)), 3), energy)} once it is steady"
            )
        whole = [float(r[key]) for r in own if r[key] is not None]
        if whole:
            return f"The first cycle{about} takes {with_unit(significant(whole[0], 3), energy)}"
    return "What the cycles take"


def _missed(groups: dict[tuple[str, bool], list[Record]], recording: str) -> float:
    """Relative error of a recording's chosen order on the part left out."""
    return min(
        float(r["held_out_rmse_kpa"]) / max(float(r["rmse_kpa"]) / max(float(r["relative_rmse"]), 1e-12), 1e-12)
        for (name_, _), rows in groups.items()
        if name_ == recording
        for r in rows
        if r["selected"]
    )


def _chosen(rows: Sequence[Record]) -> Record:
    return next((r for r in rows if r["selected"]), rows[0])


def _heading(rows: Sequence[Record]) -> str:
    chosen = _chosen(rows)
    count = len(json.loads(chosen["branches"] or "[]"))
    branches = {0: "No branch", 1: "One branch"}.get(count, f"{capital(word(count))} branches")
    error = f"{branches} on {'the given' if chosen['law_given'] else 'a fitted'} equilibrium stress leave"
    error += f"{'s' if count < 2 else ''} {percent(chosen['relative_rmse'])} of the peak"
    if chosen["residual_correlation"] is not None and chosen["residual_correlation"] > _LONG:
        error += ", and that is no noise"
    return error


def _cycle(draft: Draft, rows: Sequence[Record], *, alone: bool) -> list[Block | Fold]:
    chosen = _chosen(rows)
    recording, given = chosen["recording_id"], bool(chosen["law_given"])
    data = draft.results.columns(Query(_CURVES_SQL, {"recording": recording, "given": given}))
    order = data["model_order"].astype(int)
    if not order.size:
        return []
    curves = []
    for n in sorted(set(order.tolist())):
        own = order == n
        values = (data[c][own].astype(float) for c in ("time_s", "stretch", "measured_kpa", "modelled_kpa"))
        curves.append(CycleCurve(n, n == chosen["model_order"], *values))
    peak = float(np.max(np.abs(curves[0].measured)))
    low, high = float(curves[0].stretch.min()), float(curves[0].stretch.max())
    errors = "; ".join(f"{ordinal(r['model_order'])} order {significant(r['rmse_kpa'], 4)} kPa" for r in rows)
    law = "given with the recording" if given else "fitted with the branches"
    who: Piece = "" if alone else flow(" ", name(recording, 60), ".")
    suffix = f"cycle_{recording}_{'given' if given else 'fitted'}"
    href = draft.data(suffix, data)
    left = Figure(
        loop(
            curves,
            alt=(
                f"Nominal stress of {short(recording, 60)} between stretch {low:.3g} and {high:.3g}, up to"
                f" {significant(peak)} kPa; equilibrium stress {law}; root mean square error: {errors}."
            ),
        ),
        flow(bold(f"Equilibrium stress {law}."), who, f" Root mean square error: {errors}."),
        href,
    )
    parts = "; ".join(f"{ordinal(r['model_order'])} order {_stress(r['held_out_rmse_kpa'])}" for r in rows)
    right = Figure(
        rest(
            curves, float(chosen["held_out_from_s"]), alt=f"Measured less modelled stress over time; {errors}."
        ),
        flow(bold("What is left."), f" On the last part, after a fit to the rest: {parts}."),
        href,
    )  # fmt: skip
    return [Pair((left, right))]


def _stress(value: float | None) -> str:
    """A stress in kPa; one beyond all measure is not written out."""
    if value is None or not np.isfinite(value) or value > 1e6:
        return "not predicted"
    return with_unit(significant(value), "kPa")


def _table(draft: Draft, query: Query, found: Sequence[Record]) -> Table:
    rows = []
    for r in found:
        correlation = r["residual_correlation"]
        rows.append(
            Row(
                (
                    draft.site.recording(r["recording_id"]),
                    "given" if r["law_given"] else "fitted",
                    f"{r['model_order']} ✓" if r["selected"] else str(r["model_order"]),
                    significant(r["rmse_kpa"], 4),
                    percent(r["relative_rmse"]),
                    _stress(r["held_out_rmse_kpa"]).removesuffix(f"{NBSP}kPa"),
                    ABSENT if correlation is None else f"{correlation:.3f}",
                ),
                "sel" if r["selected"] else "",
            )
        )
    heads = (
        Head("Recording"), Head("Equilibrium stress"), Head("Order", "n"), Head("RMS error, kPa", "n"), Head("of the peak", "n"),
        Head("On the part left out, kPa", "n"), Head("Correlation of residuals", "n"),
    )  # fmt: skip
    below = "The order is chosen by the error on the last 30 % of the cycle, which the fit has not seen."
    below += tell_warnings((r for r in found if r["selected"]), "fits")
    return Table("Orders of the large cycles", heads, tuple(rows), query.shown(), below=below, kind="narrow")


def _branches(draft: Draft, query: Query, found: Sequence[Record]) -> Table:
    """Branches of the chosen orders, a row each."""
    rows, laws = [], []
    for r in (r for r in found if r["selected"]):
        which = "given" if r["law_given"] else "fitted"
        for i, b in enumerate(json.loads(r["branches"] or "[]"), 1):
            values = (pm(b[k], b[f"{k}_sd"]) for k in ("gamma_kpa", "tau_s", "eta_kpa_s"))
            rows.append(Row((draft.site.recording(r["recording_id"]), which, str(i), *values)))
        laws.append(_law(r, which))
    heads = (
        Head("Recording"), Head("Equilibrium stress"), Head("Branch", "n"), Head("γ, kPa", "n"), Head("τ, s", "n"),
        Head("η = γτ, kPa s", "n"),
    )  # fmt: skip
    below = (
        f"{capital('; '.join(dict.fromkeys(laws)))}. A branch: dQ/dt + Q/τ = γ dλ/dt. ± is one standard deviation, widened"
        " for the correlation of the residuals."
    )
    return Table("Branches of the chosen orders", heads, tuple(rows), query.shown(), below=below, kind="narrow")


def _law(row: Record, which: str) -> str:
    values: dict[str, Any] = json.loads(row["equilibrium"] or "{}")
    parts = [
        f"{n.replace('_', ' ')} {significant(v, 4)}{f'{NBSP}kPa' if n.endswith('modulus') else ''}"
        for n, v in values.items()
    ]
    return f"{which} law ({visible(row['law'] or '')}): {', '.join(parts)}"
