"""Checks of the installation: is this the software it should be, with all that it needs?

Works also where libraries are missing, and imports none of them.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata

from dealab import find_trouble

_LISTED = 5


@dataclass(frozen=True)
class Finding:
    """The result of one check; `problem` is None where all is well."""

    check: str
    problem: str | None = None

    def __str__(self) -> str:
        return f"ok       {self.check}" if self.problem is None else f"PROBLEM  {self.check}: {self.problem}"


def check_installation() -> Iterator[Finding]:
    """Is this the software it should be? Ends with the libraries where some are missing: the rest needs them."""
    trouble = find_trouble()
    yield Finding("packages are ours", None if trouble is None else f"{trouble.problem}; {trouble.remedy}")
    found = f"{sys.version_info.major}.{sys.version_info.minor}"
    yield Finding(f"Python {found}", None if sys.version_info >= (3, 11) else "Python 3.11 or newer is needed")
    lacking = list_lacking()
    needed = f"`{shlex.quote(sys.executable)} -m pip install {shlex.join(lacking)}`"
    yield tell("required libraries are installed", list(lacking.values()), needed)
    if lacking:
        return
    from ingest.formats import find_plugins

    yield tell(
        "readers of other packages can be used",
        [f"{plugin.name} of {plugin.origin}: {plugin.trouble}" for plugin in find_plugins().values() if plugin.trouble],
        "mend or remove that package",
    )


def list_lacking() -> dict[str, str]:
    """Required libraries that are missing or too old: the requirement, and what is wrong with it in words."""
    try:
        from packaging.requirements import Requirement
    except ImportError:
        return {"packaging": "packaging is missing"}
    lacking = {}
    try:
        needed = metadata.requires("dealab") or []
    except metadata.PackageNotFoundError:  # run from the project's folder without being installed
        return {}
    for text in needed:
        requirement = Requirement(text)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        wanted = f"{requirement.name}{requirement.specifier}"
        try:
            version = metadata.version(requirement.name)
        except metadata.PackageNotFoundError:
            lacking[wanted] = f"{requirement.name} is missing"
            continue
        if not requirement.specifier.contains(version, prereleases=True):
            lacking[wanted] = f"{requirement.name} is {version}, {requirement.specifier} is needed"
    return lacking


def tell(check: str, wrong: list[str], remedy: str) -> Finding:
    """The result of a check that lists what is wrong; well where the list is empty."""
    if not wrong:
        return Finding(check)
    shown = ", ".join(wrong[:_LISTED]) + (f" and {len(wrong) - _LISTED} more" if len(wrong) > _LISTED else "")
    return Finding(check, f"{shown}; {remedy}")
