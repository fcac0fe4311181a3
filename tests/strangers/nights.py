"""A night of its own over one folder of foreign files, and what it made of them."""

from __future__ import annotations

import shutil
import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import duckdb
import numpy as np
import pyarrow.parquet as pq

from ingest.inspect import inspect
from pipeline.lab.lab import Lab
from pipeline.nightly.night import nightly
from schemas.errors import DealabError, LabError

REFUSED, UNMAPPED = "quarantined", "unmapped"


@dataclass(frozen=True)
class Taken:
    """One file after the night: its row of `recordings`, and its samples as instants and columns (NaN for NULL)."""

    name: str
    status: str
    said: str
    row: Mapping[str, Any]
    time_ns: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """From the first instant to the last."""
        return float(self.time_ns[-1] - self.time_ns[0]) * 1e-9


@dataclass(frozen=True)
class NightOfOne:
    """What a night made of a folder: its files by name, the published database, and the crash where there was one."""

    files: Mapping[str, Taken]
    exit_status: int | None
    attention: tuple[str, ...]
    lab: Path
    crash: str = ""

    def rows(self, query: str) -> list[tuple[Any, ...]]:
        """Rows of a query on the published database; none where nothing was published."""
        database = self.lab / "results.duckdb"
        if not database.is_file():
            return []
        with duckdb.connect(str(database), read_only=True) as connection:
            return connection.execute(query).fetchall()

    def value(self, query: str) -> Any:
        """The first value of a query, None where there is none."""
        rows = self.rows(query)
        return rows[0][0] if rows else None

    @property
    def only(self) -> Taken:
        """The one file of the folder."""
        (found,) = self.files.values()
        return found


def run_night(folder: Path, place: Path, leave_out: Sequence[str] = ("expected.json", "README")) -> NightOfOne:
    """Copies a folder and runs the nightly over the copy, everything in this process."""
    raw, lab = place / "raw", place / "lab"
    shutil.copytree(folder, raw, ignore=shutil.ignore_patterns(*leave_out))
    for path in raw.rglob("*"):
        path.chmod(0o755 if path.is_dir() else 0o644)
    data = sorted(p.relative_to(raw).as_posix() for p in raw.rglob("*") if p.is_file() and p.suffix != ".toml")
    unmapped = {name: Taken(name, UNMAPPED, "", {}) for name in data}
    try:
        summary = nightly([raw], Lab(lab), jobs=0)
    except LabError as error:
        return NightOfOne(unmapped, 1, (str(error),), lab)
    except DealabError as error:
        return NightOfOne({}, 1, (str(error),), lab)
    except Exception:
        return NightOfOne({}, None, (), lab, traceback.format_exc().strip().splitlines()[-1])
    night = NightOfOne({}, summary.exit_status, summary.attention, lab)
    with duckdb.connect(str(lab / "results.duckdb"), read_only=True) as connection:
        query = "SELECT source_path, recording_id, status, problem, notes, samples_path FROM recordings"
        found = connection.sql(query).to_arrow_table().to_pylist()
    taken = {name: _taken(name, row, lab) for row in found for name in [_below(raw, row["source_path"])]}
    return NightOfOne(unmapped | taken, night.exit_status, night.attention, lab)


def _below(raw: Path, place: str) -> str:
    return Path(place).resolve().relative_to(raw.resolve()).as_posix()


def _taken(name: str, row: Mapping[str, Any], lab: Path) -> Taken:
    said = " ".join(str(row[key]) for key in ("problem", "notes") if row.get(key))
    status = str(row["status"])
    if not row.get("samples_path"):
        return Taken(name, status, said, row)
    with (lab / row["samples_path"]).open("rb") as file:
        table = pq.ParquetFile(file).read()
    values = {c: table.column(c).to_numpy() for c in table.column_names if c != "time_ns"}
    return Taken(name, status, said, row, table.column("time_ns").to_numpy(), values)


def drafted(folder: Path, leave_out: Sequence[str] = ("expected.json", "README")) -> str:
    """The mapping that `inspect` drafts for the one data file of a folder, or why it drafts none."""
    path = next(p for p in sorted(folder.iterdir()) if p.name not in leave_out and p.suffix != ".toml")
    found = inspect(path)
    return found.draft or "; ".join(found.notes) or str(found.error)
