"""Databases with today's tables and no rows: made once and copied, since comments on a thousand columns take half a second."""

from __future__ import annotations

import functools
import shutil
import tempfile
from pathlib import Path
from typing import Any

from pipeline.lab import snapshot
from schemas.views import fingerprint

_FOLDER = tempfile.TemporaryDirectory()
_make_empty = snapshot._make_empty


def copy_empty_database(database: Path) -> None:
    """Makes a database as a lab's first night does."""
    shutil.copyfile(_make_for(fingerprint()), database)


def open_copy(database: Path, memory: str) -> Any:
    """Stands in for `snapshot._make_empty`."""
    copy_empty_database(database)
    return snapshot._open(database, memory)


@functools.cache
def _make_for(schema: str) -> Path:
    """The database that is copied, of tables that are described so."""
    path = Path(_FOLDER.name) / f"{schema}.duckdb"
    with _make_empty(path, snapshot._MEMORY[0]) as connection:
        connection.execute("CHECKPOINT")
    return path
