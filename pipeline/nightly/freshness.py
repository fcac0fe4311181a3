"""Fresh = same input + same code + same settings: the hashes that say so, and what needs not be made then."""

from __future__ import annotations

import functools
import hashlib
import json
import re
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from ingest.discover import SourceFile
from ingest.rigs import find_rig
from pipeline.nightly.ledger import Ledger
from schemas.errors import DealabError

_ROOT = Path(__file__).resolve().parents[2]
_IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+((?:schemas|ingest|pipeline|reports)[\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)"
    r"|import[ \t]+((?:schemas|ingest|pipeline|reports)[\w.]*))",
    re.M,
)
_NUMERICAL = ("numpy", "scipy", "pyarrow")
"""Libraries whose version is part of every result's code version."""


# --- hashes of values -------------------------------------------------------------------------------------------------


def digest(value: Any) -> str:
    """SHA-256 of plain values, independent of the order of keys."""
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def digest_lists(lists: Iterable[Iterable[Sequence[str]]]) -> str:
    """The digest of lists of texts in lists, which may be longer than fits in memory."""
    hasher = hashlib.sha256(b"[")
    for number, members in enumerate(lists):
        hasher.update(b", [" if number else b"[")
        for place, member in enumerate(members):
            hasher.update(f"{', ' if place else ''}{json.dumps(member)}".encode())
        hasher.update(b"]")
    hasher.update(b"]")
    return hasher.hexdigest()


# --- hashes of what a raw file's results are made from ----------------------------------------------------------------


def hash_input(mapping_hash: str, sha256: str, rig_hash: str) -> str:
    """Hash of all that the results of a raw file are made from: its content, its mapping and its rig's file."""
    return digest([sha256, mapping_hash, rig_hash])


def hash_reads(source: SourceFile) -> str:
    """Hash of what a mapping reads of a raw file (columns, rows, how), empty for a file that says it itself."""
    if source.mapping is not None:
        return source.mapping.reads
    return "" if source.error is None else digest(source.error.problem)


def plain_sha256(content: str | None) -> str | None:
    """The SHA-256 of a file, without the mark that tells ways of reading the same bytes apart."""
    return None if content is None else content.partition("#")[0]


def hash_mapping(source: SourceFile) -> str:
    """Hash of a raw file's mapping; of its error where it is wrong or there is none."""
    return source.mapping.hash if source.mapping is not None else digest(str(source.error))


def hash_rig(rig_id: str | None, path: Path, root: Path, rigs: Path | None) -> str:
    """Hash of the file of a rig, for a recording at `path` below `root`; of its error where it is wrong, empty where
    there is none."""
    try:
        rig = find_rig(rig_id, path, root=root, rigs=rigs)
    except DealabError as error:
        return digest(str(error))
    return "" if rig is None else rig.hash


# --- hashes of code ---------------------------------------------------------------------------------------------------


@functools.cache
def hash_code(modules: tuple[str, ...]) -> str:
    """Hash over the source of some modules, of all of ours that they import, and of the numerical libraries' versions.

    Imports are followed as they stand in the text, also those inside functions, so that no dependency can be forgotten.
    """
    hasher = hashlib.sha256()
    for path in sorted(find_sources(modules)):
        hasher.update(f"{path.relative_to(_ROOT).as_posix()}:{_read_source(path)[0]}\n".encode())
    for library in _NUMERICAL:
        hasher.update(f"{library}={metadata.version(library)}".encode())
    return hasher.hexdigest()


def find_sources(modules: Iterable[str]) -> set[Path]:
    """The source files of some modules and of everything of ours that they import."""
    found: set[Path] = set()
    waiting = list(modules)
    while waiting:
        path = _find_source(waiting.pop())
        if path is None or path in found:
            continue
        found.add(path)
        waiting += _read_source(path)[1]
    return found


@functools.cache
def _read_source(path: Path) -> tuple[str, tuple[str, ...]]:
    """SHA-256 of a source file, and the names of ours that it imports."""
    content = path.read_bytes()
    return hashlib.sha256(content).hexdigest(), tuple(_find_imports(content.decode("utf-8")))


def _find_imports(source: str) -> Iterable[str]:
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
def _find_source(module: str) -> Path | None:
    base = _ROOT.joinpath(*module.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


# --- what needs not be made -------------------------------------------------------------------------------------------


def leave_out_fresh(ledger: Ledger, stage: str, code_version: str, settings_hash: str) -> None:
    """Of the items of a stage that are `expected`, leaves those that have to be made.

    Fresh is one whose results, published or left in the journal, are what making it again would give.
    """
    same = (
        "made.item_id = e.item_id AND made.input_hash = e.input_hash AND made.code_version = ?"
        " AND made.settings_hash = ? WHERE e.stage = ?"
    )
    values = [code_version, settings_hash, stage]
    fresh = f"IN (SELECT e.item_id FROM expected e CROSS JOIN {{}} made ON {same})"
    ledger.run(f"UPDATE outcomes SET done = 1 WHERE item_id {fresh.format('outcomes')}", values)
    ledger.run(f"DELETE FROM expected WHERE item_id {fresh.format('items')}", values)
    ledger.run("DELETE FROM expected WHERE item_id IN (SELECT item_id FROM outcomes WHERE done)")
