"""Measured against simulated, a figure per kind of features: first where the cause explains most, then where most is missed."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

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
_SEEN, _CHANCE = 4.0, 3.0
"""Fall of χ² by the extension, and χ² beyond the noise in its own standard deviations, from which on there is something to see."""
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


Key = tuple[str, str]
"""Recording and block."""
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
    """A figure per kind of features; kinds that are simulated within the noise have none.

    A finding is shown where its cause explains most: the figure in which the cause takes most off χ² goes before all others, however
    much more is missed elsewhere. The others follow by what is missed.
    """
    by_kind: dict[str, dict[Key, list[Record]]] = {}
    for r in results.rows(Query(_CURVE_SQL, {"specimen": specimen})):
        by_kind.setdefault(r["kind"], {}).setdefault((r["recording_id"], r["block"]), []).append(r)
    chosen = sorted((_choose(kind, blocks) for kind, blocks in by_kind.items()), key=lambda c: (-c.missed, c.kind))
    first = max(chosen, key=lambda c: c.gain, default=None)
    chosen.sort(key=lambda c: c is not first)
    shown = 0
    for one in chosen:
        if one.is_worth_another if shown else one.shows_something:
            figure = _comparison(one, keep)
            if figure is not None:
                shown += 1
                yield figure


@dataclass(frozen=True)
class _Chosen:
    """What of a kind is drawn.

    Parameters
    ----------
    kind : of the features
    rows : values of one block, or of all small blocks together
    where : what they are of; `together` where there are several
    missed : χ² of all blocks beyond the noise under the plain model, with what the extension takes off it
    """

    kind: str
    rows: Sequence[Record]
    where: str
    together: bool
    missed: float

    @property
    def gain(self) -> float:
        """What the cause takes off χ² of that which is drawn."""
        return _rank(self.rows)[0]

    @property
    def shows_something(self) -> bool:
        """Whether what is drawn shows what the cause explains, or more than noise does by chance."""
        gain, missed = _rank(self.rows)
        return gain > _SEEN or missed > _CHANCE * (2 * len(self.rows)) ** 0.5

    @property
    def is_worth_another(self) -> bool:
        """Whether it is worth a figure beside another."""
        return self.shows_something and _rank(self.rows)[1] > _WORTH * len(self.rows)


def _choose(kind: str, blocks: Mapping[Key, list[Record]]) -> _Chosen:
    """Of a kind, the block in which the cause explains most; all of its small ones together."""
    ranks = {key: _rank(rows) for key, rows in blocks.items()}
    missed = sum(one for _, one in ranks.values())
    first = min(blocks, key=lambda key: (-ranks[key][0], -ranks[key][1], key))
    rows = blocks[first]
    if len(rows) >= _SMALL:
        return _Chosen(kind, rows, f"{short(first[0], 40)}, {visible(first[1])}", False, missed)
    # Harmonics of different order stand in one block: those of one order share their place in it.
    half, is_complex = len(rows) // 2, bool(rows[0]["component"])
    every = [r for block in blocks.values() for r in block]
    place = max((r["position"] for r in every), key=lambda p: _rank([r for r in every if r["position"] == p]))
    rows = [r for r in every if r["position"] == place or (is_complex and r["position"] % half == place % half)]
    return _Chosen(kind, rows, "All recordings", True, missed)


def _rank(rows: Sequence[Record]) -> tuple[float, float]:
    """What the cause takes off χ², and the χ² of the plain model beyond the noise with that."""
    plain = _chi2(rows, "plain")
    gain = 0.0 if any(r["extended"] is None for r in rows) else max(plain - _chi2(rows, "extended"), 0.0)
    return gain, max(plain - len(rows), 0.0) + gain


def _chi2(rows: Sequence[Record], model: str) -> float:
    return float(sum(((r["measured"] - r[model]) / r["sd"]) ** 2 for r in rows if r[model] is not None and r["sd"]))


def _comparison(chosen: _Chosen, keep: Keep) -> Figure | None:
    """The figure of what was chosen of a kind."""
    kind, rows = chosen.kind, chosen.rows
    data = compared(kind, rows, together=chosen.together)
    if data is None or data.x.size < 2:
        return None
    words = f"{significant(data.rms(data.plain), 2)} times the noise with the plain model"
    left = ""
    if data.extended is not None:
        after = data.rms(data.extended)
        words += f", {significant(after, 2)} with the extended one"
        if after > _LEFT:
            share = 1 - (after / data.rms(data.plain)) ** 2
            explained = percent(share) if share > _EXPLAINED else "nothing"
            left = f" The cause explains {explained} of it; what is left is more than noise, which would be 1."
    if data.turned:
        words = f"mostly in phase, {words}"
    about = kind_of(kind).words
    address = keep(f"diagnosis_{kind.replace('.', '_')}", {n: [r[n] for r in rows] for n in rows[0]})
    return Figure(
        comparison(data, alt=f"{capital(about)}, {chosen.where}: residual {words}."),
        flow(bold(f"{capital(about)}."), f" {chosen.where}. Residual {words}.{left}"),
        address,
    )
