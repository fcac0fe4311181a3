"""A path as text: the same for a file however it was reached, and such that every store can hold it."""

from __future__ import annotations

import functools
import os
from collections.abc import Sequence

from ingest.discover import SourceFile
from ingest.remote import is_url


def path_text(path: str | os.PathLike[str]) -> str:
    """The absolute path with links in its folders resolved; bytes that are no UTF-8 are written as escapes."""
    folder, name = os.path.split(os.path.abspath(path))
    return os.fsencode(os.path.join(_real(folder), name)).decode("utf-8", "backslashreplace")


def source_text(source: SourceFile) -> str:
    """Where a raw file is: its path, or the address it is fetched from."""
    return path_text(source.path) if source.remote is None else source.remote.url


def is_there(place: str, roots: Sequence[str]) -> bool:
    """Whether a place outside of tonight's files still holds a file. Of an address elsewhere that is taken for granted."""
    return not any(below(place, root) for root in roots) if is_url(place) else os.path.exists(place)


def below(path: str, root: str) -> bool:
    """Whether a file lies in a folder, or is the file that was given."""
    return path == root or path.startswith(root.rstrip("/") + "/")


def root_text(path: str | os.PathLike[str]) -> str:
    """The same for a folder that is looked through: the prefix of the paths of the files below it."""
    return path_text(os.path.join(os.path.abspath(path), "x"))[:-2] if os.path.isdir(path) else path_text(path)


@functools.lru_cache(maxsize=4096)
def _real(folder: str) -> str:
    return os.path.realpath(folder)
