"""Long lists in parts: all recordings, all specimens, all refused files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from reports.blocks import Block, Fold, Head, Link, Page, Pages, Row, Section, Table, Text, code, name
from reports.ledger import batches
from reports.names import short
from reports.pages import listing
from reports.pages.index.trouble import refused_table
from reports.pages.specimens import specimen_table
from reports.results import Query, day, literal
from reports.site import RECORDINGS, REFUSED, SPECIMENS, USED_SQL, Site
from schemas.numbers import ABSENT, capital, counted, digits, seconds, whole

PART = 200
"""Rows on one page."""
_LEAPS = 40
"""Most links from the first page of a list to its other parts."""


@dataclass(frozen=True)
class Part:
    """A page of a long list.

    `begin` and `end` count the rows in an order in which new ones mostly come last, so that a full part stays as it is
    and is not made again for a new row elsewhere. `number` is 0 for the page that the list begins with, whose address
    has no number; `before` and `after` are the neighbours in that order.
    """

    list: str
    number: int
    begin: int
    end: int
    before: int | None = None
    after: int | None = None

    @property
    def address(self) -> str:
        return _address(self.list, self.number)

    @property
    def label(self) -> str:
        return f"{self.begin + 1}–{self.end}"


def from_the_first(first: str, count: int) -> list[Part]:
    """Parts of a list that begins with its first rows."""
    begins = range(0, max(count, 1), PART)
    numbers = [0, *range(2, len(begins) + 1)]
    return [
        Part(first, number, begin, min(count, begin + PART), before, after)
        for number, begin, before, after in zip(
            numbers, begins, [None, *numbers[:-1]], [*numbers[1:], None], strict=True
        )
    ]


def from_the_last(first: str, count: int) -> list[Part]:
    """Parts of a list that begins with its last rows, at least a full part of them; the others are counted from the first."""
    full = max(0, count // PART - 1)
    head = Part(first, 0, full * PART, count, full or None, None)
    others = [
        Part(first, n, (n - 1) * PART, n * PART, n - 1 or None, n + 1 if n < full else 0) for n in range(1, full + 1)
    ]
    return [head, *others]


def _address(first: str, number: int) -> str:
    return first if number == 0 else first.replace(".html", f"-{number}.html")


def _pager(part: Part, parts: Sequence[Part]) -> list[Block | Fold]:
    """From the first page to parts all over the list, from the others to it and to the neighbours."""
    if len(parts) == 1:
        return []
    if part.number == 0:
        shown = parts if len(parts) <= _LEAPS else [parts[i * (len(parts) - 1) // (_LEAPS - 1)] for i in range(_LEAPS)]
        ordered = sorted(shown, key=lambda one: one.begin)
        return [Pages(tuple(Link(one.label, "" if one is part else one.address) for one in ordered))]
    near = ((part.before, "Before these"), (part.after, "After these"))
    around = (Link(word, _address(part.list, number)) for number, word in near if number)
    return [Pages((Link("Begin of the list", part.list), *around, Link(part.label, "")))]


def _page(
    site: Site, part: Part, parts: Sequence[Part], title: str, blocks: list[Block | Fold], heading: str = ""
) -> Page:
    """A part of a list; `heading` says what the whole list shows."""
    which = "" if len(parts) == 1 else f", {part.begin + 1} to {part.end}"
    section = Section("list", f"Numbers{which[1:]}" if which else "All of them", title, (*_pager(part, parts), *blocks))
    return Page(
        title=f"{title}{which}",
        heading=heading or title,
        bar=site.bar("", "Refused files" if part.list == REFUSED else part.list),
        crumbs=(Link("Last night", "index.html"), Link(title)),
        sections=(section,),
    )


_ORDER = "started_at NULLS LAST, recording_id, source_path"


def parts(site: Site, first: str) -> list[Part]:
    """The parts of a list, which is told by the address that it begins with; none of a list that there is not."""
    if first == SPECIMENS:
        return from_the_first(first, site.specimens) if site.specimens else []
    if first == REFUSED:
        count = _number(site, "WHERE status = 'quarantined'")
        return from_the_first(first, count) if count else []
    return from_the_last(first, _number(site)) if site.recordings else []


def _number(site: Site, where: str = "") -> int:
    return int(site.results.rows(f"SELECT count(*) AS n FROM recordings {where}")[0]["n"])


def page(site: Site, first: str, number: int) -> Page:
    """The part of that number of a list."""
    make = {RECORDINGS: recordings, SPECIMENS: specimens, REFUSED: refused}[first]
    known = parts(site, first)
    return make(site, next(part for part in known if part.number == number), known)


def recordings_digests(site: Site) -> Iterator[tuple[Part, str]]:
    """Parts of the list of recordings, each with a digest of its rows."""
    known = parts(site, RECORDINGS)
    digests = site.results.rows(
        f"SELECT part, sum(row) AS rows FROM (\n"
        f"    SELECT least((row_number() OVER (ORDER BY {_ORDER}) - 1) // {PART}, {len(known) - 1}) AS part, row\n"
        "    FROM (\n"
        "        SELECT started_at, recording_id, source_path, hash(r, coalesce(specimen_id IN (\n"
        f"            SELECT specimen_id FROM recordings WHERE {USED_SQL} AND kind IS DISTINCT FROM 'lifetimes'\n"
        "        ), false)) AS row\n"
        "        FROM recordings AS r\n"
        "    )\n"
        ") GROUP BY part"
    )
    rows = {d["part"]: d["rows"] for d in digests}
    for part in known:
        if part.number:
            yield part, f"{rows.get(part.number - 1)} {part.after}"
        else:
            yield part, f"{rows.get(len(known) - 1)} {_states(site, part.end)}"


def recordings(site: Site, part: Part, parts: Sequence[Part]) -> Page:
    """Every file that was found as a recording, whatever became of it; the latest first."""
    limit = f"LIMIT {part.end - part.begin} " if part.number else ""
    query = Query(
        "SELECT * FROM (\n"
        "    SELECT recording_id, specimen_id, protocol, loading, started_at, duration_s, status, problem, notes, source_path\n"
        f"    FROM recordings ORDER BY {_ORDER} {limit}OFFSET {part.begin}\n"
        ") ORDER BY started_at DESC NULLS FIRST, recording_id, source_path"
    )
    found = site.results.rows(query)
    rows = tuple(
        Row(
            (
                site.recording(r["recording_id"], "") if r["status"] in ("ok", "damaged", "excluded") else name(r["recording_id"] or r["source_path"], 60),
                site.specimen(r["specimen_id"], ""), code(r["protocol"] or ABSENT), day(r["started_at"]), seconds(r["duration_s"]),
                listing.status(r), listing.problem(r["problem"], 160) or listing.problem(r["notes"], 100),
            )
        )
        for r in found
    )  # fmt: skip
    heads = (
        Head("Recording"), Head("Specimen"), Head("Protocol", "word"), Head("Measured", "word"), Head("Duration", "n"), Head("Status"),
        Head("What is wrong or worth knowing", "text"),
    )  # fmt: skip
    table = Table("Recordings, the latest first", heads, rows, query.shown())
    if part.number:
        return _page(site, part, parts, "Recordings", [table])
    return _page(site, part, parts, digits(part.end, "recording"), [table], _states(site, part.end))


_STATES = {
    "ok": "whole", "damaged": "damaged", "quarantined": "refused", "excluded": "taken out", "duplicate": "duplicate",
    "pending": "pending",
}  # fmt: skip


def _states(site: Site, count: int) -> str:
    """`186 recordings: 182 whole, 1 damaged, 2 refused, 1 duplicate`."""
    found = site.results.rows("SELECT status, count(*) AS files FROM recordings GROUP BY status ORDER BY status")
    files = {r["status"]: r["files"] for r in found}
    states = ", ".join(f"{whole(files[status])} {words}" for status, words in _STATES.items() if files.get(status))
    return f"{digits(count, 'recording')}: {states}"


def refused_digests(site: Site) -> Iterator[tuple[Part, str]]:
    """Parts of the list of refused files, and a digest of all their rows and of which of them are new."""
    rows = site.results.rows(
        "SELECT sum(hash(r)) AS rows, sum(hash(r)) FILTER (WHERE run_id = (SELECT max(run_id) FROM runs)) AS new\n"
        "FROM recordings AS r WHERE status = 'quarantined'"
    )[0]
    return ((part, str(rows)) for part in parts(site, REFUSED))


def refused(site: Site, part: Part, parts: Sequence[Part]) -> Page:
    """Every refused file with its reason."""
    table = refused_table(site, PART, part.begin, note="kept in quarantine; nothing of them is in the results")
    title = capital(counted(parts[-1].end, "refused file"))
    return _page(site, part, parts, title, [table], f"{title}: nothing of them is in the results")


def specimens_digests(site: Site) -> Iterator[tuple[Part, str]]:
    """Parts of the list of specimens, and the digests of theirs, which the ledger has."""
    members = batches(
        site.ledger.each(
            "SELECT s.specimen_id, d.digest FROM specimens AS s"
            " LEFT JOIN digests AS d ON d.kind = 'specimen' AND d.item = s.specimen_id ORDER BY s.specimen_id"
        ),
        PART,
    )
    for part, some in zip(parts(site, SPECIMENS), members, strict=True):
        yield part, f"{site.specimens if part.number == 0 else 0} {part.after} {some}"


def specimens(site: Site, part: Part, parts: Sequence[Part]) -> Page:
    """Every specimen; those with a model or a diagnosis in numbers, the others by their recordings."""
    blocks: list[Block | Fold] = []
    begin, end = (
        str(name)
        for at in (part.begin, part.end - 1)
        for (name,) in site.ledger.each(
            "SELECT specimen_id FROM specimens ORDER BY specimen_id LIMIT 1 OFFSET ?", (at,)
        )
    )
    these = f"specimen_id BETWEEN {literal(begin)} AND {literal(end)}"
    table = specimen_table(site, "", these, "", "Models and verdicts", limit=PART)
    if table.rows:
        blocks.append(table)
    query = Query(
        "SELECT r.specimen_id, any_value(r.campaign ORDER BY r.campaign) AS campaign, any_value(r.material ORDER BY r.material) AS material,\n"
        "       count(*) AS recordings, string_agg(DISTINCT r.protocol, ', ' ORDER BY r.protocol) AS protocols,\n"
        "       count(*) FILTER (WHERE r.status = 'damaged') AS damaged\nFROM recordings AS r\n"
        "WHERE r.status IN ('ok', 'damaged', 'excluded') AND r.kind IS DISTINCT FROM 'lifetimes' AND r.recording_id IS NOT NULL\n"
        f"  AND r.specimen_id IS NOT NULL\nGROUP BY r.specimen_id\nORDER BY r.specimen_id\nLIMIT {PART} OFFSET {part.begin}"
    )
    rows = tuple(
        Row(
            (
                site.specimen(r["specimen_id"], ""), site.campaign(r["campaign"], ""), short(r["material"] or ABSENT, 40), str(r["recordings"]),
                short(r["protocols"] or ABSENT, 80), str(r["damaged"] or ABSENT),
            )
        )
        for r in site.results.rows(query)
    )  # fmt: skip
    heads = (
        Head("Specimen"),
        Head("Campaign"),
        Head("Material"),
        Head("Recordings", "n"),
        Head("Protocols"),
        Head("Damaged", "n"),
    )
    blocks.append(Table("All specimens", heads, rows, query.shown()))
    if not rows:
        blocks = [Text("No specimen has a usable recording.", "sub")]
    title = digits(site.specimens, "specimen") if part.number == 0 else "Specimens"
    return _page(site, part, parts, title, blocks)
