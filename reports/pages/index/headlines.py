"""The findings of a night: what several specimens share, limits and points out of control, then specimens, groups, and who behaves as simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from reports import findings
from reports.blocks import (
    Figure,
    Finding,
    Findings,
    Head,
    Next,
    Piece,
    Row,
    Section,
    Table,
    Text,
    bold,
    code,
    flow,
    link,
    listed,
    name,
    separated,
    tag,
)
from reports.evidence import Standing, curve, drawable, measured
from reports.figures.responses import response
from reports.findings import LESS_THAN_NOISE
from reports.names import short
from reports.pages import found, listing
from reports.pages.campaign import lives
from reports.pages.index import control, trouble
from reports.pages.specimen import comparing_models, film
from reports.site import CONTROL, REFUSED, SPECIMENS, Site
from reports.standings import Brief, of_lab
from schemas.explanations import cause
from schemas.mechanisms import RECORD
from schemas.numbers import capital, counted, digits, significant, word
from schemas.visible import quote_path

_WIDE = 2
"""Findings that get a figure; the others are a paragraph."""
_ALARMED, _MOST = 12, 20
"""Specimens with a finding of their own, and findings altogether."""
_LIMITS = 4
"""Films and electrodes beyond their limit with a finding of their own."""
_TO_DO = 2, 12
"""Lines of what to do from which on they are worth a table, and most of them in it that are about specimens."""
_NAMED = 3
"""Files without a mapping, or damaged recordings, that are named."""
_POINTS = 2
"""Points out of control with a finding of their own."""


def section(
    site: Site,
    standings: Sequence[Brief],
    survival: Sequence[tuple[str, lives.Lives]],
    bounds: Sequence[found.Limit] = (),
) -> Section | None:
    """The findings, the first of them what several specimens share, then what bounds the use of films (`bounds`) and what left its limits."""
    alarms = found.by_rank([s for s in standings if s.alarm])
    items: list[Finding] = []
    shared = found.sharing(alarms)
    together = {s.specimen_id for group in shared for s in group}
    alone = [s for s in alarms if s.specimen_id not in together]
    told = (*(group[0] for group in shared), *alone[:_ALARMED])
    full = {s.specimen_id: s for s in of_lab(site.results, [s.specimen_id for s in told])}
    following = {s.specimen_id: findings.what_next(s) for s in full.values()}
    for group in shared:
        first = full[group[0].specimen_id]
        items.append(_shared_finding(site, group, first, following[first.specimen_id], wide=len(items) < _WIDE))
    items += [found.limit_finding(site, limit, "") for limit in bounds[:_LIMITS]]
    items += _out_of_control(site)
    for standing in (full[s.specimen_id] for s in alone[:_ALARMED]):
        wide = len([i for i in items if i.figure]) < _WIDE
        items.append(_specimen_finding(site, standing, following[standing.specimen_id], wide=wide))
    if len(alone) > _ALARMED:
        items.append(
            Finding(
                f"{digits(len(alone) - _ALARMED, 'more specimen needs', 'more specimens need')} a look",
                (flow("They stand first in the ", link("list of specimens", SPECIMENS), "."),),
                "open",
            )
        )
    for campaign, lived in survival:
        text = lives.headline(lived)
        if text and len(items) < _MOST:
            page = link(flow("Campaign ", name(campaign)), site.campaign_path(campaign))
            title = (
                f"{capital(text)}."
                if lives.decisive(lived.comparisons)
                else flow("Campaign ", name(campaign), f": {text}.")
            )
            items.append(Finding(title, tuple(p for p in (lives.support(lived), page) if p), "group"))
    items += _quiet(site, [s for s in standings if not s.alarm])
    to_do = _to_do(site, [*shared, *([s] for s in alone[:_ALARMED])], full, following)
    opening = [block for block in (_verdicts(standings), to_do) if block is not None]
    if not items and not opening:
        return None
    blocks = (*opening, *([Findings(tuple(items))] if items else []))
    return Section("findings", "Findings", "Findings", blocks)


def standing_in_words(standings: Sequence[Brief]) -> str:
    """How the specimens stand, for the headline of the night: each is counted once, and nothing of one is said that was not asked."""
    alarms = sum(s.alarm for s in standings)
    simulated = sum(s.as_simulated for s in standings)
    undiagnosed = len(standings) - alarms - simulated
    if simulated and simulated == len(standings):
        return (
            "one specimen behaves as simulated"
            if simulated == 1
            else f"all {word(simulated)} specimens behave as simulated"
        )
    parts = []
    if alarms:
        parts.append(f"{counted(alarms, 'specimen')} {'needs' if alarms == 1 else 'need'} a look")
    if simulated:
        parts.append(
            f"{counted(simulated, 'specimen') if not parts else word(simulated)} {'behaves' if simulated == 1 else 'behave'} as simulated"
        )
    if undiagnosed:
        who = f"the other {word(undiagnosed)}" if parts else counted(undiagnosed, "specimen")
        parts.append(f"{who} {'is' if undiagnosed == 1 else 'are'} fitted, not diagnosed")
    return "; ".join(parts)


def _verdicts(standings: Sequence[Brief]) -> Text | None:
    """How many specimens were diagnosed, and with which verdict; those that were not, or could not be asked, too."""
    asked = [s for s in standings if s.verdict]
    without = len(standings) - len(asked)
    mute = sum(s.unasked for s in standings)
    if not asked and not mute:
        return None
    parts: list[Piece] = [
        flow(f"{sum(s.verdict == verdict for s in asked)} ", tag(verdict))
        for verdict in ("named", "ambiguous", "unknown", "none")
        if asked
    ]
    if without:
        said = f", {mute} of them could not be asked: their pages say why" if mute else ""
        parts.append(f"{digits(without, 'specimen')} without a diagnosis{said}")
    begin = f"{capital(digits(len(asked), 'specimen'))} diagnosed: " if asked else ""
    return Text(flow(begin, separated(parts), "."), "sub")


def _to_do(
    site: Site,
    groups: Sequence[Sequence[Brief]],
    full: Mapping[str, Standing],
    following: Mapping[str, Next | None],
) -> Table | None:
    """What happened and what to do about it, in one line for specimens with one cause, and for files that were not read, or not to their end.

    Where it would be one line about specimens alone there is no table: their finding says it.

    Parameters
    ----------
    groups : specimens that have one finding together, in the order of the findings
    full : how the first of each stands
    following : what to do about each of those
    """
    rows = []
    for group in groups:
        standing = full[group[0].specimen_id]
        doing = following[standing.specimen_id]
        if doing is not None and standing.diagnosis is not None:
            who = listed([site.specimen(s.specimen_id, "") for s in group])
            d = standing.diagnosis
            what = findings.tell_unnamed(d) if d["verdict"] == "unknown" else cause(d)
            rows.append(Row((who, f"{capital(what)}.", doing.body)))
    unread = [*_unread(site), *_refused(site), *_damaged(site)]
    if len(rows) + 2 * len(unread) < _TO_DO[0]:
        return None
    more = len(rows) - _TO_DO[1]
    heads = (Head("Specimen or file"), Head("What happened", "text"), Head("What to do", "text"))
    note = f"{capital(digits(more, 'further line'))}: with the findings below." if more > 0 else ""
    return Table("In short, what was found and what to do:", heads, (*rows[: _TO_DO[1]], *unread), below=note)


def _unread(site: Site) -> list[Row]:
    """The files that have no mapping and were not read for that, in one line; no line where there are none."""
    paths = trouble.list_unmapped(site)
    if not paths:
        return []
    files = _list_some([code(short(path.rpartition("/")[2], 80)) for path in paths], "file")
    verb, they = ("has", "it was") if len(paths) == 1 else ("have", "they were")
    todo = flow(code(f"dealab add {quote_path(short(paths[0], 300))}"), " makes one and asks for what it cannot tell.")
    if len(paths) > 1:
        todo = flow(todo, " So for each of them.")
    return [Row((files, f"{capital(verb)} no mapping: {they} not read.", todo))]


def _list_some(items: Sequence[Piece], what: str) -> Piece:
    """The first of some files or recordings, and how many others there are."""
    more = len(items) - _NAMED
    return listed([*items[:_NAMED], *([digits(more, f"other {what}")] if more > 0 else [])])


def _refused(site: Site) -> list[Row]:
    """The files that were refused, in one line; no line where there are none."""
    rows = trouble.list_refused(site)
    if not rows:
        return []
    who = _list_some([code(short(r["source_path"].rpartition("/")[2], 80)) for r in rows], "file")
    why, remedy = trouble.reason(rows[0]["problem"])
    if len(rows) == 1 and remedy:
        return [Row((who, flow("Refused: ", why), remedy))]
    them = "it was" if len(rows) == 1 else "they were"
    return [Row((who, f"{capital(them)} refused.", flow("Mend and copy again: ", link("why, and how", REFUSED), ".")))]


def _damaged(site: Site) -> list[Row]:
    """The recordings of which a part could not be read, in one line; no line where there are none."""
    rows = trouble.list_damaged(site)
    if not rows:
        return []
    who = _list_some([site.recording(r["recording_id"], "") for r in rows], "recording")
    one = capital(listing.problem(rows[0]["problem"])).rstrip(".") if len(rows) == 1 else ""
    what = f"{one}{'' if one.endswith('…') else '.'}" if one else "Parts of them could not be read."
    it, is_whole = ("it", "it is") if len(rows) == 1 else ("them", "they are")
    todo = f"What could be read is used. Copy {it} again from the rig if {is_whole} whole there, or exclude {it}."
    return [Row((who, what, todo))]


def _out_of_control(site: Site) -> list[Finding]:
    """The latest points that leave their control limits."""
    points = control.alarms(site)
    more = len(points) - _POINTS
    ending = f"{capital(digits(more, 'further point'))} out of control. " if more > 0 else ""
    shown = points[:_POINTS]
    specimens = sorted({a["point"] for a in shown if a["point_kind"] == "specimen"})
    faulty = {
        s.specimen_id: cause(s.diagnosis)
        for s in of_lab(site.results, specimens)
        if s.diagnosis and s.verdict == "named" and s.diagnosis["stage"] == RECORD
    }
    return [
        Finding(
            control.sentence(a),
            (
                *(
                    [f"Fitted to recordings with a fault: {faulty[a['point']]}. Put that right first."]
                    if a["point"] in faulty
                    else []
                ),
                flow(ending if i == _POINTS - 1 else "", link("Control charts", CONTROL)),
            ),
            "open",
        )
        for i, a in enumerate(shown)
    ]


def _specimen_finding(site: Site, standing: Standing, following: Next | None, *, wide: bool) -> Finding:
    body = [*findings.evidence(standing), link("The specimen's page", site.specimen_path(standing.specimen_id))]
    # Of a fault nothing is to be seen in the recordings without it.
    is_fault = (standing.diagnosis or {}).get("stage") == RECORD
    figure = (_told_figure if standing.verdict else _evidence_figure)(site, standing) if wide and not is_fault else None
    return Finding(
        findings.headline(standing),
        tuple(body),
        findings.kind(standing),
        following,
        figure,
    )


def _shared_finding(
    site: Site, group: Sequence[Brief], first: Standing, following: Next | None, *, wide: bool
) -> Finding:
    """One finding for all specimens with the same cause; sizes and evidence are those of the first."""
    pages = [link(name(s.specimen_id), site.specimen_path(s.specimen_id)) for s in group]
    batch = found.shared_batch(group)
    diagnosis = first.diagnosis or {}
    shared = found.tell_shared(diagnosis.get("stage") or "")
    body = (
        flow(listed(pages), f": {shared}. Of ", name(first.specimen_id), ":"),
        *findings.evidence(first),
    )
    who: Piece = flow(" of batch ", name(batch)) if batch else ""
    title = flow(f"{capital(word(len(group)))} specimens", who, f": {cause(diagnosis)}.")
    figure = _told_figure(site, first) if wide else None
    return Finding(title, body, findings.kind(first), following, figure)


def _told_figure(site: Site, standing: Standing) -> Figure | None:
    """Measured against both models where they part most; none where nothing is to be seen."""
    return comparing_models.foremost(site, standing.specimen_id)


def _evidence_figure(site: Site, standing: Standing) -> Figure | None:
    """The specimen's response and residual, where there is one."""
    responses = measured(site.results, standing.specimen_id, "mechanical")
    lines, fit = responses.film, standing.fit
    if lines is None or fit is None or lines.size < 3 or not drawable(fit):
        return None
    alt = f"Dynamic stiffness of {short(standing.specimen_id, 40)} with the {word(fit['model_order'])}-arm model, residual below."
    curves = [curve(fit, responses, lines, standing.stated)]
    image = response(lines, None, curves, phase=False, alt=alt, alarm=True)
    return Figure(
        image, flow(bold("Response and residual"), " of the fitted model. ", film.misfit_elsewhere(fit, curves))
    )


def _quiet(site: Site, standings: Sequence[Brief]) -> list[Finding]:
    """Specimens without a finding, in one paragraph per kind of evidence."""
    quiet: list[Finding] = []
    diagnosed = [s for s in standings if s.verdict == "none"]
    if diagnosed:
        names = _names(site, diagnosed)
        quiet.append(
            Finding(
                flow(names, ": the simulation is right within the noise."),
                (flow(tag("none"), ". What would have been seen stands on each specimen's page."),), "fine",
            )
        )  # fmt: skip
    judged = [s for s in standings if not s.verdict and s.order is not None]
    unknown = [s for s in judged if s.chi2 is None]
    by_order: dict[int, list[Brief]] = {}
    for s in judged:
        if s.order is not None and s.chi2 is not None:
            by_order.setdefault(s.order, []).append(s)
    for order, group in sorted(by_order.items(), reverse=True):
        chi2 = [s.chi2 for s in group if s.chi2 is not None]
        less = [s for s in group if s.less_than_noise]
        span: Piece = f"Reduced χ² {_span(chi2)}: nothing beyond the noise is left." if chi2 else ""
        if less:
            span = flow(
                f"Reduced χ² {_span(chi2)}. Of ",
                _names(site, less),
                f", {LESS_THAN_NOISE}: their ± are too large, and no test.",
            )
        materials = sorted({s.material for s in group if s.material})
        about = f" ({', '.join(materials[:4])})" if materials else ""
        verb = "describes" if order == 1 else "describe"
        title = flow(
            f"{capital(word(order))} relaxation{'' if order == 1 else 's'} {verb} ", _names(site, group), f"{about}."
        )
        quiet.append(Finding(title, (span,) if span else (), "fine"))
    if unknown:
        title = flow(_names(site, unknown), ": fitted, but whether the misfit is noise is not known.")
        quiet.append(Finding(title, ("Their recordings do not say how large their noise is.",), "group"))
    return quiet


def _span(values: Sequence[float]) -> str:
    low, high = significant(min(values)), significant(max(values))
    return low if low == high else f"{low} to {high}"


def _names(site: Site, standings: Sequence[Brief]) -> Piece:
    shown: list[Piece] = [site.specimen(s.specimen_id, "") for s in standings[:8]]
    if len(standings) > 8:
        shown.append(f"{len(standings) - 8} more")
    return listed(shown)
