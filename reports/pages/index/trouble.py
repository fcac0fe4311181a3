"""What did not come in whole, and what to do about it: refused, damaged, failed, duplicate, pending, passed over."""

from __future__ import annotations

import json
import re

from reports.blocks import Block, Fold, Head, Piece, Row, Section, Table, Text, code, flow, link, name, tag
from reports.names import short
from reports.pages import listing
from reports.results import Query
from reports.results import Row as Record
from reports.site import RECORDINGS, REFUSED, Site
from schemas.numbers import ABSENT, capital, digits, joined, seconds, word
from schemas.visible import quote_path

LAST_RUN = "(SELECT max(run_id) FROM runs)"
_REFUSED_SHOWN = 25

TROUBLE_SQL = """SELECT recording_id, source_path, status, problem, run_id IS NOT DISTINCT FROM {run} AS new
FROM recordings
WHERE status = '{status}'
ORDER BY new DESC, source_path, recording_id
LIMIT {limit} OFFSET {offset}"""


def section(site: Site) -> Section:
    """Refused, damaged, duplicate, pending, passed over: all of them, new ones first."""
    blocks: list[Block | Fold] = []
    counts = {
        r["status"]: r["files"]
        for r in site.results.rows("SELECT status, count(*) AS files FROM recordings GROUP BY status")
    }
    refused, damaged = counts.get("quarantined", 0), counts.get("damaged", 0)
    if refused:
        blocks.append(
            refused_table(
                site,
                _REFUSED_SHOWN,
                0,
                note=_of(refused, _REFUSED_SHOWN, "kept in quarantine; nothing of them is in the results"),
            )
        )
        blocks.append(Text(link("All refused files", REFUSED), "sub"))
    if damaged:
        blocks.append(_damaged_table(site, damaged))
        if damaged > _REFUSED_SHOWN:
            blocks.append(Text(link("All recordings with their status", RECORDINGS), "sub"))
    failed = _failed_table(site)
    if failed is not None:
        blocks.append(failed)
    silent = _without_result_table(site)
    if silent is not None:
        blocks.append(silent)
    if counts.get("excluded"):
        table = listing.taken_out(site, "$item = $item AND r.status = 'excluded'", "all", root="")
        if table:
            blocks.append(table)
    for status, words in (
        ("duplicate", "not ingested again: the same content came before"),
        ("pending", "left for the next run: still growing or changing"),
    ):
        if counts.get(status):
            blocks.append(_plain_table(site, status, counts[status], words))
    blocks += _passed_over(site)
    if not blocks:
        return Section("trouble", "Nothing was refused, nothing is damaged", "Refused and damaged", ())
    broken = len(failed.rows) if failed else 0
    counted_ = (
        (refused, "refused"),
        (damaged, "damaged"),
        (broken, "analysis failed" if broken == 1 else "analyses failed"),
        (count_without_result(site), "without a result"),
    )
    heading = joined([f"{word(n)} {what}" for n, what in counted_ if n])
    return Section("trouble", capital(heading) or "Files that were not taken in", "Refused and damaged", tuple(blocks))


def _of(count: int, shown: int, words: str) -> str:
    start = f"{digits(count, 'file')}" if count <= shown else f"{shown} of {digits(count, 'file')}, new ones first"
    return f"{start}; {words}"


def refused_table(site: Site, limit: int, offset: int, note: str = "", root: str = "") -> Table:
    """Refused files with the reason and what to do."""
    query = Query(TROUBLE_SQL.format(run=LAST_RUN, status="quarantined", limit=limit, offset=offset))
    rows = []
    for r in site.results.rows(query):
        why, remedy = reason(r["problem"])
        file = (r["source_path"] or ABSENT).rpartition("/")[2]
        todo: Piece = remedy or flow(
            code(f"dealab inspect {quote_path(short(r['source_path'] or file, 300))}"),
            " says more; mend the file and copy it again.",
        )
        new: Piece = " new" if r["new"] else ""
        rows.append(Row((flow(code(short(file, 80)), new), flow(tag("quarantined"), " ", why), todo)))
    heads = (Head("File"), Head("Why", "text"), Head("What to do", "text"))
    return Table("Refused", heads, tuple(rows), query.shown(), note)


def list_refused(site: Site) -> list[Record]:
    """`source_path` and `problem` of the refused files, new ones first."""
    return site.results.rows(
        "SELECT source_path, problem FROM recordings WHERE status = 'quarantined' AND source_path IS NOT NULL\n"
        f"ORDER BY run_id IS NOT DISTINCT FROM {LAST_RUN} DESC, source_path"
    )


def reason(problem: str | None) -> tuple[str, str]:
    """A stored reason in two parts: what is wrong with what was expected, and what to do (empty if it does not say)."""
    text = short(problem, 700) if problem else "no reason is recorded"
    found = re.search(r"\. (?=[A-Z`][^.]{8,300}\.?$)", text)
    if found is None:
        return text, ""
    why, remedy = text[: found.start()], text[found.end() :]
    return f"{why}.", remedy if remedy.endswith(".") else remedy + "."


def _damaged_table(site: Site, total: int) -> Table:
    query = Query(
        "SELECT recording_id, source_path, problem, notes, duration_s, sample_count\nFROM recordings\nWHERE status = 'damaged'\n"
        f"ORDER BY run_id IS NOT DISTINCT FROM {LAST_RUN} DESC, recording_id\nLIMIT {_REFUSED_SHOWN}"
    )
    rows = tuple(
        Row(
            (
                site.recording(r["recording_id"], ""), flow(tag("damaged"), " ", listing.problem(r["problem"])),
                f"{seconds(r['duration_s'])}, {digits(r['sample_count'] or 0, 'sample')}",
            )
        )
        for r in site.results.rows(query)
    )  # fmt: skip
    heads = (Head("Recording"), Head("What is missing", "text"), Head("What was kept"))
    return Table("Damaged", heads, rows, query.shown(), _of(total, _REFUSED_SHOWN, "used in part"))


def count_without_result(site: Site) -> int:
    """How many recordings and tables were taken in and led to no result."""
    query = Query("SELECT count(*) AS number FROM without_result WHERE status <> 'quarantined'")
    return int(site.results.rows(query)[0]["number"])


def list_unmapped(site: Site) -> list[str]:
    """The data files of the last run that have no mapping."""
    rows = site.results.rows("SELECT item_id FROM items WHERE outcome = 'unmapped' ORDER BY item_id")
    return [str(r["item_id"]).partition(":")[2] for r in rows]


def list_damaged(site: Site) -> list[Record]:
    """The recordings of which a part could not be read, with what is missing, those of the last run first."""
    return site.results.rows(
        "SELECT recording_id, problem FROM recordings WHERE status = 'damaged'\n"
        f"ORDER BY run_id IS NOT DISTINCT FROM {LAST_RUN} DESC, recording_id"
    )


def _without_result_table(site: Site) -> Table | None:
    """What was taken in and led to no result, with what was missing."""
    query = Query(
        "SELECT recording_id, source_path, what_was_missing\nFROM without_result\nWHERE status <> 'quarantined'\n"
        f"ORDER BY source_path, recording_id\nLIMIT {_REFUSED_SHOWN}"
    )
    found = site.results.rows(query)
    if not found:
        return None
    rows = []
    for r in found:
        why, remedy = reason(r["what_was_missing"])
        rows.append(Row((site.recording(r["recording_id"], ""), flow(tag("damaged", "no result"), " ", why), remedy)))
    heads = (Head("Recording or table"), Head("What was missing", "text"), Head("What to do", "text"))
    note = _of(count_without_result(site), _REFUSED_SHOWN, "taken in, and no analysis has a result from them")
    below = flow("One that never will is taken out with ", code("dealab exclude RECORDING --why TEXT"), ".")
    return Table("Led to no result", heads, tuple(rows), query.shown(), note, below=below)


_FAILED_SQL = """SELECT item_id, stage, split_part(error, chr(10), 1) AS error, run_id
FROM items
WHERE outcome = 'failed'
ORDER BY item_id"""


def _failed_table(site: Site) -> Table | None:
    """Analyses that did not come to an end: the recordings are there, their results are not."""
    query = Query(_FAILED_SQL)
    found = site.results.rows(query)
    if not found:
        return None
    rows = []
    for r in found:
        kind, _, item = r["item_id"].partition(":")
        label = site.specimen(item, "") if kind == "specimen" else name(item, 60)
        rows.append(
            Row(
                (
                    flow(kind, " ", label),
                    flow(tag("quarantined", "failed"), " ", short(r["error"] or "", 300)),
                    r["run_id"] or ABSENT,
                )
            )
        )
    heads = (Head("Analysis"), Head("Why", "text"), Head("Run"))
    below = flow(
        "Its recordings are kept; results of an earlier night, if any, stand. ", code("dealab status"), " says more."
    )
    return Table("Failed", heads, tuple(rows), query.shown(), "analyses that did not come to an end", below)


def _plain_table(site: Site, status: str, total: int, words: str) -> Fold:
    query = Query(TROUBLE_SQL.format(run=LAST_RUN, status=status, limit=_REFUSED_SHOWN, offset=0))
    rows = tuple(
        Row((code(short(r["source_path"] or ABSENT, 120)), listing.problem(r["problem"], 200) or ABSENT))
        for r in site.results.rows(query)
    )
    table = Table(
        capital(status), (Head("File"), Head("Why", "text")), rows, query.shown(), _of(total, _REFUSED_SHOWN, words)
    )
    return Fold(f"{digits(total, f'{status} file')}, {words}", (table,))


def _passed_over(site: Site) -> list[Fold]:
    run = site.last_run
    if run is None or not run["notes"]:
        return []
    try:
        notes = json.loads(run["notes"])
    except ValueError:
        notes = [run["notes"]]
    texts = [short(str(n), 240) for n in (notes if isinstance(notes, list) else [notes]) if n]
    if not texts:
        return []
    rows = tuple(Row((t,)) for t in texts[:100])
    query = Query("SELECT notes\nFROM runs\nORDER BY run_id DESC\nLIMIT 1")
    table = Table("Passed over", (Head("What"),), rows, query.shown(), f"{len(texts[:100])} of {len(texts)}")
    return [Fold(f"What was passed over, in {digits(len(texts), 'line')}", (table,))]
