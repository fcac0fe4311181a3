"""The morning after a night: what was found out, what came in, what was refused and what to do about it."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from reports.blocks import (
    Block,
    Count,
    Fold,
    Many,
    Page,
    Piece,
    Section,
    Tally,
    Text,
    code,
    flow,
    link,
    separated,
)  # fmt: skip
from reports.names import short, visible
from reports.pages import found
from reports.pages.campaign import lives
from reports.pages.campaign import page as campaign
from reports.pages.draft import Draft
from reports.pages.index import arrived, changes, headlines, trouble
from reports.pages.specimens import specimen_table
from reports.results import Query, moment
from reports.results import Row as Record
from reports.site import INDEX, SPECIMENS, Site
from reports.standings import Brief, briefs, of_lab
from schemas.numbers import NBSP, capital, counted, digits, joined, seconds, whole, word

_SPECIMENS_SHOWN, _MULTIPLES = 60, 24


def page(site: Site) -> Page:
    """The index."""
    standings = briefs(site.results)
    survival = [
        (c, lives.load(_campaign_draft(site, c), single=False)) for c in site.campaigns[: arrived.CAMPAIGNS_SHOWN]
    ]
    counts = _counts(site)
    bounds = found.leave_out_named(found.limits(site.results), standings)
    run = site.last_run
    sections = [
        s
        for s in (
            headlines.section(site, standings, survival, bounds),
            _specimens(site, standings),
            arrived.section(site),
            changes.section(site),
            trouble.section(site),
            arrived.campaigns(site),
        )
        if s is not None
    ]
    return Page(
        title=_night(run) if run else "No run yet",
        heading=headline(standings, survival, counts, trouble.count_without_result(site), found.in_words(bounds)),
        bar=site.bar("", INDEX),
        when=_night(run) if run else "",
        sub=_sub(run),
        opening=(Tally(tally(run, counts)),),
        sections=tuple(sections),
        provenance=(
            *site.provenance(run["run_id"] if run else None),
            *_run_numbers(run),
            Text(
                flow(
                    "Made from ",
                    code("results.duckdb"),
                    " alone: ",
                    code("dealab report"),
                    " gives the same bytes again.",
                ),
                "sub",
            ),
        ),
        provenance_heading="This run",
    )


def _campaign_draft(site: Site, item: str) -> Draft:
    return Draft(site, "campaign", item, root="")


def _night(run: Record) -> str:
    """`Night of 20 to 21 November 2026`, or the moment of a run by day."""
    start = run["started_at"]
    if start is None:
        return f"Run {short(run['run_id'] or '', 40)}"
    return f"Run of {moment(start)}"


_COUNTS = Query(
    "SELECT status, run_id IS NOT DISTINCT FROM (SELECT max(run_id) FROM runs) AS tonight, count(*) AS files\n"
    "FROM recordings\nGROUP BY ALL"
)


def _counts(site: Site) -> dict[tuple[str, bool], int]:
    """Files by status, those of the last run apart."""
    return {(r["status"] or "", bool(r["tonight"])): r["files"] for r in site.results.rows(_COUNTS)}


def tally(run: Record | None, counts: dict[tuple[str, bool], int]) -> tuple[Count, ...]:
    """What came of the files that the last run found; nothing is left out because it is 0.

    Refused and damaged are those that stand, new or known: the exit status and what the night printed count them too.
    """

    def tonight(status: str) -> int:
        return counts.get((status, True), 0)

    def of_run(column: str, status: str) -> int:
        value = run.get(column) if run is not None else None
        return int(value) if value is not None else tonight(status)

    came_in = [
        (tonight("ok"), "came in, whole", ""),
        (of_run("damaged", "damaged"), "▲ damaged, used in part", "damaged"),
        (of_run("quarantined", "quarantined"), "✕ refused", "refused"),
    ]
    # With other code or other constants of a rig, what is known is made again.
    known = of_run("ingested", "ok") - tonight("ok") - tonight("damaged")
    entries = [
        *came_in,
        (of_run("duplicates", "duplicate"), "duplicate", ""),
        (of_run("reused", ""), "unchanged, reused", ""),
        *([(known, "known, made again", "")] if known > 0 else []),
        (of_run("pending", "pending"), "pending", ""),
        (of_run("unmapped", ""), "without a mapping", ""),
    ]
    if run is not None and run["failed"]:
        entries.append((run["failed"], "✕ failed", "refused"))
    if run is not None and run.get("without_result"):
        entries.append((run["without_result"], "▲ without a result", "damaged"))
    return tuple(Count(whole(n), text, kind if n else "") for n, text, kind in entries)


def headline(
    standings: Sequence[Brief],
    survival: Sequence[tuple[str, lives.Lives]],
    counts: dict[tuple[str, bool], int],
    silent: int = 0,
    bounds: str = "",
) -> str:
    """The finding of the night: specimens to look at first, then lifetimes, then what came in.

    Parameters
    ----------
    standings : of the specimens
    survival : of the campaigns
    counts : files by status, those of the last run apart
    silent : recordings and tables that were taken in and led to no result
    bounds : what bounds the use of films, in words
    """
    total = sum(counts.values())
    also = f"; {counted(silent, 'recording')} led to no result" if silent else ""
    clear = next((lives.headline(x) for _, x in survival if _clear(x)), "")
    if standings:
        rest = f"; {clear}" if clear and not any(s.alarm for s in standings) else also
        if bounds:
            rest = f"; {bounds}{rest}"
        return capital(f"{headlines.standing_in_words(standings)}{rest}")
    if clear:
        return capital(clear)
    if not total:
        return "No recordings yet"
    refused = sum(n for (status, _), n in counts.items() if status == "quarantined")
    if refused == total:
        files = "the one file was" if total == 1 else f"all {word(total)} files were"
        return f"Nothing could be used: {files} refused"
    usable = sum(n for (status, _), n in counts.items() if status in ("ok", "damaged"))
    if silent == usable:
        return capital(
            f"no result: {'the one recording' if usable == 1 else f'all {word(usable)} recordings'} led to none"
        )
    came = f"{counted(usable, 'recording')}, no model fitted yet"
    told = next((text for _, x in survival if (text := lives.headline(x))), came)
    return capital(f"{told}{also}")


def _clear(found: lives.Lives) -> bool:
    best = lives.decisive(found.comparisons)
    return best is not None and best["p_value"] < 0.05


def _sub(run: Record | None) -> Piece:
    if run is None:
        return flow("Start with ", code("dealab nightly RAW"), ".")
    parts: list[Piece] = [digits(run["found"] or 0, "file") + " found"]
    if run["finished_at"] is not None:
        parts.append(f"finished {run['finished_at']:%H:%M}{NBSP}UTC")
        if run["started_at"] is not None:
            parts.append("took " + seconds((run["finished_at"] - run["started_at"]).total_seconds()))
    parts.append(end_in_words(run))
    return separated(parts)


def end_in_words(run: Record) -> str:
    """How a night ended, as its exit status says: what was refused or damaged earlier and still stands counts."""
    wanting = (
        (run["quarantined"], "refused"),
        (run["damaged"], "damaged"),
        (run["failed"], "analysis failed" if run["failed"] == 1 else "analyses failed"),
        (run["without_result"], "without a result"),
    )
    bad = [f"{whole(number)} {what}" for number, what in wanting if number]
    return f"done, {joined(bad)}" if bad else "all done"


def _specimens(site: Site, standings: Sequence[Brief]) -> Section | None:
    if not standings:
        return None
    blocks: list[Block | Fold] = []
    drawn = sorted(standings, key=lambda s: (not s.alarm, s.specimen_id))[: 2 * _MULTIPLES]
    full = of_lab(site.results, [s.specimen_id for s in drawn])
    figures, shared = campaign.multiples(site, full, "", _MULTIPLES)
    if figures:
        blocks.append(
            Text(
                flow(
                    "Dynamic stiffness |k| in N/mm against frequency in Hz, ", "all on the same" if shared else "each on its own", " axes: ", _key("dot"), "measured, ",
                    _key("line"), "selected model. Below: residual in SD of the noise, grey band ±2; vermilion beyond ±3 where the whole is more than noise.",
                ),
                "sub",
            )
        )  # fmt: skip
        blocks.append(Many(figures))
    blocks.append(specimen_table(site, "", "true", "", "Models and verdicts", limit=_SPECIMENS_SHOWN))
    more = len(standings) - _SPECIMENS_SHOWN
    text = f"{digits(more, 'specimen')} more are not shown here. " if more > 0 else ""
    blocks.append(Text(flow(text, link("All specimens", SPECIMENS)), "sub"))
    return Section("specimens", "Specimens", "Specimens", tuple(blocks))


def _key(kind: str) -> Piece:
    return Markup('<span class="key {}"></span>').format(kind)


def _run_numbers(run: Record | None) -> list[Text]:
    if run is None:
        return []
    parts = [
        f"{whole(run[c])} {w}"
        for c, w in (
            ("found", "found"),
            ("ingested", "ingested"),
            ("reused", "reused"),
            ("quarantined", "quarantined"),
            ("failed", "failed"),
        )
        if run[c] is not None
    ]
    return [Text(visible(", ".join(parts)) + ".")]
