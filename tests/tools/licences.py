"""Under which licences stands what dealab imports: the libraries that it asks for, their own ones and those of its extras."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path

from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ".github/packaging/licences.md"
ALWAYS = "always"
_OLDEST = {"python_version": "3.11", "python_full_version": "3.11.0"}
"""The oldest Python that is supported asks for the most: newer ones have in themselves what some libraries stand in for."""
_WEAK = re.compile(r"\bLGPL|Lesser General Public", re.IGNORECASE)


def find_needed() -> dict[str, set[str]]:
    """Every library that dealab comes to import on the oldest Python, with what asks for it: `always` or the names of extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    asked = {ALWAYS: project["dependencies"], **project["optional-dependencies"]}
    needed: dict[str, set[str]] = {}
    for why, requirements in asked.items():
        waiting = [Requirement(text) for text in requirements]
        seen: set[tuple[str, frozenset[str]]] = set()
        while waiting:
            one = waiting.pop()
            key = (canonicalize_name(one.name), frozenset(one.extras))
            if key in seen:
                continue
            seen.add(key)
            needed.setdefault(key[0], set()).add(why)
            waiting += _list_asked(one.name, one.extras)
    return needed


def _list_asked(name: str, extras: Iterable[str]) -> list[Requirement]:
    """What a library asks for with those extras; nothing where it is not installed, as those are that only an older Python needs."""
    try:
        found = [Requirement(text) for text in metadata.requires(name) or ()]
    except metadata.PackageNotFoundError:
        return []
    return [one for one in found if one.marker is None or _holds(one.marker, extras)]


def _holds(marker: Marker, extras: Iterable[str]) -> bool:
    return any(marker.evaluate({**_OLDEST, "extra": extra}) for extra in (*extras, ""))


def read_licence(about: metadata.PackageMetadata) -> str:
    """The licence of a library as its metadata name it: the expression, else the classifiers, else the first line of the text."""
    expression = about.get("License-Expression")
    if expression:
        return expression
    classified = [
        entry.rpartition(" :: ")[2]
        for entry in about.get_all("Classifier") or ()
        if entry.startswith("License ::") and not entry.endswith("OSI Approved")
    ]
    return ", ".join(classified) or (about.get("License") or "not said").strip().splitlines()[0]


def write_licences() -> str:
    """All libraries as a table, and what those under the LGPL ask of whoever passes them on."""
    rows = [_describe(name, why) for name, why in sorted(find_needed().items())]
    weak = [row.split(" | ")[0].strip("| ") for row in rows if _WEAK.search(row)]
    table = "\n".join(["| library | version | licence | needed |", "|---|---|---|---|", *rows])
    return f"{table}\n\nUnder the LGPL: {', '.join(weak) or 'none'}. {_ASKS}"


def _describe(name: str, why: set[str]) -> str:
    """The row of a library: of its metadata, or the one that stands in the document where this Python does not need it.

    Raises `SystemExit` where neither is there.
    """
    try:
        about = metadata.metadata(name)
    except metadata.PackageNotFoundError:
        row = re.search(rf"^\| {re.escape(name)} \|.*$", (ROOT / DOCUMENT).read_text(encoding="utf-8"), re.MULTILINE)
        if row is None:
            raise SystemExit(f"{name} is not installed: make docs with Python {_OLDEST['python_version']}") from None
        return row.group()
    reasons = ALWAYS if ALWAYS in why else ", ".join(f"`{extra}`" for extra in sorted(why))
    return f"| {name} | {about['Version']} | {read_licence(about)} | {reasons} |"


_ASKS = (
    "dealab imports these as they are, which leaves its own licence as it is; who passes on an environment or an image with them has to pass "
    "on their licences too, and must not keep anybody from putting another version of them in its place."
)
