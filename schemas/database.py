"""Opening a database file: in words that DuckDB takes for a file and nothing else, and so that Ctrl-C ends what runs on it.

For DuckDB a path that begins with `md:`, `s3:` or `http:` is a service, which it fetches an extension for, and `:memory:` is
no file; an absolute path is always a file.
"""

from __future__ import annotations

import os
from typing import Any
from weakref import WeakSet

from schemas.errors import LabError

REBUILD = "Move it away; the next nightly over all raw folders builds it anew"
"""What to do with a published database that cannot be read."""

LOCAL = {"autoinstall_known_extensions": "false", "autoload_known_extensions": "false"}
"""With this DuckDB fetches nothing from a network: for a database of SQLite in the place of ours it did."""


def spell_database(path: str | os.PathLike[str]) -> str:
    """The path as DuckDB is given it. Raises `LabError` for one that DuckDB would take for another."""
    text = os.path.abspath(path)
    if os.sep == "/" and "\\" in text:
        raise LabError(
            "there is a backslash in the path of the lab, which DuckDB takes for a border between folders",
            where=text,
            expected="a path without",
            remedy="Choose another folder with --lab",
        )
    return text


def connect(path: str | os.PathLike[str] | None = None, **config: str) -> Any:
    """A DuckDB connection to a database file, to read it; to one in memory where there is no path.

    Raises `LabError` for what is no file and for a path that DuckDB would take for another, and what DuckDB raises.
    """
    import duckdb

    config = LOCAL | config
    if path is None:
        connection = duckdb.connect(config=dict(config))
    else:
        if os.path.exists(path) and not os.path.isfile(path):  # DuckDB would wait for a pipe
            raise LabError(
                "a folder, pipe or device stands in the place of the database", where=str(path), remedy=REBUILD
            )
        connection = duckdb.connect(spell_database(path), read_only=True, config=dict(config))
    _OPEN.add(connection)
    return connection


def interrupt_queries() -> None:
    """Ends what runs on the connections of this process, which raises `duckdb.InterruptException` there.

    A thread of DuckDB does not look up from its part of a query at an exception of Python's alone: an interrupt waited until
    that was done.
    """
    for connection in tuple(_OPEN):
        connection.interrupt()


_OPEN: WeakSet[Any] = WeakSet()
"""What `connect` has opened and somebody still holds."""
