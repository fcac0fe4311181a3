"""A campaign's page: what it found, survival, force, its specimens beside the literature, what was refused."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set

import numpy as np
from markupsafe import Markup

from reports import words
from reports.blocks import (
    Block,
    Figure,
    Finding,
    Findings,
    Fold,
    Head,
    Link,
    Many,
    Page,
    Piece,
    Row,
    Section,
    Table,
    Text,
    code,
    flow,
    link,
    listed,
    name,
    separated,
    tag,
)
from reports.evidence import Standing, curve, drawable, measured
from reports.figures.responses import Multiple, find_jump, multiple
from reports.figures.scale import Scale, logarithmic
from reports.findings import causes_named, headline, kind, what_is_wrong
from reports.names import short
from reports.pages import found, listing, requirement
from reports.pages.campaign import (
    comparing,
    conflicts,
    constraint,
    depends,
    laws,
    literature,
    lives,
    places,
    plans,
)
from reports.pages.draft import Draft
from reports.pages.specimen import force
from reports.pages.specimens import specimen_table
from reports.results import Query, days
from reports.results import Row as Record
from reports.site import Site
from reports.standings import of_campaign
from schemas.mechanisms import model_name, plain_name
from schemas.numbers import capital, compact, counted, digits, joined, percent, significant, with_unit, word

MOST = 24
"""Small multiples on one page."""
_MOST_BLOCKS = 24
"""Figures, tables and paragraphs of a campaign's page from which on what is about single questions has pages of its own."""


def page(site: Site, campaign: str) -> Page:
    """The page of one campaign."""
    draft = Draft(site, "campaign", campaign)
    recordings = site.results.rows(
        Query(
            "SELECT recording_id, specimen_id, material, configuration, protocol, loading, started_at, duration_s, status, problem,\n"
            "       notes, source_path, source_sha256, metadata, run_id, kind\nFROM recordings\nWHERE campaign = $campaign\n"
            "ORDER BY started_at, recording_id, source_path",
            {"campaign": campaign},
        )
    )
    lived = lives.load(draft)
    used = [r for r in recordings if r["status"] in ("ok", "damaged")]
    standings = of_campaign(site.results, campaign, used)
    fitted = [s for s in standings if s.fit is not None or s.diagnosis is not None]
    begin = _there(_findings(draft, fitted), lives.survival(draft, lived), lives.groups(draft, lived))
    failures = _there(
        depends.section(draft, lived.unit),
        laws.voltage_life(draft, lived.unit),
        plans.section(draft, lived.unit),
        places.failures(draft, lived),
    )
    of_films = _there(_specimens(draft, fitted))
    among = "specimen_id IN (SELECT specimen_id FROM recordings WHERE campaign = $item)"
    forces = _there(
        force.section(draft, among, campaign),
        comparing.forces(draft),
        comparing.self_sensing(draft),
        constraint.section(draft),
        requirement.of_campaign(draft),
    )
    checks = _there(*literature.sections(draft, fitted, recordings), conflicts.section(draft))
    ends = [_recordings(draft, recordings, lived)]
    parts = {"checks": checks}
    if sum(len(s.blocks) for s in (*begin, *failures, *of_films, *forces, *ends)) > _MOST_BLOCKS:
        parts = {"failures": failures, "forces": forces, **parts}
        failures = forces = []
    parts = {part: apart for part, apart in parts.items() if apart}
    sections = [*begin, *failures, *of_films, *forces, *_further(draft, parts), *ends]
    run_id = _last_run(site, recordings)
    heading, lede = _finding(draft, lived, fitted, recordings)
    return Page(
        title=f"Campaign {short(campaign, 40)}",
        heading=heading,
        bar=site.bar("../", f"Campaign {short(campaign, 24)}"),
        when=site.when(run_id),
        crumbs=(Link("Last night", "../index.html"), Link("Campaign")),
        lede=lede,
        sub=_sub(campaign, recordings, lived),
        sections=tuple(sections),
        provenance=(*site.provenance(run_id), listing.files(recordings[:500], f"{capital(digits(len(recordings), 'file'))} with SHA-256")),
        files=draft.files,
        further=tuple((site.part_path(campaign, part), _part(draft, part, apart, run_id)) for part, apart in parts.items()),
    )  # fmt: skip


def _there(*sections: Section | None) -> list[Section]:
    return [s for s in sections if s is not None]


_TOLD = 8
"""Findings of single specimens on a campaign's page; the others are counted and stand in its table."""


def _findings(draft: Draft, fitted: Sequence[Standing]) -> Section | None:
    """What a laboratory would act on, first: shared causes, limits of films, specimens by themselves."""
    site = draft.site
    alarms = found.by_rank([s for s in fitted if s.alarm])
    items: list[Finding] = []
    groups = found.sharing(alarms)
    for group in groups:
        who = listed([site.specimen(s.specimen_id) for s in group])
        body = flow(who, f": {found.tell_shared((group[0].diagnosis or {}).get('stage') or '')}.")
        items.append(
            Finding(f"{capital(counted(len(group), 'specimen'))}: {what_is_wrong(group[0])}", (body,), "named")
        )
    bounds = found.leave_out_named(found.limits(draft.results, draft.item), alarms)
    items += [found.limit_finding(site, one, "../") for one in bounds]
    together = {s.specimen_id for group in groups for s in group}
    alone = [s for s in alarms if s.specimen_id not in together]
    for standing in alone[:_TOLD]:
        page = link("The specimen's page", f"../{site.specimen_path(standing.specimen_id)}")
        items.append(Finding(headline(standing), (page,), kind(standing)))
    if len(alone) > _TOLD:
        more = flow("They stand first in the ", link("table of specimens", "#specimens"), ".")
        items.append(Finding(f"{digits(len(alone) - _TOLD, 'more specimen')} to look at", (more,), "open"))
    return Section("findings", "What to act on", "Findings", (Findings(tuple(items)),)) if items else None


_PART_WORDS = {
    "failures": ("why films fail, and where", "Failures", "What lives depend on, and where on the film they end."),
    "forces": (
        "force and sensing",
        "Force and sensing",
        "What the films give, what they sense, and what is asked of them.",
    ),
    "checks": (
        "against what was published",
        "Checks",
        "Our models beside the published ones, and what in the publication does not follow from its own numbers.",
    ),
}
"""What a part is about, its short name, and the words below its heading."""


def _further(draft: Draft, parts: Mapping[str, Sequence[Section]]) -> list[Section]:
    """The way to what stands on pages of its own, by what is found there."""
    rows = tuple(
        Row((link(s.link, f"../{draft.site.part_path(draft.item, part)}#{s.id}"), s.heading, _PART_WORDS[part][1]))
        for part, sections in parts.items()
        for s in sections
    )
    if not rows:
        return []
    table = Table("Parts and what they find", (Head("Part"), Head("Finding", "text"), Head("Page")), rows)
    return [Section("further", "On pages of their own", "Further pages", (table,))]


def _part(draft: Draft, part: str, sections: Sequence[Section], run_id: str | None) -> Page:
    """A part of the campaign on a page of its own."""
    site, campaign = draft.site, draft.item
    about, called, lede = _PART_WORDS[part]
    return Page(
        title=f"Campaign {short(campaign, 40)}: {about}",
        heading=flow("Campaign ", name(campaign), f" {about}" if part == "checks" else f": {about}"),
        bar=site.bar("../", f"Campaign {short(campaign, 24)}: {called[:1].lower()}{called[1:]}"),
        when=site.when(run_id),
        crumbs=(
            Link("Last night", "../index.html"),
            Link(f"Campaign {short(campaign, 40)}", f"../{site.campaign_path(campaign)}"),
            Link(called),
        ),
        lede=lede,
        sections=tuple(sections),
        provenance=site.provenance(run_id),
    )


def _finding(
    draft: Draft, lived: lives.Lives, fitted: Sequence[Standing], recordings: Sequence[Record]
) -> tuple[Piece, Piece]:
    text = lives.headline(lived)
    if text:
        law = laws.headline(draft)
        return flow(capital(text), f"; {law[:1].lower()}{law[1:]}" if law else ""), lives.support(lived)
    who = flow("Campaign ", name(draft.item))
    if fitted:
        alarms = [s for s in fitted if s.alarm]
        if alarms:
            return flow(who, f": {word(len(alarms))} of {word(len(fitted))} specimens need a look"), causes_named(
                fitted
            )
        verb = "is" if len(fitted) == 1 else "are"
        return flow(
            who, f": {word(len(fitted))} specimen{'s' if len(fitted) != 1 else ''} {verb} described within the noise"
        ), _orders(fitted)
    return flow(who, f": {digits(len(recordings), 'recording')}, no model fitted"), ""


def _orders(fitted: Sequence[Standing]) -> str:
    by_order: dict[int, list[str]] = {}
    for s in fitted:
        if s.fit is not None:
            by_order.setdefault(s.fit["model_order"], []).append(short(s.specimen_id, 20))
    return (
        "; ".join(
            f"{model_name(order)} model: {joined(names if len(names) <= 8 else [*names[:7], f'{len(names) - 7} more'])}"
            for order, names in sorted(by_order.items())
        )
        + "."
    )


def _sub(campaign: str, recordings: Sequence[Record], lived: lives.Lives) -> Piece:
    used = [r for r in recordings if r["status"] in ("ok", "damaged", "excluded")]
    times = [r["started_at"] for r in used if r["started_at"]]
    parts: list[Piece] = [flow("Campaign ", name(campaign)), digits(len(used), "recording")]
    refused = sum(r["status"] == "quarantined" for r in recordings)
    damaged = sum(r["status"] == "damaged" for r in recordings)
    if damaged:
        parts.append(tag("damaged", f"{damaged} damaged, used in part"))
    if refused:
        parts.append(tag("refused", f"{refused} refused, not in these numbers"))
    if lived.lifetimes:
        alive = sum(not r["failed"] for r in lived.lifetimes)
        parts.append(f"{digits(len(lived.lifetimes), 'lifetime')}, {alive} alive at the end (censored)")
    if times:
        parts.append(days(min(times), max(times)))
    return separated(parts)


_SHARED = 1e7
"""Ratio of frequencies up to which small multiples share their axes; beyond, each would be a dot on them."""


def shared_scales(items: Sequence[Multiple]) -> tuple[Scale, Scale]:
    """The axes that all small multiples of a page share."""
    frequencies = [i.lines.frequency[i.lines.usable] for i in items]
    values = [np.abs(i.lines.value[i.lines.usable]) for i in items]
    return logarithmic(*frequencies, margin=0.04), logarithmic(*values, margin=0.1)


def multiples(
    site: Site, standings: Sequence[Standing], root: str, most: int = MOST
) -> tuple[tuple[Figure, ...], bool]:
    """Small responses of specimens, those with a finding first, and whether they share their axes."""
    return _draw_multiples(site, _find_multiples(site, standings, most), root)


def _find_multiples(site: Site, standings: Sequence[Standing], most: int) -> list[tuple[Standing, Multiple]]:
    """Specimens with a frequency response to draw, those with a finding first."""
    items: list[tuple[Standing, Multiple]] = []
    for standing in sorted(standings, key=lambda s: (not s.alarm, s.specimen_id))[: 2 * most]:
        responses = measured(site.results, standing.specimen_id, "mechanical")
        lines = responses.film
        if lines is None or lines.usable.sum() < 2 or len(items) >= most:
            continue
        drawn = (
            curve(standing.fit, responses, lines, standing.stated, points=60)
            if standing.fit is not None and drawable(standing.fit)
            else None
        )
        items.append((standing, Multiple(standing.specimen_id, lines, drawn, standing.alarm)))
    return items


def _draw_multiples(
    site: Site, items: Sequence[tuple[Standing, Multiple]], root: str
) -> tuple[tuple[Figure, ...], bool]:
    if not items:
        return (), True
    x, y = shared_scales([m for _, m in items])
    shared = x.high / x.low < _SHARED
    axes = [(x, y) if shared else shared_scales([m]) for _, m in items]
    return tuple(_multiple(site, s, m, *a, root) for (s, m), a in zip(items, axes, strict=True)), shared


def _multiple(site: Site, standing: Standing, item: Multiple, x: Scale, y: Scale, root: str) -> Figure:
    stiff = np.abs(item.lines.value[item.lines.usable])
    noise = ""
    if item.curve is not None:
        left = item.curve.times_noise
        times = f"{significant(left, 2)} times the noise, " if left is not None else "what is "
        noise = f"; the model leaves {times}{'beyond' if standing.alarm else 'within'} chance"
    alt = f"{short(standing.specimen_id, 40)}: dynamic stiffness {significant(stiff[0], 2)} to {significant(stiff[-1], 2)} N/mm{noise}."
    verdict: Piece = (
        tag(standing.verdict) if standing.verdict else (tag("damaged", "beyond noise") if standing.alarm else "")
    )
    material = short(" ".join(p for p in (standing.material, standing.configuration) if p), 44)
    second = material
    if standing.verdict == "named" and standing.diagnosis:
        second = ", ".join(plain_name(m) for m in standing.diagnosis["mechanisms"] or [])
    jump = find_jump(item.lines, item.curve.at_lines) if item.curve is not None else None
    if jump is not None:
        second = f"jump of {percent(jump[1] - 1)} at {with_unit(compact(jump[0], 2), 'Hz')}"
    caption = flow(site.specimen(standing.specimen_id, root), " ", verdict, Markup("<br>"), second)
    return Figure(multiple(item, x, y, alt=alt), caption, above=True)


def _specimens(draft: Draft, fitted: Sequence[Standing]) -> Section | None:
    if not fitted:
        return None
    blocks: list[Block | Fold] = []
    items = _find_multiples(draft.site, fitted, MOST)
    if items:
        blocks.append(Many(_draw_multiples(draft.site, items, "../")[0]))
        blocks += _tell_undrawn(fitted, {s.specimen_id for s, _ in items})
    blocks.append(specimen_table(draft.site, "../", "r.campaign = $item", draft.item, "Specimens of the campaign"))
    alarms = sum(s.alarm for s in fitted)
    heading = f"{count_models(fitted)}, {f'{word(alarms)} to look at' if alarms else 'all within the noise'}"
    return Section("specimens", heading, "Specimens", tuple(blocks))


def count_models(standings: Sequence[Standing]) -> str:
    """`Seven specimens, six with a model`: a diagnosis needs none."""
    everyone, fitted = len(standings), sum(s.fit is not None for s in standings)
    text = f"{capital(word(everyone))} specimen{'s' if everyone != 1 else ''}"
    if fitted == everyone:
        return f"{text} with a model"
    return f"{text}, {word(fitted) if fitted else 'none'} with a model"


def _tell_undrawn(fitted: Sequence[Standing], drawn: Set[str]) -> list[Text]:
    """Which specimens of the list have no small response above it."""
    left = [s.specimen_id for s in fitted if s.specimen_id not in drawn]
    if not left:
        return []
    if len(fitted) > MOST:
        return [Text(f"Drawn: {len(drawn)} of {len(fitted)}, those with a finding first.")]
    return [
        Text(
            f"Not drawn, for want of two usable lines of a frequency response: {joined([short(s, 40) for s in left])}."
        )
    ]


_PROTOCOL_SQL = """SELECT protocol, loading, kind, count(*) FILTER (WHERE status IN ('ok', 'damaged')) AS used,
       count(*) FILTER (WHERE status = 'damaged') AS damaged, count(*) FILTER (WHERE status = 'quarantined') AS refused,
       count(*) FILTER (WHERE status = 'excluded') AS excluded, count(DISTINCT specimen_id) AS specimens
FROM recordings
WHERE campaign = $campaign
GROUP BY protocol, loading, kind
ORDER BY protocol, loading, kind"""


def _protocol(row: Record) -> Piece:
    """What kind of test it is, with the protocol's own name, which files and lists of recordings have."""
    if row["protocol"]:
        return flow(capital(words.protocol(row["protocol"], row["loading"])), " ", code(row["protocol"]))
    return f"table: {str(row['kind'] or 'unknown').replace('_', ' ')}"


def _recordings(draft: Draft, recordings: Sequence[Record], lived: lives.Lives) -> Section:
    query = Query(_PROTOCOL_SQL, {"campaign": draft.item})
    rows = tuple(
        Row(
            (
                _protocol(r),
                *(str(r[c]) for c in ("specimens", "used", "damaged", "refused", "excluded")),
            )
        )
        for r in draft.results.rows(query)
    )
    heads = (Head("Protocol"), *(Head(t, "n") for t in ("Specimens", "Used", "of them damaged", "Refused", "Excluded")))
    blocks: list[Block | Fold] = [Table("Recordings by protocol", heads, rows, query.shown(), kind="narrow")]
    bad = [r for r in recordings if r["status"] in ("damaged", "quarantined", "excluded")]
    if bad:
        select = Query(
            "SELECT recording_id, protocol, started_at, duration_s, status, problem, notes\nFROM recordings\n"
            "WHERE campaign = $campaign AND status IN ('damaged', 'quarantined', 'excluded')\nORDER BY started_at, recording_id, source_path",
            {"campaign": draft.item},
        )
        blocks.append(
            listing.recordings(
                draft.site, bad[:100], select, "Refused, damaged or excluded", note=f"{len(bad)} of {len(recordings)}"
            )
        )
    table = lives.table(draft, lived)
    if table is not None:
        blocks.append(table)
    return Section("recordings", digits(len(recordings), "recording"), "Recordings", tuple(blocks))


def _last_run(site: Site, recordings: Sequence[Record]) -> str | None:
    order = {r["run_id"]: i for i, r in enumerate(site.runs)}
    runs = [r["run_id"] for r in recordings if r["run_id"]]
    return max(runs, key=lambda r: order.get(r, -1), default=None)
