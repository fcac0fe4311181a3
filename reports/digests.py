"""Digests of the rows that each page is made from, by which it is known whether it has to be made again.

A digest is the sum of its rows' hashes and their number: equal digests mean equal rows, in whatever order they lie.
"""

from __future__ import annotations

from dataclasses import dataclass

from reports.results import Results
from schemas.tables import TABLES

_BY_RECORDING = (
    "annotations",
    "previews",
    "distortions",
    "step_responses",
    "slow_changes",
    "loop_responses",
    "electrode_cycles",
    "calibrations",
)
_BY_SPECIMEN = (
    "model_fits",
    "predictions",
    "sensing_fits",
    "controller_gains",
    "electrode_coats",
    "coverage_fits",
    "electrode_migrations",
    "force_maps",
    "force_map_fits",
    "diagnoses",
    "diagnosis_candidates",
    "diagnosis_parameters",
    "diagnosis_blocks",
    "diagnosis_curves",
)
_BY_BOTH = ("frequency_responses", "lifetimes", "discrepancies")
_BY_CONFIGURATION = (
    "survival_curves", "survival_summaries", "weak_regions", "lifetime_distributions", "failure_causes", "voltage_life",
    "voltage_residuals", "electrode_layouts", "film_maps",
)  # fmt: skip


def _hashed(tables: tuple[str, ...], key: str) -> str:
    """The hash of each row of some tables, with the item that it belongs to."""
    return "\nUNION ALL ".join(
        f"SELECT {key} AS item, hash('{name}', t) AS part FROM {name} AS t WHERE {key} IS NOT NULL" for name in tables
    )


_SUMMED = "SELECT item, concat(sum(part), ':', count(*)) AS digest FROM"
_BY_ITEM = f"""WITH recording AS MATERIALIZED (
{_SUMMED} ({_hashed(("recordings", *_BY_RECORDING, *_BY_BOTH), "recording_id")}) GROUP BY item
), specimen AS MATERIALIZED (
{_SUMMED} ({_hashed(("recordings", *_BY_SPECIMEN, *_BY_BOTH), "specimen_id")}
UNION ALL SELECT substr(item_id, instr(item_id, ':') + 1), hash('items', item_id, outcome, error, run_id)
    FROM items WHERE stage IN ('specimen', 'diagnosis')
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
    survival: str
    control: str
    everything: str

    def of(self, kind: str, item: str) -> str:
        """Digest of a recording, a specimen or a campaign; empty where no row is about it."""
        found = self.results.ledger.row("SELECT digest FROM digests WHERE kind = ? AND item = ?", (kind, item))
        return "" if found is None else str(found[0])


_WHOLE = "\nUNION ALL ".join(
    f"SELECT '{name}' AS name, sum(hash(t)) AS rows, count(*) AS n FROM {name} AS t"
    for name in (*(name for name, table in TABLES.items() if not table.internal), "control_points")
)
_FAILED = "SELECT sum(hash(item_id, error)) AS rows, count(*) AS n FROM items WHERE outcome = 'failed'"


def digests(results: Results) -> Digests:
    """Digests of everything; those of single items go to the ledger."""
    results.ledger.add("digests", (tuple(row.values()) for row in results.each(_BY_ITEM)))
    whole = {row["name"]: f"{row['rows']}:{row['n']}" for row in results.rows(_WHOLE)}
    control = whole.pop("control_points")
    return Digests(
        results,
        survival=str([whole[name] for name in (*_BY_CONFIGURATION, "survival_comparisons")]),
        control=control,
        everything=str([whole, results.rows(_FAILED)]),
    )
