"""The part of a specimen's page about its permittivity: from harmonic sequences beside the static one."""

from __future__ import annotations

from reports.blocks import Head, Row, Section, Table
from reports.names import visible
from reports.pages.draft import Draft
from reports.results import Query
from schemas.numbers import ABSENT, bounds, compact, significant

_SQL = """SELECT method, voltage_kv, force_per_voltage_squared_n_per_kv2, relative_permittivity, relative_permittivity_lower,
       relative_permittivity_upper, stated_permittivity, "values"
FROM permittivities
WHERE specimen_id = $specimen
ORDER BY method, voltage_kv NULLS FIRST"""
_METHODS = {"sphs": "harmonic sequences", "static": "steps"}


def section(draft: Draft) -> Section | None:
    """Permittivity by each method with its interval; None where no force gives one."""
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    rows = tuple(
        Row(
            (
                _METHODS.get(r["method"], visible(r["method"] or "")),
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
        " that is active where passive film lies in series. Sequences: blocked force, the film's own dynamics and the rig taken"
        " out, with the errors of their constants. Steps: drop of tension once the film has relaxed, scatter of the steps (Student's"
        " t). Sizes and calibrations are taken as exact: an error of them moves all rows alike."
    )
    first = found[0]
    value = bounds(*(first[f"relative_permittivity{end}"] for end in ("", "_lower", "_upper")))
    static = next((r for r in found if r["method"] == "static"), None)
    heading = f"Relative permittivity {value}"
    if static is not None and first["method"] != "static":
        heading += f"; static {bounds(*(static[f'relative_permittivity{end}'] for end in ('', '_lower', '_upper')))}"
    table = Table("Permittivity from forces under voltage", heads, rows, query.shown(), below=below, kind="narrow")
    return Section("permittivity", heading, "Permittivity", (table,))
