"""What was written from what: the file by which unchanged pages are recognised, and writing that never leaves half a file."""

from __future__ import annotations

import functools
import hashlib
import importlib.metadata
import json
import os
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path

import schemas

NAME = ".manifest.json"
_OURS = re.compile(r"(?:[^/]+/)?[^/]+\.html|data/(?:[^/]+/)?[^/]+\.csv|(?:.*/)?\.writing-[^/]*")
"""What reports write: nothing else in their folder is ever removed."""
_SOURCES = (Path(__file__).parent, Path(schemas.__file__).parent)


@dataclass(frozen=True)
class Entry:
    """A page: the digest of everything it was made from, and its data files, relative to the reports' folder."""

    digest: str
    files: tuple[str, ...]


@functools.cache
def code_digest() -> str:
    """Digest of the code, templates and style that make pages, and of the libraries whose output they carry."""
    digest = hashlib.sha256()
    for folder in _SOURCES:
        for path in sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".j2", ".css")):
            digest.update(path.relative_to(folder.parent).as_posix().encode() + b"\0" + path.read_bytes())
    for library in ("duckdb", "jinja2", "markupsafe", "numpy"):
        digest.update(f"{library} {importlib.metadata.version(library)}\n".encode())
    return digest.hexdigest()


def read(folder: Path) -> dict[str, Entry]:
    """The manifest by page; empty where there is none or it cannot be read (then everything is made anew)."""
    try:
        pages = json.loads((folder / NAME).read_text(encoding="utf-8"))["pages"]
        return {page: Entry(e["digest"], tuple(e["files"])) for page, e in pages.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def write(folder: Path, entries: dict[str, Entry]) -> None:
    """Writes the manifest, pages in order; without indents, which json can only do in Python, for seconds where there are many."""
    pages = {page: {"digest": e.digest, "files": sorted(e.files)} for page, e in sorted(entries.items())}
    write_text(folder / NAME, json.dumps({"pages": pages}) + "\n")


def write_text(path: Path, text: str) -> None:
    """Replaces a file whole; readers see the old one or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=".writing-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(text.encode("utf-8", "backslashreplace"))
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def present(folder: Path) -> set[str]:
    """All files below the reports' folder, relative to it: looked at once, not file by file."""
    found: set[str] = set()
    for place, _, names in os.walk(folder):
        below = Path(place).relative_to(folder).as_posix()
        found.update(names if below == "." else (f"{below}/{name}" for name in names))
    return found


def remove_stale(folder: Path, there: set[str], kept: set[str]) -> int:
    """Removes pages and data files of earlier reports (`there`) that no page has any more; gives their number."""
    stale = [file for file in there - kept if _OURS.fullmatch(file)]
    for file in stale:
        (folder / file).unlink(missing_ok=True)
    return len(stale)
