"""Looking at the raw files of a night: which there are, which content each has, which are being written just now."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from ingest.discover import UNMAPPED, SourceFile, check_unchanged, discover, file_sha256, growing, lacks_end
from ingest.remote import fetch, is_staged, is_url, mirror
from pipeline.lab import Lab
from pipeline.paths import root_text, source_text
from pipeline.plan import Look
from pipeline.store.manifest import SeenFile
from schemas.errors import DealabError, LabError, PendingError, RefusedError

_YOUNG_NS = 60_000_000_000
_AT_ONCE = 500
"""Files that wait to be hashed; of each, the pool holds more than what is remembered."""
_SETTLED_NS = 2_000_000_000
"""A file that changed less than this before it was hashed could change again without getting a new time. An object's
mark changes with its content, however soon."""


@dataclass(frozen=True)
class Found:
    """Tonight's looks, the folders they come from, what to remember of the files, and what was passed over."""

    looks: tuple[Look, ...]
    roots: tuple[str, ...]
    seen: Mapping[str, SeenFile]
    unmapped: tuple[str, ...]
    notes: tuple[str, ...]


def likely_new(raw: Sequence[str | os.PathLike[str]], lab: Lab) -> bool:
    """Whether some folder has got other files since the lab was published: a guess within milliseconds, from the folders
    alone, so that workers can start while the night looks closely. A file that was written to in place escapes it.
    """
    try:
        published = lab.database.stat().st_mtime_ns
    except OSError:
        return True
    waiting = [os.fspath(given) for given in raw if not is_url(given)]
    while waiting:
        place = waiting.pop()
        try:
            if os.stat(place).st_ctime_ns > published:
                return True
            with os.scandir(place) as entries:
                waiting += [entry.path for entry in entries if entry.is_dir(follow_symlinks=False)]
        except OSError:  # a file, or nothing that can be listed
            continue
    return False


def look(raw: Sequence[str | os.PathLike[str]], lab: Lab, known: Mapping[str, SeenFile]) -> Found:
    """Finds the recordings among files, folders and URLs. A file that is as it was last time is not read again.

    Raises `LabError` when there is not a single recording: nothing to do is a failure, not a success.
    """
    mirrors = [mirror(given, lab.remote) for given in raw if isinstance(given, str) and is_url(given)]
    paths_given = [Path(os.path.abspath(given)) for given in raw if not is_url(given)]
    discovery = discover(paths_given, skip=[lab.folder], mirrors=mirrors)
    unmapped = tuple(source_text(f) for f in discovery.files if f.state == UNMAPPED)
    sources = [f for f in discovery.files if f.state != UNMAPPED]
    if not sources:
        also = f"; {len(unmapped)} data files have no mapping" if unmapped else ""
        raise LabError(
            f"no recordings were found{also}",
            where=", ".join(os.fspath(given) for given in raw)[:300],
            expected="*.mcap files, or data files with a mapping TOML",
            remedy="`dealab inspect FILE` says what a file holds and drafts a mapping",
        )
    paths = {id(source): source_text(source) for source in sources}
    now = {id(source): _identity(source) for source in sources}
    unchanged = {key: known[path] for key, path in paths.items() if _same(known.get(path), now[key])}
    new = [source for source in sources if id(source) not in unchanged]
    still_growing = {id(source) for source in growing(source for source in new if source.remote is None)}
    to_hash = [source for source in new if id(source) not in still_growing]
    room = _Room(lab.remote)
    hashes: dict[int, str | DealabError] = {}
    with ThreadPoolExecutor(max_workers=min(8, 2 * (os.cpu_count() or 1))) as pool:
        for first in range(0, len(to_hash), _AT_ONCE):
            some = to_hash[first : first + _AT_ONCE]
            hashes.update(zip(map(id, some), pool.map(room.hashed, some), strict=True))
    looks, seen = [], {}
    hashed_at = time.time_ns()
    for source in sources:
        key, path = id(source), paths[id(source)]
        if key in unchanged:
            looks.append(Look(source, path, unchanged[key].sha256))
            continue
        content = (
            PendingError("the file is being written", where=source.path.name) if key in still_growing else hashes[key]
        )
        if isinstance(content, DealabError):
            looks.append(Look(source, path, None, content))
            continue
        looks.append(Look(source, path, content))
        info = now[key]
        marked = source.remote is not None and source.remote.whole
        if info is not None and (marked or hashed_at - info[1] > _SETTLED_NS):
            seen[path] = SeenFile(*info, content)
    roots = (*(root_text(given) for given in paths_given), *(found.url for found in mirrors))
    return Found(tuple(looks), roots, seen, unmapped, discovery.notes)


def _identity(source: SourceFile) -> tuple[int, int, int] | None:
    """Size, time of change and inode, or what the store has in its place: another content has another of them."""
    if source.remote is not None:
        return source.remote.size, source.remote.mtime_ns, source.remote.version
    try:
        info = source.path.stat()
    except OSError:
        return None
    return info.st_size, info.st_mtime_ns, info.st_ino


def _same(known: SeenFile | None, now: tuple[int, int, int] | None) -> bool:
    return known is not None and (known.size, known.mtime_ns, known.inode) == now


class _Room:
    """Place for fetched files between their hashing and their reading: what finds none is fetched again to be read."""

    def __init__(self, folder: Path) -> None:
        self._left = shutil.disk_usage(folder).free // 2 if folder.is_dir() else 0
        self._lock = threading.Lock()

    def hashed(self, source: SourceFile) -> str | DealabError:
        """SHA-256 of a file's content, or why it cannot be had."""
        if source.remote is None:
            return _hashed(source)
        try:
            if not is_staged(source.path, source.remote):
                fetch(source.remote, source.path)
        except DealabError as error:
            return error
        content = _hashed(source)
        young = time.time_ns() - source.mtime_ns < _YOUNG_NS
        if young and not source.remote.whole and lacks_end(source.path, source.format):
            content = PendingError("the file is being written", where=source.path.name)
        with self._lock:
            self._left -= source.size
            full = self._left < 0
        if full or isinstance(content, DealabError):
            source.path.unlink(missing_ok=True)
        return content


def _hashed(source: SourceFile) -> str | DealabError:
    """SHA-256 of a file's content, or why it cannot be had."""
    try:
        content = file_sha256(source.path)
        check_unchanged(source.path, size=source.size, mtime_ns=source.mtime_ns)
    except DealabError as error:
        return error
    except OSError as error:
        return RefusedError(
            f"the file cannot be read: {error.strerror or error}",
            where=source.path.name,
            remedy="Give this user the right to read it",
        )
    return content
