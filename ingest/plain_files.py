"""Opening files that somebody else put there: regular files only, without waiting, and not without end.

A raw folder may hold a pipe that nobody writes to or a link to a device that never ends; where one of them takes the place
of a file between two looks, opening it as usual would wait for ever. Does not belong here: what the files hold.
"""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO


def open_plain(path: Path) -> BinaryIO:
    """A regular file, opened for reading bytes. Raises `OSError` for what is none, or cannot be opened."""
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    if not stat.S_ISREG(os.stat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is a pipe, a folder or a device", os.fspath(path))
    return os.fdopen(handle, "rb")


def read_plain(path: Path, limit: int) -> bytes:
    """At most one byte more than `limit` of a regular file. Raises `OSError`."""
    with open_plain(path) as file:
        return file.read(limit + 1)
