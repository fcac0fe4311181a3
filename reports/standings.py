"""How the specimens of a campaign or of the whole lab stand; of the lab's, few are in memory at a time.

Does not belong here: how one stands (`reports.evidence`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from reports.evidence import Standing, choice, extended, less_than_noise, told, unasked
from reports.ledger import batches
from reports.names import short
from reports.owners import find_owners
from reports.results import Query, Results, Row, literal
from reports.site import flat_metadata, stated_rig
from schemas.places import SIGN

_JUDGED = (
    "status IN ('ok', 'damaged') AND kind IS DISTINCT FROM 'lifetimes'"
    " AND specimen_id IN (SELECT specimen_id FROM model_fits UNION ALL SELECT specimen_id FROM diagnoses"
    " UNION ALL SELECT specimen_id FROM discrepancies)"
)
"""Recordings of specimens with a model, a diagnosis or something negative."""
_TELL_SIGN = {"sign_flipped", "channels_swapped"}
"""Faults that say themselves why something is negative that no film has."""
_AT_ONCE = 100
"""Specimens in memory at a time: a fit has many columns."""


@dataclass(frozen=True, slots=True)
class Brief:
    """What the index needs of every specimen with a model or a diagnosis, in little memory."""

    specimen_id: str
    alarm: bool
    verdict: str
    mechanisms: tuple[str, ...]
    unasked: bool
    order: int | None
    """Arms of the fit; None where only a diagnosis is there."""
    chi2: float | None
    less_than_noise: bool
    """The fit leaves less than the errors that it reckoned with."""
    material: str
    batch: str = ""

    @property
    def as_simulated(self) -> bool:
        """A diagnosis was made and found nothing; a fit alone simulates no recording."""
        return self.verdict == "none" and not self.alarm


def of_campaign(results: Results, campaign: str, recordings: Sequence[Row]) -> list[Standing]:
    """The specimens of some recordings of a campaign, by name."""
    where = Query(
        "specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $campaign)", {"campaign": campaign}
    )
    return _of(results, recordings, where)


def of_lab(results: Results, specimens: Sequence[str]) -> list[Standing]:
    """Those of the named specimens that have a model or a diagnosis, by name."""
    return _among(results, f"specimen_id IN ({', '.join(map(literal, specimens))})") if specimens else []


def briefs(results: Results) -> list[Brief]:
    """All specimens with a model or a diagnosis, by name."""
    return [_brief(s) for s in _every(results)]


def _every(results: Results) -> Iterator[Standing]:
    names = results.each(
        f"SELECT DISTINCT specimen_id FROM recordings WHERE {_JUDGED} AND specimen_id <> '' ORDER BY specimen_id"
    )
    for some in batches(names, _AT_ONCE):
        first, last = (literal(row["specimen_id"]) for row in (some[0], some[-1]))
        yield from _among(results, f"specimen_id BETWEEN {first} AND {last}")


def _among(results: Results, where: str) -> list[Standing]:
    recordings = results.rows(
        f"SELECT specimen_id, material, configuration, loading, metadata FROM recordings WHERE {_JUDGED} AND {where}"
        " ORDER BY started_at, recording_id"
    )
    return [s for s in _of(results, recordings, Query(where)) if s.fit or s.diagnosis or s.negative]


def _of(results: Results, recordings: Sequence[Row], where: Query) -> list[Standing]:
    """The specimens of some recordings with their fits and diagnoses, `where` they are."""
    theirs: dict[str, list[Row]] = {}
    for r in recordings:
        if r["specimen_id"]:
            theirs.setdefault(r["specimen_id"], []).append(r)
    fits: dict[str, list[Row]] = {}
    selected = f"SELECT * FROM model_fits WHERE (selected OR extension <> '') AND {where.sql} ORDER BY specimen_id, loading, method"
    for fit in results.rows(Query(selected, where.parameters)):
        fits.setdefault(fit["specimen_id"], []).append(fit)
    made = results.rows(Query(f"SELECT * FROM diagnoses WHERE {where.sql} ORDER BY specimen_id", where.parameters))
    diagnoses = {d["specimen_id"]: d for d in made}
    negative, tapped, owners = find_negative(results, where), find_tapped(results, where), find_owners(results, where)
    return [
        stand(
            specimen,
            records,
            fits.get(specimen, []),
            diagnoses.get(specimen),
            negative=negative.get(specimen, ""),
            taps=specimen in tapped,
            owner=owners.get(specimen, ""),
        )
        for specimen, records in sorted(theirs.items())
    ]


def stand(
    specimen: str,
    recordings: Sequence[Row],
    fits: Sequence[Row],
    diagnosis: Row | None,
    *,
    negative: str,
    taps: bool,
    owner: str,
) -> Standing:
    """How a specimen stands.

    Parameters
    ----------
    specimen : its name
    recordings : of it, in their order
    fits : rows of `model_fits` of it
    diagnosis : its row of `diagnoses`, if it has one
    negative : what came out negative that no film has; a diagnosis that names why says it better
    taps : whether taps of the clamp are among what its diagnosis rests on
    owner : whose its foreign recordings may be
    """
    last = recordings[-1] if recordings else None
    fit = choice(fits)
    diagnosed = told(diagnosis)
    if diagnosed and diagnosed["verdict"] == "named" and _TELL_SIGN & {*(diagnosed["mechanisms"] or ())}:
        negative = ""
    return Standing(
        specimen,
        last["material"] if last else None,
        last["configuration"] if last else None,
        fit,
        diagnosed,
        stated_rig(recordings),
        unasked(diagnosis),
        batch=_batch(last) if last else "",
        taps=taps,
        owner=owner,
        extension=extended(fits, fit) if fit else None,
        negative=negative,
    )


def _batch(recording: Row) -> str:
    """The batch that a recording's metadata name."""
    return str(flat_metadata(recording["metadata"]).get("batch") or "")


def find_tapped(results: Results, where: Query) -> set[str]:
    """Specimens, of those `where` they are, among whose diagnosed recordings are taps of the clamp."""
    query = f"SELECT DISTINCT specimen_id FROM diagnosis_blocks WHERE starts_with(kind, 'tap.') AND {where.sql}"
    return {r["specimen_id"] for r in results.rows(Query(query, where.parameters))}


def find_negative(results: Results, where: Query) -> dict[str, str]:
    """By specimen, of those `where` they are, what came out negative in their recordings, the clearest only."""
    rows = results.rows(
        Query(
            "SELECT specimen_id, arg_max(statement, chi2) AS statement FROM discrepancies"
            f" WHERE where_found = '{SIGN}' AND {where.sql} GROUP BY specimen_id",
            where.parameters,
        )
    )
    return {r["specimen_id"]: r["statement"] for r in rows if r["specimen_id"]}


def _brief(standing: Standing) -> Brief:
    fit, diagnosis = standing.fit, standing.diagnosis
    return Brief(
        standing.specimen_id,
        standing.alarm,
        standing.verdict,
        tuple(diagnosis["mechanisms"] or ()) if diagnosis else (),
        bool(standing.unasked),
        None if fit is None else fit["model_order"],
        None if fit is None else fit["reduced_chi2"],
        fit is not None and less_than_noise(fit),
        short(standing.material, 30) if standing.material else "",
        standing.batch,
    )
