"""The import path without the working folder: what lies beside somebody's raw data is data, never code.

Python puts the folder that a program is started in first on the path of `python -m`, `python -c` and of worker
processes, and takes an empty entry of `PYTHONPATH` for it as well: a `numpy.py` there would run in numpy's place. Imports
nothing but Python's own modules that are loaded already, so that it can come before everything else.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator

_ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
"""The folder that this software lies in, which stays on the path also where it is the working folder."""


def leave_working_folder() -> None:
    """Takes the working folder off the import path of this process."""
    sys.path[:] = _keep_trusted(sys.path)


@contextlib.contextmanager
def start_without_working_folder() -> Iterator[None]:
    """Python processes that are started in the block have no working folder on their import path."""
    before = {name: os.environ.get(name) for name in ("PYTHONSAFEPATH", "PYTHONPATH")}
    given = before["PYTHONPATH"]
    kept = _keep_trusted(given.split(os.pathsep) if given else [])
    if sys.path and _lead_to(sys.path[0] or os.curdir, _ROOT):  # we were started from a checkout that is not installed
        kept = [_ROOT, *kept]
    os.environ["PYTHONSAFEPATH"] = "1"
    os.environ["PYTHONPATH"] = os.pathsep.join(kept)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _keep_trusted(entries: list[str]) -> list[str]:
    """The entries that do not depend on where the program was started."""
    kept = []
    for entry in entries:
        if _lead_to(entry or os.curdir, _ROOT):
            kept.append(_ROOT)
        elif os.path.isabs(entry) and (_is_installed(entry) or not _lead_to(entry, os.curdir)):
            kept.append(entry)
    return kept


def _is_installed(entry: str) -> bool:
    """Whether a folder is Python's own or one of its installed packages, where somebody may be working just now."""
    return any(entry.startswith(os.path.join(prefix, "lib")) for prefix in (sys.prefix, sys.base_prefix))


def _lead_to(entry: str, folder: str) -> bool:
    return os.path.realpath(entry) == os.path.realpath(folder)
