"""The import path without the working folder: what lies beside somebody's raw data is data, never code, and no settings.

Python puts the folder that a program is started in first on the path of `python -m`, `python -c` and of worker
processes, and takes an empty entry of `PYTHONPATH` for it as well: a `numpy.py` there would run in numpy's place. matplotlib
reads `matplotlibrc` of the working folder before any other settings. Imports nothing but Python's own modules that are
loaded already, so that it can come before everything else.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

_ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
"""The folder that this software lies in, which stays on the path also where it is the working folder."""


def leave_working_folder() -> None:
    """Takes the working folder off the import path of this process, and its settings out of the sight of libraries."""
    sys.path[:] = _keep_trusted(sys.path)
    if _LOADED_ELSEWHERE not in sys.meta_path:
        sys.meta_path.insert(0, _LOADED_ELSEWHERE)


class _LoadedElsewhere:
    """Loads the library that looks for settings in the working folder with its own folder in that one's place."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """That of the other finders; of any other module none, which they find themselves."""
        if name != "matplotlib":
            return None
        found = (finder.find_spec(name, path, target) for finder in sys.meta_path if finder is not self)
        spec = next((one for one in found if one is not None), None)
        if spec is not None and spec.loader is not None and spec.origin is not None:
            loader, home = spec.loader, os.path.dirname(spec.origin)
            load = loader.exec_module

            def load_elsewhere(module: ModuleType) -> None:
                with _working_in(home):
                    load(module)

            loader.exec_module = load_elsewhere  # type: ignore[method-assign]
        return spec


_LOADED_ELSEWHERE = _LoadedElsewhere()


@contextlib.contextmanager
def _working_in(folder: str) -> Iterator[None]:
    """Another working folder within the block; the same one where it cannot be left, because nobody could come back."""
    try:
        before = os.getcwd()
        os.chdir(folder)
    except OSError:
        yield
        return
    try:
        yield
    finally:
        os.chdir(before)


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
