"""The part of a diagnosis that tells the most probable cause without a name: its stage, what it depends on, and the function with its band."""

from __future__ import annotations

from reports.blocks import Block, Head, Row, Table
from reports.pages.draft import Draft
from reports.results import Query
from reports.results import Row as Record
from schemas.numbers import capital, percent, significant

_ROWS = 7
"""Places at which the function is told."""
_SQL = """SELECT stage, covariate, covariate_value, covariate_unit, term, lower_95, upper_95
FROM diagnosis_terms
WHERE specimen_id = $specimen
ORDER BY covariate_value"""


def blocks(draft: Draft, d: Record) -> list[Block]:
    """The function of the verdict `unknown`; nothing with any other verdict.

    Parameters
    ----------
    draft : the specimen's page
    d : its row of `diagnoses`
    """
    query = Query(_SQL, {"specimen": draft.item})
    found = draft.results.rows(query) if d["verdict"] == "unknown" else []
    if not found:
        return []
    first = found[0]
    covariate = str(first["covariate"]).replace("_", " ")
    told = [found[round(i * (len(found) - 1) / (_ROWS - 1))] for i in range(_ROWS)] if len(found) > _ROWS else found
    unit = "" if first["covariate_unit"] in ("", "1") else f", {first['covariate_unit']}"
    heads = (Head(f"{capital(covariate)}{unit}", "n"), Head("Relative change", "n"), Head("95 % interval", "n"))
    rows = tuple(
        Row((significant(r["covariate_value"]), percent(r["term"]), f"{percent(r['lower_95'])} to {percent(r['upper_95'])}"))
        for r in told
    )  # fmt: skip
    title = f"Without a name: what the stage “{first['stage']}” does over {covariate}"
    note = "the most probable function of no listed cause"
    return [Table(title, heads, rows, query.shown(), note)]
