"""The night's first step: which raw files there are, which content each has, which are being written just now.

A content is what is read of a raw file, known by its SHA-256; several files may have the same. Where mappings read the
same bytes in different ways (other columns, other rows), each way is a content of its own. Does not belong here: what a
content holds (`pipeline.nightly.read`), how folders are walked (`ingest.discover`).
"""

from __future__ import annotations

import json
import os
import shutil
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ingest.discover import UNMAPPED, SourceFile, check_unchanged, discover, file_sha256, growing, lacks_end
from ingest.passed_over import Passed
from ingest.paths import spell_root, spell_source
from ingest.remote import RemoteFile, fetch, is_staged, is_url, mirror
from pipeline.lab.journal import ACCIDENT, PENDING, RECORDING, Freshness, Outcome, make_item_id
from pipeline.lab.lab import Lab
from pipeline.nightly.freshness import hash_mapping, hash_reads, plain_sha256
from pipeline.nightly.ledger import Ledger, book_accident, split
from schemas.errors import AccidentError, DealabError, LabError, PendingError, RefusedError

SOURCE = "place, root, found_size, found_mtime_ns, format, state, url, name, version, whole, part"
"""Columns of `looks` that say which file it was."""
FILE = "file"
"""Stage of the items of files that are not read: what was passed over, or could not be looked at."""
NO_MAPPING = "no mapping: not read; `dealab add FILE` makes one"
_YOUNG_NS = 60_000_000_000
_AT_ONCE = 500
"""Files that wait to be hashed."""
_ASKED_AT_ONCE = 1000
"""Files that are asked together whether they grow, which may take a second."""
_MARK = 12
"""Characters of the hash that tells ways of reading the same bytes apart."""
_SETTLED_NS = 2_000_000_000
"""A file that changed less than this before it was hashed could change again without getting a new time. An object's
mark changes with its content, however soon."""


@dataclass(frozen=True)
class Found:
    """What a look at the raw files found.

    Parameters
    ----------
    roots : the files, folders and addresses that were looked through
    some_new : a file among them is new or changed
    unmapped : data files without a mapping, which are no recordings
    passed : what was passed over, and why
    """

    roots: tuple[str, ...]
    some_new: bool
    unmapped: tuple[str, ...]
    passed: tuple[Passed, ...]


class NothingFoundError(LabError):
    """There is no recording among the raw files; `lines` say of each file why it is none."""

    lines: tuple[str, ...] = ()


def has_newer_folder(raw: Sequence[str | os.PathLike[str]], lab: Lab) -> bool:
    """Whether some folder has got other files since the lab was published.

    A guess within milliseconds, from the folders alone, so that workers can start while the night looks closely. A file
    that was written to in place escapes it.
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


def look_at_files(
    raw: Sequence[str | os.PathLike[str]],
    lab: Lab,
    ledger: Ledger,
    *,
    run_id: str,
    deadline_s: float,
    rigs: Path | None = None,
) -> Found:
    """Finds the raw files that may be recordings and books a look at each, with its content.

    `raw` are files, folders and URLs. A file that is as it was last time is not read for its content again. Reading a
    file for its content may take `deadline_s`. `rigs` is the folder of rig files that was given.

    Raises `LabError` when there is not a single recording: nothing to do is a failure, not a success.
    """
    mirrors = [mirror(given, lab.remote) for given in raw if isinstance(given, str) and is_url(given)]
    paths_given = [Path(os.path.abspath(given)) for given in raw if not is_url(given)]
    unmapped: list[str] = []
    passed: list[Passed] = []

    def first_time(place: str) -> bool:
        return ledger.run("INSERT OR IGNORE INTO reached VALUES (?)", [os.fsencode(place)]) == 1

    def look() -> Iterator[tuple[Any, ...]]:
        found = discover(
            paths_given, passed.append, skip=[lab.folder], rigs=rigs, mirrors=mirrors, first_time=first_time
        )
        for source in found:
            if source.state == UNMAPPED:
                unmapped.append(spell_source(source))
            else:
                yield _make_row(source, ledger)

    ledger.add("looks", look())
    if not ledger.number("SELECT EXISTS (SELECT 1 FROM looks)"):
        also = f"; {len(unmapped)} data files have no mapping" if unmapped else ""
        also += f"; passed over: {passed[0]}" if passed else ""
        also += f" (and {len(passed) - 1} more lines)" if len(passed) > 1 else ""
        nothing = NothingFoundError(
            f"no recordings were found{also}",
            where=", ".join(os.fspath(given) for given in raw)[:300],
            expected="*.mcap files, or data files with a mapping TOML",
            remedy="`dealab inspect FILE` says what a file holds and drafts a mapping",
        )
        nothing.lines = (*map(str, passed), *(f"{path}: {NO_MAPPING}" for path in unmapped))
        raise nothing
    _hash_new(ledger, _Staging(lab.remote), run_id, deadline_s)
    separate_readings(ledger)
    roots = (*(spell_root(given) for given in paths_given), *(found.url for found in mirrors))
    some_new = bool(ledger.number("SELECT EXISTS (SELECT 1 FROM looks WHERE settled)"))
    return Found(roots, some_new, tuple(unmapped), tuple(passed))


def separate_readings(ledger: Ledger) -> None:
    """Tells contents apart that mappings read from the same bytes in different ways, by a mark behind the SHA-256.

    The way that was there first keeps the plain SHA-256, so that a mapping that changes makes no new content of its
    file.
    """
    shared = ledger.each(
        "SELECT sha256 FROM looks WHERE sha256 IS NOT NULL GROUP BY sha256 HAVING count(DISTINCT reads) > 1"
        " OR EXISTS (SELECT 1 FROM known WHERE source_sha256 > sha256 || '#' AND source_sha256 < sha256 || '$')"
    )
    for (sha256,) in list(shared):
        looks = list(
            ledger.each("SELECT id, path, reads FROM looks WHERE sha256 = ? ORDER BY length(path), path", [sha256])
        )
        known = dict(
            ledger.each(
                "SELECT source_sha256, source_path FROM known WHERE (source_sha256 = ? OR source_sha256 > ? AND"
                " source_sha256 < ?) AND status NOT IN ('duplicate', 'pending')",
                [sha256, f"{sha256}#", f"{sha256}$"],
            )
        )
        plain = _choose_plain(sha256, looks, known)
        for look, _, reads in looks:
            marked = _mark(sha256, reads)
            if reads != plain and (plain is not None or marked in known):
                ledger.run("UPDATE looks SET sha256 = ? WHERE id = ?", [marked, look])


def _choose_plain(sha256: str, looks: Sequence[tuple[int, str, str]], known: Mapping[str, str]) -> str | None:
    """The way of reading that keeps the plain SHA-256; None where a file has it that was not looked at tonight."""
    if sha256 in known:
        return next((reads for _, path, reads in looks if path == known[sha256]), None)
    return next((reads for _, _, reads in looks if _mark(sha256, reads) not in known), None)


def _mark(sha256: str, reads: str) -> str:
    return f"{sha256}#{reads[:_MARK]}"


def make_source(
    place: bytes, root: bytes, size: int, mtime_ns: int, file_format: str, state: str, *remote: Any
) -> SourceFile:
    """A file that was looked at, from its columns `SOURCE`; without its mapping, for `ingest.discover.with_mapping`."""
    url, name, version, whole, part = remote
    return SourceFile(
        Path(os.fsdecode(place)),
        Path(os.fsdecode(root)),
        size,
        mtime_ns,
        file_format,
        state,
        remote=None if url is None else RemoteFile(url, name, size, mtime_ns, version, bool(whole)),
        part=part,
    )


def _make_row(source: SourceFile, ledger: Ledger) -> tuple[Any, ...]:
    """The look at a file, with its content where it is as it was last time."""
    path, remote = spell_source(source), source.remote
    identity = _identify(source)
    known = ledger.row("SELECT size, mtime_ns, inode, sha256 FROM files WHERE path = ?", [path])
    return (
        None,
        path,
        os.fsencode(source.path),
        os.fsencode(source.root),
        source.size,
        source.mtime_ns,
        source.format,
        source.state,
        *((None,) * 4 if remote is None else (remote.url, remote.name, remote.version, remote.whole)),
        source.part,
        hash_mapping(source),
        *(identity or (None,) * 3),
        plain_sha256(known[3]) if known is not None and known[:3] == identity else None,
        None,
        None,
        False,
        False,
        hash_reads(source),
    )


def _hash_new(ledger: Ledger, staging: _Staging, run_id: str, deadline_s: float) -> None:
    """Reads the content of what is new or changed, some files at a time."""
    last = 0
    query = (
        f"SELECT id, mtime_ns, {SOURCE} FROM looks WHERE id > ? AND sha256 IS NULL ORDER BY id LIMIT {_ASKED_AT_ONCE}"
    )
    while some := list(ledger.each(query, [last])):
        last = some[-1][0]
        sources = [make_source(*row[2:]) for row in some]
        still_growing = {id(one) for one in growing(one for one in sources if one.remote is None)}
        for part in split(zip(some, sources, strict=True), _AT_ONCE):
            to_hash = [source for _, source in part if id(source) not in still_growing]
            hashes = dict(zip(map(id, to_hash), _hash_in_time(to_hash, staging, deadline_s), strict=True))
            hashed_at = time.time_ns()
            for (look, mtime_ns, *_), source in part:
                content = hashes.get(id(source)) or PendingError("the file is being written", where=source.path.name)
                if isinstance(content, AccidentError):
                    content = _book_accident(ledger, source, content, run_id)
                _book_content(ledger, look, content, _is_settled(source, mtime_ns, hashed_at))


def _book_accident(ledger: Ledger, source: SourceFile, error: AccidentError, run_id: str) -> PendingError:
    """Books trouble with a file whose content is not known."""
    path = spell_source(source)
    facts = {ACCIDENT: True, "source_path": path}
    item_id = make_item_id(FILE, path)
    outcome = Outcome(item_id, RECORDING, Freshness("", "", ""), PENDING, 0.0, error.problem, facts)
    return PendingError(book_accident(ledger, outcome, run_id), where=source.path.name)


def _hash_in_time(sources: Sequence[SourceFile], staging: _Staging, deadline_s: float) -> list[str | DealabError]:
    """The content of each file, or why it cannot be had.

    A thread that waits for a file system which does not answer cannot be ended: it is left behind, and the other files
    go on in new threads.
    """
    from pebble import ThreadPool

    found: list[str | DealabError] = []
    while len(found) < len(sources):
        pool = ThreadPool(max_workers=min(8, 2 * (os.cpu_count() or 1)))
        hashes = [pool.schedule(staging.hash_content, args=[source]) for source in sources[len(found) :]]
        pool.close()
        for future in hashes:
            try:
                found.append(future.result(timeout=deadline_s))
            except TimeoutError:
                name = sources[len(found)].path.name
                found.append(AccidentError("reading it took longer than deadline_s allows", where=name))
                pool.stop()
                break
        else:
            pool.join()
    return found


def _book_content(ledger: Ledger, look: int, content: str | DealabError, settled: bool) -> None:
    if isinstance(content, DealabError):
        ledger.run(
            "UPDATE looks SET problem = ?, refusal = ?, pending = ? WHERE id = ?",
            [str(content), json.dumps(content.as_dict()), content.transient, look],
        )
    else:
        ledger.run("UPDATE looks SET sha256 = ?, settled = ? WHERE id = ?", [content, settled, look])


def _is_settled(source: SourceFile, mtime_ns: int | None, hashed_at: int) -> bool:
    """Whether a file that is found as it was when it was hashed has the content that it had."""
    marked = source.remote is not None and source.remote.whole
    return mtime_ns is not None and (marked or hashed_at - mtime_ns > _SETTLED_NS)


def _identify(source: SourceFile) -> tuple[int, int, int] | None:
    """Size, time of change and inode, or what the store has in its place: another content has another of them."""
    if source.remote is not None:
        return source.remote.size, source.remote.mtime_ns, source.remote.version
    try:
        info = source.path.stat()
    except OSError:
        return None
    return info.st_size, info.st_mtime_ns, info.st_ino


class _Staging:
    """Where fetched files stay until they are read, as far as the disk has room; others are fetched once more then."""

    def __init__(self, folder: Path) -> None:
        self._left = shutil.disk_usage(folder).free // 2 if folder.is_dir() else 0
        self._lock = threading.Lock()

    def hash_content(self, source: SourceFile) -> str | DealabError:
        """SHA-256 of a file's content, or why it cannot be had."""
        if source.remote is None:
            return _hash_file(source)
        try:
            if not is_staged(source.path, source.remote):
                fetch(source.remote, source.path)
        except DealabError as error:
            return error
        content = _hash_file(source)
        young = time.time_ns() - source.mtime_ns < _YOUNG_NS
        if young and not source.remote.whole and lacks_end(source.path, source.format):
            content = PendingError("the file is being written", where=source.path.name)
        with self._lock:
            self._left -= source.size
            full = self._left < 0
        if full or isinstance(content, DealabError):
            source.path.unlink(missing_ok=True)
        return content


def _hash_file(source: SourceFile) -> str | DealabError:
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
