"""What a lab holds, without what differs from night to night: for comparing two labs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import duckdb

from pipeline import Lab
from pipeline.lab.health import check_lab
from schemas.tables import TABLES

VOLATILE = {"items": {"seconds", "run_id", "input_hash", "code_version"}, "recordings": {"run_id"}}
"""Columns that differ from night to night, or when a source file is edited while the tests run."""

BY_NIGHT = ("runs", "files", "history")
"""Tables that say how it came about: nights, the clocks of files, what moved from night to night."""


def select(lab: Lab, query: str) -> list[tuple[Any, ...]]:
    """Rows of a query on the published database."""
    with duckdb.connect(str(lab.database), read_only=True) as connection:
        rows: list[tuple[Any, ...]] = connection.execute(query).fetchall()
    return rows


def content(lab: Lab) -> dict[str, list[str]]:
    """Everything in the database that does not depend on the clock, as sorted text."""
    found = {}
    with duckdb.connect(str(lab.database), read_only=True) as connection:  # opening takes longer than many a table
        for table in TABLES.values():
            columns = ", ".join(f'"{c.name}"' for c in table.columns if c.name not in VOLATILE.get(table.name, ()))
            if table.name not in BY_NIGHT:
                rows = connection.execute(f"SELECT {columns} FROM {table.name}").fetchall()
                found[table.name] = sorted(map(str, rows))
    return found


def samples(lab: Lab) -> dict[Path, bytes]:
    """All samples files, byte by byte."""
    return {path.relative_to(lab.folder): path.read_bytes() for path in lab.samples_folder.rglob("*") if path.is_file()}


def left_over(lab: Lab) -> list[str]:
    """Files and folders of the lab that no finished night leaves."""
    known = {".lock", "results.duckdb", "samples", "reports", "quarantine", "settings.toml", "annotations.jsonl"}
    strange = [path.name for path in lab.folder.iterdir() if path.name not in known]
    endings = (".tmp", ".wal", ".part")
    half = [p.name for p in lab.folder.rglob("*") if p.name.endswith(endings) or ".partial" in p.name]
    return strange + half


def healthy(lab: Lab) -> list[str]:
    """What `dealab doctor` finds wrong with a lab."""
    return [str(finding) for finding in check_lab(lab) if finding.problem]
