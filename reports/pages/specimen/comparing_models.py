"""Measured against simulated: the kinds of features in which the plain and the extended model differ most, a figure each."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping

from reports.blocks import Block, Figure, Heading, Pair, bold, flow
from reports.csvfile import Column
from reports.features import compared, kind_of
from reports.figures.comparison import comparison
from reports.names import short, visible
from reports.pages.draft import Draft
from reports.results import Query, Results
from reports.results import Row as Record
from reports.site import Site
from schemas.numbers import capital, percent, significant

_TELLING = 4
"""Kinds of features that get a figure."""
_WORTH = 0.5
"""χ² per value, beyond the noise and taken off by the extension together, from which a second figure is worth its place."""
_LEFT = 1.5
"""Residual of the extended model from which on it is said that something is left, SD."""
_EXPLAINED = 0.01
"""Share of the misfit below which nothing of it is explained."""
_SMALL = 12
"""Blocks with fewer values are drawn together, block by block in the order of the session."""

_CURVE_SQL = """SELECT recording_id, kind, block, position, component, frequency_hz, amplitude, voltage_kv, cycle, time_s,
       measured, plain, extended, sd
FROM diagnosis_curves AS c
WHERE specimen_id = $specimen
ORDER BY (SELECT min(started_at) FROM recordings AS r WHERE r.recording_id = c.recording_id), recording_id, kind,
         min(time_s) OVER (PARTITION BY recording_id, kind, block), block, position"""


Key = tuple[str, str, str]
Keep = Callable[[str, Mapping[str, Column]], str]
"""Name and columns of a figure's data → the address of their file."""


def blocks(draft: Draft, d: Record) -> list[Block]:
    """Measured against simulated where both models differ most, or where the plain one errs most."""
    if d["verdict"] == "none":
        return []
    pictures = list(itertools.islice(_figures(draft.results, draft.item, draft.data), _TELLING))
    if not pictures:
        return []
    pairs = [tuple(pictures[i : i + 2]) for i in range(0, len(pictures), 2)]
    return [Heading("Measured against simulated"), *(Pair(p) if len(p) > 1 else p[0] for p in pairs)]


def foremost(site: Site, specimen: str) -> Figure | None:
    """The most telling of these figures, for the index; its data are those of the specimen's page."""
    return next(_figures(site.results, specimen, lambda name, _: site.data_path("specimen", specimen, name)), None)


def _figures(results: Results, specimen: str, keep: Keep) -> Iterator[Figure]:
    """A figure per kind of features, the most telling first; kinds that are simulated within the noise have none."""
    by_block: dict[Key, list[Record]] = {}
    for r in results.rows(Query(_CURVE_SQL, {"specimen": specimen})):
        by_block.setdefault((r["kind"], r["recording_id"], r["block"]), []).append(r)
    by_kind: dict[str, list[tuple[float, Key]]] = {}
    for key, rows in by_block.items():
        by_kind.setdefault(key[0], []).append((_telling(rows), key))
    ranked = sorted(by_kind.items(), key=lambda item: (-sum(score for score, _ in item[1]), item[0]))
    for place, (kind, scored) in enumerate(ranked):
        most = max(score / len(by_block[key]) for score, key in scored)
        if most > (_WORTH if place else 0.0):
            figure = _comparison(kind, sorted(scored, key=lambda s: (-s[0], s[1])), by_block, keep)
            if figure is not None:
                yield figure


def _telling(rows: list[Record]) -> float:
    """χ² of the plain model beyond the noise, and what the extension takes off it."""

    def chi2(name: str) -> float:
        terms = (((r["measured"] - r[name]) / r["sd"]) ** 2 for r in rows if r[name] is not None and r["sd"])
        return float(sum(terms))

    plain = chi2("plain")
    extended = plain if any(r["extended"] is None for r in rows) else chi2("extended")
    return max(plain - len(rows), 0.0) + max(plain - extended, 0.0)


def _comparison(
    kind: str, scored: list[tuple[float, Key]], blocks: Mapping[Key, list[Record]], keep: Keep
) -> Figure | None:
    """One figure for a kind: its most telling block, or all of its small ones together."""
    first = scored[0][1]
    small = len(blocks[first]) < _SMALL
    keys = [key for key in blocks if key[0] == kind] if small else [first]
    rows = [r for key in keys for r in blocks[key]]
    if small:  # harmonics of different order stand in one block: those of one order share their place in it
        place = max((r["position"] for r in rows), key=lambda p: _telling([r for r in rows if r["position"] == p]))
        half = len(blocks[first]) // 2
        is_complex = bool(blocks[first][0]["component"])
        rows = [r for r in rows if r["position"] == place or (is_complex and r["position"] % half == place % half)]
    data = compared(kind, rows, together=small)
    if data is None or data.x.size < 2:
        return None
    where = "All recordings" if small else f"{short(first[1], 40)}, {visible(first[2])}"
    words = f"{significant(data.rms(data.plain), 2)} times the noise with the plain model"
    left = ""
    if data.extended is not None:
        after = data.rms(data.extended)
        words += f", {significant(after, 2)} with the extended one"
        if after > _LEFT:
            share = 1 - (after / data.rms(data.plain)) ** 2
            explained = percent(share) if share > _EXPLAINED else "nothing"
            left = f" The cause explains {explained} of it; what is left is still no noise (1)."
    if data.turned:
        words = f"mostly in phase, {words}"
    about = kind_of(kind).words
    address = keep(f"diagnosis_{kind.replace('.', '_')}", {n: [r[n] for r in rows] for n in rows[0]})
    return Figure(
        comparison(data, alt=f"{capital(about)}, {where}: residual {words}."),
        flow(bold(f"{capital(about)}."), f" {where}. Residual {words}.{left}"),
        address,
    )
