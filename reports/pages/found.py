"""What was found of specimens, in the order in which a laboratory would act on it: for the index and for campaigns.

First what several specimens share (the rig), then what bounds the use of a film, then each specimen by itself. How one
stands is decided in `reports.evidence`, its words in `reports.findings`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

from reports.blocks import Finding, flow, link, name
from reports.results import Query, Results
from reports.results import Row as Record
from reports.site import Site
from schemas.mechanisms import FILM
from schemas.numbers import bounds, counted, counted_bounds, percent, with_unit

SHARED = 3
"""Specimens with the same cause from which on they have one finding together."""
_RANK = {"named": 0, "ambiguous": 1, "unknown": 2}


class Judged(Protocol):
    """A specimen with its verdict."""

    @property
    def specimen_id(self) -> str: ...
    @property
    def verdict(self) -> str: ...
    @property
    def mechanisms(self) -> tuple[str, ...]: ...
    @property
    def batch(self) -> str: ...


One = TypeVar("One", bound=Judged)


def by_rank(alarms: Sequence[One]) -> list[One]:
    """Named causes first, then those that cannot be told apart, then what has no name, then what is only misfit."""
    return sorted(alarms, key=lambda s: (_RANK.get(s.verdict, 3), s.specimen_id))


def sharing(alarms: Sequence[One]) -> list[list[One]]:
    """Specimens in which the same causes are named, where there are several, or two of one batch: what they share is rig or material."""
    groups: dict[tuple[str, ...], list[One]] = {}
    for standing in alarms:
        if standing.verdict == "named":
            groups.setdefault(standing.mechanisms, []).append(standing)
    return [group for group in groups.values() if len(group) >= SHARED or (len(group) > 1 and shared_batch(group))]


def shared_batch(group: Sequence[Judged]) -> str:
    """The batch of which all of them are; empty where they are of several, or of none that is known."""
    batches = {one.batch for one in group}
    return next(iter(batches)) if len(batches) == 1 else ""


@dataclass(frozen=True)
class Limit:
    """Something that bounds the use of a specimen: what happens from where on, what else is known, its place on the page, and the cause that a
    diagnosis names for it."""

    specimen_id: str
    words: str
    detail: str
    anchor: str
    mechanism: str


_WRINKLING_SQL = """SELECT specimen_id, wrinkling_onset_kv, wrinkling_onset_kv_lower, wrinkling_onset_kv_upper
FROM sensing_fits
WHERE wrinkling_onset_kv IS NOT NULL AND {where}
ORDER BY specimen_id"""
_MIGRATION_SQL = """SELECT m.specimen_id, m.onset_cycle, m.onset_cycle_lower, m.onset_cycle_upper, m.distortion_before,
       m.distortion_after, m.cycles
FROM electrode_migrations AS m JOIN recordings AS r USING (recording_id)
WHERE m.onset_cycle IS NOT NULL AND r.status IN ('ok', 'damaged') AND m.{where}
ORDER BY m.specimen_id, m.onset_cycle"""


def limits(results: Results, campaign: str | None = None, *, specimen: str | None = None) -> list[Limit]:
    """What bounds the use of specimens, of one, of a campaign's or of all: films that wrinkle, electrodes that migrate."""
    where = "specimen_id IS NOT NULL"
    parameters = {}
    if specimen is not None:
        where, parameters = "specimen_id = $item", {"item": specimen}
    elif campaign is not None:
        where, parameters = (
            "specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $item)",
            {"item": campaign},
        )
    wrinkled, migrated = (
        specimen is None or results.has(table, "specimen_id", specimen)
        for table in ("sensing_fits", "electrode_migrations")
    )
    found = [
        Limit(
            r["specimen_id"],
            f"the film wrinkles from {with_unit(_onset(r, 'wrinkling_onset_kv'), 'kV')} on",
            "Above it force and capacitance no longer follow V²; those steps are left out of the fits.",
            "steps",
            "wrinkling",
        )
        for r in (results.rows(Query(_WRINKLING_SQL.format(where=where), parameters)) if wrinkled else ())
    ]
    seen: set[str] = set()
    for r in results.rows(Query(_MIGRATION_SQL.format(where=where), parameters)) if migrated else ():
        if r["specimen_id"] not in seen:
            seen.add(r["specimen_id"])
            found.append(
                Limit(r["specimen_id"], f"the electrode migrates from cycle {_onset(r, 'onset_cycle', counted_bounds)} on", _distortion(r), "migration", "electrode_degradation")
            )  # fmt: skip
    return found


def _onset(row: Record, column: str, write: Callable[..., str] = bounds) -> str:
    return write(*(row[f"{column}{end}"] for end in ("", "_lower", "_upper")))


def _distortion(row: Record) -> str:
    if row["distortion_before"] is None or row["distortion_after"] is None:
        return ""
    before, after = percent(row["distortion_before"]), percent(row["distortion_after"])
    return (
        f"Harmonics of the capacitance rise from {before} of the fundamental to {after} after {row['cycles']} cycles."
    )


def limit_finding(site: Site, limit: Limit, root: str) -> Finding:
    """A limit as a finding, with the way to where it is shown."""
    page = link("Where it is shown", f"{root}{site.specimen_path(limit.specimen_id)}#{limit.anchor}")
    title = flow("Specimen ", name(limit.specimen_id), f": {limit.words}")
    return Finding(title, (*((limit.detail,) if limit.detail else ()), page), "open")


def leave_out_named(found: Sequence[Limit], standings: Sequence[Judged]) -> list[Limit]:
    """The limits whose cause no diagnosis names for that specimen: what one names is told by it."""
    named = {(s.specimen_id, m) for s in standings if s.verdict == "named" for m in s.mechanisms}
    return [limit for limit in found if (limit.specimen_id, limit.mechanism) not in named]


def tell_shared(stage: str) -> str:
    """Where a cause is rather that several specimens have, by the stage at which it acts."""
    where = "the material than in one film" if stage == FILM else "the rig than in the film"
    return f"one cause in all of them, so rather in {where}"


def in_words(found: Sequence[Limit]) -> str:
    """`one film wrinkles, one electrode migrates`, for a headline; empty without any."""
    parts = []
    for start, thing, verb in (("the film", "film", "wrinkle"), ("the electrode", "electrode", "migrate")):
        count = sum(one.words.startswith(start) for one in found)
        if count:
            parts.append(f"{counted(count, thing)} {verb}{'s' if count == 1 else ''}")
    return ", ".join(parts)
