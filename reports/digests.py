"""Digests of the rows that each page is made from, by which it is known whether it has to be made again.

A digest is the sum of its rows' hashes and their number: equal digests mean equal rows, in whatever order they lie.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from reports.results import Results
from schemas.mechanisms import FOREIGN
from schemas.tables import TABLES, Table


def _by_recording() -> Iterator[str]:
    """Tables whose rows belong to a recording: what its page shows, and what other pages find by recording alone."""
    for table in _shown():
        if "recording_id" in table.names and ("recording" in table.pages or "specimen_id" not in table.names):
            yield table.name


def _by_specimen() -> Iterator[str]:
    """Tables whose rows belong to a specimen: what its page shows, and that of its campaign."""
    for table in _shown():
        if "specimen_id" in table.names and {"specimen", "campaign"} & set(table.pages):
            yield table.name


def _by_group() -> Iterator[str]:
    """Tables of the pages of campaigns whose rows belong to neither."""
    for table in _shown():
        if "campaign" in table.pages and not {"recording_id", "specimen_id"} & set(table.names):
            yield table.name


def _shown() -> Iterator[Table]:
    return (table for table in TABLES.values() if not table.internal and table.pages)


def _hashed(tables: Iterable[str], key: str) -> str:
    """The hash of each row of some tables, with the item that it belongs to."""
    return "\nUNION ALL ".join(
        f"SELECT {key} AS item, hash('{name}', t) AS part FROM {name} AS t WHERE {key} IS NOT NULL" for name in tables
    )


_SUMMED = "SELECT item, concat(sum(part), ':', count(*)) AS digest FROM"


def _by_item() -> str:
    """The query for the digest of every recording, specimen and campaign.

    A specimen's holds those of its recordings and the outcome of its analyses, and with a foreign recording the responses of all, whose it
    may be; a campaign's those of its specimens.
    """
    return f"""WITH recording AS MATERIALIZED (
{_SUMMED} ({_hashed(_by_recording(), "recording_id")}) GROUP BY item
), specimen AS MATERIALIZED (
{_SUMMED} ({_hashed(_by_specimen(), "specimen_id")}
UNION ALL SELECT substr(item_id, instr(item_id, ':') + 1), hash('items', item_id, outcome, error, run_id)
    FROM items WHERE stage IN ('specimen', 'diagnosis')
UNION ALL SELECT specimen_id, hash('others', others.digest)
    FROM (SELECT DISTINCT specimen_id FROM corrections WHERE cause = '{FOREIGN}')
    CROSS JOIN (SELECT sum(hash(t)) AS digest FROM frequency_responses AS t WHERE loading = 'mechanical') AS others
UNION ALL SELECT specimen_id, hash('recording', recording_id, digest)
    FROM (SELECT DISTINCT specimen_id, recording_id FROM recordings WHERE specimen_id IS NOT NULL)
    LEFT JOIN recording ON item = recording_id
) GROUP BY item
), campaign AS (
{_SUMMED} (SELECT campaign AS item, hash('specimen', specimen_id, digest) AS part
    FROM (SELECT campaign, specimen_id FROM recordings UNION SELECT campaign, specimen_id FROM lifetimes)
    LEFT JOIN specimen ON item = specimen_id
    WHERE campaign IS NOT NULL AND specimen_id IS NOT NULL
) GROUP BY item
)
SELECT 'recording' AS kind, item, digest FROM recording
UNION ALL SELECT 'specimen', item, digest FROM specimen
UNION ALL SELECT 'campaign', item, digest FROM campaign"""


@dataclass(frozen=True)
class Digests:
    """Of what belongs to no one item; those of items lie in the ledger, where there are any."""

    results: Results
    groups: str
    control: str
    everything: str

    def of(self, kind: str, item: str) -> str:
        """Digest of a recording, a specimen or a campaign; empty where no row is about it."""
        found = self.results.ledger.row("SELECT digest FROM digests WHERE kind = ? AND item = ?", (kind, item))
        return "" if found is None else str(found[0])


def _whole() -> str:
    """The query for the digest of every table of results."""
    return "\nUNION ALL ".join(
        f"SELECT '{name}' AS name, sum(hash(t)) AS rows, count(*) AS n FROM {name} AS t"
        for name in (*(name for name, table in TABLES.items() if not table.internal), "control_points")
    )


_FAILED = "SELECT sum(hash(item_id, error)) AS rows, count(*) AS n FROM items WHERE outcome = 'failed'"


def digests(results: Results) -> Digests:
    """Digests of everything; those of single items go to the ledger."""
    results.ledger.add("digests", (tuple(row.values()) for row in results.each(_by_item())))
    whole = {row["name"]: f"{row['rows']}:{row['n']}" for row in results.rows(_whole())}
    control = whole.pop("control_points")
    return Digests(
        results,
        groups=str([whole[name] for name in _by_group()]),
        control=control,
        everything=str([whole, results.rows(_FAILED)]),
    )
