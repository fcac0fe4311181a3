"""The door of dealab: the command, and `from dealab import Lab` for notebooks.

One file under a name that is ours alone. The packages behind it have names that others use too: `pip install reports` puts
another `reports` over ours without a word. So the door looks at what is installed before it imports any of it, and says
what is wrong in a sentence. Imports nothing but Python's own modules.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

PACKAGES = ("schemas", "ingest", "pipeline", "reports")
_HOME = os.path.dirname(os.path.abspath(__file__))
__all__ = ["Lab"]  # noqa: F822 - given by __getattr__


class Trouble(NamedTuple):
    """What is not as it was installed, and what to do.

    Parameters
    ----------
    problem, remedy : what is wrong, and what to do
    spoils : whether no command can be trusted; a file that somebody edited is told by `dealab doctor` only
    """

    problem: str
    remedy: str
    spoils: bool


def find_trouble() -> Trouble | None:
    """Looks whether Python finds our packages under their names, and whether their files are those that were installed."""
    from importlib.util import find_spec

    elsewhere, files = [], []
    for name in PACKAGES:
        spec = find_spec(name)
        origin = None if spec is None else spec.origin
        if origin is None or os.path.dirname(os.path.dirname(os.path.realpath(origin))) != os.path.realpath(_HOME):
            elsewhere.append(f"Python finds {origin or 'no package'} under the name {name}")
            files.append(f"{name}/__init__.py")
    if elsewhere:
        return _describe("; ".join(elsewhere), files, spoils=True)
    changed = list(_list_changed())
    if not changed:
        return None
    files = [name for name, _ in changed]
    shown = ", ".join(files[:3]) + (f" and {len(files) - 3} more" if len(files) > 3 else "")
    missing = any(is_missing for _, is_missing in changed)
    return _describe(f"files of dealab are {'missing' if missing else 'not as installed'}: {shown}", files, missing)


def _list_changed() -> Iterator[tuple[str, bool]]:
    """Files that differ from what pip recorded as it installed them, each with whether it is missing.

    Nothing where dealab runs from its project's folder: such files are meant to be edited.
    """
    record = _find_record()
    if record is None:
        return
    import csv
    from base64 import urlsafe_b64encode
    from hashlib import sha256

    with open(record, newline="", encoding="utf-8") as lines:
        for name, expected, _ in csv.reader(lines):
            if name.partition("/")[0] not in PACKAGES or not expected.startswith("sha256="):
                continue
            try:
                with open(os.path.join(_HOME, name), "rb") as file:
                    found = urlsafe_b64encode(sha256(file.read()).digest()).decode().rstrip("=")
            except OSError:
                yield name, True
            else:
                if f"sha256={found}" != expected:
                    yield name, False


def _find_record() -> str | None:
    """The list of files that pip keeps beside us."""
    for name in os.listdir(_HOME):
        if name.startswith("dealab-") and name.endswith(".dist-info"):
            path = os.path.join(_HOME, name, "RECORD")
            return path if os.path.isfile(path) else None
    return None


def _describe(problem: str, files: Sequence[str], spoils: bool) -> Trouble:
    """The trouble with some files, with whose they are now and the commands that put it right."""
    import shlex
    from importlib import metadata

    wanted = set(files)
    owners = set()
    for distribution in metadata.distributions():
        name = distribution.metadata["Name"]
        if name != "dealab" and any(str(file) in wanted for file in distribution.files or ()):
            owners.add(name)
    pip = f"{shlex.quote(sys.executable)} -m pip"
    commands = [f"`{pip} uninstall --yes {' '.join(sorted(owners))}`"] if owners else []
    if _find_record() is not None:
        commands.append(f"`{pip} install --force-reinstall --no-deps {_find_source()}`")
    because = f"; the package {' and '.join(sorted(owners))} has the same names" if owners else ""
    steps = ", then ".join(commands) or "Look at PYTHONPATH and at what lies there"
    remedy = f"{steps}; an environment of its own keeps dealab apart"
    return Trouble(problem + because, remedy, spoils or bool(owners))


def _find_source() -> str:
    """What dealab was installed from, as a word for a shell."""
    import json
    import shlex
    from importlib import metadata
    from urllib.parse import unquote, urlsplit

    text = metadata.distribution("dealab").read_text("direct_url.json")
    url = json.loads(text)["url"] if text else "FOLDER_OR_WHEEL_OF_DEALAB"
    return shlex.quote(unquote(urlsplit(url).path) if url.startswith("file://") else url)


def main() -> int:
    """The command line; returns the exit status."""
    words = sys.argv[1:]
    trouble = find_trouble()
    if trouble is not None and trouble.spoils:
        if words[:1] == ["doctor"]:
            print(f"PROBLEM  packages are ours: {trouble.problem}; {trouble.remedy}")
        else:
            print(f"dealab: {trouble.problem}. {trouble.remedy}", file=sys.stderr)
        return 1
    try:
        from pipeline.cli import main as run

        return run()
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library in PACKAGES:
            raise
        print(f"dealab: the library {library} is missing. `dealab doctor` lists what is needed", file=sys.stderr)
        return 1


def __getattr__(name: str) -> Any:
    """Loads `Lab` when it is asked for. Raises `ImportError` where the packages are not ours."""
    if name != "Lab":
        raise AttributeError(f"module 'dealab' has no attribute {name!r}")
    trouble = find_trouble()
    if trouble is not None and trouble.spoils:
        raise ImportError(f"{trouble.problem}. {trouble.remedy}")
    from pipeline import Lab

    return Lab


if __name__ == "__main__":
    sys.exit(main())
