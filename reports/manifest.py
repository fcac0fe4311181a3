"""What was written from what: the file by which unchanged pages are recognised, and writing that never leaves half a file.

The manifest is JSON with one page a line, so that it is read and written without ever being in memory whole.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib.metadata
import itertools
import json
import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

import schemas
from reports.ledger import Ledger, batches

NAME = ".manifest.json"
_OURS = re.compile(r"(?:[^/]+/)?[^/]+\.html|data/(?:[^/]+/)?[^/]+\.csv|(?:.*/)?\.writing-[^/]*")
"""What reports write, with names of ASCII: nothing else in their folder is ever removed."""
_BEGIN, _WITH_SCRIPT, _END = '{"pages": {\n', '{"script": true, "pages": {\n', "}}\n"
_SOURCES = (Path(__file__).parent, Path(schemas.__file__).parent)


@functools.cache
def code_digest() -> str:
    """Digest of the code, templates and style that make pages, and of the libraries whose output they carry."""
    digest = hashlib.sha256()
    for folder in _SOURCES:
        for path in sorted(p for p in folder.rglob("*") if p.suffix in (".py", ".j2", ".css", ".js")):
            digest.update(path.relative_to(folder.parent).as_posix().encode() + b"\0" + path.read_bytes())
    for library in ("duckdb", "jinja2", "markupsafe", "matplotlib", "numpy", "pillow"):
        digest.update(f"{library} {importlib.metadata.version(library)}\n".encode())
    return digest.hexdigest()


def read(folder: Path, ledger: Ledger) -> None:
    """Notes pages, digests and data files of the manifest; nothing where there is none, or one that cannot be read or is of
    an earlier release, which had all pages in one line (then everything is made anew)."""
    try:
        with (folder / NAME).open(encoding="utf-8") as file:
            if file.readline(len(_WITH_SCRIPT)) not in (_BEGIN, _WITH_SCRIPT):
                return
            for some in batches(_entries(file)):
                ledger.add("known", ((page, digest) for page, digest, _ in some))
                ledger.add("data", ((page, path) for page, _, files in some for path in files))
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        ledger.run("DELETE FROM known")
        ledger.run("DELETE FROM data")


def _entries(file: Iterable[str]) -> Iterator[tuple[str, str, list[str]]]:
    """The pages of a manifest after its first line; `ValueError` where it is not whole."""
    for line in file:
        if line == _END:
            return
        ((page, entry),) = json.loads(f"{{{line.rstrip().removesuffix(',')}}}").items()
        digest, files = entry["digest"], entry["files"]
        if not (isinstance(digest, str) and isinstance(files, list) and all(isinstance(f, str) for f in files)):
            raise ValueError(page)
        yield page, digest, files
    raise ValueError("the end is missing")


def interactive(folder: Path) -> bool:
    """The pages that are there have the script."""
    with contextlib.suppress(OSError, ValueError), (folder / NAME).open(encoding="utf-8") as file:
        return file.readline(len(_WITH_SCRIPT)) == _WITH_SCRIPT
    return False


def write(folder: Path, ledger: Ledger, *, script: bool = False) -> None:
    """Writes the manifest, pages in order; `script`: they have one."""
    rows = ledger.each(
        "SELECT p.path, p.digest, d.path FROM pages AS p LEFT JOIN data AS d ON d.page = p.path ORDER BY p.path, d.path"
    )
    with _replacing(folder / NAME) as file:
        before = _WITH_SCRIPT if script else _BEGIN
        for (page, digest), some in itertools.groupby(rows, key=lambda row: row[:2]):
            entry = {"digest": digest, "files": [path for *_, path in some if path is not None]}
            file.write(f"{before}{json.dumps(page)}: {json.dumps(entry)}".encode())
            before = ",\n"
        file.write(f"\n{_END}".encode())


def write_text(path: Path, text: str) -> None:
    """Replaces a file whole; readers see the old one or the new one."""
    with _replacing(path) as file:
        file.write(text.encode("utf-8", "backslashreplace"))


@contextlib.contextmanager
def _replacing(path: Path) -> Iterator[BinaryIO]:
    """What is written takes the place of a file when it is whole."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=".writing-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            yield file
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def look(folder: Path, ledger: Ledger) -> None:
    """Notes all files of ours below the reports' folder: looked at folder by folder, not file by file."""
    ledger.add("found", ((path,) for path in _files(folder, "") if path.isascii() and _OURS.fullmatch(path)))


def _files(folder: Path, below: str) -> Iterator[str]:
    """Files in a folder and in those in it, relative to the reports' folder."""
    with contextlib.suppress(FileNotFoundError), os.scandir(folder) as found:
        for entry in found:
            if entry.is_dir(follow_symlinks=False):
                yield from _files(folder / entry.name, f"{below}{entry.name}/")
            else:
                yield below + entry.name


def remove_stale(folder: Path, ledger: Ledger) -> None:
    """Removes pages and data files of earlier reports that no page has any more."""
    for (path,) in ledger.each("SELECT path FROM found EXCEPT SELECT path FROM pages EXCEPT SELECT path FROM data"):
        (folder / path).unlink(missing_ok=True)
