"""What came in last night, and which campaigns there are."""

from __future__ import annotations

from reports.blocks import Head, Piece, Row, Section, Table, Text, code, flow, link, name
from reports.names import short
from reports.pages.index import trouble
from reports.results import Query, days
from reports.site import RECORDINGS, Site
from reports.words import plain, protocol
from schemas.numbers import ABSENT, capital, digits, every, joined

CAMPAIGNS_SHOWN = 40


_CAME_IN_SQL = f"""SELECT coalesce(kind, 'recording') AS kind, protocol, loading, count(*) AS recordings,
       array_agg(DISTINCT specimen_id ORDER BY specimen_id) AS specimens
FROM recordings
WHERE run_id = {trouble.LAST_RUN} AND status IN ('ok', 'damaged')
GROUP BY ALL
ORDER BY kind, protocol, loading"""
_NAMED = "array_agg(DISTINCT specimen_id ORDER BY specimen_id) FILTER (WHERE specimen_id <> '')"
_FIRST_SQL = _CAME_IN_SQL.replace(
    "array_agg(DISTINCT specimen_id ORDER BY specimen_id) AS specimens",
    f"({_NAMED})[:11] AS specimens, count(DISTINCT specimen_id) FILTER (WHERE specimen_id <> '') AS named",
)
"""The same with no more specimens than are shown: after a first night these may be all."""


def section(site: Site) -> Section | None:
    if not site.recordings:
        return None
    query = Query(_CAME_IN_SQL)
    found = site.results.rows(_FIRST_SQL)
    total = sum(r["recordings"] for r in found)
    everything: Piece = link(f"{every(site.recordings, 'recording')} in the lab", RECORDINGS)
    if not found:
        return Section(
            "in",
            "Nothing new came in",
            "What came in",
            (Text(flow("The last run found only what was known. ", everything, ".")),),
        )
    rows = []
    for r in found:
        known = [short(s, 24) for s in r["specimens"] or ()]
        text = joined([*known[:10], f"{r['named'] - 10} more"] if r["named"] > 11 else known) or ABSENT
        label: Piece = capital(protocol(r["protocol"], r["loading"]))
        if r["kind"] != "recording":
            label = f"Table of {plain(r['kind'])}"
        rows.append(Row((label, code(r["protocol"] or ABSENT), str(r["recordings"]), text)))
    heads = (Head("Test"), Head("Protocol"), Head("Recordings", "n"), Head("Specimens", "text"))
    table = Table(
        "Came in", heads, tuple(rows), query.shown(), digits(total, "recording or table", "recordings and tables")
    )
    return Section(
        "in", f"{capital(digits(total, 'recording'))} came in", "What came in", (table, Text(everything, "sub"))
    )


_CAMPAIGN_SQL = """WITH tested AS (
    SELECT campaign, count(DISTINCT specimen_id) AS specimens
    FROM (SELECT campaign, specimen_id FROM recordings UNION SELECT campaign, specimen_id FROM lifetimes)
    GROUP BY campaign
)
SELECT campaign, count(*) FILTER (WHERE status IN ('ok', 'damaged')) AS used,
       count(*) FILTER (WHERE status = 'quarantined') AS refused, any_value(specimens) AS specimens,
       min(started_at) AS first, max(started_at) AS last
FROM recordings JOIN tested USING (campaign)
WHERE campaign <> ''
GROUP BY campaign
ORDER BY last DESC, campaign
LIMIT {limit}"""


def campaigns(site: Site) -> Section | None:
    if not site.campaigns:
        return None
    query = Query(_CAMPAIGN_SQL.format(limit=CAMPAIGNS_SHOWN))
    known = set(site.campaigns)
    rows = tuple(
        Row(
            (
                site.campaign(r["campaign"], "") if r["campaign"] in known else name(r["campaign"]), str(r["specimens"]),
                str(r["used"]), str(r["refused"]), days(r["first"], r["last"]) if r["first"] else ABSENT,
            )
        )
        for r in site.results.rows(query)
    )  # fmt: skip
    heads = (
        Head("Campaign"),
        Head("Specimens", "n"),
        Head("Recordings used", "n"),
        Head("Refused", "n"),
        Head("Measured"),
    )
    table = Table("Campaigns, the latest first", heads, rows, query.shown(), kind="narrow")
    return Section("campaigns", "Campaigns", "Campaigns", (table,))
