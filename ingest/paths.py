"""A path as text: the same for a file however it was reached, and such that every store can hold it."""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence

from ingest.discover import SourceFile
from ingest.remote import is_url

PART = "#each="
"""Stands between the place of a file and the label of one of its recordings."""


def spell_path(path: str | os.PathLike[str]) -> str:
    """The absolute path with links in its folders resolved; bytes that are no UTF-8 are written as escapes."""
    folder, name = os.path.split(os.path.abspath(path))
    return os.fsencode(os.path.join(_resolve(folder), name)).decode("utf-8", "backslashreplace")


def spell_source(source: SourceFile) -> str:
    """Where a raw file is: its path, or the address it is fetched from; of one of its several recordings, with its label."""
    place = spell_path(source.path) if source.remote is None else source.remote.url
    return f"{place}{PART}{source.part}" if source.part else place


def is_there(place: str, roots: Sequence[str]) -> bool:
    """Whether a place that was not looked at holds a file. An address outside of `roots` is not asked."""
    return (
        not any(is_below(place, root) for root in roots) if is_url(place) else os.path.exists(place.partition(PART)[0])
    )


def is_below(path: str, root: str) -> bool:
    """Whether a file lies in the folder `root`, or is the file `root`."""
    return path.partition(PART)[0] == root or path.startswith(root.rstrip("/") + "/")


def spell_root(path: str | os.PathLike[str]) -> str:
    """The text of a folder that is looked through: what the texts of the files below it begin with."""
    return spell_path(os.path.join(os.path.abspath(path), "x"))[:-2] if os.path.isdir(path) else spell_path(path)


@functools.lru_cache(maxsize=4096)
def _resolve(folder: str) -> str:
    return os.path.realpath(folder)
