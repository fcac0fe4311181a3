"""Fresh = same input + same code + same settings: the hashes that say so."""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

_ROOT = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+((?:schemas|ingest|pipeline|reports)[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)"
    r"|import[ \t]+((?:schemas|ingest|pipeline|reports)[\w.]*))",
    re.M,
)
_NUMERICAL = ("numpy", "scipy", "pyarrow")
"""Libraries whose version is part of every result's code version."""


def digest(value: Any) -> str:
    """SHA-256 of plain values, independent of the order of keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def digest_of_lists(lists: Iterable[Iterable[Sequence[str]]]) -> str:
    """The digest of lists of texts in lists, which may be longer than fits in memory."""
    hasher = hashlib.sha256(b"[")
    for number, members in enumerate(lists):
        hasher.update(b", [" if number else b"[")
        for place, member in enumerate(members):
            hasher.update(f"{', ' if place else ''}{json.dumps(member)}".encode())
        hasher.update(b"]")
    hasher.update(b"]")
    return hasher.hexdigest()


@functools.cache
def code_version(module: str) -> str:
    """Hash over the source of a module, of everything of ours that it imports, and of the numerical libraries' versions.

    Imports are followed as they stand in the text, also those inside functions, so that no dependency can be forgotten.
    """
    hasher = hashlib.sha256()
    for path in sorted(_closure(module)):
        hasher.update(f"{path.relative_to(_ROOT).as_posix()}:{_source(path)[0]}\n".encode())
    for library in _NUMERICAL:
        hasher.update(f"{library}={metadata.version(library)}".encode())
    return hasher.hexdigest()


def _closure(module: str) -> set[Path]:
    found: set[Path] = set()
    waiting = [module]
    while waiting:
        path = _file(waiting.pop())
        if path is None or path in found:
            continue
        found.add(path)
        waiting += _source(path)[1]
    return found


@functools.cache
def _source(path: Path) -> tuple[str, tuple[str, ...]]:
    """SHA-256 of a source file, and the names of ours that it imports."""
    content = path.read_bytes()
    return hashlib.sha256(content).hexdigest(), tuple(_imports(content.decode("utf-8")))


def _imports(source: str) -> Iterable[str]:
    for package, names, plain in _IMPORT.findall(source):
        if plain:
            yield plain
            continue
        yield package
        for name in names.strip("()").split(","):
            word = name.split("#")[0].split()
            if word:
                yield f"{package}.{word[0]}"


@functools.cache
def _file(module: str) -> Path | None:
    base = _ROOT.joinpath(*module.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None
