"""The version of this software, as every result carries it."""

from __future__ import annotations

import functools


@functools.cache
def software_version() -> str:
    """The installed version; read once, since that means parsing a file."""
    from importlib import metadata

    return metadata.version("dealab")
