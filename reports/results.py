"""The published database as the pages see it: read-only queries whose text the pages show, and digests by item.

A query that makes a table of a page is a `Query`; the page prints `Query.shown()`, which `dealab sql` answers with the
same rows. The database is opened read-only and nothing else is read.
"""

from __future__ import annotations

import hashlib
import itertools
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import duckdb
import numpy as np
from numpy.typing import NDArray

from reports.names import Verbatim, seen
from schemas.errors import LabError
from schemas.tables import TABLES
from schemas.views import VIEWS

Row = dict[str, Any]
DATABASE = "results.duckdb"

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


@dataclass(frozen=True)
class Query:
    """A SELECT with named parameters (`$name`)."""

    sql: str
    parameters: Mapping[str, str | float] = field(default_factory=dict)

    def shown(self) -> Verbatim:
        """The statement as somebody can type it: parameters written out as literals."""
        text = self.sql
        for name in sorted(self.parameters, key=len, reverse=True):
            text = text.replace(f"${name}", literal(self.parameters[name]))
        return Verbatim(text + ";")


def literal(value: str | float) -> str:
    """The value as SQL; characters that cannot be seen are spelt out with chr()."""
    if not isinstance(value, str):
        return repr(value)
    texts: list[str] = []
    for visible, run in itertools.groupby(value, key=seen):
        text = "".join(run)
        texts += ["'" + text.replace("'", "''") + "'"] if visible else [f"chr({ord(c)})" for c in text]
    if len(texts) == 1 and texts[0].startswith("'"):
        return texts[0]
    return f"({' || '.join(texts)})" if texts else "''"


class Results:
    """A published database, open for reading. `LabError` where there is none or it is not one of ours."""

    def __init__(self, lab: Path) -> None:
        self.path = lab / DATABASE
        self._known: dict[tuple[str, str], set[str | None]] = {}
        if not self.path.is_file():
            raise LabError(
                "there is no database to report on",
                where=str(self.path),
                remedy=f"Run `dealab nightly RAW --lab {lab}` first",
            )
        try:
            self._connection = duckdb.connect(str(self.path), read_only=True)
            self._connection.execute("SET TimeZone = 'UTC'")
            named = "SELECT table_name FROM duckdb_tables() UNION ALL SELECT view_name FROM duckdb_views()"
            found = {name for (name,) in self._connection.execute(named).fetchall()}
        except duckdb.Error as error:
            raise LabError(
                f"the database cannot be read: {str(error).splitlines()[0]}",
                where=str(self.path),
                remedy="Run `dealab doctor`; the next nightly publishes it anew",
            ) from error
        missing = sorted({*TABLES, *(view.name for view in VIEWS if not view.parameters)} - found)
        if missing:
            self.close()
            raise LabError(
                f"the database has no table {', '.join(missing)}",
                where=str(self.path),
                remedy="It was made by another version of dealab: run the nightly again",
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        self._connection.close()

    def rows(self, query: Query | str) -> list[Row]:
        """All rows, each a dictionary by column; times are aware datetimes in UTC."""
        query = Query(query) if isinstance(query, str) else query
        # Not through arrow, whose times with zone need pandas, which takes longer to import than a site to be checked.
        answer = self._connection.execute(query.sql, dict(query.parameters))
        names = [column[0] for column in answer.description]
        return [dict(zip(names, row, strict=True)) for row in answer.fetchall()]

    def columns(self, query: Query) -> dict[str, NDArray[Any]]:
        """All rows as one array per column; NULL in a real column is NaN."""
        answer = self._connection.execute(query.sql, dict(query.parameters)).fetchnumpy()
        return {name: _plain(np.ma.asarray(values)) for name, values in answer.items()}

    def has(self, table: str, key: str, value: str) -> bool:
        """Some row of the table has that value in the column; asked once for all values, so that pages can skip queries."""
        if (table, key) not in self._known:
            sql = f'SELECT DISTINCT "{key}" FROM {table}'
            self._known[table, key] = {v for (v,) in self._connection.execute(sql).fetchall()}
        return value in self._known[table, key]

    def digests(self) -> Digests:
        """Digests of everything that belongs to a recording, a specimen or a configuration."""
        by_recording = self._by(("recordings", *_BY_RECORDING, *_BY_BOTH), "recording_id")
        specimens = self._by((*_BY_SPECIMEN, *_BY_BOTH), "specimen_id")
        belongs: dict[str, set[str]] = defaultdict(set)
        for row in self.rows("SELECT DISTINCT specimen_id, recording_id FROM recordings WHERE specimen_id IS NOT NULL"):
            belongs[row["specimen_id"]].add(row["recording_id"] or "")
        for specimen, hashes in self._by(("recordings",), "specimen_id").items():
            specimens[specimen] = _combined(specimens.get(specimen, ""), hashes)
        failed = "SELECT item_id, outcome, error, run_id FROM items WHERE stage IN ('specimen', 'diagnosis')"
        for row in self.rows(f"{failed} ORDER BY item_id"):
            specimen = row["item_id"].partition(":")[2]
            specimens[specimen] = _combined(specimens.get(specimen, ""), *(str(v) for v in row.values()))
        for specimen, recordings in belongs.items():
            parts = (by_recording.get(r, "") for r in sorted(recordings))
            specimens[specimen] = _combined(specimens.get(specimen, ""), *parts)
        return Digests(
            recordings=by_recording,
            specimens=specimens,
            configurations=self._by(_BY_CONFIGURATION, "configuration"),
            comparisons=self._whole("survival_comparisons"),
            control=self._whole("control_points"),
            everything=_combined(
                *(self._whole(name) for name, table in TABLES.items() if not table.internal),
                str(self.rows("SELECT item_id, error FROM items WHERE outcome = 'failed' ORDER BY item_id")),
            ),
        )

    def _by(self, tables: tuple[str, ...], key: str) -> dict[str, str]:
        found: dict[str, list[str]] = defaultdict(list)
        for name in tables:
            sql = f"SELECT {key}, sum(hash(t)), count(*) FROM {name} AS t WHERE {key} IS NOT NULL GROUP BY ALL"
            for value, total, count in self._connection.execute(sql).fetchall():
                found[value].append(f"{name}:{total}:{count}")
        return {value: _combined(*parts) for value, parts in found.items()}

    def _whole(self, name: str) -> str:
        answer = self._connection.execute(f"SELECT sum(hash(t)), count(*) FROM {name} AS t").fetchall()
        return f"{name}:{answer}"


def _plain(values: np.ma.MaskedArray[Any, Any]) -> NDArray[Any]:
    """The array with NaN where a number is NULL, None where anything else is."""
    if not np.ma.is_masked(values):
        return np.asarray(values.data)
    if values.dtype.kind in "iuf":
        return np.asarray(np.ma.filled(values.astype(float), np.nan))
    return np.asarray(np.ma.filled(values.astype(object), None))


@dataclass(frozen=True)
class Digests:
    """What each page depends on, condensed: equal digests mean equal rows."""

    recordings: Mapping[str, str]
    specimens: Mapping[str, str]
    configurations: Mapping[str, str]
    comparisons: str
    control: str
    everything: str


def _combined(*parts: str) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()


def day(time: date | datetime | None) -> str:
    """`21 November 2026`."""
    if time is None:
        return "–"
    return f"{time.day}\u00a0{_MONTHS[time.month - 1]}\u00a0{time.year}"


def moment(time: datetime | None) -> str:
    """`21 November 2026, 05:12 UTC`."""
    return "–" if time is None else f"{day(time)}, {time:%H:%M}\u00a0UTC"


def days(first: datetime, last: datetime) -> str:
    """`18 to 20 November 2026`, as short as the span allows."""
    if first.date() == last.date():
        return day(first)
    if (first.year, first.month) == (last.year, last.month):
        return f"{first.day} to {day(last)}"
    return f"{day(first)} to {day(last)}"


_MONTHS = (
    "January", "February", "March", "April", "May", "June",
    "July", "August", "September", "October", "November", "December",
)  # fmt: skip
