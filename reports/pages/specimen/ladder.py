"""The part of a specimen's page about wide bands: what each number of arms reaches."""

from __future__ import annotations

import numpy as np

from reports.blocks import Figure, Head, Row, Section, Table, bold, filled, flow
from reports.figures.relaxation import error_by_arms
from reports.names import short
from reports.pages.draft import Draft
from reports.results import Query
from schemas.numbers import NBSP, p_value, percent, significant

_SQL = """SELECT model_order, resolved_arms, relative_error, r_squared_storage, r_squared_loss, r_squared_relaxation, order_p_value
FROM order_ladders
WHERE specimen_id = $specimen
ORDER BY model_order"""
_LEVEL = 0.01
"""Level at which one more arm counts as needed."""


def section(draft: Draft) -> Section | None:
    """Error against the number of arms, and the least that is enough."""
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query)
    if not found:
        return None
    enough = next((r["model_order"] for r in found if (r["order_p_value"] or 0.0) >= _LEVEL), None)
    rows = tuple(
        Row(
            (
                f"{r['model_order']}{' ✓' if r['model_order'] == enough else ''}",
                percent(r["relative_error"]),
                *(_explained(r[f"r_squared_{part}"]) for part in ("storage", "loss", "relaxation")),
                p_value(r["order_p_value"]),
            ),
            "sel" if r["model_order"] == enough else "",
        )
        for r in found
    )
    heads = (
        Head("Arms"), Head("Relative error", "n"), Head("R², storage", "n"), Head("R², loss", "n"), Head("R², relaxation", "n"),
        Head("p, next not needed", "n"),
    )  # fmt: skip
    kept, shown = filled(heads, rows)
    below = (
        "Relative error: root mean square of |model/measured − 1| over all lines and times, which is what the fit weighs; R² counts"
        f" large values only. ✓: from here on one more arm is no significant gain at 1{NBSP}%."
    )
    table = Table("What each number of arms reaches", kept, shown, query.shown(), below=below, kind="narrow")
    arms = np.array([r["model_order"] for r in found], dtype=float)
    error = np.array([r["relative_error"] for r in found], dtype=float)
    first, last = (f"{percent(float(e))} with {int(n)}" for n, e in ((arms[0], error[0]), (arms[-1], error[-1])))
    figure = Figure(
        error_by_arms(
            arms, error, enough, alt=f"Relative error of {short(draft.item, 40)} against the number of arms: {first}, {last}."
        ),
        flow(bold("Error against arms."), f" {first}, {last}."),
        draft.data("ladder", {"arms": arms, "relative_error": error}),
    )  # fmt: skip
    heading = f"{enough} arms are enough over this band" if enough else f"Not even {int(arms[-1])} arms reach the noise"
    return Section("ladder", heading, "Arms over the band", (figure, table))


def _explained(value: float | None) -> str:
    """R²; close to 1 by what it lacks."""
    if value is None:
        return ""
    return f"{value:.7f}".rstrip("0") if value > 0.9999 else significant(value, 4)
