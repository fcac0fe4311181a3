"""Specimens with their models and verdicts as a table, as a campaign's page, the first page and the list of all show them."""

from __future__ import annotations

from collections.abc import Sequence

from reports.blocks import Head, Piece, Row, Table, tag
from reports.names import short
from reports.results import Query
from reports.site import Site
from schemas.mechanisms import plain_name
from schemas.numbers import ABSENT, NBSP, UNRESOLVED, gained, is_usable, pm, significant

_SPECIMEN_SQL = """WITH used AS (
    SELECT specimen_id, min(material) AS material, count(*) AS recordings
    FROM recordings AS r
    WHERE status IN ('ok', 'damaged') AND kind IS DISTINCT FROM 'lifetimes' AND {where}
    GROUP BY specimen_id
), fit AS (
    SELECT *, row_number() OVER (
        PARTITION BY specimen_id
        ORDER BY loading <> 'mechanical', loading <> 'joint', method <> 'forward') AS preference
    FROM model_fits WHERE selected AND coalesce(extension, '') = ''
)
SELECT used.specimen_id, used.material, used.recordings, fit.model_order, fit.k0_n_per_mm, fit.k0_n_per_mm_sd,
       fit.modulus_mpa, fit.reduced_chi2, d.verdict, d.mechanisms, d.gain, d.gain_lower
FROM used
LEFT JOIN fit ON fit.specimen_id = used.specimen_id AND fit.preference = 1
LEFT JOIN diagnoses AS d ON d.specimen_id = used.specimen_id
WHERE fit.specimen_id IS NOT NULL OR d.specimen_id IS NOT NULL
ORDER BY d.verdict IS NULL OR d.verdict = 'none', used.specimen_id
LIMIT {limit} OFFSET {offset}"""


def specimen_table(
    site: Site, root: str, where: str, value: str, caption: str, *, limit: int = 200, offset: int = 0
) -> Table:
    """Specimens with a model or a diagnosis, findings first."""
    query = Query(
        _SPECIMEN_SQL.format(where=where, limit=limit, offset=offset), {"item": value} if "$item" in where else {}
    )
    rows = []
    specimens = site.results.rows(query)
    diagnosed = any(r["verdict"] for r in specimens)
    for r in specimens:
        modulus_sd = None
        if r["modulus_mpa"] and r["k0_n_per_mm"] and r["k0_n_per_mm_sd"]:
            modulus_sd = r["modulus_mpa"] * r["k0_n_per_mm_sd"] / r["k0_n_per_mm"]
        cells: list[Piece] = [
            site.specimen(r["specimen_id"], root), short(r["material"] or ABSENT, 40), str(r["recordings"]),
            ABSENT if r["model_order"] is None else str(r["model_order"]),
            _known(r["k0_n_per_mm"], r["k0_n_per_mm_sd"], r["verdict"]), _known(r["modulus_mpa"], modulus_sd, r["verdict"]),
            significant(r["reduced_chi2"]),
        ]  # fmt: skip
        if diagnosed:
            cells += [
                tag(r["verdict"]) if r["verdict"] else "not diagnosed",
                _causes(r["mechanisms"] or [], r["verdict"]),
                gained(r["gain"], r["gain_lower"]),
            ]
        rows.append(Row(tuple(cells)))
    heads = [
        Head("Specimen"), Head("Material"), Head("Recordings", "n"), Head("Order", "n"), Head("k₀, N/mm", "n"),
        Head("Modulus, MPa", "n"), Head("Red. χ²", "n"),
    ]  # fmt: skip
    if diagnosed:
        heads += [Head("Verdict"), Head("Cause"), Head("Gain", "n")]
    below = "± is one standard deviation."
    if any(r["verdict"] not in _SOUND and is_usable(r["k0_n_per_mm_sd"]) for r in specimens):
        below += (
            f" {_PLAIN} Of the plain model, in which the diagnosis finds something wrong: the ± knows nothing of that. With a named"
            " cause in the model the film stands on the specimen's page."
        )
    if diagnosed:
        below += " Gain: share of the squared held-out error beyond the noise that the extension removes."
    return Table(caption, tuple(heads), tuple(rows), query.shown(), below=below)


_SOUND = (None, "none")
"""Verdicts that find nothing wrong with the plain model."""
_PLAIN = "†"
"""Marks a number of a plain model that a diagnosis finds wanting."""


def _known(value: float | None, sd: float | None, verdict: str | None) -> str:
    """Value ± SD; a word for what the recordings do not resolve, such as a parameter at its bound; marked where the model is not right."""
    if value is None or not is_usable(sd):
        return ABSENT if value is None else UNRESOLVED
    return pm(value, sd) if verdict in _SOUND else f"{pm(value, sd)}{NBSP}{_PLAIN}"


def _causes(mechanisms: Sequence[str], verdict: str | None) -> str:
    """The most probable explanation in words; where others are as good, that there are others."""
    if not mechanisms:
        return ABSENT
    first, *more = (plain_name(m) for m in mechanisms)
    text = " + ".join([first, *(f"{m[:1].lower()}{m[1:]}" for m in more)])
    return f"{text}, or others" if verdict == "ambiguous" else text
