"""The part of specimen and campaign pages about static force: how it grows with pre-stretch, and with which permittivity."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from reports.blocks import Block, Figure, Fold, Head, Row, Section, Table, Text, bold, flow
from reports.figures import steps as figures
from reports.figures.steps import ForceSeries
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from reports.words import remark
from schemas.numbers import ABSENT, bounds, capital, compact, pm, significant

_DRAWN, _LISTED, _FEW = 6, 12, 2
"""Series drawn, points listed without a fold, and points that are no map yet."""


def section(draft: Draft, where: str, value: str) -> Section | None:
    """Static actuation force by pre-stretch, of a specimen or of a campaign's specimens."""
    query = Query(
        "SELECT specimen_id, configuration, direction, stretch_1, stretch_2, voltage_kv, force_n, force_sd_n, repeats,\n"
        f"       predicted_n, relative_permittivity, relative_permittivity_sd\nFROM force_maps\nWHERE {where}\n"
        "ORDER BY specimen_id, direction, stretch_1, stretch_2",
        {"item": value},
    )
    found = draft.results.rows(query)
    if not found:
        return None
    fits = draft.results.rows(
        Query(f"SELECT * FROM force_map_fits WHERE {where} ORDER BY specimen_id", {"item": value})
    )
    axis = "stretch_2" if len({r["stretch_2"] for r in found}) >= len({r["stretch_1"] for r in found}) else "stretch_1"
    best = max((r for r in found if r["force_n"] is not None), key=lambda r: abs(r["force_n"]), default=None)
    blocks: list[Block | Fold] = [_figure(draft, found, fits, axis, best)]
    blocks += [
        Text(flow(f"{short(f['specimen_id'] or '', 40)}: ", remark(f["statement"]), "."))
        for f in _maps(fits)[:_DRAWN]
        if f["statement"]
    ]
    table = _table(draft, query, found)
    blocks.append(Fold(f"All {len(found)} points", (table,)) if len(found) > _LISTED else table)
    return Section("force", capital(finding(found, fits)) or "Static force", "Static force", tuple(blocks))


def _maps(fits: Sequence[Record]) -> Sequence[Record]:
    """Fits over several pre-stretches; all where there is none of those."""
    return [f for f in fits if (f["points"] or 0) > _FEW] or fits


def finding(found: Sequence[Record], fits: Sequence[Record]) -> str:
    """`static force reaches 361 ± 5 mN, with a relative permittivity of 2.59 (2.57–2.61)`; empty without any force.

    A permittivity that may as well be 0 is none.
    """
    best = max((r for r in found if r["force_n"] is not None), key=lambda r: abs(r["force_n"]), default=None)
    if best is None:
        return ""
    several = len({r.get("specimen_id") for r in found}) > 1
    text = f"static force reaches {_force(best)}" + (f" ({short(best['specimen_id'] or '', 30)})" if several else "")
    if len(fits) == 1 and fits[0]["relative_permittivity"] is not None:
        fit = fits[0]
        if fit["relative_permittivity_lower"] is not None and fit["relative_permittivity_lower"] <= 0:
            return f"{text}; no one permittivity explains it"
        value = bounds(*(fit[f"relative_permittivity{end}"] for end in ("", "_lower", "_upper")))
        text += f", with a relative permittivity of {value}"
        if fit["stated_permittivity"] is not None and not _agrees(fit):
            text += f" where {compact(fit['stated_permittivity'])} is stated"
    return text


def _agrees(fit: Record) -> bool:
    low, high = fit["relative_permittivity_lower"], fit["relative_permittivity_upper"]
    return low is None or high is None or bool(low <= fit["stated_permittivity"] <= high)


def _force(row: Record) -> str:
    return pm(_milli(row["force_n"]), _milli(row["force_sd_n"]), "mN")


def _figure(draft: Draft, found: Sequence[Record], fits: Sequence[Record], axis: str, best: Record | None) -> Figure:
    fitted = {f["specimen_id"]: f["relative_permittivity"] for f in fits}
    series = []
    points = Counter((r["specimen_id"], r["direction"]) for r in found)
    ranked = sorted(points, key=lambda k: -points[k])
    if best is not None:  # what the heading names is drawn, and how the same film does in its other direction
        ranked.sort(key=lambda k: k[0] != best["specimen_id"] and points[k] <= _FEW)
    for key in ranked[:_DRAWN]:
        part = [r for r in found if (r["specimen_id"], r["direction"]) == key and r["force_n"] is not None]
        if part:
            series.append(_series(part, axis, fitted.get(key[0]), several=len(fitted) > 1))
    words = "" if best is None else tell_strongest(found, best)
    lines = "dashed: thesis, eq 3.7, with the permittivity stated"
    if any(s.fitted is not None for s in series):
        lines += "; solid: with the one permittivity that meets all points best; below: what is left of that"
    columns = {n: [r[n] for r in found] for n in found[0]}
    return Figure(
        figures.forces(series, f"Pre-stretch in direction {axis[-1]}", alt=f"Static actuation force by pre-stretch. {words}"),
        flow(bold("Static force."), f" {words} Points: mean ± 2 SD of the repeats; {lines}."),
        draft.data("force_map", columns),
    )  # fmt: skip


def tell_strongest(found: Sequence[Record], best: Record) -> str:
    """Where the force is largest, and how many times the least of the same film and direction; a sentence."""
    several = len({r["specimen_id"] for r in found}) > 1
    who = f"{short(best['specimen_id'] or '', 30)} in" if several else "In"
    like = [
        r
        for r in found
        if (r["specimen_id"], r["direction"]) == (best["specimen_id"], best["direction"]) and r["force_n"]
    ]
    least = min(like, key=lambda r: abs(r["force_n"]), default=best)
    force, stretches = _force(best), f"{significant(best['stretch_1'])} and {significant(best['stretch_2'])}"
    if least is best:
        return f"{who} direction {best['direction']} the force is {force}, at stretches {stretches}."
    ratio = abs(best["force_n"] / least["force_n"])
    return (
        f"{who} direction {best['direction']} the force is largest at stretches {stretches}, {force}:"
        f" {significant(ratio, 2)} times the {_force(least)} at {significant(least['stretch_1'])} and"
        f" {significant(least['stretch_2'])}, where it is least."
    )


def _series(part: Sequence[Record], axis: str, permittivity: float | None, *, several: bool) -> ForceSeries:
    """One specimen in one direction; eq 3.7 is proportional to the permittivity, so the fitted line is the stated one scaled."""
    predicted = np.array([np.nan if r["predicted_n"] is None else r["predicted_n"] for r in part], dtype=float)
    by_point = np.array([np.nan if r["relative_permittivity"] is None else r["relative_permittivity"] for r in part])
    force = np.array([r["force_n"] for r in part], dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        per_unit = force / by_point.astype(float)
    who = f"{short(part[0]['specimen_id'] or '', 12)}, " if several else ""
    return ForceSeries(
        f"{who}direction {part[0]['direction']}",
        np.array([r[axis] for r in part], dtype=float),
        force,
        np.array([r["force_sd_n"] or np.nan for r in part], dtype=float),
        None if np.isnan(predicted).any() else predicted,
        None if permittivity is None or np.isnan(per_unit).any() else permittivity * per_unit,
    )


def _table(draft: Draft, query: Query, found: Sequence[Record]) -> Table:
    rows = tuple(
        Row(
            (
                draft.site.specimen(r["specimen_id"]), str(r["direction"]), significant(r["stretch_1"]), significant(r["stretch_2"]),
                compact(r["voltage_kv"], 2), pm(_milli(r["force_n"]), _milli(r["force_sd_n"])), str(r["repeats"] or ABSENT),
                significant(_milli(r["predicted_n"])), pm(r["relative_permittivity"], r["relative_permittivity_sd"]),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Specimen"), Head("Direction", "n"), Head("Stretch 1", "n"), Head("Stretch 2", "n"), Head("Voltage, kV", "n"),
        Head("Force, mN", "n"), Head("Repeats", "n"), Head("Predicted, mN", "n"), Head("Relative permittivity", "n"),
    )  # fmt: skip
    below = "Relative permittivity: the one that makes eq 3.7 of the thesis meet the measurement."
    return Table("Force by pre-stretch", heads, rows, query.shown(), below=below)


def _milli(value: float | None) -> float | None:
    return None if value is None else 1e3 * value
