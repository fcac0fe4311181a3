"""Where a database file is, in words that DuckDB takes for a file and nothing else.

For DuckDB a path that begins with `md:`, `s3:` or `http:` is a service, which it fetches an extension for, and `:memory:` is
no file; an absolute path is always a file.
"""

from __future__ import annotations

import os

from schemas.errors import LabError

REBUILD = "Move it away; the next nightly over all raw folders builds it anew"
"""What to do with a published database that cannot be read."""


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
