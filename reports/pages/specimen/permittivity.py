"""The part of a specimen's page about its permittivity: from harmonic sequences beside the static one."""

from __future__ import annotations

from collections.abc import Sequence

from reports.blocks import Head, Row, Section, Table
from reports.names import visible
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import ABSENT, NBSP, bounds, compact, joined, significant

_SQL = """SELECT method, voltage_kv, force_per_voltage_squared_n_per_kv2, relative_permittivity, relative_permittivity_lower,
       relative_permittivity_upper, stated_permittivity, "values"
FROM permittivities
WHERE specimen_id = $specimen
ORDER BY method, voltage_kv NULLS FIRST"""
_METHODS = {"sphs": "harmonic sequences", "static": "steps"}
_POOLED = "harmonic sequences, one fit"
"""The row of all sequences: no mean of those of single voltages, but of another model."""


def section(draft: Draft) -> Section | None:
    """Permittivity by each method with its interval; None where no force gives one."""
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                _POOLED if _is_pooled(r) else _METHODS.get(r["method"], visible(r["method"] or "")),
                "all" if r["voltage_kv"] is None else compact(r["voltage_kv"], 2),
                significant(1e3 * r["force_per_voltage_squared_n_per_kv2"]),
                bounds(*(r[f"relative_permittivity{end}"] for end in ("", "_lower", "_upper"))),
                ABSENT if r["stated_permittivity"] is None else compact(r["stated_permittivity"]),
                str(r["values"]),
            ),
            "sel" if i == 0 else "",
        )
        for i, r in enumerate(found)
    )
    heads = (
        Head("From"), Head("Voltage, kV", "n"), Head("Force over V², mN/kV²", "n"), Head("Relative permittivity (95 %)", "n"),
        Head("In the metadata", "n"), Head("Lines or steps", "n"),
    )  # fmt: skip
    below = (
        "Force over V² = ε₀ εᵣ w/z with the stretched width and thickness (thesis, eq 4.7 and 4.8), times the share of the length"
        " that is active where passive film lies in series. One fit: a model of film and rig fitted to all sequences together, clamp and"
        " load cell free within the ± of the rig's file; it is no mean of the rows below it. Those of one voltage: blocked force, the"
        " film of the mechanical model and the rig of its file taken out, with the errors of their constants. Steps: drop of tension once the film has relaxed, scatter of the steps (Student's"
        " t). Sizes and calibrations are taken as exact: an error of them moves all rows alike."
        f"{_tell_apart(found)}"
    )
    first = found[0]
    value = bounds(*(first[f"relative_permittivity{end}"] for end in ("", "_lower", "_upper")))
    static = next((r for r in found if r["method"] == "static"), None)
    heading = f"Relative permittivity {value}"
    if static is not None and first["method"] != "static":
        heading += f"; static {bounds(*(static[f'relative_permittivity{end}'] for end in ('', '_lower', '_upper')))}"
    table = Table("Permittivity from forces under voltage", heads, rows, query.shown(), below=below, kind="narrow")
    return Section("permittivity", heading, "Permittivity", (table,))


def _is_pooled(row: Record) -> bool:
    return bool(row["method"] == "sphs" and row["voltage_kv"] is None)


def _tell_apart(found: Sequence[Record]) -> str:
    """What it means that single voltages are beyond the limits of the fit to all of them; empty where they are not."""
    pooled = next((r for r in found if _is_pooled(r)), None)
    if pooled is None:
        return ""
    apart = [
        f"{compact(r['voltage_kv'], 2)}{NBSP}kV"
        for r in found
        if r["method"] == "sphs" and r["voltage_kv"] is not None and not _overlap(r, pooled)
    ]
    if not apart:
        return ""
    verb = "is" if len(apart) == 1 else "are"
    return (
        f" At {joined(apart)} the permittivity {verb} not that of the one fit within their limits: the rig's file or the film of the"
        " mechanical model is not what the sequences show."
    )


def _overlap(a: Record, b: Record) -> bool:
    low, high = (f"relative_permittivity_{end}" for end in ("lower", "upper"))
    return None in (a[low], a[high], b[low], b[high]) or bool(a[low] <= b[high] and b[low] <= a[high])
